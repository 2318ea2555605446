"""From a built diagram to a compiled one."""

from collections import defaultdict
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.compilation.blocks import block_of, has_vectors, why_not
from drake_quad.compilation.compiled_system import CompiledSystem, input_name
from drake_quad.compilation.program import Program
from drake_quad.compilation.stand_in import StandIn, remembers
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.errors import InputError
from drake_quad.framework.formulas import INTERPRETED
from drake_quad.framework.wiring import build

# What a compiled diagram calls its compiled system.
COMPILED = "compiled"


def compile_diagram(
    diagram: Diagram, *, ticks: int | None = None, tick: float | None = None, record: bool = False
) -> Diagram:
    """Compiles a diagram to machine code.

    What declares its formulas is compiled, and so are the simplest of Drake's own systems. Every other system, such as
    a controller in plain Python, stays what it is beside the compiled one.

    Args:
        diagram: of systems with discrete state, for any number of vehicles. It is kept, and not changed.
        ticks: None for events at every instant at which something happens in the diagram: state and ports are those of
            the diagram at any time. Else how many ticks an event takes at once where nothing else looks in between:
            ports then show what holds at their end, and simulations begin at time zero.
        tick: the time between two ticks, one of the periods, s; if not given, that after which everything happens
            together again.
        record: whether the output ports are recorded at every tick, as discrete updates see them.

    Returns:
        A diagram with the same exported ports, in the state that the diagram has by default. Its subsystem `compiled`
        is a `CompiledSystem`; the others have the names of their paths.

    Raises:
        InputError: the diagram cannot be compiled, and why.
    """
    if INTERPRETED:
        raise InputError("DRAKE_QUAD_INTERPRETED is set, so formulas run as they are written; fly the diagram as wired")
    program = Program(diagram)
    for path, system in program.others.items():
        if not isinstance(system, StandIn):
            _check_other(path, system)
    core = CompiledSystem(program, ticks=ticks, tick=tick, record=record)
    builder = DiagramBuilder()
    builder.AddNamedSystem(COMPILED, core)
    others = {}
    for path, system in program.others.items():
        others[path] = builder.AddNamedSystem(path, system.system if isinstance(system, StandIn) else StandIn(system))
    for source in program.places.inputs:
        if isinstance(source, Port):
            port = others[source.path].get_output_port(source.number)
            builder.Connect(port, core.GetInputPort(input_name(program, source)))
    exported = _connect_others(builder, program, core, others)
    # In the order of the diagram's.
    for number in range(diagram.num_input_ports()):
        name = diagram.get_input_port(number).get_name()
        ports = exported[name]
        if any(isinstance(source, ExportedPort) and source.name == name for source in program.places.inputs):
            ports.append(core.GetInputPort(name))
        for port in ports:
            if port is ports[0]:
                builder.ExportInput(port, name)
            else:
                builder.ConnectInput(name, port)
    for name in program.topology.outputs:
        builder.ExportOutput(core.GetOutputPort(name), name)
    return build(builder, diagram.get_name())


def compiled_part(diagram: Diagram) -> CompiledSystem:
    """The compiled system in a diagram from `compile_diagram`."""
    part: CompiledSystem = diagram.GetSubsystemByName(COMPILED)
    return part


def or_stand_in(system: Any) -> Any:
    """A system as it is, if it can be compiled; else what stands in for it in a diagram that will be.

    In the compiled diagram there is the system itself again.
    """
    leaves = Topology(system).leaves.values() if isinstance(system, Diagram) else [system]
    return system if all(map(block_of, leaves)) else StandIn(system)


def _connect_others(
    builder: DiagramBuilder, program: Program, core: Any, others: dict[str, Any]
) -> dict[str, list[Any]]:
    """Connects the inputs of what is not compiled; returns those that are the diagram's, by name."""
    exported: dict[str, list[Any]] = defaultdict(list)
    for path, system in others.items():
        for index, source in enumerate(program.topology.sources(path)):
            port = system.get_input_port(index)
            if isinstance(source, Port):
                if source.path in others:
                    builder.Connect(others[source.path].get_output_port(source.number), port)
                else:
                    builder.Connect(core.GetOutputPort(f"{path}.{port.get_name()}"), port)
            elif source is not None:
                exported[source.name].append(port)
    return exported


def _check_other(path: str, system: Any) -> None:
    """Raises InputError if a system of another diagram cannot be shown here."""
    if remembers(system):
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled: {why_not(system)}; and it cannot stand beside"
            " compiled systems, since it has a state of its own"
        )
    if not has_vectors(system):
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled, nor stand beside compiled systems: what some of"
            " its ports hold are no vectors"
        )
    if not system.num_output_ports():
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled: it has no output, and what it does is not known"
        )
