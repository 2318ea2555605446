"""The reference as a Drake system."""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, Multiplexer, TrajectorySource

from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.wiring import append, build
from drake_quad.reference.plan import REFERENCE_PORTS, Plan


def build_reference(plan: Plan, *, num_vehicles: int = 1, ahead: Sequence[float] = ()) -> Diagram:
    """Builds the diagram `reference` around Drake's TrajectorySource.

    .. pydrake_system::

        name: reference
        output_ports:
        - reference
        - reference_jerk
        - reference_snap
        - reference_ahead

    The last one is there if it is asked for: X, Y and Z of the position at one time ahead after another.

    Args:
        plan: flown by every vehicle.
        num_vehicles: N.
        ahead: times from now, s.
    """
    builder = DiagramBuilder()
    source = append(builder, "trajectory", TrajectorySource(plan.reference()))
    parts = Demultiplexer([len(kind._fields) for kind in REFERENCE_PORTS.values()])
    append(builder, "parts", parts, source)
    shown = {name: parts.get_output_port(i) for i, name in enumerate(REFERENCE_PORTS)}
    if ahead:
        shown["reference_ahead"] = _positions_ahead(builder, plan, ahead)
    for name, port in shown.items():
        if num_vehicles > 1:
            port = append(builder, name, Broadcast(num_vehicles=num_vehicles, num_rows=port.size()), port)
        builder.ExportOutput(port, name)
    return build(builder, "reference")


def _positions_ahead(builder: DiagramBuilder, plan: Plan, ahead: Sequence[float]) -> Any:
    """Return the port that shows where the reference will be."""
    sources = []
    for i, time in enumerate(ahead):
        position = plan.derivative(0)
        position.shiftRight(-time)
        sources.append(append(builder, f"ahead_{i}", TrajectorySource(position)))
    return append(builder, "ahead", Multiplexer([3] * len(ahead)), *sources)
