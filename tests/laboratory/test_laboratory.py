"""Tests of the timing of motion capture, command link and recorder, and of defaults of the laboratory."""

import math

import numpy as np
import pytest
from noise_feed import feed_noise
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.assembly.recorder import build_recorder, read_recorder
from drake_quad.framework.records import record_like
from drake_quad.laboratory.command_link import CommandLink, LinkParameters
from drake_quad.laboratory.flight_monitor import CrashLimits, Surroundings, Window
from drake_quad.laboratory.motion_capture import CameraParameters, MotionCapture
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, Turbulence, TurbulenceParameters
from drake_quad.laboratory.wind.fans import Direction, Fans, Jet, Outlet
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.laboratory.wind.sine import SineParameters, SineWind
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.scenario import models
from drake_quad.signals import Wind, Wrench

INITIAL_WRENCH = Wrench(7.0, 7.0, 7.0, 7.0)  # wrench before the first command arrives, in N and N m


def ramp_source(size):
    """Return a source in which each element of the output is the time plus one."""
    line = PiecewisePolynomial.FirstOrderHold([0.0, 100.0], np.array([[1.0] * size, [101.0] * size]).T)
    return TrajectorySource(line)


def recorded_output(system, output, size, duration, period=0.005, column=0):
    """Return times and values of a system's output, as a discrete update reads them. The input is a ramp."""
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("clock", ramp_source(size))
    builder.AddNamedSystem("system", system)
    builder.Connect(source.get_output_port(), system.get_input_port())
    recorder = builder.AddNamedSystem("recorder", build_recorder({"out": size}, period=period))
    builder.Connect(system.GetOutputPort(output), recorder.GetInputPort("out"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    time, signals = read_recorder(recorder, simulator.get_context())
    return time, signals["out"][:, column]


def latest_sample_time(times, period):
    """Return the time of the sample that an update at each time reads: the latest earlier multiple of the period."""
    ticks = np.round(times / period, 6)
    return np.maximum(np.ceil(ticks) - 1, 0) * period


def test_motion_capture_holds_each_frame_for_a_period():
    time, value = recorded_output(MotionCapture(period=0.01), "measurement", 12, 0.3)
    np.testing.assert_allclose(value - 1.0, latest_sample_time(time, 0.01), atol=1e-12)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_command_link_delays_by_whole_ticks(delay):
    link = CommandLink(period=0.02, longest_delay=delay, parameters=LinkParameters(delay, initial=INITIAL_WRENCH))
    time, value = recorded_output(link, "wrench", 4, 0.3)
    # At each tick, the recorder reads the output first, and then the link receives the command.
    tick = np.ceil(np.round(time / 0.02, 6)) - 1 - delay
    expected = np.where(tick < 0, 7.0, 1.0 + 0.02 * tick)
    np.testing.assert_allclose(value, expected, atol=1e-12)


def test_each_vehicle_of_a_fleet_has_its_own_delay():
    delays = np.array([2, 0, 1])
    for i, delay in enumerate(delays):
        link = CommandLink(
            num_vehicles=3, period=0.02, longest_delay=2, parameters=LinkParameters(delays, initial=INITIAL_WRENCH)
        )
        time, value = recorded_output(link, "wrench", 12, 0.3, column=i)
        tick = np.ceil(np.round(time / 0.02, 6)) - 1 - delay
        np.testing.assert_allclose(value, np.where(tick < 0, 7.0, 1.0 + 0.02 * tick), atol=1e-12)


@pytest.mark.parametrize("delay", [0, 2])
def test_a_lost_packet_is_replaced_by_the_previous_one(delay):
    rate, n = 0.3, 20
    parameters = LinkParameters(delay, rate)
    link = CommandLink(num_vehicles=n, period=0.02, longest_delay=delay, loses_packets=True, parameters=parameters)
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("clock", ramp_source(4 * n))
    builder.AddNamedSystem("link", link)
    builder.Connect(source.get_output_port(), link.GetInputPort("wrench"))
    feed_noise(builder, link, StreamKind.NOISE, Samples(2, range(n)))
    log = LogVectorOutput(link.GetOutputPort("wrench"), builder, publish_period=0.02)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(20.0)
    log_data = log.FindLog(simulator.get_context())
    output = log_data.data().reshape(4, n, -1)[0, :, delay + 2 :]
    time = log_data.sample_times()[delay + 2 :]
    ages = np.round((time - (output - 1.0)) / 0.02)
    # The output is the packet sent `delay` ticks before the last tick. If that packet was lost, it is an older packet.
    lateness = ages - (delay + 1)
    assert lateness.min() == 0.0
    for ticks in (0, 1, 2):
        fraction = (1.0 - rate) * rate**ticks
        assert (lateness == ticks).mean() == pytest.approx(fraction, abs=0.02)
    is_current = lateness[:, 1:] == 0
    np.testing.assert_array_equal(is_current | (lateness[:, 1:] == lateness[:, :-1] + 1), True)


def test_the_recorder_stores_signals_as_a_discrete_update_reads_them_at_each_tick():
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("clock", ramp_source(2))
    recorder = builder.AddNamedSystem("recorder", build_recorder({"a": 2, "b": 2}, period=0.02))
    for name in ("a", "b"):
        builder.Connect(source.get_output_port(), recorder.GetInputPort(name))
    simulator = Simulator(builder.Build())
    for end in (0.05, 0.06, 0.2):
        simulator.AdvanceTo(end)
    simulator.AdvancePendingEvents()
    time, signals = read_recorder(recorder, simulator.get_context())
    np.testing.assert_allclose(time, np.arange(11) * 0.02)
    for name in ("a", "b"):
        np.testing.assert_allclose(signals[name], np.column_stack([time, time]) + 1.0)


FILTERED_CAMERAS = CameraParameters(derivative_bandwidth=50.0)  # rad/s
JET = Jet(Outlet(0.0, 0.0, 0.0), Direction(1.0, 0.0, 0.0), 5.0, 1.0)
TURBULENCE = Turbulence.at_low_altitude(height=10.0, wind_at_20_feet=5.0, airspeed=5.0)  # m and m/s


def test_the_laboratory_is_ideal_by_default():
    assert LinkParameters() == (0.0, 0.0, Wrench(0.0, 0.0, 0.0, 0.0))
    assert CameraParameters() == record_like(CameraParameters, models.Laboratory().motion_capture)
    assert Surroundings() == ((), 0.0)
    assert Window() == (0.0, math.inf)
    wind = Wind(1.0, 2.0, 3.0)
    assert GustParameters(wind, 1.0, 2.0).hold_time == math.inf
    assert SineParameters(wind, 1.0).phase == 0.0
    assert JET.turbulence == 0.0
    assert TurbulenceParameters(TURBULENCE).heading == 0.0


def test_default_crash_limits_agree_with_the_defaults_of_a_scenario():
    crash = {name: models.Crash.model_fields[name].default for name in CrashLimits._fields}
    assert CrashLimits()._asdict() == pytest.approx(crash)


@pytest.mark.slow
def test_measurements_and_wind_are_zero_before_a_simulation_begins():
    """The first samples are taken by initialization events, which occur only when a simulation begins."""
    wind = Wind(1.0, 2.0, 3.0)
    for system in (
        MotionCapture(filtered=True, drifts=True, longest_latency=2, num_vehicles=2, parameters=FILTERED_CAMERAS),
        Gust(parameters=GustParameters(wind, 0.0, 1.0)),
        SineWind(parameters=SineParameters(wind, 1.0, 1.0)),
        Fans(parameters=(JET,)),
        DrydenTurbulence(parameters=TurbulenceParameters(TURBULENCE)),
    ):
        context = system.CreateDefaultContext()
        for i in range(context.num_discrete_state_groups()):
            np.testing.assert_array_equal(context.get_discrete_state(i).CopyToVector(), 0.0)
