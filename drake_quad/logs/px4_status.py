"""Status information in a ULog: vehicle type, estimator resets and faults, failsafes, and pulse ranges of the motors.

The codes of vehicle types are those of MAVLink's MAV_TYPE and of PX4's parameter CA_AIRFRAME.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names

# Topics that contain no signals, only status information.
STATUS_TOPICS = ("vehicle_status", "vehicle_land_detected", "estimator_status")
_QUADROTOR = 2  # value of MAV_TYPE
# Vehicles that are not quadrotors, by value of MAV_TYPE.
_MAV_TYPES = {
    1: "an aeroplane",
    3: "a coaxial helicopter",
    4: "a helicopter",
    7: "an airship",
    8: "a balloon",
    10: "a ground rover",
    11: "a boat",
    12: "a submarine",
    13: "a hexarotor",
    14: "an octorotor",
    15: "a tricopter",
    **dict.fromkeys(range(19, 26), "a VTOL"),
    29: "a dodecarotor",
    35: "a decarotor",
}
# Vehicles that are not multirotors with fixed rotors, by value of CA_AIRFRAME.
_AIRFRAMES = {
    1: "an aeroplane",
    **dict.fromkeys((2, 3, 4), "a VTOL"),
    **dict.fromkeys((5, 6, 13), "a ground rover"),
    7: "a vehicle with motors in all directions",
    8: "a multirotor that tilts its rotors",
    **dict.fromkeys((10, 11, 12), "a helicopter"),
    14: "a spacecraft",
}
# Vehicles that are not multirotors with four rotors, by thousands of SYS_AUTOSTART.
_AIRFRAME_SERIES = {
    2: "an aeroplane",
    **dict.fromkeys((6, 7), "a hexarotor"),
    **dict.fromkeys((8, 9, 12), "an octorotor"),
    11: "a hexarotor",
    13: "a VTOL",
    14: "a tricopter",
    16: "a helicopter",
    50: "a ground rover",
    60: "an underwater vehicle",
}
# Values of `vehicle_status.vehicle_type` other than 0 (unknown) and 1 (rotary wing).
_VEHICLE_TYPES = {2: "an aeroplane", 3: "a ground rover", 4: "an airship"}
_ARMED = 2  # value of `arming_state` of an armed vehicle


class _Reset(NamedTuple):
    """Counter of the estimator's resets of one quantity.

    Attributes:
        topic: name of the topic that contains the counter.
        counter: name of the counter's field.
        quantity: name of the quantity that is reset.
        fields: names of the fields with the components of the last change.
        factor: conversion factor from the norm of these fields to `unit`.
        unit: unit in which the change is reported.
    """

    topic: str
    counter: str
    quantity: str
    fields: tuple[str, ...]
    factor: float
    unit: str


_QUATERNION_VECTOR_PART = ("delta_q_reset[1]", "delta_q_reset[2]", "delta_q_reset[3]")
_RESETS = (
    _Reset("vehicle_local_position", "xy_reset_counter", "position", ("delta_xy[0]", "delta_xy[1]"), 1.0, "m"),
    _Reset("vehicle_local_position", "z_reset_counter", "height", ("delta_z",), 1.0, "m"),
    _Reset("vehicle_local_position", "vxy_reset_counter", "velocity", ("delta_vxy[0]", "delta_vxy[1]"), 1.0, "m/s"),
    _Reset("vehicle_local_position", "vz_reset_counter", "climb", ("delta_vz",), 1.0, "m/s"),
    # For a small rotation, the norm of the vector part of a quaternion is half of the rotation angle.
    _Reset("vehicle_attitude", "quat_reset_counter", "attitude", _QUATERNION_VECTOR_PART, 2.0, "rad"),
)
_MIN_RESET = 0.01  # m, m/s or rad, smallest reported reset; estimators make smaller resets when they start
# Validity flags of `vehicle_local_position`, each with the fields to which it applies.
_VALIDITY_FLAGS = {
    "xy_valid": ("x", "y"),
    "z_valid": ("z",),
    "v_xy_valid": ("vx", "vy"),
    "v_z_valid": ("vz",),
}
_DEFAULT_PULSE_RANGE = 1000.0, 2000.0  # µs, range of motor pulses in PX4 unless its parameters change it
_OUTPUT_GROUPS = ("MAIN", "AUX")  # groups of outputs in the names of PX4's parameters
_MOTOR_FUNCTION = 101  # value of PWM_MAIN_FUNC1 to PWM_MAIN_FUNC16 that assigns motor 1; 102 assigns motor 2
_NUM_MOTORS = 4  # number of motors of a quadrotor
_MICROSECOND = 1e-6  # s

_Parameters = Mapping[str, Any]
_Data = Mapping[str, np.ndarray]


def other_vehicle(parameters: _Parameters, status: _Data | None) -> str:
    """Return the type of the logged vehicle if it is not a quadrotor, and the field that states the type.

    Args:
        parameters: parameters of PX4 in the log.
        status: data of the topic `vehicle_status`; None if it was not logged.

    Returns:
        A phrase; empty if the vehicle is a quadrotor, or if the log does not state its type.
    """
    types = [("the parameter MAV_TYPE", parameters.get("MAV_TYPE"), _MAV_TYPES)]
    types += [("the parameter CA_AIRFRAME", parameters.get("CA_AIRFRAME"), _AIRFRAMES)]
    for field, names in (("system_type", _MAV_TYPES), ("vehicle_type", _VEHICLE_TYPES)):
        values = () if status is None else np.unique(status.get(field, ())).tolist()
        types += [(f"vehicle_status.{field}", value, names) for value in values]
    for where, value, names in types:
        if value in names:
            return f"{names[value]} ({where} is {value})"
    airframe = parameters.get("SYS_AUTOSTART", 0)
    if (name := _AIRFRAME_SERIES.get(int(airframe) // 1000)) is not None:
        return f"{name} (the parameter SYS_AUTOSTART is {airframe})"
    if status is not None and np.any(status.get("is_vtol", 0)):
        return "a VTOL (vehicle_status.is_vtol is 1)"
    rotors = parameters.get("CA_ROTOR_COUNT", 0)
    if rotors not in (0, _NUM_MOTORS):
        return f"a vehicle with {rotors} rotors (the parameter CA_ROTOR_COUNT is {rotors})"
    return ""


def status_remarks(topics: Mapping[str, _Data], start: int) -> Iterator[str]:
    """Yield remarks on resets and faults of the estimator, on failsafes, and on a log that ends in flight.

    Args:
        topics: data of the logged topics, by name.
        start: timestamp that counts as 0 s in the remarks, µs.
    """

    def seconds(data: _Data, row: int) -> float:
        return (int(data["timestamp"][row]) - start) * _MICROSECOND

    for reset in _RESETS:
        data = topics.get(reset.topic, {})
        if not all(field in data for field in (reset.counter, *reset.fields)):
            continue
        rows = 1 + np.flatnonzero(np.diff(data[reset.counter].astype(int)))
        sizes = reset.factor * np.linalg.norm([data[field][rows].astype(float) for field in reset.fields], axis=0)
        rows, sizes = rows[sizes >= _MIN_RESET], sizes[sizes >= _MIN_RESET]
        if len(rows):
            count = "once" if len(rows) == 1 else f"{len(rows)} times"
            yield (
                f"the estimator resets its {reset.quantity} {count}, by up to {sizes.max():.2g} {reset.unit}, first"
                f" at {seconds(data, rows[0]):.4g} s of the log; the estimate jumps there"
            )
    yield from _failsafes(topics.get("vehicle_status", {}), seconds)
    estimator, local = topics.get("estimator_status", {}), topics.get("vehicle_local_position", {})
    is_dead_reckoning = np.logical_and(local.get("dead_reckoning", False), local.get("xy_valid", False))
    for data, flags, finding in (
        (estimator, estimator.get("filter_fault_flags", ()), "estimator_status reports numerical faults"),
        (
            estimator,
            estimator.get("innovation_check_flags", ()),
            "estimator_status reports rejected measurements",
        ),
        (local, is_dead_reckoning, "the position comes from dead reckoning"),
    ):
        rows = np.flatnonzero(flags)
        if len(rows):
            fraction, first = len(rows) / len(data["timestamp"]), seconds(data, rows[0])
            yield f"{finding} in {fraction:.2%} of its samples, first at {first:.4g} s of the log"
    yield from _end(topics)


def _failsafes(status: _Data, seconds: Any) -> Iterator[str]:
    edges = np.diff(np.asarray(status.get("failsafe", ())).astype(int), prepend=0, append=0)
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    if len(begins):
        intervals = [
            f"{seconds(status, a):.4g} to {seconds(status, b):.4g} s" for a, b in zip(begins, ends, strict=True)
        ]
        yield (
            f"PX4 is in failsafe from {join_names(intervals, 3)} of the log: the vehicle may not follow its reference"
            " there"
        )


def _end(topics: Mapping[str, _Data]) -> Iterator[str]:
    armed = np.asarray(topics.get("vehicle_status", {}).get("arming_state", ()))
    landed = np.asarray(topics.get("vehicle_land_detected", {}).get("landed", ()))
    if len(armed) and len(landed) and armed[-1] == _ARMED and not landed[-1]:
        yield "the log ends in flight"


def without_invalid_samples(topic: str, data: _Data) -> dict[str, np.ndarray]:
    """Return the fields of a topic with NaN in place of the samples that the topic declares invalid."""
    result = dict(data)
    if topic == "vehicle_local_position":
        for validity, fields in _VALIDITY_FLAGS.items():
            for field in fields:
                if validity in data and field in data:
                    result[field] = np.where(data[validity].astype(bool), data[field], np.nan)
    return result


def with_motor_pulses(data: _Data, parameters: _Parameters) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return `actuator_outputs` with the motors as its first four outputs, and their pulses scaled to 1000 to 2000 µs.

    Args:
        data: data of the topic `actuator_outputs`.
        parameters: parameters of PX4 in the log, which assign channels and pulse ranges to the motors.

    Returns:
        The topic with these outputs, and remarks on the channels and pulse ranges.

    Raises:
        InputError: if the longest pulse of a motor is not longer than its shortest pulse.
    """
    # Boards with two groups of outputs may have the motors in either of them.
    assigned = {
        group: {
            motor: channel
            for channel in range(1, 17)
            for motor in range(_NUM_MOTORS)
            if parameters.get(f"PWM_{group}_FUNC{channel}") == _MOTOR_FUNCTION + motor
        }
        for group in _OUTPUT_GROUPS
    }
    group = max(_OUTPUT_GROUPS, key=lambda each: len(assigned[each]))
    channels = [assigned[group].get(motor, motor + 1) for motor in range(_NUM_MOTORS)]
    names = [f"output[{channel - 1}]" for channel in channels]
    if not all(name in data for name in names):
        return dict(data), []
    result, ranges = dict(data), []
    for motor, (name, channel) in enumerate(zip(names, channels, strict=True)):
        low, high = (
            _pulse_limit(parameters, f"PWM_{group}_{end}", channel, default)
            for end, default in zip(("MIN", "MAX"), _DEFAULT_PULSE_RANGE)
        )
        if not low < high:
            raise InputError(
                f"the parameters PWM_{group}_MIN and PWM_{group}_MAX set the pulses of motor {motor + 1} to {low:g} to"
                f" {high:g} µs, which is not a valid range: the minimum must be below the maximum"
            )
        ranges.append((low, high))
        shortest, longest = _DEFAULT_PULSE_RANGE
        result[f"output[{motor}]"] = shortest + (data[name].astype(float) - low) * (longest - shortest) / (high - low)
    remarks = []
    is_given = any(name.startswith(("PWM_MIN", "PWM_MAX", f"PWM_{group}_M")) for name in parameters)
    range_text = join_names(list(dict.fromkeys(f"{low:g} to {high:g}" for low, high in ranges)))
    source = (
        f"according to the parameters PWM_{group}_MIN, PWM_{group}_MAX and similar ones"
        if is_given
        else "assumed, since the log contains no such parameter"
    )
    remarks.append(f"the pulse range of the motors, from off to full throttle, is {range_text} µs, {source}")
    if channels != [*range(1, _NUM_MOTORS + 1)]:
        remarks.append(
            f"PX4's motors 1 to 4 are on its outputs {', '.join(map(str, channels))}, according to the parameters"
            f" PWM_{group}_FUNC1 and so on"
        )
    return result, remarks


def _pulse_limit(parameters: _Parameters, limit: str, channel: int, default: float) -> float:
    """Return the shortest or longest pulse of a channel, µs.

    If a parameter is missing or negative, the next, more general parameter is used, and finally `default`.

    Args:
        parameters: parameters of PX4.
        limit: name of the parameter for the whole group of outputs, such as PWM_MAIN_MIN.
        channel: number of the channel.
        default: value without a parameter, µs.
    """
    for name in (f"{limit}{channel}", limit, f"PWM_{limit.rpartition('_')[2]}"):
        value = parameters.get(name, -1)
        if value >= 0:
            return float(value)
    return default
