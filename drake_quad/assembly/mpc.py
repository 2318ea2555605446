"""Model predictive control of a scenario: what stands beside its linear-quadratic-Gaussian controller."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.lqg import height_model, lateral_model, lqg_timing
from drake_quad.control.axes import PerAxis
from drake_quad.control.lqg.design import regulator_of
from drake_quad.control.lqg.laws import LqgNumbers
from drake_quad.control.mpc.constraints import Corridor, Preview
from drake_quad.control.mpc.system import OPEN, PredictiveProgramme
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import layout_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.mpc import MpcControl, Room, Tube
from drake_quad.signals import Jerk, Reference, Snap


class _Shown(NamedTuple):
    """What the reference shows at an instant."""

    reference: Reference
    jerk: Jerk
    snap: Snap


def mpc_recipes(batch: Batch, plan: Plan, believed: LqgNumbers) -> dict[str, Recipe]:
    """The recipe for the programme of a model predictive controller, by its path; none if the control is another.

    Args:
        batch: that is flown.
        plan: that is flown.
        believed: numbers of its regulator.
    """
    control = batch.scenario.control
    if not isinstance(control, MpcControl):
        return {}
    times = lqg_timing(batch.scenario)
    structure = {
        "tick": times.tick,
        "num_ticks": max(1, round(control.horizon / times.tick)),
        "believed": believed,
        "lateral": regulator_of(lateral_model(control.lateral), times, control.lateral.command_weight),
        "vertical": regulator_of(height_model(control.vertical), times, control.vertical.command_weight),
        "preview": _preview(plan, times.tick),
        "corridor": _corridor(control.corridor),
        "tilt_weight": control.tilt_weight,
    }
    return {"programme": Recipe(PredictiveProgramme, structure, None)}


def _preview(plan: Plan, tick: float) -> tuple[Preview, ...]:
    """Return the reference at each tick from time zero until it rests; the last entry also holds after that."""
    layout = layout_of(_Shown)
    rows = plan.reference().vector_values(tick * np.arange(-1, math.ceil(plan.rest_time / tick) + 2))
    shown = [layout.build(row) for row in rows.T.tolist()]
    return tuple([Preview(now.reference, now.jerk, now.snap, before.snap) for before, now in itertools.pairwise(shown)])


def _corridor(corridor: Tube | Room | None) -> Corridor:
    match corridor:
        case Tube():
            upper = _walls(corridor.half_width, math.inf)
            return Corridor(PerAxis(*[-wall for wall in upper]), upper, moves=True, weight=corridor.weight)
        case Room():
            return Corridor(
                _walls(corridor.lower, -math.inf), _walls(corridor.upper, math.inf), moves=False, weight=corridor.weight
            )
    return OPEN


def _walls(walls: Sequence[float | None], none: float) -> PerAxis:
    return PerAxis(*[none if wall is None else wall for wall in walls])
