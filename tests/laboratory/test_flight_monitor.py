"""Tests of the flight monitor: metrics, crashes and collisions."""

import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.laboratory.flight_monitor import (
    CollidedSolid,
    CrashLimits,
    FlightMonitor,
    FreeBall,
    Surroundings,
    Window,
    detect_contact,
    nearest_solid,
)
from drake_quad.signals import SIGNALS, State
from drake_quad.space.shapes import Ball, Cuboid, convex_hull

PERIOD = 0.02  # s, control tick


def row(port, field):
    """Return the index of a component in the signal of a port."""
    return SIGNALS[port]._fields.index(field)


def metrics_of_inputs(inputs, num_vehicles=1, **options):
    """Return the metrics and the output `crashed` for inputs, which are (ticks, size) arrays by port."""
    monitor, context = monitor_with_inputs(inputs, num_vehicles, **options)
    return monitor.metrics(context), monitor.GetOutputPort("crashed").Eval(context)


def monitor_with_inputs(inputs, num_vehicles=1, **options):
    """Return a monitor that has processed the inputs, and its final context."""
    builder = DiagramBuilder()
    monitor = builder.AddNamedSystem("monitor", FlightMonitor(num_vehicles=num_vehicles, period=PERIOD, **options))
    ticks = len(next(iter(inputs.values())))
    for name, values in inputs.items():
        # Each row of the inputs applies from half a period before its tick to half a period after it.
        breaks = PERIOD * (np.arange(ticks + 1) - 0.5)
        rows = np.vstack([values, values[-1:]])
        source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.ZeroOrderHold(breaks, rows.T)))
        builder.Connect(source.get_output_port(), monitor.GetInputPort(name))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(PERIOD * (ticks - 1))
    simulator.AdvancePendingEvents()
    return monitor, monitor.GetMyContextFromRoot(simulator.get_context())


def random_inputs(ticks=40, num_vehicles=1, seed=0):
    rng = np.random.default_rng(seed)
    sizes = {"state": 12, "reference": 11, "acceleration_command": 3}
    inputs = {name: 0.3 * rng.normal(size=(ticks, size * num_vehicles)) for name, size in sizes.items()}
    heights = inputs["state"].reshape(ticks, 12, num_vehicles)[:, row("state", "z")]
    heights[:] = np.abs(heights)
    inputs["shortfall"] = np.repeat(rng.integers(0, 2, (ticks, num_vehicles)), 4, axis=1).reshape(
        ticks, num_vehicles, 4
    )
    inputs["shortfall"] = inputs["shortfall"].transpose(0, 2, 1).reshape(ticks, -1) * 1.0
    return inputs


def expected_metrics(inputs, ticks):
    """Return the metrics by name, computed from their definitions."""
    error = inputs["reference"][ticks, :3] - inputs["state"][ticks, :3]
    command = inputs["acceleration_command"][ticks]
    variation = np.abs(np.diff(command, axis=0)).sum(axis=0) / (PERIOD * (len(error) - 1))
    metrics_of_axes = {
        "rmse": np.sqrt(np.mean(error**2, axis=0)),
        "effort": np.mean(command**2, axis=0),
        "variation": variation,
    }
    return {
        "rmse": math.sqrt(np.mean(np.sum(error**2, axis=1))),
        "peak_error": np.linalg.norm(error, axis=1).max(),
        "saturated_fraction": np.mean(np.any(inputs["shortfall"][ticks] != 0.0, axis=1)),
        **{
            f"{name}_{axis}": value
            for name, values in metrics_of_axes.items()
            for axis, value in zip("xyz", values, strict=True)
        },
    }


def check_metrics(metrics, expected_values, vehicle=0):
    """Check a vehicle's metrics against the expected ones, by name."""
    actual = {name: getattr(metrics, name)[vehicle] for name in expected_values}
    assert actual == pytest.approx(expected_values, rel=1e-12)


def test_metrics_agree_with_their_definitions():
    inputs = random_inputs()
    metrics, crashed = metrics_of_inputs(inputs)
    check_metrics(metrics, expected_metrics(inputs, slice(None)))
    assert crashed == 0.0
    assert not metrics.crashed[0]


def test_metrics_use_only_the_ticks_in_the_metric_window():
    inputs = random_inputs()
    metrics, _ = metrics_of_inputs(inputs, window=Window(0.2, 0.5))
    check_metrics(metrics, expected_metrics(inputs, slice(10, 26)))


@pytest.mark.parametrize(
    ("port", "field", "value"),
    [
        ("state", "roll", 1.5),
        ("state", "pitch", -1.5),
        ("state", "z", -0.6),
        ("state", "x", -6.0),
        ("state", "y", 6.0),
        ("reference", "z", 6.5),
        ("acceleration_command", "x", math.inf),
        ("acceleration_command", "y", -math.inf),
        ("acceleration_command", "z", math.nan),
        *(("wrench", field, math.nan) for field in SIGNALS["wrench"]._fields),
        *(("attitude_target", field, -math.inf) for field in SIGNALS["attitude_target"]._fields),
    ],
)
def test_a_crash_is_detected_and_ends_the_metrics(port, field, value):
    inputs = random_inputs()
    if port in ("wrench", "attitude_target"):
        inputs[port] = np.ones((len(inputs["state"]), len(SIGNALS[port]._fields)))
    inputs[port][25:, row(port, field)] = value
    metrics, crashed = metrics_of_inputs(inputs)
    assert crashed == 1.0
    assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)
    check_metrics(metrics, expected_metrics(inputs, slice(25)))


def test_a_crash_is_permanent():
    """The vehicle remains crashed even if it is within all limits at the next tick."""
    inputs = random_inputs()
    inputs["state"][25, row("state", "roll")] = 1.5
    metrics, crashed = metrics_of_inputs(inputs)
    assert crashed == 1.0
    assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)
    check_metrics(metrics, expected_metrics(inputs, slice(25)))


def test_the_crash_limit_applies_to_the_euclidean_error():
    """An error of (3, 2.8, 2.8) m is within the limit of 5 m and (3, 2.9, 2.9) m is not, in any order of the axes."""
    for shift in range(3):
        inputs = random_inputs()
        inputs["state"][:, 0:3] = 10.0
        inputs["reference"][:, 0:3] = 10.0 + np.roll([3.0, -2.8, 2.8], shift)
        inputs["reference"][25:, 0:3] = 10.0 + np.roll([3.0, -2.9, 2.9], shift)
        metrics, _ = metrics_of_inputs(inputs)
        assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)


def test_a_vehicle_exactly_at_the_limits_has_not_crashed():
    inputs = {"state": np.zeros((5, 12)), "reference": np.zeros((5, 11))}
    inputs["state"][:] = State(*[0.0] * 12)._replace(z=-0.5, roll=1.2, pitch=-1.2)
    inputs["reference"][:, 0:3] = 3.0, -4.0, -0.5
    assert metrics_of_inputs(inputs, limits=CrashLimits(tilt=1.2))[1] == 0.0
    assert metrics_of_inputs(inputs, limits=CrashLimits(tilt=1.1999))[1] == 1.0
    assert metrics_of_inputs(inputs, limits=CrashLimits(tilt=1.2, position_error=4.9999))[1] == 1.0
    assert metrics_of_inputs(inputs, limits=CrashLimits(tilt=1.2, height=-0.4999))[1] == 1.0


@pytest.mark.parametrize("component", range(4))
def test_any_shortfall_of_the_wrench_counts_as_saturation(component):
    inputs = random_inputs()
    inputs["shortfall"][:] = 0.0
    inputs["shortfall"][[3, 7, 8], component] = 0.1, -0.2, 1e-9
    assert metrics_of_inputs(inputs)[0].saturated_fraction[0] == pytest.approx(3.0 / 40.0)


def test_a_single_tick_has_an_error_but_no_variation():
    inputs = random_inputs()
    metrics, _ = metrics_of_inputs(inputs, window=Window(0.2, 0.21))
    error = inputs["reference"][10, :3] - inputs["state"][10, :3]
    assert metrics.rmse[0] == metrics.peak_error[0] == pytest.approx(np.linalg.norm(error))
    assert np.isnan([metrics.variation_x[0], metrics.variation_y[0], metrics.variation_z[0]]).all()
    metrics_without_ticks, _ = metrics_of_inputs(inputs, window=Window(0.201, 0.219))
    assert np.isnan(
        [
            metrics_without_ticks.rmse[0],
            metrics_without_ticks.peak_error[0],
            metrics_without_ticks.effort_x[0],
            metrics_without_ticks.saturated_fraction[0],
        ]
    ).all()


def test_a_crash_does_not_affect_other_vehicles():
    inputs = random_inputs(num_vehicles=3)
    inputs["state"].reshape(-1, 12, 3)[15:, 0, 1] = math.nan
    metrics, crashed = metrics_of_inputs(inputs, num_vehicles=3)
    np.testing.assert_array_equal(crashed, [0.0, 1.0, 0.0])
    for i, ticks in enumerate((slice(None), slice(15), slice(None))):
        inputs_of_vehicle = {name: values.reshape(len(values), -1, 3)[:, :, i] for name, values in inputs.items()}
        check_metrics(metrics, expected_metrics(inputs_of_vehicle, ticks), i)


def test_metrics_of_unconnected_ports_are_nan():
    inputs = random_inputs()
    metrics, _ = metrics_of_inputs({name: inputs[name] for name in ("state", "reference")})
    assert math.isfinite(metrics.rmse[0])
    assert np.isnan([metrics.effort_x[0], metrics.variation_z[0], metrics.saturated_fraction[0]]).all()


# Obstacles; positions and sizes in m.
SOLIDS = Ball((2.0, 0.0, 1.0), radius=0.5), Cuboid((0.0, 3.0, 1.0), size=(1.0, 1.0, 1.0))


def inputs_at_rest(num_vehicles=1, **rows):
    """Return inputs for five ticks with vehicles at rest at their reference, at a height of 1 m."""
    inputs = {"state": np.zeros((5, 12, num_vehicles)), "reference": np.zeros((5, 11, num_vehicles))}
    for port in inputs:
        inputs[port][:, row(port, "z")] = 1.0
    for name, values in rows.items():
        inputs["state"][:, row("state", name)] = values
        inputs["reference"][:, row("reference", name)] = values
    return {port: values.reshape(5, -1) for port, values in inputs.items()}


def test_a_vehicle_within_its_radius_of_a_solid_has_crashed_into_it():
    """The distances to each solid are just below and just above the radius. The last vehicle is inside a solid."""
    x = np.array([1.29, 1.31, 0.0, 0.0, 0.0])
    y = np.array([0.0, 0.0, 2.29, 2.31, 3.0])
    monitor, context = monitor_with_inputs(inputs_at_rest(5, x=x, y=y), 5, surroundings=Surroundings(SOLIDS, 0.2))
    np.testing.assert_array_equal(monitor.obstacle_hit(context), [0, 1, 0, 2, 2])
    np.testing.assert_array_equal(monitor.metrics(context).crashed, [False, True, False, True, True])


def test_a_vehicle_that_begins_in_a_solid_has_crashed_at_the_first_tick():
    """There is no free ball before the first tick, so the monitor computes the distances to all solids."""
    for start in ((0.4, 0.0), (0.0, 0.9)):
        inputs = inputs_at_rest(x=start[0], y=start[1])
        solid = Ball((start[0] + 0.1, start[1], 1.1), radius=0.2)
        monitor, context = monitor_with_inputs(inputs, surroundings=Surroundings((solid,), 0.2))
        assert monitor.obstacle_hit(context) == [1]
        assert monitor.metrics(context).crash_time == [0.0]


def test_the_nearest_distance_is_infinite_without_solids():
    assert nearest_solid(1.0, 2.0, 3.0, ()) == (math.inf, 0.0)


def test_the_first_collision_is_recorded_permanently():
    inputs = inputs_at_rest()
    inputs["state"][2:, row("state", "x")] = inputs["reference"][2:, row("reference", "x")] = 1.4
    inputs["state"][3:, 0:2] = inputs["reference"][3:, 0:2] = 0.0, 3.0
    monitor, context = monitor_with_inputs(inputs, surroundings=Surroundings(SOLIDS, 0.2))
    assert monitor.obstacle_hit(context) == [1]
    assert monitor.metrics(context).crash_time[0] == pytest.approx(2 * PERIOD)


def test_a_vehicle_that_crashes_before_it_reaches_a_solid_has_touched_none():
    inputs = inputs_at_rest()
    inputs["state"][2, row("state", "roll")] = 1.5
    inputs["state"][3:, row("state", "x")] = inputs["reference"][3:, row("reference", "x")] = 1.4
    monitor, context = monitor_with_inputs(inputs, surroundings=Surroundings(SOLIDS, 0.2))
    assert monitor.obstacle_hit(context) == [0]
    assert monitor.metrics(context).crash_time[0] == pytest.approx(2 * PERIOD)


@pytest.mark.parametrize("num_vehicles", [1, 11])
def test_skipping_distance_computations_misses_no_collision(num_vehicles):
    """Vehicles move by about 1 mm, 3 cm or 30 cm per tick. The expected values use all distances at every tick."""
    rng = np.random.default_rng(num_vehicles)
    ticks, radius = 400, 0.2
    rock = convex_hull(rng.normal(size=(12, 3)) * 0.2 + [-1.5, -1.0, 1.2])
    solids = *SOLIDS, rock, convex_hull(rng.normal(size=(8, 3)) * 0.3 + [1.0, -2.0, 1.0])
    steps = rng.normal(size=(ticks, 3, num_vehicles)) * rng.choice([0.001, 0.03, 0.3], (ticks, 1, num_vehicles))
    positions = np.cumsum(steps, axis=0) + np.array([0.0, 0.0, 1.5])[:, None]
    if num_vehicles > 1:
        positions[20:, :, 0] = np.nan
    inputs = {name: np.zeros((ticks, size, num_vehicles)) for name, size in (("state", 12), ("reference", 11))}
    for values in inputs.values():
        values[:, :3] = positions
    inputs = {name: values.reshape(ticks, -1) for name, values in inputs.items()}
    limits = CrashLimits(height=-math.inf)
    monitor, context = monitor_with_inputs(
        inputs, num_vehicles, surroundings=Surroundings(solids, radius), limits=limits
    )
    obstacle_hit, crash_time = monitor.obstacle_hit(context), monitor.metrics(context).crash_time
    num_collisions = 0
    for i in range(num_vehicles):
        distances = np.array([solid.distances(positions[:, :, i]) for solid in solids])
        crashes = np.flatnonzero((distances.min(axis=0) < radius) | np.isnan(positions[:, 0, i]))
        if not len(crashes):
            assert (obstacle_hit[i], crash_time[i]) == (0, math.inf)
            continue
        first = distances[:, crashes[0]]
        assert obstacle_hit[i] == (0 if np.isnan(first[0]) else 1 + np.argmin(first))
        assert crash_time[i] == pytest.approx(PERIOD * crashes[0])
        num_collisions += obstacle_hit[i] > 0
    assert num_vehicles == 1 or 3 <= num_collisions < num_vehicles


class CountingSolid:
    """Solid that counts how often its distance is computed."""

    def __init__(self, shape):
        self.shape = shape
        self.count = 0

    def distance(self, x, y, z):
        self.count += 1
        return self.shape.distance(x, y, z)

    def distance_lower_bound(self, x, y, z):
        return self.shape.distance_lower_bound(x, y, z)


def test_distances_are_computed_only_after_a_vehicle_leaves_its_free_ball():
    """A free ball contains only positions at which the vehicle touches no solid."""
    solid = CountingSolid(Ball((2.0, 0.0, 1.0), radius=0.5))
    surroundings, free = Surroundings((solid,), 0.2), FreeBall()
    level = State(*[0.0] * 12)._replace(z=1.0)
    counts = []
    # The first free ball has a radius of 1.3 m, and the second one a radius of 2.61 m.
    for x, is_flying in ((0.0, True), (0.5, True), (-1.29, True), (-1.31, True), (0.5, True), (0.9, True), (1.4, True)):
        touch, free = detect_contact(level._replace(x=x), is_flying, free, surroundings)
        counts.append(solid.count)
        assert touch == CollidedSolid(1.0 if x == 1.4 else 0.0)
    assert counts == [1, 1, 1, 2, 2, 2, 3]
    # Distances of a crashed vehicle are not computed.
    touch, ball_after_crash = detect_contact(level._replace(x=1.5), False, free, surroundings)
    assert (touch, ball_after_crash, solid.count) == (CollidedSolid(), free, 3)


def test_the_distance_of_a_hull_is_computed_only_if_it_can_be_the_nearest_solid():
    near, far = (
        CountingSolid(Ball((1.0, 0.0, 1.0), radius=0.5)),
        CountingSolid(convex_hull(np.add(np.eye(4, 3), [5.0, 0.0, 0.0]))),
    )
    detect_contact(State(*[0.0] * 12), True, FreeBall(), Surroundings((near, far), 0.1))
    assert (near.count, far.count) == (1, 0)
    detect_contact(State(*[0.0] * 12), True, FreeBall(), Surroundings((far, near), 0.1))
    assert (near.count, far.count) == (2, 1)
