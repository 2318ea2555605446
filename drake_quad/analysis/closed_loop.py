"""The loop of a scenario at rest: its equilibrium, its linear model, and the plants that its controllers act on."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from drake_quad.analysis.context_vector import ContextVector
from drake_quad.analysis.sampled_system import SampledSystem, at_tick, linearize
from drake_quad.assembly.effects import thrust_curve, vehicle_effects
from drake_quad.assembly.laboratory import build_laboratory_of, laboratory_recipes, vehicle_parameters
from drake_quad.assembly.planning import nominal_parameters, plan_route
from drake_quad.assembly.tracking import build_fleet_diagram, build_tracking_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.framework.wiring import split_output
from drake_quad.randomness.noise import Exported, Samples
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario import Batch, Scenario, distributions_in
from drake_quad.scenario.autopilots import AttitudeAutopilot, Autopilot
from drake_quad.scenario.effects import Payload
from drake_quad.scenario.layouts import are_paired
from drake_quad.scenario.models import Nominal, Vehicle, Window
from drake_quad.scenario.routes import HoverRoute
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.effects import as_in_hover
from drake_quad.vehicle.motors import ThrottleModel, told_as
from drake_quad.vehicle.parameters import QuadrotorParameters

if TYPE_CHECKING:
    import control
    import scipy

# They watch the loop and do not act on it.
WATCHERS = ("monitor", "recorder")
_HOVER = HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))
# Ticks after which the equilibrium is sought (the first grids that do not quite coincide are behind), and how still
# everything must be (in SI units over a period) to be called one.
_TICKS, _STILL = 4, 1e-9
# Of Newton's method.
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

    def to_control(self) -> "control.StateSpace":
        """The system as python-control's StateSpace, see `SampledSystem.to_control`."""
        return self.system.to_control()

    def to_scipy(self) -> "scipy.signal.StateSpace":
        """The system as SciPy's StateSpace, see `SampledSystem.to_scipy`."""
        return self.system.to_scipy()


def at_rest(scenario: Scenario) -> Scenario:
    """Return the scenario in hover, without random or time-varying effects.

    The vehicle hovers where the scenario's route hovers, or at (0, 0, 1). Noise, lost frames and packets, turbulence,
    gusts, sinusoidal wind, battery sag, the battery, rotor failures and obstacles are removed. Delays, lags, filters,
    drag, errors of the vehicle, the bias of the gyroscope, fans and steady wind remain. A payload remains if the
    vehicle carries it at the start of the flight.

    Raises:
        InputError: if the scenario contains a distribution.
    """
    hovering = without_losses(in_hover(scenario))
    laboratory = hovering.laboratory
    cameras = laboratory.motion_capture.model_copy(
        update={"position_noise": 0.0, "attitude_noise": 0.0, "velocity_drift": (0.0, 0.0, 0.0)}
    )
    still = {
        "motion_capture": cameras,
        "autopilot": _with(laboratory.autopilot, gyroscope_noise=0.0, attitude_noise=0.0),
        "wind": tuple(calm for source in laboratory.wind if (calm := source.without_turbulence()) is not None),
    }
    return hovering.model_copy(update={"laboratory": laboratory.model_copy(update=still)})


def in_hover(scenario: Scenario) -> Scenario:
    """Return the scenario in hover like `at_rest`, but with its noise, turbulence, lost frames and lost packets.

    Raises:
        InputError: if the scenario contains a distribution.
    """
    for path in distributions_in(scenario):
        if not path.startswith("route."):
            raise InputError(
                f"{path} is a distribution; the analysis of hover needs a number: give one, or select a sample"
            )
    laboratory = scenario.laboratory
    lasting = tuple(source for source in laboratory.wind if not source.depends_on_time)
    payload = None if scenario.vehicle.payload is None else _lasting(scenario.vehicle.payload)
    steady = {"battery_sag": 0.0, "battery": None, "rotor_failure": None, "payload": payload}
    vehicle = scenario.vehicle.model_copy(update=steady)
    route = scenario.route
    if not isinstance(route, HoverRoute) or any(path.startswith("route.") for path in distributions_in(scenario)):
        route = _HOVER
    nowhere = scenario.crash.model_copy(update={"position_error": 1e6, "height": -1e6})
    return scenario.model_copy(
        update={
            "route": route,
            "vehicle": vehicle,
            "laboratory": laboratory.model_copy(update={"wind": lasting}),
            "duration": None,
            "sample": None,
            "crash": nowhere,
            "space": None,
            "metrics": Window(),
        }
    )


def without_losses(scenario: Scenario) -> Scenario:
    """Return the scenario without lost frames and packets, which a linear model cannot represent."""
    laboratory = scenario.laboratory
    reliable = {
        "motion_capture": laboratory.motion_capture.model_copy(update={"dropout_rate": 0.0}),
        "command_link": laboratory.command_link.model_copy(update={"loss_rate": 0.0}),
    }
    return scenario.model_copy(update={"laboratory": laboratory.model_copy(update=reliable)})


def _lasting(payload: Payload) -> Payload | None:
    """A payload that stays if it is there when the flight begins; None if it is not."""
    if (payload.event == "dropped") == (payload.time == 0.0):
        return None
    return payload.model_copy(update={"time": 0.0, "event": "picked_up"})


def as_believed(scenario: Scenario) -> Scenario:
    """The scenario in hover at (0, 0, 1) in still air with the vehicle that the ground believes in, for design.

    Of the vehicle as it is, only what the ground knows besides `nominal` stays: the lag of the rotors that speed up,
    the drag, and what the air does to the rotors.
    """
    return _even(with_believed_vehicle(at_rest(scenario)))


def with_believed_vehicle(scenario: Scenario) -> Scenario:
    """The scenario with the vehicle that the ground believes in, see `as_believed`."""
    believed = {name: getattr(scenario.nominal, name) for name in Nominal.model_fields}
    kept = (
        *("rotor_time_constant", "linear_drag", "quadratic_drag", "body_drag", "rotor_aerodynamics"),
        *("attitude_kinematics", "time_step"),
    )
    vehicle = Vehicle().model_copy(update=believed | {name: getattr(scenario.vehicle, name) for name in kept})
    return scenario.model_copy(update={"vehicle": vehicle})


def _even(resting: Scenario) -> Scenario:
    """A resting scenario in hover at (0, 0, 1) without what couples the axes or leans it.

    That is wind, uneven rotors, misalignment, the spin that is left over where rotors hover at different speeds, and
    whatever acts beside the middle: drag of the body, a payload, and a gyroscope's bias.
    """
    layouts = resting.vehicle.layout, resting.nominal.layout
    even: dict[str, Any] = {
        "thrust_factor_error": (0.0, 0.0, 0.0, 0.0),
        "centre_of_mass": (0.0, 0.0),
        "rotor_inertia": 0.0,
        "layout": layouts[0] if all(map(are_paired, layouts)) else layouts[1],
    }
    drag, payload = resting.vehicle.body_drag, resting.vehicle.payload
    if drag is not None:
        even["body_drag"] = drag.model_copy(update={"centre_of_pressure": (0.0, 0.0, 0.0)})
    if payload is not None:
        even["payload"] = payload.model_copy(update={"position": (0.0, 0.0, payload.position[2])})
    cameras = resting.laboratory.motion_capture.model_copy(update={"misalignment": (0.0, 0.0, 0.0)})
    autopilot = _with(resting.laboratory.autopilot, gyroscope_bias=(0.0, 0.0, 0.0))
    laboratory = resting.laboratory.model_copy(update={"wind": (), "motion_capture": cameras, "autopilot": autopilot})
    vehicle = resting.vehicle.model_copy(update=even)
    return resting.model_copy(update={"route": _HOVER, "vehicle": vehicle, "laboratory": laboratory})


def _with(autopilot: Autopilot, **numbers: Any) -> Autopilot:
    """An autopilot with other numbers, if it is of a kind that has them."""
    return autopilot.model_copy(update=numbers) if isinstance(autopilot, AttitudeAutopilot) else autopilot


def closed_loop(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """Finds the equilibrium of a scenario's loop at rest and linearises it there.

    Newton's method on x = Φ(x), from hover at the reference: in wind or with an uneven vehicle a PD settles beside it.

    Args:
        scenario: flown `at_rest`.
        position_controller: stands in for the scenario's; see `build_tracking_diagram`.
        control: stands in for the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: the loop has no equilibrium near hover, or cannot be differentiated.
    """
    resting = at_rest(scenario)
    diagram = build_tracking_diagram(resting, position_controller=position_controller, control=control)
    return _settled(scenario.name, diagram, diagram.CreateDefaultContext(), max(_periods(resting).values()))


def loop_with_injection(scenario: Scenario, *, position_controller: Any = None, control: Any = None) -> ClosedLoop:
    """The same, from what is added to the signals of the command link to what goes over it then.

    The inputs of the system are `injection.0`, `injection.1`, ..., its outputs `injected.0` and so on, row by row of
    what the link carries.

    Args:
        scenario: flown `at_rest`.
        position_controller: stands in for the scenario's; see `build_tracking_diagram`.
        control: stands in for the whole cascade; see `build_tracking_diagram`.

    Raises:
        InputError: as `closed_loop`, or something happens less often than the control ticks.
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
    """The loop from its noise and turbulence to the vehicle's state.

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
    """A diagram in its equilibrium near what it is in, and its linear system over a period (s)."""
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
    """The plant that a scenario's controllers act on, in hover in still air.

    Args:
        scenario: whose laboratory it is.
        vehicle: the one of `as_believed`, or the one that flies, but for what would couple its axes: errors of single
            rotors, a centre of mass beside the middle, misaligned markers.

    Raises:
        InputError: hover is no equilibrium, or something happens less often than the control ticks.
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
    """The scenario of which plants are made, in hover at (0, 0, 1)."""
    return as_believed(scenario) if vehicle == "believed" else _even(at_rest(scenario))


def _hover_speeds(resting: Scenario) -> RotorSpeed:
    """At which the rotors of a resting scenario's vehicle turn in hover.

    Raises:
        InputError: they cannot.
    """
    parameters, effects = vehicle_parameters(resting.vehicle), vehicle_effects(resting.vehicle)
    hover = hover_rotor_speeds(as_in_hover(parameters, effects, _HOVER.position[2]))
    if not max(hover) < parameters.max_rotor_speed or not min(hover) > parameters.min_rotor_speed:
        raise InputError(
            f"the rotors cannot hold {resting.name} in hover: they would turn at {max(hover):.0f} rad/s, but can at"
            f" {parameters.min_rotor_speed:g} to {parameters.max_rotor_speed:g} rad/s"
        )
    return hover


def _hover_wrench(resting: Scenario, hover: RotorSpeed) -> Wrench:
    """What the ground believes to command where the vehicle's rotors hover at some speeds."""
    believed, commanded = nominal_parameters(resting), hover
    flown, known = vehicle_effects(resting.vehicle).thrust_curve, thrust_curve(resting.nominal.motors)
    if flown is not None and known is not None:
        parameters = vehicle_parameters(resting.vehicle)
        commanded = told_as(hover, ThrottleModel.of(parameters, flown), ThrottleModel.of(believed, known))
    return rotor_action(commanded, believed).wrench


def _with_axes_apart(system: SampledSystem, hover: RotorSpeed, parameters: QuadrotorParameters) -> SampledSystem:
    """The system with thrust and torques in place of the speeds of the rotors, which hover at some."""
    turning = "vehicle.rotor_speed."
    rotors = [i for i, name in enumerate(system.states) if turning in name]
    inside, _, _ = system.states[rotors[0]].partition(turning)
    names = [f"{inside}vehicle.rotors.{name}" for name in Wrench._fields]
    pattern = _wrench_pattern(hover, parameters)
    return system.transformed(rotors, pattern, names)


def loop_by_axes(scenario: Scenario) -> SampledSystem:
    """The linear model of `closed_loop`, with thrust and torques in place of the speeds of the rotors.

    An even vehicle's axes then have no state in common.

    Raises:
        InputError: as `closed_loop`, or the rotors cannot hold the vehicle.
    """
    resting = at_rest(scenario)
    hover = _hover_speeds(resting)
    return _with_axes_apart(closed_loop(scenario).system, hover, vehicle_parameters(resting.vehicle))


def on_board_plant(scenario: Scenario, *, vehicle: Literal["believed", "as it is"] = "believed") -> SampledSystem:
    """The plant of an autopilot's loops: from `wrench` to `state`, over a period of the autopilot.

    The autopilot sees the state of its instant, and its wrench acts from then on. So does a fixed input here: just
    before an instant's events a stepping vehicle still has the state of a step before, and there the period begins.

    Args:
        scenario: with an autopilot of kind attitude.
        vehicle: as in `laboratory_plant`.

    Raises:
        InputError: the vehicle has a continuous state, or cannot hover.
    """
    resting = _in_still_air(scenario, vehicle)
    autopilot = resting.laboratory.autopilot
    assert isinstance(autopilot, AttitudeAutopilot)
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
    at_tick(diagram, _TICKS * autopilot.period, context)
    system, _ = linearize(diagram, context, period=autopilot.period, inputs=["wrench"], outputs=["state"])
    return _with_axes_apart(system, hover, vehicle_parameters(resting.vehicle))


def _wrench_pattern(hover: RotorSpeed, parameters: QuadrotorParameters) -> np.ndarray:
    """(4, 4) from rotor speeds to what makes thrust and torques near hover, eq (5); the largest of each row is 1."""
    columns = [rotor_action(RotorSpeed(*column), parameters).wrench for column in np.diag(np.sqrt(hover))]
    pattern = np.array(columns).T
    scaled: np.ndarray = pattern / np.abs(pattern).max(axis=1, keepdims=True)
    return scaled


def _periods(scenario: Scenario) -> dict[str, float]:
    """The periods of all that happens in a loop, s; 0 for a vehicle that moves continuously."""
    periods = {".".join(path): period for path, period in scenario.periods.items()}
    return periods | {"vehicle.time_step": scenario.vehicle.time_step}
