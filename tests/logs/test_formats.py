"""Tests that the format of a log is recognised by its content, and that the written values are read back."""

import io
import json
import lzma
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
from mcap.writer import Writer as McapWriter
from rosbags import typesys
from rosbags.rosbag2 import StoragePlugin
from written_logs import (
    blackbox_log,
    dataflash_log,
    old_crazyflie_log,
    quaternion_of,
    ros_1_bag,
    ros_2_bag,
)

from drake_quad import InputError
from drake_quad.logs.formats.log_format import FORMATS
from drake_quad.logs.formats.ros import _content, _Decoder, _Message, _Rows, _tables
from drake_quad.logs.mapping import load_mapping, shipped_mappings
from drake_quad.logs.reading import read_log
from drake_quad.logs.source import LogFile

NUM_SAMPLES = 60  # samples of each log
TIMES = 20_000 * np.arange(NUM_SAMPLES)  # µs
SECONDS = 1e-6 * TIMES


@pytest.fixture
def read(tmp_path):
    def read_one(data, *mapping):
        path = tmp_path / "log"
        path.write_bytes(data)
        return read_log(path, *mapping)

    return read_one


def has_remark(record, words):
    return any(words in remark for remark in record.remarks)


def rows(*columns):
    """Return the rows of a table from `TIMES` and further columns, each a sequence or a constant."""
    return [
        (int(time), *(column[i] if np.ndim(column) else column for column in columns)) for i, time in enumerate(TIMES)
    ]


ARDUPILOT = dataflash_log(
    {
        "ATT": (
            "ccccCC",
            ["DesRoll", "Roll", "DesPitch", "Pitch", "DesYaw", "Yaw"],
            rows(100, np.arange(NUM_SAMPLES), 200, np.arange(NUM_SAMPLES), 300, 9000),
        ),
        # Messages of the first of several IMUs.
        "IMU": (
            "Bffffff",
            ["I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"],
            rows(0, 0.1, 0.2, SECONDS, 0.5, 0.25, -9.8),
        ),
        "XKF1": (
            "BffffffB",
            ["C", "VN", "VE", "VD", "PN", "PE", "PD", "FS"],
            rows(0, 1.0, 2.0, 3.0, SECONDS, 5.0, -2.0, 0),
        ),
        "RCOU": ("HHHH", ["C1", "C2", "C3", "C4"], rows(1100, 1200, 1300, 1400)),
    },
    parameters={"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0},
)


@pytest.mark.slow
def test_an_ardupilot_log_is_converted_to_the_frames_and_rotor_order_of_this_library(read):
    """Half a turn about x converts NED to NWU.

    ArduPilot's rotors 1 to 4 are front right, back left, front left, back right.
    """
    record = read(ARDUPILOT)
    np.testing.assert_allclose(record.time, SECONDS, atol=1e-12)
    np.testing.assert_allclose(record.attitude[:, 0], np.radians(0.01 * np.arange(NUM_SAMPLES)), atol=1e-12)
    np.testing.assert_allclose(record.attitude[:, 1], -np.radians(0.01 * np.arange(NUM_SAMPLES)), atol=1e-12)
    np.testing.assert_allclose(record.attitude[:, 2], -0.5 * np.pi)
    np.testing.assert_allclose(record.attitude_command[0], np.radians([1.0, -2.0, -3.0]))
    np.testing.assert_allclose(record.body_rates[:, 2], -SECONDS, atol=1e-6)
    np.testing.assert_allclose(record.specific_force[0], [0.5, -0.25, 9.8], rtol=1e-6)
    np.testing.assert_allclose(record.position[:, 0], SECONDS, atol=1e-6)
    np.testing.assert_allclose(record.position[0, 1:], [-5.0, 2.0])
    np.testing.assert_allclose(record.velocity[0], [1.0, -2.0, -3.0])
    np.testing.assert_allclose(record.motor_command[0], [0.1, 0.4, 0.2, 0.3])
    # The clock of a message is not reported as unread.
    assert has_remark(record, "not read: FMT, IMU.I, PARM, XKF1.C, XKF1.FS")
    assert not has_remark(record, "TimeUS")


def test_the_first_instance_of_a_sensor_is_read(read):
    instances = [row for time in TIMES.tolist() for row in ((time, 1, 7.0, 8.0, 9.0), (time + 9_000, 0, 0.1, 0.2, 0.3))]
    record = read(dataflash_log({"IMU": ("Bfff", ["I", "GyrX", "GyrY", "GyrZ"], instances)}))
    np.testing.assert_allclose(record.body_rates, np.tile([0.1, -0.2, -0.3], (NUM_SAMPLES, 1)), rtol=1e-6)


def test_a_message_without_a_time_is_left_out(read):
    assert ARDUPILOT.count(b"TimeUS,C,VN") == 1
    record = read(ARDUPILOT.replace(b"TimeUS,C,VN", b"Moment,C,VN"))
    assert record.velocity is None
    np.testing.assert_array_equal(record.specific_force, read(ARDUPILOT).specific_force)


def test_an_ardupilot_log_without_a_known_message_is_refused(read):
    barometer = dataflash_log({"BARO": ("f", ["Alt"], rows(1.0))})
    with pytest.raises(InputError, match=r"is an ArduPilot log without any of the messages ATT, .*XKQ$"):
        read(barometer)


def test_an_ardupilot_log_of_another_vehicle_needs_a_mapping(read):
    hexarotor = dataflash_log(
        {"ATT": ("ccc", ["Roll", "Pitch", "Yaw"], rows(1, 2, 3))}, parameters={"FRAME_CLASS": 2.0}
    )
    with pytest.raises(InputError, match="is a log of a hexarotor, not of a quadrotor; to read it, give a mapping"):
        read(hexarotor)
    assert has_remark(read(hexarotor, "ardupilot"), "the log is of a hexarotor")
    plus = dataflash_log({"ATT": ("ccc", ["Roll", "Pitch", "Yaw"], rows(1, 2, 3))}, parameters={"FRAME_TYPE": 0.0})
    assert has_remark(read(plus), "FRAME_TYPE states another layout")


def test_frame_classes_have_the_numbers_that_ardupilot_publishes(read):
    """Quad is 1 in ArduPilot's parameter list. A log without the parameter counts as the log of a quadrotor."""
    classes = {
        2: "a hexarotor", 3: "an octorotor", 4: "an octorotor", 5: "a hexarotor with coaxial rotors", 6: "a helicopter",
        7: "a tricopter", 8: "a vehicle with one rotor", 9: "a vehicle with coaxial rotors",
        10: "a vehicle on two rotors", 11: "a helicopter", 12: "a dodecarotor", 13: "a helicopter", 14: "a decarotor",
    }  # fmt: skip
    message = {"ATT": ("ccc", ["Roll", "Pitch", "Yaw"], rows(1, 2, 3))}
    for number in range(1, 16):
        log = dataflash_log(message, parameters={"FRAME_CLASS": float(number), "FRAME_TYPE": 1.0})
        remarks = [each for each in read(log, "ardupilot").remarks if each.startswith("the log is of")]
        assert remarks == ([f"the log is of {classes[number]}"] if number in classes else []), number
    assert not has_remark(read(dataflash_log(message)), "the log is of")
    # Older versions call the parameter FRAME.
    for frame, other in ((0.0, True), (1.0, False)):
        log = dataflash_log(message, parameters={"FRAME": frame})
        assert has_remark(read(log), "FRAME_TYPE states another layout") == other


BLACKBOX_FIELDS = [
    f"{name}[{i}]" for name, count in (("gyroADC", 3), ("accSmooth", 3), ("motor", 4)) for i in range(count)
]
BLACKBOX = blackbox_log(
    BLACKBOX_FIELDS, [(int(time), i, -2 * i, 57, 0, 1024, 2048, 48, 2047, 1047, 548) for i, time in enumerate(TIMES)]
)


def test_a_betaflight_log_is_converted_to_thrust_fractions_and_si_units(read):
    """Betaflight's rotors 1 to 4 are back right, front right, back left, front left."""
    record = read(BLACKBOX)
    np.testing.assert_allclose(record.time, SECONDS, atol=1e-12)
    np.testing.assert_allclose(np.degrees(record.body_rates[:, 0]), np.arange(NUM_SAMPLES))
    np.testing.assert_allclose(np.degrees(record.body_rates[:, 1]), -2.0 * np.arange(NUM_SAMPLES))
    np.testing.assert_allclose(record.specific_force[0], [0.0, 0.5 * 9.80665, 9.80665])
    np.testing.assert_allclose(record.motor_command[0], [1.0, 0.0, 999.0 / 1999.0, 500.0 / 1999.0])
    # Betaflight's columns `loopIteration` and `time` are not reported as unread.
    assert not has_remark(record, "not read")


def test_the_longest_flight_of_a_betaflight_log_is_read(read):
    short = blackbox_log(BLACKBOX_FIELDS, [(int(time), *[0] * 10) for time in TIMES[:5]])
    record = read(short + BLACKBOX)
    assert len(record.time) == NUM_SAMPLES
    assert has_remark(record, "the log has 2 flights; only the longest is read, number 2")


def test_the_longest_flight_of_a_betaflight_log_may_be_the_first(read):
    short = blackbox_log(BLACKBOX_FIELDS, [(int(time), *[0] * 10) for time in TIMES[:5]])
    record = read(BLACKBOX + short + short)
    assert len(record.time) == NUM_SAMPLES
    assert has_remark(record, "the log has 3 flights; only the longest is read, number 1")


def test_damaged_frames_of_a_betaflight_log_are_counted(read):
    damaged = bytearray(BLACKBOX)
    damaged[-40] ^= 0x80
    assert has_remark(read(bytes(damaged)), "damaged frames are left out")


OLD_CRAZYFLIE = old_crazyflie_log(
    [("stateEstimate.x", "f"), ("stateEstimate.y", "f"), ("stateEstimate.z", "f"), ("motor.m1", "H")]
    + [(f"motor.m{i}", "H") for i in (2, 3, 4)],
    [(20 * i, 0.5 * i, 2.0, 3.0, 65535, 0, 13107, 26214) for i in range(NUM_SAMPLES)],
)


def test_the_old_crazyflie_format_has_the_column_names_of_the_new_format(read):
    record = read(OLD_CRAZYFLIE)
    np.testing.assert_allclose(record.time, SECONDS, atol=1e-12)
    np.testing.assert_allclose(record.position[:, 0], 0.5 * np.arange(NUM_SAMPLES))
    np.testing.assert_allclose(record.motor_command[0], [1.0, 0.0, 0.2, 0.4])
    assert has_remark(record, "the mapping is crazyflie")
    assert not has_remark(record, "not read")


def test_blocks_of_an_old_crazyflie_log_with_a_wrong_checksum_are_left_out(read):
    damaged = bytearray(OLD_CRAZYFLIE)
    damaged[len(damaged) // 2] ^= 1
    record = read(bytes(damaged))
    assert len(record.time) == NUM_SAMPLES - 7
    assert has_remark(record, "1 block of records is left out because of a wrong checksum")
    damaged[len(damaged) // 4] ^= 1
    fewer = read(bytes(damaged))
    assert has_remark(fewer, "2 blocks of records are left out because of a wrong checksum")
    assert NUM_SAMPLES > len(record.time) > len(fewer.time) > NUM_SAMPLES // 2
    cut = read(OLD_CRAZYFLIE[:-1])
    assert len(cut.time) == NUM_SAMPLES - NUM_SAMPLES % 7
    assert has_remark(cut, "bytes are not read: no complete block of records")


def mat_file(content):
    file = io.BytesIO()
    scipy.io.savemat(file, content)
    return file.getvalue()


MAT_CONTENT = {
    "log": {
        "t": SECONDS,
        "p": np.column_stack([SECONDS, 2.0 + 0.0 * SECONDS, 3.0 + 0.0 * SECONDS]),
        # MATLAB users store a component as a row as often as a column.
        "u": np.outer([10.0, 20.0, 30.0, 40.0], np.ones(NUM_SAMPLES)),
        "vbat": 0.0 * SECONDS + 11.1,
    },
    "note": "flight 7",
}
MAT_MAPPING = """
time: {column: log.t}
signals:
  position: {column: log.p, unit: mm}
  motor_command: {columns: ["log.u[0]", "log.u[1]", "log.u[2]", "log.u[3]"], unit: "%"}
  battery_voltage: {columns: [log.vbat]}
"""


def test_structs_and_matrices_of_a_mat_file_are_read(read, tmp_path):
    (tmp_path / "mine.yaml").write_text(MAT_MAPPING)
    record = read(mat_file(MAT_CONTENT), tmp_path / "mine.yaml")
    np.testing.assert_allclose(record.time, SECONDS)
    np.testing.assert_allclose(record.position[:, 0], 1e-3 * SECONDS)
    np.testing.assert_allclose(record.motor_command[0], [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(record.battery_voltage, 11.1)
    with pytest.raises(InputError, match="none of the shipped mappings"):
        read(mat_file(MAT_CONTENT))


def test_a_matrix_of_times_is_refused(read, tmp_path):
    (tmp_path / "mine.yaml").write_text(MAT_MAPPING)
    content = {"log": {**MAT_CONTENT["log"], "t": np.ones((NUM_SAMPLES, 2))}}
    with pytest.raises(InputError, match=r"log\.t must be a vector of times"):
        read(mat_file(content), tmp_path / "mine.yaml")


def test_variables_of_a_mat_file_that_are_not_as_long_as_the_time_are_left_out(read, tmp_path):
    """A remark names each variable once."""
    (tmp_path / "mine.yaml").write_text(MAT_MAPPING)
    content = {"log": {**MAT_CONTENT["log"], "gains": np.ones(5), "inertia": np.eye(3), "rpm": np.ones(NUM_SAMPLES)}}
    record = read(mat_file(content), tmp_path / "mine.yaml")
    for name in ("gains", "inertia"):
        (remark,) = [each for each in record.remarks if name in each]
        assert remark == f"log.{name} is not read: its length differs from the length of log.t"
    assert has_remark(record, "not read: log.rpm")
    content["log"]["p"] = np.ones((NUM_SAMPLES - 1, 3))
    shorter = read(mat_file(content), tmp_path / "mine.yaml")
    assert shorter.position is None
    assert has_remark(shorter, "log.p is not read: its length differs from the length of log.t")


def test_a_mat_file_in_hdf5_format_is_refused(read):
    with pytest.raises(InputError, match=r"MAT-file of version 7.3 \(HDF5\); save it in MATLAB with the option -v7"):
        read(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")


def check_ros(record):
    """Assert the values of the odometry, with velocity along the body axes, and of the IMU."""
    t = record.time
    np.testing.assert_allclose(record.position, np.column_stack([np.sin(t), 0.5 + 0.0 * t, 2.0 - t]), atol=1e-6)
    np.testing.assert_allclose(record.attitude, np.column_stack([0.0 * t, 0.0 * t, t]), atol=1e-9)
    np.testing.assert_allclose(record.velocity, np.column_stack([np.cos(t), np.sin(t), -1.0 + 0.0 * t]), atol=1e-9)
    np.testing.assert_allclose(record.body_rates[0], [0.1, 0.2, 1.0])
    np.testing.assert_allclose(record.specific_force[0], [0.0, 0.0, 9.81])
    assert has_remark(record, "velocity is turned from body axes to world axes by the attitude")


@pytest.mark.slow
@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("plugin", StoragePlugin)
def test_a_ros_2_bag_is_read_as_a_folder_and_as_a_file(tmp_path, plugin, version):
    file = ros_2_bag(tmp_path / "bag", plugin=plugin, version=version)
    for path in (tmp_path / "bag", file):
        check_ros(read_log(path))


@pytest.mark.parametrize("count", [0, 2])
def test_a_folder_with_several_files_of_a_bag_or_without_any_is_refused(tmp_path, count):
    (tmp_path / "metadata.yaml").touch()
    for i in range(count):
        (tmp_path / f"bag_{i}.mcap").touch()
    with pytest.raises(InputError, match=f"is a ROS 2 bag of {count} files; give the path of the file to read"):
        read_log(tmp_path)


def test_ros_messages_are_decoded_by_the_definitions_of_the_bag_or_the_standard_ones():
    store = typesys.get_typestore(typesys.Stores.LATEST)
    kind = "geometry_msgs/msg/Vector3"
    data = store.serialize_cdr(store.types[kind](x=1.0, y=2.0, z=3.0), kind)
    bag_definitions = {"geometry_msgs/Vector3": "float64 a\nfloat64 b\nfloat64 c"}
    for definitions, names in (({}, "xyz"), (bag_definitions, "abc"), ({"other_msgs/Other": "float64 a"}, "xyz")):
        decoder = _Decoder(typesys, definitions)
        for spelling in (kind, "geometry_msgs/Vector3"):
            result = decoder(data, spelling)
            assert [getattr(result, name) for name in names] == [1.0, 2.0, 3.0]


def rows_of(kind, *times, behind=None):
    """Return messages with their times in ns. The header of each message has a time that is `behind` ns earlier."""
    rows = _Rows(kind, ["x"])
    for time in times:
        stamp = 0 if behind is None else time - behind
        rows.append({"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}, "x": time}, time)
    return rows


def test_the_topic_with_most_messages_of_a_type_is_read():
    start = 5 * 10**9
    topics = {
        "/few": rows_of("sort/One", start + 3, start + 4),
        "/many": rows_of("sort/One", *range(start + 3, start + 6)),
        "/as_many": rows_of("sort/One", *range(start + 1, start + 4)),
        "/other": rows_of("sort/Other", start + 2),
    }
    content = _tables(topics, ("ros", None), [], [])
    assert [table.name for table in content.tables] == [*topics]
    of_types = {
        name: table.name for table in content.tables for name in table.columns if not name.startswith(table.name)
    }
    assert of_types == {"sort/One.x": "/many", "sort/Other.x": "/other"}
    assert content.remarks == ["3 topics have the type sort/One; /many is read, which has the most messages"]
    # Times are relative to the first message of any topic.
    for table, first in zip(content.tables, (2, 2, 0, 1), strict=True):
        np.testing.assert_allclose(table.time, 1e-9 * (first + np.arange(len(table.time))))


@pytest.mark.parametrize(
    ("behind", "are_used"),
    [(9 * 10**8, True), (-9 * 10**8, True), (11 * 10**8, False), (-11 * 10**8, False), (None, None)],
)
def test_header_stamps_are_used_if_they_have_the_clock_of_the_recording(behind, are_used):
    start = 5 * 10**12
    rows = rows_of("sort/One", *(start + 10**8 * i for i in range(5)), behind=behind)
    table, remarks = rows.table("/topic", start, with_type_names=False)
    np.testing.assert_allclose(table.time, 0.1 * np.arange(5))
    if are_used:
        np.testing.assert_allclose(table.sample_time, 0.1 * np.arange(5) - 1e-9 * behind, atol=1e-9)
        assert remarks == []
    else:
        assert table.sample_time is None
        assert remarks == [
            f"/topic: the header stamps are {1e-9 * each:g} s before the recording times, which are used instead"
            for each in ([] if are_used is None else [behind])
        ]


def content_of(*messages, error=None):
    """Return the content of a bag from its messages, each a pair of a topic and a number.

    A message without a number cannot be decoded. Reading ends with the given error, if any.
    """

    def decoding(number):
        if number is None:
            raise RuntimeError("damaged")
        return {"x": number}

    def read_one_by_one():
        for time, (topic, number) in enumerate(messages):
            yield _Message(topic, "sort/One", 1 + time, lambda number=number: decoding(number))
        if error is not None:
            raise error

    mapping = SimpleNamespace(names={"/a.x", "/b.x"})
    log = SimpleNamespace(mark="the log")
    return _content(log, ("mine", mapping), "a bag", read_one_by_one())


def test_a_damaged_bag_is_read_up_to_the_damage():
    result = content_of(("/a", 1.0), ("/a", None), ("/c", 2.0), ("/b", None), ("/b", 7.0), ("/a", 3.0))
    (table,) = result.tables
    np.testing.assert_array_equal(table.columns["/a.x"], [1.0, 3.0])
    # A topic whose first message cannot be decoded is left out.
    assert result.remarks == ["the messages of /b cannot be decoded"]
    assert result.names == ["/b", "/c"]
    error = ValueError(" no\n chunk ")
    result = content_of(("/a", 1.0), error=error)
    assert result.remarks == ["the log is truncated or damaged; it is read up to this error: no chunk"]
    for messages in ((), (("/c", 1.0),), (("/a", None),)):
        with pytest.raises(InputError, match="^the log: is a bag that cannot be read: no chunk$"):
            content_of(*messages, error=error)
    with pytest.raises(InputError, match="that cannot be read: EOFError$"):
        content_of(error=EOFError())
    with pytest.raises(InputError, match="^refused$"):
        content_of(error=InputError("refused"))
    with pytest.raises(InputError, match="without any topic of the mapping mine; its topics are /b, /c"):
        content_of(("/c", 1.0), ("/b", None))
    with pytest.raises(InputError, match="its topics are none$"):
        content_of()


@pytest.mark.slow
def test_a_ros_1_bag_is_read(tmp_path):
    check_ros(read_log(ros_1_bag(tmp_path / "flight.bag")))


def json_mcap():
    """Return an MCAP file with positions as JSON, in many small chunks."""
    file = io.BytesIO()
    writer = McapWriter(file, chunk_size=500)
    writer.start()
    schema = writer.register_schema("mine", "jsonschema", b"{}")
    channel = writer.register_channel("/state", "json", schema)
    for time in TIMES:
        content = {"pose": {"p": [1e-6 * float(time), 2.0, 3.0]}}
        stamp = 1000 * int(time) + 5
        writer.add_message(channel, log_time=stamp, publish_time=stamp, data=json.dumps(content).encode())
    writer.finish()
    return file.getvalue()


JSON_MCAP = json_mcap()


def test_json_messages_of_a_truncated_mcap_file_are_read_with_a_mapping(read, tmp_path):
    mapping = tmp_path / "mine.yaml"
    mapping.write_text('signals: {position: {columns: ["/state.pose.p[0]", "/state.pose.p[1]", "/state.pose.p[2]"]}}')
    record = read(JSON_MCAP, mapping)
    np.testing.assert_allclose(record.position[:, 0], SECONDS)
    np.testing.assert_allclose(record.time, SECONDS, atol=1e-9)
    with pytest.raises(InputError, match="without any topic of the mapping ros; its topics are /state"):
        read(JSON_MCAP)
    cut = read(JSON_MCAP[: len(JSON_MCAP) // 2], mapping)
    np.testing.assert_array_equal(cut.position, record.position[: len(cut.time)])
    assert 10 < len(cut.time) < NUM_SAMPLES
    assert has_remark(cut, "the log is truncated or damaged; it is read up to this error")


NANOBENCH_COLUMNS = [
    "t",
    "px",
    "py",
    "pz",
    "qx",
    "qy",
    "qz",
    "qw",
    "vx",
    "vy",
    "vz",
    "wx_vicon",
    "wy_vicon",
    "wz_vicon",
]
NANOBENCH_COLUMNS += [f"motor_motor_m{i}" for i in (1, 2, 3, 4)]


def test_rates_about_world_axes_are_converted_to_body_rates(read, tmp_path):
    """A vehicle that is rolled by 90° and turns about the vertical turns about its body y axis."""
    w, x, y, z = quaternion_of(0.5 * np.pi, 0.0, 0.0)
    cells = [0, 0, 1, x, y, z, w, 0, 0, 0, 0.0, 0.0, 1.5, *[32768] * 4]
    text = (
        "\n".join([",".join(NANOBENCH_COLUMNS), *(",".join(map(str, [0.01 * i, *cells])) for i in range(NUM_SAMPLES))])
        + "\n"
    )
    record = read(text.encode())
    assert has_remark(record, "the mapping is nanobench")
    np.testing.assert_allclose(record.body_rates, np.tile([0.0, 1.5, 0.0], (NUM_SAMPLES, 1)), atol=1e-9)
    mapping = tmp_path / "mine.yaml"
    rates = "time: {column: t}\nsignals: {body_rates: {columns: [wx_vicon, wy_vicon, wz_vicon], frame: NWU}%s}"
    mapping.write_text(rates % ", position: {columns: [px, py, pz]}")
    without_attitude = read(text.encode(), mapping)
    assert without_attitude.body_rates is None
    left_out = "body_rates is left out: it is along world axes, and no attitude is logged"
    assert left_out in without_attitude.remarks
    mapping.write_text(rates % "")
    with pytest.raises(InputError, match=f"has no signal that can be used: {left_out}"):
        read(text.encode(), mapping)


def written(tmp_path):
    """Return a log of each format that needs a library, with the name of the library."""
    return [
        (ARDUPILOT, "pymavlink", "ardupilot"),
        (BLACKBOX, "betaflight_chirp_core", "blackbox"),
        (ros_1_bag(tmp_path / "a.bag").read_bytes(), "rosbags", "ros"),
        (ros_2_bag(tmp_path / "b", plugin=StoragePlugin.SQLITE3).read_bytes(), "rosbags", "ros"),
        (ros_2_bag(tmp_path / "c", plugin=StoragePlugin.MCAP).read_bytes(), "mcap", "mcap"),
    ]


@pytest.mark.slow
def test_a_format_whose_library_is_missing_says_how_to_get_it(read, tmp_path, monkeypatch):
    for data, module, extra in written(tmp_path):
        with monkeypatch.context() as without:
            for name in [each for each in sys.modules if each.partition(".")[0] == module]:
                without.delitem(sys.modules, name)
            without.setitem(sys.modules, module, None)
            with pytest.raises(
                InputError, match=rf"is not installed; install it with: pip install 'drake_quad\[{extra}\]'"
            ):
                read(data)


@pytest.mark.slow
def test_each_log_is_recognised_as_one_format_even_if_compressed(tmp_path):
    logs = [each for each, *_ in written(tmp_path)] + [OLD_CRAZYFLIE, mat_file(MAT_CONTENT)]
    names = [[each.name for each in FORMATS if each.recognizes(LogFile(tmp_path, data, ()))] for data in logs]
    assert all(len(each) == 1 for each in names)
    assert len({name for (name,) in names}) == len(logs)
    (tmp_path / "log.bbl.xz").write_bytes(lzma.compress(BLACKBOX))
    record = read_log(tmp_path / "log.bbl.xz")
    assert (record.name, len(record.time)) == ("log", NUM_SAMPLES)


def test_shipped_mappings_are_valid():
    for name in shipped_mappings():
        assert load_mapping(name)[1].description
