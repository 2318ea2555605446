"""Tests of the simulation of one vehicle: samples, early ends and errors."""

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, load_scenario, simulate


@pytest.mark.parametrize("compiled", [False, True])
def test_progress_is_reported_until_the_end(diagrams, compiled):
    """Progress is reported every second, and less often by a compiled diagram with hundreds of ticks per event."""
    reports, scenario = [], load_scenario(diagrams / "hover.yaml", ["duration=2.5"])
    simulate(scenario, compiled=compiled, progress=lambda *now: reports.append(now))
    times = [1.0, 2.0, 2.5]
    assert reports == [(time, 2.5) for time in (times[2:] if compiled else times)]


@pytest.mark.slow
def test_a_scenario_is_flown_with_its_own_sample_and_seed_by_default(diagrams):
    """Samples differ in their turbulence."""
    wind = "laboratory.wind=[{kind: dryden, level: light}]"

    def wind_of(*overrides, **arguments):
        scenario = load_scenario(diagrams / "hover.yaml", ["duration=0.04", wind, *overrides])
        return simulate(scenario, **arguments)["wind"]

    np.testing.assert_array_equal(wind_of("sample=3"), wind_of(sample=3))
    np.testing.assert_array_equal(wind_of("sample=3", sample=4), wind_of(sample=4))
    np.testing.assert_array_equal(wind_of(), wind_of(sample=0))
    np.testing.assert_array_equal(wind_of("seed=5"), wind_of(seed=5))
    assert np.abs(wind_of(sample=3) - wind_of(sample=4)).max() > 1e-3
    assert np.abs(wind_of(seed=5) - wind_of(seed=6)).max() > 1e-3


def test_a_flight_that_stops_early_has_the_signals_of_the_whole_flight_until_then(diagrams):
    scenario = load_scenario(diagrams / "hover.yaml", ["duration=0.2"])
    complete, partial = simulate(scenario), simulate(scenario, until=0.1)
    np.testing.assert_array_equal(partial.time, complete.time[:6])
    np.testing.assert_array_equal(partial["state"], complete["state"][:6])
    assert simulate(scenario, until=0.2).time[-1] == complete.time[-1]
    for until in (-0.1, 0.0, 0.3):
        with pytest.raises(InputError, match=f"until is {until}, but must be larger than 0 and at most .*, 0.2 s"):
            simulate(scenario, until=until)


def test_an_error_in_a_user_defined_system_is_not_hidden(diagrams):
    class Failing(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareVectorOutputPort("wind", BasicVector(3), self.fail)

        def fail(self, context, output):
            if context.get_time() > 0.05:
                raise RuntimeError("the anemometer is broken")
            output.SetFromVector([0.0, 0.0, 0.0])

    with pytest.raises(RuntimeError, match="the anemometer is broken"):
        simulate(load_scenario(diagrams / "hover.yaml", ["duration=0.1"]), wind=Failing())


def test_a_scenario_with_distributions_needs_a_sample(diagrams):
    with pytest.raises(InputError, match="is a distribution, but one flight needs a number; give"):
        simulate(load_scenario(diagrams / "robustness.yaml"))


@pytest.mark.long
def test_a_continuous_state_is_exact_to_a_tenth_of_a_nanometre(diagrams):
    """The expected state is computed with Runge-Kutta steps of 0.625 ms."""
    continuous, fine = (
        simulate(load_scenario(diagrams / "figure_eight.yaml", ["duration=0.5", "metrics.start=0", step]))["state"]
        for step in ("vehicle.time_step=0", "vehicle.time_step=0.000625")
    )
    np.testing.assert_allclose(continuous, fine, rtol=0.0, atol=1e-10)
