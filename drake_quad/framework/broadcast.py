"""System that copies the signal of one vehicle to every vehicle of a fleet."""

from pydrake.systems.framework import BasicVector, BasicVector_, Context

from drake_quad.errors import not_connected
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system


@fleet_system(float, AutoDiffXd)
class Broadcast(FleetSystem):
    """System that copies the signal of a single vehicle to every vehicle of a fleet.

    .. pydrake_system::

        name: Broadcast
        input_ports:
        - single
        output_ports:
        - fleet

    Args:
        num_vehicles: number N of vehicles.
        num_rows: number k of components of the signal; `single` has k elements, and `fleet` has k rows of N elements.
    """

    def declare(self, *, num_rows: int = 1) -> None:
        """Declare the ports of this system."""
        self._num_rows = num_rows
        self._single = self.DeclareVectorInputPort("single", BasicVector_[self.scalar](num_rows)).get_index()
        size, prerequisites = num_rows * self.num_vehicles, {self.input_port_ticket(self._single)}
        self.DeclareVectorOutputPort("fleet", BasicVector_[self.scalar](size), self._calc, prerequisites)

    def _calc(self, context: Context, output: BasicVector) -> None:
        rows = self.EvalVectorInput(context, self._single)
        if rows is None:
            raise not_connected("single", self)
        if self.scalar is float:
            output.get_mutable_value().reshape(self._num_rows, -1)[:] = rows.value()[:, None]
        else:
            output.SetFromVector(rows.CopyToVector().repeat(self.num_vehicles))
