"""Tests of fleet simulations: when they end, what they record, and how they are reset."""

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import load_scenario, register_controller
from drake_quad.fleets.fleet_simulation import fly, simulate_fleet
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.batch import Batch


@pytest.fixture(scope="module")
def scenario(diagrams):
    """Return a hover in turbulence with a partial rotor failure at 0.1 s."""
    overrides = [
        "route.duration=20",
        "laboratory.wind=[{kind: dryden, level: light}]",
        "vehicle.rotor_failure={rotor: 2, time: 0.1, speed_factor: {uniform: {min: 0.95, max: 0.99}}}",
    ]
    return load_scenario(diagrams / "hover.yaml", overrides)


def simulation_of(scenario, samples, compiled, factors=None):
    """Return a batch of samples and its simulation; failed rotors keep the given fractions of their speed."""
    batch = Batch.draw(scenario, samples)
    if factors is not None:
        batch = batch.with_varying({"vehicle.rotor_failure.speed_factor": np.array(factors)})
    return batch, simulate_fleet(batch, plan_route(scenario), record=True, compiled=compiled)


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_a_reset_fleet_flies_like_a_new_fleet(scenario, compiled):
    """A reset computes the initial wind by other code than the construction, so rounding errors may differ."""
    first, simulation = simulation_of(scenario, [3, 5], compiled)
    flown = []
    for batch in (first, Batch.draw(scenario, [8, 1]), first):
        simulation.reset(batch)
        assert simulation.simulator.get_context().get_time() == 0.0
        assert not simulation.metrics().crashed.any()
        simulation.fly(0.4)
        time, signals = simulation.recording()
        new = simulate_fleet(batch, plan_route(scenario), record=True, compiled=compiled)
        new.fly(0.4)
        np.testing.assert_array_equal(time, new.recording()[0])
        for name, values in new.recording()[1].items():
            np.testing.assert_allclose(signals[name], values, rtol=1e-9, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(np.array(simulation.metrics()), np.array(new.metrics()), rtol=1e-9)
        flown.append(signals["state"])
    assert np.abs(flown[0] - flown[1])[-1].max() > 1e-4
    np.testing.assert_allclose(flown[2], flown[0], rtol=1e-9, atol=1e-12)


def test_integrator_steps_of_a_continuous_fleet_end_at_the_rotor_failures_of_its_current_batch(diagrams):
    """All steps before and after the failure equal the steps of a new fleet to the last bit."""
    failure = "{rotor: 2, time: {uniform: {min: 0.05, max: 0.25}}, speed_factor: 0.5}"
    overrides = ["vehicle.time_step=0", "crash.tilt=null", f"vehicle.rotor_failure={failure}"]
    continuous = load_scenario(diagrams / "hover.yaml", overrides)
    _, simulation = simulation_of(continuous, [0], False)
    batch, new = simulation_of(continuous, [1], False)
    simulation.reset(batch)
    for fleet in (simulation, new):
        fleet.fly(0.3)
    np.testing.assert_array_equal(simulation.recording()[1]["state"], new.recording()[1]["state"])


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_a_fleet_flight_ends_when_all_vehicles_have_crashed(scenario, compiled):
    reports = []
    _, simulation = simulation_of(scenario, [0, 1], compiled, [0.0, 0.5])
    simulation.fly(20.0, progress=lambda *now: reports.append(now))
    crash_times = simulation.metrics().crash_time
    assert crash_times.max() < 3.0
    times = [time for time, _ in reports]
    strides = np.diff([0.0, *times])
    np.testing.assert_allclose(strides, strides[0])
    assert times[-1] - strides[0] <= crash_times.max() <= times[-1] < 6.0
    assert {duration for _, duration in reports} == {20.0}


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_a_fleet_flies_for_the_whole_duration_if_one_vehicle_has_not_crashed(scenario, compiled):
    """The flight ends at its duration, even if this is not a multiple of the interval between checks for crashes."""
    reports = []
    _, simulation = simulation_of(scenario, [0, 1], compiled, [0.0, 0.99])
    simulation.fly(5.5, progress=lambda time, _: reports.append(time))
    assert reports[-1] == simulation.simulator.get_context().get_time() == 5.5
    np.testing.assert_array_equal(np.isfinite(simulation.metrics().crash_time), [True, False])
    time, signals = simulation.recording()
    np.testing.assert_allclose(time, 0.02 * np.arange(276), atol=1e-12)
    assert {len(values) for values in signals.values()} == {276}
    states = signals["state"].reshape(276, 12, 2)
    # A crashed vehicle is frozen from the next tick on.
    crashed = time > simulation.metrics().crash_time[0]
    np.testing.assert_array_equal(states[crashed, :, 0], np.tile(states[-1, :, 0], (crashed.sum(), 1)))
    assert np.ptp(states[crashed, 0, 1]) > 0.0


@pytest.mark.slow
def test_a_simulation_reports_whether_it_is_compiled(scenario):
    assert [simulation_of(scenario, [0], compiled)[1].compiled for compiled in (False, True)] == [False, True]


class Free(LeafSystem):
    """Controller with a state, which is the constant acceleration that it commands."""

    def __init__(self, num_vehicles=1):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        state = self.DeclareDiscreteState(np.full(3 * num_vehicles, 0.5))
        self.DeclareStateOutputPort("acceleration_command", state)


@pytest.mark.long
def test_a_registered_controller_that_cannot_be_compiled_flies_in_a_compiled_fleet(diagrams):
    kind = register_controller(Free)
    hover = load_scenario(diagrams / "hover.yaml", [f"control.position={{kind: {kind}, feed_forward: none}}"])
    fleets = [simulation_of(hover, [0], compiled)[1] for compiled in (False, True)]
    for fleet in fleets:
        fleet.fly(0.4)
    uncompiled, compiled = (fleet.recording()[1]["state"] for fleet in fleets)
    np.testing.assert_allclose(compiled, uncompiled, rtol=1e-9, atol=1e-12)
    # The vehicle accelerates upwards as commanded, after the delays of the loop and the lag of the rotors.
    assert 0.25 * 0.5 < uncompiled[-1, 8] < 0.4 * 0.5


@pytest.mark.parametrize("jump", [0.25, 1.75])
def test_one_integration_step_ends_just_before_a_jump_of_the_forces_and_the_next_one_at_the_jump(jump):
    class Recorder:
        """Simulator that records the times to which it is advanced."""

        def __init__(self):
            self.times = []

        def get_system(self):
            return self

        def get_context(self):
            return None

        def GetOutputPort(self, name):
            return self

        def Eval(self, context):
            return np.zeros(1)

        def AdvanceTo(self, time):
            self.times.append(time)

        def AdvancePendingEvents(self):
            pass

    recorder = Recorder()
    fly(recorder, 2.0, check_interval=1.0, jumps=[jump])
    assert np.nextafter(jump, 0.0) in recorder.times
    assert recorder.times.index(jump) == recorder.times.index(np.nextafter(jump, 0.0)) + 1
