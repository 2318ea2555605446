"""Position and attitude controllers of the scenario language."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from drake_quad.control.integral import Integration
from drake_quad.geometry.flatness import EulerSequence
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import (
    Gains,
    Number,
    PlainPositive,
    PlainPositives,
    PlainSpans,
    Positive,
    Positives,
    Span,
    Spans,
    Tilt,
    bounded,
)

_INTEGRATION = (
    "whether the command of a tick has the integral of the errors before it (forward_euler), or with its own"
    " (backward_euler)"
)


class PdPosition(Model):
    """PD on the position error, eq (8)."""

    kind: Literal["pd"]
    k_p: Gains = Field(description="k_P on X, Y, Z (1/s²)")
    k_d: Gains = Field(description="k_D on X, Y, Z (1/s)")
    derivative: Literal["tracking_error", "measurement"] = Field(
        default="tracking_error", description="what k_D multiplies: v_r - v, or -v"
    )
    feed_forward: Literal["none", "acceleration", "jerk", "snap"] = Field(
        default="none", description="up to which derivative of the reference is fed forward"
    )


class PidPosition(PdPosition):
    """PD with an integral, which is held within a limit against windup."""

    kind: Literal["pid"]  # type: ignore[assignment]
    k_i: Gains = Field(description="k_I on X, Y, Z (1/s³)")
    integral_limit: Positive = Field(
        default=2.0, description="largest acceleration that the integral may ask for (m/s²)"
    )
    integration: Integration = Field(default="forward_euler", description=_INTEGRATION)


class CommandedResponse(Model):
    """The vehicle is believed to follow commanded accelerations."""

    kind: Literal["commanded"]
    delay_ticks: Annotated[int, Field(ge=0, le=50)] = Field(
        default=1, description="whole ticks of the control from a command to what it does (1)"
    )
    lag: Spans = Field(description="time constant of what follows, cameras and their filters included, on X, Y, Z (s)")
    feed_forward_lag: Spans | None = Field(
        default=None,
        description="the same for what is fed forward with its derivatives and so does not wait for the attitude (s);"
        " as `lag` if not given",
    )


class TiltResponse(Model):
    """The thrust is believed to follow its command, and to point where the measured attitude says."""

    kind: Literal["tilt"]
    delay_ticks: Annotated[int, Field(ge=0, le=50)] = Field(
        default=1, description="whole ticks of the control from a commanded thrust to what it does (1)"
    )
    lag: Span = Field(description="time constant of the thrust (s)")


class _EstimatingPosition(PdPosition):
    """PD with an estimate of the disturbance."""

    response: Annotated[CommandedResponse | TiltResponse, Field(discriminator="kind")]
    disturbance_limit: Positive = Field(
        default=5.0, description="largest acceleration on an axis that is held for a disturbance (m/s²)"
    )


class ObserverPosition(_EstimatingPosition):
    """PD with a Kalman filter for the disturbing acceleration, from positions alone."""

    kind: Literal["disturbance_observer"]  # type: ignore[assignment]
    position_noise: PlainPositive = Field(description="standard deviation of the measured position (m)")
    deviation: PlainPositives = Field(description="standard deviation of the disturbance on X, Y, Z (m/s²)")
    time_constant: PlainSpans = Field(
        description="after which the disturbance is another, on X, Y, Z (s); a long one makes a random walk"
    )


class L1Position(_EstimatingPosition):
    """PD with L1 adaptive augmentation, piecewise-constant; the method is the subject of US patent 8,712,559."""

    kind: Literal["l1"]  # type: ignore[assignment]
    adaptation: Positive = Field(default=1.0, description="a_s, decay of the state predictor's error (1/s)")
    bandwidth: Positives = Field(description="ω of the low-pass C(s) = ω / (s + ω) on X, Y, Z (rad/s)")


class IndiPosition(_EstimatingPosition):
    """PD with incremental nonlinear dynamic inversion of the acceleration."""

    kind: Literal["indi"]  # type: ignore[assignment]
    bandwidth: Positives = Field(
        description="ω of the filter ω² / (s² + √2 ω s + ω²) of measured and modelled acceleration on X, Y, Z (rad/s)"
    )


PositionController = Annotated[
    PdPosition | PidPosition | ObserverPosition | L1Position | IndiPosition, Field(discriminator="kind")
]


class PdAttitude(Model):
    """PD on the error of roll, pitch and yaw."""

    kind: Literal["pd"] = Field(default="pd", description="may be left out")
    k_p: Gains = Field(description="on roll, pitch, yaw (1/s²)")
    k_d: Gains = Field(description="on roll, pitch, yaw rate (1/s)")


class GeometricAttitude(PdAttitude):
    """PD on the error of the rotation, without a singularity; thrust is projected on its measured axis.

    `euler_sequence: zxy` and `integration: backward_euler` without the transport term are the Lee controller of the
    Crazyflie's firmware.
    """

    kind: Literal["geometric"]  # type: ignore[assignment]
    k_i: Gains | None = Field(
        default=None,
        description="on the integral of the error of roll, pitch, yaw (1/s³); without integral if not given",
    )
    integral_limit: Positive = Field(
        default=50.0, description="largest angular acceleration that the integral may ask for (rad/s²)"
    )
    integration: Integration = Field(default="forward_euler", description=_INTEGRATION)
    euler_sequence: EulerSequence = Field(
        default="zyx",
        description="what the reference's yaw is of an attitude that leans: with zyx x_B stays in the vertical plane of"
        " the heading, as eq (1) and PX4 have it; with zxy y_B stays perpendicular to the heading, as Lee et al. (2010)"
        " and the Crazyflie's firmware have it",
    )
    transport_term: bool = Field(
        default=True,
        description="whether -Ω̂ Rᵀ R_d Ω_d is part of the law, as Lee et al. (2010) have it; the Crazyflie's firmware"
        " leaves it out",
    )


class IndiAttitude(PdAttitude):
    """PD with incremental nonlinear dynamic inversion of the angular acceleration."""

    kind: Literal["indi"]  # type: ignore[assignment]
    delay_ticks: Annotated[int, Field(ge=0, le=50)] = Field(
        default=1, description="whole ticks of the control from a torque to what it does, believed (1)"
    )
    lag: Span = Field(
        description="time constant of the angular acceleration behind the torque: of rotors, cameras, filters (s)"
    )
    bandwidth: Positive = Field(
        description="ω of the filter ω² / (s² + √2 ω s + ω²) of measured and modelled angular acceleration (rad/s)"
    )
    disturbance_limit: Positive = Field(
        default=50.0, description="largest angular acceleration that is held for a disturbance (rad/s²)"
    )


def _attitude_kind(value: Any) -> Any:
    """The kind, of which a PD need not speak; what is no mapping at all is refused as a PD."""
    return value.get("kind", "pd") if isinstance(value, dict) else getattr(value, "kind", "pd")


AttitudeControl = Annotated[
    Annotated[PdAttitude, Tag("pd")]
    | Annotated[GeometricAttitude, Tag("geometric")]
    | Annotated[IndiAttitude, Tag("indi")],
    Discriminator(_attitude_kind),
]


class ThrustVectoring(Model):
    """Limits of what eq (7) may command."""

    max_tilt: Tilt = Field(default=0.6, description="largest angle between thrust and vertical (rad)")
    min_thrust: Annotated[Number, bounded(above=0.0, below=1.0)] = Field(
        default=0.3, description="least vertical thrust, as a share of the weight (1)"
    )
    max_thrust: Annotated[Number, bounded(above=1.0)] = Field(
        default=1.8, description="largest thrust, as a share of the weight (1)"
    )
