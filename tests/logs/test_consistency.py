"""Tests that contradictory signals of a log are reported with a probable cause, and consistent ones are not."""

import functools
import math
import re

import numpy as np
import pytest
import scipy
from written_logs import DATA

from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.consistency import (
    _force_in_body,
    _is_other_frame,
    _on_grid,
    _Pair,
    _pairs,
    _refined_minimum,
    _response,
    _shift,
    _size_of_force,
    _tilt,
    clock_shifts,
    inconsistencies,
)
from drake_quad.logs.faults import faults
from drake_quad.logs.reading import read_log

GRAVITY = 9.81  # m/s²
PERIOD = 0.01  # s, sampling period
TIME = PERIOD * np.arange(1500)  # s
# The search compares the log with about a hundred faults.
pytestmark = pytest.mark.slow
HALF_TURN = np.array([1.0, -1.0, -1.0])  # signs of x, y and z after a rotation by 180° about x


@functools.cache
def flight(noise=1.0):
    """Return a flight with linear drag and thrust along the body's z axis; its attitude follows from path and yaw."""
    random = np.random.default_rng(1)
    frequencies, sizes = np.array([1.1, 1.7, 0.9]), np.array([1.5, 0.8, 0.4])
    phase = np.outer(TIME, frequencies) + np.array([0.0, 0.3, 0.7])
    position = sizes * np.sin(phase) + [0.0, 0.0, 1.5]
    velocity = sizes * frequencies * np.cos(phase)
    force = -sizes * frequencies**2 * np.sin(phase) + [0.0, 0.0, GRAVITY]
    thrust = force + 0.3 * velocity
    yaw = 0.8 * np.sin(0.7 * TIME)
    # The thrust along the axes of the heading gives the tangents of pitch and roll, for Z-Y-X angles.
    along = thrust[:, 0] * np.cos(yaw) + thrust[:, 1] * np.sin(yaw)
    across = thrust[:, 1] * np.cos(yaw) - thrust[:, 0] * np.sin(yaw)
    pitch = np.arctan2(along, thrust[:, 2])
    roll = np.arctan2(-across, np.hypot(along, thrust[:, 2]))
    attitude = np.column_stack([roll, pitch, yaw])
    body_rates = rates_of(attitude)
    specific_force = rotation_matrices(attitude).apply(force, inverse=True)
    exact = {
        "position": (position, 1e-3),
        "velocity": (velocity, 0.02),
        "attitude": (attitude, 2e-3),
        "body_rates": (body_rates, 0.05),
        "specific_force": (specific_force, 0.3),
        "reference_position": (sizes * np.sin(phase + 0.3 * frequencies) + [0.0, 0.0, 1.5], 0.0),
        "attitude_command": (attitude, 0.0),
    }
    return {name: values + noise * size * random.normal(size=values.shape) for name, (values, size) in exact.items()}


def rates_of(attitude):
    """Return body rates (n, 3) from finite differences of roll, pitch and yaw (n, 3) and their kinematics."""
    roll, pitch, _ = attitude.T
    d_roll, d_pitch, d_yaw = np.gradient(attitude, PERIOD, axis=0).T
    return np.column_stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
            d_yaw * np.cos(roll) * np.cos(pitch) - d_pitch * np.sin(roll),
        ]
    )


def texts(signals, time):
    return [each.text for each in inconsistencies(signals, time)]


def found(changes=None, time=TIME):
    return texts({**flight(), **(changes or {})}, time)


def test_a_physically_correct_flight_has_no_contradiction():
    assert found() == []
    assert texts(flight(noise=0.0), TIME) == []
    # A log with a gap, and a shorter log, have no contradiction either.
    outside_gap = (TIME < 8.0) | (TIME > 9.5)
    assert texts({name: values[outside_gap] for name, values in flight().items()}, TIME[outside_gap]) == []
    for count in (2, 30, 120):
        assert texts({name: values[:count] for name, values in flight().items()}, TIME[:count]) == []


def test_windows_that_touch_a_gap_are_left_out():
    outside_gap = (TIME < 8.0) | (TIME > 9.5)
    grid = _on_grid({"position": flight()["position"][outside_gap]}, TIME[outside_gap])
    edges = TIME[0] + grid.step * np.arange(len(grid.usable))
    np.testing.assert_allclose(edges[~grid.usable][[0, -1]], [7.99, 9.5], atol=0.011)
    starts = grid.starts(20)
    assert len(starts) == len(grid.usable) - (~grid.usable).sum() - 2 * 20
    assert all(grid.usable[start : start + 21].all() for start in starts)
    np.testing.assert_array_equal(grid.with_stride(7).starts(20), starts[::7])


def test_a_stride_of_three_selects_every_third_window():
    grid = _on_grid({**flight(), "reference_velocity": flight()["velocity"]}, TIME)
    strided_pairs = _pairs(grid.with_stride(3))
    for compare, pair in _pairs(grid).items():
        strided = strided_pairs[compare]
        np.testing.assert_array_equal(strided.expected, pair.expected[::3])
        np.testing.assert_array_equal(strided.measured, pair.measured[::3])


@pytest.mark.parametrize("without", [None, "velocity"])
def test_a_log_with_a_repaired_fault_is_compared_like_a_correct_log(without):
    """Quantities that do not depend on the repaired signals are not computed again."""
    signals, time = {name: values[:200] for name, values in flight().items() if name != without}, TIME[:200]
    grid = _on_grid(signals, time)
    _pairs(grid)
    for fault in faults(grid.signals):
        repaired, expected = grid.repaired(fault), _on_grid(signals, time).repaired(fault)
        # Signals that need motion are not compared if the repaired velocity hardly varies.
        pairs, expected_pairs = _pairs(repaired), _pairs(expected)
        assert pairs.keys() == expected_pairs.keys()
        for compare, pair in pairs.items():
            np.testing.assert_array_equal(pair.expected, expected_pairs[compare].expected)
            np.testing.assert_array_equal(pair.measured, expected_pairs[compare].measured)


@pytest.mark.parametrize(
    ("period", "step", "is_gap"), [(0.01, 0.045, False), (0.01, 0.055, True), (0.05, 0.145, False), (0.05, 0.155, True)]
)
def test_a_time_step_is_a_gap_if_it_exceeds_three_samples_and_50_ms(period, step, is_gap):
    """Missing samples of a fast log are interpolated linearly if they span less than 50 ms."""
    time = period * np.arange(400.0)
    time[200:] += step - period
    grid = _on_grid({"position": np.zeros((400, 3))}, time)
    assert grid.step == pytest.approx(period)
    assert grid.usable.all() != is_gap
    edges = grid.step * np.arange(len(grid.usable) + 1)
    inside = (edges[:-1] > time[199] - 1e-9) & (edges[1:] < time[200] + 1e-9)
    outside = (edges[1:] < time[199] + 1e-9 - period) | (edges[:-1] > time[200] - 1e-9 + period)
    assert (grid.usable[inside] != is_gap).all()
    assert grid.usable[outside].all()


@pytest.mark.parametrize(("period", "seconds"), [(0.002, 4.0), (0.01, 100.0), (0.03, 100.0), (0.03, 300.0)])
def test_grid_values_are_means_over_grid_steps_in_the_middle_of_the_log(period, seconds):
    """The grid has at most 6000 steps of at least 10 ms. The mean of a ramp over a step is its value in the middle."""
    time = period * np.arange(round(seconds / period) + 1.0)
    grid = _on_grid({"position": np.column_stack([time, 2.0 * time, -time])}, time)
    assert grid.step == pytest.approx(max(period, 0.01))
    count = min(6000, int(seconds / grid.step + 1e-6))
    middles, _, _ = grid.signals["position"].T
    assert len(middles) == pytest.approx(count, abs=1)
    np.testing.assert_allclose(np.diff(middles), grid.step)
    assert np.mean(middles) == pytest.approx(0.5 * seconds, abs=2.0 * grid.step)
    # A window has at least one step.
    assert (grid.num_steps(1e-3), grid.num_steps(0.6)) == (1, round(0.6 / grid.step))
    # A vehicle at constant velocity does not accelerate, so the grid does not count as moving.
    assert not grid.is_moving
    assert _on_grid({"position": np.zeros((49, 3))}, 0.01 * np.arange(49.0)) is None
    assert _on_grid({"position": np.zeros((51, 3))}, 0.01 * np.arange(51.0)) is not None


def test_the_disagreement_of_equal_signals_is_zero_and_of_opposite_signals_two():
    random = np.random.default_rng(3)
    one, other = random.normal(size=(2, 5000, 1))
    for measured, expected in ((one, 0.0), (other, 1.0), (-one, 2.0), (3.0 * one, 4.0 / 10.0)):
        pair = _Pair("velocity", "the derivative of position", one, measured, 0.5, ("x",))
        assert pair.disagreement()[0] == pytest.approx(expected, abs=0.05)
        assert pair.excited()[0]
    # A constant offset counts only if means are compared.
    for centred, expected in ((True, 0.0), (False, 0.9)):
        pair = _Pair("specific_force", "gravity", one, one + 9.8, 0.5, ("x",), centred=centred)
        assert pair.disagreement()[0] == pytest.approx(expected, abs=0.1)
    # The amplitude of a pair is the larger of its two RMS values, without the largest tenth of each signal.
    spikes = np.where(np.arange(5000)[:, None] % 20 == 0, 100.0, 0.1)
    for threshold, excited in ((0.09, True), (0.11, False)):
        pair = _Pair("velocity", "", np.zeros((5000, 1)), spikes, threshold, ("x",), centred=False)
        assert pair.excited()[0] == excited
        assert pair._replace(threshold=0.5 * threshold).excited(factor=2.0)[0] == excited


def test_accelerations_follow_from_positions_if_no_velocity_is_logged():
    clean = flight(0.0)
    both = _on_grid({name: clean[name] for name in ("position", "velocity")}, TIME)
    np.testing.assert_array_equal(both.velocity, both.signals["velocity"])
    alone = _on_grid({"position": clean["position"]}, TIME)
    np.testing.assert_allclose(alone.velocity[1:-1], both.velocity[1:-1], atol=1e-3)
    assert _on_grid({"attitude": clean["attitude"]}, TIME).velocity is None
    # A wrong sign of the specific force is found as well, although a vehicle at rest does not accelerate.
    signals = {"position": clean["position"], "attitude": clean["attitude"], "specific_force": clean["specific_force"]}
    assert texts(signals, TIME) == []
    (remark,) = texts(signals | {"specific_force": clean["specific_force"] * [-1.0, 1.0, 1.0]}, TIME)
    assert remark.endswith("the sign of specific_force looks wrong in x")
    assert alone.is_moving
    assert not _on_grid({"position": 0.01 * clean["position"]}, TIME).is_moving


def test_a_velocity_that_hardly_varies_shows_no_acceleration():
    """A stopped estimator logs a constant velocity, while attitude and specific force vary."""
    clean = flight()
    for velocity in (np.full((len(TIME), 3), 0.3), 0.04 * clean["velocity"] / np.std(clean["velocity"], axis=0)):
        signals = {name: clean[name] for name in ("attitude", "specific_force")} | {"velocity": velocity}
        grid = _on_grid(signals, TIME)
        assert not grid.is_moving
        compared = [pair.other for pair in _pairs(grid).values()]
        assert compared == ["gravity"]
        assert texts(signals, TIME) == []
    assert _on_grid({"velocity": 0.06 * clean["velocity"] / np.std(clean["velocity"], axis=0)}, TIME).is_moving


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3, 0.4])
def test_a_command_is_compared_with_signals_that_lag_by_up_to_half_a_second(delay, sign):
    """The estimated delay does not depend on the sign of the command."""
    phases = np.outer(TIME, [1.1, 1.7, 2.3])
    commands = np.sin(phases) + 0.4 * np.sin(2.3 * phases)
    followed = np.column_stack([np.interp(TIME - delay, TIME, column) for column in commands.T])
    grid = _on_grid({"attitude_command": sign * commands, "attitude": 0.8 * followed}, TIME)
    for columns in (2, 3):
        pair = _response("attitude_command", "attitude", 0.03, columns, grid)
        assert pair.axes == ("roll", "pitch", "yaw")[:columns]
        assert pair.expected.shape == pair.measured.shape == (len(grid.usable) - 10 - round(delay / PERIOD), columns)
        np.testing.assert_allclose(pair.expected[100:], 0.8 * sign * pair.measured[100:], atol=0.02)
        # Signals with amplitudes of 0.8 and 1 disagree by (1 - 0.8)² / (1 + 0.8²), or (1 + 0.8)² / (1 + 0.8²) if
        # opposite.
        expected = (1.0 - 0.8 * sign) ** 2 / 1.64
        np.testing.assert_allclose(pair.disagreement(), expected, atol=0.02)


@pytest.mark.long
@pytest.mark.parametrize("name", ["position", "velocity", "attitude", "body_rates", "specific_force"])
def test_each_wrong_sign_is_named(name):
    axes = ("roll", "pitch", "yaw") if name == "attitude" else ("x", "y", "z")
    for axis, word in enumerate(axes):
        signs = np.ones(3)
        signs[axis] = -1.0
        (remark,) = found({name: flight()[name] * signs})
        assert remark.endswith(f": the sign of {name} looks wrong in {word}")
    (remark,) = found({name: flight()[name] * HALF_TURN})
    assert f"the sign of {name} looks wrong in {axes[1]} and {axes[2]}, as if it were in " in remark


@pytest.mark.parametrize(
    ("name", "factor", "message"),
    [
        ("position", 1e3, "millimetres were taken for metres"),
        ("velocity", 1e2, "centimetres were taken for metres"),
        ("velocity", 3.6, "km/h were taken for m/s"),
        ("attitude", math.degrees(1.0), "degrees were taken for radians"),
        ("attitude_command", math.degrees(1.0), "degrees were taken for radians"),
        ("body_rates", math.degrees(1.0), "degrees were taken for radians"),
        ("body_rates", math.radians(1.0), "radians were taken for degrees"),
        ("specific_force", 1.0 / GRAVITY, "g were taken for m/s²"),
        ("specific_force", GRAVITY, "m/s² were taken for g"),
        ("reference_position", 1e2, "centimetres were taken for metres"),
    ],
)
def test_each_wrong_unit_is_named(name, factor, message):
    (remark,) = found({name: factor * flight()[name]})
    assert remark.endswith(f": {name} looks as if {message}")


@pytest.mark.long
def test_each_wrong_frame_is_named():
    clean = flight()
    to_world = rotation_matrices(clean["attitude"]).apply
    to_body = rotation_matrices(clean["attitude"]).inv().apply
    for name, turned, words in (
        ("body_rates", to_world, "body_rates looks as if it were along world axes"),
        ("specific_force", to_world, "specific_force looks as if it were along world axes"),
        ("velocity", to_body, "velocity looks as if it were along body axes"),
        ("velocity", lambda v: v[:, [1, 0, 2]] * [1.0, 1.0, -1.0], "velocity looks as if NED was taken for ENU"),
        ("attitude", lambda a: a + np.array([0.0, 0.0, 0.5 * np.pi]), "the yaw of attitude looks 90° too large"),
    ):
        (remark,) = found({name: turned(clean[name])})
        assert words in remark
    remarks = texts({name: values * HALF_TURN for name, values in clean.items()}, TIME)
    assert remarks[0].endswith(": all signals look as if NED and FRD were taken for NWU and FLU")


def test_a_wrong_frame_is_named_at_small_tilts_if_the_other_frame_is_exact():
    """The horizontal velocity along body axes is almost that along world axes at a tilt of 0.1 rad."""
    tilt = 0.1 * np.sin(2.0 * np.outer(TIME, [1.0, 0.8]))
    velocity = np.zeros((len(TIME), 3))
    velocity[:, :2] = scipy.integrate.cumulative_simpson(GRAVITY * np.tan(tilt), x=TIME, axis=0, initial=0.0)
    velocity -= velocity.mean(axis=0)
    position = scipy.integrate.cumulative_simpson(velocity, x=TIME, axis=0, initial=0.0)
    # The attitude is chosen so that the thrust is parallel to (tan(tilt_x), tan(tilt_y), 1).
    attitude = np.zeros((len(TIME), 3))
    attitude[:, 1] = tilt[:, 0]
    attitude[:, 0] = -np.arctan(np.tan(tilt[:, 1]) * np.cos(tilt[:, 0]))
    in_body = rotation_matrices(attitude).apply(velocity, inverse=True)
    assert texts({"position": position, "attitude": attitude, "velocity": velocity}, TIME) == []
    (remark,) = texts({"position": position, "attitude": attitude, "velocity": in_body}, TIME)
    assert remark.endswith("velocity looks as if it were along body axes")


@pytest.mark.parametrize("shift", [-0.1, 0.04, 0.15])
@pytest.mark.parametrize(("name", "other"), [("velocity", "position"), ("body_rates", "attitude")])
def test_a_time_shift_is_measured(name, other, shift):
    shifted = np.column_stack([np.interp(TIME - shift, TIME, column) for column in flight()[name].T])
    remarks = [each for each in found({name: shifted}) if each.startswith(f"{name} is ")]
    (remark,) = remarks
    size, error = (float(each) for each in re.search(r"is (\d+) ± (\d+) ms", remark).groups())
    assert abs(size - 1e3 * abs(shift)) <= max(error, 5.0)
    assert ("behind" if shift > 0.0 else "ahead of") + f" the derivative of {other}" in remark


@pytest.mark.parametrize(("amplitude", "is_detected"), [(0.15, False), (0.26, True), (0.4, True), (1.5, True)])
def test_a_time_shift_of_the_vertical_force_is_detected_in_small_motions(amplitude, is_detected):
    """The comparison of amplitudes includes the mean force, which is the weight.

    The comparison of time shifts does not.
    """
    random = np.random.default_rng(2)
    phases = np.outer(TIME, [2.1, 3.4]) + np.array([0.0, 1.0])
    horizontal = np.zeros((len(TIME), 2))
    # The acceleration is a sum of two sines.
    acceleration = amplitude * np.sin(phases).sum(axis=1)
    velocity = -amplitude * (np.cos(phases) / [2.1, 3.4]).sum(axis=1)
    delayed = np.interp(TIME - 0.1, TIME, acceleration) + 0.01 * random.normal(size=len(TIME))
    remarks = texts(
        {
            "attitude": np.zeros((len(TIME), 3)),
            "velocity": np.column_stack([horizontal, velocity]),
            "specific_force": np.column_stack([horizontal, GRAVITY + delayed]),
        },
        TIME,
    )
    if is_detected:
        (remark,) = remarks
        assert re.match(r"specific_force is (99|100|101) ± \d ms behind the acceleration and gravity: ", remark)
    else:
        assert remarks == []


@pytest.mark.parametrize("axis", [0, 1])
def test_a_time_shift_of_a_horizontal_force_is_detected(axis):
    """A horizontal force accelerates a level vehicle, and the log of its accelerometer is late or early."""
    phases = np.outer(TIME, [2.1, 3.4]) + np.array([0.0, 1.0])
    acceleration, velocity = np.zeros((len(TIME), 3)), np.zeros((len(TIME), 3))
    acceleration[:, axis] = np.sin(phases).sum(axis=1)
    velocity[:, axis] = -(np.cos(phases) / [2.1, 3.4]).sum(axis=1)
    for shift, words in ((0.1, "behind"), (-0.1, "ahead of")):
        force = np.zeros((len(TIME), 3))
        force[:, axis] = np.interp(TIME - shift, TIME, acceleration[:, axis])
        force[:, 2] = GRAVITY
        signals = {"attitude": np.zeros((len(TIME), 3)), "velocity": velocity, "specific_force": force}
        (remark,) = texts(signals, TIME)
        assert re.match(rf"specific_force is (99|100|101) ± \d ms {words} the acceleration and the tilt: ", remark)


def test_the_lag_of_body_rates_is_estimated_only_where_they_match_the_attitude():
    signals, late = flight(noise=0.1), np.maximum(TIME - 0.03, 0.0)
    rates = np.column_stack([np.interp(late, TIME, axis) for axis in signals["body_rates"].T])
    lags = clock_shifts({"attitude": signals["attitude"], "body_rates": rates}, TIME).lags
    assert len(lags) == 7
    np.testing.assert_allclose(lags, 0.03, atol=0.005)
    # The rates of a gyroscope with half the true scale do not match.
    assert not len(clock_shifts({"attitude": signals["attitude"], "body_rates": 0.5 * rates}, TIME).lags)


@pytest.mark.parametrize("shift", [-31, -29, -3, -2, 0, 2, 3, 29, 31])
def test_shifts_of_25_to_300_milliseconds_are_reported(shift):
    """Filters and radio links cause smaller shifts in correct logs."""
    time = PERIOD * np.arange(-100.0, 1600.0)
    signal = sum(np.sin(rate * time + rate) for rate in (0.9, 2.1, 3.4))
    pair = _Pair("velocity", "it", signal[100:1600, None], signal[100 - shift : 1600 - shift, None], 0.1, ("x",))
    remarks = list(_shift(pair, PERIOD, np.array([True])))
    if 2 < abs(shift) < 30:
        (remark,) = remarks
        words = "behind" if shift > 0 else "ahead of"
        assert remark.startswith(f"velocity is {10 * abs(shift)} ± 0 ms {words} it: their clocks are shifted")
    else:
        assert remarks == []
    assert list(_shift(pair, PERIOD, np.array([False]))) == []
    # A shift is estimated in eight parts with 25 windows each. Windows closer to an end than the largest shift are left
    # out.
    for count, enough in ((259, False), (260, True)) if abs(shift) < 20 else ():
        short = pair._replace(expected=pair.expected[:count], measured=pair.measured[:count])
        assert len(list(_shift(short, PERIOD, np.array([True])))) == (enough and bool(remarks))


def test_a_time_shift_of_less_than_one_sample_is_found():
    """Shifts of up to 0.3 s are tried. This is one sample at four samples per second, and none at one per second."""
    time = 0.25 * np.arange(400.0)

    def signal(at):
        return sum(np.sin(rate * at + rate) for rate in (0.3, 0.5, 0.7))[:, None]

    pair = _Pair("velocity", "it", signal(time), signal(time - 0.1), 0.1, ("x",))
    (remark,) = _shift(pair, 0.25, np.array([True]))
    assert re.match(r"velocity is (99|100|101) ± \d ms behind it: ", remark)
    assert list(_shift(pair, 1.0, np.array([True]))) == []


@pytest.mark.parametrize(("sigmas", "reported"), [(3.7, False), (4.3, True)])
def test_a_shift_is_reported_if_it_exceeds_25_milliseconds_by_four_standard_errors(sigmas, reported):
    """The eight parts have shifts of 100 ms + d and 100 ms - d, whose mean has a standard error of d / √7."""
    scatter = math.sqrt(7.0) * 0.075 / sigmas
    time = PERIOD * np.arange(-200.0, 4260.0)
    # The log has parts of 5 s. The time shift is constant in each part, except for linear transitions between the
    # parts.
    begins = 0.3 + 5.0 * np.arange(9)
    shifts = 0.1 + scatter * np.where(np.arange(8) % 2, 1.0, -1.0)
    shift = np.interp(time, np.sort([*(begins[:-1] + 0.3), *(begins[1:] - 0.3)]), np.repeat(shifts, 2))

    def signal(at):
        return sum(np.sin(rate * at + rate) for rate in (4.9, 7.1, 10.4))[200:, None]

    pair = _Pair("velocity", "it", signal(time)[:4060], signal(time - shift)[:4060], 0.1, ("x",))
    remarks = list(_shift(pair, PERIOD, np.array([True])))
    assert bool(remarks) == reported


def test_the_horizontal_acceleration_follows_from_the_tangent_of_the_tilt():
    """The horizontal acceleration is (g + c) tan(tilt), for the vertical acceleration c. The vehicle yaws by 90°."""
    phases = np.outer(TIME, [1.1, 1.7, 0.9])
    frequencies, sizes = np.array([1.1, 1.7, 0.9]), np.array([9.0, 5.0, 2.0])
    acceleration, velocity = sizes * np.sin(phases), -sizes / frequencies * np.cos(phases)
    thrust = acceleration + np.array([0.0, 0.0, GRAVITY])
    # The body's x axis is along the world's y axis at a yaw of 90°, so pitch accelerates along y, and roll along x.
    pitch = np.arctan2(thrust[:, 1], thrust[:, 2])
    roll = np.arctan2(thrust[:, 0], np.hypot(thrust[:, 1], thrust[:, 2]))
    attitude = np.column_stack([roll, pitch, np.full(len(TIME), 0.5 * np.pi)])
    np.testing.assert_allclose(
        np.cross(rotation_matrices(attitude).apply([0.0, 0.0, 1.0]), thrust), 0.0, atol=1e-9
    )  # the thrust is along the body's z axis
    grid = _on_grid({"attitude": attitude, "velocity": velocity}, TIME)
    pair = _tilt(grid)
    assert np.abs(pair.expected).max() > 8.0  # a tilt of about 40°
    np.testing.assert_allclose(pair.measured, pair.expected, atol=0.25)
    assert (pair.disagreement() < 1e-3).all()


def test_the_magnitude_of_a_force_is_compared_outside_of_gaps():
    outside_gap = (TIME < 8.0) | (TIME > 9.5)
    grid = _on_grid({"specific_force": flight()["specific_force"][outside_gap]}, TIME[outside_gap])
    pair = _size_of_force(grid)
    assert len(pair.measured) == len(pair.expected) == grid.usable.sum()
    np.testing.assert_array_equal(pair.expected, GRAVITY)
    sizes = np.linalg.norm(grid.signals["specific_force"], axis=1)
    np.testing.assert_allclose(pair.measured[:, 0], sizes[grid.usable])
    # The magnitude is compared with a negative sign if the force points down.
    upside_down = _on_grid({"specific_force": -flight()["specific_force"]}, TIME)
    pair = _size_of_force(upside_down)
    assert (pair.measured < 0.0).all()


@pytest.mark.parametrize(("correlation", "named"), [(-0.45, False), (-0.85, True)])
def test_a_wrong_sign_is_reported_if_changing_the_sign_removes_most_of_the_disagreement(correlation, named):
    """The disagreement is one minus the correlation. Its reduction must exceed the remaining disagreement by 0.4."""
    rates, others = np.array([1.1, 1.7, 0.9]), np.array([2.9, 2.3, 3.7])
    velocity = np.sin(np.outer(TIME, rates))
    position = -np.cos(np.outer(TIME, rates)) / rates
    mixed = correlation * velocity + np.sqrt(1.0 - correlation**2) * np.sin(np.outer(TIME, others))
    remarks = texts({"position": position, "velocity": mixed}, TIME)
    assert any("the sign of" in remark for remark in remarks) == named


def sized(values, size):
    """Scale each axis of a motion so that the RMS of its values, clipped to their 90 % quantile, is `size`."""
    limit = np.quantile(np.abs(values), 0.9, axis=0)
    return size * values / np.sqrt(np.mean(np.clip(values, -limit, limit) ** 2, axis=0))


@pytest.mark.parametrize(("multiple", "contradicts"), [(1.8, False), (2.2, True), (4.0, True)])
@pytest.mark.parametrize(
    ("name", "threshold", "other"),
    [
        ("velocity", 0.05, "the derivative of position"),
        ("body_rates", 0.05, "the derivative of attitude"),
        ("specific_force", 0.2, "the acceleration and the tilt"),
    ],
)
def test_independent_signals_contradict_each_other_if_one_exceeds_twice_the_amplitude_threshold(
    name, threshold, other, multiple, contradicts
):
    """The motions are slow, so averaging over windows of 0.2 s hardly changes their amplitudes."""
    moving = sized(np.sin(np.outer(TIME, [0.5, 0.7, 0.4])), multiple * threshold)
    small = 1e-3 * np.sin(np.outer(TIME, [2.9, 2.3, 3.7]))
    if name == "velocity":
        signals = {"position": small, "velocity": moving}
    elif name == "body_rates":
        signals = {"attitude": small, "body_rates": moving}
    else:
        # A constant acceleration along z shows that the vehicle moves.
        velocity = small + np.outer(TIME, [0.0, 0.0, 0.1])
        force = moving * [1.0, 1.0, 0.0] + [0.0, 0.0, GRAVITY + 0.1]
        signals = {"attitude": 0.0 * small, "velocity": velocity, "specific_force": force}
    remarks = texts(signals, TIME)
    assert any(remark.startswith(f"{name} contradicts {other}") for remark in remarks) == contradicts


@pytest.mark.parametrize("multiple", [0.9, 1.1])
@pytest.mark.parametrize(
    ("signal", "other", "threshold"),
    [
        ("reference_position", "position", 0.1),
        ("attitude_command", "attitude", 0.03),
        ("body_rate_command", "body_rates", 0.1),
    ],
)
def test_a_wrong_sign_of_a_command_is_named_if_its_amplitude_exceeds_the_threshold(signal, other, threshold, multiple):
    motion = sized(np.sin(np.outer(TIME, [0.5, 0.7, 0.4])), multiple * threshold)
    remarks = texts({signal: motion * [-1.0, 1.0, 1.0], other: motion}, TIME)
    assert any("the sign of" in each for each in remarks) == (multiple > 1.0)
    # A yaw is not compared with its command.
    remarks = texts({signal: motion * [1.0, 1.0, -1.0], other: motion}, TIME)
    assert any("the sign of" in each for each in remarks) == (multiple > 1.0 and "attitude" not in other)


@pytest.mark.parametrize("multiple", [0.9, 1.1])
def test_a_wrong_sign_of_a_derivative_or_a_tilt_is_named_if_its_amplitude_exceeds_the_threshold(multiple):
    phases = np.outer(TIME, [0.5, 0.7, 0.4])
    velocity = sized(np.sin(phases), multiple * 0.05)
    position = scipy.integrate.cumulative_simpson(velocity, x=TIME, axis=0, initial=0.0)
    signals = {"reference_velocity": velocity * [1.0, -1.0, 1.0], "reference_position": position}
    assert any("the sign of" in each for each in texts(signals, TIME)) == (multiple > 1.0)
    acceleration = sized(np.sin(phases), multiple * 0.2) * [1.0, 1.0, 0.0]
    velocity = np.cumsum(acceleration, axis=0) * PERIOD
    attitude = np.column_stack([-acceleration[:, 1], acceleration[:, 0], 0.0 * TIME]) / GRAVITY
    remarks = texts({"attitude": attitude * [1.0, -1.0, 1.0], "velocity": velocity}, TIME)
    assert any("the sign of" in each for each in remarks) == (multiple > 1.0)


@pytest.mark.parametrize(
    ("name", "others"),
    [
        ("attitude", ["velocity"]),
        ("reference_velocity", ["reference_position"]),
        ("position", ["reference_position"]),
        ("attitude", ["attitude_command"]),
    ],
)
def test_a_time_shift_is_not_reported_for_signals_that_may_be_delayed(name, others):
    clean = flight(0.0)
    clean = clean | {"reference_velocity": np.gradient(clean["reference_position"], PERIOD, axis=0)}
    shifted = np.column_stack([np.interp(TIME - 0.05, TIME, column) for column in clean[name].T])
    assert texts({each: clean[each] for each in others} | {name: shifted}, TIME) == []


def test_a_body_force_is_compared_at_the_attitude_in_the_middle_of_a_window():
    """With exact signals, expected and measured force differ only because the attitude changes within a window."""
    grid = _on_grid({name: flight(0.0)[name] for name in ("velocity", "attitude", "specific_force")}, TIME)
    pair = _force_in_body(grid)
    means = grid.mean(grid.signals["specific_force"], grid.num_steps(0.2))[:, :2]
    np.testing.assert_allclose(pair.measured, means[: len(pair.measured)])
    size = np.std(pair.measured, axis=0)
    assert np.all(np.std(pair.measured - pair.expected, axis=0) < 0.04 * size)


def test_the_thrust_of_a_vehicle_that_accelerates_down_faster_than_gravity_counts_as_zero():
    time = TIME[:, None]
    velocity = -np.cos(time) * [0.0, 0.0, 15.0]
    grid = _on_grid({"attitude": np.tile([0.0, 0.5, 0.0], (len(TIME), 1)), "velocity": velocity}, TIME)
    pair = _tilt(grid)
    thrust = np.maximum(0.0, GRAVITY + 15.0 * np.sin(TIME[10:-10]))[: len(pair.measured)]
    assert np.mean(thrust == 0.0) > 0.2
    np.testing.assert_allclose(pair.measured[:, 0], np.tan(0.5) * thrust, atol=0.2)


@pytest.mark.parametrize(("delay", "found"), [(10, 10), (20, 20), (30, None)])
def test_the_largest_response_delay_that_is_tried_is_half_of_a_short_log(delay, found):
    """The log has 70 samples, and about 60 windows of a tenth of a second. A delay of 30 samples is not found."""
    random = np.random.default_rng(12)
    command = random.normal(size=(110, 3)).cumsum(axis=0)
    grid = _on_grid({"attitude_command": command[40:], "attitude": command[40 - delay : 110 - delay]}, TIME[:70])
    pair = _response("attitude_command", "attitude", 0.03, 2, grid)
    windows = len(grid.usable) - 10
    if found is None:
        assert len(pair.expected) >= windows - 20
    else:
        assert len(pair.expected) == windows - found


@pytest.mark.long
def test_signals_that_agree_along_one_axis_do_not_contradict_each_other():
    """A single axis may disagree for another reason, such as noise of the yaw."""
    clean = flight()
    for name, columns, contradicts in (
        ("velocity", [2], False),
        ("velocity", [0, 1], False),
        ("body_rates", [2], False),
        ("body_rates", [0, 1, 2], True),
    ):
        values = clean[name].copy()
        values[:, columns] = 0.7 * np.sin(np.outer(TIME, [3.3, 2.3, 4.1]))[:, columns]
        assert any(f"{name} contradicts the" in remark for remark in found({name: values})) == contradicts, columns


def test_a_message_states_the_correlation():
    """A pitch rate with the wrong sign has the correlation -1 with the derivative of the pitch."""
    (remark,) = found({"body_rates": flight()["body_rates"] * [1.0, -1.0, 1.0]})
    match = re.search(
        r"derivative of attitude along y \(correlation (-\d\.\d+), amplitudes ([\d.]+) and ([\d.]+)\)", remark
    )
    correlation, size, other = (float(each) for each in match.groups())
    assert correlation < -0.95
    assert size == pytest.approx(other, rel=0.1)


@pytest.mark.parametrize(("size", "message"), [(2.0, "2 and 0.5"), (0.05, "0.05 and 0.5"), (0.0, "0 and 0.5")])
def test_a_disagreement_names_both_amplitudes_or_says_that_the_other_signal_is_constant(size, message):
    """The signals alternate between two values, so clipping at their quantile does not change their amplitude."""
    signal = np.tile([1.0, -1.0], 400)[:, None]
    pair = _Pair("velocity", "the derivative of position", 0.5 * signal, -size * signal, 0.1, ("x",))
    correlation = "-1.00" if size else "0.00"
    text = pair.text(0).replace("-0.00", "0.00")
    assert text == f"the derivative of position along x (correlation {correlation}, amplitudes {message})"
    angles = pair._replace(other="it", expected=1e-10 * size * signal, axes=("roll",))
    assert angles.text(0) == f"it in roll (correlation {correlation}, which is constant)"


def test_a_constant_signal_contradicts_one_that_varies():
    (remark,) = found({"position": np.ones((len(TIME), 3)), "reference_position": np.ones((len(TIME), 3))})
    assert remark.startswith("velocity contradicts the derivative of position along x (correlation 0.00")
    assert remark.endswith("which is constant)")


def test_two_faults_are_both_named():
    clean = flight()
    remarks = found({"body_rates": -clean["body_rates"], "specific_force": clean["specific_force"] / GRAVITY})
    assert len(remarks) == 2
    assert any("the sign of body_rates looks wrong" in each for each in remarks)
    assert any("g were taken for m/s²" in each for each in remarks)


def test_unit_and_sign_of_a_specific_force_are_checked_without_an_attitude():
    force = {"specific_force": flight()["specific_force"]}
    assert texts(force, TIME) == []
    (remark,) = texts({"specific_force": force["specific_force"] / GRAVITY}, TIME)
    assert remark.endswith("specific_force looks as if g were taken for m/s²")
    (remark,) = texts({"specific_force": force["specific_force"] * HALF_TURN}, TIME)
    assert "the sign of specific_force looks wrong in z" in remark or "FRD" in remark


def test_signals_of_noise_do_not_contradict_each_other():
    random = np.random.default_rng(1)
    names = ("position", "velocity", "attitude", "body_rates")
    hovering = {name: 1e-3 * random.normal(size=(len(TIME), 3)) for name in names}
    assert texts(hovering, TIME) == []


@pytest.mark.parametrize(
    "path", sorted(DATA.glob("crazyflie/*/*.xz")) + sorted(DATA.glob("px4/*.xz")), ids=lambda path: path.stem
)
def test_the_shipped_flights_have_no_contradiction(path):
    record = read_log(path)
    assert texts(dict(record.signals()), record.time) == []
    assert not any("looks as if" in each or "looks wrong" in each or "contradicts" in each for each in record.remarks)


@pytest.mark.parametrize("minimum", [0.7, 1.6, 2.0, 3.3, 4.4])
def test_the_minimum_of_a_parabola_is_found_between_its_samples(minimum):
    assert _refined_minimum(7.0 * (np.arange(6.0) - minimum) ** 2 + 2.0) == pytest.approx(minimum)


@pytest.mark.parametrize("errors", [[1.0, 2.0, 3.0], [3.0, 2.0, 1.0], [2.0, 2.0, 2.0]])
def test_a_smallest_value_at_an_end_is_not_a_minimum(errors):
    assert _refined_minimum(np.array(errors)) is None


@pytest.mark.parametrize(
    ("parts", "fraction", "other"), [(6, 0.1, True), (5, 0.1, False), (8, 0.74, True), (8, 0.76, False)]
)
def test_another_frame_is_reported_if_it_reduces_the_error_by_a_quarter_in_six_of_eight_parts(parts, fraction, other):
    """The other frame increases the error slightly in the remaining parts."""
    signal = np.tile([1.0, -1.0], 400)[:, None]
    pair = _Pair("velocity", "it", signal, 1.5 * signal, 0.1, ("x",))
    # The squared errors are multiplied by `fraction`.
    factors = np.repeat(np.where(np.arange(8) < parts, np.sqrt(fraction), 1.01), 100)[:, None]
    turned = pair._replace(measured=signal * (1.0 + 0.5 * factors))
    assert _is_other_frame(pair, turned) == other


def test_position_and_velocity_in_ned_are_recognised_together():
    clean = flight()
    ned = {name: clean[name] * HALF_TURN for name in ("position", "velocity")}
    (remark,) = found(ned)
    assert remark.endswith("position and velocity look as if NED were taken for NWU")


def test_samples_in_reverse_order_are_recognised():
    (remark,) = texts({name: values[::-1] for name, values in flight().items()}, TIME)
    assert remark.endswith("the samples look as if they were in reverse order")
