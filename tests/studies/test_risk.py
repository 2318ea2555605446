"""Tests of estimated probabilities of rare events."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate
from drake_quad.statistics import subset_simulation
from drake_quad.studies.risk import MIN_RUNS, Event, estimate_risk

MASS_DISTRIBUTION = "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.5}}"
OVERRIDES = ["duration=0.6", MASS_DISTRIBUTION, "laboratory.motion_capture.position_noise=0.003"]
PEAK_ERROR_BOUND = 0.055  # m


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("hover", OVERRIDES)


@pytest.fixture(scope="module")
def risk(scenario):
    return estimate_risk(scenario, f"peak_error > {PEAK_ERROR_BOUND}", size=500, half_width=10.0, noise_period=0.3)


@pytest.mark.long
def test_a_probability_agrees_with_plain_sampling(scenario, risk):
    plain = run_monte_carlo(scenario, 20_000, num_workers=1).metrics
    frequency = np.mean(plain.peak_error > PEAK_ERROR_BOUND)
    assert 0.01 < frequency < 0.04
    assert risk.probability.low < frequency < risk.probability.high


@pytest.mark.long
def test_repeated_flights_of_the_worst_samples_have_the_same_metric(risk):
    values = sorted((run.performance.max() for run in risk.runs), reverse=True)
    assert len(risk.scenarios) == 3
    for each, performance in zip(risk.scenarios, values, strict=False):
        assert len(each.noise.samples) == 2
        peak_error = simulate(each, compiled=True).metrics.peak_error
        assert peak_error == pytest.approx(PEAK_ERROR_BOUND + performance, rel=1e-9)


@pytest.mark.slow
def test_the_important_random_number_is_named_first(risk):
    assert [each.name for each in risk.coordinates] == ["vehicle.mass"]
    assert risk.num_flights == sum(run.num_evaluations for run in risk.runs)


@pytest.mark.long
def test_the_same_seed_repeats_an_estimate_with_any_noise_period(scenario, risk):
    options = {"size": 500, "half_width": 10.0}
    repeated = estimate_risk(scenario, Event("peak_error", 1.0, PEAK_ERROR_BOUND), noise_period=0.3, **options)
    assert repeated.probability == risk.probability
    other = estimate_risk(scenario, f"peak_error > {PEAK_ERROR_BOUND}", noise_period=0.2, **options)
    assert len(other.scenarios[0].noise.samples) == 3
    # Both noise periods give the same probability, so the intervals overlap.
    assert other.probability.low < risk.probability.high
    assert risk.probability.low < other.probability.high


@pytest.mark.long
def test_an_estimate_ends_when_its_interval_is_short_or_flights_are_used_up(scenario):
    limited = estimate_risk(scenario, f"peak_error > {PEAK_ERROR_BOUND}", size=500, half_width=1e-3, max_flights=8000)
    assert not limited.is_precise
    assert limited.num_flights >= 8000
    # Runs that follow the first ones have other random numbers.
    assert len(limited.runs) > MIN_RUNS
    assert len({run.performance.tobytes() for run in limited.runs}) == len(limited.runs)
    with pytest.raises(InputError, match=r"1,000 flights are enough for \d runs?, but an interval needs 6"):
        estimate_risk(scenario, f"peak_error > {PEAK_ERROR_BOUND}", size=500, max_flights=1000)


@pytest.mark.slow
def test_an_event_that_is_too_rare_is_refused_with_the_largest_value_that_was_reached(monkeypatch):
    monkeypatch.setattr(subset_simulation, "_MAX_LEVELS", 3)
    quiet = load_scenario("hover", ["duration=0.1", MASS_DISTRIBUTION])
    with pytest.raises(InputError, match=r"peak_error > 4 is too rare: a run ended without .* and peak_error = "):
        estimate_risk(quiet, "peak_error > 4", size=500)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("peak_error", "is not an event; write it as in 'peak_error > 0.8', or write 'crash'"),
        ("crash > 1", "is not an event"),
        ("peak_error = 3", "is not an event"),
        ("peak > 3", "there is no metric called .peak.; there are rmse"),
        ("peak_error > wide", "'wide' is not a number"),
        ("peak_error > nan", "'nan' is not a number"),
    ],
)
def test_a_text_that_is_not_an_event_is_refused(scenario, text, words):
    with pytest.raises(InputError, match=words):
        Event.parse(text, scenario)


def test_the_performance_of_a_flight_is_negative_unless_the_event_occurs():
    scenario = load_scenario("hover", ["requirements={near: {always: {signal: position_error, below: 0.1}}}"])
    kind = scenario.metrics_type
    values = {name: np.zeros(3) for name in kind._fields}
    metrics = kind(**{**values, "peak_error": np.array([0.1, 0.5, 0.2]), "crash_time": np.array([9.0, 9.0, 0.5])})
    metrics = metrics._replace(crash_time=np.array([np.inf, np.inf, 0.5]), near=np.array([0.1, -0.2, 0.05]))
    np.testing.assert_allclose(Event("peak_error", 1.0, 0.4).performance(metrics), [-0.3, 0.1, np.inf])
    np.testing.assert_allclose(Event("near", -1.0, 0.0).performance(metrics), [-0.1, 0.2, np.inf])
    crash = Event("crash").performance(metrics)
    assert [*(crash >= 0.0)] == [False, False, True]
    assert crash[1] > crash[0]
    assert [*(Event("near", -1.0, 0.1).performance(metrics) >= 0.0)] == [False, True, True]
    np.testing.assert_allclose(Event("near", -1.0, 0.5).value(np.array([0.2])), [0.3])
    undefined = metrics._replace(peak_error=np.array([0.1, np.nan, 0.2]))
    with pytest.raises(InputError, match="peak_error is not defined in every flight"):
        Event("peak_error", 1.0, 0.4).performance(undefined)


@pytest.mark.slow
@pytest.mark.parametrize(("event", "value"), [("saturated_fraction > 0", "0"), ("settling_time < 0.3", "inf")])
def test_a_metric_that_is_the_same_in_almost_all_flights_is_refused(event, value):
    """A metric with one value in almost all flights does not show how close a flight is to the event."""
    scenario = load_scenario("hover", [*OVERRIDES, "metrics.additional.settling_time.radius=1e-9"])
    words = rf"{event.split()[0]} is {value} in 100.0% of the samples of a step, .* choose another metric"
    with pytest.raises(InputError, match=words):
        estimate_risk(scenario, event, size=500)


@pytest.mark.slow
def test_an_event_that_always_occurs_has_the_interval_of_plain_sampling(scenario):
    risk = estimate_risk(scenario, "peak_error > -1", size=500)
    assert risk.probability.value == risk.probability.high == 1.0
    assert 0.99 < risk.probability.low < 1.0
