"""Estimates of several logs: weighted by their errors, which grow where logs disagree."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad import InputError
from drake_quad.identification.results.estimates import Estimates, Explained, Source
from drake_quad.identification.results.merging import merged


def estimate(log, method="least squares", freedom=np.inf, covariance=None, **values):
    """Values and deviations by name; _0 stands for an item of a list."""
    names = tuple(name.replace("_0", "[0]").replace("_1", "[1]") for name in values)
    numbers, deviations = np.array([*values.values()]).T
    covariance = np.diag(deviations**2) if covariance is None else np.array(covariance)
    return Estimates(names, numbers, covariance, freedom, Source(method, log))


def test_the_mean_is_weighted_by_inverse_variances():
    found = merged([estimate("a", mass=(1.0, 0.1), freedom=8.0), estimate("b", mass=(1.1, 0.2), freedom=20.0)])
    assert found.values == pytest.approx([(1.0 / 0.01 + 1.1 / 0.04) / (1.0 / 0.01 + 1.0 / 0.04)])
    assert found.deviations == pytest.approx([1.0 / np.sqrt(1.0 / 0.01 + 1.0 / 0.04)])
    # Welch and Satterthwaite: weights 0.8 and 0.2.
    assert found.degrees_of_freedom == pytest.approx([1.0 / (0.64 / 8.0 + 0.04 / 20.0)])
    assert found.sources == ((Source("least squares", "a"), Source("least squares", "b")),)
    assert found.remarks == ()


def test_what_different_logs_tell_are_blocks_of_their_own():
    first = estimate("a", mass=(1.0, 0.1), arm_length=(0.1, 0.01), covariance=[[0.01, 5e-4], [5e-4, 1e-4]])
    found = merged([first, estimate("b", inertia_0=(1e-3, 1e-5), freedom=3.0)])
    assert found.names == ("mass", "arm_length", "inertia[0]")
    np.testing.assert_allclose(found.values, [1.0, 0.1, 1e-3], rtol=1e-9)
    np.testing.assert_allclose(found.covariance[:2, :2], first.covariance, rtol=1e-6)
    np.testing.assert_allclose(found.covariance[2], [0.0, 0.0, 1e-10], rtol=1e-6, atol=1e-20)
    np.testing.assert_array_equal(found.degrees_of_freedom, [np.inf, np.inf, 3.0])
    assert [[source.log for source in each] for each in found.sources] == [["a"], ["a"], ["b"]]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_it_is_the_least_squares_of_all(seed):
    """Beside the normal equations of the whole, where nothing disagrees: the estimates are the same numbers."""
    rng = np.random.default_rng(seed)
    names = ("mass", "arm_length", "linear_drag")
    parts = [(0, 1), (1, 2), (0, 1, 2), (2,)]
    shapes = [rng.normal(size=(len(part), 5)) for part in parts]
    covariances = [shape @ shape.T for shape in shapes]
    truth = np.array([3.0, 2.0, 1.0])
    records = [
        Estimates(tuple(names[i] for i in part), truth[list(part)], each, np.inf, Source("any", str(k)))
        for k, (part, each) in enumerate(zip(parts, covariances, strict=True))
    ]
    found = merged(records)
    design = np.concatenate([np.eye(3)[list(part)] for part in parts])
    precision = design.T @ np.linalg.inv(scipy.linalg.block_diag(*covariances)) @ design
    order = [found.names.index(name) for name in names]
    np.testing.assert_allclose(found.values[order], truth, rtol=1e-6)
    np.testing.assert_allclose(found.covariance[np.ix_(order, order)], np.linalg.inv(precision), rtol=1e-5, atol=1e-9)
    assert found.remarks == ()


def test_what_disagrees_is_less_sure():
    """By Birge's ratio, the spread is that of the logs, and so are the degrees of freedom."""
    masses = [1.0, 1.3, 0.8, 1.1]
    found = merged([estimate(str(i), mass=(mass, 0.01), arm_length=(0.1, 0.01)) for i, mass in enumerate(masses)])
    assert found.value("mass") == pytest.approx(np.mean(masses))
    assert found.deviations == pytest.approx([np.std(masses, ddof=1) / 2.0, 0.005], rel=1e-6)
    np.testing.assert_array_equal(found.degrees_of_freedom, [3.0, np.inf])
    (remark,) = found.remarks
    assert "estimates of mass disagree: 1 ± 0.01, 1.3 ± 0.01, 0.8 ± 0.01, 1.1 ± 0.01 kg" in remark


def test_what_agrees_only_number_by_number_is_less_sure_too():
    """Each is within its error, but their sum is known well, and differs."""
    covariance = [[1.0, -0.999], [-0.999, 1.0]]
    pair = [
        estimate(log, mass=(1.0, 1.0), arm_length=(length, 1.0), covariance=covariance)
        for log, length in (("a", 1.0), ("b", 1.6))
    ]
    found = merged(pair)
    (remark,) = found.remarks
    assert "together, the estimates of mass, arm_length disagree" in remark
    sums = np.ones(2)
    misfit = 0.6**2 / (2.0 * (sums @ np.array(covariance) @ sums))
    assert sums @ found.covariance @ sums == pytest.approx(0.001 * 0.5 * misfit, rel=0.01)
    np.testing.assert_array_equal(found.degrees_of_freedom, [2.0, 2.0])


def test_two_methods_of_one_log_do_not_count_twice():
    sure, unsure = (
        estimate("a", "shooting", mass=(1.0, 0.1)),
        estimate("a", "thrust", mass=(1.2, 0.3), arm_length=(1, 1)),
    )
    found = merged([unsure, sure, estimate("b", mass=(1.1, 0.1))])
    assert found.value("mass") == pytest.approx(1.05)
    assert found.deviations[found.names.index("mass")] == pytest.approx(0.1 / np.sqrt(2.0))
    assert found.remarks == (
        "mass is 1.2 ± 0.3 kg by thrust too, which does not count beside shooting: it is of the same log, a",
    )
    assert found.value("arm_length") == pytest.approx(1.0)


def test_the_surest_says_what_a_number_explains_and_nothing_is_unseen_that_another_log_tells():
    share = Explained(0.3, "thrust")
    first = Estimates(("mass",), [1.0], [[1.0]], 9.0, Source("x", "a"), {"mass": Explained(0.1, "z")}, {}, ("A gap.",))
    second = Estimates(("mass",), [1.0], [[0.1]], 9.0, Source("x", "b"), {"mass": share}, {"drag_factor": "no yaw"})
    unseen = {"mass": "no thrust", "drag_factor": "still no yaw"}
    third = Estimates(("arm_length",), [1.0], [[0.1]], 9.0, Source("x", "c"), {}, unseen, ("A gap.",))
    found = merged([first, second, third])
    assert found.explained == {"mass": share}
    assert found.not_seen == {"drag_factor": "no yaw"}
    assert found.remarks == ("A gap.",)


@pytest.mark.parametrize("deviations", [(0.5, 0.5, 0.5), (0.2, 0.4, 1.0)])
def test_intervals_of_what_is_merged_cover(deviations):
    """At 95 %, with deviations that are known of numbers that differ by no more."""
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        found = merged([estimate(str(i), mass=(rng.normal(9.0, each), each)) for i, each in enumerate(deviations)])
        low, high = found.intervals()[0]
        hits += low <= 9.0 <= high
    assert 0.91 < hits / 200 <= 0.995


def test_nothing_cannot_be_merged():
    with pytest.raises(InputError, match="no estimates"):
        merged([])
