"""Tests of a diagram's Jacobian over one period, by comparison with classical sampling and finite differences."""

from dataclasses import replace

import control
import numpy as np
import pytest
import scipy
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold
from tick_jacobian import jacobian_of_tick

from drake_quad import InputError, build_tracking_diagram, draw_sample, load_scenario
from drake_quad.framework.wiring import subsystem
from drake_quad.linear import sampled_system
from drake_quad.linear.closed_loop import PASSIVE_SYSTEMS, laboratory_plant
from drake_quad.linear.context_vector import ContextVector, scheduled_groups
from drake_quad.linear.sampled_system import SampledSystem, at_tick, linearize, linearize_ticks, settle, tick_after

IMPERFECT_OVERRIDES = [
    "route={kind: hover}",
    "vehicle.linear_drag=0.1",
    "vehicle.centre_of_mass=[0.0005, -0.0003]",
    "laboratory.motion_capture={derivative_bandwidth: 60, latency_frames: 1, misalignment: [0.01, 0.02, 0.0]}",
    "laboratory.command_link.delay_ticks=2",
    "laboratory.wind=[{kind: steady, velocity: [1, 0.5, 0]},"
    " {kind: fan, position: [-2, 0, 1], direction: [1, 0, 0], flow: 2, diameter: 0.7, turbulence: 0}]",
]


@pytest.fixture
def hover(diagrams):
    return lambda *overrides: load_scenario(diagrams / "hover.yaml", overrides)


def classical_response(frequency, *, delay_ticks, h=0.01):
    """Return the response from a commanded acceleration to value and rate of a double integrator with rotor lag.

    The input is held over ticks of 2h and delayed by whole ticks, and a frame is h old when it is read.
    Matrix exponentials give the exact result.
    """
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -20.0]])
    B = np.array([[0.0], [0.0], [20.0]])

    def sampled_by_hold(time):
        exponential = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 4))]]) * time)
        return exponential[:3, :3], exponential[:3, 3:]

    phi, gamma = sampled_by_hold(2.0 * h)
    phi_half, gamma_half = sampled_by_hold(h)
    z = np.exp(2j * frequency * h)
    x = np.linalg.solve(z * np.eye(3) - phi, gamma)  # state at a tick, for an input that acts from this tick on
    # A tick reads the frame that was taken h earlier, in the middle of the previous period.
    measured = (phi_half @ x + gamma_half) / z
    return (measured[:2, 0]) / z**delay_ticks


@pytest.mark.parametrize("delay_ticks", [0, 1, 3])
@pytest.mark.parametrize(
    ("torque", "inertia", "rows"), [("tau_x", 0.007, ("roll", "p")), ("thrust", 0.68, ("z", "v_z"))]
)
def test_the_model_of_an_ideal_laboratory_agrees_with_classical_sampling(hover, delay_ticks, torque, inertia, rows):
    plant = laboratory_plant(hover(f"laboratory.command_link.delay_ticks={delay_ticks}")).system
    plant = plant.between([f"wrench.{torque}"], [f"measurement.{row}" for row in rows]).connected()
    for frequency in (0.3, 3.0, 30.0, 100.0):
        response = inertia * plant.response(np.exp(1j * np.array([frequency]) * plant.period))[0, :, 0]
        # The tolerance covers the Runge-Kutta step, which integrates an exponential by Simpson's rule.
        np.testing.assert_allclose(response, classical_response(frequency, delay_ticks=delay_ticks), rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [[], IMPERFECT_OVERRIDES])
def test_the_jacobian_of_the_whole_loop_matches_finite_differences(hover, overrides):
    scenario = hover(*overrides)
    diagram = build_tracking_diagram(scenario)
    context = at_tick(diagram, 0.08)
    system, _ = linearize(diagram, context, period=0.02, excluded_systems=PASSIVE_SYSTEMS)
    layout = ContextVector(diagram, excluded_systems=PASSIVE_SYSTEMS)
    numeric = jacobian_of_tick(diagram, context, layout, until=0.1)
    np.testing.assert_allclose(system.A, numeric, atol=2e-8)


def test_the_state_of_a_diagram_has_unique_names_and_excludes_monitor_and_recorder(hover):
    diagram = build_tracking_diagram(hover(*IMPERFECT_OVERRIDES), record=True)
    names = ContextVector(diagram, excluded_systems=PASSIVE_SYSTEMS).names
    assert len(names) == len(set(names))
    assert "laboratory.vehicle.state.pitch" in names
    assert "laboratory.motion_capture.measurement_in_transit.0.v_x" in names
    assert "laboratory.command_link.wrench_in_transit.1.thrust" in names
    assert "laboratory.wind.fans.wind.x" in names
    assert not any(name.startswith(PASSIVE_SYSTEMS) for name in names)


def test_vehicles_with_a_continuous_state_and_with_a_time_step_have_the_same_model(hover):
    """A vehicle with time steps and a vehicle that Drake integrates have the same slow poles."""
    poles_of_models = []
    for time_step in (0.01, 0.0):
        diagram = build_tracking_diagram(hover(f"vehicle.time_step={time_step}"))
        system, _ = linearize(diagram, at_tick(diagram, 0.08), period=0.02, excluded_systems=PASSIVE_SYSTEMS)
        poles_of_models.append(
            {tuple(np.round(pole, 4)) for pole in np.column_stack([system.poles().real, abs(system.poles().imag)])}
        )
    stepping, continuous = poles_of_models
    assert {pole for pole in stepping if pole[0] > 0.5} == {pole for pole in continuous if pole[0] > 0.5}


class UserController(LeafSystem):
    """Position controller for floats only, optionally with an abstract state."""

    def __init__(self, abstract=False):
        super().__init__()
        for name, size in (("measurement", 12), ("reference", 11)):
            self.DeclareVectorInputPort(name, BasicVector(size))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3), self.command)
        if abstract:
            self.DeclareAbstractState(AbstractValue.Make("a memory"))

    def command(self, context, output):
        output.SetFromVector([0.0, 0.0, 0.0])


def test_a_system_that_cannot_be_differentiated_is_named(hover):
    for abstract, words in (
        (False, "control.position does not support AutoDiffXd"),
        (True, "control.position has an abstract state"),
    ):
        diagram = build_tracking_diagram(hover(), position_controller=UserController(abstract))
        with pytest.raises(InputError, match=words):
            linearize(diagram, at_tick(diagram, 0.04), period=0.02)


def random_system(rng):
    A = rng.normal(size=(5, 5))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    names = [tuple(f"{kind}{i}" for i in range(size)) for kind, size in (("x.", 5), ("u.", 2), ("y.", 3))]
    return SampledSystem(A, rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2)), 0.02, *names)


def test_operations_on_systems_match_python_control():
    rng = np.random.default_rng(1)
    system = random_system(rng)
    z = np.exp(1j * np.array([0.1, 0.7, 2.0]))
    model = system.to_control()
    assert (model.dt, model.state_labels[0], model.input_labels, model.output_labels) == (
        0.02,
        "x_0",
        ["u_0", "u_1"],
        ["y_0", "y_1", "y_2"],
    )
    np.testing.assert_allclose(system.response(z), np.moveaxis(model(z), -1, 0), atol=1e-12)
    part = system.between(["u.1"], ["y.2", "y.0"])
    np.testing.assert_allclose(part.response(z), system.response(z)[:, [2, 0], 1:], atol=1e-12)
    transformed = system.transformed([1, 3], np.array([[1.0, 2.0], [-1.0, 1.0]]), ["a", "b"])
    np.testing.assert_allclose(transformed.response(z), system.response(z), atol=1e-11)
    assert transformed.states == ("x.0", "a", "x.2", "b", "x.4")
    delayed = replace(system, D=0.0 * system.D)
    gain = rng.normal(size=(2, 3)) * 0.1
    G = delayed.response(z)
    closed = np.linalg.solve(np.eye(3) + G @ gain, G)
    np.testing.assert_allclose(delayed.with_feedback(gain).response(z), closed, atol=1e-11)


def test_python_control_and_scipy_have_the_same_poles_and_steps():
    system = random_system(np.random.default_rng(2))
    outputs = [np.zeros(5)]
    for _ in range(40):
        outputs.append(system.A @ outputs[-1] + system.B @ [1.0, 0.0])
    steps = np.array(outputs[:-1]) @ system.C.T + system.D[:, 0]
    by_control, by_scipy = system.to_control(), system.to_scipy()
    assert by_scipy.dt == by_control.dt == system.period
    for poles in (by_control.poles(), np.linalg.eigvals(by_scipy.A)):
        np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(system.poles()), atol=1e-12)
    times = system.period * np.arange(40)
    response = control.step_response(by_control, times, input=0).outputs
    np.testing.assert_allclose(response[:, 0].T, steps, atol=1e-12)
    scipy_response = scipy.signal.dstep(by_scipy, n=40)
    np.testing.assert_allclose(scipy_response[1][0], steps, atol=1e-12)


def test_unreachable_and_unobservable_states_are_left_out():
    A = np.diag([0.5, 0.6, 0.7, 0.8]) + np.diag([0.1, 0.0, 0.1], k=-1)  # State 0 drives state 1, and 2 drives 3.
    B, C = np.array([[1.0], [0.0], [0.0], [0.0]]), np.array([[0.0, 1.0, 0.0, 1.0]])
    system = SampledSystem(A, B, C, np.zeros((1, 1)), 0.02, ("a", "b", "c", "d"), ("u",), ("y",))
    connected = system.connected()
    assert connected.states == ("a", "b")
    z = np.exp(1j * np.array([0.1, 1.0]))
    np.testing.assert_allclose(connected.response(z), system.response(z), atol=1e-14)
    # Units have no influence, because each entry is compared with the other entries in its row.
    faint = replace(system, B=1e-14 * system.B, C=1e-14 * system.C)
    assert faint.connected().states == ("a", "b")
    rounding = replace(system, A=system.A + 1e-16 * np.ones((4, 4)))
    assert rounding.connected().states == ("a", "b")


def test_a_constant_output_has_zero_derivatives():
    builder = DiagramBuilder()
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.1, 1))
    constant = builder.AddNamedSystem("constant", ConstantVectorSource([3.0]))
    builder.ExportInput(hold.get_input_port(), "u")
    builder.ExportOutput(hold.get_output_port(), "y")
    builder.ExportOutput(constant.get_output_port(), "c")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.get_input_port().FixValue(context, [0.0])
    system, _ = linearize(diagram, at_tick(diagram, 0.2, context), period=0.1, outputs=["y", "c"])
    np.testing.assert_array_equal(system.C, [[1.0], [0.0]])


def two_inputs():
    """Return a diagram of two zero-order holds, and a context of the diagram.

    The hold `first` has two elements, and the hold `second` has one.
    """
    builder = DiagramBuilder()
    for name, size in (("first", 2), ("second", 1)):
        hold = builder.AddNamedSystem(name, ZeroOrderHold(0.1, size))
        builder.ExportInput(hold.get_input_port(), f"u_{name}")
        builder.ExportOutput(hold.get_output_port(), f"y_{name}")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    for name, values in (("first", [1.0, 2.0]), ("second", [5.0])):
        diagram.GetInputPort(f"u_{name}").FixValue(context, values)
    return diagram, context


@pytest.mark.parametrize("order", [("first", "second"), ("second", "first"), ("second",)])
def test_inputs_and_outputs_of_a_linear_model_have_the_requested_order(order):
    """The linear model of two zero-order holds has the matrices A = 0 and D = 0.

    B and C consist of rows of the identity matrix, in the requested order.
    """
    diagram, context = two_inputs()
    inputs, outputs = [f"u_{name}" for name in order], [f"y_{name}" for name in order[::-1]]
    system, change = linearize(diagram, at_tick(diagram, 0.2, context), period=0.1, inputs=inputs, outputs=outputs)
    rows = {"first": ("first.group_0.0", "first.group_0.1"), "second": ("second.group_0.0",)}
    assert system.states == (*rows["first"], *rows["second"])
    assert system.inputs == tuple(f"u_{name}.{i}" for name in order for i in range(len(rows[name])))
    assert system.outputs == tuple(f"y_{name}.{i}" for name in order[::-1] for i in range(len(rows[name])))
    columns = [system.states.index(row) for name in order for row in rows[name]]
    np.testing.assert_array_equal(system.A, np.zeros((3, 3)))
    np.testing.assert_array_equal(system.B, np.eye(3)[:, columns])
    rows_of_states = [system.states.index(row) for name in order[::-1] for row in rows[name]]
    np.testing.assert_array_equal(system.C, np.eye(3)[rows_of_states])
    np.testing.assert_array_equal(system.D, np.zeros((len(rows_of_states), len(columns))))
    np.testing.assert_array_equal(change, np.zeros(3))
    assert system.period == 0.1


def test_the_change_of_the_state_is_its_difference_over_a_period():
    diagram, context = two_inputs()
    root = at_tick(diagram, 0.2, context)
    diagram.GetInputPort("u_second").FixValue(root, [9.0])
    _, change = linearize(diagram, root, period=0.1)
    np.testing.assert_array_equal(change, [0.0, 0.0, 4.0])
    assert root.get_time() == 0.2


def test_a_system_without_inputs_and_outputs_has_empty_matrices():
    diagram, context = two_inputs()
    system, _ = linearize(diagram, at_tick(diagram, 0.2, context), period=0.1, excluded_systems=("first",))
    assert system.states == ("second.group_0.0",)
    assert [matrix.shape for matrix in (system.A, system.B, system.C, system.D)] == [(1, 1), (1, 0), (0, 1), (0, 0)]


def test_times_of_ticks_equal_those_of_drake():
    assert tick_after(0.3 - 1e-12, 0.1) == 4 * 0.1
    assert tick_after(0.3, 0.1, 0) == 3 * 0.1 != 0.3
    assert tick_after(0.1, 0.1, 6) == 7 * 0.1 != 0.7


@pytest.mark.parametrize(("size", "is_kept"), [(2e-12, ("a", "b")), (-2e-12, ("a", "b")), (0.5e-12, ("b",))])
def test_an_entry_of_1e_12_relative_to_its_row_is_significant(size, is_kept):
    """The tested entry is the only path from the first state to the output."""
    A = np.array([[0.5, 0.0], [size, 1.0]])
    system = SampledSystem(
        A, np.array([[1.0], [1.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 1)), 0.02, ("a", "b"), ("u",), ("y",)
    )
    assert system.connected().states == is_kept
    assert system.connected(tolerance=1e-15).states == ("a", "b")
    assert system.connected(tolerance=1e-9).states == ("b",)


def test_scaled_multiplies_the_response_by_a_factor_and_renames_the_input():
    system = random_system(np.random.default_rng(3)).between(["u.0"], ["y.1"])
    scaled = system.scaled(-3.0, "push")
    z = np.exp(1j * np.array([0.1, 1.0]))
    np.testing.assert_allclose(scaled.response(z), -3.0 * system.response(z))
    assert (scaled.inputs, scaled.outputs) == (("push",), ("y.1",))


def test_states_between_any_input_and_any_output_are_kept():
    """State 1 connects input 1 to output 1, state 2 connects the other input and output, and state 3 no output."""
    B, C = np.array([[1.0, 0.0], [0.0, -1.0], [0.0, 1.0]]), np.array([[-1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    system = SampledSystem(
        np.diag([0.5, -0.6, 0.7]), B, C, np.zeros((2, 2)), 0.02, ("a", "b", "c"), ("u", "v"), ("y", "z")
    )
    connected = system.connected()
    assert connected.states == ("a", "b")
    np.testing.assert_array_equal(connected.A, np.diag([0.5, -0.6]))
    np.testing.assert_array_equal(connected.B, B[:2])
    np.testing.assert_array_equal(connected.C, C[:, :2])


def test_states_that_are_reached_in_many_steps_are_kept():
    A = np.eye(5, k=-1)
    system = SampledSystem(A, np.eye(5)[:, :1], np.eye(5)[-1:], np.zeros((1, 1)), 0.02, tuple("abcde"), ("u",), ("y",))
    assert system.connected().states == tuple("abcde")


def test_the_frequency_response_at_a_pole_of_the_system_is_refused():
    system = SampledSystem(
        np.diag([0.5, 0.25]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.02, ("a", "b"), ("u",), ("y",)
    )
    assert system.response(np.array([1.0])).item() == pytest.approx(1.0 / 0.5 + 1.0 / 0.75)
    with pytest.raises(np.linalg.LinAlgError, match="one of the points is a pole of the system"):
        system.response(np.array([1.0, 0.25]))


def drifting_system(output_gain):
    """Return a system with a decaying mode and a double integrator, which acts on the output with the given gain."""
    A = np.array([[0.5, 0.0, 0.0], [0.1, 1.0, 1.0], [0.0, 0.0, 1.0]])
    B, C = np.array([[1.0], [0.3], [0.2]]), np.array([[1.0, output_gain, 0.0]])
    return SampledSystem(A, B, C, np.zeros((1, 1)), 0.1, ("a", "b", "c"), ("u",), ("y",))


def test_a_system_is_printed_by_its_sizes():
    assert repr(drifting_system(0.0)) == "<SampledSystem with 3 states, 1 inputs, 1 outputs and period 0.1 s>"


def test_modes_that_no_output_shows_are_removed():
    system = drifting_system(0.0)
    visible = system.without_hidden_modes()
    np.testing.assert_allclose(visible.poles(), [0.5])
    points = np.exp(1j * np.linspace(0.1, 3.0, 7))
    np.testing.assert_allclose(visible.response(points), system.response(points))
    transposed = replace(system, A=system.A.T, B=system.C.T, C=system.B.T)
    np.testing.assert_allclose(transposed.without_hidden_modes().response(points), system.response(points))


def test_modes_that_an_output_shows_are_kept():
    for system in (drifting_system(1e-3), replace(drifting_system(0.0), A=np.diag([0.5, 0.9, 0.99]))):
        assert system.without_hidden_modes() is system


def test_linearizing_each_tick_of_a_period_gives_the_map_over_the_period():
    """A camera with half the rate of the control acts in every second tick."""
    scenario = load_scenario("laboratory:nominal", [*IMPERFECT_OVERRIDES, "laboratory.motion_capture.period=0.04"])
    diagram = build_tracking_diagram(scenario)
    context = at_tick(diagram, 0.08)
    period_model, change = linearize(diagram, context, period=0.04, excluded_systems=PASSIVE_SYSTEMS)
    ticks, total = linearize_ticks(diagram, context, period=0.02, num_ticks=2, excluded_systems=PASSIVE_SYSTEMS)
    np.testing.assert_allclose(ticks[1].A @ ticks[0].A, period_model.A, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(total, change, rtol=0.0, atol=1e-12)
    assert np.abs(ticks[0].A - ticks[1].A).max() > 0.1


@pytest.mark.long
def test_covariances_of_a_kalman_filter_are_settled(monkeypatch):
    """Settling for twice the time changes no element by more than 2 % of the largest element."""
    scenario = draw_sample(load_scenario("outdoor_gnss", ["route={kind: hover, position: [0, 0, 1]}"]), 0)
    covariances = []
    for factor in (1.0, 2.0):
        monkeypatch.setattr(sampled_system, "_SETTLING_TIME", factor * sampled_system._SETTLING_TIME)
        diagram = build_tracking_diagram(scenario)
        context = diagram.CreateDefaultContext()
        settle(diagram, context, period=0.04)
        estimator = subsystem(diagram, ["laboratory", "estimator"])
        group, *_ = scheduled_groups(estimator)
        covariances.append(estimator.GetMyContextFromRoot(context).get_discrete_state(group).CopyToVector())
    once, twice = covariances
    np.testing.assert_allclose(once, twice, rtol=0.0, atol=0.02 * np.abs(twice).max())
