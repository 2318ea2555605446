"""Tests of the margins of periodic loops, by comparison with time-invariant loops, poles and responses."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import closed_loop, loop_with_injection
from drake_quad.linear.link_margins import fast_link_margins, joint_disk_margin, link_margins
from drake_quad.linear.margins import margins as margins_of
from drake_quad.linear.periodic_margins import periodic_margins
from drake_quad.linear.sampled_system import SampledSystem, lifted
from drake_quad.scenario.batch import median_scenario

pytestmark = pytest.mark.slow


def offset_loop(scenario, row):
    """Return the closed loop from an offset on a signal of the command link to this signal."""
    closed = loop_with_injection(scenario).system
    inputs, outputs = (
        [name for name in names if name.partition("@")[0] == f"{port}.{row}"]
        for names, port in ((closed.inputs, "injection"), (closed.outputs, "injected"))
    )
    return closed.between(inputs, outputs).connected()


def loop_with_slow_camera(delay_ticks=1):
    """Return a scenario with a camera frame at every second tick."""
    delay = f"laboratory.command_link.delay_ticks={delay_ticks}"
    return load_scenario("laboratory:nominal", ["laboratory.motion_capture.period=0.04", delay])


@pytest.fixture(scope="module")
def slow_camera():
    return loop_with_slow_camera()


def poles_with_gain(closed, factor):
    """Return the closed-loop poles after the signal at which the loop is broken is multiplied by a factor."""
    gain = (factor - 1.0) / factor
    feedback = gain * np.linalg.inv(np.eye(len(closed.inputs)) - gain * closed.D)
    return np.linalg.eigvals(closed.A + closed.B @ feedback @ closed.C)


@pytest.mark.parametrize(
    ("name", "signal", "row"),
    [
        ("hover", "tau_x", 1),
        pytest.param("laboratory:nominal", "tau_x", 1, marks=pytest.mark.long),
        ("onboard", "roll", 1),
    ],
)
@pytest.mark.parametrize("num_ticks", [1, 3])
def test_a_time_invariant_loop_has_the_same_margins_as_a_periodic_loop(name, signal, row, num_ticks):
    scenario = load_scenario(name)
    loop = offset_loop(scenario, row)
    result = periodic_margins(lifted([loop] * num_ticks))
    expected = link_margins(scenario)[signal]
    np.testing.assert_allclose(result[:-1], expected[:-1], rtol=1e-5)
    assert result.bandwidth == pytest.approx(expected.bandwidth, rel=1e-3)


def sampled_loop(numerator, denominator):
    """Return L and its closed loop from an offset to the signal, for a strictly proper transfer function of z."""
    A, B, C, D = scipy.signal.tf2ss(numerator, denominator)
    opened = SampledSystem(A, B, C, D, 0.1, ("x",) * len(A), ("injection.0",), ("injected.0",))
    return opened, replace(opened, A=A - B @ C, C=-C, D=np.ones((1, 1)))


@pytest.mark.parametrize("num_ticks", [1, 2, 4, 5])
@pytest.mark.parametrize(
    "loop", [([0.9], [1.0, -0.5]), ([0.5, 0.2], [1.0, -1.0, 0.0]), ([1.2, -0.9], [1.0, -1.6, 0.6])]
)
def test_a_loop_that_is_faster_than_its_common_period_has_the_margins_of_its_transfer_function(loop, num_ticks):
    opened, closed = sampled_loop(*loop)
    np.testing.assert_allclose(periodic_margins(lifted([closed] * num_ticks))[:-1], margins_of(opened)[:-1], rtol=2e-5)


def test_a_loop_of_small_gain_tolerates_any_phase_and_delay():
    margins = periodic_margins(lifted([sampled_loop([0.2], [1.0, 0.0])[1]] * 2))
    assert margins.gain == pytest.approx(20.0 * math.log10(5.0), rel=1e-5)
    assert (margins.phase, margins.delay, margins.gain_reduction) == (math.inf, math.inf, math.inf)
    assert margins.crossover == 0.0


def test_lifting_keeps_the_response_of_a_periodic_system():
    rng = np.random.default_rng(0)
    systems = [
        SampledSystem(
            *(rng.normal(size=shape) for shape in ((3, 3), (3, 2), (1, 3), (1, 2))), 0.1, ("x",) * 3, ("a", "b"), ("y",)
        )
        for _ in range(4)
    ]
    u, x = rng.normal(size=(4, 2)), rng.normal(size=3)
    lifted_system, start, outputs = lifted(systems), x, []
    for system, inputs in zip(systems, u, strict=True):
        outputs.append(system.C @ x + system.D @ inputs)
        x = system.A @ x + system.B @ inputs
    np.testing.assert_allclose(lifted_system.A @ start + lifted_system.B @ u.ravel(), x)
    np.testing.assert_allclose(lifted_system.C @ start + lifted_system.D @ u.ravel(), np.ravel(outputs))
    assert lifted_system.inputs == ("a@0", "b@0", "a@1", "b@1", "a@2", "b@2", "a@3", "b@3")
    assert (lifted_system.period, lifted_system.outputs) == (pytest.approx(0.4), ("y@0", "y@1", "y@2", "y@3"))


def test_a_factor_beyond_the_gain_margins_of_a_periodic_loop_makes_it_unstable(slow_camera):
    closed = offset_loop(slow_camera, 1)
    margins = periodic_margins(closed)
    for decibel in (margins.gain, -margins.gain_reduction):
        size = [np.abs(poles_with_gain(closed, 10.0 ** (share * decibel / 20.0))).max() for share in (0.999, 1.001)]
        assert size[0] < 1.0 < size[1]


def test_a_phase_beyond_the_phase_margin_of_a_periodic_loop_makes_it_unstable(slow_camera):
    closed = offset_loop(slow_camera, 1)
    phase = math.radians(periodic_margins(closed).phase)
    size = [np.abs(poles_with_gain(closed, np.exp(-1j * share * phase))).max() for share in (0.999, 1.001)]
    assert size[0] < 1.0 < size[1]


def test_a_tick_of_delay_reduces_the_delay_margins_of_a_periodic_loop_by_a_tick(slow_camera):
    tick = slow_camera.laboratory.command_link.period
    first, second = (link_margins(each) for each in (slow_camera, loop_with_slow_camera(2)))
    for signal in ("thrust", "tau_x", "tau_z"):
        assert second[signal].delay == pytest.approx(first[signal].delay - tick, rel=1e-5)
    # The loop is stable with the largest number of additional ticks within the delay margin, but not with one more.
    ticks = math.floor(min(margins.delay for margins in first.values()) / tick)
    sizes = [
        np.abs(closed_loop(loop_with_slow_camera(1 + ticks + extra_ticks)).system.poles()).max()
        for extra_ticks in (0, 1)
    ]
    assert sizes[0] < 1.0 < sizes[1]


@pytest.mark.long
def test_the_sensitivity_peak_and_the_disk_margin_are_gains_of_the_periodic_loop(slow_camera):
    """The gain over a finite time approaches the gain over an infinite time from below."""
    closed = offset_loop(slow_camera, 1)
    margins, N, periods = periodic_margins(closed), len(closed.inputs), 400
    matrix, x = np.zeros((N * periods, N)), closed.B
    matrix[:N] = closed.D
    for first in range(N, N * periods, N):
        matrix[first : first + N], x = closed.C @ x, closed.A @ x
    response = np.hstack([np.vstack([np.zeros((N * i, N)), matrix[: N * (periods - i)]]) for i in range(periods)])
    for shift, expected in ((0.0, margins.sensitivity), (0.5, 1.0 / margins.disk)):
        gain = np.linalg.norm(response - shift * np.eye(len(response)), 2)
        assert 0.99 * expected < gain < 1.00001 * expected


@pytest.mark.parametrize("num_ticks", [1, 3])
@pytest.mark.parametrize(("gain", "direct", "expected"), [(0.25, 0.0, 0.0), (0.0, 10.0, math.inf)])
def test_the_bandwidth_is_zero_or_infinite_if_the_response_never_crosses_minus_3_db(num_ticks, gain, direct, expected):
    """The loop is gain / (z - 0.5) + direct. |T| is at most 1/3 in the first case and always 10/11 in the second."""
    opened = SampledSystem(*np.reshape([0.5, 1.0, gain, direct], (4, 1, 1)), 0.1, ("x",), ("u",), ("y",))
    feedback = opened.C / (1.0 + opened.D)
    closed = replace(
        opened,
        A=opened.A - opened.B @ feedback,
        B=opened.B / (1.0 + opened.D),
        C=-feedback,
        D=1.0 / (1.0 + opened.D),
        inputs=("injection.0",),
        outputs=("injected.0",),
    )
    assert periodic_margins(lifted([closed] * num_ticks)).bandwidth == expected
    assert margins_of(opened).bandwidth == expected


def test_margins_of_all_signals_of_a_periodic_loop_agree(slow_camera):
    expected, fast = [*link_margins(slow_camera).values()], fast_link_margins(slow_camera)
    np.testing.assert_allclose(fast.sensitivity, [each.sensitivity for each in expected], rtol=1e-3)
    np.testing.assert_allclose(fast.delay, [each.delay for each in expected], rtol=1e-3)
    assert joint_disk_margin(slow_camera).disk == pytest.approx(min(each.disk for each in expected), rel=5e-3)


@pytest.mark.long
@pytest.mark.parametrize("name", ["warehouse_uwb", "outdoor_gnss"])
def test_unobservable_states_do_not_make_the_loops_of_an_estimator_unstable(name):
    """The yaw and the bias of its gyroscope are unobservable without a magnetometer, and the loop has a pole at 1."""
    margins = link_margins(median_scenario(load_scenario(name)))
    assert margins["yaw"] is None
    assert all(each.disk > 0.5 for each in margins.values() if each is not None)
