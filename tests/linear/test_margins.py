"""Tests of stability margins, by comparison with their definitions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from drake_quad.linear.margins import _crossings, fast_margins, frequencies, margins
from drake_quad.linear.sampled_system import SampledSystem

PERIOD = 0.02  # s


def loop_of(k_p, k_d, *, lag=0.05, delay_ticks=2):
    """Return the loop of a PD controller and a double integrator with a lag, a zero-order hold and delay ticks."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / lag]])
    B = np.array([[0.0], [0.0], [1.0 / lag]])
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, np.eye(3), np.zeros((3, 1))), PERIOD)
    n = 3 + delay_ticks
    state_matrix = np.zeros((n, n))
    state_matrix[:3, :3], state_matrix[:3, 3:4] = Ad, Bd
    state_matrix[3:-1, 4:] = np.eye(delay_ticks - 1)
    input_column = np.zeros((n, 1))
    input_column[-1] = 1.0
    output_row = np.zeros((1, n))
    output_row[0, :2] = k_p, k_d
    names = tuple(f"x{i}" for i in range(n))
    return SampledSystem(state_matrix, input_column, output_row, np.zeros((1, 1)), PERIOD, names, ("u",), ("y",))


def is_stable(loop, factor=1.0, more_delay=0):
    """Return whether the loop is stable with its gain multiplied by `factor` and with additional ticks of delay."""
    n = len(loop.A)
    A = np.zeros((n + more_delay, n + more_delay))
    A[:n, :n] = loop.A
    B = np.zeros((n + more_delay, 1))
    if more_delay:
        A[:n, n : n + 1] = loop.B
        A[n:-1, n + 1 :] = np.eye(more_delay - 1)
        B[-1] = 1.0
    else:
        B[:n] = loop.B
    C = np.hstack([loop.C, np.zeros((1, more_delay))])
    return np.abs(np.linalg.eigvals(A - factor * B @ C)).max() < 1.0


# Gains k_p and k_d.
PD_GAINS = [(5.0, 4.0), (9.0, 6.0), (2.0, 1.0), (20.0, 8.0)]


@pytest.mark.parametrize(("k_p", "k_d"), PD_GAINS)
def test_the_closed_loop_becomes_unstable_at_the_gain_margin(k_p, k_d):
    loop = loop_of(k_p, k_d)
    factor = 10.0 ** (margins(loop).gain / 20.0)
    assert is_stable(loop, 0.9999 * factor)
    assert not is_stable(loop, 1.0001 * factor)


@pytest.mark.parametrize(("k_p", "k_d"), PD_GAINS[:2])
def test_margins_match_python_control(k_p, k_d):
    """python-control gets the frequency response, since its polynomials in z lose too many digits."""
    import control

    loop = loop_of(k_p, k_d)
    grid = frequencies(PERIOD)
    data = control.FrequencyResponseData(loop.response(np.exp(1j * grid * PERIOD))[:, 0, 0], grid, smooth=True)
    gain, phase, _, _, crossover, _ = control.stability_margins(data)
    actual = margins(loop)
    assert actual.gain == pytest.approx(20.0 * np.log10(gain), rel=1e-8)
    assert actual.phase == pytest.approx(phase, rel=1e-8)
    assert actual.crossover == pytest.approx(crossover, rel=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_the_closed_loop_becomes_unstable_at_the_delay_margin(ticks):
    """The test searches the gains for which the margin is a whole number of ticks.

    Larger gains are unstable with this delay.
    """
    low, high = 0.02, 50.0  # bounds of the factor by which the gains are multiplied
    grid = frequencies(PERIOD)
    for _ in range(60):
        middle = np.sqrt(low * high)
        loop = loop_of(2.0 * middle, 2.0 * np.sqrt(middle))
        delay = fast_margins(loop.response(np.exp(1j * grid * PERIOD))[:, 0, 0], grid).delay
        low, high = (middle, high) if delay > ticks * PERIOD else (low, middle)
    for scale, is_tolerated in ((0.999 * low, True), (1.001 * low, False)):
        loop = loop_of(2.0 * scale, 2.0 * np.sqrt(scale))
        assert (margins(loop).delay > ticks * PERIOD) == is_tolerated
        assert is_stable(loop, more_delay=ticks) == is_tolerated


def nearest_crossing(L):
    """Return the smallest angle (degrees) between -1 and a point where the Nyquist curve crosses the unit circle."""
    crossings = np.flatnonzero(np.diff(np.abs(L) > 1.0))
    return np.degrees(np.abs(np.angle(-L[crossings]))).min()


def resonance(*, gain, delay_ticks, frequency=4.0, damping=0.02):
    """Return a sampled resonance (rad/s) with whole ticks of delay, and its matrices A and B without the delay."""
    A = np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]])
    B = np.array([[0.0], [gain * frequency**2]])
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), PERIOD)
    n = 2 + delay_ticks
    state_matrix, input_column, output_row = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    state_matrix[:2, :2], state_matrix[:2, 2:3] = Ad, Bd
    state_matrix[2:-1, 3:] = np.eye(delay_ticks - 1)
    input_column[-1], output_row[0, 0] = 1.0, 1.0
    names = tuple(map(str, range(n)))
    return SampledSystem(state_matrix, input_column, output_row, np.zeros((1, 1)), PERIOD, names, ("u",), ("y",)), (
        Ad,
        Bd,
    )


def test_a_real_positive_response_does_not_limit_the_gain():
    """The response of a resonance with the opposite sign is larger where it is positive than where it is negative."""
    loop, _ = resonance(gain=-0.02, delay_ticks=2)
    factor = 10.0 ** (margins(loop).gain / 20.0)
    response = loop.response(np.exp(1j * frequencies(PERIOD) * PERIOD))[:, 0, 0]
    assert response.real[np.abs(response.imag) < 0.1 * np.abs(response.real)].max() > 2.0 / factor
    assert is_stable(loop, 0.999 * factor)
    assert not is_stable(loop, 1.001 * factor)


def test_a_phase_jump_between_two_frequencies_is_not_a_crossing():
    """The phase of a sharp resonance jumps by more than π within one step of the grid, where L is positive."""
    loop, _ = resonance(gain=0.1, delay_ticks=10, frequency=20.0, damping=1e-5)
    grid = frequencies(PERIOD)

    def response(frequencies):
        return loop.response(np.exp(1j * frequencies * PERIOD))[:, 0, 0]

    turns = _crossings(loop, grid, response(grid), lambda L: np.angle(-L))
    assert len(turns) > 2
    np.testing.assert_allclose(np.angle(-response(turns)), 0.0, atol=1e-3)


@pytest.mark.slow
def test_the_delay_margin_is_the_delay_until_the_phase_falls_to_an_odd_multiple_of_180_degrees():
    """A resonance at 4 rad/s has a damping ratio of 0.02, a gain of 0.1 and 55 ticks of delay.

    At both crossovers, the phase is far below -180°. The delay margin is the delay until the phase falls to the next
    lower odd multiple of 180°, which need not be the nearest one. Closed loops confirm a margin of 0.497 s.
    """
    delay_ticks = 55
    loop, (Ad, Bd) = resonance(gain=0.1, delay_ticks=delay_ticks)
    grid = frequencies(PERIOD)
    fast = fast_margins(loop.response(np.exp(1j * grid * PERIOD))[:, 0, 0], grid)
    z = np.exp(1j * np.geomspace(1.0, 20.0, 200_001) * PERIOD)
    numerator, denominator = scipy.signal.ss2tf(Ad, Bd, np.array([[1.0, 0.0]]), np.zeros((1, 1)))
    phase = nearest_crossing(np.polyval(numerator[0], z) / np.polyval(denominator, z) * z**-delay_ticks)
    exact = margins(loop)
    assert exact.delay == pytest.approx(0.497, abs=5e-4)
    assert fast.delay == pytest.approx(exact.delay, rel=1e-3)
    # The phase margin holds for changes in both directions, so it is the distance to the nearest odd multiple of 180°,
    # which is above the phase here.
    assert exact.phase == pytest.approx(phase, abs=0.05)
    assert fast.phase == pytest.approx(phase, abs=0.05)
    assert [is_stable(loop, more_delay=ticks) for ticks in (0, 19, 20, 24, 25)] == [True, True, True, True, False]


@pytest.mark.parametrize(("k_p", "k_d"), PD_GAINS)
def test_every_gain_and_phase_within_the_disk_margin_is_tolerated(k_p, k_d):
    import control

    loop = loop_of(k_p, k_d)
    exact = margins(loop)
    low = (1.0 - 0.5 * exact.disk) / (1.0 + 0.5 * exact.disk)
    assert is_stable(loop, 1.001 * low)
    assert is_stable(loop, 0.999 / low)
    grid = frequencies(PERIOD)
    response = loop.response(np.exp(1j * grid * PERIOD))[:, 0, 0]
    # The loop tolerates any gain f between `low` and 1 / `low`. The disk around the points -1 / f touches the Nyquist
    # curve and contains no point of the curve.
    middle, radius = -0.5 * (low + 1.0 / low), 0.5 * (1.0 / low - low)
    assert np.abs(response - middle).min() == pytest.approx(radius, rel=1e-3)
    top = int(np.argmax(np.abs(1.0 / (1.0 + response) - 0.5)))
    fine = np.linspace(grid[top - 1], grid[top + 1], 1001)
    assert exact.disk == pytest.approx(control.disk_margins(loop.to_state_space(), fine)[0], rel=1e-8)
    # The gain and phase margins cannot be smaller than those that the disk guarantees.
    assert -20.0 * np.log10(low) <= exact.gain * (1.0 + 1e-6)
    assert np.degrees(2.0 * np.arctan(0.5 * exact.disk)) <= exact.phase * (1.0 + 1e-6)


def test_a_pole_may_cross_the_unit_circle_at_minus_one():
    """A double integrator with a PD and no delay has a phase above -180° up to half the sampling rate."""
    h, k_p, k_d = 0.02, 2.0, 2.0
    A, B, C = np.array([[1.0, h], [0.0, 1.0]]), np.array([[0.5 * h * h], [h]]), np.array([[k_p, k_d]])
    loop = SampledSystem(A, B, C, np.zeros((1, 1)), h, ("x", "v"), ("u",), ("y",))
    factor = 10.0 ** (margins(loop).gain / 20.0)
    assert is_stable(loop, 0.999 * factor)
    assert not is_stable(loop, 1.001 * factor)
    grid = frequencies(h)
    fast = fast_margins(loop.response(np.exp(1j * grid * h))[:, 0, 0], grid)
    assert fast.gain == pytest.approx(margins(loop).gain, abs=1e-6)


@pytest.mark.parametrize(("k_p", "k_d"), PD_GAINS)
def test_crossover_bandwidth_and_peaks_match_direct_evaluation(k_p, k_d):
    """L is evaluated by solving linear equations at each frequency, and SciPy finds its crossings and maxima."""
    loop, exact = loop_of(k_p, k_d), margins(loop_of(k_p, k_d))

    def L(frequency):
        z = np.exp(1j * frequency * PERIOD)
        return (loop.C @ np.linalg.solve(z * np.eye(len(loop.A)) - loop.A, loop.B)).item()

    def peak(size):
        grid = np.geomspace(0.3, np.pi / PERIOD, 300)
        top = int(np.argmax([size(L(frequency)) for frequency in grid]))
        ends = grid[top - 1], grid[min(top + 1, len(grid) - 1)]
        best = scipy.optimize.minimize_scalar(lambda w: -size(L(w)), bounds=ends, method="bounded")
        return -best.fun

    assert exact.crossover == pytest.approx(scipy.optimize.brentq(lambda w: abs(L(w)) - 1.0, 0.5, 50.0), rel=1e-8)
    bandwidth = scipy.optimize.brentq(lambda w: abs(L(w) / (1.0 + L(w))) - np.sqrt(0.5), exact.crossover, 100.0)
    assert exact.bandwidth == pytest.approx(bandwidth, rel=1e-8)
    assert exact.sensitivity == pytest.approx(peak(lambda L: abs(1.0 / (1.0 + L))), rel=1e-8)
    assert exact.disk == pytest.approx(1.0 / peak(lambda L: abs(1.0 / (1.0 + L) - 0.5)), rel=1e-8)


def second_order(frequency, damping):
    """Return a loop of a PD controller and a sampled double integrator, and one of its closed-loop poles.

    The closed-loop poles have the given frequency (rad/s) and damping ratio.
    """
    pole = np.exp((-damping + 1j * np.sqrt(1.0 - damping**2)) * frequency * PERIOD)
    trace, determinant = 2.0 * pole.real, abs(pole) ** 2
    A = np.array([[1.0, PERIOD], [0.0, 1.0]])
    B = np.array([[0.5 * PERIOD**2], [PERIOD]])
    # The trace of A - B C is 2 - k_p h² / 2 - k_d h, and its determinant is 1 + k_p h² / 2 - k_d h.
    k_p = (1.0 - trace + determinant) / PERIOD**2
    k_d = (3.0 - trace - determinant) / (2.0 * PERIOD)
    return SampledSystem(A, B, np.array([[k_p, k_d]]), np.zeros((1, 1)), PERIOD, ("x", "v"), ("u",), ("y",)), pole


@pytest.mark.parametrize("damping", [0.8, 0.3, 0.1])
@pytest.mark.parametrize("frequency", [3.0, 20.3, 111.0])
def test_peaks_of_a_second_order_loop_match_the_closed_form(frequency, damping):
    """The sensitivity S is (z - 1)² / (z² - t z + d), so |S|² is a quotient of quadratics in x = cos ω.

    The maximum of this quotient is at an end of [-1, 1] or at a root of its derivative. The same holds for |S - 1/2|².
    """
    loop, pole = second_order(frequency, damping)

    def squared(first, second, third):
        middle = first**2 + second**2 + third**2 - 2.0 * first * third
        return np.poly1d([4.0 * first * third, 2.0 * second * (first + third), middle])

    def peak(numerator, denominator):
        N = squared(*numerator)
        D = squared(*denominator)
        roots = (N.deriv() * D - N * D.deriv()).roots
        candidates = [-1.0, 1.0, *(root.real for root in roots if abs(root.imag) < 1e-9 and abs(root.real) < 1.0)]
        return max(np.sqrt(N(x) / D(x)) for x in candidates)

    integrators, closed = np.array([1.0, -2.0, 1.0]), np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
    exact = margins(loop)
    assert exact.sensitivity == pytest.approx(peak(integrators, closed), rel=1e-8)
    assert exact.disk == pytest.approx(1.0 / peak(integrators - 0.5 * closed, closed), rel=1e-8)


@pytest.mark.parametrize("damping", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("frequency", [3.0, 20.3, 111.0])
def test_a_peak_narrower_than_the_grid_spacing_is_found(frequency, damping):
    loop, pole = second_order(frequency, damping)

    def minus_sensitivity(turn):
        z = np.exp(1j * turn)
        return -(abs(z - 1.0) ** 2) / (abs(z - pole) * abs(z - pole.conj()))

    pole_angle, pole_damping = np.angle(pole), -np.log(abs(pole))
    best = scipy.optimize.minimize_scalar(
        minus_sensitivity,
        bounds=(pole_angle - pole_damping, pole_angle + pole_damping),
        options={"xatol": 1e-6 * pole_damping},
    )
    # Rounding moves the pole by about 1e-15, which changes the height of its peak.
    assert margins(loop).sensitivity == pytest.approx(-best.fun, rel=max(1e-8, 1e-14 / pole_damping))


@pytest.mark.slow
def test_the_loop_gain_of_an_unstable_plant_has_a_lower_limit():
    """The plant has a pole at 2 1/s. Closed loops confirm that the loop is unstable below the gain reduction margin."""
    pole, h = np.exp(2.0 * PERIOD), PERIOD
    loop = SampledSystem(*(np.array([[x]]) for x in (pole, 1.0, 0.2, 0.0)), h, ("x",), ("u",), ("y",))
    factor = 10.0 ** (-margins(loop).gain_reduction / 20.0)
    assert factor == pytest.approx((pole - 1.0) / 0.2, rel=1e-3)
    assert is_stable(loop, 1.001 * factor)
    assert not is_stable(loop, 0.999 * factor)
    assert margins(loop_of(5.0, 4.0)).gain_reduction == np.inf


@pytest.mark.slow
def test_fast_margins_agrees_with_margins_for_each_of_many_loops():
    grid = frequencies(PERIOD)
    loops = [loop_of(*gains) for gains in PD_GAINS]
    responses = np.array([loop.response(np.exp(1j * grid * PERIOD))[:, 0, 0] for loop in loops])
    fast = fast_margins(responses, grid)
    for i, loop in enumerate(loops):
        exact = margins(loop)
        assert fast.gain[i] == pytest.approx(exact.gain, abs=1e-3)
        assert fast.phase[i] == pytest.approx(exact.phase, abs=1e-3)
        assert fast.delay[i] == pytest.approx(exact.delay, rel=1e-4)


def test_a_loop_whose_gain_is_always_below_one_has_infinite_margins():
    weak = replace(loop_of(1.0, 1.0), A=0.5 * np.eye(5))
    infinite = margins(weak)
    assert (infinite.gain, infinite.phase, infinite.delay) == (np.inf, np.inf, np.inf)
    assert infinite.crossover == 0.0


def test_the_grid_ends_just_below_half_the_sampling_rate():
    for period in (0.02, 0.005):
        grid = frequencies(period)
        assert len(grid) == 2000
        assert grid[0] == pytest.approx(1e-4, rel=1e-12)
        assert 0.9998 < grid[-1] * period / np.pi < 0.99999
        np.testing.assert_allclose(grid[1:] / grid[:-1], grid[1] / grid[0])
    assert len(frequencies(0.02, points=17)) == 17


def first_order(pole, gain, direct=0.0):
    """Return the loop gain / (z - pole) + direct."""
    matrices = (np.array([[number]]) for number in (pole, 1.0, gain, direct))
    return SampledSystem(*matrices, PERIOD, ("x",), ("u",), ("y",))


@pytest.mark.parametrize("frequency", [0.997e-4, 1.003e-4, 1e-3, 2.0])
def test_the_bandwidth_of_an_integrator_agrees_with_its_closed_form_down_to_the_lowest_frequency(frequency):
    """|L / (1 + L)| = |k / (z - 1 + k)| falls below -3 dB where 4 (1 - k) sin²(ω h / 2) = k²."""
    k = frequency * PERIOD
    expected = 2.0 * np.arcsin(0.5 * k / np.sqrt(1.0 - k)) / PERIOD
    bandwidth = margins(first_order(1.0, k)).bandwidth
    assert bandwidth == (pytest.approx(expected, rel=1e-6) if expected > 1e-4 else 0.0)


@pytest.mark.slow
def test_a_loop_that_never_falls_below_minus_3_db_has_infinite_bandwidth():
    exact = margins(first_order(0.5, 0.0, direct=10.0))
    assert exact.bandwidth == np.inf
    assert exact.sensitivity == pytest.approx(1.0 / 11.0)


def test_a_pole_may_cross_the_unit_circle_at_one_or_minus_one():
    """1 + f L is zero at z = 1 or at z = -1, for factors f in closed form."""
    for gain in (0.1, -0.1):
        exact, loop = margins(first_order(0.5, gain)), first_order(0.5, gain)
        # L(1) = 2 gain, L(-1) = -gain / 1.5.
        limits = [-1.0 / limit for limit in (2.0 * gain, -gain / 1.5) if limit < 0.0]
        assert 10.0 ** (exact.gain / 20.0) == pytest.approx(min(limits), rel=1e-12)
        # |S| is largest at half the sampling rate or at zero frequency.
        assert exact.sensitivity == pytest.approx(max(1.5 / (1.5 - gain), 0.5 / (0.5 + gain)), rel=1e-8)
        assert is_stable(loop, 0.999 * min(limits))
        assert not is_stable(loop, 1.001 * min(limits))
        assert exact.gain_reduction == np.inf


def test_a_pole_near_one_is_not_an_integrator():
    """A pole at 1 + 1e-6 is unstable. A gain of 1e-6 or more stabilises it."""
    assert margins(first_order(1.0 + 1e-6, 1e-3)).gain_reduction == pytest.approx(60.0, abs=0.01)
    assert margins(first_order(1.0, 1e-3)).gain_reduction == np.inf


def test_fast_margins_returns_infinite_margins_for_loops_without_crossings():
    grid = frequencies(PERIOD)
    small_responses = np.full((2, len(grid)), [[0.1], [-0.1]], dtype=complex)
    fast = fast_margins(small_responses, grid)
    np.testing.assert_array_equal(fast.phase, [np.inf, np.inf])
    np.testing.assert_array_equal(fast.delay, [np.inf, np.inf])
    assert fast.gain[0] == np.inf
    assert fast.gain[1] == pytest.approx(20.0)
    zero = fast_margins(np.zeros((1, len(grid)), dtype=complex), grid)
    np.testing.assert_array_equal([zero.gain[0], zero.phase[0], zero.delay[0]], [np.inf] * 3)


@pytest.mark.parametrize("turns", np.linspace(0.02, 0.98, 10))
@pytest.mark.parametrize("steepness", [-7.0, 7.0])
def test_fast_margins_returns_exact_margins_if_the_logarithm_of_the_response_is_linear(turns, steepness):
    """L = (ω / ω_c)^(-1 + i steepness) e^(2πi turns) has magnitude one and the phase `turns` at ω_c."""
    crossover, grid = 3.0, np.geomspace(0.11, 50.0, 20)
    # The phase changes by two radians from one frequency to the next.
    assert 2.0 < abs(steepness) * np.log(grid[1] / grid[0]) < np.pi
    logs = np.log(grid / crossover)
    fast = fast_margins(np.exp((-1.0 + 1j * steepness) * logs + 2j * np.pi * turns)[None], grid)
    assert fast.phase[0] == pytest.approx(360.0 * abs(turns - 0.5))
    assert fast.delay[0] == pytest.approx(2.0 * np.pi * ((turns - 0.5) % 1.0) / crossover)
