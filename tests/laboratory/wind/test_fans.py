"""Tests that jets agree with the formulas of free round jets, and that vehicles fly in the wind of these jets."""

import math

import numpy as np
import pytest
import scipy
from noise_feed import feed_noise
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from drake_quad.laboratory.wind.fans import Direction, Fans, Jet, Outlet, jet_speed, local_air
from drake_quad.laboratory.wind.wind import build_wind
from drake_quad.randomness.noise import random_streams
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.signals import State

D = 0.75  # diameter of the outlet, m
Q = 2.5  # flow, m³/s
JET_DIRECTION = (0.0, 0.6, 0.8)  # unit vector in W
JET = Jet.of_fan(outlet=Outlet(1.0, 2.0, 3.0), direction=Direction(0.0, 3.0, 4.0), flow=Q, diameter=D, turbulence=0.22)


def state_at(along, across):
    """Return the state of a vehicle at the given distances from the outlet along the jet and across it, m."""
    return State(1.0 + across, 2.0 + 0.6 * along, 3.0 + 0.8 * along, *[0.0] * 9)


def speed(along, across=0.0):
    return jet_speed(state_at(along, across), JET)[0]


def integral_of_speed(along, power):
    """Return the integral of a power of the speed over the cross section of the jet."""
    jet_radius = 0.5 * D + 8.0 * 0.094 * along
    integrals = [
        scipy.integrate.quad(lambda r: 2.0 * math.pi * r * speed(along, r) ** power, a, b)[0]
        for a, b in ((0, D / 2), (D / 2, jet_radius))
    ]
    return sum(integrals)


def test_the_direction_of_a_fan_may_have_any_length():
    other_arguments = {"outlet": Outlet(1.0, 2.0, 3.0), "diameter": D, "turbulence": 0.22}
    for length in (0.1, 5.0):
        direction = Direction(*(length * part for part in JET_DIRECTION))
        jet = Jet.of_fan(direction=direction, flow=np.array([Q, 2.0 * Q]), **other_arguments)
        np.testing.assert_allclose(jet.direction, JET_DIRECTION, rtol=1e-15)
        np.testing.assert_allclose(jet.exit_speed, np.array([4.0, 8.0]) * Q / (math.pi * D**2))
        assert (jet.outlet, jet.diameter, jet.turbulence) == (Outlet(1.0, 2.0, 3.0), D, 0.22)


def test_the_exit_speed_follows_from_flow_and_diameter():
    assert JET.exit_speed == pytest.approx(5.66, abs=0.005)
    assert integral_of_speed(1e-6, 1) == pytest.approx(Q, rel=1e-4)
    np.testing.assert_allclose(JET.direction, JET_DIRECTION)


@pytest.mark.parametrize("diameters", [6.0, 10.0, 25.0])
def test_the_jet_has_the_published_speed_and_half_width_far_from_the_fan(diameters):
    along = diameters * D
    assert speed(along) == pytest.approx(5.9 * JET.exit_speed * D / along, rel=1e-12)
    assert speed(along, 0.094 * along) == pytest.approx(0.5 * speed(along), rel=1e-12)
    # A Gaussian profile has a sixteenth of the centreline speed at twice the half-width.
    assert speed(along, 0.188 * along) == pytest.approx(speed(along) / 16.0, rel=1e-12)


def test_the_momentum_flux_is_constant_far_away_and_close_to_the_exit_value_in_the_core():
    exit_flux = JET.exit_speed**2 * math.pi * D**2 / 4.0
    far_fluxes = [integral_of_speed(diameters * D, 2) for diameters in (6.0, 9.0, 15.0, 30.0)]
    np.testing.assert_allclose(far_fluxes, far_fluxes[0], rtol=1e-9)
    assert far_fluxes[0] / exit_flux == pytest.approx(0.89, abs=0.01)
    near_shares = [integral_of_speed(diameters * D, 2) / exit_flux for diameters in (0.1, 1.0, 2.0, 3.0, 4.0, 5.0)]
    assert min(near_shares) > 0.86
    assert max(near_shares) < 1.01


def test_the_core_of_a_jet_has_the_exit_speed_and_joins_the_far_jet_smoothly():
    for diameters in (0.5, 3.0, 5.8):
        assert speed(diameters * D) == JET.exit_speed
    for across in (0.1, 0.3, 0.6):
        assert speed(5.9 * D - 1e-9, across) == pytest.approx(speed(5.9 * D + 1e-9, across), rel=1e-6)
    assert speed(-0.01) == 0.0
    assert speed(0.5 * D, 0.51 * D + 0.3 * D) < 1e-6 * JET.exit_speed


@pytest.mark.parametrize("along", [0.0, -0.01, -3.0])
def test_the_air_upstream_of_the_outlet_is_at_rest(along):
    for across in (0.0, 0.3, 2.0):
        mean, variance, rate = local_air(state_at(along, across), (JET,))
        assert (*mean, variance, rate) == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_turbulence_variances_and_decay_rates_of_several_jets_add_up():
    state = state_at(4.0, 0.3)
    other = JET._replace(outlet=Outlet(1.0, 1.0, 2.0), turbulence=0.4)
    (speed_1, width_1), (speed_2, width_2) = jet_speed(state, JET), jet_speed(state, other)
    _, variance, rate = local_air(state, (JET, other))
    assert min(speed_1, speed_2) > 1.0
    assert variance == pytest.approx((0.22 * speed_1) ** 2 + (0.4 * speed_2) ** 2)
    assert rate == pytest.approx(speed_1 / width_1 + speed_2 / width_2)


def wind_at(state, *jets, n, duration, seed=0):
    """Return (3, n, ticks) winds of n vehicles at rest."""
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("state", ConstantVectorSource(np.repeat(state, n)))
    fans = builder.AddNamedSystem("fans", Fans(num_vehicles=n, period=0.01, parameters=jets))
    builder.Connect(source.get_output_port(), fans.GetInputPort("state"))
    feed_noise(builder, fans, StreamKind.WIND, Samples(seed, range(n)))
    log = LogVectorOutput(fans.get_output_port(), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    return log.FindLog(simulator.get_context()).data().reshape(3, n, -1)


def test_the_wind_has_the_mean_and_turbulence_at_the_position_of_the_vehicle():
    state = state_at(5.0, 0.2)
    wind = wind_at(state, JET, n=2000, duration=3.0)
    mean, _ = jet_speed(state, JET)
    np.testing.assert_allclose(wind.mean(axis=(1, 2)), mean * np.array(JET_DIRECTION), atol=0.02 * mean)
    np.testing.assert_allclose(wind.std(axis=(1, 2)), 0.22 * mean, rtol=0.03)
    np.testing.assert_allclose(wind[:, :, 0].std(axis=1), 0.22 * mean, rtol=0.06)


def test_the_correlation_time_of_turbulence_is_the_half_width_divided_by_the_speed():
    state = state_at(5.0, 0.0)
    mean, half_width = jet_speed(state, JET)
    wind = wind_at(state, JET, n=3000, duration=1.0)[0]
    for ticks in (5, 20):
        correlation = np.corrcoef(wind[:, 40], wind[:, 40 + ticks])[0, 1]
        assert correlation == pytest.approx(math.exp(-0.01 * ticks * mean / half_width), abs=0.06)


def test_the_winds_of_several_jets_add_up():
    other_jet = JET._replace(direction=Direction(1.0, 0.0, 0.0), outlet=Outlet(-2.0, 5.0, 7.0), turbulence=0.0)
    jet_without_turbulence = JET._replace(turbulence=0.0)
    state = state_at(5.0, 0.0)
    wind = wind_at(state, jet_without_turbulence, other_jet, n=1, duration=0.1)
    along_x = jet_speed(state, other_jet)[0]
    assert along_x > 1.0
    expected = jet_speed(state, jet_without_turbulence)[0] * np.array(JET_DIRECTION) + [along_x, 0.0, 0.0]
    np.testing.assert_allclose(wind[:, 0, -1], expected, rtol=1e-12)


def test_sources_that_depend_on_position_add_up():
    """Two sources with one jet each, without turbulence, agree with one source of both jets."""
    jets = JET._replace(turbulence=0.0), JET._replace(turbulence=0.0, direction=Direction(0.0, 0.8, 0.6))
    separate_sources, common_source = (
        {f"fan_{i}": Fans(parameters=(jet,)) for i, jet in enumerate(jets)},
        {"fans": Fans(parameters=jets)},
    )
    winds = []
    for sources in (separate_sources, common_source):
        wind = build_wind(sources, streams=random_streams(sources, StreamKind.WIND))
        simulator = Simulator(wind)
        context = simulator.get_mutable_context()
        wind.GetInputPort("state").FixValue(context, state_at(2.0, 0.1))
        for name in sources:
            wind.GetInputPort(f"{name}.jet_noise").FixValue(context, [1.0, -2.0, 3.0])
        simulator.Initialize()
        winds.append(wind.GetOutputPort("wind").Eval(simulator.get_context()))
    assert np.linalg.norm(winds[0]) > 1.0
    np.testing.assert_allclose(winds[0], winds[1], rtol=1e-12, atol=1e-15)
