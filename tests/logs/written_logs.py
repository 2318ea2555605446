"""Writers of small logs with known values, in each format."""

import struct
import zlib
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

DATA = Path(__file__).parents[1] / "data"


def crazyflie_log(event_types, records, *, version=2, checksum=True):
    """Return the bytes of a Crazyflie's log.

    Args:
        kinds: (id, name, [(variable, letter), ...]) of each event type.
        records: (id, time in µs or ms, values) of each record.
        version: version of the format.
        checksum: True if the log ends with a checksum.
    """
    data = struct.pack("<BHH", 0xBC, version, len(event_types))
    for identity, name, variables in event_types:
        data += struct.pack("<H", identity) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        for variable, letter in variables:
            data += f"{variable}({letter})".encode() + b"\0"
    formats = {identity: "".join(letter for _, letter in variables) for identity, _, variables in event_types}
    for identity, time, values in records:
        data += struct.pack("<HI" if version == 1 else "<HQ", identity, time)
        data += struct.pack("<" + formats[identity], *values)
    return data + struct.pack("<I", zlib.crc32(data)) if checksum else data


def ulog(topics, *, dropouts=(), start=1_000_000, parameters=None):
    """Return the bytes of a ULog.

    Args:
        topics: for each name, the fields after the time, [(type, field), ...], and rows of (time in µs, values).
        dropouts: (time in µs, length in ms), written before the first row that is later.
        start: start time of the log, µs.
        parameters: parameters of the vehicle, by name.
    """
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", start)
    data += message(b"B", bytes(40))
    letters = {"float": "f", "double": "d", "uint64_t": "Q", "int32_t": "i", "bool": "?", "uint8_t": "B"}
    for name, (fields, _) in topics.items():
        text = ";".join(["uint64_t timestamp", *(f"{kind} {field}" for kind, field in fields)])
        data += message(b"F", f"{name}:{text};".encode())
    for name, value in (parameters or {}).items():
        key = f"{'float' if isinstance(value, float) else 'int32_t'} {name}".encode()
        packed = struct.pack("<f" if isinstance(value, float) else "<i", value)
        data += message(b"P", bytes([len(key)]) + key + packed)
    for number, name in enumerate(topics):
        data += message(b"A", struct.pack("<BH", 0, number) + name.encode())
    rows = []
    for number, (fields, samples) in enumerate(topics.values()):
        layout = "<HQ"
        for kind, _ in fields:
            base, _, size = kind.rstrip("]").partition("[")
            layout += f"{size}{letters[base]}"
        rows += [(row[0], 1, message(b"D", struct.pack(layout, number, *row))) for row in samples]
    rows += [(time, 0, message(b"O", struct.pack("<H", length))) for time, length in dropouts]
    return data + b"".join(message for _, _, message in sorted(rows, key=lambda row: row[:2]))


def message(kind, content):
    """Return a message of a ULog as bytes, given its type and its content."""
    return struct.pack("<H", len(content)) + kind + content


def quaternion_of(roll, pitch, yaw):
    """Return the quaternion (w, x, y, z) of Z-Y-X angles, from half angles."""
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw))
    about_z, about_y, about_x = (c_y, 0.0, 0.0, s_y), (c_p, 0.0, s_p, 0.0), (c_r, s_r, 0.0, 0.0)
    return product(product(about_z, about_y), about_x)


def product(a, b):
    """Return the product of two quaternions (w, x, y, z)."""
    (a0, *av), (b0, *bv) = a, b
    return (a0 * b0 - np.dot(av, bv), *(a0 * np.array(bv) + b0 * np.array(av) + np.cross(av, bv)))


def old_crazyflie_log(columns, rows, *, block=7):
    """Return the bytes of a Crazyflie's log in the format used before 2021.

    Args:
        columns: (name, letter) of each column except the time.
        rows: (time in ms, values) of each row.
        block: number of rows per block.
    """

    def checked(data):
        return data + struct.pack("<I", ~zlib.crc32(data) & 0xFFFFFFFF)

    names = "".join(f"{name}({letter})," for name, letter in [("tick", "I"), *columns])
    data = checked(bytes([1 + len(columns)]) + names.encode())
    layout = "<I" + "".join(letter for _, letter in columns)
    for first in range(0, len(rows), block):
        part = rows[first : first + block]
        data += checked(bytes([len(part)]) + b"".join(struct.pack(layout, *row) for row in part))
    return data


def dataflash_log(messages, *, parameters=None):
    """Return the bytes of an ArduPilot log.

    Args:
        messages: for each name, (letters of the types, names of the fields after TimeUS, rows of (time in µs, values)).
        parameters: parameters of the vehicle, by name.
    """
    letters = {"Q": "Q", "f": "f", "c": "h", "C": "H", "h": "h", "H": "H", "B": "B", "N": "16s", "n": "4s", "Z": "64s"}

    def declared(number, name, types, fields):
        size = 3 + struct.calcsize("<" + "".join(letters[each] for each in types))
        return struct.pack(
            "<BBBBB4s16s64s", 0xA3, 0x95, 0x80, number, size, *(x.encode() for x in (name, types, fields))
        )

    data = declared(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    data += declared(1, "PARM", "QNf", "TimeUS,Name,Value")
    for name, value in (parameters or {}).items():
        data += struct.pack("<BBBQ16sf", 0xA3, 0x95, 1, 1, name.encode(), value)
    rows = []
    for number, (name, (types, fields, samples)) in enumerate(messages.items(), start=2):
        data += declared(number, name, "Q" + types, ",".join(["TimeUS", *fields]))
        layout = "<BBBQ" + "".join(letters[each] for each in types)
        rows += [(row[0], number, struct.pack(layout, 0xA3, 0x95, number, *row)) for row in samples]
    return data + b"".join(content for *_, content in sorted(rows))


def blackbox_log(fields, rows, *, headers=None, interval=8):
    """Return the bytes of a Betaflight log of one flight.

    Args:
        fields: names of the fields after loopIteration and time.
        rows: (time in µs, integer values) of each row.
        headers: further lines of the header, by name.
        interval: every `interval`-th row is written completely, and all other rows as differences from the row before.
    """
    names = ["loopIteration", "time", *fields]
    count = len(names)
    lines = {
        "Product": "Blackbox flight data recorder by Nicholas Sherlock",
        "Data version": 2,
        "I interval": interval,
        "P interval": "1/1",
        "Field I name": ",".join(names),
        "Field I signed": ",".join(["1"] * count),
        "Field I predictor": ",".join(["0"] * count),
        "Field I encoding": ",".join(["0"] * count),
        "Field P predictor": ",".join(["1"] * count),
        "Field P encoding": ",".join(["0"] * count),
        "Firmware revision": "Betaflight 4.3.1 (8d4f005) STM32F7X2",
        "acc_1G": 2048,
        "motorOutput": "48,2047",
        **(headers or {}),
    }
    data = "".join(f"H {name}:{value}\n" for name, value in lines.items()).encode()
    before = [0] * count
    for i, row in enumerate(rows):
        values = [i, *row]
        is_whole = i % interval == 0
        data += b"I" if is_whole else b"P"
        data += b"".join(_zigzag(value - (0 if is_whole else old)) for value, old in zip(values, before, strict=True))
        before = values
    return data + b"E\xffEnd of log\0"


def _zigzag(value):
    """Return a signed integer as bytes with seven bits each."""
    value = value << 1 ^ value >> 63
    data = b""
    while value > 0x7F:
        data += bytes([value & 0x7F | 0x80])
        value >>= 7
    return data + bytes([value])


def ros_messages(store, count=60, period=0.02):
    """Return (topic, type, time in ns, message) of odometry and IMU of a vehicle that turns about its z axis."""
    types = store.types
    header = types["std_msgs/msg/Header"]
    counter = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    nothing = np.zeros(9)
    for i in range(count):
        t = period * i
        stamp = types["builtin_interfaces/msg/Time"](sec=100, nanosec=round(1e9 * t))
        w, x, y, z = quaternion_of(0.0, 0.0, t)
        turn = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
        pose = types["geometry_msgs/msg/Pose"](position=point(x=np.sin(t), y=0.5, z=2.0 - t), orientation=turn)
        twist = types["geometry_msgs/msg/Twist"](
            linear=vector(x=1.0, y=0.0, z=-1.0), angular=vector(x=0.0, y=0.0, z=1.0)
        )
        odometry = types["nav_msgs/msg/Odometry"](
            header=header(**counter, stamp=stamp, frame_id="map"),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
        )
        imu = types["sensor_msgs/msg/Imu"](
            header=header(**counter, stamp=stamp, frame_id="base_link"),
            orientation=turn,
            orientation_covariance=nothing,
            angular_velocity=vector(x=0.1, y=0.2, z=1.0),
            angular_velocity_covariance=nothing,
            linear_acceleration=vector(x=0.0, y=0.0, z=9.81),
            linear_acceleration_covariance=nothing,
        )
        time = 100 * 10**9 + round(1e9 * t) + 2_000_000
        yield "/odom", "nav_msgs/msg/Odometry", time, odometry
        yield "/imu", "sensor_msgs/msg/Imu", time, imu


def ros_2_bag(folder, *, plugin, version=9):
    """Write the folder of a ROS 2 bag, and return its only file."""
    store = get_typestore(Stores.LATEST)
    with Rosbag2Writer(folder, version=version, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, time, content in ros_messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_cdr(content, kind))
    (file,) = (each for each in folder.iterdir() if each.suffix in (".db3", ".mcap"))
    return file


def ros_1_bag(path):
    """Write a ROS 1 bag, and return its path."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Rosbag1Writer(path) as writer:
        connections = {}
        for topic, kind, time, content in ros_messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, store.serialize_ros1(content, kind))
    return path
