"""Additions to Drake's DiagramBuilder: ports connected by name or in order, and outputs split into signals."""

from collections.abc import Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer


def split_output(builder: DiagramBuilder, name: str, system: Any) -> dict[str, Any]:
    """Add a system with a packed output to a builder, split the output, and return a port for each signal.

    The system computes several signals with one formula, since a call of Python takes far longer than Drake's
    Demultiplexer. The Demultiplexer is added beside the system under `name` with `_parts` appended.
    """
    builder.AddNamedSystem(name, system)
    sizes = [layout.num_rows * system.num_vehicles for layout in system.packed.values()]
    parts = Demultiplexer(sizes)
    append(builder, f"{name}_parts", parts, system.get_output_port())
    return {signal: parts.get_output_port(i) for i, signal in enumerate(system.packed)}


def append(builder: DiagramBuilder, name: str, system: Any, *sources: Any) -> Any:
    """Add a system, feed its input ports in their order by output ports, and return its first output port."""
    builder.AddNamedSystem(name, system)
    for i, source in enumerate(sources):
        builder.Connect(source, system.get_input_port(i))
    return system.get_output_port(0)


def connect_inputs(
    builder: DiagramBuilder,
    systems: Iterable[Any],
    sources: Mapping[str, Any] = MappingProxyType({}),
    exported: Container[str] = (),
) -> None:
    """Connect input ports by their names; ports that are already connected do not change.

    Args:
        builder: builder with the systems.
        systems: systems whose input ports are connected.
        sources: output ports that feed the input ports of the same names.
        exported: names of input ports that are exported; ports of the same name become one input port of the diagram.
    """
    exported_names: set[str] = set()
    for system in systems:
        for port in map(system.get_input_port, range(system.num_input_ports())):
            name = port.get_name()
            if builder.IsConnectedOrExported(port):
                continue
            if name in sources:
                builder.Connect(sources[name], port)
            elif name in exported_names:
                builder.ConnectInput(name, port)
            elif name in exported:
                builder.ExportInput(port, name)
                exported_names.add(name)


def build(builder: DiagramBuilder, name: str) -> Diagram:
    """Build a diagram and give it a name."""
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def subsystem(diagram: Any, path: Sequence[str]) -> Any:
    """Return the system with a path of names, such as `("laboratory", "vehicle")`; the diagram for an empty path.

    Systems are identified by names because scalar conversion keeps names, but not the order of systems.
    """
    system: Any = diagram
    for name in path:
        system = system.GetSubsystemByName(name)
    return system
