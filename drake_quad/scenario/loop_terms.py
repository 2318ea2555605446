"""Integral, derivative and feed-forward terms of a PID loop, in the scenario language."""

import math
from typing import Annotated, Any

from pydantic import Field

from drake_quad.pid.filters import Order, low_pass
from drake_quad.pid.loop import Derivative, Integral, Terms
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.quantities import Gains, IntegrationRule, Positive, Positives


class LoopTerms(Model):
    """Optional terms of a PID loop on three axes: integral, derivative, feed-forward and limit of the output."""

    k_i: Gains | None = Field(default=None, description="integral gains (unit of the proportional gains over s)")
    integral_limit: Annotated[Positives | None, needs("k_i")] = Field(
        default=None, description="largest magnitude of the integral term (unit of the output); no limit if not given"
    )
    integral_fade: Annotated[Positive | None, needs("k_i")] = Field(
        default=None,
        description="e₀: the integrand is multiplied by 1 - (e / e₀)², and is 0 for errors e larger than e₀"
        " (unit of the error); no factor if not given",
    )
    integration: Annotated[IntegrationRule, needs("k_i")] = "forward_euler"
    k_d: Gains | None = Field(
        default=None, description="gains of the derivative of the measurement (unit of the proportional gains times s)"
    )
    derivative_bandwidth: Annotated[Positives | None, needs("k_d")] = Field(
        default=None, description="bandwidth of the low-pass filter on the derivative (rad/s); no filter if not given"
    )
    derivative_order: Annotated[Order, needs("derivative_bandwidth")] = Field(
        default=2, description="order of the low-pass filter: 2 for Butterworth, 1 for a first-order lag"
    )
    k_ff: Gains | None = Field(
        default=None, description="feed-forward gains from the setpoint (unit of the proportional gains)"
    )
    limit: Positives | None = Field(
        default=None, description="largest magnitude of the output (its unit); no limit if not given"
    )

    @property
    def integrates_first(self) -> bool:
        """True if the integral in the output of a tick already includes the error of the same tick."""
        return self.integration == "backward_euler"

    def terms(self, period: float) -> tuple[Terms, Terms, Terms]:
        """Return the loop terms of each axis, given the loop period (s)."""
        first, second, third = (self._axis(axis, period) for axis in range(3))
        return first, second, third

    def _axis(self, axis: int, period: float) -> Terms:
        integral = derivative = None
        k_i, k_d, k_ff = (_gain(gains, axis) for gains in (self.k_i, self.k_d, self.k_ff))
        if k_i is not None:
            limit: Any = math.inf if self.integral_limit is None else self.integral_limit[axis]
            max_error: Any = self.integral_fade
            integral = Integral(k_i, limit, max_error)
        if k_d is not None:
            bandwidth: Any = None if self.derivative_bandwidth is None else self.derivative_bandwidth[axis]
            derivative = Derivative(
                k_d, None if bandwidth is None else low_pass(bandwidth, period, self.derivative_order)
            )
        limited: Any = None if self.limit is None else self.limit[axis]
        return Terms(integral, derivative, k_ff, limited)


def _gain(gains: Any, axis: int) -> Any:
    """Return the gain of a term on an axis.

    The result is None if the gain is missing or 0. The loop then omits the term and needs no state for it.
    """
    gain = None if gains is None else gains[axis]
    return None if isinstance(gain, float) and gain == 0.0 else gain
