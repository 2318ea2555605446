"""Possible faults of logged signals: a wrong sign, unit or frame."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from drake_quad.logs.attitudes import rotation_matrices

GRAVITY = 9.81  # m/s²

_VECTOR = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
AXES = {
    "velocity": _VECTOR,
    "body_rates": _VECTOR,
    "attitude": _ANGLES,
    "specific_force": _VECTOR,
    "position": _VECTOR,
    "reference_velocity": _VECTOR,
    "reference_position": _VECTOR,
    "attitude_command": _ANGLES,
    "body_rate_command": _VECTOR,
}
"""Axis names of each checked signal. If faults of two signals explain a log equally well, the first one is reported."""

_Signals = Mapping[str, np.ndarray]


class Fault(NamedTuple):
    """Possible fault of one signal, or of all signals.

    Attributes:
        signals: names of the faulty signals.
        text: clause that describes the fault, for the end of a remark.
        repaired: function that returns the faulty signals without the fault.
        num_axes: number of axes for which the search for faults penalises this fault.
        is_frame: True if the fault exchanges world and body axes, which hardly differ at small tilts.
    """

    signals: tuple[str, ...]
    text: str
    repaired: Callable[[_Signals], dict[str, np.ndarray]]
    num_axes: int = 3
    is_frame: bool = False


# Descriptions of wrong units, keyed by the factor that corrects the logged values.
_LENGTH_UNITS = {
    1e-3: "millimetres were taken for metres",
    1e-2: "centimetres were taken for metres",
    1e2: "metres were taken for centimetres",
    1e3: "metres were taken for millimetres",
}
_SPEED_UNITS = {**_LENGTH_UNITS, 1.0 / 3.6: "km/h were taken for m/s"}
_ANGLE_UNITS = {
    math.pi / 180.0: "degrees were taken for radians",
    180.0 / math.pi: "radians were taken for degrees",
}
_FORCE_UNITS = {
    GRAVITY: "g were taken for m/s²",
    1.0 / GRAVITY: "m/s² were taken for g",
    1e-3: "mm/s² were taken for m/s²",
}
_WRONG_UNITS = {
    "position": _LENGTH_UNITS,
    "velocity": _SPEED_UNITS,
    "reference_position": _LENGTH_UNITS,
    "reference_velocity": _SPEED_UNITS,
    "attitude": _ANGLE_UNITS,
    "attitude_command": _ANGLE_UNITS,
    "body_rates": _ANGLE_UNITS,
    "body_rate_command": _ANGLE_UNITS,
    "specific_force": _FORCE_UNITS,
}
_HALF_TURN = (1.0, -1.0, -1.0)  # signs of x, y and z after a rotation by 180° about x
# Wrong signs of x, y and z that a log may have.
_WRONG_SIGNS = [
    (-1.0, 1.0, 1.0),
    (1.0, -1.0, 1.0),
    (1.0, 1.0, -1.0),
    _HALF_TURN,
    (-1.0, 1.0, -1.0),
    (-1.0, -1.0, 1.0),
    (-1.0, -1.0, -1.0),
]
_BODY_SIGNALS = ("body_rates", "specific_force", "body_rate_command")
# Faults that swap x and y. The keys are the signs of x, y and z after the swap.
_SWAPS = {
    (1.0, 1.0, -1.0): "NED was taken for ENU, or ENU for NED",
    (1.0, -1.0, 1.0): "ENU was taken for NWU",
    (-1.0, 1.0, 1.0): "NWU was taken for ENU",
    (1.0, 1.0, 1.0): "x and y were swapped",
}
# Signals along the axes of W, which a log usually contains in the same frame.
_WORLD_SIGNALS = ("position", "velocity", "reference_position", "reference_velocity")
# Descriptions of errors of the yaw, keyed by the angle (degrees) that corrects them.
_YAW_OFFSETS = {90.0: "90° too small", -90.0: "90° too large", 180.0: "180° off"}
# For each signal, the wrong frame (body or world) in which a log may contain it.
_WRONG_FRAMES = {
    "body_rates": "world",
    "specific_force": "world",
    "velocity": "body",
}


def faults(signals: _Signals) -> Iterator[Fault]:
    """Yield the possible faults of logged signals, which are given by name."""
    for signal, axes in AXES.items():
        if signal not in signals:
            continue
        for signs in _WRONG_SIGNS:
            wrong = [name for name, sign in zip(axes, signs, strict=True) if sign < 0.0]
            where = "" if len(wrong) == len(axes) else f" in {' and '.join(wrong)}"
            text = f"the sign of {signal} looks wrong{where}"
            if signs == _HALF_TURN:
                text += f", as if it were in {'FRD' if signal in _BODY_SIGNALS else 'NED'}"
            yield Fault((signal,), text, _scaled((signal,), np.array(signs)), len(wrong))
        for factor, description in _WRONG_UNITS[signal].items():
            yield Fault((signal,), f"{signal} looks as if {description}", _scaled((signal,), factor))
        if signal in _WORLD_SIGNALS:
            for signs, description in _SWAPS.items():
                yield Fault((signal,), f"{signal} looks as if {description}", _swapped(signal, np.array(signs)))
        if signal == "attitude":
            for offset, description in _YAW_OFFSETS.items():
                yield Fault((signal,), f"the yaw of {signal} looks {description}", _offset(signal, offset), 1)
    yield from _common_faults(signals)


def _common_faults(signals: _Signals) -> Iterator[Fault]:
    """Yield the possible faults whose repair needs the attitude, or changes several signals."""
    groups = [tuple(name for name in group if name in signals) for group in (_WORLD_SIGNALS[:2], _WORLD_SIGNALS)]
    for known in dict.fromkeys(group for group in groups if len(group) > 1):
        text = f"{' and '.join(known)} look as if NED were taken for NWU"
        yield Fault(known, text, _scaled(known, np.array(_HALF_TURN)), 2)
    known = tuple(name for name in AXES if name in signals)
    text = "the samples look as if they were in reverse order"
    yield Fault(known, text, lambda logged: {name: logged[name][::-1] for name in known}, 3)
    if "attitude" not in signals:
        return
    text = "all signals look as if NED and FRD were taken for NWU and FLU"
    yield Fault(known, text, _scaled(known, np.array(_HALF_TURN)), 2)
    for signal, frame in _WRONG_FRAMES.items():
        if signal in signals:
            text = f"{signal} looks as if it were along {frame} axes"
            yield Fault((signal,), text, _turned(signal, frame), 0, is_frame=True)


def _scaled(names: tuple[str, ...], factor: np.ndarray | float) -> Callable[[_Signals], dict[str, np.ndarray]]:
    return lambda signals: {name: signals[name] * factor for name in names}


def _swapped(signal: str, signs: np.ndarray) -> Callable[[_Signals], dict[str, np.ndarray]]:
    return lambda signals: {signal: signals[signal][:, [1, 0, 2]] * signs}


def _offset(signal: str, turn: float) -> Callable[[_Signals], dict[str, np.ndarray]]:
    return lambda signals: {signal: signals[signal] + np.array([0.0, 0.0, math.radians(turn)])}


def _turned(signal: str, frame: str) -> Callable[[_Signals], dict[str, np.ndarray]]:
    """Return a function that turns a signal from the given wrong frame, world or body, to the other frame."""
    return lambda signals: {
        signal: rotation_matrices(signals["attitude"]).apply(signals[signal], inverse=frame == "world"),
    }
