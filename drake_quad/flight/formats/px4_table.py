"""Export of a flight as a table whose columns are named after PX4's log topics.

Column names such as `vehicle_local_position.x` follow docs.px4.io, "uORB message reference". The units and axes follow
PX4: the world frame is NED and the body frame is FRD. A rotation by π about x converts W to NED and B to FRD, so X of W
points north and Y west. PX4 numbers the rotors of a quad-x in the order front right, back left, front left, back right.
These are rotors 1, 3, 4 and 2 of this package. The unit of `timestamp` is one microsecond.

| topic | signal of the flight |
|---|---|
| `vehicle_local_position`, `vehicle_attitude`, `vehicle_angular_velocity` | `measurement` |
| the first two with `_groundtruth`, `vehicle_angular_velocity_groundtruth` | `state` |
| `trajectory_setpoint` | `reference` |
| `vehicle_attitude_setpoint` | `attitude_command`, or the attitude in `attitude_target` |
| `vehicle_rates_setpoint` | `body_rate_command`, or the body rates in `attitude_target` |
| `esc_status` | `rotor_speed`, rpm |
| `actuator_motors` | `throttle_command` |
| `wind` | `wind` |

The table omits topics whose signal is not part of the flight.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.files import write_table
from drake_quad.flight.flight import Flight
from drake_quad.flight.formats.flight_format import FORMATS, FlightFormat
from drake_quad.geometry.quaternion import Quaternion

# Signs that convert the components of a vector from W to NED, or from B to FRD.
_AXIS_SIGNS = (1.0, -1.0, -1.0)
# Indices of this package's rotors in the order in which PX4 numbers them.
_PX4_ROTOR_ORDER = (0, 2, 3, 1)
_RPM_PER_RAD_S = 60.0 / (2.0 * math.pi)  # revolutions per minute in 1 rad/s
_MICROSECONDS_PER_SECOND = 1e6

_Columns = dict[str, np.ndarray]


def px4_columns(flight: Flight) -> _Columns:
    """Return the (ticks,) columns of the PX4 table of a flight, keyed by name."""
    columns: _Columns = {"timestamp": np.round(_MICROSECONDS_PER_SECOND * flight.time).astype(np.int64)}
    for name, suffix in (("measurement", ""), ("state", "_groundtruth")):
        columns |= _motion_columns(flight, name, suffix)
    reference = flight.record("reference")
    columns |= _vector_columns("trajectory_setpoint.position[{}]", "012", reference.x, reference.y, reference.z)
    columns |= _vector_columns("trajectory_setpoint.velocity[{}]", "012", reference.v_x, reference.v_y, reference.v_z)
    columns |= _vector_columns(
        "trajectory_setpoint.acceleration[{}]", "012", reference.a_x, reference.a_y, reference.a_z
    )
    # PX4 defines the yaw of TrajectorySetpoint between -π and π.
    yaw = np.arctan2(-np.sin(reference.yaw), np.cos(reference.yaw))
    columns |= {"trajectory_setpoint.yaw": yaw, "trajectory_setpoint.yawspeed": -reference.yaw_rate}
    for name in ("attitude_target", "attitude_command"):
        if name in flight:
            command = flight.record(name)
            columns |= _attitude_columns("vehicle_attitude_setpoint.q_d", command.roll, command.pitch, command.yaw)
    for name in ("attitude_target", "body_rate_command"):
        if name in flight:
            rates = flight.record(name)
            columns |= _vector_columns("vehicle_rates_setpoint.{}", ("roll", "pitch", "yaw"), rates.p, rates.q, rates.r)
    speeds = [_RPM_PER_RAD_S * flight["rotor_speed"][:, rotor] for rotor in _PX4_ROTOR_ORDER]
    columns |= {f"esc_status.esc[{i}].esc_rpm": speed for i, speed in enumerate(speeds)}
    if "throttle_command" in flight:
        throttles = [flight["throttle_command"][:, rotor] for rotor in _PX4_ROTOR_ORDER]
        columns |= {f"actuator_motors.control[{i}]": throttle for i, throttle in enumerate(throttles)}
    wind = flight.record("wind")
    return columns | {"wind.windspeed_north": wind.x, "wind.windspeed_east": -wind.y}


def save_px4_table(flight: Flight, path: Path | str) -> Path:
    """Write the table as a CSV file and return its path; `drake_quad.logs` reads the file like a ULog.

    Raises:
        OSError: if the file cannot be written.
    """
    return write_table(Path(path), px4_columns(flight))


def _motion_columns(flight: Flight, name: str, suffix: str) -> _Columns:
    state = flight.record(name)
    position = f"vehicle_local_position{suffix}."
    return {
        **_vector_columns(position + "{}", "xyz", state.x, state.y, state.z),
        **_vector_columns(position + "v{}", "xyz", state.v_x, state.v_y, state.v_z),
        **_attitude_columns(f"vehicle_attitude{suffix}.q", state.roll, state.pitch, state.yaw),
        **_vector_columns(f"vehicle_angular_velocity{suffix}." + "xyz[{}]", "012", state.p, state.q, state.r),
    }


def _vector_columns(pattern: str, rows: str | tuple[str, ...], *vector: np.ndarray) -> _Columns:
    """Return the columns of a vector, converted from W to NED or from B to FRD."""
    return {pattern.format(row): sign * part for row, sign, part in zip(rows, _AXIS_SIGNS, vector, strict=True)}


def _attitude_columns(name: str, *angles: Any) -> _Columns:
    """Return the columns of the quaternion from FRD to NED, given roll, pitch and yaw between B and W, rad."""
    rotation: Any = Quaternion.of(*angles)
    parts = rotation.w, rotation.x, -rotation.y, -rotation.z
    return {f"{name}[{i}]": part for i, part in enumerate(parts)}


FORMATS.append(
    FlightFormat("px4", "also write the flight as px4.csv, with PX4's topic names", "px4.csv", save_px4_table)
)
