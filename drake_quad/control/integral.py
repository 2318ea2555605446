"""Integral action of a PID.

Two integration methods are available, as in Simulink's block Discrete-Time Integrator:

    forward_euler     the command of a tick depends on the errors of earlier ticks
    backward_euler    the command of a tick also depends on the error of this tick
"""

from typing import Annotated, Literal, NamedTuple

from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, PositionError, Quantity, Row

Integration = Literal["forward_euler", "backward_euler"]


class IntegralGains(NamedTuple):
    """Gains and limit of an `IntegralCorrection`.

    Attributes:
        k_i: gains on the integrated position error, 1/s³.
        limit: largest absolute value of the correction on each axis.
    """

    k_i: PerAxis
    limit: Annotated[Row, Quantity("m/s²")]


def integrate_correction(
    correction: Acceleration, error: PositionError, gains: IntegralGains, period: float
) -> Acceleration:
    """Return the correction after adding the position error of one tick of the given period (s)."""
    return Acceleration._make(
        maximum(minimum(before - period * k_i * e, gains.limit), -gains.limit)
        for before, k_i, e in zip(correction, gains.k_i, error, strict=True)
    )


@fleet_system(float, AutoDiffXd)
class IntegralCorrection(FleetSystem):
    """Integral of the position error, with a limit against windup.

    .. pydrake_system::

        name: IntegralCorrection
        input_ports:
        - error
        output_ports:
        - correction

    At every tick i⁺ = i + h k_I e, saturated at plus and minus the limit. The output `correction`, which the position
    controller subtracts, is -i with the integration `forward_euler`, and -i⁺ with `backward_euler`.

    The only state is `correction`; the only parameter of the context is `gains`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period h, s.
        integration: "forward_euler" or "backward_euler".
        parameters: gains of the integral.
    """

    def declare(
        self, *, period: float = 0.02, integration: Integration = "forward_euler", parameters: IntegralGains
    ) -> None:
        """Declare the ports, state and parameters of this system."""
        error, gains = self.input("error"), self.parameter("gains", lambda gains: gains)
        correction = self.state("correction", lambda _: Acceleration(0.0, 0.0, 0.0))
        reads = correction, error, gains, period
        self.update(period, integrate_correction, *reads, writes=[correction])
        if integration == "backward_euler":
            self.output("correction", integrate_correction, *reads)
        else:
            self.state_output(correction)
