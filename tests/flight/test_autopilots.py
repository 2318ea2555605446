"""Tests of autopilots in flights: compiled and uncompiled, alone and in fleets, and with controllers of a user."""

import numpy as np
import pytest
from compiled_comparison import assert_flights_alike, assert_flown_alike, assert_metrics_alike
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.scenario.batch import Batch
from drake_quad.signals import AttitudeTarget, Reference, State


def uniform(low, high):
    return f"{{uniform: {{min: {low}, max: {high}}}}}"


DISTRIBUTIONS = [
    "vehicle.mass=" + uniform(0.66, 0.72),
    "laboratory.command_link.delay_ticks={choice: [0, 1, 3]}",
    "laboratory.wind=[{kind: dryden, level: light, intensity: 0.5}]",
    "seed=4",
]
GYROSCOPE_BIAS = ", ".join([uniform(-0.01, 0.01), uniform(-0.02, 0.01), "0.005"])  # rad/s
AUTOPILOT_OVERRIDES = {
    "attitude": [
        f"laboratory.autopilot.k_attitude=[{uniform(4, 6)}, 5.0, {uniform(3, 5)}]",
        f"laboratory.autopilot.k_rate=[12, {uniform(10, 13)}, 9]",
        f"laboratory.autopilot.gyroscope_bias=[{GYROSCOPE_BIAS}]",
        f"laboratory.autopilot.gyroscope_noise={uniform(0.0, 0.01)}",
        "laboratory.autopilot.attitude_noise=0.001",
    ],
    "response": [
        f"laboratory.autopilot={{kind: response, natural_frequency: [{uniform(6, 7)}, 6.3, {uniform(3, 4)}],"
        f" damping: [0.5, {uniform(0.4, 0.6)}, 0.9]}}",
        "control.position.feed_forward=acceleration",
        f"vehicle.battery_sag={uniform(0.0, 0.03)}",
    ],
}

for_each_autopilot = pytest.mark.parametrize("kind", AUTOPILOT_OVERRIDES)


@pytest.fixture
def scenario(diagrams):
    return lambda kind, *overrides: load_scenario(
        diagrams / "onboard.yaml", [*DISTRIBUTIONS, *AUTOPILOT_OVERRIDES[kind], *overrides]
    )


@pytest.mark.long
@for_each_autopilot
def test_compiled_uncompiled_and_single_flights_agree(scenario, kind):
    """The flights are bitwise equal. Each vehicle has its own parameters, noise and delay."""
    flights = assert_flown_alike(Batch.draw(scenario(kind, "duration=1"), range(3)))
    assert len({flight.metrics.rmse for flight in flights}) == 3
    for sample in (1, 2):
        alone = simulate(scenario(kind, "duration=1"), sample=sample, compiled=True)
        for name, values in alone.signals.items():
            np.testing.assert_array_equal(values, flights[sample][name], err_msg=name)


@pytest.mark.long
@for_each_autopilot
def test_a_later_batch_has_the_same_results_as_a_first_batch(scenario, kind):
    study = scenario(kind, "duration=0.5")
    plan = plan_route(study)
    fleet = StudyFleet(study, plan, 4)
    first = fleet.fly(range(4))
    fleet.fly(range(10, 14))
    assert_metrics_alike(fleet.fly(range(4)), first)
    assert_metrics_alike(StudyFleet(study, plan, 4, compiled=False).fly(range(4)), first)


@pytest.mark.long
@for_each_autopilot
def test_a_flight_with_an_autopilot_starts_in_hover_at_any_heading(scenario, kind):
    """Nothing moves before the first packet, since the initial target has the heading of the hovering vehicle."""
    overrides = ["vehicle.mass=0.68", "laboratory.wind=[]", "laboratory.command_link.delay_ticks=3"]
    route = "route={kind: hover, position: [1, 2, 1], yaw: 2.5, duration: 0.05}"
    bias = {"attitude": "laboratory.autopilot={gyroscope_bias: [0, 0, 0], gyroscope_noise: 0, attitude_noise: 0}"}
    flight = simulate(scenario(kind, *overrides, route, bias.get(kind, "vehicle.battery_sag=0")), sample=0)
    np.testing.assert_allclose(flight["state"] - flight["state"][0], 0.0, atol=1e-12)
    np.testing.assert_array_equal(flight["wrench"], np.tile([0.68 * 9.81, 0.0, 0.0, 0.0], (len(flight.time), 1)))


@pytest.mark.long
@for_each_autopilot
def test_a_vehicle_with_a_continuous_state_has_the_same_flight(scenario, kind):
    """The tolerance of 0.1 mm covers the discretization error of the vehicle with a time step."""
    positions = []
    for time_step in (0.0025, 0.0):
        flight = simulate(
            scenario(kind, "duration=1", f"vehicle.time_step={time_step}", "laboratory.wind=[]"), sample=2
        )
        positions.append(flight["state"][-1, 0:3])
    assert np.abs(positions[0] - flight["state"][0, 0:3]).max() > 0.02
    np.testing.assert_allclose(*positions, atol=1e-4)


def height_law(measurement: State, reference: Reference) -> AttitudeTarget:
    """Return the command of a height controller with a constant pitch of 0.1 rad."""
    thrust = 6.6708 + 4.0 * (reference.z - measurement.z) - 2.5 * measurement.v_z
    return AttitudeTarget(thrust, 0.0, 0.1, reference.yaw, 0.0, 0.0, 0.0)


@fleet_system(float)
class HeightOnly(FleetSystem):
    """User's control of the height as a FleetSystem, with the law `height_law`."""

    def declare(self) -> None:
        self.output("attitude_target", height_law, self.input("measurement"), self.input("reference"))


class PlainHeightOnly(LeafSystem):
    """User's control of the height as a plain LeafSystem of Drake, with the law `height_law`."""

    def __init__(self):
        super().__init__()
        self.ports = [
            self.DeclareVectorInputPort(name, BasicVector(size))
            for name, size in (("measurement", 12), ("reference", 11))
        ]
        self.DeclareVectorOutputPort("attitude_target", BasicVector(7), self.command)

    def command(self, context, output):
        measurement, reference = (port.Eval(context) for port in self.ports)
        output.SetFromVector(height_law(State(*measurement), Reference(*reference)))


@pytest.mark.long
@for_each_autopilot
def test_a_user_defined_control_can_command_the_autopilot(scenario, kind):
    """The vehicle pitches and flies along x, with the compiled FleetSystem and with the uncompiled LeafSystem."""
    study = scenario(kind, "duration=1", "laboratory.wind=[]", "vehicle.mass=0.68")
    flights = [
        simulate(study, sample=1, control=make_control(), compiled=compiled)
        for make_control, compiled in ((HeightOnly, False), (HeightOnly, True), (PlainHeightOnly, True))
    ]
    for other in flights[1:]:
        assert_flights_alike(other, flights[0])
    state = flights[0].record("state")
    assert state.pitch[-1] == pytest.approx(0.1, abs=0.03)
    assert state.x[-1] - state.x[0] > 0.2


def test_a_control_without_the_output_for_its_autopilot_is_refused(scenario):
    class Wrenches(LeafSystem):
        def __init__(self, name, size):
            super().__init__()
            self.DeclareVectorOutputPort(name, BasicVector(size), lambda context, output: None)

    study = scenario("attitude")
    for control, words in (
        (Wrenches("wrench", 4), "control must have the output port `attitude_target`, but has `wrench`"),
        (Wrenches("attitude_target", 4), "the port `attitude_target` of control must have 7 elements, but has 4"),
    ):
        with pytest.raises(InputError, match=words):
            simulate(study, sample=0, control=control)


def test_signals_are_exported_from_the_subsystems_that_compute_them(diagrams):
    diagram = build_tracking_diagram(load_scenario(diagrams / "onboard.yaml"))
    names = {diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())}
    assert {"attitude_target", "wrench", "attitude_command"} <= names
    laboratory, control = (diagram.GetSubsystemByName(name) for name in ("laboratory", "control"))
    assert laboratory.HasOutputPort("wrench")
    assert not control.HasOutputPort("wrench")
    assert not control.HasSubsystemNamed("attitude")
    assert laboratory.HasInputPort("attitude_target")


@pytest.mark.slow
def test_attitude_control_on_board_reduces_the_error_in_the_figure_eight(diagrams):
    """The loop on board has no link delay, so higher PD gains reduce the error to a quarter."""
    ground_scenario = load_scenario(
        diagrams / "laboratory.yaml:nominal", layers=[diagrams / "gains" / "laboratory.yaml"]
    )
    ground = simulate(ground_scenario, compiled=True)
    board = simulate(load_scenario(diagrams / "onboard.yaml"), compiled=True)
    assert not board.metrics.crashed
    assert board.metrics.rmse < 0.25 * ground.metrics.rmse
