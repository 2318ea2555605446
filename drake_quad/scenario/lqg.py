"""Linear-quadratic-Gaussian control in the scenario language: what it believes, and what it weighs."""

from typing import Annotated, Literal

from pydantic import Field

from drake_quad.scenario.distributions import Model
from drake_quad.scenario.networks import Network
from drake_quad.scenario.quantities import (
    NonNegative,
    Number,
    PlainAngleNoise,
    PlainNonNegative,
    PlainPositive,
    PlainSpan,
    Tilt,
    bounded,
)

BelievedDelay = Annotated[int, Field(ge=0, le=20)]


class ColouredNoise(Model):
    """White noise behind a lag, 1 / (1 + T s) for first order and the critically damped 1 / (1 + T s)² for second."""

    deviation: PlainPositive = Field(description="standard deviation, in the unit of what it is")
    time: PlainSpan = Field(description="T of the lag (s)")


class Axis(Model):
    """Fields of all axes."""

    first: ColouredNoise = Field(description="disturbing acceleration, noise behind a lag of first order (m/s²)")
    second: ColouredNoise = Field(
        description="disturbing acceleration, noise behind a critically damped lag of second order (m/s²)"
    )
    command_noise: PlainNonNegative = Field(
        default=0.0,
        description="spectral density of white noise on the command, against a model that is wrong (its unit √s)",
    )
    position_noise: PlainPositive = Field(description="standard deviation in a frame (m)")
    command_weight: PlainPositive = Field(
        description="ρ of the cost, the sum of p² + ρ u² with the command u in m/s² or, torques over the link, m/s⁴"
    )


class VerticalAxis(Axis):
    """What the controller believes of the way from its command to the height, and what it weighs."""

    lag: PlainSpan = Field(description="of the thrust behind its command (s)")


class LateralAxis(Axis):
    """What the controller believes of the way from its command to x and to y, and what it weighs."""

    lag: PlainSpan | None = Field(
        default=None,
        description="of the rotors (s); needed without an autopilot, with one none if its answer has it already",
    )
    natural_frequency: PlainPositive | None = Field(
        default=None, description="ω of the attitude's answer (rad/s); needed with an autopilot"
    )
    damping: PlainPositive | None = Field(
        default=None, description="ζ of the attitude's answer (1); needed with an autopilot"
    )
    bias: ColouredNoise = Field(description="of what turns the vehicle, noise behind a lag of first order (m/s⁴)")
    attitude_noise: PlainAngleNoise = Field(description="standard deviation in a frame (rad)")


class YawPd(Model):
    """PD on the yaw."""

    k_p: NonNegative = Field(description="on the yaw (1/s²)")
    k_d: NonNegative = Field(description="on its rate (1/s)")


class LqgControl(Model):
    """A Kalman filter and a linear-quadratic regulator in place of the whole cascade; it believes in `nominal`."""

    kind: Literal["lqg"]
    delay_ticks: BelievedDelay = Field(description="believed, from a tick to when its command acts")
    lateral: LateralAxis
    vertical: VerticalAxis
    network: Network | None = Field(default=None, description="around the controller, if any")
    yaw: YawPd | None = Field(
        default=None, description="needed without an autopilot, and to be left out, or null, with one"
    )
    max_tilt: Tilt = Field(
        default=0.6, description="whose horizontal acceleration in hover is the largest commanded (rad)"
    )
    min_thrust: Annotated[Number, bounded(above=0.0, below=1.0)] = Field(
        default=0.3, description="least vertical thrust, as a share of the weight (1)"
    )
    max_thrust: Annotated[Number, bounded(above=1.0)] = Field(
        default=1.8, description="largest thrust, as a share of the weight (1)"
    )
    max_snap: PlainPositive = Field(
        default=400.0, description="largest command along x and along y with torques over the link (m/s⁴)"
    )
