"""Units of logs, and their conversion to SI units."""

import math
from typing import NamedTuple


class Unit(NamedTuple):
    """Unit of logged values; a value in SI units is (value − zero) · scale.

    Attributes:
        scale: size of the unit in SI units.
        zero: logged value that corresponds to zero.
    """

    scale: float
    zero: float = 0.0


_STANDARD_GRAVITY = 9.80665  # m/s²
_DEGREE = math.pi / 180.0  # rad

UNITS: dict[str, dict[str, Unit]] = {
    "s": {"s": Unit(1.0), "ms": Unit(1e-3), "us": Unit(1e-6), "ns": Unit(1e-9)},
    "m": {"m": Unit(1.0), "cm": Unit(1e-2), "mm": Unit(1e-3)},
    "m/s": {"m/s": Unit(1.0), "cm/s": Unit(1e-2), "mm/s": Unit(1e-3), "km/h": Unit(1.0 / 3.6)},
    "m/s²": {"m/s²": Unit(1.0), "mm/s²": Unit(1e-3), "g": Unit(_STANDARD_GRAVITY)},
    "rad": {"rad": Unit(1.0), "mrad": Unit(1e-3), "deg": Unit(_DEGREE)},
    "rad/s": {
        "rad/s": Unit(1.0),
        "mrad/s": Unit(1e-3),
        "deg/s": Unit(_DEGREE),
        "rpm": Unit(2.0 * math.pi / 60.0),
    },
    # A fraction of the full command may be logged with 16 bits, or as a servo pulse from 1 ms (0) to 2 ms (1).
    "1": {"1": Unit(1.0), "%": Unit(1e-2), "uint16": Unit(1.0 / 65535.0), "servo us": Unit(1e-3, 1000.0)},
    "N": {"N": Unit(1.0), "mN": Unit(1e-3), "gf": Unit(1e-3 * _STANDARD_GRAVITY)},
    "N m": {"N m": Unit(1.0), "mN m": Unit(1e-3)},
    "V": {"V": Unit(1.0), "mV": Unit(1e-3)},
}
"""Units in which a signal may be logged, by its SI unit."""
