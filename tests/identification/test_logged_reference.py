"""Tests that the reference in a log becomes a route, by comparison with known paths."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.identification.validation import reference
from drake_quad.identification.validation.free_flight import free_flight
from drake_quad.identification.validation.reference import logged_reference
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path

POINTS = np.array([[0.0, 0.0, 1.0], [1.0, 0.4, 1.2], [0.3, -0.5, 0.9], [0.0, 0.0, 1.0]])  # waypoints (m)
PATH = minimum_snap(POINTS, np.array([0.0, 1.3, 2.9, 4.4]))


def logged(path, *, period=0.004, held=1, begin=0.0, end=None, velocity=True, **signals):
    """Return a log of a path whose reference changes only once in `held` samples."""
    end = path.times[-1] if end is None else end
    time = np.arange(begin, end, period)
    sent = time[np.arange(len(time)) // held * held]
    faster = {"reference_velocity": evaluate(path, sent, 1).T} if velocity else {}
    return FlightRecord("a", time - begin, reference_position=evaluate(path, sent).T, **faster, **signals)


def route_path(route):
    """Return the path of a route, from its knots."""
    rows = [[knot.position, knot.velocity, knot.acceleration, knot.jerk] for knot in route.knots]
    return hermite_path(np.array([knot.time for knot in route.knots]), np.array(rows))


def distance(recovered, path: PolynomialPath, start, delay=0.0):
    time = np.linspace(0.1, path.times[-1] - 0.1, 500)
    return np.abs(evaluate(route_path(recovered.route), time + start) - evaluate(path, time - delay)).max()


def test_a_path_is_recovered_with_its_acceleration_and_jerk():
    result = logged_reference(logged(PATH), rest=2.0)
    assert (result.start, result.route.knots[0].time) == (2.0, 0.0)
    assert result.deviation < 2e-3
    assert distance(result, PATH, 2.0) < 1e-4
    time = np.linspace(0.2, 4.2, 300)
    for order, allowed in ((1, 1e-3), (2, 0.02), (3, 0.5)):
        actual = evaluate(route_path(result.route), time + 2.0, order)
        np.testing.assert_allclose(actual, evaluate(PATH, time, order), atol=allowed)


@pytest.mark.parametrize("velocity", [True, False])
def test_rounded_and_held_values_hardly_change_the_path(velocity):
    """A path that is rounded to 1 mm and sent at 50 Hz is reconstructed to 0.5 mm.

    Its delay is half of the hold time minus half a sample.
    """
    record = logged(PATH, held=5, velocity=velocity)
    cut = FlightRecord(
        "a",
        record.time,
        reference_position=np.trunc(1e3 * record.reference_position) / 1e3,
        reference_velocity=record.reference_velocity,
    )
    result = logged_reference(cut, rest=1.0)
    assert distance(result, PATH, 1.0, delay=0.008) < 1.1e-3
    assert result.deviation < 2e-3
    # If the delay were ignored, the error would be the distance travelled during half of the hold time.
    assert distance(result, PATH, 1.0) > 5e-3


def test_before_the_log_starts_the_route_rests_at_the_first_logged_position():
    knots = logged_reference(logged(PATH), rest=3.0).route.knots
    for knot in (knots[0], knots[1], knots[2]):
        np.testing.assert_allclose(knot.position, POINTS[0], atol=1e-4)
        np.testing.assert_allclose([knot.velocity, knot.acceleration], 0.0, atol=1e-3)
    assert [knot.time for knot in knots[:3]] == [0.0, 1.5, 3.0]


def test_a_log_that_begins_in_motion_is_preceded_by_a_run_up():
    record = logged(PATH, begin=0.7)
    result = logged_reference(record, rest=4.0)
    path = route_path(result.route)
    np.testing.assert_allclose(evaluate(path, [4.0]).T[0], record.reference_position[0], atol=2e-3)
    np.testing.assert_allclose(evaluate(path, [4.0], 1).T[0], record.reference_velocity[0], atol=1e-2)
    assert np.linalg.norm(record.reference_velocity[0]) > 0.5
    np.testing.assert_array_equal(result.route.knots[0].velocity, 0.0)
    # The run-up does not reverse, and hardly exceeds the speed at the first sample of the log.
    along = evaluate(path, np.linspace(0.0, 4.0, 200), 1).T @ record.reference_velocity[0]
    full = np.linalg.norm(record.reference_velocity[0]) ** 2
    assert -0.1 * full < along.min() <= along.max() < 1.3 * full
    with pytest.raises(InputError, match="already moves at its first sample; rest must be larger than 0"):
        logged_reference(record)


def test_a_gap_is_filled_smoothly():
    """The minimum-snap path through a gap of 0.9 s stays near the true one."""
    record = logged(PATH)
    result = logged_reference(record.subset((record.time < 1.0) | (record.time > 1.9)), rest=1.0)
    assert distance(result, PATH, 1.0) < 0.05


@pytest.mark.parametrize("velocity", [True, False])
def test_a_path_across_a_gap_at_the_beginning_starts_at_rest(velocity):
    """Two equal samples show that the reference rests. The minimum-snap path across the gap is near the true path."""
    record = logged(PATH)
    speed = np.vstack([np.zeros((2, 3)), record.reference_velocity[200:]])
    resting = FlightRecord(
        "a",
        np.array([0.0, 0.001, *record.time[200:]]),
        reference_position=np.vstack([POINTS[:1], POINTS[:1], record.reference_position[200:]]),
        reference_velocity=speed if velocity else None,
    )
    result = logged_reference(resting, rest=1.0)
    assert distance(result, PATH, 1.0) < 0.02
    first = next(knot for knot in result.route.knots if knot.time == 1.0)
    np.testing.assert_allclose([first.velocity, first.acceleration, first.jerk], 0.0, atol=1e-3)


def test_the_yaw_of_the_route_is_the_unwrapped_logged_yaw():
    time = np.arange(0.0, 4.0, 0.004)
    yaw = 3.0 + 0.8 * np.sin(time)
    record = logged(PATH, end=4.0 - 1e-9, reference_yaw=(yaw + np.pi) % (2.0 * np.pi) - np.pi)
    knots = logged_reference(record, rest=1.0).route.yaw_knots
    assert (knots[0].time, knots[0].yaw_rate, knots[0].yaw) == (0.0, 0.0, knots[1].yaw)
    result = {knot.time - 1.0: knot.yaw for knot in knots[1:]}
    np.testing.assert_allclose([*result.values()], 3.0 + 0.8 * np.sin([*result]), atol=1e-3)


@pytest.mark.parametrize("attitude", [None, 0.3])
def test_the_measured_yaw_is_used_if_no_reference_yaw_is_logged(attitude):
    record = logged(PATH)
    if attitude is not None:
        angles = np.tile([0.0, 0.0, attitude], (len(record.time), 1))
        angles[:100] = 2.0  # a different yaw before the take-off
        record = logged(PATH, attitude=angles)
    assert {knot.yaw for knot in logged_reference(record, rest=1.0).route.yaw_knots} == {attitude or 0.0}


def jumping(*, period=0.004, **signals):
    """Return a record whose reference jumps by 10 cm at 2.4 s."""
    record = logged(PATH, period=period, velocity=False, **signals)
    position = record.reference_position.copy()
    position[600:] += [0.1, 0.0, 0.0]
    return replace(record, reference_position=position)


def test_the_route_of_a_jumping_reference_consists_of_the_logged_setpoints():
    """Every logged value is held exactly from its sample to the next."""
    record = replace(jumping(), reference_yaw=np.linspace(3.0, 3.4, 1100) % (2.0 * np.pi) - 2.0 * np.pi)
    result = logged_reference(record, rest=1.5)
    assert (result.start, result.deviation, result.jump) == (1.5, 0.0, pytest.approx(2.4))
    rows = np.array(result.route.setpoints)
    assert rows[0, 0] == 0.0
    held = rows[np.searchsorted(rows[:, 0], record.time + 1.5 + 1e-6) - 1]
    np.testing.assert_array_equal(held[:, 1:4], record.reference_position)
    np.testing.assert_allclose(np.diff(rows[:, 4]), 0.4 / 1099, rtol=1e-6)
    assert rows[-1, 0] + result.route.last_hold == pytest.approx(record.time[-1] + 1.5, abs=1e-3)
    assert "setpoints, each held until the next, since they jump at 2.40 s" in str(result)


def test_a_flight_with_a_take_off_begins_at_the_position_on_the_ground():
    """Setpoints before the lift-off are left out. The clock of the route begins at the lift-off."""
    standing = np.array([0.3, -0.2, 0.06])
    record = jumping()
    record = replace(record, position=np.tile(standing, (len(record.time), 1)))
    result = logged_reference(record, rest=8.0, lift_off=100)
    rows = np.array(result.route.setpoints)
    np.testing.assert_array_equal(rows[0], [0.0, *standing, 0.0])
    assert result.start == pytest.approx(-record.time[100], abs=1e-3)
    held = rows[np.searchsorted(rows[:, 0], record.time[100:] + result.start + 1e-6) - 1]
    np.testing.assert_array_equal(held[:, 1:4], record.reference_position[100:])


def test_a_jumping_reference_with_a_logged_velocity_is_refused_with_the_time():
    record = replace(jumping(), reference_velocity=logged(PATH).reference_velocity)
    message = r"off by \d\d\.\d mm at 2\.\d+ s; a possible cause is a jump"
    with pytest.raises(InputError, match=message):
        logged_reference(record, rest=1.0)


def test_a_log_without_a_reference_is_refused():
    with pytest.raises(InputError, match="lacks reference_position; it has no signals"):
        logged_reference(FlightRecord("a", np.array([0.0, 1.0])))


@pytest.mark.parametrize("orders", [2, 4])
def test_a_fit_is_the_least_squares_spline_through_values_and_derivatives(orders):
    """The expected fit is a single least-squares solution for all derivatives at all knots."""
    random = np.random.default_rng(2)
    time = np.sort(random.uniform(0.0, 2.0, 120))
    samples = [random.normal(size=(120, 2)), random.normal(size=(120, 2))]
    result = reference._fitted_path(time, samples, end=2.0, spacing=0.6, orders=orders)
    # The path has the smallest number of knots that are at most `spacing` apart.
    np.testing.assert_allclose(result.times, np.linspace(0.0, 2.0, 5))
    columns = []
    for knot in range(5):
        for order in range(orders):
            unit = np.zeros((5, orders, 1))
            unit[knot, order] = 1.0
            path = hermite_path(result.times, unit)
            columns.append(np.concatenate([evaluate(path, time, each)[0] for each in (0, 1)]))
    _, min_squares, *_ = np.linalg.lstsq(np.array(columns).T, np.vstack(samples), rcond=None)
    residual_squares = [np.sum((evaluate(result, time, each).T - samples[each]) ** 2, axis=0) for each in (0, 1)]
    np.testing.assert_allclose(residual_squares[0] + residual_squares[1], min_squares, rtol=1e-3)


def test_a_value_that_is_held_briefly_counts_once_at_the_middle_of_the_hold():
    """A value held for more than 50 ms is a rest, and each of its samples counts."""
    time = 0.01 * np.arange(17)
    values = np.array([0, 0, 0, 1, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3], dtype=float)
    sent, unrepeated = reference._without_repetitions(time, [values[:, None]])
    expected = [(0.01, 0.0), (0.03, 1.0), (0.065, 2.0), *((0.01 * k, 3.0) for k in range(10, 17))]
    np.testing.assert_allclose(np.column_stack([sent, unrepeated[:, 0]]), expected)
    # A sample with the same position but another velocity is not a repetition, and is kept.
    sent, position, speed = reference._without_repetitions(
        time[:3], [np.zeros((3, 1)), np.array([[0.0], [0.0], [1.0]])]
    )
    np.testing.assert_allclose(np.column_stack([sent, position[:, 0], speed[:, 0]]), [(0.005, 0, 0), (0.02, 0, 1)])


def test_a_setpoint_is_held_until_the_next_one():
    """If several setpoints are less than a control period apart, the first of them counts."""
    time = np.array([0.0, 0.1, 0.2, 0.20001, 0.3, 0.5, 0.9])
    height = np.array([1.0, 1.0, 2.0, 2.5, 2.5, 4.0, 4.0])
    position = np.column_stack([np.zeros(7), np.zeros(7), height])
    result = reference._setpoint_reference(FlightRecord("a", time, reference_position=position), 2.0, None)
    rows = np.array(result.route.setpoints)
    np.testing.assert_allclose(rows[:, [0, 3]], [[0.0, 1.0], [2.2, 2.0], [2.5, 4.0]])
    assert result.route.last_hold == pytest.approx(0.4)
    assert (result.start, result.jump) == (2.0, pytest.approx(0.5))
    # A setpoint at the last sample is held for less than 1 ms.
    short = FlightRecord("a", time[:6], reference_position=position[:6], reference_yaw=np.array([0, 0, 3, 3, -3, -3.0]))
    result = reference._setpoint_reference(short, 2.0, None)
    assert 0.0 < result.route.last_hold < 1e-3
    np.testing.assert_allclose(np.array(result.route.setpoints)[:, 4], [0.0, 3.0, 2.0 * np.pi - 3.0, 2.0 * np.pi - 3.0])


def test_setpoints_begin_at_the_lift_off_with_the_yaw_of_the_reference():
    time = 0.1 * np.arange(10)
    position = np.column_stack([np.arange(10.0), np.zeros(10), np.ones(10)])
    record = FlightRecord(
        "a", time, position=np.full((10, 3), 0.2), reference_position=position, reference_yaw=0.1 * np.arange(10.0)
    )
    result = reference._setpoint_reference(record, 5.0, 4)
    rows = np.array(result.route.setpoints)
    np.testing.assert_allclose(rows[0], [0.0, 0.2, 0.2, 0.2, 0.4])
    np.testing.assert_allclose(rows[1:, 1], np.arange(4.0, 10.0))
    np.testing.assert_allclose(rows[1:, 4], 0.1 * np.arange(4.0, 10.0))
    np.testing.assert_allclose(np.diff(rows[1:, 0]), 0.1)
    assert 0.0 < rows[1, 0] < 1e-3
    assert result.start == pytest.approx(rows[1, 0] - 0.4)


def test_a_route_states_its_number_of_pieces_and_its_error():
    result = logged_reference(logged(PATH))
    pieces = len(result.route.knots) - 1
    assert str(result) == f"{pieces} pieces of degree 7, within {1e3 * result.deviation:.2f} mm of the logged positions"
    assert (result.start, result.jump, result.route.knots[0].time) == (0.0, None, 0.0)


@pytest.mark.parametrize(("end", "pieces"), [(0.3, 1), (0.5, 1), (0.51, 2), (1.01, 3)])
def test_knots_are_at_most_the_given_distance_apart(end, pieces):
    time = np.linspace(0.0, end, 50)
    result = reference._fitted_path(time, [np.sin(time)[:, None]], end=end, spacing=0.5, orders=4)
    np.testing.assert_allclose(result.times, np.linspace(0.0, end, pieces + 1))
    np.testing.assert_allclose(evaluate(result, time)[0], np.sin(time), atol=1e-5)


def test_the_yaw_knots_cover_the_whole_route():
    record = logged(PATH)
    for rest in (0.0, 2.0):
        first, last = reference._yaw_knots(record, rest)
        assert (first.time, last.time) == (0.0, pytest.approx(record.time[-1] + rest))
    yaw = np.sin(record.time)
    turning = replace(record, reference_yaw=yaw)
    for rest in (0.0, 2.0):
        knots = reference._yaw_knots(turning, rest)
        assert knots[0].time == 0.0
        moving = knots[1:] if rest else knots
        np.testing.assert_allclose(
            [knot.yaw for knot in moving], np.sin([knot.time - rest for knot in moving]), atol=1e-3
        )
        rates = [knot.yaw_rate for knot in moving]
        np.testing.assert_allclose(rates, np.cos([knot.time - rest for knot in moving]), atol=0.02)
        assert moving[-1].time == pytest.approx(record.time[-1] + rest)


def test_a_yaw_of_cubic_pieces_is_recovered_with_its_rates():
    """Each piece lasts half a second. The yaw acceleration jumps where two pieces meet."""
    random = np.random.default_rng(6)
    times = np.linspace(0.0, 4.0, 9)
    rows = random.uniform(-1.0, 1.0, (9, 2, 1))
    time = np.linspace(0.0, 4.0, 801)
    yaw = evaluate(hermite_path(times, rows), time)[0]
    record = FlightRecord("a", time, reference_position=np.zeros((801, 3)), reference_yaw=yaw)
    knots = reference._yaw_knots(record, 0.0)
    np.testing.assert_allclose([knot.time for knot in knots], times)
    np.testing.assert_allclose([[knot.yaw, knot.yaw_rate] for knot in knots], rows[:, :, 0], atol=1e-4)


def test_the_approach_to_the_first_knot_accelerates_during_half_of_the_initial_phase():
    first = reference.Knot(time=0.0, position=(1.0, 2.0, 3.0), velocity=(0.4, 0.0, -0.8))
    begin, away = reference._approach(first, 3.0)
    assert (begin.time, away.time) == (0.0, 1.5)
    np.testing.assert_allclose([begin.position, away.position], [[0.7, 2.0, 3.6]] * 2)
    np.testing.assert_array_equal([begin.velocity, away.velocity], np.zeros((2, 3)))


@pytest.mark.parametrize("rest", [0.0, 1.0])
def test_a_reference_whose_first_two_samples_are_equal_starts_at_rest(monkeypatch, rest):
    """If velocities are logged, the velocities of both samples must be zero as well."""
    calls = []
    fitted = reference._fitted_path

    def recorded_fit(*arguments, at_rest=False, **options):
        calls.append(at_rest)
        return fitted(*arguments, at_rest=at_rest, **options)

    monkeypatch.setattr(reference, "_fitted_path", recorded_fit)
    time = np.linspace(0.0, 1.0, 101)
    resting = np.tile([0.0, 0.0, 1.0], (101, 1))
    moving, moving_sideways = resting.copy(), np.zeros((101, 3))
    moving[1:, 0] += 1e-4
    moving_sideways[0, 1] = 1e-4
    for position, velocity, at_rest in (
        (resting, None, True),
        (resting, np.zeros((101, 3)), True),
        (moving, None, False),
        (moving, np.zeros((101, 3)), False),
        (resting, moving_sideways, False),
    ):
        logged_reference(FlightRecord("a", time, reference_position=position, reference_velocity=velocity), rest=rest)
        assert calls == [at_rest]
        calls.clear()


def slowly_logged(record, period, *, offset=0.0):
    """Return the record with a reference that is logged with a period (s), and held until its next sample."""
    number = np.maximum(np.floor((record.time - offset) / period + 1e-9), 0.0)
    rows = np.searchsorted(record.time, offset + period * number - 1e-9)
    speed = record.reference_velocity
    return replace(
        record,
        reference_period=period,
        reference_position=record.reference_position[rows],
        reference_velocity=None if speed is None else speed[rows],
    )


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("period", [0.1, 0.2])
def test_a_slowly_logged_reference_is_recovered_without_a_delay(period, velocity):
    """The reference rests for a second before it moves."""
    path = minimum_snap(POINTS, np.array([0.0, 2.0, 4.0, 6.0]))
    record = logged(path, velocity=velocity)
    rested = replace(
        record,
        time=np.append(0.004 * np.arange(250), 1.0 + record.time),
        reference_position=np.vstack([np.tile(POINTS[0], (250, 1)), record.reference_position]),
        reference_velocity=np.vstack([np.zeros((250, 3)), record.reference_velocity]) if velocity else None,
    )
    result = logged_reference(slowly_logged(rested, period, offset=0.04), rest=1.0)
    assert result.deviation < 2e-3
    assert (result.start, result.end) == (1.0, pytest.approx(rested.time[-1], abs=period))
    time = np.linspace(1.0, 1.0 + record.time[-1] - 0.3, 300)
    error = evaluate(route_path(result.route), time + 1.0) - evaluate(path, time - 1.0)
    # A path through the middle of each held value would be late by half a period, which is 4 to 9 cm at 0.9 m/s.
    assert np.abs(error).max() < 5e-3


def test_velocities_that_contradict_the_positions_are_ignored_and_reported():
    """PX4 logs velocities that are not the derivatives of its positions while the vehicle lags behind."""
    record = logged(PATH)
    lagging = replace(record, reference_velocity=record.reference_velocity + np.array([0.0, 0.0, 0.3]))
    for each in (lagging, slowly_logged(lagging, 0.1)):
        result = logged_reference(each, rest=1.0)
        assert result.velocity_deviation == pytest.approx(0.3, abs=0.05)
        assert "not used, since they differ from the derivatives of the logged positions by up to 0.3" in str(result)
        assert distance(result, PATH, 1.0) < 5e-3
    assert logged_reference(record, rest=1.0).velocity_deviation is None


def test_repeated_samples_of_a_slow_reference_are_kept():
    """The log contains three equal samples of the reference at rest, before the reference moves."""
    time = 0.02 * np.arange(50)
    position = np.array([1.0, 1.0, 1.0, 2.0, 3.0])[np.arange(50) // 10]
    record = FlightRecord(
        "a", time, reference_position=np.column_stack([position, position, position]), reference_period=0.2 * 1.02
    )
    at_logged_rate = reference._as_logged(record)
    np.testing.assert_allclose(at_logged_rate.time, [0.0, 0.2, 0.4, 0.6, 0.8], atol=1e-9)
    np.testing.assert_array_equal(at_logged_rate.reference_position[:, 0], [1.0, 1.0, 1.0, 2.0, 3.0])
    fast = replace(record, reference_period=0.05)
    assert reference._as_logged(fast) is fast


@pytest.mark.parametrize("velocity", [True, False])
def test_a_slow_reference_that_jumps_is_not_a_smooth_path(velocity):
    """A path through two samples 0.1 s apart would follow a jump of 1 m at 500 m/s²."""
    record = logged(PATH, velocity=velocity)
    position = record.reference_position.copy()
    position[600:] += [1.0, 0.0, 0.0]
    jumping = slowly_logged(replace(record, reference_position=position), 0.1)
    if velocity:
        with pytest.raises(InputError, match="a possible cause is a jump of the reference"):
            logged_reference(jumping, rest=1.0)
    else:
        assert logged_reference(jumping, rest=1.0).jump == pytest.approx(2.4, abs=0.11)


def test_a_smooth_reference_begins_at_the_lift_off():
    """PX4 commands a descending reference on the ground, which jumps to the position of the vehicle at take-off."""
    record = logged(PATH)
    record = replace(record, position=record.reference_position)
    position, speed = record.reference_position.copy(), record.reference_velocity.copy()
    position[:300], speed[:300] = [5.0, 5.0, 0.0], [0.0, 0.0, -0.7]
    result = logged_reference(
        replace(record, reference_position=position, reference_velocity=speed), rest=2.0, lift_off=300
    )
    assert result.start == pytest.approx(2.0 - record.time[300])
    assert result.end == pytest.approx(record.time[-1])
    time = np.linspace(record.time[310], record.time[-1] - 0.1, 200)
    np.testing.assert_allclose(evaluate(route_path(result.route), time + result.start), evaluate(PATH, time), atol=1e-3)


@pytest.mark.parametrize(("distance", "kind"), [(0.3, "setpoints"), (0.2, "trajectory")])
def test_a_smooth_reference_with_a_step_at_take_off_becomes_setpoints(distance, kind):
    """If the vehicle lifts off far below the reference, a smooth path that starts on the reference omits the climb."""
    path_positions = logged(PATH, velocity=False).reference_position
    reference_position = np.vstack([np.zeros((100, 3)), np.tile(POINTS[0], (200, 1)), path_positions])
    position = np.tile(POINTS[0] - [0.0, 0.0, distance], (len(reference_position), 1))
    record = FlightRecord(
        "a", 0.004 * np.arange(len(reference_position)), position=position, reference_position=reference_position
    )
    assert logged_reference(record, rest=1.0, lift_off=150).route.kind == kind


def test_the_reference_of_a_shipped_ulog_is_a_path_with_small_accelerations(root):
    """PX4 logs setpoints at 5 Hz. They climb at 1 m/s, and descend at 0.7 m/s until the landing."""
    record = read_log(root / "tests/data/px4/sample_px4_events.ulg.xz")
    assert record.reference_period == pytest.approx(0.2, rel=0.05)
    part = free_flight(record)
    result = logged_reference(record.subset(slice(part.end)), rest=8.0, lift_off=part.lift_off)
    path = route_path(result.route)
    time = np.linspace(8.0, path.times[-1], 500)
    assert np.abs(evaluate(path, time, 2)).max() < 4.0
    assert 0.8 < evaluate(path, time, 1)[2].max() < 1.1
    descending = (time > path.times[-1] - 1.5) & (time < path.times[-1] - 0.2)
    np.testing.assert_allclose(evaluate(path, time[descending], 1)[2], -0.7, atol=0.02)
