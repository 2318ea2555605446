"""Helper functions for Drake's DiagramBuilder, which connect ports by name or in order, and separate packed outputs."""

from collections.abc import Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer


def split_output(builder: DiagramBuilder, name: str, system: Any) -> dict[str, Any]:
    """Add a system with a packed output and a Demultiplexer to a builder, and return a port for each signal.

    A packed output computes several signals with one formula. This is faster than several outputs, since a Python call
    takes far longer than Drake's Demultiplexer. The Demultiplexer is named after the system, with `_parts` appended.
    """
    builder.AddNamedSystem(name, system)
    sizes = [layout.num_rows * system.num_vehicles for layout in system.packed.values()]
    parts = Demultiplexer(sizes)
    append(builder, f"{name}_parts", parts, system.get_output_port())
    return {signal: parts.get_output_port(i) for i, signal in enumerate(system.packed)}


def append(builder: DiagramBuilder, name: str, system: Any, *sources: Any) -> Any:
    """Add a system, connect the given output ports to its input ports in order, and return its first output port."""
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
    """Connect or export input ports by name; ports that are already connected or exported are not changed.

    Args:
        builder: builder that contains the systems.
        systems: systems whose input ports are connected.
        sources: output ports, by the names of the input ports to which they are connected.
        exported: names of input ports to export; ports of the same name become a single input port of the diagram.
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
    """Return the system at a path of names, such as `("laboratory", "vehicle")`; the diagram if the path is empty.

    Systems are identified by names because scalar conversion preserves names, but not the order of systems.
    """
    system: Any = diagram
    for name in path:
        system = system.GetSubsystemByName(name)
    return system
