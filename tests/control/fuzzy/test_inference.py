"""Tests of fuzzy inference, by comparison with pyit2fls and by its mathematical properties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.control.fuzzy.inference import (
    Antecedents,
    CircularSets,
    FuzzySets,
    elliptic_membership,
    firing_strengths,
)

upper_exponents = st.floats(1.001, 3.0)
lower_exponents = st.floats(0.1, 0.999)
weights_of_lower = st.floats(0.0, 1.0)
inputs_in_universe = st.floats(-1.0, 1.0)


def multiples_of_a_sixteenth(low, high):
    return st.integers(16 * low, 16 * high).map(lambda number: number / 16)


@st.composite
def fuzzy_sets(draw):
    """Draw two to five overlapping sets with any scale.

    Their centres are multiples of 1/16, so that the ends of their supports have no rounding errors.
    """
    centres = np.cumsum(
        [draw(multiples_of_a_sixteenth(-3, 3)), *draw(st.lists(multiples_of_a_sixteenth(1, 2), min_size=1, max_size=4))]
    )
    gaps = np.diff(centres)
    # Each width exceeds half of the distance to either neighbour.
    widths = [max(gaps[max(i - 1, 0) : i + 1]) * draw(st.sampled_from([0.625, 1.0, 1.25])) for i in range(len(centres))]
    return FuzzySets(draw(st.floats(0.1, 10.0)), tuple(centres.tolist()), tuple(map(float, widths)))


def pyit2fls_network(antecedents, weights):
    """Return a network of the library pyit2fls with the same antecedents and weights."""
    import pyit2fls  # The import takes two seconds.

    network = pyit2fls.IT2TSK(pyit2fls.product_t_norm, pyit2fls.probabilistic_sum_s_norm)
    # The output of pyit2fls is the middle of an interval, which contains only one point here.
    q = antecedents.q
    network.algorithm = lambda intervals: (pyit2fls.BMM_algorithm(intervals, (q, 1.0 - q)),) * 2
    inputs = {}
    for name, sets in zip(("error", "rate"), antecedents.inputs, strict=True):
        network.add_input_variable(name)
        inputs[name] = [
            pyit2fls.IT2FS_Elliptic(np.linspace(c - d, c + d, 3), [c, d, antecedents.a1, antecedents.a2, 1.0])
            for c, d in zip(sets.centres, sets.widths, strict=True)
        ]
    network.add_output_variable("u")
    pairs = [(first, second) for first in inputs["error"] for second in inputs["rate"]]
    for (first, second), weight in zip(pairs, weights, strict=True):
        consequent = {"const": float(weight), "error": 0.0, "rate": 0.0}
        network.add_rule([("error", first), ("rate", second)], [("u", consequent)])
    return network


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(upper_exponents, lower_exponents, weights_of_lower, fuzzy_sets(), fuzzy_sets(), st.integers(0, 2**32))
def test_inference_matches_pyit2fls(a1, a2, q, error, rate, seed):
    """Each network is compared at 15 points."""
    rng = np.random.default_rng(seed)
    antecedents = Antecedents(a1, a2, q, (error, rate))
    weights = rng.normal(size=antecedents.num_rules)
    network = pyit2fls_network(antecedents, weights)
    for _ in range(15):
        x = [rng.uniform(sets.centres[0], sets.centres[-1]) for sets in (error, rate)]
        firing = firing_strengths((x[0] / error.scale, x[1] / rate.scale), antecedents)
        expected = network.evaluate({"error": x[0], "rate": x[1]})["u"]
        assert np.dot(firing, weights) == pytest.approx(expected, abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(st.floats(0.1, 5.0), inputs_in_universe)
def test_memberships_are_elliptic(exponent, u):
    grade = elliptic_membership(u, exponent)
    assert grade**exponent + abs(u) ** exponent == pytest.approx(1.0, abs=1e-12)
    assert elliptic_membership(-u, exponent) == grade
    # Near the edge of the support, the rounding error of the power is amplified.
    assert elliptic_membership(np.array([u]), exponent)[0] == pytest.approx(grade, abs=1e-15 if abs(u) < 0.99 else 1e-4)


def test_memberships_are_zero_outside_the_sets():
    for exponent in (0.1, 0.5, 1.0, 2.0, 3.0):
        values = [0.0, -0.0, 1.0, -1.0, 1.5, -7.0]
        assert [elliptic_membership(u, exponent) for u in values] == [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
        np.testing.assert_array_equal(elliptic_membership(np.array(values), exponent), [1.0, 1.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    upper_exponents,
    lower_exponents,
    weights_of_lower,
    fuzzy_sets(),
    fuzzy_sets(),
    st.floats(-50.0, 50.0),
    st.floats(-50.0, 50.0),
)
def test_firing_strengths_are_not_negative_and_sum_to_one(a1, a2, q, error_sets, rate_sets, error, rate):
    """This holds for any inputs. Firing strengths that are computed for a fleet equal those of each vehicle alone."""
    antecedents = Antecedents(a1, a2, q, (error_sets, rate_sets))
    firing = firing_strengths((error, rate), antecedents)
    assert min(firing) >= 0.0
    assert sum(firing) == pytest.approx(1.0, abs=1e-13)
    errors, rates = np.linspace(error - 1.0, error, 7), np.linspace(rate, rate + 1.0, 7)
    fleet = np.array(firing_strengths((errors, rates), antecedents))
    alone = [firing_strengths((float(e), float(r)), antecedents) for e, r in zip(errors, rates, strict=True)]
    np.testing.assert_allclose(fleet, np.transpose(alone), atol=1e-15, rtol=1e-12)


def test_inputs_are_clamped_to_the_universe():
    error, rate = FuzzySets(2.0, (-1.0, -0.1, 0.8), (1.1, 0.9, 1.3)), FuzzySets(0.5, (-0.9, 0.3, 1.2), (1.4, 1.3, 1.5))
    antecedents = Antecedents(1.3, 0.7, 0.4, (error, rate))
    # The universes of the two inputs range from -0.5 to 0.4 and from -1.8 to 2.4, in units of the inputs.
    for beyond, edge in ((-0.51, -0.5), (-9.0, -0.5), (0.41, 0.4), (9.0, 0.4)):
        assert firing_strengths((beyond, 0.2), antecedents) == firing_strengths((edge, 0.2), antecedents)
    for beyond, edge in ((-1.81, -1.8), (-9.0, -1.8), (2.41, 2.4), (9.0, 2.4)):
        assert firing_strengths((0.1, beyond), antecedents) == firing_strengths((0.1, edge), antecedents)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-5.0, 5.0), min_size=9, max_size=9), inputs_in_universe, inputs_in_universe)
def test_a_type_1_network_interpolates_between_its_weights(weights, error, rate):
    triangles = Antecedents(a1=1.0, a2=1.0)
    table = np.reshape(weights, (3, 3))
    i, j = min(int(error + 1.0), 1), min(int(rate + 1.0), 1)
    s, t = error + 1.0 - i, rate + 1.0 - j
    expected = (1 - s) * ((1 - t) * table[i, j] + t * table[i, j + 1]) + s * (
        (1 - t) * table[i + 1, j] + t * table[i + 1, j + 1]
    )
    assert np.dot(firing_strengths((error, rate), triangles), weights) == pytest.approx(expected, abs=1e-14)


def test_each_vehicle_of_a_fleet_may_have_its_own_network():
    rng = np.random.default_rng(3)
    n = 5
    a1, a2, q, scale, width = (rng.uniform(*limits, n) for limits in ((1.1, 2), (0.3, 0.9), (0, 1), (1, 4), (0.8, 1.4)))
    error, rate = rng.normal(size=(2, n)) * 0.4
    wide = FuzzySets(scale, (-1.0, 0.0, 1.0), (width, width, width))
    fleet = np.array(firing_strengths((error, rate), Antecedents(a1, a2, q, (wide, wide))))
    for i in range(n):
        sets = FuzzySets(scale[i], (-1.0, 0.0, 1.0), (width[i],) * 3)
        alone = firing_strengths((error[i], rate[i]), Antecedents(a1[i], a2[i], q[i], (sets, sets)))
        np.testing.assert_allclose(fleet[:, i], alone, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("value", [-0.3, 0.0, 0.31, 0.9, 0.97, 1.0, 4.2])
def test_circular_sets_use_the_shorter_distance_around_the_circle(value):
    """The inputs 0 and 1 are the same point of the circle. Expected distances are angles between directions."""
    scale, centres, widths, a1, a2, q = 2.5, (0.2, 1.1, 2.3), (1.4, 1.1, 1.3), 1.3, 0.7, 0.4
    directions = np.exp(2j * np.pi * np.array([value, *np.array(centres) / scale]))
    u = np.abs(np.angle(directions[1:] / directions[0])) * scale / (2.0 * np.pi) / widths
    strengths = [np.where(u < 1.0, (1.0 - np.minimum(u, 1.0) ** a) ** (1.0 / a), 0.0) for a in (a1, a2)]
    expected = (1.0 - q) * strengths[0] / strengths[0].sum() + q * strengths[1] / strengths[1].sum()
    firing = firing_strengths((value,), Antecedents(a1, a2, q, (CircularSets(scale, centres, widths),)))
    np.testing.assert_allclose(firing, expected, atol=1e-9)
