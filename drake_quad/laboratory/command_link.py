"""The radio link from the ground station to the vehicle.

It carries a wrench or, to an autopilot, an attitude target, as MAVLink's message SET_ATTITUDE_TARGET does.
"""

from typing import Any, Literal, NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.delay_line import carried, declare_delay_line, newest
from drake_quad.signals import AttitudeTarget, Number, Wrench

Command = Literal["wrench", "attitude_target"]


class PacketLoss(NamedTuple):
    """A random number between 0 and 1 for each packet, which is lost if it is below the loss rate."""

    packet: Number


class LinkNumbers(NamedTuple):
    """What a command link does to packets.

    Attributes:
        delay_ticks: whole number of ticks from sampling to arrival.
        loss_rate: share of the packets that are lost.
        initial: the command that is out before the first packet arrives.
    """

    delay_ticks: Number = 0.0
    loss_rate: Number = 0.0
    initial: Wrench | AttitudeTarget = Wrench(0.0, 0.0, 0.0, 0.0)


def sent(command: Any, out: Any, under_way: tuple[Any, ...], random: PacketLoss | None, numbers: LinkNumbers) -> Any:
    """What is out, and under way if there can be a delay, after a tick.

    Args:
        command: a record, sampled at this tick.
        out: the command that is out.
        under_way: the last packets, the newest first.
        random: None if no packet can be lost.
        numbers: of the link.
    """
    packet = command
    if random is not None:
        packet = where(random.packet < numbers.loss_rate, newest(out, under_way), command)
    return carried(packet, under_way, numbers.delay_ticks)


@fleet_system(float, AutoDiffXd)
class CommandLink(FleetSystem):
    """Samples what is commanded, carries it for a number of ticks, and holds it until the next one arrives.

    .. pydrake_system::

        name: CommandLink
        input_ports:
        - wrench
        - packet_loss
        output_ports:
        - wrench

    What is sampled at a tick leaves `delay_ticks` later; in place of a packet that is lost goes the one before it.
    `packet_loss` is random: a number between 0 and 1 for each packet, which is lost if it is below the loss rate. The
    port is there if packets can be lost.

    The ports are called after the signal that the link carries: a `wrench`, or an `attitude_target` for an autopilot.
    The states are those of a `DelayLine`, `wrench` and `wrench_under_way`; the only parameter of the context is `link`.

    Args:
        num_vehicles: N.
        signal: that it carries.
        period: of the ticks, s; the paper's controllers run at 50 Hz.
        longest_delay: that there will ever be, in ticks.
        loses_packets: whether packets can be lost.
        numbers: of the link.
    """

    def declare(
        self,
        *,
        signal: Command = "wrench",
        period: float = 0.02,
        longest_delay: int = 0,
        loses_packets: bool = False,
        numbers: LinkNumbers = LinkNumbers(),
    ) -> None:
        """Declares the system."""
        command, link = self.input(signal), self.parameter("link", lambda numbers: numbers)
        random = None
        if loses_packets:
            random = self.random_input("packet_loss", PacketLoss, RandomDistribution.kUniform, period=period)
        line = declare_delay_line(self, signal, lambda numbers: numbers.initial, longest_delay)
        self.update(period, sent, command, line.out, line.under_way, random, link, writes=line)
        self.state_output(line.out)
