"""The discrete gust of MIL-F-8785C, section 3.7.2.3."""

import math
from typing import NamedTuple

from drake_quad.framework.elementary import cos, maximum, minimum
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Row, Time, Wind


class GustNumbers(NamedTuple):
    """When a gust comes and goes.

    Attributes:
        velocity: of the air at the gust's height.
        start: when it begins.
        rise_time: from nothing to full height, larger than zero.
        hold_time: at full height; infinite for a gust that stays, as in MIL-F-8785C.
    """

    velocity: Wind
    start: Time
    rise_time: Time
    hold_time: Time = math.inf


def gust_share(time: Row, start: Row, rise_time: Row, hold_time: Row) -> Row:
    """The share of its height that a gust has at a time: (1 - cos(π x / d)) / 2, and the same backwards.

    The distance x into the gust over the gust's length d is the time since its start over its rise time: the gust
    goes by at constant speed. All in s.
    """
    rising = (time - start) / rise_time
    falling = (start + hold_time - time) / rise_time + 2.0
    return 0.5 - 0.5 * cos(math.pi * maximum(minimum(minimum(rising, falling), 1.0), 0.0))


def gust_wind(gust: GustNumbers, time: Row, period: float) -> Wind:
    """The velocity of the air that is held for a period (s) from a time (s) on: that of its middle."""
    share = gust_share(time + 0.5 * period, gust.start, gust.rise_time, gust.hold_time)
    return Wind._make(share * part for part in gust.velocity)


@fleet_system(float, AutoDiffXd)
class Gust(FleetSystem):
    """A 1-cosine gust.

    .. pydrake_system::

        name: Gust
        output_ports:
        - wind

    `wind` is the gust's velocity times `gust_share`, over each period that of its middle. The only state is `wind`, the
    only parameter of the context `gust`.

    Args:
        num_vehicles: N.
        period: of the samples, s; the vehicle's time step.
        numbers: of the gust.
    """

    def declare(self, *, period: float = 0.01, numbers: GustNumbers) -> None:
        """Declares the system."""
        gust, wind = self.parameter("gust", lambda gust: gust), self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        self.initialize(gust_wind, gust, TIME, period, writes=[wind])
        self.update(period, gust_wind, gust, TIME, period, writes=[wind])
        self.state_output(wind)
