"""Tests of adaptive membership functions: their gradient, their bounds, and their system."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad import simulate
from drake_quad.control.fuzzy.adaptation import (
    AdaptationRates,
    _with_valid_widths,
    adapt_antecedents,
    membership_derivatives,
    output_gradient,
)
from drake_quad.control.fuzzy.inference import (
    Antecedents,
    CircularSets,
    FuzzySets,
    elliptic_membership,
    firing_strengths,
)
from drake_quad.control.fuzzy.laws import GradientLaw, LearningLimits
from drake_quad.control.fuzzy.set_learning import AdaptationParameters, SetLearning
from drake_quad.control.fuzzy.systems import (
    FuzzyRules,
    FuzzyRulesParameters,
    LearningParameters,
    WeightLearning,
    build_fuzzy_network,
)
from drake_quad.framework.records import layout_of

ALL_PARTS = ("centres", "widths", "exponents")
FUZZY_SETS_OF_INPUTS = (
    FuzzySets(1.8, (-1.0, -0.1, 0.5, 1.2), (1.1, 0.9, 1.3, 0.8)),
    FuzzySets(0.7, (-0.9, 0.2, 0.8), (1.2, 1.0, 1.4)),
    CircularSets(3.9, (-0.7, 1.1), (1.5, 1.6)),
)
INITIAL_ANTECEDENTS = Antecedents(a1=1.4, a2=0.6, q=0.3, inputs=FUZZY_SETS_OF_INPUTS)  # before learning


def with_change(antecedents, index, change):
    """Return the antecedents with one changed parameter."""
    layout = layout_of(Antecedents, antecedents)
    rows = layout.flatten(antecedents)
    rows[index] += change
    return layout.build(rows)


@pytest.mark.parametrize("a1", [1.0, 1.4])
def test_the_output_gradient_matches_central_differences(a1):
    """The derivatives with respect to the scales are zero by definition, because the scales never learn."""
    rng = np.random.default_rng(7)
    start = INITIAL_ANTECEDENTS._replace(a1=a1)
    layout = layout_of(Antecedents, start)
    for values in rng.uniform(-0.4, 0.35, (6, 3)).tolist():
        weights = rng.normal(size=start.num_rules)
        gradient = layout.flatten(output_gradient(values, start, weights.tolist()))
        for index, (name, derivative) in enumerate(zip(layout.names, gradient, strict=True)):
            if "scale" in name:
                assert derivative == 0.0
                continue
            up, down = (
                np.dot(weights, firing_strengths(values, with_change(start, index, side * 1e-6)))
                for side in (1.0, -1.0)
            )
            assert derivative == pytest.approx((up - down) / 2e-6, rel=1e-5, abs=1e-7), name


def test_membership_slopes_are_finite_at_centre_and_edge_and_zero_outside_a_set():
    for exponent in (0.3, 0.8, 1.0, 1.4, 3.0):
        slopes = np.array([membership_derivatives(u, exponent) for u in (0.0, 1e-12, 0.999999, -0.999999)])
        by_distance, by_exponent = slopes.T
        assert (by_distance >= -10.0).all()
        assert (by_distance <= 0.0).all()
        assert (np.abs(by_exponent) < 1.0).all()
        assert membership_derivatives(1.2, exponent) == membership_derivatives(-1.0, exponent) == (0.0, 0.0)
    np.testing.assert_allclose([membership_derivatives(u, 1.0)[0] for u in (0.0, 0.5, 0.9)], -1.0, rtol=1e-12)


@pytest.mark.long
@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.01, 1e3))
def test_adapted_sets_stay_valid_for_any_learning_signal(seed, size):
    rng, sets = np.random.default_rng(seed), INITIAL_ANTECEDENTS
    for _ in range(5):
        values, weights = rng.uniform(-1.0, 1.0, 3).tolist(), rng.normal(size=24).tolist()
        gradient = output_gradient(values, sets, weights)
        sets = adapt_antecedents(
            sets,
            gradient,
            rng.normal() * size,
            AdaptationRates(1.0, 1.0, 1.0),
            initial=INITIAL_ANTECEDENTS,
            parts=ALL_PARTS,
        )
        assert sets.a1 > 1.0 > sets.a2 > 0.0
        assert 0.0 <= sets.q <= 1.0
        for after, before in zip(sets.inputs, INITIAL_ANTECEDENTS.inputs, strict=True):
            centres, widths = np.array(after.centres), np.array(after.widths)
            assert (centres[[0, -1]] == np.array(before.centres)[[0, -1]]).all()
            assert (np.diff(centres) >= 0.5 * np.diff(before.centres) - 1e-12).all()
            # Every point belongs to at least one set, so no division by zero occurs.
            assert (widths[:-1] + widths[1:] >= 1.02 * np.diff(centres) - 1e-12).all()
            if isinstance(before, CircularSets):
                assert widths[-1] + widths[0] >= 1.02 * (centres[0] + before.scale - centres[-1]) - 1e-12
            assert (widths <= np.maximum(before.widths, np.ptp(centres)) + 1e-12).all()
            assert after.scale == before.scale
        assert sum(firing_strengths(values, sets)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("part", ALL_PARTS)
def test_only_the_selected_parts_of_the_sets_learn(part):
    gradient = output_gradient([0.2, 0.3, -0.1], INITIAL_ANTECEDENTS, np.arange(24.0).tolist())
    rates = AdaptationRates(0.5, 0.3, 0.2)
    after = adapt_antecedents(INITIAL_ANTECEDENTS, gradient, 0.001, rates, initial=INITIAL_ANTECEDENTS, parts=(part,))
    changed = {
        "exponents": after[:3] != INITIAL_ANTECEDENTS[:3],
        "centres": any(new.centres != old.centres for new, old in zip(after.inputs, FUZZY_SETS_OF_INPUTS, strict=True)),
        "widths": any(new.widths != old.widths for new, old in zip(after.inputs, FUZZY_SETS_OF_INPUTS, strict=True)),
    }
    assert [name for name, has_changed in changed.items() if has_changed] == [part]
    # The step is too small to reach a bound, so each part changes by its rate times the gradient.
    layout = layout_of(Antecedents, INITIAL_ANTECEDENTS)
    before, slopes, final = (np.array(layout.flatten(record)) for record in (INITIAL_ANTECEDENTS, gradient, after))
    is_moved = final != before
    np.testing.assert_allclose((final - before)[is_moved], -0.001 * getattr(rates, part) * slopes[is_moved], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("learns_from", ["surface", "feedback"])
def test_a_tick_of_the_system_is_a_gradient_step_on_each_axis(learns_from):
    """The parameters of two vehicles follow the equations of the gradient law with a dead zone."""
    sets = (
        INITIAL_ANTECEDENTS._replace(inputs=FUZZY_SETS_OF_INPUTS[:2]),
        INITIAL_ANTECEDENTS._replace(a1=1.2, inputs=FUZZY_SETS_OF_INPUTS[:2]),
    )
    learning = LearningParameters(1.7, GradientLaw(0.4), LearningLimits(deadzone=0.05))
    parameters = AdaptationParameters(sets, AdaptationRates(0.5, 0.3, 0.2), learning)
    system = SetLearning(num_vehicles=2, axes=("x", "z"), learns_from=learns_from, parameters=parameters)
    rng, context = np.random.default_rng(2), system.CreateDefaultContext()
    rows = {"error": 3, "error_rate": 3, "pd": 3, "disturbance": 3, "weights": 24}
    given = {name: 0.4 * rng.normal(size=(count, 2)) for name, count in rows.items()}
    given["pd"][2, 1] = given["disturbance"][2, 1] + 0.02
    for name, values in given.items():
        if system.HasInputPort(name):
            system.GetInputPort(name).FixValue(context, values.ravel())
    context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
    layout = layout_of(tuple[Antecedents, ...], sets)
    final = np.reshape(system.GetOutputPort("antecedents").Eval(context), (-1, 2))
    for vehicle in range(2):
        expected = []
        for index, (axis, initial) in enumerate(zip((0, 2), sets, strict=True)):
            e, rate, pd, d = (given[name][axis, vehicle] for name in ("error", "error_rate", "pd", "disturbance"))
            signal = rate + 1.7 * e if learns_from == "surface" else pd - d
            step = 0.02 * signal if abs(signal) >= 0.05 else 0.0
            weights = given["weights"][12 * index : 12 * (index + 1), vehicle].tolist()
            gradient = output_gradient((float(e), float(rate)), initial, weights)
            expected.append(
                adapt_antecedents(initial, gradient, step, parameters.rates, initial=initial, parts=ALL_PARTS)
            )
        np.testing.assert_allclose(final[:, vehicle], layout.flatten(tuple(expected)), rtol=1e-12)


@pytest.mark.slow
def test_a_network_with_zero_adaptation_rates_equals_one_with_constant_sets():
    """The corrections of both networks are equal for the same weights and inputs."""
    sets, parameters = (
        INITIAL_ANTECEDENTS._replace(inputs=FUZZY_SETS_OF_INPUTS[:2]),
        LearningParameters(1.7, GradientLaw(0.4), initial_weight=0.3),
    )

    def command(**options):
        network = build_fuzzy_network(
            rules=FuzzyRules(adaptive=bool(options), parameters=FuzzyRulesParameters((sets,))),
            learning=WeightLearning(num_rules=12, parameters=parameters),
            **options,
        )
        context = network.CreateDefaultContext()
        for name, rows in (("error", (0.1, -0.2, 0.3)), ("error_rate", (0.4, 0.1, -0.3))):
            network.GetInputPort(name).FixValue(context, rows)
        learning = network.GetSubsystemByName("learning")
        weights = tuple(tuple(np.linspace(-1.0, 1.0, 12) * side) for side in (1.0, -0.7))
        learning.set_state(learning.GetMyMutableContextFromRoot(context), "weights", weights)
        return network.GetOutputPort("correction").Eval(context)

    adaptive = SetLearning(parameters=AdaptationParameters((sets, sets), learning=parameters))
    np.testing.assert_array_equal(command(sets=adaptive), command())


@pytest.mark.long
def test_adaptive_sets_move_in_flight_and_do_not_increase_the_error(asymmetric):
    """For this network of few rules, the error with adaptive sets may be at most 2 % larger than with constant sets."""
    overrides = ["control.network.learning={kind: gradient, rate: 0.6}", "metrics.start=5", "crash.position_error=5"]
    constant_sets = simulate(asymmetric("pd_t2fnn", *overrides), sample=0, compiled=True)
    rates = "control.network.adaptive={centres: 0.5, widths: 0.5, exponents: 0.5}"
    adaptive = simulate(asymmetric("pd_t2fnn", *overrides, rates), sample=0, compiled=True)
    parameters = adaptive["antecedents"]
    assert parameters.shape[1] == 3 * 19
    is_moved = np.ptp(parameters, axis=0) > 0.0
    assert 20 < is_moved.sum() < 60
    assert adaptive.metrics.rmse <= 1.02 * constant_sets.metrics.rmse
    assert "antecedents" not in constant_sets.signals


def test_membership_derivatives_agree_with_the_membership():
    """`membership_derivatives` returns the derivatives of `elliptic_membership` with respect to its two arguments."""
    for exponent in (0.7, 1.3):
        for u in (0.1, 0.5, 0.9):
            by_distance, by_exponent = membership_derivatives(u, exponent)
            difference = elliptic_membership(u + 1e-6, exponent) - elliptic_membership(u - 1e-6, exponent)
            assert by_distance == pytest.approx(difference / 2e-6, rel=1e-6)
            difference = elliptic_membership(u, exponent + 1e-6) - elliptic_membership(u, exponent - 1e-6)
            assert by_exponent == pytest.approx(difference / 2e-6, rel=1e-6)


def test_a_set_that_began_wider_than_all_sets_together_keeps_its_width():
    """A set may be as wide as the distance from the first to the last centre, or as it was before learning."""
    initial = FuzzySets(1.0, (-0.5, 0.0, 0.5), (1.6, 0.9, 0.7))
    learned = initial._replace(widths=(1.5, 2.0, 2.0))
    assert _with_valid_widths(learned, initial).widths == (1.5, 1.0, 1.0)
    assert _with_valid_widths(learned._replace(widths=(3.0, 0.9, 0.7)), initial).widths[0] == 1.6
