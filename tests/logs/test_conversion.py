"""Tests of the conversion of columns to signals on one clock: choice of clock and signals, and interpolation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.logs import conversion
from drake_quad.logs.conversion import Table
from drake_quad.logs.mapping import Mapping, SignalSource

# Numbers of columns of the signals that do not have three columns.
NUM_COLUMNS = {"motor_command": 4, "thrust_fraction": 1, "reference_yaw": 1, "battery_voltage": 1}


def channel(signal, begin, end, period, *, known=None, values=None):
    """Return a signal with a separate clock. `known` selects the times at which the signal has values."""
    clock = begin + period * np.arange(round((end - begin) / period) + 1)
    rows = np.arange(len(clock)) if known is None else np.flatnonzero(known(clock))
    if values is None:
        values = np.repeat(clock[rows][:, None], NUM_COLUMNS.get(signal, 3), axis=1)
    return conversion._Channel(signal, clock, rows, values, SignalSource(columns=("a", "b"), unit="mm"))


def test_commands_are_held_between_samples_and_measurements_are_not():
    for name in ("motor_command", "thrust_fraction", "battery_voltage", "torque_command", "reference_position"):
        assert conversion.is_held(name)
    for name in ("position", "attitude", "body_rates", "specific_force", "wind", "hover_thrust_fraction"):
        assert not conversion.is_held(name)


@pytest.mark.parametrize(("lasts", "taken"), [(4.9, False), (5.1, True)])
def test_the_record_uses_the_clock_of_the_fastest_measurement_that_covers_half_of_the_log(lasts, taken):
    slow, fast = channel("position", 0.0, 10.0, 0.01), channel("body_rates", 2.0, 2.0 + lasts, 0.002)
    commands = channel("motor_command", 0.0, 10.0, 0.001)
    for channels in ([slow, fast, commands], [commands, fast, slow]):
        assert conversion._fastest(channels) is (fast if taken else slow).clock
    assert conversion._fastest([commands, channel("thrust_fraction", 0.0, 10.0, 0.01)]) is commands.clock
    # The rate of a clock follows from its median step, so gaps do not matter.
    gapped = slow._replace(clock=np.where(slow.clock > 5.0, slow.clock + 50.0, slow.clock))
    assert conversion._fastest([gapped, channel("velocity", 0.0, 60.0, 0.02)]) is gapped.clock


def test_signals_present_for_less_than_half_of_the_time_are_left_out():
    clock = channel("body_rates", 1.0, 11.0, 0.01).clock
    for begin, end, fraction in (
        (1.0, 5.9, 0.49),
        (1.0, 6.1, 0.51),
        (6.1, 99.0, 0.49),
        (5.9, 99.0, 0.51),
        (12.0, 13.0, 0),
    ):
        chosen, remarks = conversion._sufficiently_logged([channel("position", begin, end, 0.1)], clock)
        assert bool(chosen) == (fraction > 0.5)
        assert remarks == (
            [] if fraction > 0.5 else [f"position is left out: it is logged for {fraction:.0%} of the time"]
        )
    # A command is held until the end. A slow signal is extended by its first and last value.
    assert conversion._sufficiently_logged([channel("thrust_fraction", 1.0, 2.0, 0.1)], clock)[0]
    assert not conversion._sufficiently_logged([channel("thrust_fraction", 6.2, 7.0, 0.1)], clock)[0]
    assert conversion._sufficiently_logged([channel("wind", 10.0, 10.5, 0.1)], clock)[0]
    # Times at which a signal is NaN are not among the times at which it is logged.
    for known, fraction in ((4.4, 0.44), (5.6, 0.56)):
        half = channel("velocity", 1.0, 11.0, 0.1, known=lambda time, known=known: time < 1.0 + known)
        full = half._replace(rows=np.append(half.rows[:-1], len(half.clock) - 1))
        assert bool(conversion._sufficiently_logged([full], clock)[0]) == (fraction > 0.5)


def test_a_record_has_the_samples_at_which_all_signals_are_known():
    clock = 0.1 * np.arange(101)
    starting_late, ending_early = channel("position", 2.05, 12.0, 0.1), channel("velocity", -0.05, 8.55, 0.1)
    inside, remarks = conversion._common_samples([starting_late, ending_early], clock)
    np.testing.assert_array_equal(inside, (clock >= 2.05) & (clock <= 8.55 + 1e-9))
    assert remarks == [
        "the first 2.05 s are left out: position is not logged yet",
        "the last 1.45 s are left out: velocity is no longer logged",
    ]
    # The record begins when all signals have started; slow signals may start later. A command that ends early is held.
    held, slow = channel("motor_command", 3.0, 4.0, 0.1), channel("battery_voltage", 6.0, 7.0, 0.1)
    inside, remarks = conversion._common_samples([channel("position", 0.0, 10.0, 0.1), held, slow], clock)
    np.testing.assert_array_equal(inside, clock >= 3.0)
    assert remarks == ["the first 3 s are left out: motor_command is not logged yet"]
    assert conversion._common_samples([held], clock)[1] == remarks
    inside, _ = conversion._common_samples([slow], clock)
    np.testing.assert_array_equal(inside, clock >= 6.0)


def test_measurements_are_interpolated_commands_are_held_and_angles_turn_the_shorter_way():
    clock = 0.1 * np.arange(60)
    inside = (clock > 0.55) & (clock < 5.0)
    measured = conversion._resampled(channel("position", 0.03, 5.9, 0.25), clock, inside)
    np.testing.assert_allclose(measured, np.tile(clock[inside][:, None], 3))
    held = conversion._resampled(channel("thrust_fraction", 0.0, 5.9, 0.25), clock + 1e-9, inside)
    np.testing.assert_allclose(held, np.floor((clock[inside] + 1e-9) / 0.25) * 0.25)
    # A command has the value of its first sample at all earlier times.
    before = conversion._resampled(channel("thrust_fraction", 3.0, 5.0, 0.5), clock, inside)
    np.testing.assert_allclose(before[clock[inside] < 3.0], 3.0)
    for signal in ("attitude", "attitude_command", "reference_yaw"):
        turning = channel(signal, 0.0, 6.0, 0.25)
        yaw = 3.0 * turning.values
        wrapped = turning._replace(values=np.arctan2(np.sin(yaw), np.cos(yaw)))
        actual = conversion._resampled(wrapped, clock, inside)
        assert np.abs(actual).max() <= np.pi
        if not conversion.is_held(signal):
            expected = np.broadcast_to(3.0 * clock[inside][:, None], actual.shape)
            np.testing.assert_allclose(np.exp(1j * actual), np.exp(1j * expected), atol=1e-9)
    # A signal on the record's clock is unchanged, unless some of its values are missing.
    complete = channel("position", 0.0, 5.9, 0.1, values=np.random.default_rng(1).normal(size=(60, 3)))
    np.testing.assert_array_equal(conversion._resampled(complete, complete.clock, inside), complete.values[inside])
    incomplete = complete._replace(rows=np.delete(complete.rows, 30), values=np.delete(complete.values, 30, axis=0))
    actual = conversion._resampled(incomplete, complete.clock, inside)
    expected = complete.values.copy()
    expected[30] = 0.5 * (complete.values[29] + complete.values[31])
    np.testing.assert_allclose(actual, expected[inside])


@pytest.mark.parametrize(
    ("unit", "scale", "minimum", "maximum"),
    [("1", 1.0, -0.5, 1.5), ("uint16", 65535.0, -1e-3, 1.001), ("%", 100.0, -0.5, 1.5)],
)
def test_rows_with_impossible_commands_are_left_out_as_damaged(unit, scale, minimum, maximum):
    source = {"columns": ["a", "b", "c", "d"], "unit": unit}
    mapping = Mapping(signals={"motor_command": source})
    width = maximum - minimum
    for command, damaged in (
        (minimum + 1e-4 * width, False),
        (minimum - 1e-4 * width, True),
        (maximum - 1e-4 * width, False),
        (maximum + 1e-4 * width, True),
    ):
        columns = {name: np.zeros(5) for name in "abcd"}
        columns["c"][[2, 4]] = command * scale
        table = Table("motors", 7.0 + np.arange(5.0), columns, 6.9 + np.arange(5.0))
        remarks = []
        result = conversion._without_damaged_rows(table, mapping, remarks)
        if damaged:
            assert result.time.tolist() == [7.0, 8.0, 10.0]
            np.testing.assert_allclose(result.sample_time, [6.9, 7.9, 9.9])
            assert len(result.columns["a"]) == 3
            (remark,) = remarks
            assert remark.startswith(
                "2 of 5 samples are left out, first at 2 s: the log is damaged, with motor commands"
            )
            assert remark.endswith(f" of up to {abs(command):.3g} times the full command")
        else:
            assert (result is table, remarks) == (True, [])
    other_table = Table("other", np.arange(3.0), {"a": np.full(3, 9e9)})
    assert conversion._without_damaged_rows(other_table, mapping, []) is other_table


def test_unread_columns_are_reported_by_group():
    """The group is the part of a name before the first dot or bracket.

    If some columns of a group are read, up to six unread ones are listed by name.
    """
    read_columns = {"imu.x", "imu.y"}
    six_columns, seven_columns = ({f"imu.more{i}" for i in range(count)} for count in (6, 7))
    (remark,) = conversion._unread_remarks(
        read_columns | six_columns | {"baro.asl", "baro.temp", "lone.x"}, read_columns
    )
    assert remark == f"not read: baro, {', '.join(sorted(six_columns))}, lone.x"
    (remark,) = conversion._unread_remarks(read_columns | seven_columns | {"esc[0]", "esc[1]"}, read_columns)
    assert remark == "not read: esc, the rest of imu"
    assert list(conversion._unread_remarks(read_columns, read_columns)) == []


def test_missing_columns_are_reported_for_the_first_source_with_some_logged_columns():
    sources = [{"columns": ["a", "b", "c"]}, {"columns": ["d", "e", "f"]}]
    mapping = Mapping(signals={"position": sources})

    def remarks_for(*available):
        return list(conversion._incomplete_remarks("position", mapping, {*available}))

    assert remarks_for() == []
    assert remarks_for("a", "b") == ["position is left out: c is not logged"]
    assert remarks_for("f") == ["position is left out: d, e are not logged"]
    assert remarks_for("a", "d", "e", "f") == ["position is left out: b, c are not logged"]
    assert remarks_for("d", "e", "f") == ["position is left out: d to f is a number in fewer than two samples"]


def test_only_the_first_usable_source_of_a_signal_is_read():
    """A signal is read from its first source with at least two samples."""
    mapping = Mapping(signals={"position": [{"columns": ["a", "b", "c"]}, {"columns": ["d", "e", "f"]}]})
    columns = {name: np.zeros(20) for name in "abcdef"}
    for damaged, unread in (("", "not read: d, e, f"), ("a", "not read: a, b, c")):
        logged = {name: np.full(20, np.nan) if name == damaged else values for name, values in columns.items()}
        table = Table("", np.linspace(0.0, 1.0, 20), logged)
        record = conversion.record_of([table], mapping, name="log", mark="log")
        assert unread in record.remarks


def test_the_origin_of_a_signal_lists_columns_rate_resampling_and_missing_samples():
    clock = channel("body_rates", 0.0, 1.0, 0.004)
    slow, held = channel("position", 0.0, 1.0, 0.05), channel("motor_command", 0.0, 1.0, 0.02)
    held = held._replace(source=SignalSource(column="p"))
    incomplete = slow._replace(rows=slow.rows[3:])
    origins = [conversion._origin(each, clock.clock) for each in (clock, slow, held, incomplete)]
    assert [each.signal for each in origins] == ["body_rates", "position", "motor_command", "position"]
    assert [each.columns for each in origins] == ["a to b (mm)", "a to b (mm)", "p", "a to b (mm)"]
    np.testing.assert_allclose([each.rate for each in origins], [250.0, 20.0, 50.0, 20.0])
    assert [each.resampling for each in origins] == ["", "interpolated", "held", "interpolated"]
    np.testing.assert_allclose([each.missing_fraction for each in origins], [0.0, 0.0, 0.0, 3 / 21])


@pytest.mark.parametrize("reverse", [False, True])
def test_a_column_in_two_tables_is_read_from_the_longer_one(reverse):
    """A Crazyflie can log a variable in two blocks, and ArduPilot a field in two messages."""
    mapping = Mapping(signals={"body_rates": {"columns": ["p", "q", "r"]}})
    tables = [
        Table(f"{count}", np.linspace(0.0, 1.0, count), {name: np.full(count, float(count)) for name in "pqr"})
        for count in (20, 50, 30)
    ]
    record = conversion.record_of(tables[::-1] if reverse else tables, mapping, name="log", mark="log")
    assert len(record.time) == 50
    np.testing.assert_array_equal(record.body_rates, 50.0)


def test_vectors_are_rotated_between_body_axes_and_world_axes_by_the_attitude():
    """The vectors are left out if no attitude is logged. Vectors in the required frame are unchanged."""
    random = np.random.default_rng(2)
    attitude, velocity, force, rates = random.normal(size=(4, 60, 3))
    to_world = Rotation.from_euler("ZYX", attitude[:, ::-1])
    given = {"attitude": attitude, "velocity": velocity, "specific_force": force, "body_rates": rates}
    frames = {"velocity": "FLU", "specific_force": "ENU", "body_rates": "FRD"}
    channels = [
        channel(name, 0.0, 5.9, 0.1)._replace(source=SignalSource(column=name, frame=frames.get(name)))
        for name in given
    ]
    signals = dict(given)
    assert list(conversion._turn_to_signal_frames(signals, channels)) == [
        "velocity is turned from body axes to world axes by the attitude",
        "specific_force is turned from world axes to body axes by the attitude",
    ]
    np.testing.assert_allclose(signals["velocity"], to_world.apply(velocity), atol=1e-12)
    np.testing.assert_allclose(signals["specific_force"], to_world.inv().apply(force), atol=1e-12)
    assert (signals["attitude"] is attitude, signals["body_rates"] is rates) == (True, True)
    signals = {name: values for name, values in given.items() if name != "attitude"}
    assert list(conversion._turn_to_signal_frames(signals, channels[1:])) == [
        "velocity is left out: it is along body axes, and no attitude is logged",
        "specific_force is left out: it is along world axes, and no attitude is logged",
    ]
    assert set(signals) == {"body_rates"}


def test_values_are_scaled_rotated_and_reordered():
    """The factor is applied before the unit. A cell without a number may be mapped to a value in the log's unit."""
    rows = np.arange(12.0).reshape(3, 4)
    table = Table("", np.arange(3.0), {**{f"c{i}": rows[:, i] for i in range(4)}, "all": rows, "vector": rows[:, :3]})

    def values(signal, **source):
        mapping = Mapping(signals={signal: source})
        return conversion._values(signal, mapping.signals[signal][0], table)

    three = ["c0", "c1", "c2"]
    np.testing.assert_allclose(values("velocity", columns=three, unit="mm/s", factor=2.0), 2e-3 * rows[:, :3])
    np.testing.assert_allclose(
        values("velocity", columns=three, factor=[1.0, -1.0, 3.0]), rows[:, :3] * np.array([1.0, -1.0, 3.0])
    )
    np.testing.assert_allclose(values("velocity", column="vector", frame="NED"), rows[:, :3] * [1.0, -1.0, -1.0])
    np.testing.assert_allclose(values("velocity", columns=["c0", 7.0, "c1"]), np.insert(rows[:, :2], 1, 7.0, axis=1))
    for frame, sign in (("NED", -1.0), ("ENU", 1.0)):
        yaw = values("reference_yaw", columns=["c1"], unit="deg", frame=frame)
        np.testing.assert_allclose(yaw[:, 0], sign * np.radians(rows[:, 1]))
    # Column i belongs to the rotor with the number rotors[i].
    motors = values("motor_command", column="all", unit="%", rotors=[3, 1, 4, 2])
    np.testing.assert_allclose(motors[:, [2, 0, 3, 1]], 0.01 * rows)
    table.columns["c1"][1] = np.nan
    known = values("body_rates", columns=three, unit="deg/s", missing=90.0)
    np.testing.assert_allclose(known[1], np.radians([4.0, 90.0, 6.0]))
    assert np.isnan(values("body_rates", columns=three, unit="deg/s")[1, 1])


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("frame", [None, "NED"])
def test_quaternions_are_converted_to_roll_pitch_and_yaw(order, frame):
    """A quaternion is accepted if its norm is between 0.5 and 2.

    Zeros, with which many logs begin, are not a quaternion.
    """
    random = np.random.default_rng(8)
    angles = random.uniform(-1.4, 1.4, size=(20, 3))
    quaternion = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat()[:, [3, 0, 1, 2]]
    if frame == "NED":  # half a turn about x, of world and body
        quaternion = quaternion * [1.0, 1.0, -1.0, -1.0]
    quaternion = quaternion * np.where(np.arange(20) % 2, 1.001, -0.999)[:, None]
    quaternion[5:9] *= np.array([[0.49], [2.02], [0.51], [1.98]])
    logged = quaternion if order == "wxyz" else np.roll(quaternion, -1, axis=1)
    table = Table("", np.arange(20.0), {"q": logged})
    mapping = Mapping(signals={"attitude": {"column": "q", "quaternion": order, **({"frame": frame} if frame else {})}})
    result = conversion._values("attitude", mapping.signals["attitude"][0], table)
    known = np.delete(np.arange(20), [5, 6])
    np.testing.assert_allclose(result[known], angles[known], atol=1e-9)
    assert np.isnan(result[[5, 6]]).all()
