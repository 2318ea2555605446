"""The loop of a scenario at rest: its equilibrium, its linear model, and the plants that its controllers act on."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from drake_quad.assembly.laboratory import build_laboratory_of, laboratory_recipes, vehicle_parameters
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.flight.mission import build_tracking_diagram, plan_route
from drake_quad.framework.wiring import split_output
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import SampledSystem, at_tick, linearize
from drake_quad.planning.believed import nominal_parameters
from drake_quad.randomness.noise import Exported, Samples
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.hovering import as_believed, at_rest, symmetric_hover
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import joined
from drake_quad.scenario.routes.hover import HoverRoute
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.effects import hover_equivalent
from drake_quad.vehicle.motors import ThrottleModel, believed_rotor_speeds
from drake_quad.vehicle.parameters import QuadrotorParameters

# Subsystems that only observe the loop.
WATCHERS = ("monitor", "recorder")
_HOVER = HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))
# Ticks after which the equilibrium is sought (the first grids that do not quite coincide are behind), and how still
# everything must be (in SI units over a period) to be called one.
_TICKS, _STILL = 4, 1e-9
# Number of steps of Newton's method.
_STEPS = 20


class ClosedLoop(NamedTuple):
    """A diagram in equilibrium.

    Attributes:
        diagram: of the closed loop.
        context: at a tick, before its events.
        system: what `linearize` makes of it: x⁺ = A x over a tick of the control, or over the period of the cameras or
            the vehicle's time step if that is longer.
    """

    diagram: Diagram
    context: Context
    system: SampledSystem


def closed_loop(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Find the equilibrium of a scenario's loop at rest and linearise it there.

    Newton's method solves x = Φ(x), starting in hover at the reference. In wind, or with an uneven vehicle, a PD
    settles beside the reference.

    Args:
        scenario: scenario, of which `at_rest` is linearised.
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: if the loop has no equilibrium near hover, or cannot be differentiated.
    """
    resting = at_rest(scenario)
    diagram = build_tracking_diagram(resting, position_controller=position_controller, control=control)
    return _settled(scenario.name, diagram, diagram.CreateDefaultContext(), max(_periods(resting).values()))


def loop_with_injection(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Return the closed loop from an addition to the signals of the command link to these signals.

    The inputs of the system are `injection.0`, `injection.1`, ..., its outputs `injected.0` and so on, row by row of
    what the link carries.

    Args:
        scenario: scenario, of which `at_rest` is linearised.
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: an error of `closed_loop`, or a period is longer than that of the control.
    """
    resting = at_rest(scenario)
    period = resting.laboratory.command_link.period
    for name, other in _periods(resting).items():
        if other > period:
            raise InputError(
                f"{name} is {other:g} s, but what goes over the link is looked at every tick, {period:g} s"
            )
    own = UserSystems(position_controller, control)
    diagram = build_fleet_diagram(Batch.draw(resting, [0]), plan_route(resting), own=own, injects=True)
    context = diagram.CreateDefaultContext()
    port = diagram.GetInputPort("injection")
    port.FixValue(context, np.zeros(port.size()))
    return _settled(scenario.name, diagram, context, period, inputs=["injection"], outputs=["injected"])


def loop_with_noise(hovering: Scenario) -> tuple[ClosedLoop, np.ndarray]:
    """Return the loop from its noise and turbulence to the vehicle's state.

    The inputs of the system are normal numbers of deviation 1, those of a whole period for each stream; its outputs
    are the rows of `state`.

    Args:
        hovering: a scenario of `in_hover`.

    Returns:
        The loop in its equilibrium, and by how much (12,) the state is beside the reference there.

    Raises:
        InputError: as `closed_loop`.
    """
    period = max(_periods(hovering).values())
    plan = plan_route(hovering)
    diagram = build_fleet_diagram(Batch.draw(hovering, [0]), plan, exported=Exported(period))
    context = diagram.CreateDefaultContext()
    ports = [diagram.get_input_port(i) for i in range(diagram.num_input_ports())]
    for port in ports:
        port.FixValue(context, np.zeros(port.size()))
    loop = _settled(
        hovering.name, diagram, context, period, inputs=[port.get_name() for port in ports], outputs=["state"]
    )
    beside = diagram.GetOutputPort("state").Eval(loop.context).copy()
    beside[:3] -= evaluate(plan.path, [0.0])[:, 0]
    return loop, beside


def _settled(name: str, diagram: Diagram, context: Context, period: float, **ports: Sequence[str]) -> ClosedLoop:
    """Move a context to the equilibrium nearest to it, and return the linear system over a period (s)."""
    at_tick(diagram, _TICKS * period, context)
    layout = ContextVector(diagram, without=WATCHERS)
    for _ in range(_STEPS):
        system, moved = linearize(diagram, context, period=period, without=WATCHERS, **ports)
        worst = int(np.argmax(np.abs(moved)))
        if np.abs(moved[worst]) < _STILL:
            return ClosedLoop(diagram, context, system)
        if not (np.isfinite(moved).all() and np.isfinite(system.A).all()):
            break
        step = np.linalg.lstsq(np.eye(len(moved)) - system.A, moved, rcond=None)[0]
        layout.write(diagram, context, layout.read(diagram, context) + step)
    raise InputError(
        f"the loop of {name} has no equilibrium near hover: {layout.names[worst]} still moves by"
        f" {moved[worst]:.3g} a tick"
    )


class LaboratoryPlant(NamedTuple):
    """The linear model of a laboratory in hover.

    Attributes:
        system: from `wrench` or, with an autopilot, from `attitude_target` to `measurement`, over a tick of the
            control. The rotors' four states are turned into the thrust and the torques that they stand for, so that the
            axes come apart.
        specific_thrust: commanded in hover, over the believed mass, m/s²: a horizontal acceleration takes a tilt of as
            much less, eq (7). It is g for a vehicle that is as believed.
    """

    system: SampledSystem
    specific_thrust: float


def laboratory_plant(scenario: Scenario, *, vehicle: Literal["believed", "as it is"] = "believed") -> LaboratoryPlant:
    """Return the plant that a scenario's controllers act on, in hover in still air.

    Args:
        scenario: scenario with the laboratory.
        vehicle: "believed" for the vehicle of `as_believed`; "as it is" for the vehicle that flies, without what
            couples its axes: errors of single rotors, an offset of the centre of mass, and misaligned markers.

    Raises:
        InputError: if hover is no equilibrium, or a period is longer than that of the control.
    """
    resting = _in_still_air(scenario, vehicle)
    period = resting.laboratory.command_link.period
    for name, other in _periods(resting).items():
        if not 0.0 < other <= period:
            raise InputError(f"{name} is {other:g} s, but gains are designed for periods up to {period:g} s, a tick")
    plan = plan_route(resting)
    recipes = laboratory_recipes(Batch(resting, (0,), {}), plan, plan.duration)
    laboratory = build_laboratory_of(recipes, 1, Samples(0, [0]))
    context = laboratory.CreateDefaultContext()
    hover = _hover_speeds(resting)
    wrench = _hover_wrench(resting, hover)
    link, command = recipes["command_link"], resting.laboratory.autopilot.command
    held = link.numbers.initial._replace(thrust=wrench.thrust) if command == "attitude_target" else wrench
    laboratory.GetInputPort(command).FixValue(context, held)
    link._replace(numbers=link.numbers._replace(initial=held)).reset(laboratory, "command_link", context)
    at_tick(laboratory, _TICKS * period, context)
    system, moved = linearize(laboratory, context, period=period, inputs=[command], outputs=["measurement"])
    worst = int(np.argmax(np.abs(moved)))
    if not np.abs(moved[worst]) < _STILL:
        raise InputError(
            f"hover is not an equilibrium of {scenario.name}: {system.states[worst]} moves by {moved[worst]:.3g} a tick"
        )
    return LaboratoryPlant(
        _with_axes_apart(system, hover, vehicle_parameters(resting.vehicle)),
        float(wrench.thrust / resting.nominal.mass),
    )


def _in_still_air(scenario: Scenario, vehicle: Literal["believed", "as it is"]) -> Scenario:
    """Return the scenario of which plants are made, in hover at (0, 0, 1)."""
    return as_believed(scenario) if vehicle == "believed" else symmetric_hover(at_rest(scenario))


def _hover_speeds(resting: Scenario) -> RotorSpeed:
    """Return the rotor speeds in hover of a resting scenario's vehicle, rad/s.

    Raises:
        InputError: the rotors cannot hold the vehicle in hover.
    """
    parameters, effects = vehicle_parameters(resting.vehicle), resting.vehicle.effect_numbers()
    hover = hover_rotor_speeds(hover_equivalent(parameters, effects, _HOVER.position[2]))
    if not max(hover) < parameters.max_rotor_speed or not min(hover) > parameters.min_rotor_speed:
        raise InputError(
            f"the rotors cannot hold {resting.name} in hover: they would turn at {max(hover):.0f} rad/s, but can at"
            f" {parameters.min_rotor_speed:g} to {parameters.max_rotor_speed:g} rad/s"
        )
    return hover


def _hover_wrench(resting: Scenario, hover: RotorSpeed) -> Wrench:
    """Return the wrench that commands these rotor speeds according to the nominal model."""
    believed, commanded = nominal_parameters(resting), hover
    flown, known = resting.vehicle.effect_numbers().thrust_curve, resting.nominal.motors.thrust_curve()
    if flown is not None and known is not None:
        parameters = vehicle_parameters(resting.vehicle)
        commanded = believed_rotor_speeds(hover, ThrottleModel.of(parameters, flown), ThrottleModel.of(believed, known))
    return rotor_action(commanded, believed).wrench


def _with_axes_apart(system: SampledSystem, hover: RotorSpeed, parameters: QuadrotorParameters) -> SampledSystem:
    """Return the system with thrust and torques in place of the speeds of the rotors, which hover at some."""
    turning = "vehicle.rotor_speed."
    rotors = [i for i, name in enumerate(system.states) if turning in name]
    inside, _, _ = system.states[rotors[0]].partition(turning)
    names = [f"{inside}vehicle.rotors.{name}" for name in Wrench._fields]
    pattern = _wrench_pattern(hover, parameters)
    return system.transformed(rotors, pattern, names)


def loop_by_axes(scenario: Scenario) -> SampledSystem:
    """Return the linear model of `closed_loop`, with thrust and torques in place of the speeds of the rotors.

    An even vehicle's axes then have no state in common.

    Raises:
        InputError: as `closed_loop`, or the rotors cannot hold the vehicle.
    """
    resting = at_rest(scenario)
    hover = _hover_speeds(resting)
    return _with_axes_apart(closed_loop(scenario).system, hover, vehicle_parameters(resting.vehicle))


def on_board_plant(scenario: Scenario, *, vehicle: Literal["believed", "as it is"] = "believed") -> SampledSystem:
    """Return the plant of an autopilot's loops: from `wrench` to `state`, over a period of the autopilot.

    The autopilot sees the state of its instant, and its wrench acts from then on. So does a fixed input here: just
    before an instant's events a stepping vehicle still has the state of a step before, and there the period begins.

    Args:
        scenario: with an autopilot of kind attitude.
        vehicle: as in `laboratory_plant`.

    Raises:
        InputError: the vehicle has a continuous state, or cannot hover.
    """
    resting = _in_still_air(scenario, vehicle)
    period = resting.laboratory.autopilot.period
    assert period is not None
    if not resting.vehicle.time_step > 0.0:
        raise InputError("vehicle.time_step is 0 s, but loops on board are designed for a vehicle that steps")
    plan = plan_route(resting)
    recipes = laboratory_recipes(Batch(resting, (0,), {}), plan, plan.duration)
    builder = DiagramBuilder()
    allocated = split_output(builder, "allocation", recipes["allocation"].build(1))
    flown = builder.AddNamedSystem("vehicle", recipes["vehicle"].build(1))
    (told,) = (name for name in allocated if name != "shortfall")
    builder.Connect(allocated[told], flown.GetInputPort(told))
    builder.ExportInput(builder.GetSubsystemByName("allocation").GetInputPort("wrench"), "wrench")
    builder.ExportOutput(flown.GetOutputPort("state"), "state")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    hover = _hover_speeds(resting)
    diagram.GetInputPort("wrench").FixValue(context, _hover_wrench(resting, hover))
    at_tick(diagram, _TICKS * period, context)
    system, _ = linearize(diagram, context, period=period, inputs=["wrench"], outputs=["state"])
    return _with_axes_apart(system, hover, vehicle_parameters(resting.vehicle))


def _wrench_pattern(hover: RotorSpeed, parameters: QuadrotorParameters) -> np.ndarray:
    """(4, 4) from rotor speeds to what makes thrust and torques near hover, eq (5); the largest of each row is 1."""
    columns = [rotor_action(RotorSpeed(*column), parameters).wrench for column in np.diag(np.sqrt(hover))]
    pattern = np.array(columns).T
    return pattern / np.abs(pattern).max(axis=1, keepdims=True)


def _periods(scenario: Scenario) -> dict[str, float]:
    """Return the periods of all that happens in a loop, s; 0 for a vehicle that moves continuously."""
    periods = {joined(*path): period for path, period in scenario.periods.items()}
    loops = scenario.control.loop_period(scenario.laboratory.command_link.period)
    return periods | {"vehicle.time_step": scenario.vehicle.time_step, "control.period": loops}
