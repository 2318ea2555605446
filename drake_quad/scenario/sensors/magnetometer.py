"""Magnetometer in the scenario language."""

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.estimation.corrections import MagneticAiding
from drake_quad.framework.records import record_like
from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.magnetometer import (
    MAGNETOMETER,
    EarthField,
    MagnetometerErrors,
    MagnetometerParameters,
    MotorInterference,
    SoftIron,
)
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.plausible import Plausible
from drake_quad.scenario.quantities import Direction, NonNegative, Number, Position, Positive, field_from_record
from drake_quad.scenario.sensors.aiding import AidingModel
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings

# The magnetic field of the earth has a magnitude of 22 to 67 µT.
_PLAUSIBLE_FIELD = Plausible("T", "µT", 1e-6, upper=1e-3)
_SixNumbers = Annotated[tuple[Number, Number, Number, Number, Number, Number], Field(strict=False)]


@SENSORS.register
class MagnetometerSettings(SensorSettings):
    """Magnetometer, which measures the magnetic field in body axes B."""

    kind: Literal["magnetometer"]
    strength: Annotated[Positive, _PLAUSIBLE_FIELD] = Field(
        default=5e-5, description="magnitude of the field of the earth (T)"
    )
    inclination: Direction = Field(
        default=math.radians(65.0), description="angle of the field below the horizontal (rad)"
    )
    declination: Direction = Field(
        default=0.0, description="angle of magnetic north from true north, positive towards east (rad)"
    )
    north: Direction = Field(
        default=math.radians(90.0),
        description="direction of true north in W, as the angle from X towards Y (rad); by default, X points east",
    )
    hard_iron: Annotated[Position, _PLAUSIBLE_FIELD] = field_from_record(
        MagnetometerParameters, "hard_iron", "constant error along x, y and z"
    )
    soft_iron: _SixNumbers = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        description="elements xx, yy, zz, xy, xz and yz of a symmetric matrix; the error is this matrix times the"
        " field (1)",
    )
    motor_interference: Position = Field(
        default=(0.0, 0.0, 0.0),
        description="disturbance by the motors along x, y and z, relative to the sum of the rotor torques, to which the"
        " currents are proportional (T/(N m))",
    )
    field_noise: Annotated[NonNegative, _PLAUSIBLE_FIELD] = field_from_record(
        MagnetometerParameters, "field_noise", "standard deviation of a reading on each axis"
    )
    law: ClassVar = MAGNETOMETER
    noise: ClassVar = ("field_noise",)
    aids: ClassVar = AidingModel("magnetic_field", (("field_noise",),))

    def parameters(self, vehicle: Any) -> MagnetometerParameters:
        """Return the magnetometer parameters."""
        settings: Any = self
        first, second, third, fourth = (rotor.drag_factor for rotor in rotors_of(vehicle))
        interference = MotorInterference(Vector(*settings.motor_interference), (first, second, third, fourth))
        errors = MagnetometerErrors(SoftIron(*settings.soft_iron), interference)
        return record_like(MagnetometerParameters, self, earth=self._earth_field(), errors=errors)

    def aiding_parameters(self, deviations: tuple[Any, ...]) -> MagneticAiding:
        """Return the parameters of the measurement equation for the direction of the horizontal field.

        Args:
            deviations: standard deviation of the field on each axis, T.
        """
        field = self._earth_field()
        (deviation,) = deviations
        return MagneticAiding(deviation / np.hypot(field.x, field.y), Vector(*field))

    def _earth_field(self) -> EarthField:
        settings: Any = self
        return EarthField.of(
            strength=settings.strength,
            inclination=settings.inclination,
            declination=settings.declination,
            north=settings.north,
        )
