"""Writes small logs, as a Crazyflie and PX4 write them, with numbers that a test knows."""

import struct
import zlib
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[1] / "data"


def crazyflie_log(kinds, records, *, version=2, checksum=True):
    """The bytes of a Crazyflie's log.

    Args:
        kinds: (id, name, [(variable, letter), ...]) of each event type.
        records: (id, time in µs or ms, values) in their order.
        version: of the format.
        checksum: whether it ends in one.
    """
    data = struct.pack("<BHH", 0xBC, version, len(kinds))
    for identity, name, variables in kinds:
        data += struct.pack("<H", identity) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        for variable, letter in variables:
            data += f"{variable}({letter})".encode() + b"\0"
    formats = {identity: "".join(letter for _, letter in variables) for identity, _, variables in kinds}
    for identity, time, values in records:
        data += struct.pack("<HI" if version == 1 else "<HQ", identity, time)
        data += struct.pack("<" + formats[identity], *values)
    return data + struct.pack("<I", zlib.crc32(data)) if checksum else data


def ulog(topics, *, dropouts=(), start=1_000_000, parameters=None):
    """The bytes of a ULog.

    Args:
        topics: by name, [(type, field), ...] after the time, and rows of (time in µs, values).
        dropouts: (time in µs, length in ms), written before the first row that is later.
        start: of the log, µs.
        parameters: by name, of the vehicle.
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
    """Of a ULog."""
    return struct.pack("<H", len(content)) + kind + content


def quaternion_of(roll, pitch, yaw):
    """w, x, y, z of a turn by the yaw about z, then the pitch about y, then the roll about x, from half angles."""
    (c_r, s_r), (c_p, s_p), (c_y, s_y) = ((np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw))
    about_z, about_y, about_x = (c_y, 0.0, 0.0, s_y), (c_p, 0.0, s_p, 0.0), (c_r, s_r, 0.0, 0.0)
    return product(product(about_z, about_y), about_x)


def product(a, b):
    """Of two quaternions (w, x, y, z)."""
    (a0, *av), (b0, *bv) = a, b
    return (a0 * b0 - np.dot(av, bv), *(a0 * np.array(bv) + b0 * np.array(av) + np.cross(av, bv)))
