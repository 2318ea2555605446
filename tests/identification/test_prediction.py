"""Open-loop prediction: what a vehicle that is right, and one that is wrong, are off by."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.model import (
    OpenLoop,
    Starts,
    delay_of,
    level_vehicle,
    with_level_commands,
)
from drake_quad.identification.windows import airborne, held_out
from drake_quad.identification.flown_again import prediction
from drake_quad.identification.flown_again.prediction import (
    Predictions,
    _angle_between,
    _begun,
    _continuous,
    _difference,
    _errors,
    _reached,
    _starts,
    joined,
    predict,
)
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import quantile
from drake_quad.identification.results.vehicle_numbers import with_numbers, with_throttles
from drake_quad.scenario.files.loading import load_undesigned


@pytest.fixture(scope="module")
def scenario(root):
    overrides = (
        "duration=10",
        "laboratory.wind=[{kind: steady, velocity: [1.0, 0.0, 0.0]}]",
        # So that a command shows as late as the delay of a scenario says, of link and cameras.
        "laboratory.motion_capture.period=0.01",
        "laboratory.command_link.delay_ticks=0",
        "laboratory.command_link.loss_rate=0",
    )
    return load_scenario(root / "diagrams" / "laboratory.yaml:low_wind", overrides)


@pytest.fixture(scope="module")
def record(scenario):
    """The state without noise, 10 ms after it was, and the commands as they acted."""
    flight = simulate(scenario, compiled=True)
    state = np.array([np.interp(flight.time - 0.01, flight.time, row) for row in flight["state"].T]).T
    command = np.concatenate([flight["rotor_speed_command"][1:], flight["rotor_speed_command"][-1:]])
    rows = {"position": state[:, :3], "attitude": state[:, 3:6], "velocity": state[:, 6:9], "body_rates": state[:, 9:]}
    return FlightRecord("flown", flight.time, **rows, rotor_speed_command=command)


@pytest.fixture(scope="module")
def predictions(record, scenario):
    factor = 1.1 * scenario.vehicle.thrust_factor
    stronger = with_numbers(scenario, {"thrust_factor": factor})
    return predict(record, {"right": scenario, "stronger": stronger}, horizons=(0.1, 0.5, 1.0))


def test_a_vehicle_that_is_right_is_off_by_next_to_nothing(predictions):
    assert predictions.rmse("position", "right", 0.5).value < 2e-3
    assert predictions.rmse("attitude", "right", 0.5).value < 5e-3


@pytest.mark.parametrize("horizon", [0.1, 0.5])
def test_a_tenth_more_thrust_lifts_by_that_of_gravity(predictions, horizon):
    """From rotors that turn as they are told: they have followed the same commands, and lift a tenth more at once."""
    expected = 0.5 * 0.1 * 9.81 * horizon**2
    assert predictions.rmse("position", "stronger", horizon).value == pytest.approx(expected, rel=0.1)
    better = predictions.better("position", "right", "stronger", horizon)
    assert better.low > 0.8
    assert better.value == pytest.approx(
        1.0 - predictions.rmse("position", "right", horizon).value / expected, abs=0.05
    )


def test_fewer_starts_reach_farther_horizons(predictions):
    starts = [predictions.starts(horizon) for horizon in predictions.horizons]
    assert starts[0] > starts[1] > starts[2] > 50


def test_intervals_are_those_of_blocks():
    """Of blocks of a second with one start each: Student's t of the mean square, on the scale of its logarithm."""
    errors = np.array([1.0, 2.0, 1.5, 0.5, 1.0, 3.0])
    squares = errors**2
    given = Predictions(
        ("one", "other"),
        (0.5,),
        np.array(["a"] * 6),
        np.arange(6.0),
        {"position": np.stack([errors, 2.0 * errors])[:, None]},
    )
    found = given.rmse("position", "one", 0.5)
    reach = 2.570582 * np.std(squares, ddof=1) / math.sqrt(6) / (2.0 * np.mean(squares))
    assert found.value == pytest.approx(math.sqrt(np.mean(squares)))
    assert found.high == pytest.approx(found.value * math.exp(reach), rel=1e-6)
    assert given.better("position", "one", "other", 0.5) == pytest.approx((0.5, 0.5, 0.5))
    both = joined([given, given])
    assert both.starts(0.5) == 12
    single = Predictions(
        ("one",), (0.5,), np.array(["a"] * 2), np.array([0.0, 0.1]), {"position": errors[None, None, :2]}
    )
    assert single.rmse("position", "one", 0.5).high == math.inf


def test_a_model_without_errors_is_better_than_all_others():
    errors = np.stack([np.zeros(6), np.arange(1.0, 7.0)])[:, None]
    given = Predictions(("exact", "other"), (0.5,), np.array(["a"] * 6), np.arange(6.0), {"position": errors})
    assert given.rmse("position", "exact", 0.5) == (0.0, 0.0, 0.0)
    assert given.better("position", "exact", "other", 0.5) == (1.0, 1.0, 1.0)
    assert np.isnan(given.better("position", "other", "exact", 0.5)).all()
    assert np.isnan(given.better("position", "exact", "exact", 0.5)).all()


def test_an_exact_prediction_or_two_do_not_make_a_model_exact():
    errors = np.array([0.0, 1.0, 2.0, 3.0, 0.0, 2.0])
    given = Predictions(
        ("one", "other"),
        (0.5,),
        np.array(["a"] * 6),
        np.arange(6.0),
        {"position": np.stack([errors, 2.0 * errors])[:, None]},
    )
    assert given.better("position", "one", "other", 0.5) == pytest.approx((0.5, 0.5, 0.5))


def test_joined_predictions_have_the_quantities_that_all_logs_have():
    def part(name, count, *quantities):
        numbers = np.arange(2.0 * 3.0 * count).reshape(2, 3, count)
        return Predictions(
            ("one", "other"),
            (0.1, 0.5, 1.0),
            np.array([name] * count),
            np.arange(1.0 * count),
            dict.fromkeys(quantities, numbers),
        )

    both = joined([part("a", 4, "position", "attitude", "velocity"), part("b", 2, "velocity", "position")])
    assert set(both.errors) == {"position", "velocity"}
    assert both.errors["position"].shape == (2, 3, 6)
    np.testing.assert_array_equal(both.errors["position"][..., 4:], np.arange(12.0).reshape(2, 3, 2))
    assert both.log.tolist() == ["a"] * 4 + ["b"] * 2
    assert both.time.tolist() == [0.0, 1.0, 2.0, 3.0, 0.0, 1.0]
    assert (both.vehicles, both.horizons) == (("one", "other"), (0.1, 0.5, 1.0))


def test_blocks_are_as_long_as_the_horizon_and_lie_within_one_log():
    """Errors that are constant over two seconds have the interval of independent blocks of two seconds."""
    sizes = np.array([1.0, 2.0, 1.5, 0.5, 1.0, 3.0])
    time = np.concatenate([np.arange(0.0, 8.0, 0.1), np.arange(0.0, 4.0, 0.1)])
    log = np.array(["a"] * 80 + ["b"] * 40)
    errors = np.repeat(sizes, 20)[None, None]
    found = Predictions(("one",), (2.0,), log, time, {"position": errors}).rmse("position", "one", 2.0)
    squares = sizes**2
    reach = quantile(5) * np.std(squares, ddof=1) / math.sqrt(6) / (2.0 * np.mean(squares))
    assert found.high / found.value == pytest.approx(math.exp(reach), rel=1e-6)
    assert found.low / found.value == pytest.approx(math.exp(-reach), rel=1e-6)
    empty = Predictions(("one",), (2.0,), log, time, {"position": np.full((1, 1, 120), np.nan)})
    assert np.isnan(empty.rmse("position", "one", 2.0)).all()
    assert np.isnan(empty.better("position", "one", "one", 2.0)).all()


@pytest.mark.parametrize(("every", "past"), [(2, 4), (3, 3), (5, 3)])
def test_a_start_is_fitted_to_what_is_before_it(record, scenario, monkeypatch, every, past):
    """To 0.15 s, and to three samples at least; the log has 50 / every samples per second."""
    asked = []

    def no_starts(log, before, *_):
        asked.append(before)
        return np.array([], dtype=int)

    monkeypatch.setattr(prediction, "_starts", no_starts)
    rows = {name: values[::every] for name, values in record.signals()}
    with pytest.raises(InputError, match="has no stretch in the air"):
        predict(FlightRecord("log", record.time[::every], **rows), {"true": scenario})
    assert asked == [past]


def test_vehicles_are_compared_over_the_same_starts():
    """The interval is that of the differences of squares, each over their mean, start by start."""
    random = np.random.default_rng(4)
    own, others = random.uniform(1.0, 2.0, (2, 12))
    given = Predictions(
        ("one", "other"), (0.5,), np.array(["a"] * 12), np.arange(12.0), {"position": np.stack([own, others])[:, None]}
    )
    better = given.better("position", "one", "other", 0.5)
    ratio = math.sqrt(np.mean(own**2) / np.mean(others**2))
    differences = own**2 / np.mean(own**2) - others**2 / np.mean(others**2)
    reach = 0.5 * quantile(11) * math.sqrt(12.0 / 11.0 * np.sum(differences**2)) / 12.0
    assert better == pytest.approx((1.0 - ratio, 1.0 - ratio * math.exp(reach), 1.0 - ratio * math.exp(-reach)))


def test_errors_are_distances_and_angles_between_attitudes():
    """The predicted vehicle is displaced and rotated from a vehicle that rests at another attitude."""
    one, other = np.array([[0.3, -0.2, 3.0]]), np.array([[0.1, 0.4, -3.0]])
    first, second = (RollPitchYaw(*each[0]).ToRotationMatrix() for each in (one, other))
    expected = (first.inverse() @ second).ToAngleAxis().angle()
    np.testing.assert_allclose(_angle_between(one, other), abs(expected))
    flown = np.zeros((11, 1, 12))
    flown[10, 0, :3] = [1.0, 2.0, 2.0]
    flown[10, 0, 3:6] = one[0]
    flown[10, 0, 6:9] = [0.0, 3.0, 4.0]
    count = 30
    log = FlightRecord(
        "log",
        0.01 * np.arange(count),
        position=np.zeros((count, 3)),
        attitude=np.tile(other, (count, 1)),
        velocity=np.zeros((count, 3)),
    )
    names = ["position", "velocity", "attitude"]
    found = _errors(log, names, flown, np.array([5]), [10], False)
    np.testing.assert_allclose([found[name][0, 0] for name in names], [3.0, 5.0, abs(expected)])
    level = _errors(log, ["position", "velocity"], flown, np.array([5]), [10], True)
    assert {name: float(values[0, 0]) for name, values in level.items()} == {"height": 2.0, "climb": 4.0}


def test_starts_are_after_gaps_and_before_the_end(record, scenario):
    kept = (record.time < 4.0) | (record.time > 4.5)
    found = predict(record.part(kept), {"right": scenario}, horizons=(0.5,))
    error = found.errors["position"][0, 0]
    over_gap = (found.time > 3.45) & (found.time < 4.0)
    assert np.isnan(error[over_gap]).all() or not over_gap.any()
    assert not ((found.time > 4.5) & (found.time < 4.85)).any()
    assert np.nanmax(error) < 0.02


def test_only_the_end_is_predicted_where_that_is_asked_for(record, scenario):
    found = predict(record, {"right": scenario}, horizons=(0.1,), share=0.25)
    assert found.time.min() > 7.4


def test_a_log_of_which_nothing_can_be_predicted_is_refused(record, scenario):
    bare = FlightRecord("bare", record.time, rotor_speed_command=record.rotor_speed_command)
    with pytest.raises(InputError, match="needs position, velocity, attitude or body_rates"):
        predict(bare, {"right": scenario})
    with pytest.raises(InputError, match="no stretch in the air that lasts 0.65 s"):
        predict(record.part(slice(0, 20)), {"right": scenario}, horizons=(0.5,))
    with pytest.raises(InputError, match="no stretch in the air that lasts 2.1 s"):
        predict(record.part(slice(0, 100)), {"right": scenario}, horizons=(2.0,))
    with pytest.raises(InputError, match="no log to predict"):
        joined([])


@pytest.mark.slow
def test_a_crazyflie_is_predicted_better_by_a_third_at_least(root):
    """Fitted to the first two thirds of a flight, beside the data sheet on the last."""
    base = load_undesigned(root / "diagrams" / "vehicles" / "crazyflie.yaml", ["nominal.mass=0.0375"])
    record = read_log(root / "tests" / "data" / "crazyflie" / "crazyswarm2" / "log100.xz")
    found = identify([record], base)
    predictions = predict(record, {"identified": found.vehicle, "data sheet": base}, believed=base, share=1 / 3)
    assert predictions.better("position", "identified", "data sheet", 0.5).low > 0.3
    assert predictions.rmse("position", "identified", 0.5).value < 0.1


@pytest.mark.slow
def test_a_flight_without_attitude_tells_its_height(root):
    """Fitted to one flight, predicting another."""
    base = with_throttles(load_undesigned(root / "diagrams" / "vehicles" / "crazyflie.yaml", ["nominal.mass=0.0287"]))
    folder = root / "tests" / "data" / "crazyflie" / "crazypad"
    first, second = (read_log(folder / f"normal_flight_E8_log0{i}.xz") for i in (0, 1))
    found = identify([first.part(slice(len(first.time) // 2))], base)
    predictions = predict(second, {"identified": found.vehicle, "data sheet": base}, believed=base)
    assert set(predictions.errors) == {"height", "climb"}
    assert predictions.better("height", "identified", "data sheet", 0.5).low > 0.8


@pytest.mark.parametrize("share", [1.0, 0.4])
@pytest.mark.parametrize("period", [0.02, 0.004])
def test_starts_are_where_past_and_nearest_horizon_are_in_the_air_without_a_gap(share, period):
    """Against a look at every sample: 0.1 s apart, with known commands of 0.4 s before and 0.15 s in the air."""
    time = period * np.arange(round(20.0 / period))
    thrust = np.where((time > 2.0) & (time < 18.0) & ~((time > 9.0) & (time < 10.0)), 0.5, 0.0)
    gapped = (time < 13.0) | (time > 13.3)
    log = FlightRecord("log", time, thrust_command=thrust, position=np.zeros((len(time), 3))).part(gapped)
    flying = airborne(log)
    late = held_out(flying, share) if share < 1.0 else flying
    past, last, known = (round(seconds / period) for seconds in (0.15, 0.3, 0.4))
    expected = [
        k
        for k in range(known, len(log.time) - last, round(0.1 / period))
        if late[k]
        and flying[k - past : k + last + 1].all()
        and np.diff(log.time[k - known : k + last + 1]).max() < 2.0 * period
    ]
    found = _starts(log, past, (0.5, 0.3), share)
    assert found.tolist() == expected
    assert len(expected) > 20


def test_a_flight_goes_on_as_far_as_it_is_in_the_air_without_a_gap():
    time = 0.01 * np.arange(3000) + np.where(np.arange(3000) > 1500, 0.2, 0.0)
    thrust = np.where((np.arange(3000) > 100) & (np.arange(3000) < 2700), 0.5, 0.0)
    log = FlightRecord("log", time, thrust_command=thrust)
    flying = airborne(log)
    starts = np.arange(2950)
    for steps in (1, 30, 100):
        found = _reached(log, starts, steps)
        expected = [
            k + steps < 3000 and flying[k : k + steps + 1].all() and not k <= 1500 < k + steps for k in starts.tolist()
        ]
        assert found.tolist() == expected


@pytest.mark.parametrize("signals", [("position", "attitude"), ("velocity", "attitude", "body_rates")])
def test_a_start_is_the_state_that_flies_to_what_was_measured_before_it(record, scenario, signals):
    """Without noise the state itself is found, of which positions and attitudes tell velocities and rates."""
    measured = record.part(slice(0, 200))
    measured = FlightRecord(
        "log",
        measured.time,
        rotor_speed_command=measured.rotor_speed_command,
        wind=measured.wind,
        **{name: getattr(measured, name) for name in signals},
    )
    loop = OpenLoop(scenario, measured, delay=float(delay_of(scenario)))
    starts, past = np.array([60, 90, 130]), 8
    states = _begun(loop, measured, list(signals), starts, past, False)
    for name, columns in (
        ("position", slice(0, 3)),
        ("attitude", slice(3, 6)),
        ("velocity", slice(6, 9)),
        ("body_rates", slice(9, 12)),
    ):
        if name != "position" or name in signals:
            np.testing.assert_allclose(states[:, columns], getattr(record, name)[starts], atol=0.03, rtol=0.03)


def test_a_start_of_a_level_vehicle_has_the_velocity_of_its_places(record, scenario):
    """A level vehicle rises and drifts, and only its places are measured, without noise."""
    level = level_vehicle(scenario)
    commands = with_level_commands(FlightRecord("log", record.time, rotor_speed_command=record.rotor_speed_command))
    loop = OpenLoop(level, commands)
    begun = np.zeros((1, 1, 12))
    begun[..., [0, 1, 2, 6, 7, 8]] = [0.3, -0.2, 1.0, 0.5, -0.4, 0.7]
    flown = loop.fly(Starts(np.array([50]), 100), begun)[:, 0, 0]
    position = np.zeros((len(record.time), 3))
    position[50:151] = flown[:, :3]
    starts = np.array([70, 120])
    states = _begun(loop, replace(commands, position=position), ["position"], starts, 8, True)
    np.testing.assert_allclose(states, flown[starts - 50], atol=1e-4)


def test_only_angles_differ_by_half_a_turn_at_most():
    predicted, values = np.array([[7.0, -4.0, 0.1]]), np.zeros((1, 3))
    np.testing.assert_allclose(
        _difference("attitude", predicted, values), [[7.0 - 2.0 * np.pi, 2.0 * np.pi - 4.0, 0.1]]
    )
    for name in ("position", "velocity", "body_rates"):
        np.testing.assert_array_equal(_difference(name, predicted, values), predicted)


def test_angles_that_wrap_go_on_and_other_signals_stay():
    yaw = 0.7 * np.arange(30.0)
    rows = np.column_stack([0.0 * yaw, 0.0 * yaw, np.arctan2(np.sin(yaw), np.cos(yaw))])
    log = FlightRecord("log", 0.01 * np.arange(30), attitude=rows, position=rows, body_rates=rows)
    np.testing.assert_allclose(_continuous(log, "attitude")[:, 2], yaw, atol=1e-9)
    np.testing.assert_array_equal(_continuous(log, "position"), rows)
    np.testing.assert_array_equal(_continuous(log, "body_rates"), rows)
