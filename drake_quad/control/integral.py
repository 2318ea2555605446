"""The integral of a PID."""

from typing import Any

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, minimum
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


@formula
def integrated(error: Rows, correction: Rows, parameters: Rows, period: float) -> tuple[tuple[Row, Row, Row]]:
    """The correction a tick later, m/s².

    Args:
        error: 3 rows, m.
        correction: 3 rows, m/s².
        parameters: k_I on X, Y, Z, the limit.
        period: of the ticks, s.
    """
    k_x, k_y, k_z, limit = parameters
    x = correction[0] - period * k_x * error[0]
    y = correction[1] - period * k_y * error[1]
    z = correction[2] - period * k_z * error[2]
    within = (
        maximum(minimum(x, limit), -limit),
        maximum(minimum(y, limit), -limit),
        maximum(minimum(z, limit), -limit),
    )
    return (within,)


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
        self._law = self.mapped(integrated, inputs=(3, 3, 4), outputs=(3,))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._integrate)
        self.state_output(3, self._correction)

    def _integrate(self, context: Any, discrete_state: Any) -> None:
        error, before = self.EvalVectorInput(context, self._error), context.get_discrete_state(self._correction)
        after = discrete_state.get_mutable_vector(self._correction)
        self._law([after], [error, before, self.parameter(context, self._parameters)], self._period)
