"""Model predictive control in the scenario language: a regulator that keeps to limits over a horizon."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.lqg import LqgControl
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.quantities import PlainPositive

HalfWidths = Annotated[tuple[PlainPositive | None, PlainPositive | None, PlainPositive | None], Field(strict=False)]
Walls = Annotated[tuple[Real | None, Real | None, Real | None], Field(strict=False)]
_OPEN = (None, None, None)


class _Corridor(Model):
    """What the walls of a corridor have in common."""

    weight: PlainPositive = Field(
        default=10.0, description="ζ of the cost at a tick, p² + ρ u² + ζ ε², for being ε beyond it (m)"
    )


class Tube(_Corridor):
    """Walls that go along with the reference."""

    kind: Literal["tube"]
    half_width: HalfWidths = Field(description="largest error on X, Y, Z, or null for any (m)")


class Room(_Corridor):
    """Walls that stand in W."""

    kind: Literal["room"]
    lower: Walls = Field(default=_OPEN, description="least X, Y, Z of the position, or null for no wall (m)")
    upper: Walls = Field(default=_OPEN, description="largest X, Y, Z of the position, or null for no wall (m)")

    @model_validator(mode="after")
    def _has_room(self) -> "Room":
        for axis, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is not None and high is not None and not low < high:
                raise self.wrong("upper", axis, kind="walls", demand="must be larger than lower, {low}", low=low)
        return self


class MpcControl(LqgControl):
    """A Kalman filter and a regulator that keeps to its limits over a horizon; the same for all vehicles of a fleet."""

    kind: Literal["mpc"]  # type: ignore[assignment]
    horizon: Annotated[float, Field(gt=0.0, le=4.0)] = Field(
        default=0.6, description="over which limits are kept, rounded to ticks of the control (s)"
    )
    corridor: Annotated[Tube | Room, Field(discriminator="kind")] | None = Field(
        default=None, description="to fly in, as far as disturbances let it; null for none"
    )
    tilt_weight: PlainPositive = Field(
        default=10.0,
        description="ζ of the cost for a specific thrust ε beyond that of max_tilt, with torques over the link (g)",
    )

    @model_validator(mode="after")
    def _is_the_same_for_all(self) -> "MpcControl":
        """The vehicles of a fleet share one programme."""
        for path in distributions_in(self):
            if not path.startswith("network."):
                raise self.wrong(
                    *[int(step) if step.isdecimal() else step for step in path.split(".")],
                    kind="number",
                    demand="must be a number with control.kind mpc, not a distribution",
                )
        return self
