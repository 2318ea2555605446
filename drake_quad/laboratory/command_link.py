"""The radio link from the ground station to the vehicle."""

from typing import Any

from pydrake.common import RandomDistribution

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, is_zero, where
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.delay_line import DelayLine


@formula
def sent(wrench: Rows, last: Rows, number: Rows, loss_rate: Rows) -> tuple[Rows]:
    """The wrench, or the last one again if the packet is lost, for which the number is below the loss rate."""
    return (where(number[0] < loss_rate[0], last, wrench),)


@fleet_system(float, AutoDiffXd)
class CommandLink(FleetSystem):
    """Samples the commanded wrench, carries it for a number of ticks, and holds it until the next one arrives.

    .. pydrake_system::

        name: CommandLink
        input_ports:
        - wrench
        - packet_loss
        output_ports:
        - wrench

    Both wrenches have 4 rows: F_z (N), τ_x, τ_y, τ_z (N m). What is sampled at a tick leaves `delay_ticks` later; a
    packet that is lost leaves the one before it out. `packet_loss` (1 row) is random: a number between 0 and 1 for
    each packet, which is lost if it is below the loss rate. The port is there if packets can be lost.

    Discrete-state groups, 4 rows each: those of a `DelayLine`. Numeric parameters of the context: the delay, if there
    can be any, and the loss rate, if packets can be lost.

    Args:
        num_vehicles: N.
        period: of the ticks, s; the paper's controllers run at 50 Hz.
        delay_ticks: whole number of ticks from sampling to arrival; a number or an (N,) array.
        longest_delay: that it will ever be in a context; if not given, no longer than these.
        loss_rate: share of the packets that are lost, 1; likewise.
        initial: 4 rows, the wrench that is out before the first one arrives.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.02,
        delay_ticks: Row = 0,
        longest_delay: int | None = None,
        loss_rate: Row = 0.0,
        initial: Rows = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self.period = period
        self._wrench = self.input("wrench", 4)
        self._line = DelayLine(self, "wrench", initial, delay_ticks, longest_delay)
        self._loss_rate = None
        if not is_zero(loss_rate):
            self._loss_rate = self.numeric_parameter([loss_rate])
            self._send = self.mapped(sent, inputs=(4, 4, 1, 1), outputs=(4,))
            self._packet_loss = self.random_input("packet_loss", 1, RandomDistribution.kUniform)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._tick)
        self.state_output(4, self._line.out)

    def _tick(self, context: Any, discrete_state: Any) -> None:
        wrench, packet = self.EvalVectorInput(context, self._wrench), self._line.advance(context, discrete_state)
        if self._loss_rate is None:
            self.copy(packet, wrench)
        else:
            (number,), rate = self.inputs(context, self._packet_loss), self.parameter(context, self._loss_rate)
            self._send([packet], [wrench, self._line.newest(context), number, rate])
        self._line.release(context, discrete_state)
