"""Tests of remarks on the vehicle and the estimator of a ULog, by comparison with codes of MAVLink and PX4."""

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.logs.px4_status import (
    other_vehicle,
    status_remarks,
    with_motor_pulses,
    without_invalid_samples,
)

# From MAVLink's common.xml.
MAV_TYPES = {
    "MAV_TYPE_FIXED_WING": (1, "an aeroplane"),
    "MAV_TYPE_COAXIAL": (3, "a coaxial helicopter"),
    "MAV_TYPE_HELICOPTER": (4, "a helicopter"),
    "MAV_TYPE_AIRSHIP": (7, "an airship"),
    "MAV_TYPE_FREE_BALLOON": (8, "a balloon"),
    "MAV_TYPE_GROUND_ROVER": (10, "a ground rover"),
    "MAV_TYPE_SURFACE_BOAT": (11, "a boat"),
    "MAV_TYPE_SUBMARINE": (12, "a submarine"),
    "MAV_TYPE_HEXAROTOR": (13, "a hexarotor"),
    "MAV_TYPE_OCTOROTOR": (14, "an octorotor"),
    "MAV_TYPE_TRICOPTER": (15, "a tricopter"),
    "MAV_TYPE_VTOL_TAILSITTER_DUOROTOR": (19, "a VTOL"),
    "MAV_TYPE_VTOL_TAILSITTER_QUADROTOR": (20, "a VTOL"),
    "MAV_TYPE_VTOL_TILTROTOR": (21, "a VTOL"),
    "MAV_TYPE_VTOL_FIXEDROTOR": (22, "a VTOL"),
    "MAV_TYPE_VTOL_TAILSITTER": (23, "a VTOL"),
    "MAV_TYPE_VTOL_TILTWING": (24, "a VTOL"),
    "MAV_TYPE_VTOL_RESERVED5": (25, "a VTOL"),
    "MAV_TYPE_DODECAROTOR": (29, "a dodecarotor"),
    "MAV_TYPE_DECAROTOR": (35, "a decarotor"),
}
# From PX4's parameter reference.
AIRFRAMES = {
    "Fixed-wing": (1, "an aeroplane"),
    "Standard VTOL": (2, "a VTOL"),
    "Tiltrotor VTOL": (3, "a VTOL"),
    "Tailsitter VTOL": (4, "a VTOL"),
    "Rover (Ackermann)": (5, "a ground rover"),
    "Rover (Differential)": (6, "a ground rover"),
    "Motors (6DOF)": (7, "a vehicle with motors in all directions"),
    "Multirotor with Tilt": (8, "a multirotor that tilts its rotors"),
    "Helicopter (tail ESC)": (10, "a helicopter"),
    "Helicopter (tail Servo)": (11, "a helicopter"),
    "Helicopter (Coaxial)": (12, "a helicopter"),
    "Rover (Mecanum)": (13, "a ground rover"),
    "Spacecraft 2D": (14, "a spacecraft"),
}
# From VEHICLE_TYPE in PX4's VehicleStatus.msg.
VEHICLE_TYPES = {"fixed wing": (2, "an aeroplane"), "rover": (3, "a ground rover"), "airship": (4, "an airship")}


def test_types_of_vehicles_have_the_published_codes():
    for name, table in (("MAV_TYPE", MAV_TYPES), ("CA_AIRFRAME", AIRFRAMES)):
        known = dict(table.values())
        for number in range(60):
            expected = f"{known[number]} (the parameter {name} is {number})" if number in known else ""
            assert other_vehicle({name: number}, None) == expected
    for field, table in (("system_type", MAV_TYPES), ("vehicle_type", VEHICLE_TYPES)):
        known = dict(table.values())
        for number in range(60):
            status = {field: np.full(5, number)}
            expected = f"{known[number]} (vehicle_status.{field} is {number})" if number in known else ""
            assert other_vehicle({}, status) == expected
    assert other_vehicle({}, {"is_vtol": np.array([0, 0, 1])}) == "a VTOL (vehicle_status.is_vtol is 1)"
    assert other_vehicle({}, {"is_vtol": np.zeros(3)}) == ""
    for rotors in range(9):
        expected = (
            "" if rotors in (0, 4) else f"a vehicle with {rotors} rotors (the parameter CA_ROTOR_COUNT is {rotors})"
        )
        assert other_vehicle({"CA_ROTOR_COUNT": rotors}, None) == expected


STAMPS = {"timestamp": 5_000_000 + 100_000 * np.arange(20)}  # µs


def remarks(**topics):
    """Return the remarks on topics of 20 rows, 0.1 s apart, in a log that begins 1 s before them."""
    return list(status_remarks({name: STAMPS | data for name, data in topics.items()}, 4_000_000))


@pytest.mark.parametrize(
    ("topic", "counter", "fields", "size", "message"),
    [
        ("vehicle_local_position", "xy", ("delta_xy[0]", "delta_xy[1]"), 1.0, "position {} m"),
        ("vehicle_local_position", "z", ("delta_z",), 1.0, "height {} m"),
        ("vehicle_local_position", "vxy", ("delta_vxy[0]", "delta_vxy[1]"), 1.0, "velocity {} m/s"),
        ("vehicle_local_position", "vz", ("delta_vz",), 1.0, "climb {} m/s"),
        ("vehicle_attitude", "quat", tuple(f"delta_q_reset[{i}]" for i in (1, 2, 3)), 2.0, "attitude {} rad"),
    ],
)
def test_each_reset_is_reported_with_its_size_and_unit(topic, counter, fields, size, message):
    """Resets below 0.01 are ignored, since every estimator begins with them."""
    quantity, unit = message.split(" {} ")
    for count, jumps in ((1, [(3, 0.2)]), (2, [(3, 0.2), (9, 0.4)]), (1, [(3, 0.001), (9, 0.4)]), (0, [(3, 0.001)])):
        counts = sum((np.arange(20) >= row).astype(int) for row, _ in jumps)
        sizes = np.zeros(20)
        for row, jump in jumps:
            sizes[row] = jump / len(fields) ** 0.5 / size
        actual = remarks(**{topic: {f"{counter}_reset_counter": counts} | dict.fromkeys(fields, sizes)})
        if count == 0:
            assert actual == []
            continue
        large = [(row, jump) for row, jump in jumps if jump > 0.01]
        times = "once" if count == 1 else "2 times"
        assert actual == [
            f"the estimator resets its {quantity} {times}, by up to {max(jump for _, jump in large):.2g} {unit},"
            f" first at {1.0 + 0.1 * large[0][0]:.4g} s of the log; the estimate jumps there"
        ]
    # A reset is not reported if its size is not logged.
    assert remarks(**{topic: {f"{counter}_reset_counter": np.arange(20)}}) == []


def test_failsafes_faults_and_dead_reckoning_are_reported_with_their_times():
    rows = np.arange(20)
    assert remarks(vehicle_status={"failsafe": np.isin(rows, [0, 1, 5, 18, 19])}) == [
        "PX4 is in failsafe from 1 to 1.1 s, 1.5 to 1.5 s, 2.8 to 2.9 s of the log: the vehicle may not follow its"
        " reference there"
    ]
    assert remarks(vehicle_status={"failsafe": np.zeros(20, dtype=bool)}) == []
    for field, fault in (
        ("filter_fault_flags", "numerical faults"),
        ("innovation_check_flags", "rejected measurements"),
    ):
        assert remarks(estimator_status={field: np.where(rows > 14, 4, 0)}) == [
            f"estimator_status reports {fault} in 25.00% of its samples, first at 2.5 s of the log"
        ]
    with_dead_reckoning = {"dead_reckoning": rows < 10, "xy_valid": rows >= 5}
    assert remarks(vehicle_local_position=with_dead_reckoning) == [
        "the position comes from dead reckoning in 25.00% of its samples, first at 1.5 s of the log"
    ]


@pytest.mark.parametrize(("armed", "landed", "ends"), [(2, 0, True), (1, 0, False), (2, 1, False)])
def test_a_log_ends_in_flight_if_it_is_armed_and_not_landed(armed, landed, ends):
    actual = remarks(
        vehicle_status={"arming_state": np.array([1, 2, armed])},
        vehicle_land_detected={"landed": np.array([1, 1 - landed, landed])},
    )
    assert (actual == ["the log ends in flight"]) == ends
    assert remarks(vehicle_status={"arming_state": np.array([armed])}) == []


def test_each_field_is_left_out_where_its_flag_marks_it_as_invalid():
    fields = {"xy_valid": ("x", "y"), "z_valid": ("z",), "v_xy_valid": ("vx", "vy"), "v_z_valid": ("vz",)}
    every = [name for names in fields.values() for name in names]
    data = {name: np.arange(4.0) for name in every} | {flag: np.ones(4) for flag in fields}
    for flag, names in fields.items():
        actual = without_invalid_samples("vehicle_local_position", data | {flag: np.array([1, 0, 1, 0])})
        for name in every:
            expected = [0.0, np.nan, 2.0, np.nan] if name in names else [0.0, 1.0, 2.0, 3.0]
            np.testing.assert_array_equal(actual[name], expected)
        others = without_invalid_samples("vehicle_attitude", data | {flag: np.zeros(4)})
        np.testing.assert_array_equal(others["x"], data["x"])
    assert {*without_invalid_samples("vehicle_local_position", {"x": np.zeros(2)})} == {"x"}


def test_motor_pulses_are_read_from_any_of_sixteen_outputs():
    data = {f"output[{i}]": np.full(3, 1000.0 + 50.0 * i) for i in range(16)}
    parameters = {"PWM_MAIN_FUNC16": 101, "PWM_MAIN_FUNC1": 102, "PWM_MAIN_FUNC9": 103, "PWM_MAIN_FUNC5": 104}
    actual, remarks = with_motor_pulses(data, parameters)
    np.testing.assert_allclose([actual[f"output[{i}]"][0] for i in range(4)], [1750.0, 1000.0, 1400.0, 1200.0])
    phrase = "the pulse range of the motors, from off to full throttle, is"
    assert remarks[0] == f"{phrase} 1000 to 2000 µs, assumed, since the log contains no such parameter"
    assert (
        remarks[1]
        == "PX4's motors 1 to 4 are on its outputs 16, 1, 9, 5, according to the parameters PWM_MAIN_FUNC1 and so on"
    )
    # A limit of 0 µs is valid. If `PWM_MAIN_MIN` is negative, the more general parameter `PWM_MIN` applies.
    limits = {"PWM_MAIN_MIN2": 0, "PWM_MAIN_MIN": -1, "PWM_MIN": 900, "PWM_MAX": 1900}
    actual, remarks = with_motor_pulses(data, limits)
    expected = [1000.0 + 1000.0 * (1000.0 - 900.0) / 1000.0, 1000.0 + 1000.0 * 1050.0 / 1900.0]
    np.testing.assert_allclose([actual[f"output[{i}]"][0] for i in range(2)], expected)
    assert remarks == [
        f"{phrase} 900 to 1900, 0 to 1900 µs, according to the parameters PWM_MAIN_MIN, PWM_MAIN_MAX and similar ones"
    ]
    # If one of the outputs is missing, the motor commands are unknown.
    incomplete = {name: values for name, values in data.items() if name != "output[2]"}
    assert with_motor_pulses(incomplete, {}) == (incomplete, [])


def test_motors_on_auxiliary_outputs_are_read_with_their_own_limits():
    data = {f"output[{i}]": np.full(3, 1100.0 + 50.0 * i) for i in range(8)}
    parameters = {f"PWM_AUX_FUNC{channel}": 100 + motor for motor, channel in enumerate((3, 1, 2, 4), start=1)}
    parameters |= {f"PWM_MAIN_FUNC{channel}": 0 for channel in range(1, 9)}
    parameters |= {"PWM_AUX_MIN3": 1000, "PWM_AUX_MAX3": 1400, "PWM_MAIN_MIN3": 500, "PWM_AUX_MAX": 2000}
    actual, remarks = with_motor_pulses(data, parameters)
    np.testing.assert_allclose([actual[f"output[{i}]"][0] for i in range(4)], [1500.0, 1100.0, 1150.0, 1250.0])
    assert "according to the parameters PWM_AUX_MIN, PWM_AUX_MAX and similar ones" in remarks[0]
    assert remarks[1].endswith("outputs 3, 1, 2, 4, according to the parameters PWM_AUX_FUNC1 and so on")
    with pytest.raises(InputError, match="the parameters PWM_AUX_MIN and PWM_AUX_MAX set the pulses of motor 1"):
        with_motor_pulses(data, {**parameters, "PWM_AUX_MIN3": 1500})


# From PX4's airframe reference; the numbers of quadrotors begin with 4 and 5.
@pytest.mark.parametrize(
    ("number", "expected"),
    [(4001, ""), (5001, ""), (1001, ""), (0, ""), (2100, "an aeroplane"), (6001, "a hexarotor"), (13000, "a VTOL")],
)
def test_the_airframe_number_states_the_type_of_vehicle(number, expected):
    text = f"{expected} (the parameter SYS_AUTOSTART is {number})" if expected else ""
    assert other_vehicle({"SYS_AUTOSTART": number}, None) == text
