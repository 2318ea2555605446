from concurrent.futures import ThreadPoolExecutor

import pytest

from drake_quad import InputError
from drake_quad.analysis.monte_carlo.workers import fly_batches


def test_a_sample_that_the_scenario_may_not_say_ends_all():
    def fly(samples):
        raise InputError(f"samples {samples} may not be said")

    with ThreadPoolExecutor(1) as executor, pytest.raises(InputError, match=r"samples \[0\]"):
        list(fly_batches(executor.submit, fly, [[0], [1]], at_once=1))
