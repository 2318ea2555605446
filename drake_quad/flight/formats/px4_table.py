"""A flight as a table with the names that PX4's ULog gives its topics.

The names are those of docs.px4.io, "uORB message reference", as in `vehicle_local_position.x`; units are PX4's, and its
axes: world NED, body FRD. Half a turn about x makes W NED and B FRD: our X is north, our Y is west. A quad-x of PX4
counts its rotors front right, back left, front left, back right: ours are 1, 3, 4 and 2.
`timestamp` is in whole microseconds.

| topic | of the flight |
|---|---|
| `vehicle_local_position`, `vehicle_attitude`, `vehicle_angular_velocity` | `measurement` |
| the first two with `_groundtruth`, `vehicle_angular_velocity_groundtruth` | `state` |
| `trajectory_setpoint` | `reference` |
| `vehicle_attitude_setpoint` | `attitude_command`, or that of `attitude_target` |
| `vehicle_rates_setpoint` | `body_rate_command`, or that of `attitude_target` |
| `esc_status` | `rotor_speed`, rpm |
| `actuator_motors` | `throttle_command` |
| `wind` | `wind` |

What a flight has not, the table has not.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.files import write_table
from drake_quad.flight.flight import Flight
from drake_quad.flight.formats.flight_format import FORMATS, FlightFormat
from drake_quad.geometry.quaternion import Quaternion

# By which the rows of a vector are multiplied that is turned by half a turn about x.
_HALF_TURN = (1.0, -1.0, -1.0)
# Of our rotors, from 0 on, in PX4's order.
_ROTORS = (0, 2, 3, 1)
_RPM = 60.0 / (2.0 * math.pi)
_MICROSECONDS = 1e6

_Columns = dict[str, np.ndarray]


def px4_columns(flight: Flight) -> _Columns:
    """Return the columns (ticks,) of the table by name."""
    columns: _Columns = {"timestamp": np.round(_MICROSECONDS * flight.time).astype(np.int64)}
    for name, suffix in (("measurement", ""), ("state", "_groundtruth")):
        columns |= _motion(flight, name, suffix)
    reference = flight.record("reference")
    columns |= _turned("trajectory_setpoint.position[{}]", "012", reference.x, reference.y, reference.z)
    columns |= _turned("trajectory_setpoint.velocity[{}]", "012", reference.v_x, reference.v_y, reference.v_z)
    columns |= _turned("trajectory_setpoint.acceleration[{}]", "012", reference.a_x, reference.a_y, reference.a_z)
    # PX4 defines the yaw of TrajectorySetpoint between -π and π.
    yaw = np.arctan2(-np.sin(reference.yaw), np.cos(reference.yaw))
    columns |= {"trajectory_setpoint.yaw": yaw, "trajectory_setpoint.yawspeed": -reference.yaw_rate}
    for name in ("attitude_target", "attitude_command"):
        if name in flight:
            command = flight.record(name)
            columns |= _attitude("vehicle_attitude_setpoint.q_d", command.roll, command.pitch, command.yaw)
    for name in ("attitude_target", "body_rate_command"):
        if name in flight:
            rates = flight.record(name)
            columns |= _turned("vehicle_rates_setpoint.{}", ("roll", "pitch", "yaw"), rates.p, rates.q, rates.r)
    speeds = [_RPM * flight["rotor_speed"][:, rotor] for rotor in _ROTORS]
    columns |= {f"esc_status.esc[{i}].esc_rpm": speed for i, speed in enumerate(speeds)}
    if "throttle_command" in flight:
        throttles = [flight["throttle_command"][:, rotor] for rotor in _ROTORS]
        columns |= {f"actuator_motors.control[{i}]": throttle for i, throttle in enumerate(throttles)}
    wind = flight.record("wind")
    return columns | {"wind.windspeed_north": wind.x, "wind.windspeed_east": -wind.y}


def save_px4_table(flight: Flight, path: Path | str) -> Path:
    """Write the table as CSV, and return its path; `drake_quad.identification.logs` reads it as it reads a ULog.

    Raises:
        OSError: the file cannot be written.
    """
    return write_table(Path(path), px4_columns(flight))


def _motion(flight: Flight, name: str, suffix: str) -> _Columns:
    state = flight.record(name)
    position = f"vehicle_local_position{suffix}."
    return {
        **_turned(position + "{}", "xyz", state.x, state.y, state.z),
        **_turned(position + "v{}", "xyz", state.v_x, state.v_y, state.v_z),
        **_attitude(f"vehicle_attitude{suffix}.q", state.roll, state.pitch, state.yaw),
        **_turned(f"vehicle_angular_velocity{suffix}." + "xyz[{}]", "012", state.p, state.q, state.r),
    }


def _turned(pattern: str, rows: str | tuple[str, ...], *vector: np.ndarray) -> _Columns:
    """Return the columns of a vector of W in NED, or of B in FRD."""
    return {pattern.format(row): sign * part for row, sign, part in zip(rows, _HALF_TURN, vector, strict=True)}


def _attitude(name: str, *angles: Any) -> _Columns:
    """Return the columns of a quaternion from FRD to NED, for roll, pitch and yaw."""
    turn: Any = Quaternion.of(*angles)
    return {f"{name}[{i}]": part for i, part in enumerate((turn.w, turn.x, -turn.y, -turn.z))}


FORMATS.append(
    FlightFormat("px4", "write the flight also as px4.csv, with the names of PX4's logs", "px4.csv", save_px4_table)
)
