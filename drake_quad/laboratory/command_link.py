"""The radio link from the ground station to the vehicle."""

from typing import Any

from drake_quad.elementary import Rows
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

    Discrete-state groups, 4 rows each: 0 the wrench that is out, then those under way, the next one first.

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
        initial: Rows = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._wrench = self.input("wrench", 4)
        self._arrived = self.discrete_state(initial)
        self._under_way = [self.discrete_state(initial) for _ in range(delay_ticks)]
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._tick)
        self.DeclareStateOutputPort("wrench", self._arrived)

    def _tick(self, context: Any, discrete_state: Any) -> None:
        place = self._arrived
        for behind in self._under_way:
            self.copy(discrete_state.get_mutable_vector(place), context.get_discrete_state(behind))
            place = behind
        self.copy(discrete_state.get_mutable_vector(place), self.EvalVectorInput(context, self._wrench))
