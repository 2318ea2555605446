"""Labels, put where they cross neither curves nor borders nor each other."""

from collections.abc import Sequence
from typing import Any, Literal, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

# Distances of a label from its point, in points, and directions in which it may stand, the best ones first.
_DISTANCES = (5.0, 9.0, 14.0, 20.0, 28.0, 38.0)
AROUND = ((1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))
BESIDE = ((1, 0), (-1, 0))
_ACROSS: dict[int, Literal["left", "center", "right"]] = {1: "left", 0: "center", -1: "right"}
_UP: dict[int, Literal["bottom", "center", "top"]] = {1: "bottom", 0: "center", -1: "top"}
_NOTHING = ("None", "none", "", " ", None)
# Room that a label keeps, in pixels.
_ROOM = 1.5


def place_labels(figure: Figure, labels: Sequence[Annotation], directions: Sequence[tuple[int, int]] = AROUND) -> None:
    """Puts each label beside its point where it crosses nothing, as near as can be.

    A label that finds no such place stands where it crosses least.

    Args:
        figure: with all else that it shows.
        labels: its annotations, with offsets in points.
        directions: in which they may stand, by preference.
    """
    figure.draw_without_rendering()
    taken: list[Bbox] = []
    for label in labels:
        obstacles = outlines(_axes(label))
        tries = [(distance, direction) for distance in _DISTANCES for direction in directions]
        costs = []
        for distance, direction in tries:
            _stand(label, distance, direction)
            costs.append(crossings(label, obstacles, taken))
            if not costs[-1]:
                break
        _stand(label, *tries[int(np.argmin(costs))])
        taken.append(_box(label))


def crossings(label: Annotation, curves: Sequence[Path], taken: Sequence[Bbox] = ()) -> int:
    """The number of curves and boxes on the page that a label crosses, and of borders of its axes."""
    box, inside = _box(label), _axes(label).get_window_extent()
    outside = not (inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1)
    return sum(curve.intersects_bbox(box, filled=False) for curve in curves) + sum(map(box.overlaps, taken)) + outside


def outlines(axes: Axes) -> list[Path]:
    """The lines and the edges of areas of axes on the page, markers as squares."""
    found = [patch.get_transform().transform_path(patch.get_path()) for patch in axes.patches]
    for line in axes.lines:
        path = line.get_transform().transform_path(line.get_path())
        if line.get_linestyle() not in _NOTHING:
            found.append(path)
        if line.get_marker() not in _NOTHING:
            half = 0.5 * line.get_markersize() * axes.get_figure(root=True).dpi / 72.0  # type: ignore[union-attr]
            found += [_square(x, y, half) for x, y in np.asarray(path.vertices).tolist() if np.isfinite(x + y)]
    return found


def _square(x: float, y: float, half: float) -> Path:
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    return Path([(x + a * half, y + b * half) for a, b in corners])


def _stand(label: Annotation, distance: float, direction: tuple[int, int]) -> None:
    across, up = direction
    label.set_position((distance * across, distance * up))
    label.set_horizontalalignment(_ACROSS[across])
    label.set_verticalalignment(_UP[up])


def _box(label: Annotation) -> Bbox:
    canvas: Any = _axes(label).get_figure(root=True).canvas  # type: ignore[union-attr]
    renderer = canvas.get_renderer()
    label.update_positions(renderer)
    return label.get_window_extent(renderer).padded(_ROOM)


def _axes(label: Annotation) -> Axes:
    return cast(Axes, label.axes)
