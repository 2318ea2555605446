"""Mixers of Betaflight."""

from drake_quad.errors import InputError
from drake_quad.firmware.motors import PLUS_ANGLE, X_ANGLE, Mixer, Motor
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE

# Directions of rotation that Betaflight calls "props in".
_MIXERS = {
    "QUADX": Mixer(
        (Motor(-135.0, CLOCKWISE), Motor(-45.0, ANTICLOCKWISE), Motor(135.0, ANTICLOCKWISE), Motor(45.0, CLOCKWISE)),
        X_ANGLE,
    ),
    "QUADP": Mixer(
        (Motor(180.0, CLOCKWISE), Motor(-90.0, ANTICLOCKWISE), Motor(90.0, ANTICLOCKWISE), Motor(0.0, CLOCKWISE)),
        PLUS_ANGLE,
    ),
}


def mixer_of(name: str, *, motors_reversed: bool) -> Mixer:
    """Return a mixer of Betaflight.

    Args:
        name: name of the mixer.
        motors_reversed: setting `yaw_motors_reversed`: all motors turn in the opposite direction ("props out").

    Raises:
        InputError: if the mixer is not supported.
    """
    if name not in _MIXERS:
        names = " and ".join(_MIXERS)
        raise InputError(f"laboratory.autopilot.settings: the mixer {name} is not supported; use {names}")
    mixer, factor = _MIXERS[name], -1.0 if motors_reversed else 1.0
    return mixer._replace(motors=tuple([motor._replace(turns=factor * motor.turns) for motor in mixer.motors]))
