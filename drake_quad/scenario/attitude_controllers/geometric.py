"""Geometric attitude controller, in the scenario language."""

from typing import Annotated, Any, Literal

from pydantic import Field

from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeParameters,
)
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.flatness import EulerSequence
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AttitudeControllerSettings
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.quantities import Gains, IntegrationRule, Positive
from drake_quad.vehicle.parameters import Inertia


@ATTITUDE_CONTROLLERS.register
class GeometricAttitude(AttitudeControllerSettings):
    """PD controller of the rotation matrix error, which has no singularity. Thrust is projected on the measured z_B.

    With `euler_sequence: zxy`, `integration: backward_euler` and no transport term, it is the Lee controller of the
    Crazyflie firmware.
    """

    kind: Literal["geometric"]
    k_i: Gains | None = Field(
        default=None,
        description="integral gains of roll, pitch, yaw (1/s³); no integral if not given",
    )
    integral_limit: Annotated[Positive, needs("k_i")] = Field(
        default=50.0, description="largest angular acceleration that the integral commands on an axis (rad/s²)"
    )
    integration: Annotated[IntegrationRule, needs("k_i")] = "forward_euler"
    euler_sequence: EulerSequence = Field(
        default="zyx",
        description="meaning of the reference's yaw for a tilted attitude: with zyx, x_B is in the vertical plane of"
        " the heading, as in eq (1) and PX4; with zxy, y_B is perpendicular to the heading, as in Lee et al. (2010) and"
        " the Crazyflie firmware",
    )
    transport_term: bool = Field(
        default=True,
        description="whether the law has the term -Ω̂ Rᵀ R_d Ω_d, as in Lee et al. (2010); the Crazyflie firmware"
        " omits it",
    )

    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe to build the controller, including its integral term if it has one."""
        structure: dict[str, Any] = {"transports": self.transport_term}
        if self.k_i is None:
            return Recipe(GeometricAttitudeController, structure, self.parameters(inertia))
        structure = {"period": period, "integration": self.integration, **structure}
        parameters = IntegratingAttitudeParameters(self.parameters(inertia), PerAngle(*self.k_i), self.integral_limit)
        return Recipe(IntegratingAttitudeController, structure, parameters)

    def vectoring(self) -> dict[str, Any]:
        """Return the arguments of a `ThrustVectoring` with projection and with this controller's Euler sequence."""
        return {"projects": True, "sequence": self.euler_sequence}
