"""Tests of the disturbances of a vehicle along its plan, for cases with closed forms."""

import numpy as np
import pytest
import scipy

from drake_quad import simulate
from drake_quad.flight.mission import plan_route
from drake_quad.linear.disturbances import disturbance_statistics, disturbances_along
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.batch import Batch

HOVER_ROUTE = "route={kind: hover, position: [0, 0, 1], duration: 0.4}"
UNDISTURBED_OVERRIDES = (
    *("laboratory.wind=[]", "vehicle.quadratic_drag=0", "vehicle.thrust_factor_error=[0, 0, 0, 0]"),
    *("vehicle.centre_of_mass=[0, 0]", "vehicle.mass=0.7", "vehicle.gravity=9.79", "vehicle.thrust_factor=4.0e-5"),
    *("vehicle.arm_length=0.16", "metrics={start: 0, end: null}"),
)


def disturbances_of(scenario, samples=(0,)):
    return disturbances_along(Batch.draw(scenario, samples), plan_route(scenario))


def test_wind_accelerates_a_hovering_vehicle_by_drag_over_mass(asymmetric):
    steady = "laboratory.wind=[{kind: steady, velocity: [2.0, -1.5, 0.5]}]"
    disturbances = disturbances_of(asymmetric("pid", *UNDISTURBED_OVERRIDES, HOVER_ROUTE, steady))
    expected = 0.12 / 0.7 * np.array([2.0, -1.5, 0.5])
    np.testing.assert_allclose(disturbances.acceleration[:, :, 0], np.repeat(expected[:, None], 20, axis=1), atol=1e-9)
    np.testing.assert_allclose(disturbances.angular_acceleration, 0.0, atol=1e-9)


def test_drag_decelerates_a_vehicle_along_its_path(asymmetric):
    scenario = asymmetric("pid", *UNDISTURBED_OVERRIDES)
    plan = plan_route(scenario)
    disturbances = disturbances_of(scenario)
    times = disturbances.step * np.arange(disturbances.acceleration.shape[1])
    velocity = plan.derivative(1).vector_values(times)
    np.testing.assert_allclose(disturbances.acceleration[:, :, 0], -0.12 / 0.7 * velocity, atol=1e-9)


def test_planned_torques_turn_a_vehicle_with_another_inertia_by_euler_s_equations(asymmetric):
    """The plan requires the torque I ω̇ + ω × I ω, with the nominal inertia I and the planned body rates ω."""
    nominal, actual = np.array([0.0065, 0.0085, 0.0126]), np.array([0.0071, 0.0079, 0.0131])
    scenario = asymmetric("pid", *UNDISTURBED_OVERRIDES, "vehicle.rotor_inertia=0", "nominal.rotor_inertia=0")
    plan = plan_route(scenario)
    step, _, angular_acceleration = disturbances_of(scenario)
    times, h = step * np.arange(1, angular_acceleration.shape[1] - 1), 1e-4
    before, rates, after = (
        np.transpose(plan_demand(plan, nominal_parameters(scenario), times + shift).body_rates)
        for shift in (-h, 0.0, h)
    )
    slopes = (after - before) / (2.0 * h)
    torques = nominal * slopes + np.cross(rates, nominal * rates)
    expected = (torques - np.cross(rates, actual * rates)) / actual - slopes
    assert np.abs(expected[:, :2]).max(axis=0).min() > 0.01
    np.testing.assert_allclose(angular_acceleration[:, 1:-1, 0], expected[:, :2].T, atol=1e-7)


def test_each_vehicle_turns_according_to_the_centre_of_mass_of_its_sample(asymmetric):
    offset = "vehicle.centre_of_mass=[{uniform: {min: -0.002, max: 0.002}}, 0.001]"
    scenario = asymmetric("pid", *(each for each in UNDISTURBED_OVERRIDES if "centre" not in each), HOVER_ROUTE, offset)
    batch = Batch.draw(scenario, range(4))
    disturbances = disturbances_along(batch, plan_route(scenario))
    lever = batch.varying["vehicle.centre_of_mass.0"]
    # The angular acceleration is weight times lever divided by the moment of inertia.
    np.testing.assert_allclose(disturbances.angular_acceleration[1, 0], 0.7 * 9.79 * lever / 0.0079, rtol=1e-6)
    np.testing.assert_allclose(disturbances.angular_acceleration[0, 0], -0.7 * 9.79 * 0.001 / 0.0071, rtol=1e-6)
    assert len({*lever}) == 4


def test_a_fan_acts_in_its_jet_and_each_sample_has_its_own_turbulence(asymmetric):
    fan = (
        "laboratory.wind=[{kind: fan, position: [-2, 0, 1], direction: [1, 0, 0], flow: 2, diameter: 0.8,"
        " turbulence: 0.2}]"
    )
    disturbances = disturbances_of(asymmetric("pid", *UNDISTURBED_OVERRIDES, HOVER_ROUTE, fan), samples=(0, 1))
    x, y, _ = disturbances.acceleration
    assert (x.mean(axis=0) > 0.1).all()
    assert np.abs(y.mean()) < 0.2 * x.mean()
    assert x[-1, 0] != x[-1, 1]


def test_drag_at_a_centre_of_pressure_turns_a_hovering_vehicle_in_wind(asymmetric):
    """The angular acceleration is r × F divided by the inertia. Hover in still air needs no torque."""
    drag = "vehicle.body_drag={linear: [0.1, 0.2, 0.3], centre_of_pressure: [0.02, 0.03, 0.04]}"
    steady = "laboratory.wind=[{kind: steady, velocity: [2.0, -1.5, 0.5]}]"
    disturbances = disturbances_of(
        asymmetric("pid", *UNDISTURBED_OVERRIDES, HOVER_ROUTE, steady, drag, "vehicle.linear_drag=0")
    )
    torque = np.cross([0.02, 0.03, 0.04], [0.1 * 2.0, 0.2 * -1.5, 0.3 * 0.5])
    expected = torque[:2] / [0.0071, 0.0079]
    np.testing.assert_allclose(
        disturbances.angular_acceleration[:, :, 0], np.repeat(expected[:, None], 20, axis=1), atol=1e-9
    )


@pytest.mark.slow
def test_sampled_turbulence_equals_that_in_flights_of_the_same_samples(asymmetric):
    """The flight records the same turbulence one step later."""
    turbulence = "laboratory.wind=[{kind: dryden, level: light, height: 4.0, heading: 0.7}]"
    steps = ("vehicle.time_step=0.02", "laboratory.motion_capture.period=0.02")
    scenario = asymmetric("pid", *UNDISTURBED_OVERRIDES, HOVER_ROUTE, turbulence, *steps)
    disturbances = disturbances_of(scenario, samples=(0, 3))
    assert disturbances.step == 0.02
    for vehicle, sample in enumerate((0, 3)):
        wind = simulate(scenario, sample=sample)["wind"].T
        np.testing.assert_allclose(disturbances.acceleration[:, 0, vehicle], 0.12 / 0.7 * wind[:, 0])
        np.testing.assert_allclose(disturbances.acceleration[:, 1:-1, vehicle], 0.12 / 0.7 * wind[:, 2:20], atol=1e-12)


def test_white_noise_gets_a_time_constant_whose_autocorrelation_halves_in_one_step():
    """The autocorrelation (1 + x) exp(-x) is 1/2 if x is the step divided by the time constant."""
    lag = scipy.optimize.brentq(lambda x: (1.0 + x) * np.exp(-x) - 0.5, 0.0, 5.0)
    white = np.random.default_rng(3).normal(size=(1, 4000, 2))
    assert disturbance_statistics(white, 0.02).time == pytest.approx(0.02 / lag, rel=1e-5)


def test_statistics_separate_the_constant_part_from_fluctuations():
    """The samples are second-order noise in four flights, two with a mean of 0.5 and two with -0.5."""
    rng, step, time, deviation = np.random.default_rng(2), 0.02, 0.4, 0.7
    poles = np.exp(-step / time)
    values, inner, outer = [], np.zeros(4), np.zeros(4)
    for _ in range(40000):
        inner = poles * inner + rng.normal(size=4)
        outer = poles * outer + inner
        values.append(outer)
    noise = np.array(values)
    noise *= deviation / noise.std()
    statistics = disturbance_statistics(
        (noise - noise.mean(axis=0) + np.array([0.5, -0.5, 0.5, -0.5]))[np.newaxis], step
    )
    assert statistics.mean == pytest.approx(0.5)
    assert statistics.deviation == pytest.approx(0.7, rel=0.01)
    assert statistics.time == pytest.approx(0.4, rel=0.06)
