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

# A leg with a lower horizontal speed at its middle (m/s) counts as vertical.
_MIN_HORIZONTAL_SPEED = 0.2


class LegMark(NamedTuple):
    """Position of the number of a leg.

    Attributes:
        number: number of the leg, from 1 on.
        place: middle of the leg, (3,), m.
        beside: unit vector to the right of the leg, seen from above, (2,); zero for a vertical leg.
    """

    number: int
    place: np.ndarray
    beside: np.ndarray


def leg_marks(plan: Plan) -> list[LegMark]:
    """Return the marks of a plan's legs; none if the plan has a single leg."""
    position, velocity = plan.derivative(0), plan.derivative(1)
    marks = []
    for number, (start, end) in enumerate(_legs(plan), start=1):
        middle = 0.5 * (start + end)
        v_x, v_y, _ = velocity.value(middle)[:, 0]
        speed = np.hypot(v_x, v_y)
        beside = np.array([v_y, -v_x]) / speed if speed > _MIN_HORIZONTAL_SPEED else np.zeros(2)
        marks.append(LegMark(number, position.value(middle)[:, 0], beside))
    return marks


def number_legs(axes: Axes, plan: Plan, *, distance: float = 11.0) -> None:
    """Write the number of each leg beside its middle, seen from above.

    Args:
        axes: axes that show X and Y of W, m.
        plan: plan with the legs.
        distance: distance from a number to the path, points.
    """
    for number, (x, y, _), (right_x, right_y) in leg_marks(plan):
        # A vertical leg is a point from above, so its number would lie on top of others.
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
    """Return legend handles that explain the numbers by the names of the legs."""
    return [
        Line2D([], [], linestyle="none", marker=_outline(str(mark.number)), color="0.35", label=leg.name)
        for mark, leg in zip(leg_marks(plan), plan.legs, strict=False)
    ]


def _outline(text: str) -> Path:
    """Return a text as a centred marker; a formula such as `$1$` would need the slow mathtext parser."""
    path = TextPath((0.0, 0.0), text)
    return Path(path.vertices - path.get_extents().get_points().mean(axis=0), path.codes)


def shade_legs(axes: Axes, plan: Plan, last_time: float, *, height: float | None = None) -> None:
    """Write the numbers of the legs over time, and shade every second leg.

    Args:
        axes: axes over time, s.
        plan: plan with the legs.
        last_time: last time that the axes show, s.
        height: height of the numbers as a share of the axes; None to write them above the axes, clear of curves.
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
    """Return start and end of each leg, s; nothing for a plan with a single leg."""
    ends = [*plan.leg_times, float(plan.path.times[-1])]
    return list(itertools.pairwise(ends)) if len(ends) > 2 else []
