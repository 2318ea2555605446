"""Tests of the integral of a PID, by comparison with sums."""

import itertools

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad.control.integral import IntegralCorrection, IntegralGains, integrate_correction
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, PositionError

H = 0.02  # s, control tick
K_I = np.array([0.3, 0.5, 2.0])  # 1/s³


def corrections_for(errors, limit, num_vehicles=1, k_i=tuple(K_I), integration="forward_euler"):
    """Return the corrections (ticks + 1, 3, N) for errors (ticks, 3, N), one for each tick."""
    parameters = IntegralGains(PerAxis(*k_i), limit)
    system = IntegralCorrection(num_vehicles=num_vehicles, period=H, integration=integration, parameters=parameters)
    simulator = Simulator(system)
    context, corrections = simulator.get_mutable_context(), []
    for tick, error in enumerate(errors):
        # The simulator updates the integral of a tick when it advances to the next tick. The input port must still
        # contain the error of the earlier tick then.
        if tick:
            simulator.AdvanceTo(tick * H)
        corrections.append(system.get_output_port().Eval(context))
        system.get_input_port().FixValue(context, np.ravel(error))
    simulator.AdvancePendingEvents()
    corrections.append(system.get_output_port().Eval(context))
    return np.array(corrections).reshape(-1, 3, num_vehicles)


def test_a_tick_adds_error_times_gain_times_period_up_to_the_limit():
    """The expected corrections are 1 - 0.02 · 2 · 10 on X, -1 + 0.02 · 3 · 5 on Y, and the limit on Z."""
    gains = IntegralGains(PerAxis(2.0, 3.0, 4.0), 1.5)
    after = integrate_correction(Acceleration(1.0, -1.0, 1.4), PositionError(10.0, -5.0, -2.0), gains, H)
    assert after == pytest.approx(Acceleration(0.6, -0.7, 1.5))
    opposite = integrate_correction(Acceleration(-1.0, 1.0, -1.4), PositionError(-10.0, 5.0, 2.0), gains, H)
    assert opposite == pytest.approx(Acceleration(-0.6, 0.7, -1.5))


def test_the_correction_is_minus_the_integral_of_the_errors():
    """The correction is subtracted from the command, so the command increases with the error on every axis."""
    errors = np.random.default_rng(0).normal(size=(50, 3, 1))
    corrections = corrections_for(errors, limit=1e9)
    sums = np.cumsum(errors, axis=0) * H * K_I[:, None]
    np.testing.assert_array_equal(corrections[0], 0.0)
    np.testing.assert_allclose(corrections[1:], -sums, atol=1e-14)


def test_backward_euler_includes_the_error_of_the_current_tick():
    """The limit of the correction and the stored integral are the same as with forward Euler."""
    limit = 0.05
    errors = np.random.default_rng(2).normal(size=(30, 3))
    parameters = IntegralGains(PerAxis(*K_I), limit)
    system = IntegralCorrection(period=H, integration="backward_euler", parameters=parameters)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    integral = np.zeros(3)
    num_limited = 0
    for tick, error in enumerate(errors):
        if tick:
            simulator.AdvanceTo(tick * H)
        system.get_input_port().FixValue(context, error)
        integral = np.clip(integral + H * K_I * error, -limit, limit)
        num_limited += np.abs(integral).max() == limit
        np.testing.assert_allclose(system.get_output_port().Eval(context), -integral, atol=1e-15)
    assert 0 < num_limited < len(errors)


@pytest.mark.parametrize("signs", [*itertools.product((1.0, -1.0), repeat=3)])
def test_the_integral_saturates_on_every_axis_and_does_not_wind_up(signs):
    error, limit = 40.0 * np.reshape(signs, (1, 3, 1)), 0.7
    saturating = np.repeat(error, 30, axis=0)
    corrections = corrections_for(np.concatenate([saturating, -saturating[:2]]), limit)
    np.testing.assert_array_equal(corrections[30, :, 0], -limit * np.array(signs))
    # No error is stored beyond the limit, so the opposite error moves the integral away from it in one tick.
    np.testing.assert_allclose(
        corrections[31, :, 0], np.array(signs) * np.minimum(40.0 * H * K_I - limit, limit), atol=1e-12
    )


def test_each_vehicle_of_a_fleet_has_its_own_integral():
    rng = np.random.default_rng(1)
    errors, limits, gains = rng.normal(size=(40, 3, 3)), np.array([0.05, 0.2, 5.0]), rng.uniform(0.1, 2.0, (3, 3))
    fleet = corrections_for(errors, limits, num_vehicles=3, k_i=tuple(gains))
    for i in range(3):
        alone = corrections_for(errors[:, :, i : i + 1], limits[i], k_i=tuple(gains[:, i]))
        np.testing.assert_array_equal(fleet[:, :, i], alone[:, :, 0])
