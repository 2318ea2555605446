"""Magnetometer: measurement of the magnetic field along the axes of the body.

    reading = (1 + S) R_WBᵀ B + b + c Σ_i d_i Ω_i² + σ n

with the field B of the earth in W, the symmetric soft-iron matrix S, the hard-iron error b, and standard normal n. The
currents of the motors disturb the field. The current of a motor is proportional to its torque, so the disturbance is a
vector c times the sum of the aerodynamic torques d_i Ω_i² of the rotors.
"""

from typing import Annotated, NamedTuple

import numpy as np

from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.mounting import axes_of
from drake_quad.laboratory.sensors.sensor import SensorLaw
from drake_quad.signals import Number, Quantity, RotorSpeed, Row, State

FieldB = Annotated[Row, Quantity("T", "B")]
FieldW = Annotated[Row, Quantity("T", "W")]


class MagneticField(NamedTuple):
    """Magnetic flux density, or its measurement error."""

    x: FieldB
    y: FieldB
    z: FieldB


class EarthField(NamedTuple):
    """Magnetic flux density of the earth."""

    x: FieldW
    y: FieldW
    z: FieldW

    @classmethod
    def of(cls, *, strength: Row, inclination: Row, declination: Row, north: Row) -> "EarthField":
        """Return the field at a place on the earth; arguments are numbers or arrays.

        Args:
            strength: magnitude of the field, T.
            inclination: angle of the field below the horizontal, rad.
            declination: angle of magnetic north from true north, positive towards east, rad.
            north: direction of true north in W, as the angle from X towards Y, rad.
        """
        horizontal, heading = strength * np.cos(inclination), north - declination
        return cls(horizontal * np.cos(heading), horizontal * np.sin(heading), -strength * np.sin(inclination))


class SoftIron(NamedTuple):
    """Symmetric matrix S of the soft iron."""

    xx: Number
    yy: Number
    zz: Number
    xy: Number
    xz: Number
    yz: Number


class MotorInterference(NamedTuple):
    """Disturbance by the currents of the motors.

    Attributes:
        field: field c per sum of the rotor torques, T/(N m).
        drag_factors: ratio d_i of torque to squared speed of each rotor, N m s².
    """

    field: Vector
    drag_factors: tuple[Row, Row, Row, Row]


class MagnetometerErrors(NamedTuple):
    """Errors that can be switched off; None for an error that is switched off.

    Attributes:
        soft_iron: matrix of the soft iron.
        motor_interference: disturbance by the motors.
    """

    soft_iron: SoftIron | None = None
    motor_interference: MotorInterference | None = None


class MagnetometerParameters(NamedTuple):
    """Field of the earth, and errors of a magnetometer.

    Attributes:
        earth: field of the earth.
        hard_iron: constant error of the readings.
        field_noise: standard deviation of the noise of a reading on each axis.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    earth: EarthField
    hard_iron: MagneticField = MagneticField(0.0, 0.0, 0.0)
    field_noise: Annotated[Row, Quantity("T", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0
    errors: MagnetometerErrors = MagnetometerErrors()


def magnetometer_reading(
    parameters: MagnetometerParameters, noise: MagneticField | None, state: State, rotor_speed: RotorSpeed | None
) -> MagneticField:
    """Return a reading of a magnetometer, with noise unless `noise` is None."""
    errors = parameters.errors
    x, y, z = field = axes_of(state).in_body(Vector(*parameters.earth))
    if errors.soft_iron is not None:
        iron = errors.soft_iron
        field = Vector(
            x + iron.xx * x + iron.xy * y + iron.xz * z,
            y + iron.xy * x + iron.yy * y + iron.yz * z,
            z + iron.xz * x + iron.yz * y + iron.zz * z,
        )
    components = [part + error for part, error in zip(field, parameters.hard_iron, strict=True)]
    if errors.motor_interference is not None and rotor_speed is not None:
        torque: Row = 0.0
        for factor, speed in zip(errors.motor_interference.drag_factors, rotor_speed, strict=True):
            torque = torque + factor * speed * speed
        gains = errors.motor_interference.field
        components = [part + gain * torque for part, gain in zip(components, gains, strict=True)]
    if noise is not None:
        components = [part + parameters.field_noise * number for part, number in zip(components, noise, strict=True)]
    return MagneticField(*components)


MAGNETOMETER = SensorLaw(
    MagneticField, magnetometer_reading, ("state",), errors_that_read=(("motor_interference", "rotor_speed"),)
)
"""Measurement law of a magnetometer."""
