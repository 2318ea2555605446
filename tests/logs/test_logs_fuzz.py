"""Tests that arbitrary bytes quickly give a valid record or a one-sentence error.

The environment variable `FUZZ_CASES` sets the number of cases.
"""

import functools
import io
import json
import os
import time

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin
from test_formats import ARDUPILOT, BLACKBOX, OLD_CRAZYFLIE
from test_ulog import ATTITUDE, LOCAL_POSITION_FIELDS, XYZ, rows
from written_logs import crazyflie_log, ros_1_bag, ros_2_bag, ulog

from drake_quad import InputError
from drake_quad.logs.reading import read_log

NUM_CASES = int(os.environ.get("FUZZ_CASES", "80"))
MAX_PROCESSOR_TIME = 2.0  # s of processor time per file


def fuzz(test, cases=NUM_CASES):
    limits = {"max_examples": cases, "derandomize": "FUZZ_CASES" not in os.environ, "database": None, "deadline": None}
    return settings(suppress_health_check=list(HealthCheck), **limits)(test)


VARIABLES = [[(f"gyro.{axis}", "f") for axis in "xyz"], [(f"stateEstimateZ.{axis}", "h") for axis in "xyz"]]
VARIABLES += [[("stateEstimateZ.quat", "I")], [(f"acc.{axis}", "d") for axis in "xyz"]]
CRAZYFLIE = crazyflie_log(
    [(i, f"event{i}", variables) for i, variables in enumerate(VARIABLES)],
    [(i % 4, 1000 * i, [i % 100] * len(VARIABLES[i % 4])) for i in range(60)],
)
ULOG = ulog(
    {
        "vehicle_local_position": (LOCAL_POSITION_FIELDS, rows(50_000, lambda t: (t, 2.0, -3.0, 0.1, 0.2, -0.3))),
        "vehicle_attitude": (ATTITUDE, rows(50_000, lambda t: (1.0, 0.0, 0.0, 0.0))),
        "vehicle_angular_velocity": (XYZ, rows(20_000, lambda t: (t, 0.2, -0.3), sampled=0)),
    },
    dropouts=[(1_500_000, 30)],
)
VECTOR, TURN = '"[1, 2, 3]"', '"[0, 0, 0, 1]"'
CELLS = f'"[0.1, 1, 2]",{VECTOR},{TURN},{VECTOR},[0.5],{TURN},{VECTOR},{VECTOR},{VECTOR}\n'
TABLE = ("t,p,v,q,w,T_sp,q_sp,p_d,v_d,fa\n" + "".join(f"{0.02 * i},{CELLS}" for i in range(20))).encode()
LOGS = [CRAZYFLIE, ULOG, TABLE]


def check(path, data):
    """Assert that a file quickly gives a record, which validates itself, or an error of one sentence."""
    path.write_bytes(data)
    start = time.process_time()
    try:
        record = read_log(path)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert record.names
        assert record.time[0] == 0.0
        assert all("\n" not in remark for remark in record.remarks)
        for _, values in record.signals():
            assert np.isfinite(values).all()
    assert time.process_time() - start < MAX_PROCESSOR_TIME


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("logs") / "log"


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS, ids=["crazyflie", "ulog", "table"])
@fuzz
@given(data=st.data())
def test_a_log_cut_anywhere_is_read_or_refused(log, path, data):
    check(path, log[: data.draw(st.integers(0, len(log)))])


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS, ids=["crazyflie", "ulog", "table"])
@fuzz
@given(data=st.data())
def test_a_log_with_flipped_bytes_is_read_or_refused(log, path, data):
    changed = bytearray(log)
    positions = st.integers(0, min(400, len(log) - 1)) | st.integers(0, len(log) - 1)
    for position in data.draw(st.lists(positions, min_size=1, max_size=8)):
        changed[position] = data.draw(st.integers(0, 255))
    check(path, bytes(changed))


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS, ids=["crazyflie", "ulog", "table"])
@fuzz
@given(data=st.data())
def test_a_log_with_repeated_removed_or_inserted_pieces_is_read_or_refused(log, path, data):
    first, second = sorted(data.draw(st.tuples(*[st.integers(0, len(log))] * 2)))
    middle = data.draw(st.sampled_from([b"", log[first:second] * 2]) | st.binary(max_size=40))
    check(path, log[:first] + middle + log[second:])


OTHER_FORMATS = ["ardupilot", "betaflight", "old crazyflie", "matlab", "ros 1", "ros 2", "mcap"]


@pytest.fixture(scope="module")
def logs_by_format(tmp_path_factory):
    """Return a log of each format in `OTHER_FORMATS`. Libraries read most of these formats."""
    folder = tmp_path_factory.mktemp("bags")
    bags = [ros_2_bag(folder / plugin.name, plugin=plugin) for plugin in (StoragePlugin.SQLITE3, StoragePlugin.MCAP)]
    mat = io.BytesIO()
    scipy.io.savemat(mat, {"time": np.arange(60.0), "pos": np.ones((60, 3)), "quat": np.ones((60, 4))})
    bags = [path.read_bytes() for path in (ros_1_bag(folder / "a.bag"), *bags)]
    return dict(zip(OTHER_FORMATS, [ARDUPILOT, BLACKBOX, OLD_CRAZYFLIE, mat.getvalue(), *bags], strict=True))


@pytest.mark.long
@pytest.mark.parametrize("name", OTHER_FORMATS)
@functools.partial(fuzz, cases=max(NUM_CASES // 4, 10))
@given(data=st.data())
def test_damaged_logs_of_other_formats_are_read_or_refused(logs_by_format, name, path, data):
    log = bytearray(logs_by_format[name])
    if data.draw(st.booleans()):
        log = log[: data.draw(st.integers(0, len(log)))]
    positions = st.integers(0, max(min(400, len(log) - 1), 0)) | st.integers(0, max(len(log) - 1, 0))
    for position in data.draw(st.lists(positions, max_size=8)):
        log[position : position + 1] = bytes([data.draw(st.integers(0, 255))])
    first, second = sorted(data.draw(st.tuples(*[st.integers(0, len(log))] * 2)))
    check(
        path,
        bytes(log[:first] + data.draw(st.binary(max_size=40)) + log[second if data.draw(st.booleans()) else first :]),
    )


FILE_BEGINNINGS = [b"", b"\xbc", b"\xbc\2\0", b"\xbc\1\0\1\0", b"ULog\x01\x12\x35", b"\x1f\x8b", b"\xfd7zXZ\0"]
FILE_BEGINNINGS += [
    b"\xa3\x95\x80",
    b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n",
    b"\2tick(I),",
    b"MATLAB 5.0 ",
]
FILE_BEGINNINGS += [b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"]


@fuzz
@given(start=st.sampled_from(FILE_BEGINNINGS), rest=st.binary(max_size=200))
def test_random_bytes_are_read_or_refused(path, start, rest):
    check(path, start + rest)


YAML_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["t", "p", "wxyz", "NED", "mm", "x"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["columns", "column", "unit", "frame", "factor", "quaternion", "rotors"]), inner
        )
        | st.dictionaries(st.sampled_from(["position", "attitude", "motor_command", "wind", "signals", "time"]), inner)
    ),
    max_leaves=8,
)


@pytest.mark.long
@fuzz
@given(
    signals=st.dictionaries(st.sampled_from(["position", "attitude", "motor_command", "wind"]), YAML_VALUES),
    rest=YAML_VALUES,
)
def test_random_mappings_are_loaded_or_refused(path, signals, rest):
    log = path.with_suffix(".csv")
    log.write_bytes(TABLE)
    mapping = {"time": {"column": "t"}, "signals": signals} | (rest if isinstance(rest, dict) else {})
    path.with_suffix(".yaml").write_text(json.dumps(mapping))
    try:
        read_log(log, path.with_suffix(".yaml"))
    except InputError as error:
        assert str(path.with_suffix("")) in str(error)
