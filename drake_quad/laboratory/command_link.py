"""The radio link from the ground station to the vehicle."""

from collections.abc import Sequence
from typing import Any

from drake_quad.elementary import Row
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


@fleet_system(float, AutoDiffXd)
class CommandLink(FleetSystem):
    """Samples the commanded wrench, carries it for a number of ticks, and holds it until the next one arrives.

    .. pydrake_system::

        name: CommandLink
        input_ports:
        - wrench
        output_ports:
        - wrench

    Both ports have 4 rows: F_z (N), τ_x, τ_y, τ_z (N m). What is sampled at a tick leaves `delay_ticks` later:

        tick            0          1          2
        sampled         u₀         u₁         u₂
        1 tick of delay initial    u₀         u₁

    The only discrete-state group holds the wrenches under way, 4 rows each, the oldest first.

    Args:
        num_vehicles: N.
        period: of the ticks, s; the paper's controllers run at 50 Hz.
        delay_ticks: whole number of ticks from sampling to arrival.
        initial: 4 rows, the wrench that is out before the first one arrives.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.02,
        delay_ticks: int = 0,
        initial: Sequence[Row] = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._wrench = self.input("wrench", 4)
        self._under_way = self.discrete_state([*initial] * (delay_ticks + 1))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._send)
        self.output("wrench", 4, self._calc_wrench, uses={self.discrete_state_ticket(self._under_way)})

    def _send(self, context: Any, discrete_state: Any) -> None:
        size = 4 * self.num_vehicles
        queue = discrete_state.get_mutable_vector(self._under_way)
        values = queue.CopyToVector()
        values[:-size] = values[size:]
        values[-size:] = self._wrench.Eval(context)
        queue.SetFromVector(values)

    def _calc_wrench(self, context: Any, output: Any) -> None:
        oldest = self.values(context.get_discrete_state(self._under_way))[: 4 * self.num_vehicles]
        output.SetFromVector(oldest)
