"""Fleets of any size, batch after batch, in one compiled diagram."""

import numpy as np
import pytest
from both_ways import assert_flights_alike, assert_flown_alike, assert_metrics_alike

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
    """A fifth of a second of the study of robustness."""
    return load_scenario(diagrams / "robustness.yaml", ["duration=0.2"])


@pytest.fixture(scope="module")
def plan(study):
    return plan_route(study)


@pytest.fixture(scope="module")
def wired(study, plan):
    """The metrics of a thousand samples, in a diagram as it is wired."""
    return StudyFleet(study, plan, 1000, compiled=False).fly(range(1000))


def part(metrics, samples):
    return type(metrics)(*(values[samples] for values in metrics))


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 7, 8, 9, 1000])
def test_a_fleet_of_any_size_flies_as_wired(study, plan, wired, n):
    samples = range(1000 - n, 1000)
    found = StudyFleet(study, plan, n).fly(samples)
    assert_metrics_alike(found, part(wired, samples))


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 9, 40])
def test_a_recorded_fleet_of_any_size_flies_as_wired(study, plan, n):
    assert_flown_alike(Batch.draw(study, range(3, 3 + n)), plan=plan)


@pytest.mark.slow
def test_a_vehicle_of_a_compiled_fleet_flies_as_it_does_alone_to_the_bit(study, plan):
    fleet = simulate_samples(study, range(9), plan=plan, compiled=True)
    for sample in (0, 8):
        alone = simulate(study, sample=sample, plan=plan, compiled=True)
        for name, values in alone.signals.items():
            np.testing.assert_array_equal(fleet[sample][name], values, err_msg=name)
        assert fleet[sample].metrics == alone.metrics


@pytest.mark.slow
def test_nothing_of_a_batch_is_left_in_the_next_one(study, plan, wired):
    """Nor of another duration, nor of a batch that had fewer samples than there are vehicles."""
    fleet = StudyFleet(study, plan, 9)
    first = fleet.fly(range(9))
    assert_metrics_alike(first, part(wired, range(9)))
    assert_metrics_alike(fleet.fly([500, 20]), part(wired, [500, 20]))
    short = fleet.fly(range(9), duration=0.1)
    assert not np.any(short.rmse == first.rmse)
    assert_metrics_alike(fleet.fly(range(100, 109)), part(wired, range(100, 109)))
    for found, expected in zip(fleet.fly(range(9)), first, strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
def test_a_recorded_fleet_that_is_reset_has_recorded_nothing_yet(study, plan):
    """Another flight of the same batch leaves the same record, and no more."""
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
    """However many ticks an event takes, which are a hundred in a fleet."""
    study = load_scenario(diagrams / "figure_eight.yaml", [f"duration={duration}"])
    flights = assert_flown_alike(Batch.draw(study, [0, 1]))
    assert [flight.time[-1] for flight in flights] == [duration, duration]


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2])
def test_cameras_that_are_slower_than_the_control_leave_its_ticks_as_they_are(diagrams, n):
    """It ends, and is recorded, between two frames as well."""
    study = load_scenario(
        diagrams / "figure_eight.yaml", ["duration=0.42", "laboratory.motion_capture.period=0.08", "metrics.start=0.1"]
    )
    for flight in assert_flown_alike(Batch.draw(study, range(n))):
        np.testing.assert_allclose(flight.time, 0.02 * np.arange(22), rtol=1e-12)


@pytest.mark.slow
def test_a_flight_ends_when_the_last_vehicle_has_crashed(diagrams):
    """It is looked at after each stride, which is longer in compiled diagrams: the metrics are those of the crash."""
    mass = "vehicle.mass={uniform: {min: 0.66, max: 0.67}}"
    study = load_scenario(diagrams / "figure_eight.yaml", ["duration=5", "crash.position_error=0.03", mass])
    flown = []
    metrics = StudyFleet(study, plan_route(study), 9).fly(range(9), progress=lambda time, _: flown.append(time))
    assert flown[-1] < 5.0
    assert (metrics.crash_time < flown[-1]).all()
    assert_metrics_alike(metrics, StudyFleet(study, plan_route(study), 9, compiled=False).fly(range(9)))
    assert flight_duration(study, plan_route(study)) == 5.0


def command(held, reference, measurement):
    """A PD on what is measured now and at the last tick of one's own."""
    return Acceleration(
        2.0 * (reference.x - held.x) + 2.5 * (reference.v_x - measurement.v_x),
        2.0 * (reference.y - held.y) + 2.5 * (reference.v_y - measurement.v_y),
        5.0 * (reference.z - held.z) + 3.0 * (reference.v_z - measurement.v_z),
    )


@fleet_system(float)
class Slow(FleetSystem):
    """A position controller with a period of its own."""

    def declare(self, *, period):
        measurement, reference = self.input("measurement"), self.input("reference")
        held = self.state("held", lambda _: State(*[0.0] * 12))
        self.update(period, lambda measurement: measurement, measurement, writes=[held])
        self.output("acceleration_command", command, held, reference, measurement)


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.03, 0.04])
def test_a_controller_that_is_compiled_may_have_a_period_of_its_own(diagrams, period):
    """The flight still ends, and is recorded, at the ticks of the control."""
    study = load_scenario(diagrams / "figure_eight.yaml", ["duration=0.26"])
    flights = [
        simulate(study, position_controller=Slow(period=period), compiled=compiled) for compiled in (True, False)
    ]
    assert_flights_alike(*flights)
    assert len(flights[0].time) == 14


def test_a_controller_whose_period_does_not_fit_is_refused(diagrams):
    study = load_scenario(diagrams / "hover.yaml")
    with pytest.raises(InputError, match=r"^\S+ cannot be compiled: its period, 0.015 s, is not a multiple of 0.01 s$"):
        simulate(study, position_controller=Slow(period=0.015), compiled=True)


def test_a_continuous_vehicle_is_refused(diagrams):
    study = load_scenario(diagrams / "hover.yaml", ["vehicle.time_step=0"])
    with pytest.raises(InputError, match=r"^laboratory.vehicle, a Quadrotor, cannot be compiled: its state is contin"):
        simulate(study, compiled=True)
