"""Tests that logs with impossible values give a record of finite signals or a one-sentence error, in each format."""

import io

import numpy as np
import pytest
import scipy.io
from written_logs import blackbox_log, crazyflie_log, dataflash_log, old_crazyflie_log, quaternion_of, ulog

from drake_quad import InputError
from drake_quad.logs.reading import read_log

COUNT = 240  # samples of a log
PERIOD = 0.02  # s, sampling period
INTEGER_LIMIT = 2.0**62
RNG = np.random.default_rng(8)


def flight():
    """Return a flight in SI units: time (n, 1), position, velocity, attitude, body rates, throttles (n, 4)."""
    time = PERIOD * np.arange(COUNT)[:, None]
    rates = np.array([2.0, 2.6, 1.7])
    position, velocity = np.sin(rates * time), rates * np.cos(rates * time)
    attitude, body_rates = 0.2 * np.sin(rates * time), 0.2 * rates * np.cos(rates * time)
    throttles = 0.5 + 0.1 * np.sin(time + np.arange(4.0))
    return {
        "time": time,
        "position": position,
        "velocity": velocity,
        "attitude": attitude,
        "body_rates": body_rates,
        "throttles": throttles,
    }


def set_values(rows, value):
    """Return a mutation that overwrites some samples of every signal."""

    def mutate(log):
        return {name: np.where(np.isin(np.arange(COUNT)[:, None], np.arange(COUNT)[rows]) & (name != "time"), value, x)
                for name, x in log.items()}  # fmt: skip

    return mutate


def of_signal(name, change):
    """Return a function that applies `change` to one signal of a log."""
    return lambda log: log | {name: change(log[name])}


def from_rows(choose):
    """Return a function that selects, repeats or reorders the rows of a log."""
    return lambda log: {name: values[choose(np.arange(COUNT))] for name, values in log.items()}


SIGNALS = ("position", "velocity", "attitude", "body_rates", "throttles")
MUTATIONS = {
    "nothing": lambda log: log,
    "a run of NaN": set_values(slice(50, 90), np.nan),
    "an infinite sample": set_values(slice(50, 51), np.inf),
    "nothing but NaN": set_values(slice(None), np.nan),
    "constant": set_values(slice(None), 0.5),
    "zeros at the end": set_values(slice(-60, None), 0.0),
    "huge": set_values(slice(60, 62), 1e30),
    "beyond single precision": set_values(slice(60, None), -1e300),
    "columns swapped": lambda log: {name: values[:, ::-1] for name, values in log.items()},
    "signals swapped": lambda log: log | {"position": log["body_rates"], "attitude": log["velocity"]},
    "no rows": from_rows(lambda rows: rows[:0]),
    "one row": from_rows(lambda rows: rows[:1]),
    "two rows": from_rows(lambda rows: rows[:2]),
    "rows repeated": from_rows(lambda rows: np.repeat(rows, 2)),
    "rows shuffled": from_rows(lambda rows: RNG.permutation(rows)),
    "rows reversed": from_rows(lambda rows: rows[::-1]),
    "a gap": from_rows(lambda rows: np.concatenate([rows[:60], rows[180:]])),
    "time goes back": of_signal("time", lambda time: np.where(time > 2.0, time - 1.0, time)),
    "time stands still": of_signal("time", lambda time: 0.0 * time),
    "time in ms": of_signal("time", lambda time: 1e3 * time),
    "time 50 times too slow": of_signal("time", lambda time: 50.0 * time),
    "a sample a second": lambda log: log | {"time": 50.0 * log["time"], "position": 50.0 * log["position"]},
    "time in thousands of seconds": of_signal("time", lambda time: 1e-3 * time),
    "time before zero": of_signal("time", lambda time: time - 1e3),
    "time jumps": of_signal("time", lambda time: np.where(time > 2.0, time + 1e9, time)),
    "throttles below zero": of_signal("throttles", lambda values: -values),
    "throttles beyond one": of_signal("throttles", lambda values: 100.0 * values),
    "attitude in degrees": of_signal("attitude", np.degrees),
    "attitude wrapped": of_signal("attitude", lambda values: values % 0.1),
} | {f"{name} has the wrong sign": of_signal(name, np.negative) for name in SIGNALS}


def integer(value, bits):
    """Return a value as a signed integer that overflows, as in C; NaN is 0."""
    rounded = int(
        np.clip(np.nan_to_num(value, posinf=INTEGER_LIMIT, neginf=-INTEGER_LIMIT), -INTEGER_LIMIT, INTEGER_LIMIT)
    )
    return (rounded + (1 << bits - 1)) % (1 << bits) - (1 << bits - 1)


def single(values):
    with np.errstate(over="ignore"):
        return [float(each) for each in np.asarray(values, dtype=np.float32)]


def ticks(log, per_second=1e6):
    return [integer(1e6 + per_second * time, 62) % 2**62 for time in log["time"][:, 0]]


def quaternions(log):
    return np.array([quaternion_of(*row) for row in log["attitude"]]).reshape(-1, 4)


def as_ulog(log):
    pose = np.hstack([log["position"], log["velocity"]])
    topics = {
        "vehicle_local_position": ([("float", name) for name in ("x", "y", "z", "vx", "vy", "vz")], pose),
        "vehicle_attitude": ([("float[4]", "q")], quaternions(log)),
        "sensor_combined": ([("float[3]", "gyro_rad")], log["body_rates"]),
        "actuator_motors": ([("float[4]", "control")], log["throttles"]),
    }
    times = ticks(log)
    return ulog(
        {
            name: (fields, [(time, *single(row)) for time, row in zip(times, values, strict=True)])
            for name, (fields, values) in topics.items()
        }
    )


def as_dataflash(log):
    times = ticks(log)

    def rows(values, convert):
        return [(time, *convert(row)) for time, row in zip(times, values, strict=True)]

    def shorts(row):
        return [integer(value, 16) % 2**15 for value in row]

    return dataflash_log(
        {
            "ATT": ("ccC", ["Roll", "Pitch", "Yaw"], rows(100.0 * np.degrees(log["attitude"]), shorts)),
            "IMU": ("fff", ["GyrX", "GyrY", "GyrZ"], rows(log["body_rates"], single)),
            "XKF1": (
                "ffffff",
                ["VN", "VE", "VD", "PN", "PE", "PD"],
                rows(np.hstack([log["velocity"], log["position"]]), single),
            ),
            "RCOU": ("HHHH", ["C1", "C2", "C3", "C4"], rows(1000.0 + 1000.0 * log["throttles"], shorts)),
        }
    )


def as_blackbox(log):
    fields = [*(f"gyroADC[{i}]" for i in range(3)), *(f"motor[{i}]" for i in range(4))]
    values = np.hstack([np.degrees(log["body_rates"]), 48.0 + 2000.0 * log["throttles"]])
    rows = [(time, *(integer(each, 32) for each in row)) for time, row in zip(ticks(log), values, strict=True)]
    return blackbox_log(fields, rows)


def crazyflie_columns(log):
    names = [f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")]
    names += [f"gyro.{axis}" for axis in "xyz"]
    letters = [(name, "f") for name in names] + [(f"motor.m{i}", "H") for i in range(1, 5)]
    angles = np.degrees(log["attitude"]) * [1.0, -1.0, 1.0]
    floats = np.hstack([log["position"], log["velocity"], angles, np.degrees(log["body_rates"])])
    motors = 65535.0 * log["throttles"]
    rows = [
        (*single(row), *(integer(each, 17) % 2**16 for each in motor))
        for row, motor in zip(floats, motors, strict=True)
    ]
    return letters, rows


def as_crazyflie(log):
    letters, rows = crazyflie_columns(log)
    return crazyflie_log([(0, "fixed", letters)], [(0, *each) for each in zip(ticks(log), rows, strict=True)])


def as_old_crazyflie(log):
    letters, rows = crazyflie_columns(log)
    return old_crazyflie_log(letters, [(time % 2**32, *row) for time, row in zip(ticks(log, 1e3), rows, strict=True)])


def as_matlab(log):
    content = io.BytesIO()
    values = {"time": log["time"][:, 0], "pos": log["position"], "vel": log["velocity"], "quat": quaternions(log)}
    scipy.io.savemat(content, values | {"ang_vel": log["body_rates"], "rotor_vel": 2e4 * log["throttles"]})
    return content.getvalue()


def as_csv(log):
    names = ["time", *(f"{name}_{axis}" for name in ("pos", "vel") for axis in "xyz")]
    names += [*(f"quat_{axis}" for axis in "wxyz"), *(f"ang_vel_{axis}" for axis in "xyz")]
    values = np.hstack([log["time"], log["position"], log["velocity"], quaternions(log), log["body_rates"]])
    return "\n".join([",".join(names), *(",".join(f"{each:.9g}" for each in row) for row in values), ""]).encode()


WRITERS = [as_ulog, as_dataflash, as_blackbox, as_crazyflie, as_old_crazyflie, as_matlab]
# All formats share the processing of values, so each mutation is tested in CSV and in one binary format.
CASES = [(mutation, as_csv) for mutation in MUTATIONS]
CASES += [(mutation, WRITERS[i % len(WRITERS)]) for i, mutation in enumerate(MUTATIONS)]
CASES += [("nothing", write) for write in WRITERS[1:]]


@pytest.mark.parametrize(
    ("mutation", "write"), CASES, ids=[f"{mutation}-{write.__name__[3:]}" for mutation, write in CASES]
)
def test_a_log_with_impossible_values_is_read_or_refused_with_one_sentence(mutation, write, tmp_path):
    path = tmp_path / "log"
    with np.errstate(all="ignore"):
        path.write_bytes(write(MUTATIONS[mutation](flight())))
    try:
        record = read_log(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert mutation != "nothing"
    else:
        assert np.all(np.diff(record.time) > 0.0)
        for name, values in record.signals():
            assert np.isfinite(values).all(), name
