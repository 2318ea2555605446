"""Geometric controller of the attitude."""

from typing import Any, Literal

from pydantic import Field

from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeNumbers,
)
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.flatness import EulerSequence
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AttitudeControllerSettings
from drake_quad.scenario.quantities import Gains, IntegrationRule, Positive
from drake_quad.vehicle.parameters import Inertia


@ATTITUDE_CONTROLLERS.member
class GeometricAttitude(AttitudeControllerSettings):
    """PD on the error of the rotation, without a singularity; thrust is projected on its measured axis.

    `euler_sequence: zxy` and `integration: backward_euler` without the transport term are the Lee controller of the
    Crazyflie's firmware.
    """

    kind: Literal["geometric"]
    k_i: Gains | None = Field(
        default=None,
        description="on the integral of the error of roll, pitch, yaw (1/s³); without integral if not given",
    )
    integral_limit: Positive = Field(
        default=50.0, description="largest angular acceleration that the integral may ask for (rad/s²)"
    )
    integration: IntegrationRule = "forward_euler"
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

    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe for the controller, with its integral if it has one."""
        structure: dict[str, Any] = {"transports": self.transport_term}
        if self.k_i is None:
            return Recipe(GeometricAttitudeController, structure, self.numbers(inertia))
        structure = {"period": period, "integration": self.integration, **structure}
        numbers = IntegratingAttitudeNumbers(self.numbers(inertia), PerAngle(*self.k_i), self.integral_limit)
        return Recipe(IntegratingAttitudeController, structure, numbers)

    def vectoring(self) -> dict[str, Any]:
        """Return that thrust is projected, and the sequence of its angles."""
        return {"projects": True, "sequence": self.euler_sequence}
