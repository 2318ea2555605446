"""Tests of gusts."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from drake_quad.laboratory.wind.gust import Gust, GustParameters, gust_profile
from drake_quad.signals import Wind


def test_a_gust_has_the_given_shape():
    """The velocity, divided by its final value, is 0, then (1 - cos(π t / d)) / 2 while the gust rises, and then 1."""
    times = [1.0, 2.0, 2.75, 3.5, 4.25, 5.0, 50.0]
    expected = [0.0, 0.0, 0.5 - 0.5 * math.cos(math.pi / 4), 0.5, 0.5 + 0.5 * math.cos(math.pi / 4), 1.0, 1.0]
    fractions = [gust_profile(time, 2.0, 3.0, math.inf) for time in times]
    np.testing.assert_allclose(fractions, expected, atol=1e-15)


@pytest.mark.parametrize("hold_time", [0.0, 1.5])
def test_a_gust_that_ends_is_symmetric_in_time(hold_time):
    times = np.linspace(0.0, 10.0, 201)
    middle = 2.0 + 1.0 + 0.5 * hold_time
    fractions = [gust_profile(time, 2.0, 1.0, hold_time) for time in times]
    mirrored = [gust_profile(2.0 * middle - time, 2.0, 1.0, hold_time) for time in times]
    np.testing.assert_allclose(fractions, mirrored, atol=1e-12)
    assert max(fractions) == pytest.approx(1.0, abs=1e-12)
    assert fractions[-1] == 0.0


def test_each_vehicle_has_its_own_gust():
    gust = GustParameters(Wind(1.0, np.array([2.0, -4.0]), 0.0), np.array([1.0, 2.0]), 0.5)
    builder = DiagramBuilder()
    system = builder.AddNamedSystem("gust", Gust(num_vehicles=2, period=0.01, parameters=gust))
    log = LogVectorOutput(system.get_output_port(), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(3.0)
    log_data = log.FindLog(simulator.get_context())
    time, wind = log_data.sample_times(), log_data.data().reshape(3, 2, -1)
    np.testing.assert_array_equal(wind[1, :, time < 0.99], 0.0)
    # The wind logged at a tick belongs to the middle of the previous period.
    middle_tick = np.searchsorted(time, 1.2501)
    middle_fraction = 0.5 - 0.5 * math.cos(math.pi * (time[middle_tick] - 0.005 - 1.0) / 0.5)
    assert 0.4 < middle_fraction < 0.6
    np.testing.assert_allclose(
        wind[:, :, middle_tick], [[middle_fraction, 0.0], [2.0 * middle_fraction, 0.0], [0.0, 0.0]], atol=1e-12
    )
    np.testing.assert_allclose(wind[:, :, -1], [[1.0, 1.0], [2.0, -4.0], [0.0, 0.0]], atol=1e-12)


def test_a_gust_that_began_before_the_flight_has_full_strength_at_the_first_tick():
    system = Gust(period=0.01, parameters=GustParameters(Wind(1.0, 2.0, 3.0), -5.0, 1.0))
    simulator = Simulator(system)
    simulator.Initialize()
    np.testing.assert_allclose(system.get_output_port().Eval(simulator.get_context()), [1.0, 2.0, 3.0])
