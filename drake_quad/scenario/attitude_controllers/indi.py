"""Attitude controller with incremental nonlinear dynamic inversion (INDI), in the scenario language."""

from typing import Annotated, Literal

from pydantic import Field

from drake_quad.control.disturbance.laws import IncrementalLaw
from drake_quad.control.incremental_attitude import IncrementalAttitudeController, IncrementalAttitudeParameters
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AttitudeControllerSettings
from drake_quad.scenario.attitude_controllers.pd import PdAttitude
from drake_quad.scenario.plausible import PLAUSIBLE_DELAY, PLAUSIBLE_LAG
from drake_quad.scenario.quantities import Positive, Span
from drake_quad.vehicle.parameters import Inertia


@ATTITUDE_CONTROLLERS.register
class IndiAttitude(AttitudeControllerSettings):
    """PD controller with incremental nonlinear dynamic inversion of the angular acceleration."""

    kind: Literal["indi"]
    delay_ticks: Annotated[int, Field(ge=0, le=50), PLAUSIBLE_DELAY] = Field(
        default=1, description="modelled delay from a torque to its effect, in ticks of the control (1)"
    )
    lag: Annotated[Span, PLAUSIBLE_LAG] = Field(
        description="modelled time constant of the angular acceleration, due to rotors, cameras and filters (s)"
    )
    bandwidth: Positive = Field(
        description="ω of the filter ω² / (s² + √2 ω s + ω²) of measured and modelled angular acceleration (rad/s)"
    )
    disturbance_limit: Positive = Field(
        default=50.0, description="largest estimate of the disturbing angular acceleration (rad/s²)"
    )

    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe to build the controller."""
        law = IncrementalLaw(self.bandwidth)
        parameters = IncrementalAttitudeParameters(self.parameters(inertia), law, self.lag, self.disturbance_limit)
        return Recipe(IncrementalAttitudeController, {"period": period, "delay_ticks": self.delay_ticks}, parameters)

    def without_estimator(self) -> AttitudeControllerSettings:
        """Return the PD controller that remains without the estimate of the angular acceleration."""
        return PdAttitude(k_p=self.k_p, k_d=self.k_d)
