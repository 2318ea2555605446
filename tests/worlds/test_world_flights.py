"""Tests of flights of several vehicles in one world."""

import numpy as np
import pytest

from drake_quad import InputError, World, load_scenario, simulate, simulate_world, simulate_worlds
from drake_quad.worlds.simulation import WorldSimulation
from drake_quad.worlds.world_diagram import draw_batches

CRAZYFLIE = ["vehicles/crazyflie", "controllers/crazyflie"]


def hover(*overrides):
    return load_scenario("laboratory:nominal", ["route={kind: hover, duration: 1.5}", *overrides], layers=CRAZYFLIE)


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("name", ["onboard", "robustness"])
def test_a_world_of_one_vehicle_has_the_flight_of_its_scenario(name, compiled):
    scenario = load_scenario(name, ["duration=1.0", "metrics={start: 0, end: null}"])
    alone = simulate(scenario, sample=3, compiled=compiled)
    flown = simulate_world(World({"only": scenario}, 0.1), sample=3, compiled=compiled).flights["only"]
    np.testing.assert_array_equal(flown["state"], alone["state"])
    assert flown.metrics == pytest.approx(alone.metrics, nan_ok=True)


@pytest.mark.slow
def test_compiled_and_uncompiled_worlds_are_equal_and_the_lower_vehicle_sinks():
    world = World.formation(hover(), {"upper": (0.0, 0.0, 0.5), "lower": (0.0, 0.0, 0.0)}, radius=0.1)
    compiled, uncompiled = (simulate_world(world, compiled=each) for each in (True, False))
    for name in world.vehicles:
        np.testing.assert_allclose(
            compiled.flights[name]["state"], uncompiled.flights[name]["state"], rtol=0.0, atol=1e-12
        )
    lower = compiled.flights["lower"]["state"][:, 2]
    # The force of 0.303 N exceeds the weight of 0.26 N.
    assert lower.min() < lower[0] - 0.3
    assert compiled.smallest_distance == pytest.approx(0.5, abs=0.02)
    calm = simulate_world(World.formation(hover(), world.offsets, radius=0.1, downwash=None))
    assert np.ptp(calm.flights["lower"]["state"][:, 2]) < 0.2


@pytest.mark.slow
def test_vehicles_share_the_wind_but_not_the_noise():
    gusty = hover("laboratory.wind=[{kind: dryden, level: light, height: 3.048}]")
    offsets = {"first": (0.0, 0.0, 0.0), "second": (3.0, 0.0, 0.0)}
    flights = simulate_world(World.formation(gusty, offsets, radius=0.1), sample=2).flights
    np.testing.assert_array_equal(flights["first"]["wind"], flights["second"]["wind"])
    noise = [each["measurement"][5:, :3] - each["state"][5:, :3] for each in flights.values()]
    assert abs(np.corrcoef(noise[0][:, 0], noise[1][:, 0])[0, 1]) < 0.5
    np.testing.assert_array_equal(flights["first"]["wind"], simulate(gusty, sample=2)["wind"])


@pytest.mark.slow
def test_vehicles_that_meet_collide_and_the_others_fly_on():
    routes = {
        "east": "[[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]",
        "west": "[[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]]",
        "aside": "[[-1.0, 2.0, 1.0], [1.0, 2.0, 1.0]]",
    }
    vehicles = {
        name: load_scenario("laboratory:nominal", [f"route={{kind: waypoints, waypoints: {points}}}"], layers=CRAZYFLIE)
        for name, points in routes.items()
    }
    flown = simulate_world(World(vehicles, 0.1))
    assert [(each.vehicle, each.other) for each in flown.collisions] == [("east", "west"), ("west", "east")]
    (time,) = {each.time for each in flown.collisions}
    assert flown.flights["east"].metrics.crash_time == time
    assert not flown.flights["aside"].metrics.crashed
    assert flown.flights["aside"]["state"][-1, 0] == pytest.approx(1.0, abs=0.1)
    # The spheres overlap for the first time at the tick of the collision.
    distances = [flown.flights[name]["clearance"][:, 0] for name in ("east", "west")]
    assert all(each[-1] < 0.0 <= each[-2] for each in distances)


@pytest.mark.slow
def test_samples_fly_side_by_side_as_alone_and_a_reset_repeats_them():
    world = World.formation(hover(), {"a": (0.0, 0.0, 0.0), "b": (0.2, 0.0, 0.6)}, radius=0.05)
    together = simulate_worlds(world, [4, 5])
    alone = simulate_world(world, sample=5)
    for name in world.vehicles:
        np.testing.assert_array_equal(together[1].flights[name]["state"], alone.flights[name]["state"])
    simulation = WorldSimulation(world, draw_batches(world, [4, 4]), record=False, compiled=True)
    simulation.fly()
    simulation.reset(draw_batches(world, [4, 5]))
    simulation.fly()
    for name in world.vehicles:
        expected = [each.flights[name].metrics.rmse for each in together]
        np.testing.assert_allclose(simulation.metrics(name).rmse, expected, rtol=1e-9)


def test_worlds_that_do_not_fit_together_are_refused():
    scenario = hover()
    for vehicles, radius, words in (
        ({}, 0.1, "a world needs at least one vehicle"),
        ({"a": scenario}, 0.0, "the radius of the vehicles is 0.0, but must be larger than 0"),
        ({"a b": scenario}, 0.1, "a vehicle cannot be called 'a b'"),
        ({"a": scenario, "b": load_scenario("hover")}, 0.1, "need the same laboratory.command_link.period"),
        ({"a": load_scenario("hover", ["vehicle.time_step=0"])}, 0.1, "vehicle.time_step of a is 0"),
        ({"a": load_scenario("neural_fly:still")}, 0.1, "has an autopilot of kind response"),
    ):
        with pytest.raises(InputError, match=words):
            World(vehicles, radius)
