"""The closed loop of a scenario in hover: its equilibrium, its linear model, and the plants of its controllers."""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from drake_quad.assembly.laboratory import build_laboratory_from_recipes, laboratory_recipes, vehicle_parameters
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.flight.mission import build_tracking_diagram, plan_route
from drake_quad.framework.wiring import split_output
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import SampledSystem, at_tick, lifted, linearize, linearize_ticks, settle
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.randomness.noise import ExportedRandomNumbers
from drake_quad.randomness.streams import Samples
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.hovering import at_rest, nominal_hover, symmetric_hover, with_exact_measurement
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import join_path
from drake_quad.scenario.routes.hover import HoverRoute
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.effects import hover_equivalent
from drake_quad.vehicle.motors import ThrottleModel, nominal_rotor_speeds
from drake_quad.vehicle.parameters import QuadrotorParameters

# Subsystems that only observe the loop.
PASSIVE_SYSTEMS = ("monitor", "recorder")
_HOVER_ROUTE = HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))  # position in m
# Largest state change over a period that counts as an equilibrium, in SI units.
_EQUILIBRIUM_TOLERANCE = 1e-9
_ROTOR_SPEED = "vehicle.rotor_speed."  # part of the names of the rotor states
_MAX_NEWTON_STEPS = 20  # largest number of steps in the search for an equilibrium
# If Newton's method needs more steps, it did not start near the equilibrium.
_MAX_STEPS_NEAR_EQUILIBRIUM = 3
_FLIGHT_DURATION = 20.0  # s, duration of a flight that approaches a stable equilibrium
_MIN_GROWTH = 1e-6  # a pole counts as unstable if its magnitude exceeds 1 by more than this rounding error


class ClosedLoop(NamedTuple):
    """Closed loop in equilibrium, and its linear model.

    Attributes:
        diagram: diagram of the closed loop.
        context: context of the diagram at a tick, before the events of the tick.
        system: linearisation x⁺ = A x over the common period of all events (see `common_period`).
    """

    diagram: Diagram
    context: Context
    system: SampledSystem


def closed_loop(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Find the equilibrium of a scenario's loop at rest and linearise it there.

    Newton's method finds the state that does not change over a period. It starts in hover at the reference. The
    equilibrium is not at the reference if the controller has no integral and there is wind or an asymmetric vehicle.

    Args:
        scenario: scenario, which is linearised in hover without gusts and noise (see `at_rest`).
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: if the loop has no equilibrium near hover, or cannot be differentiated.
    """
    resting = at_rest(scenario)
    diagram = build_tracking_diagram(resting, position_controller=position_controller, control=control)
    return _in_equilibrium(scenario.name, diagram, diagram.CreateDefaultContext(), common_period(resting))


def loop_with_injection(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Return the closed loop with an offset that is added to each signal on the command link.

    The inputs of the linear system are the offsets `injection.0`, `injection.1`, ..., one for each component of the
    command. The outputs `injected.0`, `injected.1`, ... are the sums of signal and offset. If a period is longer than
    the control period, the system is lifted (see `lifted`): `injection.0@3` is the offset in tick 3 of the common
    period.

    Args:
        scenario: scenario, which is linearised in hover without gusts and noise (see `at_rest`).
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: under the conditions of `closed_loop`.
    """
    resting = at_rest(scenario)
    user_systems = UserSystems(position_controller, control)
    diagram = build_fleet_diagram(
        Batch.draw(resting, [0]), plan_route(resting), user_systems=user_systems, injects=True
    )
    context = diagram.CreateDefaultContext()
    port = diagram.GetInputPort("injection")
    port.FixValue(context, np.zeros(port.size()))
    common, tick = common_period(resting), resting.laboratory.command_link.period
    loop = _in_equilibrium(scenario.name, diagram, context, common)
    ticks, _ = linearize_ticks(
        diagram,
        loop.context,
        period=tick,
        num_ticks=round(common / tick),
        inputs=["injection"],
        outputs=["injected"],
        excluded_systems=PASSIVE_SYSTEMS,
    )
    return loop._replace(system=ticks[0] if len(ticks) == 1 else lifted(ticks))


def loop_with_noise(hovering: Scenario) -> tuple[ClosedLoop, np.ndarray]:
    """Return the closed loop from noise and turbulence to the state of the vehicle.

    The inputs of the linear system are the standard normal numbers that all random streams supply in a period. Its
    outputs are the components of `state`.

    Args:
        hovering: scenario from `in_hover`.

    Returns:
        The loop in equilibrium, and the deviation (12,) of the equilibrium state from the reference.

    Raises:
        InputError: under the conditions of `closed_loop`.
    """
    period = common_period(hovering)
    plan = plan_route(hovering)
    diagram = build_fleet_diagram(Batch.draw(hovering, [0]), plan, exported=ExportedRandomNumbers(period))
    context = diagram.CreateDefaultContext()
    ports = [diagram.get_input_port(i) for i in range(diagram.num_input_ports())]
    for port in ports:
        port.FixValue(context, np.zeros(port.size()))
    loop = _in_equilibrium(
        hovering.name, diagram, context, period, inputs=[port.get_name() for port in ports], outputs=["state"]
    )
    offset = diagram.GetOutputPort("state").Eval(loop.context).copy()
    offset[:3] -= evaluate(plan.path, [0.0])[:, 0]
    return loop, offset


def _in_equilibrium(name: str, diagram: Diagram, context: Context, period: float, **ports: Sequence[str]) -> ClosedLoop:
    """Move a context to the nearest equilibrium, and return the loop linearised over one period (s) at this point."""
    settle(diagram, context, period)
    start = context.Clone()
    loop, num_steps, failure = _by_newtons_method(diagram, context, period, **ports)
    if num_steps > _MAX_STEPS_NEAR_EQUILIBRIUM and (loop is None or not _is_stable(loop)):
        # Newton's method may have found another equilibrium than the one that the vehicle approaches in flight.
        at_tick(diagram, start.get_time() + period * math.ceil(_FLIGHT_DURATION / period), start)
        other, *_ = _by_newtons_method(diagram, start, period, **ports)
        if other is not None and _is_stable(other):
            return other
    if loop is None:
        raise InputError(f"the loop of {name} has no equilibrium near hover: {failure}")
    return loop


def _is_stable(loop: ClosedLoop) -> bool:
    return bool(np.abs(loop.system.poles()).max() <= 1.0 + _MIN_GROWTH)


def _by_newtons_method(
    diagram: Diagram, context: Context, period: float, **ports: Sequence[str]
) -> tuple[ClosedLoop | None, int, str]:
    """Return the loop in the equilibrium that Newton's method finds, the number of steps, and the reason for a failure.

    The loop is None if the method does not converge.
    """
    layout = ContextVector(diagram, excluded_systems=PASSIVE_SYSTEMS)
    for num_steps in range(_MAX_NEWTON_STEPS):
        system, change = linearize(diagram, context, period=period, excluded_systems=PASSIVE_SYSTEMS, **ports)
        worst = int(np.argmax(np.abs(change)))
        if np.abs(change[worst]) < _EQUILIBRIUM_TOLERANCE:
            return ClosedLoop(diagram, context, system), num_steps, ""
        if not (np.isfinite(change).all() and np.isfinite(system.A).all()):
            break
        step = np.linalg.lstsq(np.eye(len(change)) - system.A, change, rcond=None)[0]
        layout.write(diagram, context, layout.read(diagram, context) + step)
    return None, _MAX_NEWTON_STEPS, f"{layout.names[worst]} still changes by {change[worst]:.3g} per period"


class LaboratoryPlant(NamedTuple):
    """Linear model of a laboratory in hover.

    Attributes:
        system: linear system over a control period, from the command to `measurement`. The command is `wrench`, or
            `attitude_target` if there is an autopilot. The states include thrust and torques of the rotors instead of
            their four speeds, so that the axes are decoupled.
        specific_thrust: ratio of the thrust commanded in hover to the nominal mass, m/s². By eq (7), the tilt for a
            horizontal acceleration is inversely proportional to this ratio, which is g for the nominal vehicle.
    """

    system: SampledSystem
    specific_thrust: float


def laboratory_plant(scenario: Scenario, *, vehicle: Literal["nominal", "actual"] = "nominal") -> LaboratoryPlant:
    """Return the plant that a scenario's controllers act on, in hover in still air, without a state estimator.

    Args:
        scenario: scenario with the laboratory.
        vehicle: "nominal" for the vehicle of `nominal_hover`; "actual" for the vehicle of the scenario, without effects
            that couple its axes: differences between rotors, an offset centre of mass, and misaligned markers.

    Raises:
        InputError: if hover is not an equilibrium, or a period is longer than the control period.
    """
    resting = _in_still_air(with_exact_measurement(scenario), vehicle)
    period = resting.laboratory.command_link.period
    for name, other in loop_periods(resting).items():
        if not 0.0 < other <= period:
            raise InputError(
                f"{name} is {other:g} s, but must be at most {period:g} s, one tick, for the design of gains"
            )
    plan = plan_route(resting)
    recipes = laboratory_recipes(Batch(resting, (0,), {}), plan, plan.duration)
    laboratory = build_laboratory_from_recipes(recipes, 1, Samples(0, [0]))
    context = laboratory.CreateDefaultContext()
    hover = _hover_speeds(resting)
    wrench = _hover_wrench(resting, hover)
    link, command = recipes["command_link"], resting.laboratory.autopilot.command
    initial = link.parameters.initial._replace(thrust=wrench.thrust) if command == "attitude_target" else wrench
    laboratory.GetInputPort(command).FixValue(context, initial)
    link._replace(parameters=link.parameters._replace(initial=initial)).reset(laboratory, "command_link", context)
    settle(laboratory, context, period)
    system, change = linearize(laboratory, context, period=period, inputs=[command], outputs=["measurement"])
    worst = int(np.argmax(np.abs(change)))
    if not np.abs(change[worst]) < _EQUILIBRIUM_TOLERANCE:
        raise InputError(
            f"hover is not an equilibrium of {scenario.name}: {system.states[worst]} changes by {change[worst]:.3g} per"
            " period"
        )
    return LaboratoryPlant(
        _with_wrench_states(system, hover, vehicle_parameters(resting.vehicle)),
        float(wrench.thrust / resting.nominal.mass),
    )


def _in_still_air(scenario: Scenario, vehicle: Literal["nominal", "actual"]) -> Scenario:
    """Return the scenario from which a plant is linearised: the vehicle hovers at (0, 0, 1) in still air."""
    return nominal_hover(scenario) if vehicle == "nominal" else symmetric_hover(at_rest(scenario))


def _hover_speeds(resting: Scenario) -> RotorSpeed:
    """Return the rotor speeds at which the vehicle of a scenario hovers, rad/s.

    Raises:
        InputError: if the rotors cannot hold the vehicle in hover.
    """
    parameters, effects = vehicle_parameters(resting.vehicle), resting.vehicle.effect_parameters()
    hover = hover_rotor_speeds(hover_equivalent(parameters, effects, _HOVER_ROUTE.position[2]))
    if not max(hover) < parameters.max_rotor_speed or not min(hover) > parameters.min_rotor_speed:
        raise InputError(
            f"the rotors cannot hold {resting.name} in hover: they would turn at {max(hover):.0f} rad/s, not at"
            f" {parameters.min_rotor_speed:g} to {parameters.max_rotor_speed:g} rad/s"
        )
    return hover


def _hover_wrench(resting: Scenario, hover: RotorSpeed) -> Wrench:
    """Return the commanded wrench that results in the given rotor speeds if it is allocated by the nominal model."""
    nominal, commanded = nominal_parameters(resting), hover
    known_curve, known = resting.vehicle.effect_parameters().thrust_curve, resting.nominal.motors.thrust_curve()
    if known_curve is not None and known is not None:
        parameters = vehicle_parameters(resting.vehicle)
        commanded = nominal_rotor_speeds(
            hover, ThrottleModel.of(parameters, known_curve), ThrottleModel.of(nominal, known)
        )
    return rotor_action(commanded, nominal).wrench


def rotor_rows(states: Sequence[str]) -> list[int]:
    """Return the indices of the states that are speeds of rotors."""
    return [i for i, name in enumerate(states) if _ROTOR_SPEED in name]


def rotor_speed_to_wrench_matrix(resting: Scenario) -> np.ndarray:
    """Return the matrix (4, 4) from changes of the rotor speeds to changes of scaled thrust and torques near hover.

    Raises:
        InputError: if the rotors cannot hold the vehicle in hover.
    """
    return _wrench_pattern(_hover_speeds(resting), vehicle_parameters(resting.vehicle))


def _with_wrench_states(system: SampledSystem, hover: RotorSpeed, parameters: QuadrotorParameters) -> SampledSystem:
    """Return the system with the rotors' thrust and torques as states instead of the rotor speeds."""
    rotors = rotor_rows(system.states)
    prefix, _, _ = system.states[rotors[0]].partition(_ROTOR_SPEED)
    names = [f"{prefix}vehicle.rotors.{name}" for name in Wrench._fields]
    pattern = _wrench_pattern(hover, parameters)
    return system.transformed(rotors, pattern, names)


def decoupled_loop(scenario: Scenario) -> SampledSystem:
    """Return the linear model of `closed_loop` with decoupled axes.

    Thrust and torques of the rotors replace the rotor speeds as states. Each state then belongs to one axis if the
    vehicle is symmetric.

    Raises:
        InputError: under the conditions of `closed_loop`, or if the rotors cannot hold the vehicle in hover.
    """
    resting = at_rest(scenario)
    hover = _hover_speeds(resting)
    return _with_wrench_states(closed_loop(scenario).system, hover, vehicle_parameters(resting.vehicle))


def on_board_plant(scenario: Scenario, *, vehicle: Literal["nominal", "actual"] = "nominal") -> SampledSystem:
    """Return the plant that an autopilot's loops act on, from `wrench` to `state`, over a period of the autopilot.

    The autopilot reads the state at a tick, and its wrench acts from that tick on. A period of the plant begins just
    before the events of a tick, when a vehicle with a time step still has the state of the previous step. The input is
    constant over the period, so that the plant has the correct delay.

    Args:
        scenario: scenario with an autopilot of kind `attitude`.
        vehicle: "nominal" or "actual", as in `laboratory_plant`.

    Raises:
        InputError: if the vehicle has a continuous state, or cannot hover.
    """
    resting = _in_still_air(scenario, vehicle)
    period = resting.laboratory.autopilot.period
    assert period is not None
    if not resting.vehicle.time_step > 0.0:
        raise InputError("vehicle.time_step is 0 s, but must be positive for the design of loops on board")
    plan = plan_route(resting)
    recipes = laboratory_recipes(Batch(resting, (0,), {}), plan, plan.duration)
    builder = DiagramBuilder()
    allocated = split_output(builder, "allocation", recipes["allocation"].build(1))
    vehicle_system = builder.AddNamedSystem("vehicle", recipes["vehicle"].build(1))
    (command,) = (name for name in allocated if name != "shortfall")
    builder.Connect(allocated[command], vehicle_system.GetInputPort(command))
    builder.ExportInput(builder.GetSubsystemByName("allocation").GetInputPort("wrench"), "wrench")
    builder.ExportOutput(vehicle_system.GetOutputPort("state"), "state")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    hover = _hover_speeds(resting)
    diagram.GetInputPort("wrench").FixValue(context, _hover_wrench(resting, hover))
    settle(diagram, context, period)
    system, _ = linearize(diagram, context, period=period, inputs=["wrench"], outputs=["state"])
    return _with_wrench_states(system, hover, vehicle_parameters(resting.vehicle))


def _wrench_pattern(hover: RotorSpeed, parameters: QuadrotorParameters) -> np.ndarray:
    """Return the matrix (4, 4) of eq (5) that maps rotor speed changes to thrust and torque changes near hover.

    The largest entry of each row is scaled to 1.
    """
    columns = [rotor_action(RotorSpeed(*column), parameters).wrench for column in np.diag(np.sqrt(hover))]
    pattern = np.array(columns).T
    return pattern / np.abs(pattern).max(axis=1, keepdims=True)


def common_period(scenario: Scenario) -> float:
    """Return the period of a loop: the shortest time that is a multiple of the periods of all its events, s."""
    periods = [period for period in loop_periods(scenario).values() if period > 0.0]
    shortest = min(periods)
    return shortest * math.lcm(*(round(period / shortest) for period in periods))


def loop_periods(scenario: Scenario) -> dict[str, float]:
    """Return all periods of a loop, by name, s; the time step of a vehicle with a continuous state is 0."""
    periods = {join_path(*path): period for path, period in scenario.periods.items()}
    loops = scenario.control.loop_period(scenario.laboratory.command_link.period)
    return periods | {"vehicle.time_step": scenario.vehicle.time_step, "control.period": loops}
