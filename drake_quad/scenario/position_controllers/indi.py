"""PD position controller with incremental nonlinear dynamic inversion (INDI), in the scenario language."""

from typing import Literal

from pydantic import Field

from drake_quad.control.disturbance.laws import IncrementalLaw
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.position_controllers.estimating import EstimatingPosition
from drake_quad.scenario.quantities import Positives


@POSITION_CONTROLLERS.register
class IndiPosition(EstimatingPosition):
    """PD controller with incremental nonlinear dynamic inversion of the acceleration."""

    kind: Literal["indi"]  # type: ignore[assignment]
    bandwidth: Positives = Field(
        description="ω on X, Y, Z of the filter ω² / (s² + √2 ω s + ω²) of measured and modelled acceleration (rad/s)"
    )

    def law(self, axis: int, period: float) -> IncrementalLaw:
        """Return the INDI law of an axis."""
        return IncrementalLaw(self.bandwidth[axis])
