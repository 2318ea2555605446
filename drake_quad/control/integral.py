"""The integral of a PID."""

from typing import Annotated, NamedTuple

from drake_quad.control.axes import PerAxis
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Acceleration, PositionError, Quantity, Row


class IntegralGains(NamedTuple):
    """Gains of the integral.

    Attributes:
        k_i: on the position error, 1/s³.
        limit: of the correction on each axis.
    """

    k_i: PerAxis
    limit: Annotated[Row, Quantity("m/s²")]


def integrated(correction: Acceleration, error: PositionError, gains: IntegralGains, period: float) -> Acceleration:
    """The correction a tick (s) later."""
    return Acceleration._make(
        maximum(minimum(before - period * k_i * e, gains.limit), -gains.limit)
        for before, k_i, e in zip(correction, gains.k_i, error, strict=True)
    )


def _nothing(gains: IntegralGains) -> Acceleration:
    return Acceleration(0.0, 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class IntegralCorrection(FleetSystem):
    """Integrates the position error, within a limit against windup.

    .. pydrake_system::

        name: IntegralCorrection
        input_ports:
        - error
        output_ports:
        - correction

    At every tick i⁺ = i + h k_I e, held between plus and minus the limit; `correction` is -i, since a correction is
    subtracted from the PD's command.

    The only state is `correction`, the only parameter of the context `gains`.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        numbers: the gains.
    """

    def declare(self, *, period: float = 0.02, numbers: IntegralGains) -> None:
        """Declares the system."""
        error, gains = self.input("error"), self.parameter("gains", lambda gains: gains)
        correction = self.state("correction", _nothing)
        self.update(period, integrated, correction, error, gains, period, writes=[correction])
        self.state_output(correction)
