"""Motion capture of the scenario language."""

from typing import Annotated, Any

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import record_like
from drake_quad.laboratory import motion_capture
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import (
    AngleNoise,
    Misalignment,
    NonNegative,
    Period,
    Positive,
    Probability,
    Share,
    Span,
    Ticks,
    any_nonzero,
    largest_ticks,
)


class MotionCapture(Model):
    """Cameras that see position and attitude; without imperfections they see velocity and body rates too."""

    period: Period = Field(default=0.01, description="time between frames (s); the paper's 100 Hz")
    position_noise: NonNegative = Field(default=0.0, description="standard deviation on each axis (m)")
    attitude_noise: AngleNoise = Field(default=0.0, description="standard deviation of roll, pitch and yaw (rad)")
    misalignment: Misalignment = Field(
        default=(0.0, 0.0, 0.0), description="roll, pitch and yaw of the frame of the markers in B (rad)"
    )
    derivative_bandwidth: Positive | None = Field(
        default=None,
        description="of the filters that make velocity and body rates (rad/s); if not given they are seen exactly",
    )
    velocity_error: Annotated[tuple[Share, Share, Share], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0), description="by which velocity along X, Y, Z is seen too large, as a share of it (1)"
    )
    velocity_drift: Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0),
        description="standard deviation of a slowly changing error of velocity along X, Y, Z (m/s)",
    )
    drift_time: Span = Field(default=1.0, description="correlation time of the drift (s)")
    dropout_rate: Probability = Field(default=0.0, description="share of the frames that are lost (1)")
    latency_frames: Ticks = Field(default=0, description="whole frames from exposure to arrival")

    def recipe(self, fleet: Any) -> Recipe:
        """Return the recipe for the cameras of a fleet.

        Args:
            fleet: the cameras in a `Batch.fleet_scenario`.
        """

        def any_of(*names: str) -> bool:
            return any(any_nonzero(getattr(self, name), getattr(fleet, name)) for name in names)

        structure = {
            "period": self.period,
            "noisy": any_of("position_noise", "attitude_noise"),
            "loses_frames": any_of("dropout_rate"),
            "misaligned": any_of("misalignment"),
            "mistaken": any_of("velocity_error"),
            "filtered": fleet.derivative_bandwidth is not None,
            "drifts": any_of("velocity_drift"),
            "longest_latency": largest_ticks(self.latency_frames, fleet.latency_frames),
        }
        return Recipe(motion_capture.MotionCapture, structure, record_like(motion_capture.CameraNumbers, fleet))
