"""Tests of fleets of different sizes and of consecutive batches in one compiled diagram."""

import numpy as np
import pytest
from compiled_comparison import assert_flights_alike, assert_flown_alike, assert_metrics_alike

from drake_quad import InputError, load_scenario, simulate
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import Batch
from drake_quad.signals import Acceleration, State


@pytest.fixture(scope="module")
def study(diagrams):
    """Return the first 0.2 s of the robustness scenario, without its network, so that it is compiled faster."""
    return load_scenario(diagrams / "robustness.yaml", ["duration=0.2"], layers=["controllers/paper:pd"])


@pytest.fixture(scope="module")
def plan(study):
    return plan_route(study)


@pytest.fixture(scope="module")
def uncompiled_metrics(study, plan):
    """Return the metrics of 1,000 samples in the uncompiled diagram."""
    return StudyFleet(study, plan, 1000, compiled=False).fly(range(1000))


def part(metrics, samples):
    return type(metrics)(*(values[samples] for values in metrics))


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 7, 8, 9, 1000])
def test_a_fleet_of_any_size_has_the_metrics_of_the_uncompiled_diagram(study, plan, uncompiled_metrics, n):
    samples = range(1000 - n, 1000)
    actual = StudyFleet(study, plan, n).fly(samples)
    assert_metrics_alike(actual, part(uncompiled_metrics, samples))


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 9, 40])
def test_a_recorded_fleet_of_any_size_has_the_signals_of_the_uncompiled_diagram(study, plan, n):
    assert_flown_alike(Batch.draw(study, range(3, 3 + n)), plan=plan)


@pytest.mark.long
def test_flights_of_a_vehicle_alone_and_in_a_compiled_fleet_are_bitwise_equal(study, plan):
    fleet = simulate_samples(study, range(9), plan=plan, compiled=True)
    for sample in (0, 8):
        single = simulate(study, sample=sample, plan=plan, compiled=True)
        for name, values in single.signals.items():
            np.testing.assert_array_equal(fleet[sample][name], values, err_msg=name)
        assert fleet[sample].metrics == single.metrics


@pytest.mark.slow
def test_a_batch_of_samples_does_not_affect_the_next_one(study, plan, uncompiled_metrics):
    """The batches have different durations, and some have fewer samples than the fleet has vehicles."""
    fleet = StudyFleet(study, plan, 9)
    first = fleet.fly(range(9))
    assert_metrics_alike(first, part(uncompiled_metrics, range(9)))
    assert_metrics_alike(fleet.fly([500, 20]), part(uncompiled_metrics, [500, 20]))
    short = fleet.fly(range(9), duration=0.1)
    assert not np.any(short.rmse == first.rmse)
    assert_metrics_alike(fleet.fly(range(100, 109)), part(uncompiled_metrics, range(100, 109)))
    for actual, expected in zip(fleet.fly(range(9)), first, strict=True):
        np.testing.assert_array_equal(actual, expected)


@pytest.mark.slow
def test_a_reset_deletes_the_recorded_signals(study, plan):
    """A second flight of the same batch records bitwise equal signals."""
    batch = Batch.draw(study, range(9))
    simulation = simulate_fleet(batch, plan, record=True, compiled=True)
    records = []
    for _ in range(2):
        simulation.fly(0.2)
        records.append(simulation.recording())
        simulation.reset(batch)
    (time, signals), (again, same) = records
    np.testing.assert_array_equal(time, again)
    for name, values in signals.items():
        assert values.shape[0] == 11
        np.testing.assert_array_equal(same[name], values)


@pytest.mark.slow
@pytest.mark.parametrize("duration", [0.02, 0.14, 2.0, 2.02])
def test_a_flight_ends_at_its_last_tick(diagrams, duration):
    """The last tick does not depend on the number of ticks that an event simulates, which is 100 for a fleet."""
    study = load_scenario(diagrams / "figure_eight.yaml", [f"duration={duration}"])
    flights = assert_flown_alike(Batch.draw(study, [0, 1]))
    assert [flight.time[-1] for flight in flights] == [duration, duration]


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2])
def test_slower_cameras_do_not_change_the_ticks_of_the_control(diagrams, n):
    """The flight is recorded, and can end between two camera frames."""
    study = load_scenario(
        diagrams / "figure_eight.yaml", ["duration=0.42", "laboratory.motion_capture.period=0.08", "metrics.start=0.1"]
    )
    for flight in assert_flown_alike(Batch.draw(study, range(n))):
        np.testing.assert_allclose(flight.time, 0.02 * np.arange(22), rtol=1e-12)


@pytest.mark.slow
def test_a_flight_ends_when_the_last_vehicle_has_crashed(diagrams):
    """Compiled diagrams check for crashes less often, but their metrics end at the time of the crash."""
    mass = "vehicle.mass={uniform: {min: 0.66, max: 0.67}}"
    study = load_scenario(diagrams / "figure_eight.yaml", ["duration=5", "crash.position_error=0.03", mass])
    flown = []
    metrics = StudyFleet(study, plan_route(study), 9).fly(range(9), progress=lambda time, _: flown.append(time))
    assert flown[-1] < 5.0
    assert (metrics.crash_time < flown[-1]).all()
    assert_metrics_alike(metrics, StudyFleet(study, plan_route(study), 9, compiled=False).fly(range(9)))
    assert flight_duration(study, plan_route(study)) == 5.0


def command(held, reference, measurement):
    """Return the command of a PD that uses the current and the previous measurements."""
    return Acceleration(
        2.0 * (reference.x - held.x) + 2.5 * (reference.v_x - measurement.v_x),
        2.0 * (reference.y - held.y) + 2.5 * (reference.v_y - measurement.v_y),
        5.0 * (reference.z - held.z) + 3.0 * (reference.v_z - measurement.v_z),
    )


@fleet_system(float)
class SlowPd(FleetSystem):
    """Position controller whose period differs from the control period."""

    def declare(self, *, period):
        measurement, reference = self.input("measurement"), self.input("reference")
        held = self.state("held", lambda _: State(*[0.0] * 12))
        self.update(period, lambda measurement: measurement, measurement, writes=[held])
        self.output("acceleration_command", command, held, reference, measurement)


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.03, 0.04])
def test_a_compiled_position_controller_can_have_another_period_than_the_command_link(diagrams, period):
    """The flight is recorded every 20 ms, the period of the command link, and ends at such a time."""
    study = load_scenario(diagrams / "figure_eight.yaml", ["duration=0.26"])
    flights = [
        simulate(study, position_controller=SlowPd(period=period), compiled=compiled) for compiled in (True, False)
    ]
    assert_flights_alike(*flights)
    assert len(flights[0].time) == 14


def test_a_controller_whose_period_does_not_match_the_other_periods_is_refused(diagrams):
    study = load_scenario(diagrams / "hover.yaml")
    with pytest.raises(InputError, match=r"^\S+ cannot be compiled: its period, 0.015 s, is not a multiple of 0.01 s$"):
        simulate(study, position_controller=SlowPd(period=0.015), compiled=True)


def test_a_vehicle_with_a_continuous_state_cannot_be_compiled(diagrams):
    study = load_scenario(diagrams / "hover.yaml", ["vehicle.time_step=0"])
    with pytest.raises(InputError, match=r"^laboratory.vehicle, a Quadrotor, cannot be compiled: its state is contin"):
        simulate(study, compiled=True)
