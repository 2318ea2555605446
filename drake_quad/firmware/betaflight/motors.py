"""Assignment of Betaflight's motors to the rotors of a vehicle."""

import math
from collections.abc import Sequence

from drake_quad.errors import InputError
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotor

# Direction (°) from the middle of the vehicle to motors 1 to 4, measured from x_B towards y_B, and their direction of
# rotation seen from above. Betaflight calls these directions of rotation "props in".
_X = ((-135.0, CLOCKWISE), (-45.0, ANTICLOCKWISE), (135.0, ANTICLOCKWISE), (45.0, CLOCKWISE))
_PLUS = ((180.0, CLOCKWISE), (-90.0, ANTICLOCKWISE), (90.0, ANTICLOCKWISE), (0.0, CLOCKWISE))
# Motors of each mixer, and the largest angle (°) between the direction of a motor and that of its rotor. The frame of
# an x may be up to five times as long as wide.
_MIXERS = {"QUADX": (_X, 34.0), "QUADP": (_PLUS, 11.0)}


def motors_of_rotors(rotors: Sequence[Rotor], mixer: str, *, motors_reversed: bool) -> tuple[int, ...]:
    """Return the index of Betaflight's motor for each rotor of a vehicle, counted from 0.

    Args:
        rotors: rotors of the vehicle.
        mixer: name of Betaflight's mixer.
        motors_reversed: setting `yaw_motors_reversed`: all motors turn in the opposite direction ("props out").

    Raises:
        InputError: if the mixer does not fit the rotors.
    """
    if mixer not in _MIXERS:
        names = " and ".join(_MIXERS)
        raise InputError(f"laboratory.autopilot.settings: the mixer {mixer} is not supported; use {names}")
    (motors, max_angle), factor = _MIXERS[mixer], -1.0 if motors_reversed else 1.0
    x, y = (sum(getattr(rotor, axis) for rotor in rotors) / len(rotors) for axis in "xy")
    indices = []
    for number, rotor in enumerate(rotors, 1):
        bearing = math.degrees(math.atan2(rotor.y - y, rotor.x - x))
        angles = [abs((bearing - angle + 180.0) % 360.0 - 180.0) for angle, _ in motors]
        index = angles.index(min(angles))
        if angles[index] > max_angle:
            other = next(name for name in _MIXERS if name != mixer)
            raise InputError(
                f"laboratory.autopilot.settings: the mixer {mixer} does not fit nominal.layout; add the line"
                f" `mixer {other}`"
            )
        if rotor.direction != factor * motors[index][1]:
            value = "OFF" if motors_reversed else "ON"
            raise InputError(
                f"laboratory.autopilot.settings: rotor {number} of nominal.layout turns in the opposite direction to"
                f" motor {index + 1} of Betaflight; add the line `set yaw_motors_reversed = {value}`"
            )
        indices.append(index)
    return tuple(indices)
