"""Cascade of PID loops on position and velocity, in the scenario language."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from pydrake.systems.framework import Diagram

from drake_quad.control.pid_cascade.parameters import (
    AccelerationParameters,
    CascadeParameters,
    CascadeRules,
    PidLoopGains,
    TiltParameters,
)
from drake_quad.control.pid_cascade.system import PidCascade, build_pid_cascade
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import MinThrust, ThrustVectoringSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.loop_terms import LoopTerms
from drake_quad.scenario.quantities import Gains, NonNegative, Period, Positive, Tilt, excludes_zero
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import ForceB

# Largest rounding error in the ratio of two periods, which must be a whole number.
_RATIO_TOLERANCE = 1e-9


class PidLoop(LoopTerms):
    """PID loop on three axes."""

    k_p: Gains = Field(description="proportional gains (unit of the output over unit of the error)")

    def gains(self, period: float) -> PidLoopGains:
        """Return the gains for a loop with the given period, s."""
        return PidLoopGains(PerAxis(*self.k_p), self.terms(period))


class _CommandKind(Model):
    """Quantity that the velocity loop commands, with the limits of the command."""

    kind: str
    has_limits: ClassVar[bool]
    """True if the command itself limits velocity and tilt, so that the velocity loop must not have a limit."""

    min_thrust: MinThrust = Field(default=0.3, description="smallest thrust, relative to the nominal weight (1)")
    max_thrust: Positive = Field(default=1.8, description="largest thrust, relative to the nominal weight (1)")

    @abstractmethod
    def parameters(self, weight: ForceB) -> TiltParameters | AccelerationParameters:
        """Return the parameters of the command, given the nominal weight of the vehicle, N."""


class TiltCommand(_CommandKind):
    """Roll and pitch relative to the heading, limited by `velocity.limit`, as in the Crazyflie firmware."""

    kind: Literal["tilt"]
    has_limits: ClassVar = False
    hover_thrust: Positive = Field(
        default=1.0, description="thrust at zero velocity error, relative to the nominal weight (1)"
    )

    def parameters(self, weight: ForceB) -> TiltParameters:
        """Return the parameters of the command, given the nominal weight of the vehicle, N."""
        return TiltParameters(self.hover_thrust * weight, self.min_thrust * weight, self.max_thrust * weight)


class AccelerationCommand(_CommandKind):
    """Acceleration in W, which is converted to thrust and attitude, as in PX4."""

    kind: Literal["acceleration"]
    has_limits: ClassVar = True
    feed_forward: NonNegative = Field(default=1.0, description="factor on the reference acceleration (1)")
    max_speed: Positive = Field(default=12.0, description="largest commanded horizontal velocity (m/s)")
    max_ascent: Positive = Field(default=3.0, description="largest commanded upward velocity (m/s)")
    max_descent: Positive = Field(default=1.5, description="largest commanded downward velocity (m/s)")
    max_tilt: Tilt = Field(default=0.785, description="largest angle between thrust and the vertical (rad)")
    horizontal_margin: NonNegative = Field(
        default=0.6,
        description="horizontal thrust reserved when the vertical thrust saturates, relative to the nominal weight (1)",
    )
    decouples_vertical: bool = Field(
        default=True, description="whether the tilt is independent of the commanded vertical acceleration"
    )

    def parameters(self, weight: ForceB) -> AccelerationParameters:
        """Return the parameters of the command, given the nominal weight of the vehicle, N."""
        return AccelerationParameters(
            self.feed_forward,
            self.max_speed,
            self.max_ascent,
            self.max_descent,
            np.tan(self.max_tilt),
            self.min_thrust * weight,
            self.max_thrust * weight,
            self.horizontal_margin * weight,
        )


@CONTROLS.register
class PidCascadeControl(Control):
    """PID loops on position and velocity, as in common firmware. Attitude and body rates are controlled on board."""

    kind: Literal["pid_cascade"]
    period: Period | None = Field(
        default=None,
        description="period of the loops (s), a multiple of the period of the command link; by default, the period of"
        " the link",
    )
    position: PidLoop = Field(description="loop from the position error (m) to a velocity (m/s)")
    velocity: PidLoop = Field(
        description="loop from the velocity error (m/s) to an acceleration (m/s²) or, on x and y, to a tilt in rad"
    )
    velocity_feed_forward: NonNegative = Field(default=1.0, description="factor on the reference velocity (1)")
    command: Annotated[TiltCommand | AccelerationCommand, Field(discriminator="kind")]
    network: ClassVar = None

    @model_validator(mode="after")
    def _limits_are_consistent(self) -> "PidCascadeControl":
        if self.command.has_limits:
            if self.velocity.limit is not None:
                raise self.field_error("must be left out, since the command itself is limited", "velocity", "limit")
            if not excludes_zero(self.velocity.k_p[0]):
                raise self.field_error(
                    "must be larger than 0, since the anti-windup divides by it", "velocity", "k_p", 0
                )
            if self.velocity.integrates_first:
                demand = "must be forward_euler, since the integrand is the error after the limits"
                raise self.field_error(demand, "velocity", "integration")
        return self

    def num_ticks(self, tick: float) -> int:
        """Return the number of ticks per loop period, given the tick period (s)."""
        return 1 if self.period is None else round(self.period / tick)

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the autopilot does not control the attitude, or the period is not whole ticks."""
        laboratory = scenario.laboratory
        if not laboratory.autopilot.controls_attitude:
            demand = "must be a kind that controls the attitude, since control of kind pid_cascade commands an attitude"
            raise scenario.field_error(demand, "laboratory", "autopilot", "kind")
        tick = laboratory.command_link.period
        if self.period is not None and abs(self.period / tick - max(1, self.num_ticks(tick))) > _RATIO_TOLERANCE:
            raise scenario.field_error(
                f"must be a multiple of the period of the command link, {tick} s", "control", "period"
            )

    def loop_period(self, tick: float) -> float:
        """Return the period of the loops, s."""
        return self.num_ticks(tick) * tick

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipe from which the position and velocity loops of the cascade are built, keyed by its role.

        Args:
            setting: properties of the scenario on which the recipe depends, such as nominal vehicle and tick period.
        """
        nominal, tick = setting.nominal, setting.tick
        period = self.loop_period(tick)
        command = self.command
        structure = {
            "tick": tick,
            "num_ticks": self.num_ticks(tick),
            "rules": CascadeRules(
                self.position.integrates_first,
                self.velocity.integrates_first,
                not isinstance(command, AccelerationCommand) or command.decouples_vertical,
            ),
        }
        parameters = CascadeParameters(
            self.position.gains(period),
            self.velocity.gains(period),
            self.velocity_feed_forward,
            nominal.mass,
            nominal.gravity,
            command.parameters(nominal.mass * nominal.gravity),
        )
        return {"cascade": Recipe(PidCascade, structure, parameters)}

    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Return the diagram with the cascade."""
        return build_pid_cascade(systems["cascade"])

    def limits(self) -> ThrustVectoringSettings:
        """Return the tilt and thrust limits, with defaults for limits that the control does not have."""
        command = self.command
        limits: dict[str, Any] = {"min_thrust": command.min_thrust, "max_thrust": command.max_thrust}
        if isinstance(command, AccelerationCommand):
            limits["max_tilt"] = command.max_tilt
        elif self.velocity.limit is not None:
            limits["max_tilt"] = self.velocity.limit[0]
        return ThrustVectoringSettings(**limits)
