"""Autopilots of the scenario language: what flies on board."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import AngleNoise, Gains, NonNegative, Period, Position, Positive

PerAngle = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


# Beside the fields, each kind has the signal that its link carries, and up to which derivative of the reference can be
# fed forward: MAVLink's message SET_ATTITUDE_TARGET has body rates, which follow from the jerk, and no accelerations.


class NoAutopilot(Model):
    """None: attitude is controlled on the ground, and the wrench comes over the link, as in the paper."""

    command: ClassVar[Literal["wrench"]] = "wrench"
    kind: Literal["none"]


class AttitudeAutopilot(Model):
    """An attitude and a rate loop on board, as PX4 has them; the link carries thrust, attitude and body rates."""

    command: ClassVar[Literal["attitude_target"]] = "attitude_target"
    feeds_forward: ClassVar[tuple[str, ...]] = ("none", "acceleration", "jerk")
    kind: Literal["attitude"]
    period: Period = Field(
        default=0.0025, description="of both loops (s); the 400 Hz of PX4's parameter IMU_GYRO_RATEMAX"
    )
    k_attitude: Gains = Field(description="body rate over the error of roll, pitch, yaw (1/s)")
    k_rate: Gains = Field(description="angular acceleration over the error of the rate of roll, pitch, yaw (1/s)")
    gyroscope_noise: NonNegative = Field(default=0.0, description="standard deviation of a sample on each axis (rad/s)")
    gyroscope_bias: Position = Field(default=(0.0, 0.0, 0.0), description="on x, y, z of B (rad/s)")
    attitude_noise: AngleNoise = Field(
        default=0.0, description="standard deviation of roll, pitch and yaw as they are estimated on board (rad)"
    )


class AttitudeResponse(Model):
    """Autopilot and vehicle as a whole: each angle follows its command as a lag of second order, as flights show it."""

    command: ClassVar[Literal["attitude_target"]] = "attitude_target"
    feeds_forward: ClassVar[tuple[str, ...]] = ("none", "acceleration")
    kind: Literal["response"]
    natural_frequency: PerAngle = Field(description="ω_n of roll, pitch, yaw (rad/s)")
    damping: PerAngle = Field(description="ζ of roll, pitch, yaw (1)")


Autopilot = Annotated[NoAutopilot | AttitudeAutopilot | AttitudeResponse, Field(discriminator="kind")]
