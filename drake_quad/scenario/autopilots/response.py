"""Identified joint response of autopilot and vehicle, in the scenario language."""

from collections.abc import Iterator
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting
from drake_quad.scenario.quantities import Positives
from drake_quad.signals import AngleRate
from drake_quad.vehicle import attitude_response
from drake_quad.vehicle.attitude_response import (
    AttitudeResponseConfig,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.autopilot import ThrustOnly
from drake_quad.vehicle.motors import ThrustCurve
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import QuadrotorConfig

# Fields of a vehicle that affect only its attitude. They have no effect here, since the attitude follows the identified
# response.
_ATTITUDE_FIELDS = ("inertia", "rotor_inertia", "drag_factor", "arm_length", "layout", "centre_of_mass")


@AUTOPILOTS.register
class AttitudeResponseSettings(Autopilot):
    """Second-order response of each angle to its command, identified in flights of the vehicle with its autopilot."""

    period: ClassVar = None
    command: ClassVar = "attitude_target"
    accepts: ClassVar = ("attitude",)
    feeds_forward: ClassVar = ("none", "acceleration")
    models_vehicle: ClassVar = True
    kind: Literal["response"]
    natural_frequency: Positives = Field(description="ω_n of roll, pitch, yaw (rad/s)")
    damping: Positives = Field(description="ζ of roll, pitch, yaw (1)")

    def attitude_response(self) -> SecondOrderResponse:
        """Return the response of the roll angle."""
        return SecondOrderResponse(float(self.natural_frequency[0]), float(self.damping[0]))

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipe to build a system that outputs the thrust; the vehicle model itself tracks the attitude."""
        return {"autopilot": Recipe(ThrustOnly, {}, None)}

    def vehicle_recipe(self, structure: dict[str, Any], config: QuadrotorConfig) -> Recipe:
        """Return the recipe to build a vehicle whose attitude has this response."""
        response = attitude_response.AttitudeResponse(
            NaturalFrequencies(*self.natural_frequency), DampingRatios(*self.damping)
        )
        return Recipe(AttitudeResponseQuadrotor, structure, AttitudeResponseConfig(config, response))

    def fastest_decay(self) -> AngleRate:
        """Return the fastest decay rate of the roll, pitch and yaw responses, 1/s."""
        pairs: Any = zip(self.natural_frequency, self.damping, strict=True)
        return max(float(np.max(w * (d + np.sqrt(np.maximum(d * d - 1.0, 0.0))))) for w, d in pairs)

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the vehicle has an effect that an identified response cannot include."""
        for name in scenario.vehicle.effects_unsupported_by_response():
            demand = "must be left out, since laboratory.autopilot of kind response does not model it"
            raise scenario.field_error(demand, "vehicle", name)

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as an inertia of the vehicle that differs from the nominal one."""
        yield from super().inactive_settings(flight, path)
        vehicle, nominal = flight.scenario.vehicle, flight.scenario.nominal
        for name in _ATTITUDE_FIELDS:
            expected = getattr(nominal, name) if hasattr(nominal, name) else type(vehicle).model_fields[name].default
            if getattr(vehicle, name) != expected:
                yield InactiveSetting(f"vehicle.{name}", f"{path}.kind is {self.kind}")
