"""Tests of faults, missing readings, latency and internal states of sensors."""

from typing import Annotated, NamedTuple

import numpy as np
import pytest
from noise_feed import feed_noise
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad import load_scenario
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.laboratory.sensors.gnss import GNSS, GnssErrors, GnssParameters, PositionDeviation, PositionDrift
from drake_quad.laboratory.sensors.sensor import (
    FaultKind,
    FaultySensor,
    Sample,
    Sensor,
    SensorFault,
    SensorLaw,
    SensorMemory,
)
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.scenario.sensors.gyroscope import GyroscopeSettings
from drake_quad.signals import SIGNALS, Number, Quantity, Valid

PERIOD = 0.1  # s, sensor period
FAILED = FaultKind(is_reported=True, is_random=False)
FROZEN = FaultKind(is_reported=False, is_random=False)
DROPOUT = FaultKind(is_reported=True, is_random=True)


class Clock(NamedTuple):
    """Reading of a sensor that measures the time. In these tests, the x coordinate of the state is the time."""

    time: Annotated[float, Quantity("s")]


class ClockParameters(NamedTuple):
    """Parameters of a sensor that measures the time."""

    latency_samples: Number = 0.0


class Count(NamedTuple):
    """Internal state of a sensor that counts its readings."""

    number: Number


CLOCK = SensorLaw(Clock, lambda parameters, noise, state: Clock(state.x), ("state",))
# This clock misses all readings before 0.45 s.
LATE_CLOCK = SensorLaw(
    Clock, lambda parameters, noise, state: Sample(Clock(state.x), state.x > 0.45), ("state",), can_miss=True
)
COUNTER = SensorLaw(
    Clock,
    lambda parameters, noise, memory, state: Clock(memory.number),
    ("state",),
    memory=SensorMemory(
        lambda parameters, noise, state: Count(1.0),
        lambda parameters, noise, memory, state: Count(memory.number + 1.0),
    ),
)


@pytest.fixture(autouse=True)
def clock_signals():
    SIGNALS["clock"], SIGNALS["clock_valid"] = Clock, Valid
    yield
    del SIGNALS["clock"], SIGNALS["clock_valid"]


def simulated_outputs(sensor, duration=1.0, num_vehicles=1):
    """Return the simulated outputs of a sensor just before readings 1, 2, ..., as (T, components) arrays by port."""
    builder = DiagramBuilder()
    state = np.zeros((12 * num_vehicles, 2))
    state[:num_vehicles, 1] = 10.0
    source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.FirstOrderHold([0.0, 10.0], state)))
    builder.AddNamedSystem("clock", sensor)
    builder.Connect(source.get_output_port(), sensor.GetInputPort("state"))
    feed_noise(builder, sensor, StreamKind.NOISE, Samples(3, range(num_vehicles)))
    ports = [sensor.get_output_port(i) for i in range(sensor.num_output_ports())]
    logs = {port.get_name(): LogVectorOutput(port, builder, publish_period=PERIOD) for port in ports}
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(duration)
    return {name: log.FindLog(simulator.get_context()).data().T[1:] for name, log in logs.items()}


def clock(law=CLOCK, kind=None, fault=None, latency=0, num_vehicles=1):
    parameters = ClockParameters(float(latency))
    return Sensor(
        num_vehicles,
        name="clock",
        law=law,
        period=PERIOD,
        longest_latency=latency,
        fault=kind,
        parameters=parameters if fault is None else FaultySensor(parameters, fault),
    )


def test_a_failed_sensor_repeats_its_last_reading_and_reports_this():
    outputs = simulated_outputs(clock(kind=FAILED, fault=SensorFault(0.25, 0.55, 1.0)))
    expected = [0.0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.6, 0.7, 0.8, 0.9]
    np.testing.assert_allclose(outputs["clock"][:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"][:, 0], [1, 1, 1, 0, 0, 0, 1, 1, 1, 1])


def test_a_frozen_sensor_repeats_its_last_reading_as_if_it_were_new():
    outputs = simulated_outputs(clock(kind=FROZEN, fault=SensorFault(0.25, np.inf, 1.0)))
    np.testing.assert_allclose(outputs["clock"][:, 0], [0.0, 0.1, *[0.2] * 8], atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"], 1.0)


@pytest.mark.parametrize(
    ("settings", "kind", "fault"),
    [
        ({"kind": "failed", "time": 2.0, "duration": 3.0}, FAILED, SensorFault(2.0, 5.0, 1.0)),
        ({"kind": "frozen", "time": 2.0}, FROZEN, SensorFault(2.0, np.inf, 1.0)),
        ({"kind": "dropout", "probability": 0.3}, DROPOUT, SensorFault(0.0, np.inf, 0.3)),
    ],
)
def test_a_fault_in_a_scenario_has_the_given_kind_interval_and_probability(settings, kind, fault):
    sensor = GyroscopeSettings.model_validate({"kind": "gyroscope", "fault": settings})
    recipe = sensor.recipe(sensor, load_scenario("hover").vehicle)
    assert recipe.structure["fault"] == kind
    assert recipe.parameters.fault == fault


def test_the_validity_of_a_reading_arrives_together_with_the_reading():
    outputs = simulated_outputs(clock(kind=FAILED, fault=SensorFault(0.25, 0.45, 1.0), latency=2))
    expected = [0.0, 0.0, 0.0, 0.1, 0.2, 0.2, 0.2, 0.5, 0.6, 0.7]
    np.testing.assert_allclose(outputs["clock"][:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"][:, 0], [1, 1, 1, 1, 1, 0, 0, 1, 1, 1])


def test_a_sensor_that_has_no_first_reading_outputs_zero():
    """The clocks in this test add 7 s to the time, so that a reading of zero can only be a missing reading."""
    shifted = LATE_CLOCK._replace(formula=lambda _, noise, state: Sample(Clock(state.x + 7.0), state.x > 0.45))
    outputs = simulated_outputs(clock(shifted))
    np.testing.assert_allclose(outputs["clock"][:, 0], [0.0] * 5 + [7.5, 7.6, 7.7, 7.8, 7.9], atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"][:, 0], [0] * 5 + [1] * 5)
    failed = CLOCK._replace(formula=lambda _, noise, state: Clock(state.x + 7.0))
    outputs = simulated_outputs(clock(failed, FAILED, SensorFault(0.0, np.inf, 1.0)))
    assert not outputs["clock"].any()
    assert not outputs["clock_valid"].any()
    outputs = simulated_outputs(clock(failed, FROZEN, SensorFault(0.0, np.inf, 1.0)))
    np.testing.assert_allclose(outputs["clock"], 7.0)


def test_a_missing_reading_of_a_frozen_sensor_is_not_valid():
    outputs = simulated_outputs(clock(LATE_CLOCK, FROZEN, SensorFault(0.65, np.inf, 1.0)))
    np.testing.assert_allclose(outputs["clock"][:, 0], [0.0] * 5 + [0.5] + [0.6] * 4, atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"][:, 0], [0] * 5 + [1] * 5)


def test_a_reading_can_be_missing_because_of_the_sensor_itself_or_because_of_a_fault():
    outputs = simulated_outputs(clock(LATE_CLOCK, FAILED, SensorFault(0.65, 0.85, 1.0)))
    np.testing.assert_allclose(outputs["clock"][:, 0], [0.0] * 5 + [0.5, 0.6, 0.6, 0.6, 0.9], atol=1e-12)
    np.testing.assert_array_equal(outputs["clock_valid"][:, 0], [0, 0, 0, 0, 0, 1, 1, 0, 0, 1])


def test_readings_drop_out_with_the_given_probability_from_the_start_of_the_fault():
    """Different vehicles lose different readings. A lost reading repeats the previous one."""
    rate, vehicles = np.array([0.2] * 40 + [0.5] * 40), 80
    outputs = simulated_outputs(
        clock(kind=DROPOUT, fault=SensorFault(2.0, np.inf, rate), num_vehicles=vehicles), 10.0, vehicles
    )
    valid, readings = outputs["clock_valid"], outputs["clock"]
    assert (valid[:20] == 1.0).all()
    for half, probability in ((slice(0, 40), 0.2), (slice(40, 80), 0.5)):
        lost = 1.0 - valid[20:, half]
        assert lost.mean() == pytest.approx(probability, abs=4.0 * np.sqrt(probability * (1 - probability) / lost.size))
        assert np.ptp(lost.mean(axis=0)) > 0.0
    np.testing.assert_array_equal(np.diff(readings, axis=0) > 0.0, valid[1:] == 1.0)


def test_the_internal_state_advances_once_for_each_reading():
    np.testing.assert_array_equal(simulated_outputs(clock(COUNTER))["clock"][:, 0], np.arange(1.0, 11.0))
    # The internal state also advances when a reading is missing.
    outputs = simulated_outputs(clock(COUNTER, FAILED, SensorFault(0.25, 0.55, 1.0)))
    np.testing.assert_array_equal(outputs["clock"][:, 0], [1, 2, 3, 3, 3, 3, 7, 8, 9, 10])


@pytest.mark.slow
def test_the_drift_is_stationary_and_independent_between_the_vehicles_of_a_fleet():
    """All readings have the same standard deviation, and successive readings have the given correlation."""
    vehicles = 2000
    errors = GnssErrors(PositionDrift(PositionDeviation(2.0, 2.0, 3.0), Correlation.of(0.5, PERIOD)))
    sensor = Sensor(
        vehicles,
        name="clock",
        law=GNSS,
        period=PERIOD,
        noisy=True,
        errors=("position_drift",),
        parameters=GnssParameters(errors=errors),
    )
    readings = simulated_outputs(sensor, 0.65, vehicles)["clock"].reshape(6, 6, vehicles)
    rows = readings[:, 1] / 2.0
    np.testing.assert_allclose((rows**2).mean(axis=1), 1.0, atol=5.0 * np.sqrt(2.0 / vehicles))
    correlations = [np.mean(rows[0] * rows[k]) for k in (1, 3, 5)]
    np.testing.assert_allclose(correlations, np.exp(-np.array([0.2, 0.6, 1.0])), atol=4.0 / np.sqrt(vehicles))
    assert readings[:, 2].std() == pytest.approx(3.0, rel=0.1)
