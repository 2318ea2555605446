"""What the rules of a network look at.

`error`, `error_rate` and `disturbance` are e, ė and the estimated d on the axis on which the network acts. `x` to `v_z`
are position and velocity in W, as measured: what is learned over them is a map of the room. `phase` is how much of its
route, or of a lap of it, the vehicle should have flown, from 0 to 1: what is learned over it is a schedule. Where a lap
ends the next one begins, so that its sets stand around a circle.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from drake_quad.framework.elementary import maximum, minimum, nearest, total, where
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import Row, State

InputName = Literal["error", "error_rate", "x", "y", "z", "v_x", "v_y", "v_z", "phase", "disturbance"]

_ROUNDING = 1e-9
_ON_OWN_AXIS = ("error", "error_rate", "disturbance")


def signals_of(inputs: Sequence[InputName]) -> tuple[str, ...]:
    """The signals from which inputs follow, each once."""
    names = [name if name in _ON_OWN_AXIS else "measurement" for name in inputs if name != "phase"]
    return tuple(dict.fromkeys(names))


def input_values(
    axis: Axis, inputs: Sequence[InputName], signals: Mapping[str, Any], time: Row, lap_times: Sequence[float]
) -> list[Row]:
    """The inputs of a network on one of its axes, each in its unit.

    Args:
        axis: of the network.
        inputs: their names.
        signals: those of `signals_of`, by name.
        time: s; of no meaning without the phase.
        lap_times: when the laps begin and the last one ends, s; likewise.
    """
    values = []
    for name in inputs:
        if name == "phase":
            values.append(route_phase(time, lap_times))
        else:
            on_own_axis = name in _ON_OWN_AXIS
            values.append(getattr(signals[name if on_own_axis else "measurement"], axis if on_own_axis else name))
    return values


def moved_on(measurement: State, lead: Row) -> State:
    """What is measured, with the position to which the velocity leads in a time (s)."""
    x, y, z = measurement.x, measurement.y, measurement.z
    v_x, v_y, v_z = measurement.v_x, measurement.v_y, measurement.v_z
    return measurement._replace(x=x + lead * v_x, y=y + lead * v_y, z=z + lead * v_z)


def route_phase(time: Row, lap_times: Sequence[float]) -> Row:
    """The share of the lap that is over at a time (s), from 0 to 1; of several laps each begins at 0.

    Args:
        time: s.
        lap_times: when the laps begin and the last one ends, s.
    """
    laps = [
        minimum(maximum((time - start) * (1.0 / (end - start)), 0.0), 1.0)
        for start, end in itertools.pairwise(lap_times)
    ]
    flown = total(laps)
    if len(laps) == 1:
        return flown
    past = flown - nearest(flown)
    # What is before the end of a lap by rounding only is at the beginning of the next.
    return where(past < -_ROUNDING, past + 1.0, maximum(past, 0.0))
