"""Linear prediction of the position error in hover, caused by wind and noise.

Over one period, the closed loop in hover obeys x⁺ = A x + B w. The components of w are independent standard normal
variables that drive the turbulence filters and the noise of cameras and gyroscope. The covariance P of the state x
satisfies

    P = A P Aᵀ + B Bᵀ

The mean position error is the offset that steady wind causes. The standard deviation of the position follows from P.

The linear model omits second-order terms: products of random signals, such as lateral command times thrust in eq (7).
These products are broad-band, and the vehicle responds to their low frequencies. `drake_quad.flight.hover_error`
simulates the hover and therefore includes these terms. docs/how_to/linear_models.md quantifies the difference.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import loop_with_noise
from drake_quad.scenario.hovering import in_hover, without_losses
from drake_quad.scenario.models import Scenario

_STABILITY_TOLERANCE = 1e-9  # rounding error of the magnitude of a pole


class LinearHoverError(NamedTuple):
    """Position error in hover, as predicted by the linear model.

    Attributes:
        offset: (3,) mean error along X, Y, Z, m.
        deviation: (3,) standard deviation of the error along X, Y, Z, m.
    """

    offset: np.ndarray
    deviation: np.ndarray

    @property
    def rms(self) -> float:
        """RMS distance from the reference, m."""
        return float(np.sqrt(self.offset @ self.offset + self.deviation @ self.deviation))


def linear_hover_error(scenario: Scenario) -> LinearHoverError:
    """Return the position error in hover that the linear model of a scenario's closed loop predicts.

    The vehicle hovers at the position of the route if its kind is `hover`, and otherwise at (0, 0, 1). The model omits
    lost frames and packets, gusts, sinusoidal wind, the battery and rotor failures.

    Raises:
        InputError: if the scenario contains a distribution, or its loop is unstable, has no equilibrium or cannot be
            differentiated.
    """
    loop, offset = loop_with_noise(without_losses(in_hover(scenario)))
    system = loop.system
    position_system = system.between(system.inputs, ["state.x", "state.y", "state.z"]).connected()
    position_system = position_system.without_hidden_modes()
    size = float(np.abs(position_system.poles()).max(initial=0.0))
    if size >= 1.0 - _STABILITY_TOLERANCE:
        cause, remedy = "unstable", "reduce the gains or the delays"
        if size < 1.0 + _STABILITY_TOLERANCE:
            cause, remedy = "not asymptotically stable", "an estimator must observe all its states"
        raise InputError(
            f"the control loop of {scenario.name} is {cause} in hover (its largest pole has magnitude {size:.4f}), so"
            f" it has no RMS error; {remedy}"
        )
    covariance = (
        scipy.linalg.solve_discrete_lyapunov(position_system.A, position_system.B @ position_system.B.T)
        if len(position_system.A)
        else position_system.A
    )
    variance = np.einsum("ij,jk,ik->i", position_system.C, covariance, position_system.C)
    return LinearHoverError(offset[:3], np.sqrt(np.maximum(variance, 0.0)))
