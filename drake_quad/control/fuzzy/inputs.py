"""Inputs of a network's rules.

`error`, `error_rate` and `disturbance` are e, ė and the estimated d on the axis that the network corrects. `x`, `y`,
`z`, `v_x`, `v_y` and `v_z` are the measured position and velocity in W. With these inputs, a network learns a map of
the disturbance in space. `phase` is the fraction of the route, or of the current lap, that is completed according to
the schedule, from 0 to 1. With this input, a network learns a function of time. Since the laps follow each other, the
sets of `phase` may lie on a circle.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from drake_quad.framework.elementary import maximum, minimum, nearest, total, where
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import Row, State

InputName = Literal["error", "error_rate", "x", "y", "z", "v_x", "v_y", "v_z", "phase", "disturbance"]

# Tolerance on the end of a lap, as a fraction of the lap.
_LAP_TOLERANCE = 1e-9
_SIGNALS_ON_NETWORK_AXIS = ("error", "error_rate", "disturbance")  # inputs with one value for each axis


def input_signals(inputs: Sequence[InputName]) -> tuple[str, ...]:
    """Return the names of the signals that determine the inputs, without duplicates."""
    names = [name if name in _SIGNALS_ON_NETWORK_AXIS else "measurement" for name in inputs if name != "phase"]
    return tuple(dict.fromkeys(names))


def input_values(
    axis: Axis, inputs: Sequence[InputName], signals: Mapping[str, Any], time: Row, lap_times: Sequence[float]
) -> list[Row]:
    """Return the inputs of a network on one of its axes, each in its unit.

    Args:
        axis: axis of the network.
        inputs: names of the inputs.
        signals: signals whose names `input_signals` returns, by name.
        time: time, s; used only by the input `phase`.
        lap_times: start of each lap and end of the last one, s; used only by the input `phase`.
    """
    values = []
    for name in inputs:
        if name == "phase":
            values.append(route_phase(time, lap_times))
        else:
            on_own_axis = name in _SIGNALS_ON_NETWORK_AXIS
            values.append(getattr(signals[name if on_own_axis else "measurement"], axis if on_own_axis else name))
    return values


def extrapolate_position(measurement: State, lead: Row) -> State:
    """Return the measurement with the position extrapolated by the measured velocity over a lead time (s)."""
    x, y, z = measurement.x, measurement.y, measurement.z
    v_x, v_y, v_z = measurement.v_x, measurement.v_y, measurement.v_z
    return measurement._replace(x=x + lead * v_x, y=y + lead * v_y, z=z + lead * v_z)


def route_phase(time: Row, lap_times: Sequence[float]) -> Row:
    """Return the fraction of the current lap that is completed, from 0 to 1.

    Args:
        time: time, s.
        lap_times: start of each lap and end of the last one, s.
    """
    laps = [
        minimum(maximum((time - start) * (1.0 / (end - start)), 0.0), 1.0)
        for start, end in itertools.pairwise(lap_times)
    ]
    completed_laps = total(laps)
    if len(laps) == 1:
        return completed_laps
    past = completed_laps - nearest(completed_laps)
    # A time that is before the end of a lap only because of rounding belongs to the next lap.
    return where(past < -_LAP_TOLERANCE, past + 1.0, maximum(past, 0.0))
