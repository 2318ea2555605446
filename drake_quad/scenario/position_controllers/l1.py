"""PD controller with L1 adaptive augmentation."""

from typing import Literal

from pydantic import Field

from drake_quad.control.disturbance.laws import AdaptiveLaw
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.position_controllers.estimating import EstimatingPosition
from drake_quad.scenario.quantities import Positive, Positives


@POSITION_CONTROLLERS.member
class L1Position(EstimatingPosition):
    """PD with L1 adaptive augmentation, piecewise-constant; the method is the subject of US patent 8,712,559."""

    kind: Literal["l1"]  # type: ignore[assignment]
    adaptation: Positive = Field(default=1.0, description="a_s, decay of the state predictor's error (1/s)")
    bandwidth: Positives = Field(description="ω of the low-pass C(s) = ω / (s + ω) on X, Y, Z (rad/s)")

    def law(self, axis: int, period: float) -> AdaptiveLaw:
        """Return the adaptive law of an axis."""
        return AdaptiveLaw(self.adaptation, self.bandwidth[axis])
