"""Additions to Drake's DiagramBuilder: ports connected by name or in order, and outputs split into signals."""

from collections.abc import Container, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer


def split_output(builder: DiagramBuilder, name: str, system: Any) -> dict[str, Any]:
    """Adds a system with a packed output under a name, takes the output apart and returns a port for each signal.

    Where several signals follow from one formula, a system computes them together: a call into Python costs far more
    than Drake's Demultiplexer, which stands beside the system as `name` with `_parts` appended.
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
    """Connect input ports by their names; those that are connected already are left as they are.

    Args:
        builder: builder with the systems.
        systems: systems whose input ports are connected.
        sources: output ports that feed the input ports of the same names.
        exported: names of further input ports; those of one name become one input port of the diagram.
    """
    found: set[str] = set()
    for system in systems:
        for port in map(system.get_input_port, range(system.num_input_ports())):
            name = port.get_name()
            if builder.IsConnectedOrExported(port):
                continue
            if name in sources:
                builder.Connect(sources[name], port)
            elif name in found:
                builder.ConnectInput(name, port)
            elif name in exported:
                builder.ExportInput(port, name)
                found.add(name)


def build(builder: DiagramBuilder, name: str) -> Diagram:
    """Return the diagram of a builder, with a name."""
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def subsystem(diagram: Any, path: Sequence[str]) -> Any:
    """The system at the end of a path of names, such as `("laboratory", "vehicle")`; the diagram at the end of none.

    Scalar conversion keeps names, but not the order of systems.
    """
    system: Any = diagram
    for name in path:
        system = system.GetSubsystemByName(name)
    return system
