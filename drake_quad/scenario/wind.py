"""Wind of the scenario language: sources that add up."""

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.scenario.distributions import Model
from drake_quad.scenario.limits import SMALLEST
from drake_quad.scenario.quantities import (
    Direction,
    Moment,
    NonNegative,
    Number,
    Position,
    Positive,
    Span,
    bounded,
    excludes_zero,
)


class _Blowing(Model):
    """Air that moves at a velocity, or level at a speed in a heading."""

    velocity: Position | None = Field(default=None, description="of the air at its height, in W (m/s)")
    speed: NonNegative | None = Field(default=None, description="of the air, in place of a velocity (m/s)")
    heading: Direction | None = Field(
        default=None, description="to which it blows, with a speed, from X towards Y (rad)"
    )

    @model_validator(mode="after")
    def _one_motion(self) -> "_Blowing":
        given = [name for name in ("velocity", "speed", "heading") if getattr(self, name) is not None]
        if given not in (["velocity"], ["speed", "heading"]):
            found = " and ".join(given) or "neither"
            raise PydanticCustomError(
                "motion", "must have a velocity, or speed and heading, not {found}", {"found": found}
            )
        return self


class SteadyWind(_Blowing):
    """The same wind everywhere, always."""

    kind: Literal["steady"]


class Gust(_Blowing):
    """A 1-cosine gust: it comes over the rise time, stays, and goes as it came."""

    kind: Literal["gust"]
    start: Moment = Field(description="when it begins (s)")
    rise_time: Span = Field(description="from nothing to full height (s)")
    hold_time: Moment | None = Field(
        default=None, description="at full height (s); for good if not given, as in MIL-F-8785C"
    )


class Sine(_Blowing):
    """A wind that swells and fades as a sine, to both sides."""

    kind: Literal["sine"]
    frequency: Positive = Field(description="angular frequency (rad/s)")
    phase: Direction = Field(default=0.0, description="at time zero (rad)")


class Dryden(Model):
    """Continuous turbulence of MIL-F-8785C at low altitude."""

    kind: Literal["dryden"]
    level: Literal["light", "moderate", "severe"] = Field(
        default="moderate", description="a wind of 15, 30 or 45 knots at 20 feet"
    )
    intensity: NonNegative = Field(default=1.0, description="factor on the level's standard deviations (1)")
    height: Annotated[Number, bounded(least=3.048, most=304.8)] = Field(
        default=6.096, description="at which scales and deviations are taken (m); from 10 to 1000 feet"
    )
    airspeed: Annotated[Number, bounded(least=1.0)] | None = Field(
        default=None,
        description="with which the turbulence goes by (m/s); that of the steady wind, or 1 m/s, if not given",
    )
    heading: Direction | None = Field(
        default=None,
        description="of the longitudinal axis, from X towards Y (rad); that of the steady wind if not given",
    )


class Fan(Model):
    """An industrial fan: a free jet in a room."""

    kind: Literal["fan"]
    position: Position = Field(description="of the middle of its outlet, in W (m)")
    direction: Position = Field(description="in which it blows, in W; of any length")
    flow: NonNegative = Field(description="volume flow (m³/s)")
    diameter: Positive = Field(description="of the outlet (m)")
    turbulence: NonNegative = Field(
        default=0.22, description="standard deviation of the air's velocity over its mean, on each axis (1)"
    )

    @field_validator("direction")
    @classmethod
    def _somewhere(cls, direction: tuple[Number, Number, Number]) -> tuple[Number, Number, Number]:
        if not any(excludes_zero(part) for part in direction):
            raise PydanticCustomError(
                "direction", "must have a part that cannot be zero, nor within {least} of it", {"least": SMALLEST}
            )
        return direction


Wind = Annotated[SteadyWind | Gust | Sine | Dryden | Fan, Field(discriminator="kind")]
