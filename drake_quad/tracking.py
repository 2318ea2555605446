"""The wiring: a scenario in, a named Diagram out.

reference ──▶ control ──▶ laboratory
│            ▲             │
│            └─measurement─┘
└──▶ monitor, recorder ◀── (all of them)
"""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.cascade import POSITION_SIGNALS
from drake_quad.fleet import FleetSystem
from drake_quad.laboratory.recorder import build_recorder
from drake_quad.laboratory.tape import Samples, TapePlayer
from drake_quad.laboratory.wind.wind import build_held_wind
from drake_quad.parts.control import build_control, control_parts
from drake_quad.parts.laboratory import build_laboratory_of, laboratory_parts, monitor_part, wind_period
from drake_quad.parts.part import Part, subsystem
from drake_quad.planning import flight_duration, plan_route, refuse_distributions
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import build_reference
from drake_quad.scenario import Scenario, distributions_in, draw_samples
from drake_quad.substitutes import check_substitutes

# What is exported, and recorded, from each part; a control of the user's own need only have `wrench`.
_SIGNALS = {
    "reference": ("reference",),
    "control": (*POSITION_SIGNALS, "acceleration_command", "attitude_command", "wrench"),
    "laboratory": ("measurement", "state", "rotor_speed", "rotor_speed_command", "shortfall", "wind"),
    "monitor": ("crashed",),
}


def build_tracking_diagram(
    scenario: Scenario,
    num_vehicles: int = 1,
    *,
    samples: Sequence[int] | None = None,
    position_controller: Any = None,
    control: Any = None,
    wind: Any = None,
    plan: Plan | None = None,
    record: bool = False,
    drake_random: bool = False,
) -> Diagram:
    """Builds the closed loop of a scenario.

    Its subsystems are `reference`, `control`, `laboratory`, `monitor` and, if asked for, `recorder`. Every signal of
    the loop is exported under its name; what the control does not have is left out. The default context is hover at
    the reference's first point.

    Args:
        scenario: with numbers only, unless `samples` are given.
        num_vehicles: N.
        samples: N numbers of samples of the scenario's study: each vehicle flies one, with what is drawn for it. If not
            given, all fly the same scenario, in the wind and noise of its own sample, of the next one, and so on.
        position_controller: a system that stands in for the scenario's: from `measurement` (12 rows) and `reference`
            (11 rows) to `acceleration_command` (3 rows, m/s²). The diagram takes it over.
        control: a system that stands in for the whole cascade: from `measurement` and `reference` to `wrench`
            (4 rows: F_z in N; τ_x, τ_y, τ_z in N m). The diagram takes it over.
        wind: a source of wind beside the scenario's: one output port of 3 rows, the velocity of the air in W (m/s), and
            perhaps the input port `state` (12 rows). The diagram takes it over, and samples it at the vehicle's time
            step; a FleetSystem, such as those of `drake_quad.laboratory.wind`, does that itself.
        plan: flown instead of that of the scenario's route.
        record: whether to add a recorder of all signals, sampled at every tick of the control.
        drake_random: whether wind and noise come from Drake's random sources, for its own Monte Carlo tools, in place
            of the samples' tapes.

    Raises:
        InputError: the scenario holds a distribution and no samples are given, or one in its route; or the rotors
            cannot fly the route; or a system that is given does not fit.
        ValueError: there are not N samples.
    """
    check_substitutes({"position_controller": position_controller, "control": control, "wind": wind}, num_vehicles)
    if samples is None:
        refuse_distributions(distributions_in(scenario))
        first = scenario.sample or 0
        samples = range(first, first + num_vehicles)
    elif len(samples) != num_vehicles:
        raise ValueError(f"{num_vehicles} vehicles cannot fly {len(samples)} samples, one each")
    drawn = draw_samples(scenario, samples)
    plan = plan or plan_route(drawn)
    tapes = None if drake_random else Samples(drawn.seed, samples)

    builder = DiagramBuilder()
    systems = {
        "reference": build_reference(plan, num_vehicles=num_vehicles),
        "control": control
        or build_control(drawn, control_parts(drawn, plan, num_vehicles), position_controller=position_controller),
        "laboratory": build_laboratory_of(
            _laboratory_parts(scenario, drawn, plan, num_vehicles), tapes, own_wind=_sampled(wind, drawn)
        ),
        "monitor": monitor_part(drawn, num_vehicles).build(),
    }
    for name, part in systems.items():
        builder.AddNamedSystem(name, part)
    sources = {
        name: systems[part].GetOutputPort(name)
        for part, names in _SIGNALS.items()
        for name in names
        if systems[part].HasOutputPort(name)
    }
    derivatives = {name: systems["reference"].GetOutputPort(name) for name in ("reference_jerk", "reference_snap")}
    for part in ("control", "laboratory", "monitor"):
        for i in range(systems[part].num_input_ports()):
            port = systems[part].get_input_port(i)
            name = port.get_name()
            source = sources.get(name) or derivatives.get(name)
            if source is not None:
                builder.Connect(source, port)
    for name, port in sources.items():
        builder.ExportOutput(port, name)
    if record:
        _add_recorder(builder, sources, scenario.laboratory.command_link.period)
    diagram = builder.Build()
    diagram.set_name(scenario.name)
    return diagram


def put_samples(
    diagram: Diagram,
    context: Any,
    scenario: Scenario,
    samples: Sequence[int],
    plan: Plan,
    *,
    own: Sequence[str] = (),
) -> None:
    """Makes a context what it would be by default, had its diagram been built for other samples, as many.

    Args:
        diagram: from `build_tracking_diagram`, for samples of the same scenario and with the same plan.
        context: of the diagram.
        scenario: with or without distributions.
        samples: N numbers of samples of the scenario's study.
        plan: that is flown.
        own: which of "position_controller", "control" and "wind" were given to `build_tracking_diagram`: no numbers of
            the scenario's are in them.

    Raises:
        InputError: as `build_tracking_diagram`.
    """
    num_vehicles = len(samples)
    drawn = draw_samples(scenario, samples)
    diagram.SetDefaultContext(context)
    context.SetTime(0.0)
    laboratory, control = diagram.GetSubsystemByName("laboratory"), diagram.GetSubsystemByName("control")
    for path, part in _laboratory_parts(scenario, drawn, plan, num_vehicles).items():
        _put(part, subsystem(laboratory, path), context)
    if "control" not in own:
        for path, part in control_parts(drawn, plan, num_vehicles).items():
            if "position_controller" not in own or not path.startswith("position."):
                _put(part, subsystem(control, path), context)
    for system in laboratory.GetSystems():
        if isinstance(system, TapePlayer):
            system.put_samples(system.GetMyMutableContextFromRoot(context), Samples(drawn.seed, samples))


def _put(part: Part, system: Any, context: Any) -> None:
    part.put(system, system.GetMyMutableContextFromRoot(context))


def _laboratory_parts(scenario: Scenario, drawn: Scenario, plan: Plan, num_vehicles: int) -> dict[str, Part]:
    return laboratory_parts(scenario, drawn, plan, flight_duration(drawn, plan), num_vehicles)


def _sampled(wind: Any, scenario: Scenario) -> Any:
    if wind is None or isinstance(wind, FleetSystem):
        return wind
    return build_held_wind(wind, period=wind_period(scenario))


def _add_recorder(builder: DiagramBuilder, sources: dict[str, Any], period: float) -> None:
    sizes = {name: port.size() for name, port in sources.items()}
    recorder = builder.AddNamedSystem("recorder", build_recorder(sizes, period=period))
    for name, port in sources.items():
        builder.Connect(port, recorder.GetInputPort(name))
