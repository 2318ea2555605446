"""Drake diagram that outputs a plan as the reference."""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, Multiplexer, TrajectorySource

from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.wiring import append, build
from drake_quad.reference.plan import REFERENCE_PORTS, Plan


def build_reference(plan: Plan, *, num_vehicles: int = 1, ahead: Sequence[float] = ()) -> Diagram:
    """Build the diagram `reference` around Drake's TrajectorySource.

    .. pydrake_system::

        name: reference
        output_ports:
        - reference
        - reference_jerk
        - reference_snap
        - reference_ahead

    The output `reference_ahead` exists if `ahead` is not empty. It contains the position X, Y, Z at the first of these
    future times, then at the second, and so on.

    Args:
        plan: plan that every vehicle follows.
        num_vehicles: number N of vehicles.
        ahead: preview times relative to the present, s.
    """
    builder = DiagramBuilder()
    source = append(builder, "trajectory", TrajectorySource(plan.reference()))
    parts = Demultiplexer([len(kind._fields) for kind in REFERENCE_PORTS.values()])
    append(builder, "parts", parts, source)
    outputs = {name: parts.get_output_port(i) for i, name in enumerate(REFERENCE_PORTS)}
    if ahead:
        outputs["reference_ahead"] = _positions_ahead(builder, plan, ahead)
    for name, port in outputs.items():
        if num_vehicles > 1:
            port = append(builder, name, Broadcast(num_vehicles=num_vehicles, num_rows=port.size()), port)
        builder.ExportOutput(port, name)
    return build(builder, "reference")


def _positions_ahead(builder: DiagramBuilder, plan: Plan, ahead: Sequence[float]) -> Any:
    """Return the port with the future positions of the reference."""
    sources = []
    for i, time in enumerate(ahead):
        position = plan.derivative(0)
        position.shiftRight(-time)
        sources.append(append(builder, f"ahead_{i}", TrajectorySource(position)))
    return append(builder, "ahead", Multiplexer([3] * len(ahead)), *sources)
