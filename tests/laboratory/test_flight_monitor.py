import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.laboratory.flight_monitor import CrashLimits, FlightMonitor, Window
from drake_quad.signals import SIGNALS, State

PERIOD = 0.02


def row(port, field):
    """The place of a field in what a port holds."""
    return SIGNALS[port]._fields.index(field)


def watched(tape, num_vehicles=1, **options):
    """The metrics that the monitor gathers over a tape of (ticks, size) inputs by port."""
    builder = DiagramBuilder()
    monitor = builder.AddNamedSystem("monitor", FlightMonitor(num_vehicles=num_vehicles, period=PERIOD, **options))
    ticks = len(next(iter(tape.values())))
    for name, values in tape.items():
        # Each row holds from half a period before its tick.
        breaks = PERIOD * (np.arange(ticks + 1) - 0.5)
        rows = np.vstack([values, values[-1:]])
        source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.ZeroOrderHold(breaks, rows.T)))
        builder.Connect(source.get_output_port(), monitor.GetInputPort(name))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(PERIOD * (ticks - 1))
    simulator.AdvancePendingEvents()
    context = monitor.GetMyContextFromRoot(simulator.get_context())
    return monitor.metrics(context), monitor.GetOutputPort("crashed").Eval(context)


def random_tape(ticks=40, num_vehicles=1, seed=0):
    rng = np.random.default_rng(seed)
    sizes = {"state": 12, "reference": 11, "acceleration_command": 3}
    tape = {name: 0.3 * rng.normal(size=(ticks, size * num_vehicles)) for name, size in sizes.items()}
    heights = tape["state"].reshape(ticks, 12, num_vehicles)[:, row("state", "z")]
    heights[:] = np.abs(heights)
    tape["shortfall"] = np.repeat(rng.integers(0, 2, (ticks, num_vehicles)), 4, axis=1).reshape(ticks, num_vehicles, 4)
    tape["shortfall"] = tape["shortfall"].transpose(0, 2, 1).reshape(ticks, -1) * 1.0
    return tape


def expected(tape, ticks):
    """The metrics straight from their definitions."""
    error = tape["reference"][ticks, :3] - tape["state"][ticks, :3]
    command = tape["acceleration_command"][ticks]
    return [
        math.sqrt(np.mean(np.sum(error**2, axis=1))),
        *np.sqrt(np.mean(error**2, axis=0)),
        np.linalg.norm(error, axis=1).max(),
        *np.mean(command**2, axis=0),
        *(np.abs(np.diff(command, axis=0)).sum(axis=0) / (PERIOD * (len(error) - 1))),
        np.mean(np.any(tape["shortfall"][ticks] != 0.0, axis=1)),
    ]


def test_metrics_are_their_definitions():
    tape = random_tape()
    metrics, crashed = watched(tape)
    np.testing.assert_allclose(np.array(metrics[:-1])[:, 0], expected(tape, slice(None)), rtol=1e-12)
    assert crashed == 0.0
    assert not metrics.crashed[0]


def test_only_the_window_counts():
    tape = random_tape()
    metrics, _ = watched(tape, window=Window(0.2, 0.5))
    np.testing.assert_allclose(np.array(metrics[:-1])[:, 0], expected(tape, slice(10, 26)), rtol=1e-12)


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
    ],
)
def test_a_crash_is_called_and_ends_what_counts(port, field, value):
    tape = random_tape()
    tape[port][25:, row(port, field)] = value
    metrics, crashed = watched(tape)
    assert crashed == 1.0
    assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)
    np.testing.assert_allclose(np.array(metrics[:-1])[:, 0], expected(tape, slice(25)), rtol=1e-12)


def test_a_crash_is_for_good():
    """Also of a vehicle that is within all limits again a tick later."""
    tape = random_tape()
    tape["state"][25, row("state", "roll")] = 1.5
    metrics, crashed = watched(tape)
    assert crashed == 1.0
    assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)
    np.testing.assert_allclose(np.array(metrics[:-1])[:, 0], expected(tape, slice(25)), rtol=1e-12)


def test_the_error_of_a_crash_is_the_distance_in_space():
    """Against 5 m: (3, 2.8, 2.8) m is nearer than that, (3, 2.9, 2.9) m is not, whichever axis has which."""
    for turn in range(3):
        tape = random_tape()
        tape["state"][:, 0:3] = 10.0
        tape["reference"][:, 0:3] = 10.0 + np.roll([3.0, -2.8, 2.8], turn)
        tape["reference"][25:, 0:3] = 10.0 + np.roll([3.0, -2.9, 2.9], turn)
        metrics, _ = watched(tape)
        assert metrics.crash_time[0] == pytest.approx(25 * PERIOD)


def test_at_the_limits_a_vehicle_still_flies():
    tape = {"state": np.zeros((5, 12)), "reference": np.zeros((5, 11))}
    tape["state"][:] = State(*[0.0] * 12)._replace(z=-0.5, roll=1.2, pitch=-1.2)
    tape["reference"][:, 0:3] = 3.0, -4.0, -0.5
    assert watched(tape, limits=CrashLimits(tilt=1.2))[1] == 0.0
    assert watched(tape, limits=CrashLimits(tilt=1.1999))[1] == 1.0
    assert watched(tape, limits=CrashLimits(tilt=1.2, position_error=4.9999))[1] == 1.0
    assert watched(tape, limits=CrashLimits(tilt=1.2, height=-0.4999))[1] == 1.0


@pytest.mark.parametrize("part", range(4))
def test_rotors_are_saturated_if_they_give_up_any_part_of_the_wrench(part):
    tape = random_tape()
    tape["shortfall"][:] = 0.0
    tape["shortfall"][[3, 7, 8], part] = 0.1, -0.2, 1e-9
    assert watched(tape)[0].saturation_share[0] == pytest.approx(3.0 / 40.0)


def test_a_single_tick_has_an_error_but_no_variation():
    tape = random_tape()
    metrics, _ = watched(tape, window=Window(0.2, 0.21))
    error = tape["reference"][10, :3] - tape["state"][10, :3]
    assert metrics.rmse[0] == metrics.peak_error[0] == pytest.approx(np.linalg.norm(error))
    assert np.isnan([metrics.variation_x[0], metrics.variation_y[0], metrics.variation_z[0]]).all()
    nothing, _ = watched(tape, window=Window(0.201, 0.219))
    assert np.isnan([nothing.rmse[0], nothing.peak_error[0], nothing.effort_x[0], nothing.saturation_share[0]]).all()


def test_a_crash_touches_no_other_vehicle():
    tape = random_tape(num_vehicles=3)
    tape["state"].reshape(-1, 12, 3)[15:, 0, 1] = math.nan
    metrics, crashed = watched(tape, num_vehicles=3)
    np.testing.assert_array_equal(crashed, [0.0, 1.0, 0.0])
    for i, ticks in enumerate((slice(None), slice(15), slice(None))):
        alone = {name: values.reshape(len(values), -1, 3)[:, :, i] for name, values in tape.items()}
        np.testing.assert_allclose(np.array(metrics[:-1])[:, i], expected(alone, ticks), rtol=1e-12)


def test_what_is_not_connected_is_not_measured():
    tape = random_tape()
    metrics, _ = watched({name: tape[name] for name in ("state", "reference")})
    assert math.isfinite(metrics.rmse[0])
    assert np.isnan([metrics.effort_x[0], metrics.variation_z[0], metrics.saturation_share[0]]).all()
