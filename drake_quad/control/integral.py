"""The integral of a PID."""

from typing import Any

from drake_quad.elementary import Row, Rows, maximum, minimum
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


@fleet_system(float, AutoDiffXd)
class IntegralCorrection(FleetSystem):
    """Integrates the position error, within a limit against windup.

    .. pydrake_system::

        name: IntegralCorrection
        input_ports:
        - error
        output_ports:
        - correction

    At every tick i⁺ = i + h k_I e of `error` (3 rows, m), held between plus and minus the limit; `correction` (3 rows,
    m/s²) is -i, since a correction is subtracted from the PD's command.

    The only discrete-state group is the correction. One numeric parameter of the context: k_I on X, Y, Z, the limit.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        k_i: 3 rows, 1/s³.
        limit: of |i|, m/s².
    """

    def declare(self, *, num_vehicles: int = 1, period: float = 0.02, k_i: Rows, limit: Row) -> None:
        """Declares the system; see the class for the arguments."""
        self._period = period
        self._parameters = self.numeric_parameter([*k_i, limit])
        self._error = self.input("error", 3)
        self._correction = self.discrete_state("correction", [0.0, 0.0, 0.0])
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._integrate)
        self.state_output(3, self._correction)

    def _integrate(self, context: Any, discrete_state: Any) -> None:
        *k_i, limit = self.parameter_rows(context, self._parameters)
        error, before = self.input_rows(context, self._error), self.state_rows(context, self._correction)
        after = [old - self._period * k * e for old, k, e in zip(before, k_i, error)]
        within = [maximum(minimum(row, limit), -limit) for row in after]
        self.write(discrete_state.get_mutable_vector(self._correction), within)
