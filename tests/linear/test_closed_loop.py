"""Tests of the closed loop at rest: equilibria, and Floquet multipliers that predict how deviations decay or grow."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import InitializeParams, Simulator

from drake_quad import InputError, build_tracking_diagram, load_scenario
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.flight.mission import plan_route
from drake_quad.linear import closed_loop as closed_loop_module
from drake_quad.linear.closed_loop import PASSIVE_SYSTEMS, closed_loop, common_period, laboratory_plant
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import tick_after
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.hovering import at_rest, nominal_hover
from drake_quad.vehicle.quadrotor import HoverPose


@pytest.fixture
def laboratory(diagrams):
    layers = [diagrams / "gains" / "laboratory.yaml"]
    return lambda *overrides: load_scenario(diagrams / "laboratory.yaml:nominal", overrides, layers=layers)


def fleet_after(scenario, start, equilibrium, deviations, end):
    """Return a fleet's deviations (n, N) from an equilibrium (n,) at a later tick, given the initial deviations."""
    n, N = deviations.shape
    single = ContextVector(build_tracking_diagram(scenario), excluded_systems=PASSIVE_SYSTEMS)
    fleet = build_fleet_diagram(Batch(scenario, (0,) * N, {}), plan_route(scenario))
    layout = ContextVector(fleet, excluded_systems=PASSIVE_SYSTEMS)
    # Both contexts have the same order of state groups. In a fleet, each component of a group has N elements.
    assert len(layout.names) == n * N
    assert len(single.names) == n
    simulator = Simulator(fleet)
    simulator.AdvanceTo(start)
    context = simulator.get_mutable_context()
    layout.write(fleet, context, (equilibrium[:, None] + deviations).ravel())
    parameters = InitializeParams()
    parameters.suppress_initialization_events = True
    simulator.Initialize(parameters)
    simulator.AdvanceTo(end)
    return layout.read(fleet, context).reshape(n, N) - equilibrium[:, None]


@pytest.mark.parametrize(
    ("overrides", "grows"),
    [
        ([], False),
        (["laboratory.wind=[{kind: steady, velocity: [2, 1, 0]}]"], False),
        (["control.position.k_p=[1.6, 1.6, 6]"], True),
        (["laboratory.motion_capture.period=0.04"], False),
        (["nominal.layout={kind: x}", "vehicle.layout={kind: x, length: 0.2, width: 0.29}"], False),
    ],
)
def test_eigenvalues_predict_how_deviations_from_the_equilibrium_decay_or_grow(laboratory, overrides, grows):
    """A deviation x_0 along a slow mode with eigenvalue z becomes z^k x_0 after k periods of the nonlinear diagram."""
    scenario = at_rest(laboratory(*overrides))
    loop = closed_loop(scenario)
    values, vectors = np.linalg.eig(loop.system.A)
    assert (np.abs(values).max() > 1.0) == grows
    size = np.abs(values) ** (0.02 / loop.system.period)
    slow_modes = [i for i, value in enumerate(values) if size[i] > 0.9 and value.imag >= 0.0]
    assert len(slow_modes) >= 6
    start = np.array([1e-5 * (vectors[:, i] / np.abs(vectors[:, i]).max()).real for i in slow_modes]).T
    periods = round(0.8 / loop.system.period)
    layout = ContextVector(loop.diagram, excluded_systems=PASSIVE_SYSTEMS)
    equilibrium = layout.read(loop.diagram, loop.context)
    begin = loop.context.get_time()
    later = fleet_after(scenario, begin, equilibrium, start, tick_after(begin, loop.system.period, periods))
    for column, i in enumerate(slow_modes):
        mode = 1e-5 * vectors[:, i] / np.abs(vectors[:, i]).max()
        expected = (mode * values[i] ** periods).real
        assert np.linalg.norm(later[:, column] - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_vehicle_in_wind_settles_at_an_offset_from_the_reference(laboratory, side):
    """The offset is D / (m k_P), and the tilt is atan(D / (m g)), where D is the drag.

    The time of the returned context is that of the fourth tick.
    """
    scenario = laboratory(f"laboratory.wind=[{{kind: steady, velocity: [{2.0 * side}, 0.0, 0.0]}}]")
    loop = closed_loop(scenario)
    assert loop.context.get_time() == 4 * 0.02
    state = loop.diagram.GetOutputPort("state").Eval(loop.context)
    drag = side * (0.1 * 2.0 + 0.01 * 4.0)
    assert state[0] == pytest.approx(drag / (0.68 * scenario.control.position.k_p[0]), rel=1e-9)
    assert np.tan(state[4]) == pytest.approx(-drag / (0.68 * 9.81), rel=1e-9)
    assert np.abs(loop.system.poles()).max() < 1.0


def test_at_rest_removes_random_and_transient_effects(diagrams):
    scenario = load_scenario(
        diagrams / "outdoor.yaml", ["vehicle.battery_sag=0.1", "vehicle.rotor_failure={rotor: 1, time: 1.0}"]
    )
    resting = at_rest(scenario)
    assert [source.kind for source in resting.laboratory.wind] == ["steady"]
    assert resting.laboratory.motion_capture.attitude_noise == 0.0
    assert (
        resting.laboratory.motion_capture.derivative_bandwidth
        == scenario.laboratory.motion_capture.derivative_bandwidth
    )
    assert resting.laboratory.command_link.loss_rate == 0.0
    assert (resting.vehicle.battery_sag, resting.vehicle.rotor_failure) == (0.0, None)
    assert resting.vehicle.linear_drag == 0.1
    nominal = nominal_hover(load_scenario(diagrams / "outdoor.yaml", ["vehicle.mass=0.8"]))
    assert (nominal.vehicle.mass, nominal.vehicle.linear_drag, nominal.laboratory.wind) == (0.68, 0.1, ())


def test_the_equilibrium_is_where_a_hover_route_hovers(laboratory):
    assert at_rest(laboratory("route={kind: hover, position: [0, -4, 1.5]}")).route.position == (0.0, -4.0, 1.5)
    assert at_rest(laboratory()).route.position == (0.0, 0.0, 1.0)
    assert nominal_hover(laboratory("route={kind: hover, yaw: 1}")).route.yaw == 0.0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("laboratory.motion_capture.period=0.04", "laboratory.motion_capture.period is 0.04 s, but must be at most"),
        ("vehicle.time_step=0", "vehicle.time_step is 0 s"),
        ("nominal.mass=3", "the rotors cannot fly this route"),
    ],
)
def test_a_laboratory_whose_plant_cannot_be_linearised_is_refused(laboratory, override, words):
    with pytest.raises(InputError, match=words):
        laboratory_plant(laboratory(override))


def test_the_plant_of_the_actual_vehicle_contains_its_mass_but_not_its_asymmetry(laboratory):
    """The gain from thrust to height is inversely proportional to the mass. Thrust does not tilt either vehicle."""
    flawed = ["vehicle.mass=0.85", "vehicle.centre_of_mass=[0.002, 0]", "vehicle.thrust_factor_error=[0.1, 0, 0, 0]"]
    gains = []
    for vehicle in ("nominal", "actual"):
        plant, specific_thrust = laboratory_plant(laboratory(*flawed), vehicle=vehicle)
        thrust = plant.between(["wrench.thrust"], ["measurement.z"])
        assert specific_thrust == pytest.approx(9.81 * (1.0 if vehicle == "nominal" else 0.85 / 0.68), rel=1e-12)
        gains.append(abs(thrust.response(np.exp([1j * 0.5 * 0.02]))[0, 0, 0]))
        rolled = plant.between(["wrench.thrust"], ["measurement.roll", "measurement.pitch"])
        np.testing.assert_allclose(rolled.response(np.exp([1j * 0.5 * 0.02])), 0.0, atol=1e-12)
    # The height responds to thrust like a mass m with the linear drag d = 0.1 N s/m. The gain is inversely proportional
    # to hypot(m, d / ω). At 0.5 rad/s, d / ω is 0.2 kg.
    assert gains[0] / gains[1] == pytest.approx(np.hypot(0.85, 0.2) / np.hypot(0.68, 0.2), rel=1e-3)


@pytest.mark.slow
def test_a_missing_equilibrium_is_reported(laboratory):
    strong_wind = "laboratory.wind=[{kind: steady, velocity: [60, 0, 0]}]"
    with pytest.raises(InputError, match="has no equilibrium near hover: .* still changes by"):
        closed_loop(laboratory(strong_wind))
    with pytest.raises(InputError, match="vehicle.mass is a distribution"):
        closed_loop(laboratory("vehicle.mass={choice: [0.6, 0.7]}"))


def test_small_displacements_match_the_linear_model(laboratory):
    loop = closed_loop(nominal_hover(laboratory()))
    for row in ("x", "z", "yaw"):
        response = initial_response(loop, {row: 1e-4}, duration=4.0)
        np.testing.assert_allclose(response.nonlinear, response.linear, atol=1e-7)
        column = ("x", "y", "z", "roll", "pitch", "yaw").index(row)
        assert response.linear[0, column] == pytest.approx(1e-4)
        assert abs(response.linear[-1, column]) < 0.3e-4
    with pytest.raises(InputError, match="cannot displace height"):
        initial_response(loop, {"height": 1e-4}, duration=1.0)
    # A large displacement differs from the linear model, because the tilt is limited.
    response = initial_response(loop, {"x": 40.0}, duration=4.0)
    assert np.abs(response.nonlinear - response.linear)[:, 0].max() > 1.0


def test_an_initial_response_is_a_flight_that_starts_at_an_offset_from_the_reference(laboratory):
    """The cameras measure the displacement from their first frame on, with or without latency."""
    offset = {"x": 0.3, "y": -0.2, "z": 0.1, "yaw": -0.4}
    for latency in (0, 2):
        scenario = nominal_hover(laboratory(f"laboratory.motion_capture.latency_frames={latency}"))
        deviations = initial_response(closed_loop(scenario), offset, duration=1.0).nonlinear
        diagram = build_tracking_diagram(scenario)
        simulator = Simulator(diagram)
        vehicle = diagram.GetSubsystemByName("laboratory").GetSubsystemByName("vehicle")
        context = vehicle.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        vehicle.set_hover(context, HoverPose(0.3, -0.2, 1.1, -0.4))
        simulator.Initialize()
        equilibrium = np.array([0.0, 0.0, 1.0] + [0.0] * 9)
        for tick, deviation in enumerate(deviations):
            if tick:
                simulator.AdvanceTo(tick * 0.02)
            state = vehicle.GetOutputPort("state").Eval(context)
            np.testing.assert_allclose(state - equilibrium, deviation, atol=1e-9)
        assert np.abs(deviations[-1, 0:3] - deviations[0, 0:3]).min() > 1e-3


def test_a_scenario_with_a_distribution_has_no_linear_model():
    scenario = load_scenario("diagrams/hover.yaml", ["vehicle.mass={uniform: {min: 0.6, max: 0.7}}"])
    with pytest.raises(InputError, match="vehicle.mass is a distribution, but the analysis of hover needs a number"):
        closed_loop(scenario)


def test_at_rest_removes_position_limits_and_the_metrics_cover_the_whole_flight(laboratory):
    scenario = laboratory("duration=3", "metrics.start=1", "crash.position_error=0.1", "crash.tilt=0.5")
    resting = at_rest(scenario.model_copy(update={"sample": 4}))
    assert (resting.sample, resting.duration) == (None, None)
    assert resting.metrics == type(resting.metrics)()
    assert resting.crash.position_error > 1e5
    assert resting.crash.height < -1e5
    assert resting.crash.tilt == 0.5
    cameras = resting.laboratory.motion_capture
    assert (cameras.position_noise, cameras.attitude_noise, cameras.dropout_rate) == (0.0, 0.0, 0.0)


def test_at_rest_keeps_a_fan_s_steady_wind_but_not_its_turbulence(laboratory):
    fan = "{kind: fan, position: [-2, 0, 1], direction: [1, 0, 0], flow: 2, diameter: 0.7, turbulence: 0.3}"
    scenario = laboratory(f"laboratory.wind=[{fan}, {{kind: steady, velocity: [1, 0, 0]}}]")
    kept_fan, steady = at_rest(scenario).laboratory.wind
    assert kept_fan == scenario.laboratory.wind[0].model_copy(update={"turbulence": 0.0})
    assert steady == scenario.laboratory.wind[1]


def test_at_rest_replaces_a_random_route_by_hover_at_a_height_of_one_metre(laboratory):
    random_scenario = laboratory("route={kind: hover, position: [0, 0, {uniform: {min: 1, max: 2}}]}")
    assert at_rest(random_scenario).route.position == (0.0, 0.0, 1.0)


def test_the_nominal_vehicle_has_the_lag_and_the_drag_of_the_actual_one(laboratory):
    flawed = ["vehicle.mass=0.85", "vehicle.rotor_time_constant=0.07", "vehicle.quadratic_drag=0.03"]
    uneven = ["vehicle.centre_of_mass=[0.002, 0]", "laboratory.motion_capture.misalignment=[0.01, 0.02, 0.03]"]
    nominal = nominal_hover(laboratory(*flawed, *uneven, "vehicle.time_step=0.005", "nominal.thrust_factor=4.2e-5"))
    vehicle = nominal.vehicle
    assert (vehicle.mass, vehicle.thrust_factor, vehicle.time_step) == (0.68, 4.2e-5, 0.005)
    assert (vehicle.rotor_time_constant, vehicle.linear_drag, vehicle.quadratic_drag) == (0.07, 0.1, 0.03)
    assert vehicle.centre_of_mass == (0.0, 0.0)
    assert nominal.laboratory.motion_capture.misalignment == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ("max_rotor_speed=190", "at 201 rad/s, not at 60 to 190 rad/s"),
        ("min_rotor_speed=210", "at 201 rad/s, not at 210 to 300 rad/s"),
    ],
)
def test_a_vehicle_that_its_rotors_cannot_lift_has_no_plant(laboratory, limit, words):
    with pytest.raises(InputError, match=f"the rotors cannot hold nominal in hover: they would turn {words}"):
        laboratory_plant(laboratory(f"vehicle.{limit}"), vehicle="actual")


def test_the_states_of_the_rotors_are_thrust_and_three_torques(laboratory):
    """From one tick to the next, each of these states acts only on its own axis."""
    plant, _ = laboratory_plant(laboratory())
    names = [f"vehicle.rotors.{name}" for name in ("thrust", "tau_x", "tau_y", "tau_z")]
    for name, row in zip(names, ("v_z", "p", "q", "r"), strict=True):
        column = plant.A[:, plant.states.index(name)]
        assert column[plant.states.index(f"vehicle.state.{row}")] > 0.0
        others = [f"vehicle.state.{other}" for other in ("v_z", "p", "q", "r") if other != row]
        np.testing.assert_allclose(column[[plant.states.index(other) for other in others]], 0.0, atol=1e-12)
        decay = column[[plant.states.index(other) for other in names]]
        np.testing.assert_allclose(decay, np.exp(-0.4) * np.array([other == name for other in names]), atol=1e-3)
    assert plant.inputs == ("wrench.thrust", "wrench.tau_x", "wrench.tau_y", "wrench.tau_z")
    assert plant.period == 0.02


ARBITRARY_LAYOUT = (
    "{kind: rotors, rotors: [{position: [0.14, -0.11, 0.02], turns: clockwise},"
    "{position: [-0.09, -0.13, 0.01], turns: anticlockwise, thrust_factor: 4.1e-5},"
    "{position: [-0.13, 0.10, 0.0], turns: clockwise, drag_factor: 8.2e-7},"
    "{position: [0.11, 0.14, 0.03], turns: anticlockwise}]}"
)


@pytest.mark.parametrize("layout", ["{kind: x}", "{kind: h, length: 0.2, width: 0.3}", ARBITRARY_LAYOUT])
def test_the_plant_of_a_nominal_vehicle_does_not_depend_on_its_layout(laboratory, layout):
    """The allocation makes the wrench independent of the layout, so the response equals that of a plus layout."""
    plus, _ = laboratory_plant(laboratory())
    plant, specific_thrust = laboratory_plant(laboratory(f"nominal.layout={layout}"))
    assert specific_thrust == pytest.approx(9.81, rel=1e-12)
    points = np.exp(1j * 0.02 * np.array([0.5, 3.0, 20.0, 100.0]))
    scale = np.abs(plus.response(points)).max(axis=(0, 1))
    difference = np.abs(plant.response(points) - plus.response(points)).max(axis=(0, 1))
    np.testing.assert_array_less(difference, 1e-9 * scale + 1e-9)
    # Each transformed rotor state affects only the quantity after which it is named.
    rates = [plant.states.index(f"vehicle.state.{row}") for row in ("v_z", "p", "q", "r")]
    rotors = [plant.states.index(f"vehicle.rotors.{name}") for name in ("thrust", "tau_x", "tau_y", "tau_z")]
    entries = plant.A[np.ix_(rates, rotors)]
    assert (np.diag(entries) > 0.0).all()
    np.testing.assert_allclose(entries, np.diag(np.diag(entries)), atol=1e-9 * entries.max())


def test_arms_longer_than_nominal_increase_the_gain_of_roll_and_pitch(laboratory):
    """In an X layout, the roll gain increases with the width, and the pitch gain with the length.

    The yaw gain does not change.
    """
    scenario = laboratory(
        "nominal.layout={kind: x, length: 0.2, width: 0.3}", "vehicle.layout={kind: x, length: 0.22, width: 0.36}"
    )
    nominal, actual = (laboratory_plant(scenario, vehicle=vehicle).system for vehicle in ("nominal", "actual"))
    point = np.exp([1j * 3.0 * 0.02])
    for torque, angle, gain in (("tau_x", "roll", 1.2), ("tau_y", "pitch", 1.1), ("tau_z", "yaw", 1.0)):
        gains = [
            plant.between([f"wrench.{torque}"], [f"measurement.{angle}"]).response(point)[0, 0, 0]
            for plant in (nominal, actual)
        ]
        assert gains[1] / gains[0] == pytest.approx(gain, rel=1e-9)


def stub_linearize(monkeypatch, changes, **entries):
    """Replace `linearize` with a stub, and return a list that gets one element at each call of the stub.

    Args:
        changes: changes of the first states over a period, which the stub returns; the other changes are zero.
        entries: `A=number` replaces the first element of the matrix A that the stub returns.
    """
    linearize, calls = closed_loop_module.linearize, []

    def linearize_with_given_changes(*arguments, **options):
        system, state_changes = linearize(*arguments, **options)
        calls.append(1)
        state_changes[:] = 0.0
        state_changes[: len(changes)] = changes
        system.A[0, 0] = entries.get("A", system.A[0, 0])
        return system, state_changes

    monkeypatch.setattr(closed_loop_module, "linearize", linearize_with_given_changes)
    return calls


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([1e-10, -2e-9, 1.5e-9], "changes by -2e-09 per"),
        ([1e-10, 1.5e-9, 3e-9], "changes by 3e-09 per"),
        ([9e-10, -9e-10], None),
    ],
)
def test_the_state_of_an_equilibrium_changes_by_less_than_a_billionth(laboratory, monkeypatch, changes, words):
    stub_linearize(monkeypatch, changes)
    scenario = laboratory()
    if words is None:
        closed_loop(scenario)
        laboratory_plant(scenario)
        return
    index = 1 if changes[1] < 0.0 else 2
    names = ContextVector(build_tracking_diagram(scenario), excluded_systems=PASSIVE_SYSTEMS).names
    with pytest.raises(InputError, match=rf"no equilibrium near hover: {names[index]} still {words}"):
        closed_loop(scenario)
    with pytest.raises(InputError, match=rf"hover is not an equilibrium of nominal: \S+ {words}"):
        laboratory_plant(scenario)


@pytest.mark.parametrize(
    ("changes", "entries", "num_calls"),
    [([1e-3], {}, 20), ([1e-3, np.inf], {}, 1), ([np.nan, 1e-3], {}, 1), ([1e-3], {"A": np.nan}, 1)],
)
def test_newton_s_method_stops_at_values_that_are_not_finite(laboratory, monkeypatch, changes, entries, num_calls):
    """If all values are finite, the method fails after twenty steps. A second search starts after a flight."""
    calls = stub_linearize(monkeypatch, changes, **entries)
    with pytest.raises(InputError, match="no equilibrium near hover"):
        closed_loop(laboratory())
    assert len(calls) == 2 * num_calls


@pytest.mark.parametrize(
    ("name", "period"), [("laboratory:nominal", 0.02), ("outdoor_gnss", 0.08), ("indoor_flow", 0.16)]
)
def test_the_period_of_a_loop_is_the_least_common_multiple_of_its_periods(name, period):
    """In indoor_flow, the range finder has a period of 32 ms, and the slow loops of the cascade one of 10 ms."""
    assert common_period(load_scenario(name)) == pytest.approx(period, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("first", ["unstable", "none"])
def test_an_equilibrium_is_also_sought_from_a_flight_if_no_stable_one_is_found(laboratory, monkeypatch, first):
    scenario = laboratory()
    stable = closed_loop(scenario)
    unstable = stable._replace(system=replace(stable.system, A=1.1 * np.eye(len(stable.system.A))))
    results, times = [(None if first == "none" else unstable, 5, "x changes"), (stable, 1, "")], []

    def stub(diagram, context, period, **ports):
        times.append(context.get_time())
        return results[len(times) - 1]

    monkeypatch.setattr(closed_loop_module, "_by_newtons_method", stub)
    assert closed_loop(scenario) is stable
    assert times[1] - times[0] == pytest.approx(20.0)
    times.clear()
    results[1] = (None, 20, "")
    if first == "unstable":
        assert closed_loop(scenario) is unstable
    else:
        with pytest.raises(InputError, match="no equilibrium near hover: x changes"):
            closed_loop(scenario)
