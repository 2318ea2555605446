"""Motion capture in the scenario language."""

from typing import Annotated, Any, ClassVar

from pydantic import Field

from drake_quad.estimation.corrections import AttitudeAiding, PoseAiding, PositionAiding
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import record_like
from drake_quad.laboratory import motion_capture
from drake_quad.laboratory.motion_capture import CameraParameters
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.plausible import (
    PLAUSIBLE_ATTITUDE_NOISE,
    PLAUSIBLE_POSITION_NOISE,
    PLAUSIBLE_RELATIVE_ERROR,
    not_in_degrees,
)
from drake_quad.scenario.quantities import (
    AngleNoise,
    Misalignment,
    NonNegative,
    Period,
    Positive,
    Probability,
    RelativeError,
    Span,
    Ticks,
    any_nonzero,
    can_differ_from_zero,
    field_from_record,
    max_ticks,
)
from drake_quad.scenario.sensors.aiding import AidingModel, AidingSensor

# Markers that are aligned by eye are accurate to within 20°, or 0.35 rad.
_PLAUSIBLE_MISALIGNMENT = not_in_degrees(upper=0.35)


class MotionCaptureSettings(AidingSensor, Model):
    """Cameras that measure position and attitude. Velocity and body rates are measured or differentiated."""

    period: Period = Field(default=0.01, description="time between camera frames (s); the default is the paper's")
    position_noise: Annotated[NonNegative, PLAUSIBLE_POSITION_NOISE] = field_from_record(
        CameraParameters, "position_noise", "standard deviation of each coordinate"
    )
    attitude_noise: Annotated[AngleNoise, PLAUSIBLE_ATTITUDE_NOISE] = field_from_record(
        CameraParameters, "attitude_noise", "standard deviation of roll, pitch and yaw"
    )
    misalignment: Annotated[Misalignment, _PLAUSIBLE_MISALIGNMENT] = field_from_record(
        CameraParameters, "misalignment", "roll, pitch and yaw of the marker axes in B"
    )
    derivative_bandwidth: Positive | None = field_from_record(
        CameraParameters,
        "derivative_bandwidth",
        "bandwidth of the filters that compute velocity and body rates",
        rule="; if not given, velocity and body rates are measured exactly",
    )
    velocity_error: Annotated[
        tuple[RelativeError, RelativeError, RelativeError], Field(strict=False), PLAUSIBLE_RELATIVE_ERROR
    ] = field_from_record(CameraParameters, "velocity_error", "relative error of the velocity along X, Y, Z")
    velocity_drift: Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)] = field_from_record(
        CameraParameters, "velocity_drift", "standard deviation of a slowly varying error of the velocity along X, Y, Z"
    )
    drift_time: Annotated[Span, needs("velocity_drift")] = field_from_record(
        CameraParameters, "drift_time", "correlation time of velocity_drift"
    )
    dropout_rate: Probability = field_from_record(CameraParameters, "dropout_rate", "fraction of frames that are lost")
    latency_frames: Ticks = Field(default=0, description="delay from exposure to arrival, in whole frame periods")

    aids: ClassVar = AidingModel("pose", (("position_noise",), ("attitude_noise",)))
    position: ClassVar = (0.0, 0.0, 0.0)

    @property
    def can_miss(self) -> bool:
        """True if camera frames can be lost."""
        return can_differ_from_zero(self.dropout_rate)

    @property
    def latency(self) -> Any:
        """Delay from the exposure of a camera frame to its arrival, in whole frame periods."""
        return self.latency_frames

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> PoseAiding:
        """Return the parameters of the measurement equation for position and attitude.

        Args:
            deviations: standard deviations of each coordinate (m) and each angle (rad).
        """
        position, attitude = deviations
        return PoseAiding(PositionAiding(position, position, position), AttitudeAiding(attitude))

    def recipe(self, fleet: Any, *, reports_losses: bool = False) -> Recipe:
        """Return the recipe to build the cameras of a fleet.

        Args:
            fleet: cameras in `Batch.fleet_scenario`, in which random fields are arrays.
            reports_losses: True to add an output port with the validity of the frames.
        """

        def any_of(*names: str) -> bool:
            return any(any_nonzero(getattr(self, name), getattr(fleet, name)) for name in names)

        structure = {
            "period": self.period,
            "noisy": any_of("position_noise", "attitude_noise"),
            "loses_frames": any_of("dropout_rate"),
            "reports_losses": reports_losses,
            "misaligned": any_of("misalignment"),
            "velocity_scaled": any_of("velocity_error"),
            "filtered": fleet.derivative_bandwidth is not None,
            "drifts": any_of("velocity_drift"),
            "longest_latency": max_ticks(self.latency_frames, fleet.latency_frames),
        }
        return Recipe(motion_capture.MotionCapture, structure, record_like(CameraParameters, fleet))
