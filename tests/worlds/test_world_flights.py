"""Tests of flights of several vehicles in one world."""

import math

import numpy as np
import pytest

from drake_quad import InputError, World, load_scenario, simulate, simulate_world, simulate_worlds
from drake_quad.signals import Crashed, State
from drake_quad.worlds.proximity import Radii, clearance
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
        ({"a": scenario}, 0.0, "the radius of the vehicles is 0.0, but must be a number larger than 0"),
        ({"a": scenario}, math.inf, "the radius of the vehicles is inf, but must be a number"),
        ({"a": scenario}, "0.1", "the radius of the vehicles is 0.1, but must be a number"),
        ({"a b": scenario}, 0.1, "a vehicle cannot be called 'a b'"),
        ({1: scenario}, 0.1, "a vehicle cannot be called 1"),
        ({"proximity": scenario}, 0.1, "a vehicle cannot be called proximity, which is a part of every world"),
        ({"a": scenario, "b": hover("seed=3")}, 0.1, "need the same seed, which determines their wind"),
        ({"a": scenario, "b": load_scenario("hover")}, 0.1, "need the same laboratory.command_link.period"),
        ({"a": load_scenario("hover", ["vehicle.time_step=0"])}, 0.1, "vehicle.time_step of a is 0"),
        ({"a": load_scenario("neural_fly:still")}, 0.1, "has an autopilot of kind response"),
    ):
        with pytest.raises(InputError, match=words):
            World(vehicles, radius)


def test_offsets_that_are_no_points_of_a_vehicle_are_refused():
    scenario = hover()
    for offset in ((1.0,), 1.0, (0.0, 0.0, math.nan), (0.0, 0.0, math.inf), "abc", None, ("0", "0", "0")):
        with pytest.raises(InputError, match="^the offset of a is .*, but must consist of three finite numbers$"):
            World.formation(scenario, {"a": offset}, radius=0.1)
    with pytest.raises(InputError, match="^offsets contains zz, but the vehicles are a$"):
        World({"a": scenario}, 0.1, offsets={"zz": (0.0, 0.0, 1.0)})


def test_vehicles_that_start_in_each_other_or_in_an_obstacle_are_refused():
    scenario = hover()
    close = World.formation(scenario, {"a": (0.0, 0.0, 0.0), "b": (0.19, 0.0, 0.0)}, radius=0.1)
    with pytest.raises(InputError, match=r"a and b start at a distance of 0.19 m, but the spheres .* radius of 0.1 m"):
        simulate_world(close)
    box = "{kind: box, centre: [1.0, 0.0, 1.0], size: [0.4, 0.4, 0.4]}"
    blocked = hover(f"space={{obstacles: {{pillar: {box}}}}}")
    world = World.formation(blocked, {"a": (0.0, 0.0, 0.0), "b": (1.0, 0.0, 0.0)}, radius=0.1)
    with pytest.raises(InputError, match="^b: the route is 0 m from pillar"):
        simulate_world(world)


def test_worlds_need_a_sample():
    with pytest.raises(InputError, match="samples is empty"):
        simulate_worlds(World({"a": hover()}, 0.1), [])


@pytest.mark.slow
def test_random_wind_has_the_same_parameters_for_all_vehicles():
    scenario = load_scenario("robustness", ["duration=1.0", "metrics={start: 0, end: null}"])
    offsets = {"a": (0.0, 0.0, 0.0), "b": (0.0, 0.0, 2.0)}
    flights = simulate_world(World.formation(scenario, offsets, radius=0.1), sample=3).flights
    drawn = [flights[name].scenario for name in ("a", "b")]
    assert drawn[0].laboratory.wind == drawn[1].laboratory.wind
    assert drawn[0].vehicle.mass != drawn[1].vehicle.mass


def test_a_vehicle_whose_state_is_nan_does_not_affect_the_others():
    states = [State(x, *[0.0] * 11) for x in (0.0, math.nan, 1.0)]
    assert clearance(0, Radii((0.1,) * 3), *states, *[Crashed(0.0)] * 3).distance == pytest.approx(0.8)
