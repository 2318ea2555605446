"""Stick curves: the rotation rate that Betaflight assigns to the deflection of a stick, and their inverse.

`rate_curve` implements the five kinds of curves of the setting `rates_type`. In angle mode, the angle is proportional
to the rate that the curve gives; the largest angle is `angle_limit`.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

_MAX_RATE = 1998.0  # °/s, largest rate of all curves
_NUM_POINTS = 2001  # points of a tabulated curve: four for each microsecond from the middle to the end of a stick
_HALF_RANGE = 500.0  # µs between the middle and the end of a stick
_MIN_QUOTIENT = 0.01  # lower limit on the denominators of curves that grow towards the end of the stick

_Curve = Callable[[np.ndarray, float, float, float], np.ndarray]


def _actual(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    centre = 10.0 * rate
    return centre * x + max(0.0, 10.0 * super_rate - centre) * x * ((1.0 - expo) * x + expo * x**5)


def _betaflight(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    factor = 0.01 * rate
    factor += 14.54 * max(0.0, factor - 2.0)
    return 200.0 * factor * ((1.0 - expo) * x + expo * x**4) / _growth(x, 0.01 * super_rate)


def _kiss(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    return 2.0 * rate * ((1.0 - expo) * x + expo * x**3) / _growth(x, 0.01 * super_rate)


def _raceflight(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    return 10.0 * rate * x * (1.0 + expo * (x * x - 1.0)) * (1.0 + 0.01 * super_rate * x)


def _quick(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    curve = (1.0 - expo) * x + expo * x**3
    return 2.0 * rate * x / _growth(curve, _quick_growth(rate, super_rate))


def _quick_with_stick_expo(x: np.ndarray, rate: float, super_rate: float, expo: float) -> np.ndarray:
    curve = (1.0 - expo) * x + expo * x**3
    return 2.0 * rate * curve / _growth(x, _quick_growth(rate, super_rate))


def _growth(x: np.ndarray, factor: float) -> np.ndarray:
    return np.clip(1.0 - factor * x, _MIN_QUOTIENT, 1.0)


def _quick_growth(rate: float, super_rate: float) -> float:
    return 1.0 - 2.0 * rate / max(10.0 * super_rate, 2.0 * rate)


_CURVES: dict[str, _Curve] = {
    "ACTUAL": _actual,
    "BETAFLIGHT": _betaflight,
    "KISS": _kiss,
    "RACEFLIGHT": _raceflight,
    "QUICK": _quick,
}


def rate_curve(settings: Mapping[str, str], axis: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from deflections between 0 and 1 to rates in °/s.

    Args:
        settings: values of the settings by name.
        axis: roll, pitch or yaw.
    """
    rate, super_rate, expo = (float(settings[f"{axis}_{name}"]) for name in ("rc_rate", "srate", "expo"))
    kind = settings["rates_type"]
    curve = _CURVES[kind]
    if kind == "QUICK" and settings["quickrates_rc_expo"] == "ON":
        curve = _quick_with_stick_expo
    limit = min(_MAX_RATE, float(settings[f"{axis}_rate_limit"]))
    return lambda x: np.minimum(curve(x, rate, super_rate, 0.01 * expo), limit)


class StickTable(NamedTuple):
    """Tabulated curve of a stick: the pulse width for a commanded rate, relative to the largest rate.

    Attributes:
        fractions: rates relative to the largest rate, from -1 to 1.
        pulses: pulse widths, µs.
        max_rate: largest rate, °/s.
    """

    fractions: np.ndarray
    pulses: np.ndarray
    max_rate: float

    @classmethod
    def of(cls, settings: Mapping[str, str], axis: str) -> "StickTable":
        """Return the table of a stick, given the values of the settings by name."""
        deflections = np.linspace(0.0, 1.0, _NUM_POINTS)
        rates = rate_curve(settings, axis)(deflections)
        deadband = float(settings["yaw_deadband" if axis == "yaw" else "deadband"])
        offsets = deadband + (_HALF_RANGE - deadband) * deflections
        middle, max_rate = float(settings["mid_rc"]), float(rates[-1])
        fractions = rates / max_rate
        return cls(
            np.concatenate([-fractions[:0:-1], fractions]),
            np.concatenate([middle - offsets[:0:-1], [middle], middle + offsets[1:]]),
            max_rate,
        )
