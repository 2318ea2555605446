"""The reference as a Drake system."""

from typing import Any

from pydrake.systems.framework import BasicVector_, Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, TrajectorySource

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.reference.plan import REFERENCE_PORTS, Plan


@fleet_system(float, AutoDiffXd)
class Broadcast(FleetSystem):
    """Gives every vehicle of a fleet the same rows.

    .. pydrake_system::

        name: Broadcast
        input_ports:
        - single
        output_ports:
        - fleet

    Args:
        num_vehicles: N.
        num_rows: k; `single` has k elements, `fleet` k rows of N.
    """

    def declare(self, *, num_rows: int = 1) -> None:
        """Declares the system."""
        self._num_rows = num_rows
        self._single = self.DeclareVectorInputPort("single", BasicVector_[self.scalar](num_rows)).get_index()
        size, uses = num_rows * self.num_vehicles, {self.input_port_ticket(self._single)}
        self.DeclareVectorOutputPort("fleet", BasicVector_[self.scalar](size), self._calc, uses)

    def _calc(self, context: Context, output: Any) -> None:
        rows = self.EvalVectorInput(context, self._single)
        if self.scalar is float:
            output.get_mutable_value().reshape(self._num_rows, -1)[:] = rows.value()[:, None]
        else:
            output.SetFromVector(rows.CopyToVector().repeat(self.num_vehicles))


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
