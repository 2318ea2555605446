"""Numbers that mark the legs of a route, over time and along the path."""

import itertools
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from drake_quad.reference.plan import Plan
from drake_quad.visualization.style import PLATE

# From above, a leg that is slower than this in its middle goes straight up, m/s.
_SLOW = 0.2


class LegMark(NamedTuple):
    """Where the number of a leg is written.

    Attributes:
        number: from 1 on.
        place: of the middle of the leg, (3,), m.
        beside: (2,) direction to its right, seen from above; zero if the leg is a point from there.
    """

    number: int
    place: np.ndarray
    beside: np.ndarray


def leg_marks(plan: Plan) -> list[LegMark]:
    """The marks of a plan's legs; none if the plan has a single leg."""
    position, velocity = plan.derivative(0), plan.derivative(1)
    marks = []
    for number, (start, end) in enumerate(_legs(plan), start=1):
        middle = 0.5 * (start + end)
        v_x, v_y, _ = velocity.value(middle)[:, 0]
        speed = np.hypot(v_x, v_y)
        beside = np.array([v_y, -v_x]) / speed if speed > _SLOW else np.zeros(2)
        marks.append(LegMark(number, position.value(middle)[:, 0], beside))
    return marks


def number_legs(axes: Axes, plan: Plan, *, distance: float = 11.0) -> None:
    """Writes the number of each leg beside its middle, seen from above.

    Args:
        axes: with X and Y of W, m.
        plan: with the legs.
        distance: of the number from the path, in points.
    """
    for number, (x, y, _), (right_x, right_y) in leg_marks(plan):
        # The number of a leg that is a point from above would lie on top of others.
        if right_x or right_y:
            axes.annotate(
                str(number),
                (x, y),
                (distance * right_x, distance * right_y),
                textcoords="offset points",
                ha="center",
                va="center",
                color="0.35",
                bbox=PLATE,
                annotation_clip=True,
            )


def leg_names(plan: Plan) -> list[Line2D]:
    """Handles of a legend that says what the numbers mean."""
    return [
        Line2D([], [], linestyle="none", marker=_outline(str(mark.number)), color="0.35", label=leg.name)
        for mark, leg in zip(leg_marks(plan), plan.legs, strict=False)
    ]


def _outline(text: str) -> Path:
    """A text as a marker, about its middle; a formula, as in `$1$`, would take a parser of formulas, and its time."""
    path = TextPath((0.0, 0.0), text)
    return Path(path.vertices - path.get_extents().get_points().mean(axis=0), path.codes)


def shade_legs(axes: Axes, plan: Plan, last_time: float, *, height: float | None = None) -> None:
    """Writes the numbers of the legs over time, and shades every second leg.

    Args:
        axes: over time, s.
        plan: with the legs.
        last_time: up to which the axes show something, s.
        height: at which the numbers stand, as a share of the axes; None for above them, where no curve is.
    """
    for number, (start, end) in enumerate(_legs(plan), start=1):
        if start >= last_time:
            break
        if number % 2 == 0:
            axes.axvspan(start, min(end, last_time), color="0.95", zorder=0, linewidth=0)
        middle = 0.5 * (start + min(end, last_time))
        place, lift = (middle, 1.0 if height is None else height), 4.0 if height is None else 0.0
        axes.annotate(
            str(number),
            place,
            (0.0, lift),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            color="0.4",
            bbox=PLATE,
        )


def _legs(plan: Plan) -> list[tuple[float, float]]:
    """Start and end of each leg, s."""
    ends = [*plan.leg_times, float(plan.path.times[-1])]
    return list(itertools.pairwise(ends)) if len(ends) > 2 else []
