"""The signals of the loop: what the rows of each port mean, and in what unit."""

from typing import NamedTuple


class Row(NamedTuple):
    """One row of a port.

    Attributes:
        name: as in a column of a table.
        unit: SI.
    """

    name: str
    unit: str


def _rows(unit: str, *names: str) -> tuple[Row, ...]:
    return tuple(Row(name, unit) for name in names)


_STATE = (
    _rows("m", "x", "y", "z")
    + _rows("rad", "roll", "pitch", "yaw")
    + _rows("m/s", "v_x", "v_y", "v_z")
    + _rows("rad/s", "p", "q", "r")
)
_ACCELERATION = _rows("m/s²", "x", "y", "z")
_WRENCH = _rows("N", "thrust") + _rows("N m", "tau_x", "tau_y", "tau_z")
_ROTORS = _rows("rad/s", "1", "2", "3", "4")

# Signals whose size depends on the network.
_NETWORK_UNITS = {"weights": "m/s²", "covariance_trace": "1/s"}

SIGNALS: dict[str, tuple[Row, ...]] = {
    "state": _STATE,
    "rotor_speed": _ROTORS,
    "rotor_speed_command": _ROTORS,
    "wrench": _WRENCH,
    "shortfall": _WRENCH,
    "wind": _rows("m/s", "x", "y", "z"),
    "measurement": _STATE,
    "reference": (
        _rows("m", "x", "y", "z")
        + _rows("m/s", "v_x", "v_y", "v_z")
        + _rows("m/s²", "a_x", "a_y", "a_z")
        + _rows("rad", "yaw")
        + _rows("rad/s", "yaw_rate")
    ),
    "error": _rows("m", "x", "y", "z"),
    "error_rate": _rows("m/s", "x", "y", "z"),
    "pd": _ACCELERATION,
    "correction": _ACCELERATION,
    "acceleration_command": _ACCELERATION,
    "attitude_command": _rows("rad", "roll", "pitch", "yaw"),
    "crashed": _rows("1", "crashed"),
}


def signal_rows(name: str, size: int) -> tuple[Row, ...]:
    """What the rows of a signal of one vehicle mean.

    The rows of a network are numbered, axis after axis.
    """
    if name in _NETWORK_UNITS:
        return _rows(_NETWORK_UNITS[name], *(str(number) for number in range(1, size + 1)))
    return SIGNALS[name]
