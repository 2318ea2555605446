"""Base class of attitude controllers that run on the ground, and their registry `ATTITUDE_CONTROLLERS`.

To add an attitude controller, extend `AttitudeControllerSettings` and register the class with
`ATTITUDE_CONTROLLERS.register`.
"""

from abc import abstractmethod
from typing import Annotated, Any

from pydantic import Field
from pydantic_core import PydanticCustomError

from drake_quad.control.attitude import AttitudeParameters
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Gains
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.parameters import Inertia


class AttitudeControllerSettings(Model):
    """Control law from a commanded attitude to torques. For a fleet, randomly drawn values are (N,) arrays."""

    kind: str
    k_p: Gains = Field(description="proportional gains of roll, pitch, yaw (1/s²)")
    k_d: Gains = Field(description="gains of the rates of roll, pitch, yaw (1/s)")

    @abstractmethod
    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe to build a system with the ports of an `AttitudeController`.

        Args:
            inertia: moments of inertia of the nominal vehicle.
            period: period of the control, s.
        """

    def parameters(self, inertia: Inertia) -> AttitudeParameters:
        """Return the gains together with the nominal moments of inertia."""
        return AttitudeParameters(PerAngle(*self.k_p), PerAngle(*self.k_d), *inertia)

    def vectoring(self) -> dict[str, Any]:
        """Return the arguments of the `ThrustVectoring` that commands the attitude of this controller."""
        return {"projects": False}

    def without_estimator(self) -> "AttitudeControllerSettings":
        """Return the same controller without its estimator, if it has one. Gain design uses this simpler controller."""
        return self


ATTITUDE_CONTROLLERS = OpenUnion(AttitudeControllerSettings, default_kind="pd")
"""Registry of the kinds of attitude controllers."""

AnyAttitudeController = Annotated[AttitudeControllerSettings, ATTITUDE_CONTROLLERS]


def check_attitude_control(scenario: Any) -> None:
    """Raise a validation error unless the attitude of a `Scenario` is controlled either on the ground or on board."""
    autopilot, attitude = scenario.laboratory.autopilot, scenario.control.attitude
    if attitude is None and not autopilot.controls_attitude:
        raise PydanticCustomError("missing", "is missing", {"path": ("control", "attitude")})
    if attitude is not None and autopilot.controls_attitude:
        demand = f"must be left out, or null, since laboratory.autopilot of kind {autopilot.kind} controls the attitude"
        raise scenario.field_error(demand, "control", "attitude")
