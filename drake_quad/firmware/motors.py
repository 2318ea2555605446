"""Assignment of the motors of a firmware to the rotors of a vehicle."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from drake_quad.errors import InputError
from drake_quad.firmware.controller import FirmwareError
from drake_quad.vehicle.rotors import Rotor


class Motor(NamedTuple):
    """Motor of a mixer.

    Attributes:
        bearing: direction from the middle of the vehicle to the motor, measured from x_B towards y_B, in degrees.
        turns: direction of rotation seen from above, 1 for anticlockwise and -1 for clockwise.
    """

    bearing: float
    turns: float


class Mixer(NamedTuple):
    """Motors of a firmware, in the order of its numbers.

    Attributes:
        motors: motors 1 to 4.
        max_angle: largest angle between the directions of a motor and its rotor, in degrees.
    """

    motors: tuple[Motor, ...]
    max_angle: float


_MAX_OVERSHOOT = 1e-6  # largest motor command beyond 0 or 1, from rounding
X_ANGLE = 34.0
"""Largest angle of an x, in degrees; the frame may be five times as long as wide, or as wide as long."""
PLUS_ANGLE = 11.0
"""Largest angle of a plus, in degrees."""


def motors_of_rotors(rotors: Sequence[Rotor], mixer: Mixer, *, shape_advice: str, turns_advice: str) -> tuple[int, ...]:
    """Return the index of the firmware's motor for each rotor of a vehicle, counted from 0.

    Args:
        rotors: rotors of the vehicle.
        mixer: motors of the firmware.
        shape_advice: advice if the positions do not fit, for the error message.
        turns_advice: advice if the directions of rotation do not fit, for the error message.

    Raises:
        InputError: if the mixer does not fit the rotors.
    """
    x, y = (sum(getattr(rotor, axis) for rotor in rotors) / len(rotors) for axis in "xy")
    indices = []
    for number, rotor in enumerate(rotors, 1):
        bearing = math.degrees(math.atan2(rotor.y - y, rotor.x - x))
        angles = [abs((bearing - motor.bearing + 180.0) % 360.0 - 180.0) for motor in mixer.motors]
        index = angles.index(min(angles))
        if angles[index] > mixer.max_angle:
            raise InputError(f"the positions of the motors of the firmware do not fit nominal.layout; {shape_advice}")
        if rotor.direction != mixer.motors[index].turns:
            raise InputError(
                f"rotor {number} of nominal.layout turns in the opposite direction to the firmware's motor {index + 1};"
                f" {turns_advice}"
            )
        indices.append(index)
    return tuple(indices)


def rotor_commands(commands: Sequence[float], motors: Sequence[int], scale: float) -> tuple[float, ...]:
    """Return the commands of the rotors of a vehicle.

    Args:
        commands: commands of the firmware's motors, from 0 to 1.
        motors: index of the motor of each rotor; see `motors_of_rotors`.
        scale: factor from a motor command to the result.

    Raises:
        FirmwareError: if a command is not between 0 and 1.
    """
    if not (min(commands) >= -_MAX_OVERSHOOT and max(commands) <= 1.0 + _MAX_OVERSHOOT):
        raise FirmwareError(f"the motor commands of the firmware are {commands}, which are not between 0 and 1")
    return tuple([scale * commands[motor] for motor in motors])
