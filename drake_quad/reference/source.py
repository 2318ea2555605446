"""The reference as a Drake system."""

from collections.abc import Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, Multiplexer, TrajectorySource

from drake_quad.framework.broadcast import Broadcast
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
    source = builder.AddNamedSystem("trajectory", TrajectorySource(plan.reference()))
    sizes = {name: len(kind._fields) for name, kind in REFERENCE_PORTS.items()}
    parts = builder.AddNamedSystem("parts", Demultiplexer(list(sizes.values())))
    builder.Connect(source.get_output_port(), parts.get_input_port())
    for i, (name, num_rows) in enumerate(sizes.items()):
        output = parts.get_output_port(i)
        if num_vehicles > 1:
            fleet = builder.AddNamedSystem(name, Broadcast(num_vehicles=num_vehicles, num_rows=num_rows))
            builder.Connect(output, fleet.GetInputPort("single"))
            output = fleet.GetOutputPort("fleet")
        builder.ExportOutput(output, name)
    if ahead:
        _add_ahead(builder, plan, num_vehicles, ahead)
    reference = builder.Build()
    reference.set_name("reference")
    return reference


def _add_ahead(builder: DiagramBuilder, plan: Plan, num_vehicles: int, ahead: Sequence[float]) -> None:
    """Adds and exports where the reference will be."""
    rows = builder.AddNamedSystem("ahead", Multiplexer([3] * len(ahead)))
    for i, time in enumerate(ahead):
        position = plan.derivative(0)
        position.shiftRight(-time)
        source = builder.AddNamedSystem(f"ahead_{i}", TrajectorySource(position))
        builder.Connect(source.get_output_port(), rows.get_input_port(i))
    output = rows.get_output_port()
    if num_vehicles > 1:
        fleet = Broadcast(num_vehicles=num_vehicles, num_rows=3 * len(ahead))
        builder.AddNamedSystem("reference_ahead", fleet)
        builder.Connect(output, fleet.GetInputPort("single"))
        output = fleet.GetOutputPort("fleet")
    builder.ExportOutput(output, "reference_ahead")
