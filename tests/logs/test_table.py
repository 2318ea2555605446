"""Tests of CSV logs with a mapping: units, frames, rotor order, flights saved by this library, and error messages."""

import gzip
import json
import lzma

import numpy as np
import pytest
from written_logs import quaternion_of

from drake_quad import InputError, load_scenario, simulate
from drake_quad.files import write_table
from drake_quad.logs.mapping import load_mapping, shipped_mappings
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import COLUMNS, QUANTITIES
from drake_quad.logs.units import UNITS
from drake_quad.scenario.files.loading import load_undesigned


@pytest.fixture
def write(tmp_path):
    def write_one(name, text):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write_one


def has_remark(record, words):
    return any(words in remark for remark in record.remarks)


TABLE = "t,x,y,z,v,a,b,c,d\n" + "".join(
    f'{10 * i},{1000 + i},{2000},{-3000},"[{i}, 2, -3]",{1000 + i},{2000},{1500},{1250}\n' for i in range(6)
)
MAPPING = """
time: {column: t, unit: ms}
signals:
  position: {columns: [x, y, z], unit: mm, frame: NED}
  velocity: {column: v, unit: cm/s}
  motor_command: {columns: [a, b, c, d], unit: servo us, rotors: [1, 3, 4, 2]}
  wind: {columns: [x, 0.5, 0.0], factor: [0.001, 1.0, 1.0]}
"""


def test_a_mapping_converts_units_frames_and_rotor_order_and_may_contain_constants(write):
    record = read_log(write("log.csv", TABLE), write("m.yaml", MAPPING))
    i = np.arange(6.0)
    np.testing.assert_allclose(record.time, 0.01 * i, atol=1e-12)
    np.testing.assert_allclose(record.position, np.column_stack([1.0 + 1e-3 * i, 0.0 * i - 2.0, 0.0 * i + 3.0]))
    np.testing.assert_allclose(record.velocity, np.column_stack([0.01 * i, 0.0 * i + 0.02, 0.0 * i - 0.03]))
    np.testing.assert_allclose(
        record.motor_command, np.column_stack([1e-3 * i, 0.0 * i + 0.25, 0.0 * i + 1.0, 0.0 * i + 0.5])
    )
    np.testing.assert_allclose(record.wind, np.column_stack([1.0 + 1e-3 * i, 0.0 * i + 0.5, 0.0 * i]))
    assert has_remark(record, "the mapping is m.yaml")


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("frame", ["NWU", "NED"])
def test_a_quaternion_is_read_as_an_attitude(write, order, frame):
    """The conversion from NED and FRD leaves roll unchanged, and changes the signs of pitch and yaw."""
    sign = -1.0 if frame == "NED" else 1.0
    angles = np.array([[0.4, -0.7, 2.0], [-2.5, 0.2, -3.0]])
    rows = [quaternion_of(roll, sign * pitch, sign * yaw) for roll, pitch, yaw in angles]
    cells = ["[" + ", ".join(str(row["wxyz".index(name)]) for name in order) + "]" for row in rows]
    log = write("log.csv", "t,q\n" + "".join(f'{i},"{cell}"\n' for i, cell in enumerate(cells)))
    mapping = f"time: {{column: t}}\nsignals: {{attitude: {{column: q, quaternion: {order}, frame: {frame}}}}}"
    np.testing.assert_allclose(read_log(log, write("m.yaml", mapping)).attitude, angles, atol=1e-9)


def test_cells_without_a_number_are_interpolated_or_held(write):
    """Missing measurements are interpolated, and missing commands held.

    The record begins and ends where measurements and commands are known.
    """
    rows = ["0,,1", "1,1,5", "2,,", "3,3,", "4,6,7", "5,nan,8"]
    mapping = "time: {column: t}\nsignals: {thrust_command: {columns: [u]}, rotor_speed: {columns: [x, x, x, x]}}"
    record = read_log(write("log.csv", "t,x,u\n" + "\n".join(rows) + "\n"), write("m.yaml", mapping))
    np.testing.assert_array_equal(record.time, [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(record.rotor_speed[:, 2], [1.0, 2.0, 3.0, 6.0])
    np.testing.assert_array_equal(record.thrust_command, [5.0, 5.0, 5.0, 7.0])
    assert [each.missing_fraction for each in record.origins if each.signal == "rotor_speed"] == [0.5]
    assert has_remark(record, "the first 1 s are left out: rotor_speed is not logged yet")
    assert has_remark(record, "the last 1 s are left out: rotor_speed is no longer logged")


def test_an_angle_is_interpolated_across_half_a_turn(write):
    mapping = "time: {column: t}\nsignals: {attitude: {columns: [r, r, y]}, position: {columns: [r, r, r]}}"
    log = write("log.csv", "t,r,y\n0,0,3.1\n1,0,\n2,0,-3.1\n")
    assert abs(read_log(log, write("m.yaml", mapping)).attitude[1, 2]) == pytest.approx(np.pi)


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_a_compressed_log_is_read_and_a_truncated_one_up_to_its_end(write, pack):
    rng = np.random.default_rng(1)  # incompressible values
    text = "t,x,y,z\n" + "".join(f"{i},{a},{b},{c}\n" for i, (a, b, c) in enumerate(rng.normal(size=(3000, 3))))
    mapping = write("m.yaml", "time: {column: t}\nsignals: {position: {columns: [x, y, z]}}")
    data = pack(text.encode())
    complete = read_log(write("log.csv.packed", data), mapping)
    assert len(complete.time) == 3000
    truncated = read_log(write("log.csv.packed", data[: len(data) // 2]), mapping)
    assert 100 < len(truncated.time) < 2000
    np.testing.assert_array_equal(truncated.position, complete.position[: len(truncated.time)])
    assert has_remark(truncated, "the compressed file is truncated or damaged")
    with pytest.raises(InputError, match="is a compressed file that cannot be decompressed"):
        read_log(write("log.csv.packed", data[:8]), mapping)


def neural_fly_rows(count):
    """Return rows in Neural-Fly's format, of a straight flight."""
    for i in range(count):
        t = 0.02 * i
        w, x, y, z = quaternion_of(0.1, 0.2, 0.3)
        vectors = {
            "p": [t, 2.0 * t, 3.0 * t],
            "p_d": [t + 0.1, 2.0 * t, 3.0 * t],
            "v": [1.0, 2.0, 3.0],
            "v_d": [1.0, 2.0, 3.0],
            "q": [x, y, z, w],
            "R": np.eye(3).tolist(),
            "w": [0.1, -0.2, 0.3],
            "T_sp": [0.5 + 0.01 * i],
            "q_sp": [0.0, 0.0, 0.0, 1.0],
            "fa": [-8.0, 0.5, -0.25],
            "pwm": [1200.0, 1300.0, 1400.0, 1500.0],
        }
        cells = {"": i, "t": t, **{name: json.dumps(each) for name, each in vectors.items()}, "hover_throttle": 0.5}
        yield cells


def test_neural_fly_logs_are_read(tmp_path):
    rows = [*neural_fly_rows(30)]
    order = ["", "t", "p", "p_d", "v", "v_d", "q", "R", "w", "T_sp", "q_sp", "hover_throttle", "fa", "pwm"]
    path = write_table(tmp_path / "log.csv", {name: [row[name] for row in rows] for name in order})
    record = read_log(path)
    assert has_remark(record, "the mapping is neural_fly")
    np.testing.assert_allclose(record.time, 0.02 * np.arange(30), atol=1e-12)
    np.testing.assert_allclose(record.position, record.time[:, None] * [1.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(record.attitude, [[0.1, 0.2, 0.3]] * 30)
    np.testing.assert_allclose(record.attitude_command, 0.0, atol=1e-12)
    np.testing.assert_allclose(record.body_rates[4], [0.1, -0.2, 0.3])
    np.testing.assert_allclose(record.thrust_fraction, 0.5 + 0.01 * np.arange(30))
    np.testing.assert_allclose(record.reference_position[:, 0] - record.position[:, 0], 0.1)
    np.testing.assert_allclose(record.residual_force[9], [-8.0, 0.5, -0.25])
    assert has_remark(record, "not read: R, pwm")


def test_crazyflow_states_are_read(tmp_path):
    w, x, y, z = quaternion_of(0.1, -0.2, 0.3)
    columns = {"time": [0.0, 0.002, 0.004], "rotor_vel": ["[6000, 12000, 18000, 24000]"] * 3, "cmd_f": [0.3] * 3}
    columns |= {f"pos_{axis}": [float(i)] * 3 for i, axis in enumerate("xyz")}
    columns |= {f"quat_{name}": [float(value)] * 3 for name, value in zip("xyzw", (x, y, z, w), strict=True)}
    record = read_log(write_table(tmp_path / "log.csv", columns))
    assert has_remark(record, "the mapping is crazyflow")
    np.testing.assert_allclose(record.position[1], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(record.attitude[2], [0.1, -0.2, 0.3])
    np.testing.assert_allclose(record.rotor_speed[0], 2.0 * np.pi * np.array([100.0, 200.0, 300.0, 400.0]))
    np.testing.assert_allclose(record.thrust_command, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["figure_eight.yaml", "onboard.yaml"])
def test_flights_saved_by_this_library_are_read(tmp_path, diagrams, name):
    flight = simulate(load_scenario(diagrams / name, ["duration=2", "laboratory.motion_capture.position_noise=0.01"]))
    flight.save(tmp_path)
    record = read_log(tmp_path / "flight.csv")
    measured, state, reference = (flight.record(each) for each in ("measurement", "state", "reference"))
    np.testing.assert_allclose(record.time, flight.time - flight.time[0], atol=1e-9)
    close = {"rtol": 1e-8, "atol": 1e-9}  # values are written with nine digits
    np.testing.assert_allclose(record.position, np.column_stack([measured.x, measured.y, measured.z]), **close)
    np.testing.assert_allclose(record.attitude, np.column_stack([measured.roll, measured.pitch, measured.yaw]), **close)
    np.testing.assert_allclose(record.velocity, np.column_stack([measured.v_x, measured.v_y, measured.v_z]), **close)
    np.testing.assert_allclose(record.body_rates, np.column_stack([measured.p, measured.q, measured.r]), **close)
    np.testing.assert_allclose(record.reference_position[:, 0], reference.x, **close)
    assert record.rotor_speed is None
    truth = read_log(tmp_path / "flight.csv", "flight_truth")
    np.testing.assert_allclose(truth.position, np.column_stack([state.x, state.y, state.z]), **close)
    np.testing.assert_allclose(truth.rotor_speed, np.column_stack([*flight.record("rotor_speed")]), **close)
    np.testing.assert_allclose(truth.wind, np.column_stack([*flight.record("wind")]), **close)
    assert abs(truth.position - record.position).max() > 0.01
    commands = flight.record("attitude_target" if "attitude_target" in flight.signals else "attitude_command")
    np.testing.assert_allclose(record.attitude_command[:, 1], commands.pitch, **close)
    thrust = commands.thrust if "attitude_target" in flight.signals else flight.record("wrench").thrust
    np.testing.assert_allclose(record.thrust_command, thrust, **close)


@pytest.mark.parametrize("name", shipped_mappings())
def test_shipped_mappings_are_valid_and_contain_only_signals_of_a_record(name):
    _, mapping = load_mapping(name)
    assert {*mapping.signals} <= {*COLUMNS}
    assert mapping.description


def test_every_signal_has_units():
    assert {*QUANTITIES} == {*COLUMNS}
    for quantity in QUANTITIES.values():
        assert UNITS[quantity.unit][quantity.unit].scale == 1.0


HEADER = "time,pos,quat\n"
ROW, LEVEL = '{},"[1,2,3]","[0,0,0,1]"\n', '{},"[1,2,3]","[0,0,0,0]"\n'
SHORT, WRONG = '1,"[1,2]","[0,0,0,1]"\n', '1,"[1,2,x]","[0,0,0,1]"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n3,4\n", r"none of the shipped mappings \(.*neural_fly.*\) fits its columns, 'a', 'b'"),
        ("\0\1\2 garbage", "not a log in a known format"),
        (b"\xff\xfe\xfd", "not a log in a known format"),
        ("\n\n", "first row of a CSV file must name its columns"),
        ("", "is empty"),
        (HEADER, "fewer than two rows"),
        (HEADER + ROW.format(0) + SHORT + ROW.format(2), "log.csv:3: 'pos' is '.1,2.', but must be 3 numbers"),
        (HEADER + ROW.format(0) + WRONG + ROW.format(2), "'.1,2,x.', but must be 3 numbers"),
        (HEADER + LEVEL.format(0) + LEVEL.format(1), "lacks attitude, which the mapping requires"),
        (HEADER + ROW.format(0) + ROW.format("x") + ROW.format(2), ":3: 'time' is 'x', but must be a number"),
        (HEADER + ROW.format(1) + ROW.format(1), "no signal with two samples"),
    ],
)
def test_an_unreadable_table_is_refused(write, text, message):
    with pytest.raises(InputError, match=message):
        read_log(write("log.csv", text))


def test_truncated_rows_are_left_out(write):
    mapping = write("m.yaml", "time: {column: t}\nsignals: {position: {columns: [x, y, z]}}")
    record = read_log(write("log.csv", "t,x,y,z\n0,1,2,3\n1,1,2\n2,1,2,3\n3,1,2,3\n4,1,2,3.2"), mapping)
    np.testing.assert_array_equal(record.time, [0.0, 2.0, 3.0])
    assert has_remark(record, "1 row left out: the number of cells is not 4")
    assert has_remark(record, "the last row is left out")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("signals: {speed: {columns: [v]}}", r"m.yaml:1: signals.speed is not a signal; signals are position"),
        ("signals: {positions: {columns: [v]}}", "did you mean position"),
        ("signals:\n  position: {columns: [x, y]}", r"m.yaml:2: .*position.columns is \['x', 'y'\], but must have 3"),
        ("signals: {position: {columns: [x, y, z], unit: feet}}", "unit is 'feet', but must be m or cm or mm"),
        ("signals: {attitude: {columns: [x, y, z], frame: FRD}}", "frame is 'FRD', but must be NWU or ENU or NED"),
        ("signals: {battery_voltage: {columns: [x], frame: NED}}", "battery_voltage has no direction"),
        ("signals: {position: {columns: [x, y, z], quaternion: wxyz}}", "position is not an attitude"),
        ("signals: {attitude: {columns: [x, y, z], quaternion: wxyz}}", "must have 4 entries"),
        ("signals: {attitude: {column: q, quaternion: wxyz, unit: deg}}", "a quaternion has no unit"),
        ("signals: {position: {columns: [x, y, z], rotors: [1, 2, 3]}}", "position is not a signal with one value"),
        ("signals: {rotor_speed: {column: w, rotors: [1, 2, 3, 3]}}", "must contain each of 1, 2, 3 and 4 once"),
        ("signals: {position: {unit: mm}}", "must have either `columns` or `column`"),
        ("signals: {position: {columns: null, quaternion: null}}", "must have either `columns` or `column`"),
        ("signals: {position: [{columns: [x, y, z]}, {columns: [x], unit: mm}]}", r"position.1.columns is \['x'\]"),
        ("signals: {position: {columns: [x, y, z], scale: 2}}", "position.scale is unknown; allowed are columns"),
        ("signals: {position: {columns: [x, y, z]}}\nmass: 3", "m.yaml:2: mass is unknown; allowed are description"),
        ("signals: {position: {columns: [x, y, z], factor: a}}", "signals.position.factor is 'a'"),
        ("signals: {position: {columns: [x, y, z]}}\nrequired: [wind]", r"required.0 is 'wind', but must be one of"),
        ("time: {column: t, unit: h}\nsignals: {}", "m.yaml:1: time.unit is 'h'"),
        ("delimiter: x\nsignals: {}", "delimiter is 'x'"),
        ("time: {column: t}", "signals is missing"),
        ("[]", "must be a mapping of fields"),
        ("a: [", "is not YAML"),
        ("signals: {position: {columns: [x, y, z]}}", "the mapping m.yaml must state the time column"),
        ("time: {column: t}\nsignals: {position: {columns: [x, y, q]}}", "lacks 'q'; .* are 't', 'x', 'y', 'z'"),
        ("time: {column: s}\nsignals: {position: {columns: [x, y, z]}}", "lacks 's'; .* are 't', 'x', 'y', 'z'"),
        ("time: {column: t}\ndelimiter: ;\nsignals: {position: {columns: [x, y, q]}}", "are 't,x,y,z,v,a,b,c,d'"),
        ("time: {column: t}\nsignals: {}", "does not fit the mapping m.yaml: the mapping has no signals"),
    ],
)  # fmt: skip
def test_an_invalid_mapping_is_refused(write, text, message):
    log = write("log.csv", TABLE)
    with pytest.raises(InputError, match=message) as caught:
        read_log(log, write("m.yaml", text))
    assert "\n" not in str(caught.value)


def test_a_missing_mapping_is_refused(write, tmp_path):
    log = write("log.csv", TABLE)
    with pytest.raises(InputError, match=r"'px5' is neither a YAML file nor a shipped mapping: ardupilot, betaflight"):
        read_log(log, "px5")
    with pytest.raises(InputError, match="cannot be read: no such file"):
        read_log(log, tmp_path / "none.yaml")


def test_a_path_that_is_not_a_log_is_refused(tmp_path, write):
    with pytest.raises(InputError, match="cannot be read: no such file"):
        read_log(tmp_path / "none")
    with pytest.raises(InputError, match="is a folder, not a log$"):
        read_log(tmp_path)
    write("flight.csv", "")
    with pytest.raises(InputError, match="flight.csv, the log of a flight"):
        read_log(tmp_path)
    with pytest.raises(InputError, match="the path contains an invalid character"):
        read_log("a\0b")
    with pytest.raises(InputError, match="it is not a file"):
        read_log("/dev/zero")


def test_a_log_that_is_too_large_is_not_read(write, monkeypatch):
    monkeypatch.setattr("drake_quad.logs.source.MAX_BYTES", 1000)
    for data in (b"x" * 1001, lzma.compress(b"x" * 100_000)):
        with pytest.raises(InputError, match="is too large: a log may have at most 1,000 bytes after decompression"):
            read_log(write("log", data))
    monkeypatch.undo()
    monkeypatch.setattr("drake_quad.logs.formats.table.MAX_BYTES", 10)
    with pytest.raises(InputError, match="is too large: a CSV file may have at most 10 bytes"):
        read_log(write("log", TABLE))


def test_a_mapping_can_name_the_vehicle_and_give_the_wind_for_words_in_log_names(write):
    mapping = MAPPING.replace("  wind: {columns: [x, 0.5, 0.0], factor: [0.001, 1.0, 1.0]}\n", "")
    mapping += "wind_by_name: {gale: [-9, 1, 0.5], nogale: [0, 0, 0]}\nvehicle: vehicles/crazyflie.yaml\n"
    path = write("m.yaml", mapping)
    gale, calm, other = (read_log(write(f"{name}.csv", TABLE), path) for name in ("my_gale", "my_nogale", "my_other"))
    np.testing.assert_allclose(gale.wind, np.tile([-9.0, 1.0, 0.5], (6, 1)))
    assert has_remark(gale, "wind is (-9, 1, 0.5) m/s, as the name of the log implies")
    np.testing.assert_allclose(calm.wind, 0.0)
    assert other.wind is None
    assert gale.vehicle == "vehicles/crazyflie.yaml"
    logged = read_log(write("a_gale.csv", TABLE), write("w.yaml", MAPPING + "wind_by_name: {gale: [-9, 1, 0.5]}\n"))
    assert logged.wind[0, 1] == 0.5


def test_vehicles_that_shipped_mappings_name_exist():
    named = [load_mapping(name)[1].vehicle for name in shipped_mappings()]
    assert any(named)
    for vehicle in filter(None, named):
        load_undesigned(vehicle)


FLIGHT_MAPPING = """
time: {column: t, unit: s}
signals:
  position: {columns: [x, y, z]}
  attitude: {columns: [qw, qx, qy, qz], quaternion: wxyz}
  motor_command: {columns: [m1, m2, m3, m4], unit: uint16}
  reference_position: {columns: [rx, ry, rz]}
"""
FIELDS = ("x", "y", "z", "qw", "qx", "qy", "qz", "m1", "m2", "m3", "m4", "rx", "ry", "rz")


def record_with(write, **changed):
    """Return a record of 2 s at 100 Hz in which a vehicle moves along x, with some columns replaced."""
    t = 0.01 * np.arange(200)
    columns = {name: np.zeros(200) for name in FIELDS} | {"x": t, "z": 1.0 + 0 * t, "qw": 1.0 + 0 * t, "rx": t + 0.1}
    columns |= {f"m{i}": 40_000.0 + 0 * t for i in range(1, 5)} | {"rz": 1.0 + 0 * t, "qz": 0.01 + 0 * t}
    columns |= {name: np.broadcast_to(values(t), t.shape) for name, values in changed.items()}
    rows = np.column_stack([t, *columns.values()]).tolist()
    lines = [",".join(["t", *columns]), *(",".join(map(repr, row)) for row in rows)]
    return read_log(write("log.csv", "\n".join([*lines, ""])), write("m.yaml", FLIGHT_MAPPING))


DOUBTFUL_REMARKS = ("left out", "jumps", "zero", "may not have flown", "reference_position is up to")


def test_a_consistent_flight_has_no_remark(write):
    record = record_with(write)
    assert len(record.time) == 200
    assert not any(has_remark(record, words) for words in DOUBTFUL_REMARKS)


def test_rows_with_impossible_motor_commands_are_left_out(write):
    """Rows with impossible commands occur in logs that were extrapolated, and all of their columns are unreliable."""
    record = record_with(write, m2=lambda t: np.where(t > 1.5, 1_252_581.0, 40_000.0))
    assert record.time[-1] == pytest.approx(1.5)
    assert has_remark(record, "49 of 200 samples are left out, first at 1.51 s: the log is damaged")
    assert has_remark(record, "motor commands of up to 19.1 times the full command")
    below = record_with(write, m2=lambda t: np.where(t > 1.5, -300.0, 40_000.0))
    assert len(below.time) == 151
    assert len(record_with(write, m2=lambda t: np.where(t > 1.5, 65_535.0, 0.0)).time) == 200


def test_a_jump_of_the_position_is_reported_and_a_manoeuvre_is_not(write):
    record = record_with(write, x=lambda t: t + 0.4 * (t > 1.0), rx=lambda t: t)
    assert has_remark(
        record, "position jumps once, by up to 0.4 m at 1.01 s: the estimator was reset, or the log is damaged"
    )
    hard = record_with(write, x=lambda t: 0.5 * np.sin(10.0 * t), rx=lambda t: 0.0 * t)
    slow = record_with(write, x=lambda t: 5.0 * np.floor(5.0 * t) / 5.0, rx=lambda t: 5.0 * t)
    assert not any(has_remark(each, "jumps") for each in (hard, slow))


def test_quaternions_of_zeros_are_missing_attitudes(write):
    """The record states the fraction of samples without an attitude. If too few remain, the attitude is left out."""
    part = record_with(write, qw=lambda t: 1.0 * (t > 0.5), qz=lambda t: 0.01 * (t > 0.5))
    assert [each.missing_fraction for each in part.origins if each.signal == "attitude"] == [51 / 200]
    assert np.isfinite(part.attitude).all()
    none = record_with(write, qw=lambda t: 0.0 * t, qz=lambda t: 0.0 * t)
    assert none.attitude is None
    assert has_remark(none, "attitude is left out: qw to qz is a quaternion of length 1 in fewer than two samples")
    assert has_remark(
        record_with(write, qz=lambda t: 0.0 * t), "attitude is zero throughout: it may not have been measured"
    )


def test_a_vehicle_that_stays_on_the_ground_is_reported(write):
    record = record_with(write, z=lambda t: 0.1 + 0.05 * np.sin(t))
    assert has_remark(record, "the height stays between 0.1 and 0.15 m: the vehicle may not have flown")


def test_a_reference_out_of_reach_is_reported(write):
    record = record_with(write, rx=lambda t: np.where(t > 1.0, -17.0, t))
    assert has_remark(record, "reference_position is up to 19 m away from a vehicle that moves by 2 m, first at 1.01 s")


def test_the_first_of_several_damaged_columns_is_named(tmp_path):
    """Columns are sorted by name, independently of their order in the file."""
    names = ["time", *(f"c{i:02d}" for i in range(11, -1, -1))]
    (tmp_path / "log.csv").write_text(
        "\n".join([",".join(names), *(f"{t}" + 12 * ",bad" for t in (0.0, 0.1, 0.2))]) + "\n"
    )
    signals = ("position", "velocity", "attitude", "body_rates")
    sources = [f"  {name}: {{columns: [{', '.join(names[3 * i + 1 : 3 * i + 4])}]}}" for i, name in enumerate(signals)]
    (tmp_path / "mapping.yaml").write_text("\n".join(["time: {column: time}", "signals:", *sources]) + "\n")
    with pytest.raises(InputError, match=r"log\.csv:2: 'c00' is 'bad', but must be a number$"):
        read_log(tmp_path / "log.csv", tmp_path / "mapping.yaml")
