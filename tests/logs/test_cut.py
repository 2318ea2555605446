"""Tests that all complete records of a truncated or padded log are read, and that a remark counts the other bytes."""

import lzma
import random
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from written_logs import DATA, crazyflie_log, message, ulog

from drake_quad import InputError
from drake_quad.logs.reading import read_log
from drake_quad.logs.source import LogFile

PADDING_BYTES = [b"\0", b"\xff"]
NUM_SAMPLES = 40  # samples of each log
GYRO = [(f"gyro.{axis}", "f") for axis in "xyz"]
# One of the two event types has the id 0xffff, so padding with bytes 0xff looks like a record of this type.
CRAZYFLIE = crazyflie_log(
    [(0xFFFF, "fixedFrequency", GYRO), (0, "other", [("foo.bar", "h")])],
    [
        each
        for i in range(NUM_SAMPLES)
        for each in ((0xFFFF, 1000 * (i + 1), (i, 2.0, 3.0)), (0, 1000 * (i + 1), (1,)))[: 1 + i % 2]
    ],
)
ULOG = ulog(
    {
        "vehicle_angular_velocity": (
            [("uint64_t", "timestamp_sample"), ("float[3]", "xyz")],
            [(1_000_000 + 4000 * i, 1_000_000 + 4000 * i, float(i), 0.2, 0.3) for i in range(NUM_SAMPLES)],
        )
    }
)
TABLE = ("time,gyro.x (°/s),rate\n" + "".join(f"{0.01 * (i + 1):.2f},ä,{i}.25\n" for i in range(NUM_SAMPLES))).encode()
MAPPING = "time: {column: time}\nsignals: {body_rates: {columns: [rate, rate, rate]}}"
# Each entry holds a log, the position of its first record and the size of its largest record, in bytes.
LOGS = {
    "crazyflie": (CRAZYFLIE, CRAZYFLIE.index(b"foo.bar(h)\0") + 11, 34),
    "ulog": (ULOG, ULOG.rindex(b"vehicle_angular_velocity") + 24, 33),
    "table": (TABLE, TABLE.index(b"\n") + 1, 16),
}


@pytest.fixture
def read(tmp_path):
    mapping = tmp_path / "mapping.yaml"
    mapping.write_text(MAPPING)

    def read_one(data):
        path = tmp_path / "log"
        path.write_bytes(data)
        return read_log(path, *[mapping] * data.startswith(b"time"))

    return read_one


def unread(record):
    return [remark for remark in record.remarks if "not read: " in remark and "the last " in remark]


@pytest.mark.parametrize("fill", PADDING_BYTES)
@pytest.mark.parametrize("count", [1, 2, 3, 8, 40, 5_000, 400_000])
@pytest.mark.parametrize("name", LOGS)
def test_a_log_that_was_padded_at_a_loss_of_power_is_read_completely(read, name, count, fill):
    data, *_ = LOGS[name]
    complete, padded = read(data), read(data + count * fill)
    assert not unread(complete)
    for signal, values in complete.signals():
        np.testing.assert_array_equal(padded.of(signal), values)
    bytes_ = f"{count:,} bytes are" if count > 1 else "byte is"
    padding = "0xff" if fill == b"\xff" else "zeros"
    assert unread(padded) == [f"the last {bytes_} not read: all {padding}, as after a loss of power"]
    assert not any("checksum" in remark for remark in padded.remarks)


@pytest.mark.parametrize("name", LOGS)
def test_garbage_after_a_complete_log_is_left_out(read, name):
    data, *_ = LOGS[name]
    complete, padded = read(data), read(data + b"\x80\x81\x82" + random.Random(1).randbytes(500))
    np.testing.assert_array_equal(padded.body_rates, complete.body_rates)
    (remark,) = [each for each in padded.remarks if "503 bytes are not read" in each or "damaged" in each]
    assert "503 bytes" in remark or f"from byte {len(data):,} on" in remark


@pytest.mark.parametrize("fill", [b"", *PADDING_BYTES])
@pytest.mark.parametrize("name", LOGS)
def test_a_truncated_log_is_read_to_its_last_complete_record(read, name, fill):
    """The samples equal the first samples of the complete log. At most one complete record is lost."""
    data, first, longest = LOGS[name]
    complete = read(data)
    # Positions 53 bytes apart truncate a record in all of its parts.
    for position in range(first + 3 * longest, len(data) - 1, 53):
        cut = read(data[:position] + 300 * fill)
        samples = len(cut.time)
        np.testing.assert_array_equal(cut.body_rates, complete.body_rates[:samples])
        np.testing.assert_allclose(cut.time, complete.time[:samples], atol=1e-12)
        records = (position - first) // longest
        assert samples >= records - 1
        lost = [
            *unread(cut),
            *(remark for remark in cut.remarks if "line has no end" in remark or "checksum" in remark),
        ]
        if fill:
            count = int(unread(cut)[0].split()[2].replace(",", ""))
            assert 0 <= count - 300 <= longest
        elif name == "ulog":
            assert len(lost) == ((position - first) % longest > 0)
        else:
            assert lost or data[position - 1 : position] == b"\n"


@pytest.mark.long
@pytest.mark.parametrize("fill", PADDING_BYTES)
@pytest.mark.parametrize("file", ["px4/sample_px4_events.ulg.xz", "crazyflie/crazyswarm2/log100.xz"])
def test_real_logs_are_read_when_padded_and_when_truncated(read, file, fill):
    data = lzma.decompress((DATA / file).read_bytes())
    complete, padded = read(data), read(data + 1_000_000 * fill)
    for signal, values in complete.signals():
        np.testing.assert_array_equal(padded.of(signal), values)
    assert [remark.split(":")[0] for remark in unread(padded)] == ["the last 1,000,000 bytes are not read"]
    for fraction in (0.3, 0.7):
        position = int(fraction * len(data))
        cut = read(data[:position] + bytes(-position % 4096))
        assert len(unread(cut)) == 1
        samples = len(cut.time)
        assert samples < len(complete.time)
        # The samples of a truncated ULog may be those of another topic, because the fastest topic may end early.
        if "crazyflie" in file:
            assert samples == pytest.approx(fraction * len(complete.time), rel=0.02)
            np.testing.assert_array_equal(cut.body_rates, complete.body_rates[:samples])


def test_a_ulog_is_read_up_to_where_pyulog_fails(read):
    complete, damaged = read(ULOG), read(ULOG + bytes(40_000) + b"\1")
    np.testing.assert_array_equal(damaged.body_rates, complete.body_rates)
    assert any(f"damaged from byte {len(ULOG):,} on" in remark for remark in damaged.remarks)
    assert unread(damaged) == ["the last 40,001 bytes are not read: pyulog cannot continue there"]


def test_damage_is_reported_once(read):
    record = read(ULOG + 20 * b"\1\0\0" + b"\1")
    assert [remark for remark in record.remarks if "damaged" in remark] == [
        f"the log is damaged from byte {len(ULOG):,} on; only complete messages that pyulog finds are read"
    ]


def test_a_complete_message_of_an_unknown_topic_is_reported(read):
    """PyULog cannot assign a message of an unknown topic."""
    complete, damaged = read(ULOG), read(ULOG + message(b"D", struct.pack("<HQ", 77, 2_000_000)))
    np.testing.assert_array_equal(damaged.body_rates, complete.body_rates)
    remark = "the log is damaged; only the complete messages that pyulog finds are read"
    assert [remark in record.remarks for record in (complete, damaged)] == [False, True]


def test_a_log_ends_at_its_checksum_even_if_the_checksum_looks_like_a_record(read):
    """The checksum and the following bytes have the form of an event with a valid type."""
    log = crazyflie_log([(0xFFFF, "fixedFrequency", GYRO)], [(0xFFFF, 1000 * i, (i, 2.0, 3.0)) for i in range(3)])
    before = zlib.crc32(log[:-8])
    values = (struct.pack("<f", value) for value in range(1_000_000))
    last = next(each for each in values if zlib.crc32(each, before) & 0xFFFF == 0xFFFF)
    log = log[:-8] + last + struct.pack("<I", zlib.crc32(last, before))
    complete, padded = read(log), read(log + 300 * b"\xff")
    np.testing.assert_array_equal(padded.body_rates, complete.body_rates)
    assert padded.remarks[0] == "the last 300 bytes are not read: all 0xff, as after a loss of power"


def test_the_wrong_checksum_of_a_damaged_log_is_not_a_lost_record(read):
    damaged = bytearray(CRAZYFLIE)
    damaged[-30] ^= 1
    record = read(bytes(damaged))
    assert record.remarks[0] == "the checksum is wrong: the log is truncated or damaged"
    assert not unread(record)


@pytest.mark.parametrize(
    "data", [b"PK\x03\x04\x14\0" + bytes(30), b"\x89PNG\r\n\x1a\n" + bytes(30), bytes(30)], ids=["zip", "png", "zeros"]
)
def test_a_binary_file_in_an_unknown_format_is_refused(read, data):
    with pytest.raises(InputError, match="is not a log in a known format: ArduPilot's .*, PX4's ULog, or CSV"):
        read(data)


@pytest.mark.parametrize(
    ("data", "written"),
    [(b"flight", 6), (b"log\0\0\0", 3), (b"log\xff\xff", 3), (b"log\0\xff", 4), (b"loggg", 5), (b"\0\0", 0), (b"", 0)],
)
def test_zeros_and_bytes_of_255_at_the_end_of_a_file_are_padding(data, written):
    """Any other repeated byte is part of the log."""
    assert LogFile(Path("log"), data, ()).written_size == written


@pytest.mark.parametrize(
    ("rest", "sentence"),
    [
        (b"\0", "the last byte is not read: all zeros, as after a loss of power"),
        (b"\xff\xff", "the last 2 bytes are not read: all 0xff, as after a loss of power"),
        (b"\0\xff", "the last 2 bytes are not read: no message"),
        (b"a" * 1500, "the last 1,500 bytes are not read: no message"),
    ],
)
def test_bytes_that_are_not_read_are_counted_and_explained(rest, sentence):
    assert LogFile(Path("log"), b"log" + rest, ()).unread_remark(3, "no message") == sentence
