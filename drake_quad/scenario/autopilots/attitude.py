"""Autopilot with an attitude loop and a rate loop, in the scenario language."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.framework.recipe import Recipe
from drake_quad.pid.filters import butterworth
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.loop_terms import LoopTerms
from drake_quad.scenario.plausible import PLAUSIBLE_ATTITUDE_NOISE, PLAUSIBLE_MAX_RATES, not_in_degrees_per_second
from drake_quad.scenario.quantities import (
    AngleNoise,
    Gains,
    NonNegative,
    Number,
    Period,
    Position,
    Positive,
    Positives,
    Span,
    any_nonzero,
    bounds,
    field_from_record,
)
from drake_quad.signals import BodyRates, Wrench
from drake_quad.vehicle import autopilot
from drake_quad.vehicle.autopilot import (
    AutopilotParameters,
    Gyroscope,
    LoopAxisTerms,
    LoopGains,
    LoopRules,
    NeglectedDrag,
)
from drake_quad.vehicle.motors import ThrustCurve
from drake_quad.vehicle.parameters import QuadrotorParameters

# Uncalibrated gyroscopes have a bias of up to 20 °/s, or 0.35 rad/s, and less noise.
_PLAUSIBLE_GYROSCOPE_ERROR = not_in_degrees_per_second(upper=0.5)


class NeglectedDragSettings(Model):
    """Drag that the onboard attitude estimator neglects and therefore mistakes for tilt."""

    tilt_per_speed: Number = field_from_record(
        NeglectedDrag, "tilt_per_speed", "tilt error over velocity: drag coefficient over weight"
    )
    time: Span = field_from_record(
        NeglectedDrag, "time", "time constant with which the tilt error follows the velocity"
    )
    strength_fields: ClassVar = ("tilt_per_speed",)


@AUTOPILOTS.register
class AttitudeAutopilotSettings(Autopilot):
    """Attitude loop and rate loop on board. The command link carries thrust, attitude and body rates.

    By default both loops are proportional. With `attitude_terms` and `rate_terms` they can reproduce the loops of PX4
    or of the Crazyflie firmware.
    """

    command: ClassVar = "attitude_target"
    accepts: ClassVar = ("attitude", "rates")
    # The MAVLink message SET_ATTITUDE_TARGET contains body rates, which are computed from the jerk. It does not contain
    # angular accelerations, which would be computed from the snap.
    feeds_forward: ClassVar = ("none", "acceleration", "jerk")
    noise_free: ClassVar = {"gyroscope_noise": 0.0, "attitude_noise": 0.0}
    bias_free: ClassVar = {"gyroscope_bias": (0.0, 0.0, 0.0)}
    loop_gains: ClassVar = ("k_attitude", "k_rate")
    airframe_fields: ClassVar = ("neglected_drag",)
    kind: Literal["attitude"]
    period: Period = Field(  # type: ignore[misc]
        default=0.0025, description="period of both loops (s); the default is that of PX4's parameter IMU_GYRO_RATEMAX"
    )
    k_attitude: Gains = Field(description="gain from the error of roll, pitch, yaw to a body rate (1/s)")
    k_rate: Gains = Field(description="gain from the error of p, q, r to an angular acceleration (1/s)")
    attitude_terms: LoopTerms | None = Field(
        default=None,
        description="optional terms of the attitude loop, whose output is a body rate (rad/s); cannot be combined with"
        " yaw_weight",
    )
    rate_terms: LoopTerms | None = Field(
        default=None,
        description="optional terms of the rate loop, whose output is an angular acceleration (rad/s²)",
    )
    max_rates: Annotated[Positives | None, PLAUSIBLE_MAX_RATES] = Field(
        default=None, description="largest commanded p, q, r (rad/s); no limit if not given"
    )
    yaw_weight: Annotated[Number, bounds(gt=0.0, le=1.0)] | None = Field(
        default=None,
        description="weight of the yaw in the rotation error, as in PX4 (1); if not given, the loop uses the"
        " errors of roll, pitch and yaw",
    )
    gyroscopic_torque: bool = Field(
        default=True, description="whether ω × I ω is added to the torque; PX4 and the Crazyflie firmware omit it"
    )
    gyroscope_bandwidth: Positive | None = Field(
        default=None, description="bandwidth of a Butterworth filter of the gyroscope (rad/s); no filter if not given"
    )
    gyroscope_noise: Annotated[NonNegative, _PLAUSIBLE_GYROSCOPE_ERROR] = Field(
        default=0.0, description="standard deviation of the gyroscope noise in one sample, on each axis (rad/s)"
    )
    gyroscope_bias: Annotated[Position, _PLAUSIBLE_GYROSCOPE_ERROR] = Field(
        default=(0.0, 0.0, 0.0), description="gyroscope bias on x, y, z of B (rad/s)"
    )
    attitude_noise: Annotated[AngleNoise, PLAUSIBLE_ATTITUDE_NOISE] = Field(
        default=0.0, description="standard deviation of the error of roll, pitch and yaw as estimated on board (rad)"
    )
    neglected_drag: NeglectedDragSettings | None = Field(
        default=None, description="drag that the attitude estimator on board neglects; none if not given"
    )

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of the two proportional loops, neglecting the rotor lag."""
        k_attitude, k_rate = (float(gains[0]) for gains in (self.k_attitude, self.k_rate))
        omega = math.sqrt(k_attitude * k_rate)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * k_rate / omega:.4g}"))

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipe to build both loops.

        If only body rates are commanded, the attitude loop has no effect. In MAVLink, this corresponds to a message
        SET_ATTITUDE_TARGET whose type mask tells the autopilot to ignore the attitude.
        """
        structure = {
            "period": self.period,
            "noisy": any_nonzero(settings.gyroscope_noise, self.gyroscope_noise)
            or any_nonzero(settings.attitude_noise, self.attitude_noise),
            "rules": LoopRules(
                self.gyroscopic_torque,
                self.attitude_terms is not None and self.attitude_terms.integrates_first,
                self.rate_terms is not None and self.rate_terms.integrates_first,
            ),
        }
        attitude = self.attitude_terms if follows_attitude else None
        bandwidth: Any = self.gyroscope_bandwidth
        drag: Any = self.neglected_drag
        parameters = AutopilotParameters(
            LoopGains(*self.k_attitude) if follows_attitude else LoopGains(0.0, 0.0, 0.0),
            LoopGains(*self.k_rate),
            nominal.inertia,
            Gyroscope(self.gyroscope_noise, BodyRates(*self.gyroscope_bias)),
            self.attitude_noise,
            Wrench(nominal.mass * nominal.gravity, 0.0, 0.0, 0.0),
            None if attitude is None else LoopAxisTerms(*attitude.terms(self.period)),
            None if self.rate_terms is None else LoopAxisTerms(*self.rate_terms.terms(self.period)),
            None if bandwidth is None else butterworth(bandwidth, self.period),
            None if self.max_rates is None else BodyRates(*self.max_rates),
            self.yaw_weight if follows_attitude else None,
            None if drag is None else NeglectedDrag(drag.tilt_per_speed, drag.time),
        )
        return {"autopilot": Recipe(autopilot.AttitudeAutopilot, structure, parameters)}

    @model_validator(mode="after")
    def _has_one_kind_of_attitude_loop(self) -> "AttitudeAutopilotSettings":
        if self.yaw_weight is not None and self.attitude_terms is not None:
            raise self.field_error(
                "must be left out, since an attitude loop with yaw_weight is proportional", "attitude_terms"
            )
        return self

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the period of the loops is longer than the period of the command link."""
        link = scenario.laboratory.command_link.period
        if not self.period <= link:
            demand = f"must not be longer than the period of the command link, {link} s"
            raise scenario.field_error(demand, "laboratory", "autopilot", "period")
