"""Vibration of the rotors, as a setting of inertial sensors."""

from typing import Annotated, Any, ClassVar

from pydantic import Field

from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.vibration import FreeBody, Responses, RotorAngles, Vibration, rotor_forces
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.plausible import Plausible
from drake_quad.scenario.quantities import Direction, NonNegative

# A 20-inch propeller weighs 50 g. Its centre of mass is less than 2 mm from the axis, an unbalance of 1e-4 kg m.
_PLAUSIBLE_UNBALANCE = Plausible("kg m", "g mm", 1e-6, upper=1e-3)
# No known propeller data contain more harmonics, and each harmonic costs computing time.
_MAX_HARMONICS = 8


class VibrationSettings(Model):
    """Vibration that the rotors cause at a sensor: unbalance of each rotor, and periodic thrust."""

    unbalance: Annotated[
        tuple[NonNegative, NonNegative, NonNegative, NonNegative], Field(strict=False), _PLAUSIBLE_UNBALANCE
    ] = Field(
        default=(0.0, 0.0, 0.0, 0.0),
        description="unbalance of rotors 1 to 4: mass times the distance of the centre of mass from the axis (kg m)",
    )
    thrust_harmonics: Annotated[tuple[NonNegative, ...], Field(strict=False, max_length=_MAX_HARMONICS)] = Field(
        default=(),
        description="amplitudes of the thrust of a rotor at 1, 2, ... times its speed, as fractions of its thrust (1)",
    )
    initial_phases: Annotated[tuple[Direction, Direction, Direction, Direction], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0, 0.0), description="phases of rotors 1 to 4 at time 0 (rad)"
    )
    strength_fields: ClassVar = ("unbalance", "thrust_harmonics")

    def of_accelerometer(self, vehicle: Any, position: Vector, period: float) -> Vibration:
        """Return the vibration of an accelerometer.

        Args:
            vehicle: vehicle in `Batch.fleet_scenario`, in which random fields are arrays.
            position: position of the sensor relative to the centre of mass, m.
            period: time between readings, s.
        """
        body = FreeBody(vehicle.mass, vehicle.inertia)
        return self._vibration(lambda hub, force: body.specific_force(hub, force, position), vehicle, period)

    def of_gyroscope(self, vehicle: Any, period: float) -> Vibration:
        """Return the vibration of a gyroscope; the arguments are as in `of_accelerometer`."""
        return self._vibration(FreeBody(vehicle.mass, vehicle.inertia).angular_acceleration, vehicle, period)

    def _vibration(self, response: Any, vehicle: Any, period: float) -> Vibration:
        """Return the vibration of a sensor.

        Args:
            response: function that returns the response of the sensor, given the position of a rotor hub and a force.
            vehicle: vehicle in `Batch.fleet_scenario`, in which random fields are arrays.
            period: time between readings, s.
        """
        centre_x, centre_y = vehicle.centre_of_mass
        responses = []
        for rotor, unbalance in zip(rotors_of(vehicle), self.unbalance, strict=True):
            hub = Vector(rotor.x - centre_x, rotor.y - centre_y, rotor.z)
            responses.append(Responses._make(response(hub, force) for force in rotor_forces(rotor, unbalance)))
        return Vibration(tuple(responses), self.thrust_harmonics, RotorAngles(*self.initial_phases), period)  # type: ignore[arg-type]
