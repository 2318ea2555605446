"""What a DiagramBuilder lacks: ports by name, and outputs that are taken apart."""

from typing import Any

from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Demultiplexer


def split_output(builder: DiagramBuilder, name: str, system: Any) -> dict[str, Any]:
    """Adds a system with a packed output under a name, takes the output apart and returns a port for each signal.

    Where several signals follow from one formula, a system computes them together: a call into Python costs far more
    than Drake's Demultiplexer, which stands beside the system as `name` with `_parts` appended.
    """
    builder.AddNamedSystem(name, system)
    sizes = [layout.num_rows * system.num_vehicles for layout in system.packed.values()]
    parts = builder.AddNamedSystem(f"{name}_parts", Demultiplexer(sizes))
    builder.Connect(system.get_output_port(), parts.get_input_port())
    return {signal: parts.get_output_port(i) for i, signal in enumerate(system.packed)}


def subsystem(diagram: Any, path: str) -> Any:
    """The subsystem at a path, such as `laboratory.vehicle`."""
    system: Any = diagram
    for name in path.split("."):
        system = system.GetSubsystemByName(name)
    return system
