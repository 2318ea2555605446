"""Numbers of the legs of a route, in plots over time and in plots of the path."""

import itertools
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.textpath import TextPath

from drake_quad.reference.plan import Plan
from drake_quad.visualization.style import TEXT_BACKGROUND

# A leg counts as vertical if the horizontal speed at the middle of the leg is below this, m/s.
_MIN_HORIZONTAL_SPEED = 0.2


class LegMark(NamedTuple):
    """Number of a leg, and its position in a plot.

    Attributes:
        number: number of the leg, from 1 on.
        middle: middle of the leg, (3,), m.
        right: unit vector to the right of the leg, seen from above, (2,); zero for a vertical leg.
    """

    number: int
    middle: np.ndarray
    right: np.ndarray


def leg_marks(plan: Plan) -> list[LegMark]:
    """Return the marks of a plan's legs; empty if the plan has a single leg."""
    position, velocity = plan.derivative(0), plan.derivative(1)
    marks = []
    for number, (start, end) in enumerate(_legs(plan), start=1):
        middle = 0.5 * (start + end)
        v_x, v_y, _ = velocity.value(middle)[:, 0]
        speed = np.hypot(v_x, v_y)
        right = np.array([v_y, -v_x]) / speed if speed > _MIN_HORIZONTAL_SPEED else np.zeros(2)
        marks.append(LegMark(number, position.value(middle)[:, 0], right))
    return marks


def number_legs(axes: Axes, plan: Plan, *, distance: float = 11.0) -> None:
    """Write the number of each leg beside its middle, in a plot of the path from above.

    Args:
        axes: axes that show X and Y, m.
        plan: plan with the legs.
        distance: distance of a number from the path, points.
    """
    for number, (x, y, _), (right_x, right_y) in leg_marks(plan):
        # Seen from above, a vertical leg is a point, so its number would hide the numbers of the neighbouring legs.
        if right_x or right_y:
            axes.annotate(
                str(number),
                (x, y),
                (distance * right_x, distance * right_y),
                textcoords="offset points",
                ha="center",
                va="center",
                color="0.35",
                bbox=TEXT_BACKGROUND,
                annotation_clip=True,
            )


def leg_legend(plan: Plan) -> list[Line2D]:
    """Return legend handles with the number and the name of each leg."""
    return [
        Line2D([], [], linestyle="none", marker=_text_marker(str(mark.number)), color="0.35", label=leg.name)
        for mark, leg in zip(leg_marks(plan), plan.legs, strict=False)
    ]


def _text_marker(text: str) -> Path:
    """Return a marker that shows a text, centred.

    The built-in text markers of Matplotlib, such as `$1$`, look the same but require the slow mathtext parser.
    """
    path = TextPath((0.0, 0.0), text)
    return Path(path.vertices - path.get_extents().get_points().mean(axis=0), path.codes)


def shade_legs(axes: Axes, plan: Plan, last_time: float, *, height: float | None = None) -> None:
    """Write the number of each leg into a plot over time, and shade every second leg.

    Args:
        axes: axes with the time in s.
        plan: plan with the legs.
        last_time: last time that the axes show, s.
        height: height of the numbers relative to the height of the axes; None to write them above the axes.
    """
    for number, (start, end) in enumerate(_legs(plan), start=1):
        if start >= last_time:
            break
        if number % 2 == 0:
            axes.axvspan(start, min(end, last_time), color="0.95", zorder=0, linewidth=0)
        middle = 0.5 * (start + min(end, last_time))
        position, offset = (middle, 1.0 if height is None else height), 4.0 if height is None else 0.0
        axes.annotate(
            str(number),
            position,
            (0.0, offset),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            color="0.4",
            bbox=TEXT_BACKGROUND,
        )


def _legs(plan: Plan) -> list[tuple[float, float]]:
    """Return start and end of each leg, s; an empty list for a plan with a single leg."""
    ends = [*plan.leg_times, float(plan.path.times[-1])]
    return list(itertools.pairwise(ends)) if len(ends) > 2 else []
