"""Model predictive control (MPC) in the scenario language: a regulator with constraints over a horizon."""

import itertools
import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from drake_quad.control.lqg.design import design_regulator
from drake_quad.control.lqg.laws import LqgParameters
from drake_quad.control.mpc import constraints
from drake_quad.control.mpc.constraints import Preview
from drake_quad.control.mpc.system import NO_WALLS, PredictiveProgramme
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import layout_of
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.reference.plan import Plan
from drake_quad.scenario.controls.control import CONTROLS
from drake_quad.scenario.controls.lqg import LqgControl
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.paths import distributions_in, path_keys
from drake_quad.scenario.quantities import FixedPositive
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import Jerk, Reference, Snap

HalfWidths = Annotated[tuple[FixedPositive | None, FixedPositive | None, FixedPositive | None], Field(strict=False)]
Walls = Annotated[tuple[Real | None, Real | None, Real | None], Field(strict=False)]
_NO_WALLS = (None, None, None)


class _Corridor(Model):
    """Base class of corridors, with the fields that both kinds have."""

    weight: FixedPositive = Field(
        default=10.0,
        description="weight ζ of the violation ε of a wall (m) in the cost of a tick, p² + ρ u² + ζ ε²",
    )

    @abstractmethod
    def walls(self) -> constraints.Corridor:
        """Return the walls of the corridor as constraints of the quadratic programme."""


class Tube(_Corridor):
    """Walls on both sides of the reference, which move with it."""

    kind: Literal["tube"]
    half_width: HalfWidths = Field(description="largest error on X, Y, Z (m), or null for no limit")

    def walls(self) -> constraints.Corridor:
        """Return walls on both sides of the reference."""
        upper = _per_axis(self.half_width, math.inf)
        return constraints.Corridor(
            PerAxis(*[-wall for wall in upper]), upper, follows_reference=True, weight=self.weight
        )


class FixedCorridor(_Corridor):
    """Walls at fixed positions in W."""

    kind: Literal["room"]
    lower: Walls = Field(
        default=_NO_WALLS,
        description="lowest allowed X, Y, Z of the position (m), or null for no wall",
    )
    upper: Walls = Field(
        default=_NO_WALLS,
        description="highest allowed X, Y, Z of the position (m), or null for no wall",
    )

    @model_validator(mode="after")
    def _upper_exceeds_lower(self) -> "FixedCorridor":
        for axis, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is not None and high is not None and not low < high:
                raise self.field_error(f"must be larger than lower, {low}", "upper", axis)
        return self

    def walls(self) -> constraints.Corridor:
        """Return the parameters of walls at fixed positions in W."""
        lower, upper = _per_axis(self.lower, -math.inf), _per_axis(self.upper, math.inf)
        return constraints.Corridor(lower, upper, follows_reference=False, weight=self.weight)


def _per_axis(walls: Sequence[float | None], without_wall: float) -> PerAxis:
    return PerAxis(*[without_wall if wall is None else wall for wall in walls])


@CONTROLS.register
class MpcControl(LqgControl):
    """A Kalman filter and a regulator with constraints over a horizon. All vehicles of a fleet share one regulator."""

    kind: Literal["mpc"]  # type: ignore[assignment]
    horizon: Annotated[float, Field(gt=0.0, le=4.0)] = Field(
        default=0.6, description="horizon of the constraints (s), rounded to ticks of the control"
    )
    corridor: Annotated[Tube | FixedCorridor, Field(discriminator="kind")] | None = Field(
        default=None, description="walls as soft constraints on the position; null for none"
    )
    tilt_weight: FixedPositive = Field(
        default=10.0,
        description="weight ζ of the excess ε of the horizontal specific thrust over its value at max_tilt (g), if the"
        " link carries torques",
    )
    takes_perturbation: ClassVar = True
    torque_fields: ClassVar = ("max_snap", "tilt_weight")

    @model_validator(mode="after")
    def _has_no_distributions(self) -> "MpcControl":
        """Raise an error if a field is a distribution, since all vehicles of a fleet share one quadratic programme."""
        for path in distributions_in(self):
            if not path.startswith("network."):
                demand = "must be a number with control.kind mpc, not a distribution"
                raise self.field_error(demand, *path_keys(path))
        return self

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build the regulator, the quadratic programme and, if there is one, the network."""
        (path, regulator), *others = super().recipes(setting).items()
        return {path: regulator, "programme": self._programme(setting, regulator.parameters), **dict(others)}

    def _programme(self, setting: ControlSetting, nominal: LqgParameters) -> Recipe:
        times = self.timing(setting.frame, setting.tick)
        structure = {
            "tick": times.tick,
            "num_ticks": max(1, round(self.horizon / times.tick)),
            "nominal": nominal,
            "lateral": design_regulator(self.lateral.model(), times, self.lateral.command_weight),
            "vertical": design_regulator(self.vertical.model(), times, self.vertical.command_weight),
            "preview": _preview(setting.plan, times.tick),
            "corridor": NO_WALLS if self.corridor is None else self.corridor.walls(),
            "tilt_weight": self.tilt_weight,
        }
        return Recipe(PredictiveProgramme, structure, None)


class _ReferenceSample(NamedTuple):
    """Reference at one time, with its derivatives."""

    reference: Reference
    jerk: Jerk
    snap: Snap


def _preview(plan: Plan, tick: float) -> tuple[Preview, ...]:
    """Return the reference at each tick, from time zero until it stops. The last entry applies to all later ticks."""
    layout = layout_of(_ReferenceSample)
    rows = plan.reference().vector_values(tick * np.arange(-1, math.ceil(plan.rest_time / tick) + 2))
    samples = [layout.build(row) for row in rows.T.tolist()]
    return tuple(
        [Preview(now.reference, now.jerk, now.snap, before.snap) for before, now in itertools.pairwise(samples)]
    )
