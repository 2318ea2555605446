"""From one to many."""

from pydrake.systems.framework import BasicVector, BasicVector_, Context

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system


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

    def _calc(self, context: Context, output: BasicVector) -> None:
        rows = self.EvalVectorInput(context, self._single)
        if self.scalar is float:
            output.get_mutable_value().reshape(self._num_rows, -1)[:] = rows.value()[:, None]
        else:
            output.SetFromVector(rows.CopyToVector().repeat(self.num_vehicles))
