"""Position and attitude controllers of the scenario language."""

import itertools
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.quantities import (
    Gains,
    NonNegative,
    Number,
    PlainPositive,
    PlainPositives,
    PlainSpans,
    Positive,
    Positives,
    Probability,
    Span,
    Spans,
    bounded,
    extremes,
)

Axis = Literal["x", "y", "z"]
Axes = Annotated[tuple[Axis, ...], Field(strict=False, min_length=1)]


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


class FuzzySets(Model):
    """The fuzzy sets of one input of a network."""

    scale: Positive = Field(default=1.0, description="that the input is multiplied with (1/m for e, s/m for its rate)")
    centres: Annotated[tuple[Real, ...], Field(strict=False, min_length=2, max_length=15)] = Field(
        default=(-1.0, 0.0, 1.0), description="c of each set, ascending (1); inputs are clamped to the first and last"
    )
    widths: Annotated[tuple[Positive, ...], Field(strict=False)] = Field(
        default=(1.0, 1.0, 1.0), description="d of each set (1)"
    )

    @field_validator("centres")
    @classmethod
    def _ascending(cls, centres: tuple[float, ...]) -> tuple[float, ...]:
        if any(not low < high for low, high in itertools.pairwise(centres)):
            raise PydanticCustomError("order", "must rise from one to the next")
        return centres

    @model_validator(mode="after")
    def _covered(self) -> "FuzzySets":
        if len(self.widths) != len(self.centres):
            raise self.wrong(
                "widths", kind="widths", demand="must be as many as centres, {count}", count=len(self.centres)
            )
        ends = [(centre, extremes(width)[0]) for centre, width in zip(self.centres, self.widths, strict=True)]
        for i, ((left, reach_right), (right, reach_left)) in enumerate(itertools.pairwise(ends)):
            if reach_right is None or reach_left is None or not left + reach_right > right - reach_left:
                raise self.wrong(
                    "widths",
                    i,
                    kind="cover",
                    demand="must be wide enough that the sets at {left} and {right} overlap,"
                    " or no rule fires in between",
                    left=left,
                    right=right,
                )
        return self


class Triangles(Model):
    """The rules of a type-1 network: their antecedents are triangles."""

    error: FuzzySets = Field(default=FuzzySets(), description="of e")
    rate: FuzzySets = Field(default=FuzzySets(), description="of its rate")


class Ellipses(Triangles):
    """The rules of a type-2 network: their antecedents lie between two ellipses."""

    a1: Annotated[Number, bounded(above=1.0)] = Field(default=1.2, description="exponent of the upper memberships (1)")
    a2: Annotated[Number, bounded(above=0.0, below=1.0)] = Field(
        default=0.8, description="exponent of the lower memberships (1)"
    )
    q: Probability = Field(default=0.5, description="share of the lower memberships in the output (1)")


class _Learning(Model):
    """What all laws have in common."""

    weight_limit: Positive | None = Field(
        default=None, description="largest size of a weight (m/s²); none if not given"
    )
    initial_weight: Number = Field(default=0.0, description="of all rules (m/s²)")
    leakage: NonNegative = Field(default=0.0, description="rate at which the weights decay by themselves (1/s)")


class _SurfaceLearning(_Learning):
    """What the laws have in common that learn from s_p of eq (15)."""

    slope: Positive = Field(default=1.0, description="λ of eq (15) (1/s)")
    deadzone: NonNegative = Field(default=0.0, description="s_p below which nothing is learned (m/s)")


class CovarianceLearning(_SurfaceLearning):
    """The paper's law, eqs (15) to (17), with forgetting and resets as options."""

    kind: Literal["covariance"]
    gain: Positive = Field(default=1.0, description="K_D of eq (16) (1/s)")
    initial_covariance: Positive = Field(default=1.0, description="p₀ of P₀ = p₀ I (1/s)")
    forgetting: Annotated[Number, bounded(above=0.0, most=1.0)] = Field(
        default=1.0, description="factor for a tick (1); with less than 1 the covariance grows back, up to p₀"
    )
    reset: Literal["never", "at_segments"] = Field(
        default="never", description="when the covariance begins anew: never, as in the paper, or with every segment"
    )


class GradientLearning(_SurfaceLearning):
    """Eq (16) with a constant covariance."""

    kind: Literal["gradient"]
    rate: Positive = Field(default=1.0, description="K_D p (1/s²)")


class SignLearning(_Learning):
    """By the sign of the PD's command, with a slope that grows."""

    kind: Literal["sign"]
    rate: Positive = Field(default=1.0, description="γ by which the slope grows (1/s²)")
    initial_slope: NonNegative = Field(default=0.0, description="of the correction at the beginning (m/s³)")
    deadzone: NonNegative = Field(default=0.0, description="command below which nothing is learned (m/s²)")


Learning = Annotated[CovarianceLearning | GradientLearning | SignLearning, Field(discriminator="kind")]


class Type1Position(PdPosition):
    """PD with a type-1 fuzzy neural network that learns in flight."""

    kind: Literal["pd_t1fnn"]  # type: ignore[assignment]
    axes: Axes = Field(default=("x", "y"), description="on which there is a network")
    network: Triangles = Triangles()
    learning: Learning = CovarianceLearning(kind="covariance")


class Type2Position(PdPosition):
    """PD with an interval type-2 fuzzy neural network with elliptic memberships that learns in flight."""

    kind: Literal["pd_t2fnn"]  # type: ignore[assignment]
    axes: Axes = Field(default=("x", "y"), description="on which there is a network")
    network: Ellipses = Ellipses()
    learning: Learning = CovarianceLearning(kind="covariance")


PositionController = Annotated[
    PdPosition | PidPosition | ObserverPosition | L1Position | IndiPosition | Type1Position | Type2Position,
    Field(discriminator="kind"),
]


class PdAttitude(Model):
    """PD on the error of roll, pitch and yaw."""

    kind: Literal["pd"] = Field(default="pd", description="may be left out")
    k_p: Gains = Field(description="on roll, pitch, yaw (1/s²)")
    k_d: Gains = Field(description="on roll, pitch, yaw rate (1/s)")


class GeometricAttitude(PdAttitude):
    """PD on the error of the rotation, which has no singularity; thrust is projected on its measured axis."""

    kind: Literal["geometric"]  # type: ignore[assignment]


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
