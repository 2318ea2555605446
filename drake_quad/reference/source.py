"""The reference as a Drake system."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector_, Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource

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
        self._one = self.DeclareVectorInputPort("one", BasicVector_[self.scalar](num_rows))
        self.output("all", num_rows, self._calc, uses={self.all_input_ports_ticket()})

    def _calc(self, context: Any, output: Any) -> None:
        output.SetFromVector(np.repeat(self._one.Eval(context), self.num_vehicles))


def build_reference(plan: Plan, *, num_vehicles: int = 1) -> Diagram:
    """Builds the diagram `reference` around Drake's TrajectorySource.

    .. pydrake_system::

        name: reference
        output_ports:
        - reference
        - reference_jerk

    `reference` has 11 rows: position (m), velocity (m/s) and acceleration (m/s²) in W, yaw (rad), yaw rate (rad/s);
    `reference_jerk` has 3 (m/s³).

    Args:
        plan: flown by every vehicle.
        num_vehicles: N.
    """
    builder = DiagramBuilder()
    for name, trajectory in (("reference", plan.reference), ("reference_jerk", plan.derivative(3))):
        source = builder.AddNamedSystem(f"{name}_trajectory", TrajectorySource(trajectory))
        output = source.get_output_port()
        if num_vehicles > 1:
            fleet = builder.AddNamedSystem(name, SameForAll(num_vehicles=num_vehicles, num_rows=trajectory.rows()))
            builder.Connect(output, fleet.GetInputPort("one"))
            output = fleet.GetOutputPort("all")
        builder.ExportOutput(output, name)
    reference = builder.Build()
    reference.set_name("reference")
    return reference
