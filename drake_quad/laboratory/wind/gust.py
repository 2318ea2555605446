"""Discrete gust of MIL-F-8785C, section 3.7.2.3."""

import math
from typing import NamedTuple

from drake_quad.framework.elementary import cos, maximum, minimum
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Row, Time, Wind


class GustParameters(NamedTuple):
    """Parameters of a gust.

    Attributes:
        velocity: velocity of the air at the peak of the gust.
        start: time at which the gust begins.
        rise_time: duration of the rise from zero to the peak, and of the decay back to zero; positive.
        hold_time: duration of the peak; infinite for a gust that does not end, as in MIL-F-8785C.
    """

    velocity: Wind
    start: Time
    rise_time: Time
    hold_time: Time = math.inf


def gust_profile(time: Row, start: Row, rise_time: Row, hold_time: Row) -> Row:
    """Return the velocity of a gust at a time, relative to its peak: (1 - cos(π x / d)) / 2 during the rise.

    In the specification, x is the distance that the vehicle has travelled in the gust, and d is the length of the rise.
    Here the gust moves past the vehicle at constant speed, so x / d is the time since the start divided by the rise
    time. The decay is the mirror image of the rise. All arguments are in s.
    """
    rising = (time - start) / rise_time
    falling = (start + hold_time - time) / rise_time + 2.0
    return 0.5 - 0.5 * cos(math.pi * maximum(minimum(minimum(rising, falling), 1.0), 0.0))


def gust_wind(gust: GustParameters, time: Row, period: float) -> Wind:
    """Return the wind at the middle of a period (s) that starts at a time (s); it is held over the period."""
    fraction = gust_profile(time + 0.5 * period, gust.start, gust.rise_time, gust.hold_time)
    return Wind._make(fraction * part for part in gust.velocity)


@fleet_system(float, AutoDiffXd)
class Gust(FleetSystem):
    """1-cosine gust.

    .. pydrake_system::

        name: Gust
        output_ports:
        - wind

    `wind` is the peak velocity of the gust times `gust_profile`, evaluated at the middle of each period and held over
    the period. The only state is `wind`. The only parameter of the context is `gust`.

    Args:
        num_vehicles: number N of vehicles.
        period: sampling interval, s; equal to the vehicle's time step.
        parameters: parameters of the gust.
    """

    def declare(self, *, period: float = 0.01, parameters: GustParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        gust, wind = self.parameter("gust", lambda gust: gust), self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        self.initialize(gust_wind, gust, TIME, period, writes=[wind])
        self.update(period, gust_wind, gust, TIME, period, writes=[wind])
        self.state_output(wind)
