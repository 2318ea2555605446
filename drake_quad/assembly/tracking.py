"""Assembly of the closed loop of a scenario as a Drake diagram.

reference ──▶ control ──▶ laboratory
│            ▲             │
│            └─measurement─┘
└──▶ monitor, recorder ◀── signals of all diagrams
"""

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.assembly.laboratory import build_laboratory_from_recipes, build_monitor, laboratory_recipes, wind_period
from drake_quad.assembly.recorder import build_recorder
from drake_quad.assembly.user_systems import UserSystems, check_user_systems
from drake_quad.control.cascade import POSITION_SIGNALS
from drake_quad.errors import InputError, join_names
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.framework.wiring import subsystem
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.laboratory.wind.wind import build_held_wind
from drake_quad.planning.duration import flight_duration
from drake_quad.randomness.noise import EXPORTED_PREFIX, ExportedRandomNumbers, NoiseSource
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import build_reference
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario

# Control signals that are exported and recorded. A user's control must provide only the signal for the command link.
_CONTROL_SIGNALS = (
    *POSITION_SIGNALS,
    "observation",
    "action",
    "acceleration_command",
    "attitude_command",
    "wrench",
    "attitude_target",
)
# Signals that a controller may send over the command link. Each controller sends one of them.
_COMMANDS = ("wrench", "attitude_target")


def build_fleet_diagram(
    batch: Batch,
    plan: Plan,
    *,
    user_systems: UserSystems = UserSystems(),
    record: bool = False,
    drake_random: bool = False,
    injects: bool = False,
    exported: ExportedRandomNumbers | None = None,
    open_action: bool = False,
    has_external_load: bool = False,
    has_neighbours: bool = False,
) -> Diagram:
    """Build the closed loop of a scenario, with one vehicle for each sample in a batch.

    Args:
        batch: samples to fly.
        plan: plan that the vehicles follow.
        user_systems: the user's systems, built for the same number of vehicles. The diagram will own them.
        record: True to add a recorder, which samples all signals at every control tick.
        drake_random: True to use Drake's random sources for wind and noise instead of the random numbers of the
            samples.
        injects: True to add an input port `injection` and an output port `injected`. The signal at `injection` is added
            to the controller's command, and `injected` is the sum, which enters the command link.
        exported: option to supply the laboratory's random numbers through input ports of the diagram.
        open_action: True to add an input port `action` for the action of a policy.
        has_external_load: True to add the input port `external_load`, a force and a torque on the vehicle.
        has_neighbours: True to add the input port `clearance`, the distance from the nearest other vehicle.

    Raises:
        InputError: if the control lacks a required policy, a user's system is unsuitable, or the vehicle's time step is
            too long.
    """
    scenario, num_vehicles = batch.scenario, len(batch)
    command, rows = scenario.laboratory.autopilot.command, scenario.control.policy_rows()
    check_user_systems(
        user_systems, num_vehicles, command=command, rows=rows, sensors=scenario.laboratory.sensor_signals
    )
    if scenario.control.lacks_policy() and not open_action and user_systems.policy is None:
        raise InputError(f"control.policy of {scenario.name} is missing; give the file of a network")
    recipes = laboratory_recipes(batch, plan, flight_duration(scenario, plan), has_external_load=has_external_load)
    samples = exported or (None if drake_random else batch.noise_samples)
    builder = DiagramBuilder()
    reference = builder.AddNamedSystem(
        "reference", build_reference(plan, num_vehicles=num_vehicles, ahead=scenario.control.preview_times())
    )
    control = user_systems.control
    if control is None:
        control = build_control(scenario, control_recipes(batch, plan, user_systems), num_vehicles, user_systems)
    builder.AddNamedSystem("control", control)
    user_wind = _sampled_wind(user_systems.wind, scenario)
    laboratory = build_laboratory_from_recipes(recipes, num_vehicles, samples, user_wind=user_wind)
    builder.AddNamedSystem("laboratory", laboratory)
    monitor = builder.AddNamedSystem(
        "monitor", build_monitor(scenario, plan, num_vehicles, has_neighbours=has_neighbours)
    )

    def connect(source: Any, signal: str, target: Any) -> None:
        """Connect the ports of a signal if both the source and the target have such a port."""
        if target.HasInputPort(signal) and source.HasOutputPort(signal):
            builder.Connect(source.GetOutputPort(signal), target.GetInputPort(signal))

    measured = [laboratory.get_output_port(i).get_name() for i in range(laboratory.num_output_ports())]
    for signal in ("reference", "reference_jerk", "reference_snap", "reference_ahead"):
        connect(reference, signal, control)
    for signal in measured:
        connect(laboratory, signal, control)
    if injects:
        injected = builder.AddNamedSystem("injected", Adder(2, control.GetOutputPort(command).size()))
        builder.Connect(control.GetOutputPort(command), injected.get_input_port(0))
        builder.Connect(injected.get_output_port(), laboratory.GetInputPort(command))
        builder.ExportInput(injected.get_input_port(1), "injection")
        builder.ExportOutput(injected.get_output_port(), "injected")
    else:
        connect(control, command, laboratory)
    connect(monitor, "crashed", laboratory)
    if open_action:
        builder.ExportInput(control.GetInputPort("action"), "action")
    for part, port_name in ((laboratory, "external_load"), (monitor, "clearance")):
        if part.HasInputPort(port_name):
            builder.ExportInput(part.GetInputPort(port_name), port_name)
    for port in (laboratory.get_input_port(i) for i in range(laboratory.num_input_ports())):
        if port.get_name().startswith(EXPORTED_PREFIX):
            builder.ExportInput(port, port.get_name())

    parts = (reference, ["reference"]), (control, _CONTROL_SIGNALS), (laboratory, measured), (monitor, ["crashed"])
    signals = {name: part.GetOutputPort(name) for part, names in parts for name in names if part.HasOutputPort(name)}
    _connect_monitor(builder, monitor, signals, scenario)
    for name, port in signals.items():
        builder.ExportOutput(port, name)
    if record:
        sizes = {name: port.size() for name, port in signals.items()}
        recorder = build_recorder(sizes, period=scenario.laboratory.command_link.period)
        builder.AddNamedSystem("recorder", recorder)
        for name, port in signals.items():
            builder.Connect(port, recorder.GetInputPort(name))
    diagram = builder.Build()
    diagram.set_name(scenario.name)
    return diagram


def _connect_monitor(builder: DiagramBuilder, monitor: Any, signals: Mapping[str, Any], scenario: Scenario) -> None:
    """Connect the flight monitor to the signals of the diagram, whose output ports are keyed by signal name.

    Raises:
        InputError: if an additional metric needs a signal that the diagram lacks.
    """
    definitions = metric_definitions(scenario.metrics_type)
    read = {signal for metric in definitions.values() for signal in metric.signals}
    for port in (monitor.get_input_port(i) for i in range(monitor.num_input_ports())):
        name = port.get_name()
        if name in signals and (name in read or name not in _COMMANDS or name == scenario.laboratory.autopilot.command):
            builder.Connect(signals[name], port)
    additional = {name: f"metrics.additional.{name}" for name in scenario.metrics.additional}
    for name, path in {**additional, **{name: f"requirements.{name}" for name in scenario.requirements}}.items():
        for signal in definitions[name].signals:
            if signal not in signals:
                raise InputError(
                    f"{path} needs the signal {signal}, but the signals of {scenario.name} are {join_names([*signals])}"
                )


def reset_fleet(
    diagram: Diagram, context: Context, batch: Batch, plan: Plan, *, user_systems: UserSystems = UserSystems()
) -> None:
    """Reset the context of a diagram for another batch, as if the diagram had been built for that batch.

    Args:
        diagram: diagram from `build_fleet_diagram` for a batch of the same scenario and size, and for the same plan.
        context: context of the diagram.
        batch: new batch.
        plan: plan that the vehicles follow.
        user_systems: user's systems in the diagram, which do not depend on the batch.

    Raises:
        InputError: if the time step of the vehicle is too long.
    """
    diagram.SetDefaultContext(context)
    context.SetTime(0.0)
    reset_fleet_parts(diagram, context, batch, plan, user_systems=user_systems)


def reset_fleet_parts(
    diagram: Diagram, context: Context, batch: Batch, plan: Plan, *, user_systems: UserSystems = UserSystems()
) -> None:
    """Reset a default context for another batch. The arguments are as in `reset_fleet`.

    The diagram may be a subsystem, whose context is part of a larger one.
    """
    laboratory = diagram.GetSubsystemByName("laboratory")
    has_load, duration = laboratory.HasInputPort("external_load"), flight_duration(batch.scenario, plan)
    for path, recipe in laboratory_recipes(batch, plan, duration, has_external_load=has_load).items():
        recipe.reset(laboratory, path, context)
    for system in laboratory.GetSystems():
        if isinstance(system, NoiseSource):
            system.reset(system.GetMyMutableContextFromRoot(context), batch.noise_samples)
    control = diagram.GetSubsystemByName("control")
    for path, recipe in control_recipes(batch, plan, user_systems).items():
        recipe.reset(control, path, context)


def set_fleet_parameters(
    diagram: Diagram, context: Context, batch: Batch, plan: Plan, *, user_systems: UserSystems = UserSystems()
) -> None:
    """Set the numeric parameters of the systems of a diagram for another batch; the states do not change.

    Args:
        diagram: diagram from `build_fleet_diagram`, for a batch of the same scenario and size, and with the same plan.
        context: context of the diagram.
        batch: batch that determines the parameters.
        plan: plan that the vehicles follow.
        user_systems: user's systems in the diagram, whose parameters do not change.
    """
    recipes = {
        "laboratory": laboratory_recipes(batch, plan, flight_duration(batch.scenario, plan)),
        "control": control_recipes(batch, plan, user_systems),
    }
    for name, own_recipes in recipes.items():
        part = diagram.GetSubsystemByName(name)
        for path, recipe in own_recipes.items():
            system = subsystem(part, path.split("."))
            if isinstance(system, FleetSystem):
                system.set_parameters(system.GetMyMutableContextFromRoot(context), recipe.parameters)


def _sampled_wind(wind: Any, scenario: Scenario) -> Any:
    """Return a user's source of wind with a zero-order hold at its output; None if there is no source.

    A source that is a `FleetSystem` with periodic updates is returned unchanged.
    """
    if wind is None or (isinstance(wind, FleetSystem) and wind.updates):
        return wind
    return build_held_wind(wind, period=wind_period(scenario))
