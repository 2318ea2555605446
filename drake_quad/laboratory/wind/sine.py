"""Wind whose velocity is a sine of time, as produced by fans with a modulated speed."""

from typing import NamedTuple

from drake_quad.framework.elementary import sin_cos
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Angle, AngleRate, Row, Wind


class SineParameters(NamedTuple):
    """Parameters of a sinusoidal wind.

    Attributes:
        velocity: amplitude of the velocity of the air.
        frequency: angular frequency ω.
        phase: phase φ at time zero.
    """

    velocity: Wind
    frequency: AngleRate
    phase: Angle = 0.0


def sine_wind(sine: SineParameters, time: Row, period: float) -> Wind:
    """Return the wind at the middle of a period (s) that starts at a time (s); it is held over the period."""
    fraction, _ = sin_cos(sine.frequency * (time + 0.5 * period) + sine.phase)
    return Wind._make(fraction * part for part in sine.velocity)


@fleet_system(float, AutoDiffXd)
class SineWind(FleetSystem):
    """Wind whose velocity is a sine of time.

    .. pydrake_system::

        name: SineWind
        output_ports:
        - wind

    `wind` is velocity · sin(ω t + φ), evaluated at the middle of each period and held over the period. The only state
    is `wind`. The only parameter of the context is `sine`.

    Args:
        num_vehicles: number N of vehicles.
        period: sampling interval, s; equal to the vehicle's time step.
        parameters: parameters of the wind.
    """

    def declare(self, *, period: float = 0.01, parameters: SineParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        sine, wind = self.parameter("sine", lambda sine: sine), self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        self.initialize(sine_wind, sine, TIME, period, writes=[wind])
        self.update(period, sine_wind, sine, TIME, period, writes=[wind])
        self.state_output(wind)
