"""Tests of the inputs of a network's rules."""

import itertools

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from pydrake.autodiffutils import InitializeAutoDiff

from drake_quad import load_scenario
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets, firing_strengths
from drake_quad.control.fuzzy.inputs import extrapolate_position, input_signals, input_values, route_phase
from drake_quad.scenario.batch import Batch
from drake_quad.signals import Acceleration, PositionError, PositionErrorRate, State

SIGNALS = {
    "error": PositionError(0.1, 0.2, 0.3),
    "error_rate": PositionErrorRate(0.4, 0.5, 0.6),
    "measurement": State(*np.arange(1.0, 13.0).tolist()),
    "disturbance": Acceleration(-0.7, -0.8, -0.9),
}


def test_an_input_of_a_rule_is_a_signal_on_the_axis_a_coordinate_or_the_phase():
    inputs = ("error", "error_rate", "z", "v_x", "phase", "disturbance")
    assert input_signals(inputs) == ("error", "error_rate", "measurement", "disturbance")
    for axis, values_on_axis in (("x", (0.1, 0.4, -0.7)), ("y", (0.2, 0.5, -0.8)), ("z", (0.3, 0.6, -0.9))):
        e, rate, d = values_on_axis
        assert input_values(axis, inputs, SIGNALS, 2.0, (0.0, 8.0)) == [e, rate, 3.0, 7.0, 0.25, d]


def test_a_network_requires_only_the_signals_of_its_inputs():
    assert input_signals(("phase", "v_z", "x")) == ("measurement",)
    assert input_signals(("phase", "error_rate")) == ("error_rate",)


@pytest.mark.parametrize(
    ("time", "phase"), [(-1.0, 0.0), (0.5, 0.0), (1.5, 0.25), (4.4999, 0.99998), (4.5, 1.0), (9.0, 1.0)]
)
def test_the_phase_of_a_route_rises_from_0_to_1(time, phase):
    assert route_phase(time, (0.5, 4.5)) == pytest.approx(phase, abs=1e-5)


def test_the_phase_restarts_with_each_lap():
    """The laps have different durations."""
    laps = (1.0, 4.0, 6.0, 8.0, 13.0)
    middles = [route_phase(0.5 * (start + end), laps) for start, end in itertools.pairwise(laps)]
    assert middles == pytest.approx([0.5] * 4)
    assert [route_phase(time, laps) for time in laps] == pytest.approx([0.0] * 5, abs=1e-12)
    assert [route_phase(time - 1e-6, laps) for time in laps[1:]] == pytest.approx([1.0] * 4, abs=1e-5)
    assert route_phase(0.3, laps) == 0.0


def test_type_1_firing_strengths_of_four_inputs_are_products_of_those_of_two_pairs():
    """The pairs are the first two and the last two inputs. Type 2 does not have this property."""
    rng = np.random.default_rng(4)
    sets = [FuzzySets(1.0 + 0.1 * n, tuple(np.linspace(-1.0, 1.0, n)), (1.3,) * n) for n in (2, 3, 4, 2)]
    for values in rng.uniform(-1.0, 1.0, (20, 4)).tolist():
        firing = firing_strengths(values, Antecedents(1.0, 1.0, 0.0, tuple(sets)))
        first = firing_strengths(values[:2], Antecedents(1.0, 1.0, 0.0, tuple(sets[:2])))
        last = firing_strengths(values[2:], Antecedents(1.0, 1.0, 0.0, tuple(sets[2:])))
        np.testing.assert_allclose(firing, np.outer(first, last).ravel(), atol=1e-15)
        assert sum(firing) == pytest.approx(1.0, abs=1e-14)


def test_the_position_is_extrapolated_by_the_velocity():
    """Attitude, velocity and body rates remain unchanged."""
    now, ahead = np.array(SIGNALS["measurement"]), np.array(extrapolate_position(SIGNALS["measurement"], 0.2))
    np.testing.assert_allclose(ahead[:3], [1.0 + 0.2 * 7.0, 2.0 + 0.2 * 8.0, 3.0 + 0.2 * 9.0], rtol=1e-15)
    np.testing.assert_array_equal(ahead[3:], now[3:])


def test_the_phase_has_a_derivative_with_respect_to_time():
    (time,) = InitializeAutoDiff(np.array([5.0])).ravel()
    assert route_phase(time, (1.0, 4.0, 6.0)).derivatives() == pytest.approx([0.5])


@pytest.mark.long
def test_a_network_with_phase_input_flies_equally_compiled_and_uncompiled(diagrams):
    """A lap takes a third of a second. The weights of each fuzzy set of the phase learn only in its part of the lap."""
    scenario = load_scenario(
        diagrams / "laboratory.yaml:nominal",
        [
            "route={kind: lissajous, amplitude: [0.0001, 0.0, 0.0], period: 0.32, laps: 4}",
            "metrics={first_lap: 2}",
            "control.network={kind: type_1,"
            " inputs: {phase: {centres: [0, 0.4, 0.7], widths: [0.35, 0.45, 0.35]}, v_x: {}},"
            " lead: 0.03, learning: {kind: gradient, signal: feedback, rate: 20.0}}",
        ],
    )
    flight, _ = assert_flown_alike(Batch.draw(scenario, [3, 0]))
    weights_on_x, _ = np.split(flight["weights"], 2, axis=1)
    # The sum is over the sets of v_x, the first input of the rules.
    change = np.abs(np.diff(weights_on_x, axis=0)).reshape(-1, 3, 3).sum(axis=1)
    # A lap has 16 ticks of 20 ms. The first set, around phase 0, learns at both ends of a lap but not in its middle.
    phase = (np.arange(len(change)) % 16) / 16.0
    middle, late, early = (phase > 0.36) & (phase < 0.64), phase > 0.66, phase < 0.34
    assert change[middle, 0].max() == 0.0 < min(change[late, 0].max(), change[early, 0].max())
    assert change[early & (phase > 0.06), 2].max() == 0.0 < min(change[middle, 2].max(), change[phase < 0.04, 2].max())
    assert len(change) > 48
