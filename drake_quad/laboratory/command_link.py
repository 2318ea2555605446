"""Radio link from the ground station to the vehicle.

The link transmits a wrench or, for a vehicle with an autopilot, an attitude target like MAVLink's message
SET_ATTITUDE_TARGET.
"""

from typing import Any, Literal, NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.delay_line import declare_delay_line, delay_line_step, latest_sample
from drake_quad.signals import AttitudeTarget, Number, Wrench

Command = Literal["wrench", "attitude_target"]


class PacketLoss(NamedTuple):
    """Uniform random number in [0, 1) for a packet, which is lost if the number is below the loss rate."""

    packet: Number


class LinkParameters(NamedTuple):
    """Parameters of a command link.

    Attributes:
        delay_ticks: delay from sampling to arrival, a whole number of ticks.
        loss_rate: probability that a packet is lost.
        initial: output before the first packet arrives.
    """

    delay_ticks: Number = 0.0
    loss_rate: Number = 0.0
    initial: Wrench | AttitudeTarget = Wrench(0.0, 0.0, 0.0, 0.0)


def link_step(
    command: Any, out: Any, in_transit: tuple[Any, ...], random: PacketLoss | None, parameters: LinkParameters
) -> Any:
    """Return the output of the link and the packets in transit after a tick.

    Args:
        command: command at this tick, a record.
        out: output of the link before this tick.
        in_transit: packets in transit, latest packet first.
        random: random number that decides whether the packet is lost; None if no packet can be lost.
        parameters: parameters of the link.
    """
    packet = command
    if random is not None:
        packet = where(random.packet < parameters.loss_rate, latest_sample(out, in_transit), command)
    return delay_line_step(packet, in_transit, parameters.delay_ticks)


@fleet_system(float, AutoDiffXd)
class CommandLink(FleetSystem):
    """Link that samples a command, delays it by a number of ticks, and holds it until the next command arrives.

    .. pydrake_system::

        name: CommandLink
        input_ports:
        - wrench
        - packet_loss
        output_ports:
        - wrench

    A command that is sampled at a tick arrives `delay_ticks` ticks later. If a packet is lost, the link repeats the
    previous one. `packet_loss` is a random input: a uniform number in [0, 1) for each packet, which is lost if the
    number is below the loss rate. The port exists only if packets can be lost.

    The ports are named after the signal that the link transmits: `wrench`, or `attitude_target` for an autopilot. The
    states are the two states of a `DelayLine`, such as `wrench` and `wrench_in_transit`. The only parameter of the
    context is `link`.

    Args:
        num_vehicles: number N of vehicles.
        signal: signal that the link transmits.
        period: tick period, s; 0.02 s in Kayacan and Maslim (2016).
        longest_delay: largest possible delay, in ticks.
        loses_packets: True if packets can be lost.
        parameters: parameters of the link.
    """

    def declare(
        self,
        *,
        signal: Command = "wrench",
        period: float = 0.02,
        longest_delay: int = 0,
        loses_packets: bool = False,
        parameters: LinkParameters = LinkParameters(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        command, link = self.input(signal), self.parameter("link", lambda parameters: parameters)
        random = None
        if loses_packets:
            random = self.random_input("packet_loss", PacketLoss, RandomDistribution.kUniform, period=period)
        line = declare_delay_line(self, signal, lambda parameters: parameters.initial, longest_delay)
        self.update(period, link_step, command, line.out, line.in_transit, random, link, writes=line)
        self.state_output(line.out)
