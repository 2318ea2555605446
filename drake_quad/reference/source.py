"""The reference as a Drake system."""

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, TrajectorySource

from drake_quad.framework.broadcast import Broadcast
from drake_quad.reference.plan import REFERENCE_PORTS, Plan


def build_reference(plan: Plan, *, num_vehicles: int = 1) -> Diagram:
    """Builds the diagram `reference` around Drake's TrajectorySource.

    .. pydrake_system::

        name: reference
        output_ports:
        - reference
        - reference_jerk
        - reference_snap

    Args:
        plan: flown by every vehicle.
        num_vehicles: N.
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
    reference = builder.Build()
    reference.set_name("reference")
    return reference
