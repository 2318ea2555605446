"""Compilation of a diagram, which replaces its systems with one compiled system."""

from collections import defaultdict
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.compilation.blocks import find_block, has_vectors, reason_not_compilable
from drake_quad.compilation.compiled_system import CompiledSystem, input_name
from drake_quad.compilation.placeholder import SystemPlaceholder, has_state, system_for_compiled_diagram
from drake_quad.compilation.program import Program
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.errors import InputError
from drake_quad.framework.formulas import INTERPRETED
from drake_quad.framework.wiring import build

# Name of the compiled system in a compiled diagram.
COMPILED = "compiled"


def compile_diagram(
    diagram: Diagram, *, ticks: int | None = None, tick: float | None = None, record: bool = False
) -> Diagram:
    """Compile a diagram to machine code.

    Systems that declare formulas, and some simple Drake systems, are compiled to a single system. All other systems,
    such as a controller in plain Python, remain separate systems in the compiled diagram.

    Args:
        diagram: diagram of systems with discrete state, for any number of vehicles. The compiled diagram refers to it
            and does not change it.
        ticks: largest number of ticks that one event may simulate, if no other system needs intermediate results.
            Outputs are then updated only at the end of an event, and simulations must start at time zero. With None,
            the compiled diagram has an event at every instant at which the original diagram has one. Its state and
            outputs are then those of the original diagram at any time.
        tick: period of the ticks, s, by default the least common multiple of all periods. The period must be a multiple
            of the shortest period, and must divide the least common multiple.
        record: True to record the output ports at every tick, with the values before the discrete updates.

    Returns:
        Diagram with the same exported ports and the same default state. Its subsystem `compiled` is a `CompiledSystem`.
        Its other subsystems are named after their paths in the original diagram.

    Raises:
        InputError: if the diagram cannot be compiled; the message states the reason.
    """
    if INTERPRETED:
        raise InputError(
            "DRAKE_QUAD_INTERPRETED is set, so formulas are not compiled; unset it, or simulate the uncompiled"
            " diagram (`compiled=False`, or --wired in a command)"
        )
    program = Program(diagram)
    for path, system in program.uncompiled.items():
        if not (isinstance(system, SystemPlaceholder) or hasattr(system, "new_copy")):
            _check_uncompiled(path, system)
    core = CompiledSystem(program, ticks=ticks, tick=tick, record=record)
    builder = DiagramBuilder()
    builder.AddNamedSystem(COMPILED, core)
    uncompiled = {}
    for path, system in program.uncompiled.items():
        uncompiled[path] = builder.AddNamedSystem(path, system_for_compiled_diagram(system))
    for source in program.row_ranges.inputs:
        if isinstance(source, Port):
            port = uncompiled[source.path].get_output_port(source.number)
            builder.Connect(port, core.GetInputPort(input_name(program, source)))
    exported = _connect_uncompiled(builder, program, core, uncompiled)
    # The input ports are exported in the order of the original diagram.
    for number in range(diagram.num_input_ports()):
        name = diagram.get_input_port(number).get_name()
        ports = exported[name]
        if any(isinstance(source, ExportedPort) and source.name == name for source in program.row_ranges.inputs):
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
    """Return the compiled system of a diagram from `compile_diagram`."""
    part: CompiledSystem = diagram.GetSubsystemByName(COMPILED)
    return part


def as_compilable(system: Any) -> Any:
    """Return the system if it can be compiled, else a `SystemPlaceholder` for it.

    A diagram with the placeholder can be compiled. The compiled diagram contains the system instead of the placeholder.
    """
    leaves = Topology(system).leaves.values() if isinstance(system, Diagram) else [system]
    return system if all(map(find_block, leaves)) else SystemPlaceholder(system)


def _connect_uncompiled(
    builder: DiagramBuilder, program: Program, core: Any, uncompiled: dict[str, Any]
) -> dict[str, list[Any]]:
    """Connect the inputs of uncompiled systems, and return the inputs that the diagram exports, by port name."""
    exported: dict[str, list[Any]] = defaultdict(list)
    for path, system in uncompiled.items():
        for index, source in enumerate(program.topology.sources(path)):
            port = system.get_input_port(index)
            if isinstance(source, Port):
                if source.path in uncompiled:
                    builder.Connect(uncompiled[source.path].get_output_port(source.number), port)
                else:
                    builder.Connect(core.GetOutputPort(f"{path}.{port.get_name()}"), port)
            elif source is not None:
                exported[source.name].append(port)
    return exported


def _check_uncompiled(path: str, system: Any) -> None:
    """Raise InputError if an uncompiled system cannot be a subsystem of the compiled diagram."""
    if has_state(system):
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled: {reason_not_compilable(system)}. It cannot be"
            " combined with compiled systems either, since it has a state"
        )
    if not has_vectors(system):
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled or combined with compiled systems: some of its"
            " ports are not vector-valued"
        )
    if not system.num_output_ports():
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled: it has no output ports, and its effect is unknown"
        )
