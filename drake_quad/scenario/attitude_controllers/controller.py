"""Attitude controllers on the ground, and the questions about them that the rest of the library asks.

An attitude controller of your own is a class that extends `AttitudeControllerSettings` and is registered with
`ATTITUDE_CONTROLLERS.member`.
"""

from abc import abstractmethod
from typing import Annotated, Any

from pydantic import Field
from pydantic_core import PydanticCustomError

from drake_quad.control.attitude import AttitudeNumbers
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Gains
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.parameters import Inertia


class AttitudeControllerSettings(Model):
    """Law from a commanded attitude to torques. Numbers that a study draws are (N,) arrays in `recipe` for a fleet."""

    kind: str
    k_p: Gains = Field(description="on roll, pitch, yaw (1/s²)")
    k_d: Gains = Field(description="on roll, pitch, yaw rate (1/s)")

    @abstractmethod
    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe for a system with the ports of an `AttitudeControllerSettings`.

        Args:
            inertia: moments of inertia of the nominal vehicle.
            period: period of the control, s.
        """

    def numbers(self, inertia: Inertia) -> AttitudeNumbers:
        """Return its gains, with the nominal moments of inertia."""
        return AttitudeNumbers(PerAngle(*self.k_p), PerAngle(*self.k_d), *inertia)

    def vectoring(self) -> dict[str, Any]:
        """Return the structure of the `ThrustVectoring` that commands its attitude."""
        return {"projects": False}

    def plain(self) -> "AttitudeControllerSettings":
        """Return the controller without estimates that stands in its place when gains are designed."""
        return self


ATTITUDE_CONTROLLERS = OpenUnion(AttitudeControllerSettings, silent="pd")
"""Kinds of attitude controllers."""

AnyAttitudeController = Annotated[AttitudeControllerSettings, ATTITUDE_CONTROLLERS]


def check_attitude_control(scenario: Any) -> None:
    """Raise a validation error unless attitude is controlled once in a `Scenario`: on the ground or on board."""
    autopilot, attitude = scenario.laboratory.autopilot, scenario.control.attitude
    if attitude is None and not autopilot.controls_attitude:
        raise PydanticCustomError("missing", "is missing", {"path": ("control", "attitude")})
    if attitude is not None and autopilot.controls_attitude:
        demand = f"must be left out, or null: with laboratory.autopilot of kind {autopilot.kind} it is not used"
        raise scenario.wrong(demand, "control", "attitude")
