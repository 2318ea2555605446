"""Tests that a non-finite number ends a flight at its tick, and that the report names system, port and time."""

import re
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import load_scenario, read_flight, run_monte_carlo, simulate
from drake_quad.flight.cause import non_finite_value
from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.framework.formulas import TIME
from drake_quad.signals import Acceleration, Wrench

# First control tick at which the user's system returns a non-finite number, s.
FAILURE_TIME = 0.3
# Number of components of each signal that the user's system may return.
NUM_COMPONENTS = {"acceleration_command": 3, "wrench": 4, "attitude_target": 7, "wind": 3}


class Broken(LeafSystem):
    """A system in plain Python that holds a hover until the second component of its output becomes non-finite."""

    def __init__(self, signal, value=np.nan, num_vehicles=1, weight=0.68 * 9.81):
        super().__init__()
        n = num_vehicles
        rows = NUM_COMPONENTS[signal]

        def write_output(context, output):
            values = np.zeros((rows, n))
            values[0] = weight if signal in ("wrench", "attitude_target") else 0.0
            values[1] = value if context.get_time() >= FAILURE_TIME else 0.0
            output.SetFromVector(values.ravel())

        if signal != "wind":
            self.DeclareVectorInputPort("measurement", BasicVector(12 * n))
            self.DeclareVectorInputPort("reference", BasicVector(11 * n))
        self.DeclareVectorOutputPort(signal, BasicVector(rows * n), write_output)


@fleet_system(float)
class BrokenFormula(FleetSystem):
    """A controller with the same behaviour as `Broken`, written as a formula, which is compiled."""

    def declare(self, *, wrench=False):
        reads = self.input("measurement"), self.input("reference"), TIME
        if wrench:
            self.output("wrench", lambda m, r, time: Wrench(0.68 * 9.81, nan_after_failure(time), 0.0, 0.0), *reads)
        else:
            self.output(
                "acceleration_command", lambda m, r, time: Acceleration(0.0, nan_after_failure(time), 0.0), *reads
            )


def nan_after_failure(time):
    return where(time >= FAILURE_TIME - 1e-9, float("nan"), 0.0)


# Each case has a scenario, the part of the loop that a user-defined system replaces, and the signal and the component
# that become non-finite.
FAILING_OUTPUTS = [
    ("hover", "position_controller", "acceleration_command", "y"),
    ("hover", "control", "wrench", "tau_x"),
    ("onboard", "control", "attitude_target", "roll"),
    ("hover", "wind", "wind", "y"),
]


@pytest.mark.long
@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize(("value", "word"), [(np.nan, "nan"), (np.inf, "infinite")])
@pytest.mark.parametrize(("spec", "part", "signal", "row"), FAILING_OUTPUTS)
def test_the_report_names_the_non_finite_output_of_a_user_system(spec, part, signal, row, value, word, compiled):
    scenario = load_scenario(spec, ["route={kind: hover, position: [0, 0, 1], duration: 0.6}"])
    flight = simulate(scenario, **{part: Broken(signal, value)}, compiled=compiled)
    # Wind affects the state only at the next tick, at which the monitor reads the state.
    crash_time = FAILURE_TIME if signal != "wind" else FAILURE_TIME + 0.02
    assert flight.metrics.crash_time == pytest.approx(crash_time)
    assert flight.cause == f"{part} returned {word} in {row} of `{signal}` at {crash_time:.2f} s"
    assert f"crashed at {crash_time:.2f} s, since {flight.cause}" in repr(flight)
    assert flight.time[-1] < crash_time
    assert all(np.isfinite(values).all() for values in flight.signals.values())


# Each case has the first non-finite tick of each signal, the names of user-defined systems, and the expected cause.
FIRST_CAUSES = [
    ({"acceleration_command": 3, "wrench": 2}, (), "tau_x of `wrench` was nan at 0.04 s"),
    ({"wrench": 2, "acceleration_command": 2}, (), "y of `acceleration_command` was nan at 0.04 s"),
    ({"acceleration_command": 1, "reference": 1}, (), "y of `reference` was nan at 0.02 s"),
    ({"rotor_speed_command": 0, "wrench": 0}, (), "tau_x of `wrench` was nan at 0.00 s"),
    ({"wrench": 1, "state": 2}, ("control",), "control returned nan in tau_x of `wrench` at 0.02 s"),
    ({"wrench": 1}, ("position_controller",), "tau_x of `wrench` was nan at 0.02 s"),
    ({"weights": 1}, (), "row 2 of `weights` was nan at 0.02 s"),
    ({"state": 1, "wrench": 1}, ("control",), None),
    ({}, ("control",), None),
]


@pytest.mark.parametrize(("failures", "user_systems", "sentence"), FIRST_CAUSES)
def test_the_cause_of_a_crash_is_the_signal_that_was_non_finite_first(failures, user_systems, sentence):
    """Signals are recorded in the order of their computation, except for the signals of the vehicle."""
    rows = {
        "acceleration_command": 3,
        "wrench": 4,
        "weights": 6,
        "rotor_speed_command": 4,
        "state": 12,
        "reference": 11,
    }
    signals = {name: np.zeros((4, rows[name])) for name in rows}
    for name, tick in failures.items():
        signals[name][tick:, 1:] = np.nan
    assert non_finite_value(0.02 * np.arange(4), signals, dict.fromkeys(user_systems)) == sentence


@pytest.mark.slow
@pytest.mark.parametrize("wrench", [False, True])
def test_interpreted_and_compiled_formulas_report_the_same_cause(wrench):
    scenario = load_scenario("hover", ["duration=0.6"])
    part = "control" if wrench else "position_controller"
    flights = [simulate(scenario, **{part: BrokenFormula(wrench=wrench)}, compiled=each) for each in (False, True)]
    causes = {flight.cause for flight in flights}
    assert len(causes) == 1
    assert re.fullmatch(rf"{part} returned nan in \w+ of `\w+` at {FAILURE_TIME:.2f} s", causes.pop())


@pytest.mark.slow
def test_the_cause_of_a_crash_survives_a_round_trip_through_files(tmp_path):
    scenario = load_scenario("hover", ["duration=0.6"])
    flight = simulate(scenario, position_controller=Broken("acceleration_command"))
    flight.save(tmp_path)
    assert read_flight(tmp_path).cause == flight.cause
    assert repr(read_flight(tmp_path)) == repr(flight)


@pytest.mark.slow
def test_a_crash_with_finite_signals_has_no_reported_cause():
    """The vehicle diverges without damping, and turns over with a gain of 1e9. All signals are finite."""
    off_centre = ["vehicle.centre_of_mass=[0.01, 0]", "duration=20"]
    for gains in ("{k_p: [2, 2, 2], k_d: [0, 0, 0]}", "{k_p: [1e9, 1e9, 1], k_d: [1, 1, 1]}"):
        scenario = load_scenario("hover", [*off_centre, f"control.position={gains}"])
        flight = simulate(scenario, compiled=True)
        assert flight.metrics.crashed
        assert flight.cause is None
        assert np.isfinite(flight.metrics.rmse)


def make_broken(num_vehicles):
    return Broken("acceleration_command", num_vehicles=num_vehicles)


def make_sound(num_vehicles):
    return Broken("acceleration_command", 0.0, num_vehicles=num_vehicles)


@pytest.mark.slow
def test_a_study_warns_of_non_finite_numbers_and_counts_crashes():
    scenario = load_scenario("hover", ["duration=0.6"])
    message = r"^sample 0: position_controller returned nan in y of `acceleration_command` at 0.30 s; flights with such"
    # The study runs in a thread, because forked worker processes would warn about threads that other tests started.
    thread = ThreadPoolExecutor(1)
    with pytest.warns(UserWarning, match=message):
        study = run_monte_carlo(scenario, 2, executor=thread, position_controller=make_broken)
    assert study.metrics.crash_time == pytest.approx([FAILURE_TIME, FAILURE_TIME])
    assert np.isfinite(np.array(study.metrics)).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not run_monte_carlo(scenario, 2, executor=thread, position_controller=make_sound).metrics.crashed.any()
