"""Autopilot with an attitude loop and a rate loop."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.lqg.chains import Answer
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.scenario.quantities import AngleNoise, Gains, NonNegative, Period, Position, any_nonzero
from drake_quad.signals import BodyRates, Wrench
from drake_quad.vehicle import autopilot
from drake_quad.vehicle.autopilot import AutopilotNumbers, Gyroscope, LoopGains
from drake_quad.vehicle.parameters import QuadrotorParameters


@AUTOPILOTS.member
class AttitudeAutopilotSettings(Autopilot):
    """An attitude and a rate loop on board, as PX4 has them; the link carries thrust, attitude and body rates."""

    command: ClassVar = "attitude_target"
    accepts: ClassVar = ("attitude", "rates")
    # MAVLink's message SET_ATTITUDE_TARGET has body rates, which follow from the jerk, and no angular accelerations.
    feeds_forward: ClassVar = ("none", "acceleration", "jerk")
    noise_free: ClassVar = {"gyroscope_noise": 0.0, "attitude_noise": 0.0}
    bias_free: ClassVar = {"gyroscope_bias": (0.0, 0.0, 0.0)}
    loop_gains: ClassVar = ("k_attitude", "k_rate")
    kind: Literal["attitude"]
    period: Period = Field(  # type: ignore[misc]
        default=0.0025, description="of both loops (s); the 400 Hz of PX4's parameter IMU_GYRO_RATEMAX"
    )
    k_attitude: Gains = Field(description="body rate over the error of roll, pitch, yaw (1/s)")
    k_rate: Gains = Field(description="angular acceleration over the error of the rate of roll, pitch, yaw (1/s)")
    gyroscope_noise: NonNegative = Field(default=0.0, description="standard deviation of a sample on each axis (rad/s)")
    gyroscope_bias: Position = Field(default=(0.0, 0.0, 0.0), description="on x, y, z of B (rad/s)")
    attitude_noise: AngleNoise = Field(
        default=0.0, description="standard deviation of roll, pitch and yaw as they are estimated on board (rad)"
    )

    def answer(self) -> Answer:
        """Return the answer that the loops ask for, which the rotors follow with their lag."""
        k_attitude, k_rate = (float(gains[0]) for gains in (self.k_attitude, self.k_rate))
        omega = math.sqrt(k_attitude * k_rate)
        return Answer(float(f"{omega:.4g}"), float(f"{0.5 * k_rate / omega:.4g}"))

    def recipes(self, believed: QuadrotorParameters, *, written: Any, heeds_attitude: bool) -> dict[str, Recipe]:
        """Return the recipe for both loops.

        Commands of body rates alone have no attitude to follow, as with the type mask of SET_ATTITUDE_TARGET.
        """
        structure = {
            "period": self.period,
            "noisy": any_nonzero(written.gyroscope_noise, self.gyroscope_noise)
            or any_nonzero(written.attitude_noise, self.attitude_noise),
        }
        numbers = AutopilotNumbers(
            LoopGains(*self.k_attitude) if heeds_attitude else LoopGains(0.0, 0.0, 0.0),
            LoopGains(*self.k_rate),
            believed.inertia,
            Gyroscope(self.gyroscope_noise, BodyRates(*self.gyroscope_bias)),
            self.attitude_noise,
            Wrench(believed.mass * believed.gravity, 0.0, 0.0, 0.0),
        )
        return {"autopilot": Recipe(autopilot.AttitudeAutopilot, structure, numbers)}

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the loops are not faster than the link."""
        link = scenario.laboratory.command_link.period
        if not self.period < link:
            demand = f"must be shorter than the period of the command link, {link} s"
            raise scenario.wrong(demand, "laboratory", "autopilot", "period")
