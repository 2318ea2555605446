"""PD position controller with L1 adaptive augmentation, in the scenario language."""

from typing import Literal

from pydantic import Field

from drake_quad.control.disturbance.laws import AdaptiveLaw
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.position_controllers.estimating import EstimatingPosition
from drake_quad.scenario.quantities import Positive, Positives


@POSITION_CONTROLLERS.register
class L1Position(EstimatingPosition):
    """PD controller with piecewise-constant L1 adaptive augmentation, a method described in US patent 8,712,559."""

    kind: Literal["l1"]  # type: ignore[assignment]
    adaptation: Positive = Field(default=1.0, description="decay rate a_s of the error of the state predictor (1/s)")
    bandwidth: Positives = Field(description="ω on X, Y, Z of the low-pass filter C(s) = ω / (s + ω) (rad/s)")

    def law(self, axis: int, period: float) -> AdaptiveLaw:
        """Return the adaptive law of an axis."""
        return AdaptiveLaw(self.adaptation, self.bandwidth[axis])
