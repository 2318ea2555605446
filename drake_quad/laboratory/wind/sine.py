"""Wind that swells and fades as a sine, such as fans whose speed is modulated make it."""

from typing import NamedTuple

from drake_quad.framework.elementary import sin_cos
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Angle, AngleRate, Row, Wind


class SineNumbers(NamedTuple):
    """How a wind swells and fades.

    Attributes:
        velocity: of the air where it is strongest.
        frequency: angular.
        phase: at time zero.
    """

    velocity: Wind
    frequency: AngleRate
    phase: Angle = 0.0


def sine_wind(sine: SineNumbers, time: Row, period: float) -> Wind:
    """The velocity of the air that is held for a period (s) from a time (s) on: that of its middle."""
    share, _ = sin_cos(sine.frequency * (time + 0.5 * period) + sine.phase)
    return Wind._make(share * part for part in sine.velocity)


@fleet_system(float, AutoDiffXd)
class SineWind(FleetSystem):
    """A wind that swells and fades as a sine.

    .. pydrake_system::

        name: SineWind
        output_ports:
        - wind

    `wind` is velocity · sin(ω t + φ), over each period that of its middle. The only state is `wind`, the only parameter
    of the context `sine`.

    Args:
        num_vehicles: N.
        period: of the samples, s; the vehicle's time step.
        numbers: of the wind.
    """

    def declare(self, *, period: float = 0.01, numbers: SineNumbers) -> None:
        """Declares the system."""
        sine, wind = self.parameter("sine", lambda sine: sine), self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        self.initialize(sine_wind, sine, TIME, period, writes=[wind])
        self.update(period, sine_wind, sine, TIME, period, writes=[wind])
        self.state_output(wind)
