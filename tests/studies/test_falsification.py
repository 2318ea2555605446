"""Tests of the search for worst cases."""

import math

import cma
import numpy as np
import pytest

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate
from drake_quad.studies.falsification import MIN_FLIGHTS, find_worst_case

DISTRIBUTIONS = [
    "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.5}}",
    "vehicle.inertia.0={normal: {mean: 0.007, standard_deviation: 0.0003, min: 0.005}}",
    "vehicle.centre_of_mass=[{normal: {mean: 0.0, standard_deviation: 0.001}}, 0.0]",
]
REQUIREMENT = "requirements={near: {always: {signal: position_error, below: 0.1}}}"


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("hover", ["duration=0.6", *DISTRIBUTIONS, REQUIREMENT])


@pytest.fixture(scope="module")
def worst_case(scenario):
    return find_worst_case(scenario, "peak_error", max_flights=4 * MIN_FLIGHTS, num_noise=1)


@pytest.mark.long
def test_a_worst_case_is_worse_than_random_samples_within_the_same_limits(scenario, worst_case):
    random = run_monte_carlo(scenario, 4 * MIN_FLIGHTS, num_workers=1).metrics.peak_error
    assert worst_case.value > random.max()
    assert worst_case.num_flights == 4 * MIN_FLIGHTS
    assert np.abs(worst_case.point).max() <= 3.0
    # A mass at either limit makes the height wrong, and the other random numbers hardly matter.
    assert abs(worst_case.point[worst_case.names.index("vehicle.mass")]) > 2.5
    assert worst_case.means[-1] > worst_case.means[0]


@pytest.mark.slow
def test_a_repeated_flight_of_the_worst_case_has_the_same_metric(worst_case):
    assert simulate(worst_case.scenario, compiled=True).metrics.peak_error == pytest.approx(worst_case.value, rel=1e-9)
    assert worst_case.scenario.sample == worst_case.nominal.sample
    assert worst_case.values["vehicle.mass"][0] == pytest.approx(0.68)
    assert worst_case.values["vehicle.mass"][1] == worst_case.scenario.vehicle.mass


@pytest.mark.slow
def test_the_first_search_begins_at_the_median_and_the_next_one_elsewhere(scenario, monkeypatch):
    starts = []

    def strategy(start, step, options):
        starts.append(start)
        return create(start, step, {**options, "maxiter": 2})

    create = cma.CMAEvolutionStrategy
    monkeypatch.setattr(cma, "CMAEvolutionStrategy", strategy)
    find_worst_case(scenario, "peak_error", max_flights=4 * MIN_FLIGHTS, num_noise=1)
    assert not starts[0].any()
    assert starts[1].all()


@pytest.mark.slow
def test_the_same_seed_repeats_a_search(scenario, worst_case):
    repeated = find_worst_case(scenario, "peak_error", max_flights=4 * MIN_FLIGHTS, num_noise=1)
    np.testing.assert_array_equal(repeated.point, worst_case.point)


@pytest.mark.slow
def test_the_smallest_robustness_of_a_requirement_is_found_as_its_worst_case(scenario):
    worst_case = find_worst_case(scenario, "near", maximise=False, max_flights=2 * MIN_FLIGHTS, num_noise=2, sigma=1.0)
    assert np.abs(worst_case.point).max() <= 1.0
    assert worst_case.value == pytest.approx(
        0.1 - simulate(worst_case.scenario, compiled=True).metrics.peak_error, abs=1e-6
    )
    assert worst_case.value < np.median(run_monte_carlo(scenario, 40, num_workers=1).metrics.near)


@pytest.mark.long
def test_an_early_crash_is_the_worst_case():
    scenario = load_scenario("hover", ["duration=0.6", *DISTRIBUTIONS, "crash.position_error=0.05"])
    worst_case = find_worst_case(scenario, "rmse", max_flights=4 * MIN_FLIGHTS, num_noise=1)
    assert worst_case.is_crash
    assert math.isinf(worst_case.value)
    crash_times = run_monte_carlo(scenario, 500, num_workers=1).metrics.crash_time
    assert simulate(worst_case.scenario, compiled=True).metrics.crash_time <= crash_times.min()


@pytest.mark.slow
@pytest.mark.parametrize(("maximise", "crashes"), [(True, False), (True, True), (False, True)])
def test_an_infinite_metric_is_no_crash_and_better_than_a_crash(maximise, crashes):
    overrides = [*DISTRIBUTIONS, "metrics.additional.settling_time.radius=0.02"]
    crash = ["crash.position_error=0.05"] if crashes else []
    scenario = load_scenario("hover", ["duration=0.6", *overrides, *crash])
    worst_case = find_worst_case(scenario, "settling_time", maximise=maximise, max_flights=MIN_FLIGHTS, num_noise=1)
    assert worst_case.is_crash is crashes
    assert math.isinf(worst_case.value)
    assert simulate(worst_case.scenario, compiled=True).metrics.crashed == crashes


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"metric": "rms"}, "there is no metric called .rms.; did you mean rmse"),
        ({"sigma": 0.0}, "sigma is 0, but must be above 0 and at most 8"),
        ({"max_flights": 100}, "max_flights is 100, but must be at least 1000"),
        ({"num_noise": 0}, "num_noise is 0, but must be at least 1"),
    ],
)
def test_searches_with_invalid_options_are_refused(scenario, options, words):
    with pytest.raises(InputError, match=words):
        find_worst_case(scenario, **{"metric": "rmse", **options})


@pytest.mark.slow
def test_a_metric_that_is_the_same_in_all_flights_has_no_worst_case():
    scenario = load_scenario("hover", ["duration=0.6", *DISTRIBUTIONS])
    with pytest.raises(InputError, match=r"saturated_fraction is 0 in all 250 flights, so there is no worst case"):
        find_worst_case(scenario, "saturated_fraction", max_flights=MIN_FLIGHTS, num_noise=1)


def test_a_scenario_without_distributions_has_no_worst_case():
    with pytest.raises(InputError, match="hover contains no distribution, so there is nothing to vary"):
        find_worst_case(load_scenario("hover"), "rmse")
