from concurrent.futures import ThreadPoolExecutor

import pytest

from drake_quad import InputError, load_scenario, run_monte_carlo
from drake_quad.analysis.monte_carlo.workers import fly_batches


def test_a_sample_that_the_scenario_may_not_say_ends_all():
    def fly(samples):
        raise InputError(f"samples {samples} may not be said")

    with ThreadPoolExecutor(1) as executor, pytest.raises(InputError, match=r"samples \[0\]"):
        list(fly_batches(executor.submit, fly, [[0], [1]], at_once=1))


def test_an_executor_that_is_given_flies_everything():
    submitted = []

    class Executor(ThreadPoolExecutor):
        def submit(self, function, /, *arguments, **options):
            submitted.append(function)
            return super().submit(function, *arguments, **options)

    scenario = load_scenario("diagrams/hover.yaml", ["duration=0.1"])
    with Executor(1) as executor:
        assert len(run_monte_carlo(scenario, 4, batch_size=2, executor=executor).samples) == 4
    assert len(submitted) == 2
