"""Tests of modes and their participating states, for systems with known modes."""

import math

import numpy as np
import pytest

from drake_quad.linear.modes import modes


@pytest.mark.parametrize(
    ("poles", "multiplicities"),
    [
        ((-100.0, -100.05), [2]),
        ((-100.0, -100.12), [1, 1]),
        ((-0.300, -0.305), [2]),
        ((-0.300, -0.312), [1, 1]),
    ],
)
def test_close_poles_count_as_one_mode(poles, multiplicities):
    """Poles are close if they differ by less than a thousandth of their magnitude or by less than 0.01 1/s."""
    found_modes = modes(np.diag(poles), ("a", "b"))
    assert [mode.multiplicity for mode in found_modes] == multiplicities
    assert [mode.states for mode in found_modes] == ([("a", "b")] if multiplicities == [2] else [("a",), ("b",)])
    assert np.mean(poles) == pytest.approx(np.mean([mode.pole.real for mode in found_modes]))


@pytest.mark.parametrize(("poles", "period"), [(-np.arange(1.0, 7.0), None), ([0.9, 0.5, 0.3, -0.6, -0.4, -0.2], 0.02)])
def test_a_mode_names_its_main_states_in_descending_order(poles, period):
    """The expected participation factors are products of the entries of right and left eigenvectors.

    Some eigenvalues are negative. Rounding errors can change the imaginary parts of their logarithms from π to -π. This
    must not affect the modes.
    """
    rng = np.random.default_rng(7)
    states, num_left_out, orders = tuple("abcdef"), 0, set()
    for _ in range(12):
        T = rng.normal(size=(6, 6))
        A = T @ np.diag(poles) @ np.linalg.inv(T)
        fractions = np.abs(T * np.linalg.inv(T).T)
        for mode, fraction in zip(modes(A, states, period=period), fractions.T, strict=True):
            order = [states[i] for i in np.argsort(-fraction) if fraction[i] > 0.1 * fraction.max()]
            assert mode.states == tuple(order)
            num_left_out += 6 - len(order)
            orders.add(tuple(order))
    assert num_left_out > 20
    assert any(order != tuple(sorted(order)) for order in orders)


@pytest.mark.parametrize("seed", range(40))
def test_a_repeated_negative_eigenvalue_is_one_mode(seed):
    """Rounding may split the eigenvalue into a pair whose logarithms differ by 2πi."""
    T = np.random.default_rng(seed).normal(size=(4, 4))
    A = T @ np.diag([-0.4, -0.4, 0.2, 0.9]) @ np.linalg.inv(T)
    slow, middle, fast = modes(A, tuple("abcd"), period=0.02)
    assert (slow.multiplicity, middle.multiplicity, fast.multiplicity) == (1, 1, 2)
    assert fast.pole == pytest.approx(complex(math.log(0.4), math.pi) / 0.02)
    assert fast.states


def test_an_integrator_has_no_damping_and_a_growing_mode_has_negative_damping():
    integrator, grown = modes(np.diag([0.0, 0.5]), ("a", "b"))
    assert (integrator.frequency, integrator.multiplicity) == (0.0, 1)
    assert math.isnan(integrator.damping)
    assert (grown.pole, grown.frequency, grown.damping) == (0.5, 0.5, -1.0)


def test_modes_that_decay_within_a_tick_are_left_out():
    """Poles at zero, as in a delay line, are left out as well. A pole at 0.0012 decays more slowly and is kept."""
    kept_modes = modes(np.diag([0.0, 0.0009, 0.0012, 0.5, -0.5]), tuple("abcde"), period=0.1)
    expected = sorted([math.log(0.0012) / 0.1, math.log(0.5) / 0.1, complex(math.log(0.5), math.pi) / 0.1], key=abs)
    assert [mode.pole for mode in kept_modes] == pytest.approx(expected)
    assert modes(np.diag([0.0, 1e-5]), ("a", "b"))[0].multiplicity == 2
