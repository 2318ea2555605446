"""The discrete gust of MIL-F-8785C, section 3.7.2.3."""

import math
from typing import Any, NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, cos, maximum, minimum
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


class GustParameters(NamedTuple):
    """When a gust comes and goes.

    Attributes:
        velocity: of the air at the gust's height, 3 rows in W, m/s.
        start: s.
        rise_time: s, larger than zero.
        hold_time: at full height, s; infinite for a gust that stays, as in MIL-F-8785C.
    """

    velocity: Rows
    start: Row
    rise_time: Row
    hold_time: Row = math.inf

    def to_rows(self) -> list[Row]:
        """The parameters as 6 rows, in the order above."""
        velocity, *times = self
        return [*velocity, *times]


@formula
def gust_share(time: Row, start: Row, rise_time: Row, hold_time: Row) -> Row:
    """The share of its height that a gust has at a time: (1 - cos(π x / d)) / 2, and the same backwards.

    The distance x into the gust over the gust's length d is the time since its start over its rise time: the gust
    goes by at constant speed. All in s.
    """
    rising = (time - start) / rise_time
    falling = (start + hold_time - time) / rise_time + 2.0
    return 0.5 - 0.5 * cos(math.pi * maximum(minimum(minimum(rising, falling), 1.0), 0.0))


@formula
def gust_wind(gust: Rows, time: Row) -> tuple[Rows]:
    """The velocity of the air in W (m/s) at a time (s), given the 6 rows of `GustParameters`."""
    share = gust_share(time, gust[3], gust[4], gust[5])
    return ((share * gust[0], share * gust[1], share * gust[2]),)


@fleet_system(float, AutoDiffXd)
class Gust(FleetSystem):
    """A 1-cosine gust.

    .. pydrake_system::

        name: Gust
        output_ports:
        - wind

    `wind` (3 rows, m/s in W) is the gust's velocity times `gust_share`; what is held over a period is that of its
    middle. The only discrete-state group is what is held; the parameters are one numeric parameter of the context, the
    6 rows of `GustParameters`.

    Args:
        num_vehicles: N.
        period: of the samples, s; the vehicle's time step.
        gust: each entry a number or an (N,) array.
    """

    def declare(self, *, num_vehicles: int = 1, period: float = 0.01, gust: GustParameters) -> None:
        """Declares the system; see the class for the arguments."""
        self._period = period
        self._gust = self.numeric_parameter(gust.to_rows())
        self._wind = self.discrete_state("wind", [0.0, 0.0, 0.0])
        self._blow = self.mapped(gust_wind, inputs=(6,), outputs=(3,))
        self.DeclareInitializationDiscreteUpdateEvent(self._sample)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._sample)
        self.state_output(3, self._wind)

    def _sample(self, context: Any, discrete_state: Any) -> None:
        middle, wind = context.get_time() + 0.5 * self._period, discrete_state.get_mutable_vector(self._wind)
        self._blow([wind], [self.parameter(context, self._gust)], middle)
