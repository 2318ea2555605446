"""The reference as a Drake system."""

from typing import Any

from pydrake.systems.framework import BasicVector_, Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, TrajectorySource

from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.reference.plan import Plan


@fleet_system(float, AutoDiffXd)
class SameForAll(FleetSystem):
    """Gives every vehicle of a fleet the same rows.

    .. pydrake_system::

        name: SameForAll
        input_ports:
        - one
        output_ports:
        - all

    Args:
        num_vehicles: N.
        num_rows: k; `one` has k elements, `all` k rows of N.
    """

    def declare(self, *, num_vehicles: int = 1, num_rows: int = 1) -> None:
        """Declares the system; see the class for the arguments."""
        self._one = self.DeclareVectorInputPort("one", BasicVector_[self.scalar](num_rows)).get_index()
        self.output("all", num_rows, self._calc, uses={self.all_input_ports_ticket()})

    def _calc(self, context: Any, output: Any) -> None:
        self.write(output, self.values(self.EvalVectorInput(context, self._one)))


def build_reference(plan: Plan, *, num_vehicles: int = 1) -> Diagram:
    """Builds the diagram `reference` around Drake's TrajectorySource.

    .. pydrake_system::

        name: reference
        output_ports:
        - reference
        - reference_jerk
        - reference_snap

    `reference` has 11 rows: position (m), velocity (m/s) and acceleration (m/s²) in W, yaw (rad), yaw rate (rad/s);
    `reference_jerk` has 3 (m/s³); `reference_snap` 4: the snap (m/s⁴) and the acceleration of the yaw (rad/s²).

    Args:
        plan: flown by every vehicle.
        num_vehicles: N.
    """
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("trajectory", TrajectorySource(plan.reference()))
    names = {"reference": 11, "reference_jerk": 3, "reference_snap": 4}
    parts = builder.AddNamedSystem("parts", Demultiplexer(list(names.values())))
    builder.Connect(source.get_output_port(), parts.get_input_port())
    for i, (name, num_rows) in enumerate(names.items()):
        output = parts.get_output_port(i)
        if num_vehicles > 1:
            fleet = builder.AddNamedSystem(name, SameForAll(num_vehicles=num_vehicles, num_rows=num_rows))
            builder.Connect(output, fleet.GetInputPort("one"))
            output = fleet.GetOutputPort("all")
        builder.ExportOutput(output, name)
    reference = builder.Build()
    reference.set_name("reference")
    return reference
