"""Tests of the search for gains, where functions in closed form replace the errors of flights."""

import itertools

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.design import tuning
from drake_quad.design.tuning import Budget, TuningParameter, tolerated_delay, tune
from drake_quad.laboratory.metrics import Metrics

# A tuning parameter has the paths of the fields that it sets, and the smallest and the largest value to try.
# Tuned parameters: the gains of the position controller with the ends of their ranges, in 1/s² (k_P) and 1/s (k_D).
K_P_PARAMETER = TuningParameter(("control.position.k_p.0", "control.position.k_p.1"), 0.5, 12.0)
K_D_PARAMETER = TuningParameter(("control.position.k_d.0", "control.position.k_d.1"), 0.5, 8.0)
HEIGHT_PARAMETER = TuningParameter(("control.position.k_p.2",), 1.0, 20.0)
FLIGHT_DURATION = 4.0  # s


@pytest.fixture(scope="module")
def laboratory(diagrams):
    return load_scenario(diagrams / "laboratory.yaml:low_wind")


@pytest.fixture
def stub_flights(monkeypatch):
    """Return a function that replaces flights with given errors and crash times.

    Errors and crash times are functions of a candidate's parameters, a sample and a scenario. The returned function
    returns a dictionary that records the scenario and size of each fleet, and the samples and parameters of each
    simulation.
    """
    record = {"fleets": [], "samples": [], "varying": []}

    def install(error, crash=lambda parameters, sample, scenario: np.inf):
        class Fleet:
            def __init__(self, scenario, _plan, count):
                self.scenario = scenario
                self.duration = FLIGHT_DURATION
                record["fleets"].append((scenario, count))

            def fly_batch(self, batch):
                record["samples"].append(batch.samples)
                record["varying"].append(batch.varying)
                rows = [{path: column[i] for path, column in batch.varying.items()} for i in range(len(batch.samples))]
                flights = list(zip(rows, batch.samples, strict=True))
                times = np.array([float(crash(row, sample, self.scenario)) for row, sample in flights])
                rmse = np.array([float(error(row, sample, self.scenario)) for row, sample in flights])
                return Metrics(rmse, *[rmse] * (len(Metrics._fields) - 2), times)

            def fly(self, samples):
                times = np.array([float(crash({}, sample, self.scenario)) for sample in samples])
                return Metrics(*[times] * (len(Metrics._fields) - 1), times)

        monkeypatch.setattr(tuning, "StudyFleet", Fleet)
        return record

    return install


def log_gains(parameters):
    """Return the logarithms of a candidate's k_P and k_D, relative to the unconstrained optimum of 4 and 2."""
    return np.log(parameters["control.position.k_p.0"] / 4.0), np.log(parameters["control.position.k_d.0"] / 2.0)


def quadratic_error(parameters, *_):
    """Return an invented error (m) as a function of k_P and k_D, with a minimum of 0.1 m and an interaction."""
    p, d = log_gains(parameters)
    return 0.1 * np.exp(p * p + d * d - p * d)


SEARCH_BUDGET = Budget(rounds=6, candidates=32, samples=1, limit_evaluations=4, local_search_steps=60)


def test_the_gains_with_the_smallest_error_are_found(laboratory, stub_flights):
    stub_flights(quadratic_error)
    result = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=SEARCH_BUDGET)
    assert result.values == pytest.approx((4.0, 2.0), rel=0.01)
    assert result.error == pytest.approx(0.1, rel=1e-4)
    assert result.min_margin_ratio == np.inf


def test_the_gains_with_the_smallest_error_within_a_limit_are_found(laboratory, stub_flights):
    """If k_P is at its limit of 2, the best k_D is 2 √(2 / 4)."""
    stub_flights(quadratic_error)
    result = tune(
        [laboratory],
        [K_P_PARAMETER, K_D_PARAMETER],
        lambda s: np.array([2.0 / s.control.position.k_p[0], 9.0]),
        budget=SEARCH_BUDGET,
    )
    assert result.values == pytest.approx((2.0, np.sqrt(2.0)), rel=0.02)
    assert 1.0 <= result.min_margin_ratio < 1.02


def test_a_discontinuous_limit_is_respected(laboratory, stub_flights):
    """`margin_ratios` is discontinuous at k_P = 3.

    It returns a single zero for the unstable loops above 3, and two ratios for the stable loops below.
    """
    stub_flights(quadratic_error)

    def fractions(scenario):
        gain = scenario.control.position.k_p[0]
        return np.zeros(1) if gain > 3.0 else np.array([2.5 / gain, 0.9 + 1.0 / scenario.control.position.k_d[0]])

    result = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], fractions, budget=SEARCH_BUDGET)
    assert result.min_margin_ratio >= 1.0
    assert result.values == pytest.approx((2.5, 2.0 * np.sqrt(2.5 / 4.0)), rel=0.03)


def test_the_lowest_of_many_minima_is_found(laboratory, stub_flights):
    """The error has five minima along each axis. A search from a single point would end in the nearest minimum."""

    def error_with_many_minima(parameters, *_):
        p, d = log_gains(parameters)
        return 0.1 + 0.05 * (p * p + d * d) + 0.02 * (2.0 - np.cos(10.0 * p) - np.cos(10.0 * d))

    stub_flights(error_with_many_minima)
    result = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=Budget(rounds=8, candidates=64, samples=1))
    assert result.values == pytest.approx((4.0, 2.0), rel=0.02)


@pytest.mark.parametrize("fractions", [None, lambda _: np.array([9.0])])
def test_the_rounds_of_a_search_converge_to_the_optimum_and_stay_in_range(laboratory, stub_flights, fractions):
    """The mean of the candidates moves to the best parameters, and their spread decreases from round to round.

    A limit that no candidate violates has no influence.
    """
    record = stub_flights(quadratic_error)
    budget = Budget(rounds=6, candidates=64, samples=1, local_search_steps=1)
    tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], fractions, budget=budget)
    rounds = [each for each in record["varying"] if len(each[K_P_PARAMETER.paths[0]]) == 64]
    assert len(rounds) == 6
    points = np.array([[each[K_P_PARAMETER.paths[0]], each[K_D_PARAMETER.paths[0]]] for each in rounds])
    assert (points[:, 0] >= 0.5 * (1 - 1e-12)).all()
    assert (points[:, 0] <= 12.0 * (1 + 1e-12)).all()
    np.testing.assert_array_equal([each[K_P_PARAMETER.paths[1]] for each in rounds], points[:, 0])
    # The first candidates are evenly distributed over the ranges of both parameters.
    first = np.log(points[0] / [[0.5], [0.5]]) / np.log([[12.0 / 0.5], [8.0 / 0.5]])
    assert np.histogram2d(*first, bins=4, range=[[0, 1], [0, 1]])[0].min() == 4
    distance = np.abs(np.log(points.mean(axis=2) / [4.0, 2.0])).max(axis=1)
    spread = np.log(points).std(axis=2).max(axis=1)
    assert distance[-1] < 0.05
    assert (np.diff(spread[:5]) < 0.0).all()
    assert 0.005 < spread[-1] < 0.2 * spread[0]


def test_the_rounds_of_a_search_converge_to_the_optimum_within_a_limit(laboratory, stub_flights):
    """The limit is k_P ≤ 2. Candidates of the last round meet it, although larger k_P have a smaller error."""
    record = stub_flights(quadratic_error)
    budget = Budget(rounds=6, candidates=64, samples=1, limit_evaluations=8, local_search_steps=1)
    tune(
        [laboratory],
        [K_P_PARAMETER, K_D_PARAMETER],
        lambda scenario: np.array([2.0 / scenario.control.position.k_p[0]]),
        budget=budget,
    )
    *_, last = (each[K_P_PARAMETER.paths[0]] for each in record["varying"] if len(each[K_P_PARAMETER.paths[0]]) == 64)
    assert np.median(last) == pytest.approx(2.0, rel=0.1)
    assert last.max() < 3.0


def test_each_round_simulates_the_given_number_of_candidates(laboratory, stub_flights):
    """The number need not be a power of two, although the Sobol sequence generates points in powers of two."""
    record = stub_flights(quadratic_error)
    tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=Budget(2, 12, 1, 1, 1))
    assert [len(each[K_P_PARAMETER.paths[0]]) for each in record["varying"][:2]] == [12, 12]


def test_each_local_search_starts_with_a_smaller_step_than_the_one_before(laboratory, stub_flights, monkeypatch):
    """The range of each parameter is scaled to a width of 1, and the first step is less than a quarter of it."""
    stub_flights(quadratic_error)
    radii, minimize = [], tuning.scipy.optimize.minimize

    def minimize_and_record(function, start, **given):
        radii.append(given["options"]["rhobeg"])
        return minimize(function, start, **given)

    monkeypatch.setattr(tuning.scipy.optimize, "minimize", minimize_and_record)
    tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=Budget(1, 4, 1, 1, 1))
    assert len(radii) == 3
    assert 0.25 > radii[0] > radii[1] > radii[2] > 0.0


def test_each_candidate_flies_the_same_samples_in_every_laboratory(laboratory, stub_flights):
    """The error of a candidate is the mean over samples and laboratories.

    The budget is the total number of flights, so two laboratories have half as many samples each.
    """
    other = laboratory.model_copy(update={"name": "other"})

    def error(parameters, sample, scenario):
        return 0.1 * (1 + sample) * (3.0 if scenario.name == "other" else 1.0)

    record = stub_flights(error)
    result = tune([laboratory, other], [K_P_PARAMETER], None, budget=Budget(1, 8, 6, 1, 1), first_sample=5)
    # Each of the two laboratories flies samples 5 to 7.
    assert set(record["samples"]) == {(5, 6, 7) * 8, (5, 6, 7)}
    assert result.error == pytest.approx(np.mean([0.6, 0.7, 0.8]) * 2.0)
    assert {count for _, count in record["fleets"]} == {24, 3}
    stub_flights(error)
    record["samples"].clear()
    tune([laboratory, other], [K_P_PARAMETER], None, budget=Budget(1, 4, 1, 1, 1))
    assert set(record["samples"]) == {(0,) * 4, (0,)}


def test_a_crash_counts_as_an_error_of_one_to_two_metres(laboratory, stub_flights):
    """Two of four samples crash, after 1 s and 3 s of a 4 s flight. Their errors before the crash do not count."""

    def crash(parameters, sample, scenario):
        return {0: 1.0, 2: 3.0}.get(sample, np.inf)

    stub_flights(lambda parameters, sample, scenario: 0.1 * sample, crash)
    result = tune([laboratory], [K_P_PARAMETER], None, budget=Budget(1, 4, 4, 1, 1))
    assert result.error == pytest.approx((1.75 + 0.1 + 1.25 + 0.3) / 4.0)


def test_flights_with_extra_latency_add_only_their_crashes_to_the_error(laboratory, stub_flights):
    """The extra latency of 30 ms is three camera frames. Flights with it crash in one of the two laboratories."""
    latency_frames = laboratory.laboratory.motion_capture.latency_frames
    other = laboratory.model_copy(update={"name": "other"})

    def crash(parameters, sample, scenario):
        has_extra_latency = scenario.laboratory.motion_capture.latency_frames == latency_frames + 3.0
        assert has_extra_latency or scenario.laboratory.motion_capture.latency_frames == latency_frames
        return 2.0 if has_extra_latency and scenario.name == "other" else np.inf

    stub_flights(lambda *_: 0.2, crash)
    result = tune([laboratory, other], [K_P_PARAMETER], None, budget=Budget(1, 4, 2, 1, 1), extra_latency=0.03)
    assert result.error == pytest.approx(0.2 + 1.5 / 2.0)
    assert tune([laboratory, other], [K_P_PARAMETER], None, budget=Budget(1, 4, 2, 1, 1)).error == pytest.approx(0.2)


def test_the_vertical_gain_stays_in_the_middle_of_its_range_until_the_last_rounds(laboratory, stub_flights):
    record = stub_flights(
        lambda parameters, *_: quadratic_error(parameters) if K_P_PARAMETER.paths[0] in parameters else 1.0
    )
    scenarios = []
    budget = Budget(rounds=9, candidates=16, samples=1, local_search_steps=1)
    tune(
        [laboratory],
        [K_P_PARAMETER, HEIGHT_PARAMETER, K_D_PARAMETER],
        lambda scenario: scenarios.append(scenario.control.position.k_p) or np.array([9.0]),
        budget=budget,
    )
    assert scenarios[0][2] == pytest.approx(np.sqrt(20.0))
    assert scenarios[0][0] == scenarios[0][1]
    rounds = [set(each) for each in record["varying"] if len(next(iter(each.values()))) == 16]
    # Two thirds of the rounds vary the two lateral gains.
    assert rounds == [{*K_P_PARAMETER.paths, *K_D_PARAMETER.paths}] * 6 + [{*HEIGHT_PARAMETER.paths}] * 3


def test_the_limit_is_checked_for_the_best_candidates_of_each_round(laboratory, stub_flights):
    """The limit is checked for 16 candidates in the first round, and for 4 candidates in each of two further rounds.

    Three local searches follow, in which the limit is checked at every step.
    """
    record = stub_flights(quadratic_error)
    checked = []
    num_checked = []
    budget = Budget(rounds=3, candidates=32, samples=1, limit_evaluations=4, local_search_steps=5)

    def fractions(scenario):
        checked.append((len(record["varying"]), scenario.control.position.k_p[0]))
        return np.array([9.0])

    tune(
        [laboratory],
        [K_P_PARAMETER, K_D_PARAMETER],
        fractions,
        budget=budget,
        progress=lambda: num_checked.append(len(checked)),
    )
    assert num_checked[:3] == [16, 20, 24]
    assert len(num_checked) == 3 + 3
    assert all(1 <= step <= 6 for step in np.diff(num_checked[2:]))
    # The first round checks the candidates with the smallest errors, whether or not they meet the limit.
    first = record["varying"][0]
    columns = {path: first[path] for path in (K_P_PARAMETER.paths[0], K_D_PARAMETER.paths[0])}
    errors = quadratic_error(columns)
    best = np.sort(columns[K_P_PARAMETER.paths[0]][np.argsort(errors)[:16]])
    np.testing.assert_allclose(np.sort([gain for _, gain in checked[:16]]), best)


def test_the_gains_of_an_earlier_search_are_one_of_the_candidates(laboratory, stub_flights):
    """The earlier gains are better than all drawn candidates. Earlier gains outside of the range are clipped."""
    stub_flights(lambda parameters, *_: 0.1 if abs(np.log(parameters[K_P_PARAMETER.paths[0]] / 6.789)) < 1e-6 else 1.0)
    budget = Budget(1, 4, 1, 1, 1)
    assert tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=budget).error == 1.0
    result = tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], None, budget=budget, before=(6.789, 2.0))
    assert result.error == pytest.approx(0.1)
    assert result.values == pytest.approx((6.789, 2.0))
    stub_flights(lambda parameters, *_: 1.0 / parameters[K_P_PARAMETER.paths[0]])
    result = tune([laboratory], [K_P_PARAMETER], None, budget=budget, before=(99.0,))
    assert result.values == pytest.approx((12.0,))
    # A candidate that violates one of the limits is not preferred for its small error.
    stub_flights(lambda parameters, *_: 0.1 if abs(np.log(parameters[K_P_PARAMETER.paths[0]] / 6.789)) < 1e-6 else 1.0)

    def fractions(scenario):
        return np.array([9.0, 5.0 / scenario.control.position.k_p[0]])

    assert tune([laboratory], [K_P_PARAMETER], fractions, budget=budget, before=(6.789,)).error == 1.0


def test_local_searches_also_begin_at_earlier_gains_that_slightly_violate_a_limit(laboratory, stub_flights):
    """The drawn candidates are near another, worse minimum."""
    stub_flights(lambda parameters, *_: 0.1 + np.minimum(abs(parameters[K_P_PARAMETER.paths[0]] - 9.0), 0.5))

    def ratios(scenario):
        return np.array([8.99 / scenario.control.position.k_p[0]])

    result = tune([laboratory], [K_P_PARAMETER], ratios, budget=Budget(1, 4, 1, 1, 40), before=(9.0,))
    assert 8.9 < result.values[0] <= 8.99


def test_candidates_within_the_limit_rank_by_error_and_candidates_beyond_it_by_margin_ratio():
    tuned = [
        tuning.TuningResult((), error, fraction)
        for error, fraction in ((0.3, 1.0), (0.2, 7.0), (0.1, 0.9), (0.05, 0.5), (0.06, 0.5))
    ]
    order = [1, 0, 2, 3, 4]
    for first, second in itertools.combinations(order, 2):
        assert tuning._better(tuned[first], tuned[second]) is tuned[first]
        assert tuning._better(tuned[second], tuned[first]) is tuned[first]


def test_predicted_violations_of_the_limit_are_penalised():
    """The logarithms of the margin ratios are linear functions of the parameters.

    The predicted ratios are therefore exact, and the penalties have a closed form.
    """
    random = np.random.default_rng(5)
    slope = np.array([0.4, -0.3])
    known = tuning._EvaluatedPoints(2)
    points = random.uniform(size=(12, 2))
    for number, point in enumerate(points):
        if number == 3:
            # Three points determine a plane without any redundancy, so they give no prediction.
            assert not known.penalties(points, 0.0).any()
        known.add(point, np.exp(np.array([slope @ point - 0.05, 0.1])))
    requested = random.uniform(size=(40, 2))
    predicted = np.minimum(requested @ slope - 0.05, 0.1)
    distance = np.linalg.norm(requested[:, None] - points, axis=2).min(axis=1)
    for uncertainty in (0.0, 0.3):
        expected = 4.0 * np.maximum(0.002 - predicted - uncertainty * distance, 0.0)
        np.testing.assert_allclose(known.penalties(requested, uncertainty), expected, atol=2e-3)
        assert (expected > 0.01).sum() > 5
    # Values far from the limit need no accuracy, so they are clipped to the range from 0.2 to 1.5.
    np.testing.assert_allclose(tuning._clipped_logarithms(np.array([0.01, 0.5, 9.0]), 3), np.log([0.2, 0.5, 1.5]))
    np.testing.assert_allclose(tuning._clipped_logarithms(np.zeros(1), 3), np.log([0.2] * 3))


def test_the_tolerated_delay_is_the_longest_without_a_crash(laboratory, stub_flights):
    """From 40 ms on, one of the four training samples crashes in one of two laboratories. No other flight crashes."""
    latency_frames = laboratory.laboratory.motion_capture.latency_frames
    other = laboratory.model_copy(update={"name": "other"})

    def crash(parameters, sample, scenario):
        extra_frames = scenario.laboratory.motion_capture.latency_frames - latency_frames
        return 1.0 if extra_frames >= 4.0 and scenario.name == "other" and sample == 13 else np.inf

    stub_flights(None, crash)
    budget = Budget(samples=8)
    assert tolerated_delay([laboratory, other], 0.1, budget=budget, first_sample=10) == pytest.approx(0.03)
    assert tolerated_delay([laboratory, other], 0.02, budget=budget, first_sample=10) == pytest.approx(0.02)
    assert tolerated_delay([laboratory, other], 0.1, budget=budget, first_sample=14) == pytest.approx(0.1)
    stub_flights(None, lambda *_: 1.0)
    assert tolerated_delay([laboratory], 0.1, budget=budget) == 0.0


def test_the_assumed_error_of_predicted_margin_ratios_decreases_in_each_round(laboratory, stub_flights, monkeypatch):
    """The assumed error decreases in equal steps. In the last round of the search it is one step from zero."""
    stub_flights(quadratic_error)
    doubts = []
    monkeypatch.setattr(
        tuning._EvaluatedPoints, "penalties", lambda known, points, uncertainty: doubts.append(uncertainty) or 0.0
    )
    budget = Budget(rounds=5, candidates=8, samples=1, local_search_steps=1)
    tune([laboratory], [K_P_PARAMETER, K_D_PARAMETER], lambda scenario: np.array([9.0]), budget=budget)
    np.testing.assert_allclose(doubts[::2], tuning._INITIAL_UNCERTAINTY * np.array([1.0, 0.8, 0.6, 0.4, 0.2]))
    assert doubts[1::2] == doubts[::2]


def test_with_two_parameters_margin_ratios_are_predicted_from_four_or_more_points():
    known = tuning._EvaluatedPoints(2)
    candidate = np.array([[0.5, 0.5]])
    for count, point in enumerate(([0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]), start=1):
        known.add(np.array(point), np.array([0.6]))
        assert known.penalties(candidate, 0.0).any() == (count == 4)


def test_local_searches_end_slightly_within_the_limit(laboratory, stub_flights):
    """Predicted margins are not exact, so the search keeps a distance of 0.2 % from the stability limit."""
    stub_flights(quadratic_error)
    fractions, ends = [], []

    def limit(scenario):
        fractions.append(2.0 / scenario.control.position.k_p[0])
        return np.array([fractions[-1], 9.0])

    tune(
        [laboratory],
        [K_P_PARAMETER, K_D_PARAMETER],
        limit,
        budget=SEARCH_BUDGET,
        progress=lambda: ends.append(fractions[-1]),
    )
    np.testing.assert_allclose(ends[-3:], 1.002, rtol=1e-4)
