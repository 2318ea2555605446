"""The wiring: a scenario in, a named Diagram out.

reference ──▶ control ──▶ laboratory
│            ▲             │
│            └─measurement─┘
└──▶ monitor, recorder ◀── (all of them)
"""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad import parts
from drake_quad.control.cascade import POSITION_SIGNALS
from drake_quad.laboratory.recorder import build_recorder
from drake_quad.laboratory.tape import Samples
from drake_quad.planning import flight_duration, plan_route, refuse_distributions
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import build_reference
from drake_quad.scenario import Scenario, distributions_in, draw_samples

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
    plan: Plan | None = None,
    record: bool = False,
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
        plan: flown instead of that of the scenario's route.
        record: whether to add a recorder of all signals, sampled at every tick of the control.

    Raises:
        InputError: the scenario holds a distribution and no samples are given, or one in its route; or the rotors
            cannot fly the route.
        ValueError: there are not N samples.
    """
    if samples is None:
        refuse_distributions(distributions_in(scenario))
        first = scenario.sample or 0
        samples = range(first, first + num_vehicles)
    elif len(samples) != num_vehicles:
        raise ValueError(f"{num_vehicles} vehicles cannot fly {len(samples)} samples, one each")
    drawn = draw_samples(scenario, samples)
    plan = plan or plan_route(drawn)
    duration = flight_duration(drawn, plan)

    builder = DiagramBuilder()
    systems = {
        "reference": build_reference(plan, num_vehicles=num_vehicles),
        "control": control or parts.control(drawn, plan, num_vehicles, position_controller),
        "laboratory": parts.laboratory(drawn, plan, duration, Samples(drawn.seed, samples)),
        "monitor": parts.monitor(drawn, num_vehicles),
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


def _add_recorder(builder: DiagramBuilder, sources: dict[str, Any], period: float) -> None:
    sizes = {name: port.size() for name, port in sources.items()}
    recorder = builder.AddNamedSystem("recorder", build_recorder(sizes, period=period))
    for name, port in sources.items():
        builder.Connect(port, recorder.GetInputPort(name))
