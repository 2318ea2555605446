"""What a DiagramBuilder lacks: ports by name, and outputs that are taken apart."""

from collections.abc import Sequence
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


def subsystem(diagram: Any, path: Sequence[str]) -> Any:
    """The system at the end of a path of names, such as `("laboratory", "vehicle")`; the diagram at the end of none.

    Scalar conversion keeps names, but not the order of systems.
    """
    system: Any = diagram
    for name in path:
        system = system.GetSubsystemByName(name)
    return system
