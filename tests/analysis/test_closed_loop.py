"""The loop at rest: equilibria, and multipliers that tell how the diagram itself decays or grows."""

import numpy as np
import pytest
from pydrake.systems.analysis import InitializeParams, Simulator

from drake_quad import InputError, build_tracking_diagram, load_scenario
from drake_quad.analysis.closed_loop import WATCHERS, as_believed, at_rest, closed_loop
from drake_quad.analysis.state_vector import StateVector
from drake_quad.analysis.step_response import release


@pytest.fixture
def laboratory(diagrams):
    return lambda *overrides: load_scenario(diagrams / "laboratory.yaml:nominal", overrides)


def fleet_after(scenario, equilibrium, deviations, times):
    """(times, n, N) deviations from an equilibrium (n,) of a fleet that starts from some (n, N)."""
    n, N = deviations.shape
    single = StateVector(build_tracking_diagram(scenario), without=WATCHERS)
    fleet = build_tracking_diagram(scenario, N, samples=[0] * N)
    layout = StateVector(fleet, without=WATCHERS)
    # Both hold their groups in the same order; a fleet's group of k rows is one of k N elements, row after row.
    assert len(layout.names) == n * N
    assert len(single.names) == n
    simulator = Simulator(fleet)
    simulator.AdvanceTo(0.08)
    context = simulator.get_mutable_context()
    layout.write(fleet, context, (equilibrium[:, None] + deviations).ravel())
    keep = InitializeParams()
    keep.suppress_initialization_events = True
    simulator.Initialize(keep)
    found = []
    for time in times:
        simulator.AdvanceTo(0.08 + time)
        found.append(layout.read(fleet, context).reshape(n, N) - equilibrium[:, None])
    return np.array(found)


@pytest.mark.parametrize(
    ("overrides", "grows"),
    [
        ([], False),
        (["laboratory.wind=[{kind: steady, velocity: [2, 1, 0]}]"], False),
        (["control.position.k_p=[1.6, 1.6, 6]"], True),
    ],
)
def test_multipliers_predict_how_a_fleet_decays_or_grows(laboratory, overrides, grows):
    """1 %, in the direction of every mode that lasts: x_k = z^k x_0 in the nonlinear diagram."""
    scenario = at_rest(laboratory(*overrides))
    loop = closed_loop(scenario)
    values, vectors = np.linalg.eig(loop.system.A)
    assert (np.abs(values).max() > 1.0) == grows
    lasting = [i for i, value in enumerate(values) if abs(value) > 0.9 and value.imag >= 0.0]
    assert len(lasting) >= 6
    start = np.array([1e-5 * (vectors[:, i] / np.abs(vectors[:, i]).max()).real for i in lasting]).T
    ticks = 40
    layout = StateVector(loop.diagram, without=WATCHERS)
    equilibrium = layout.read(loop.diagram, loop.context)
    (found,) = fleet_after(scenario, equilibrium, start, [ticks * loop.system.period])
    for column, i in enumerate(lasting):
        mode = 1e-5 * vectors[:, i] / np.abs(vectors[:, i]).max()
        expected = (mode * values[i] ** ticks).real
        assert np.linalg.norm(found[:, column] - expected) < 0.01 * np.linalg.norm(expected)


def test_in_wind_it_settles_beside_the_reference(laboratory):
    """By D / (m k_P), leaning by atan(D / m g); and a turned vehicle by as much on other axes."""
    wind = "laboratory.wind=[{kind: steady, velocity: [2.0, 0.0, 0.0]}]"
    scenario = laboratory(wind)
    loop = closed_loop(scenario)
    state = loop.diagram.GetOutputPort("state").Eval(loop.context)
    drag = 0.1 * 2.0 + 0.01 * 4.0
    assert state[0] == pytest.approx(drag / (0.68 * scenario.control.position.k_p[0]), rel=1e-9)
    assert np.tan(state[4]) == pytest.approx(-drag / (0.68 * 9.81), rel=1e-9)
    assert np.abs(loop.system.poles()).max() < 1.0


def test_what_is_random_or_passes_is_left_out(diagrams):
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
    believed = as_believed(load_scenario(diagrams / "outdoor.yaml", ["vehicle.mass=0.8"]))
    assert (believed.vehicle.mass, believed.vehicle.linear_drag, believed.laboratory.wind) == (0.68, 0.1, ())


def test_no_equilibrium_is_told(laboratory):
    storm = "laboratory.wind=[{kind: steady, velocity: [60, 0, 0]}]"
    with pytest.raises(InputError, match="has no equilibrium near hover: .* still moves by"):
        closed_loop(laboratory(storm))
    with pytest.raises(InputError, match="vehicle.mass is a distribution"):
        closed_loop(laboratory("vehicle.mass={choice: [0.6, 0.7]}"))


def test_small_steps_are_those_of_the_linear_model(laboratory):
    loop = closed_loop(as_believed(laboratory()))
    for row in ("x", "z", "yaw"):
        response = release(loop, {row: 1e-4}, duration=4.0)
        np.testing.assert_allclose(response.nonlinear, response.linear, atol=1e-7)
        column = ("x", "y", "z", "roll", "pitch", "yaw").index(row)
        assert response.linear[0, column] == pytest.approx(1e-4)
        assert abs(response.linear[-1, column]) < 0.3e-4
    # A large step is not: the tilt is limited.
    response = release(loop, {"x": 40.0}, duration=4.0)
    assert np.abs(response.nonlinear - response.linear)[:, 0].max() > 1.0
