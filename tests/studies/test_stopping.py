"""Tests of rules that stop a study."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, read_study, run_monte_carlo
from drake_quad.studies import monte_carlo
from drake_quad.studies.stopping import StoppingRule, checkpoints

REQUIREMENT = {"near": {"always": {"signal": "position_error", "below": 0.6}}}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("robustness", [{"duration": 2.0, "requirements": REQUIREMENT}])


@pytest.mark.long
def test_a_study_ends_at_the_first_checkpoint_at_which_its_rules_are_met(scenario, tmp_path):
    rules = "rmse ± 3 %", "near ± 8 %"
    study = run_monte_carlo(scenario, 5000, num_workers=1, until=rules, folder=tmp_path)
    counts = [*checkpoints(5000)]
    end = len(study.samples)
    assert end in counts
    assert counts.index(end) > 0
    parsed = [StoppingRule.parse(rule, scenario) for rule in rules]
    for count in counts[: counts.index(end) + 1]:
        are_met = all(rule.is_met(study.metrics.take(slice(count))) for rule in parsed)
        assert are_met == (count == end)
    # The number of samples depends neither on the batches nor on an interruption.
    other_study = run_monte_carlo(scenario, 5000, num_workers=2, batch_size=100, until=rules)
    assert np.array_equal(other_study.metrics.rmse, study.metrics.rmse)
    resumed = run_monte_carlo(scenario, 5000, num_workers=1, until=rules, folder=tmp_path, resume=True)
    assert (len(resumed.samples), resumed.simulated_time) == (end, 0.0)
    assert len(read_study(tmp_path).samples) == end


@pytest.mark.long
def test_samples_that_failed_are_not_flown_again_at_the_next_checkpoint(scenario, monkeypatch):
    flown = []
    fly_batch = monte_carlo.fly_batch

    def fail_once(job, samples):
        flown.extend(samples)
        if 7 in samples:
            raise ValueError("cannot be flown")
        return fly_batch(job, samples)

    monkeypatch.setattr(monte_carlo, "fly_batch", fail_once)
    with ThreadPoolExecutor(1) as executor:
        study = run_monte_carlo(scenario, 400, num_workers=1, executor=executor, until=["rmse ± 0.1 %"])
    assert [*study.failures] == [7]
    assert len(study.samples) == 399
    assert max(np.bincount(flown)[256:]) == 1


def test_checkpoints_grow_and_end_at_the_number_of_samples():
    assert [*checkpoints(500)] == [256, 320, 400, 500]
    assert [*checkpoints(100)] == [100]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("crash ± 0.2 %", ("crash", 0.002, True)),
        ("rmse +- 1%", ("rmse", 0.01, False)),
        ("near +/- 2 %", ("near", 0.02, True)),
    ],
)
def test_stopping_rules_are_parsed(scenario, text, expected):
    rule = StoppingRule.parse(text, scenario)
    assert rule == (expected[0], pytest.approx(expected[1]), expected[2])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rmse ± 1 cm", "is not a stopping rule; write it as in"),
        ("rmse", "is not a stopping rule; write it as in"),
        ("rmse ± 0 %", "must be above 0 % and below 100 %"),
        ("rmse ± x %", "must be above 0 % and below 100 %"),
        ("speed ± 1 %", "speed is not crash, a requirement or a metric of robustness; choose from near, rmse"),
    ],
)
def test_invalid_stopping_rules_are_refused(scenario, text, message):
    with pytest.raises(InputError, match=message):
        StoppingRule.parse(text, scenario)
