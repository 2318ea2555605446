"""Position error of a vehicle that hovers in wind and noise, to first order in them.

Between two ticks of the loop in hover, x⁺ = A x + B w, where the normal numbers w of deviation 1 feed the filters of
the turbulence, the cameras and the gyroscope. The covariance P of the state x satisfies

    P = A P Aᵀ + B Bᵀ

The position deviates from the reference by what steady wind leaves of it, and at random by the square root of its part
of P. Products of noises, such as that of lateral command and thrust in eq (7), are of second order and are left out.
They are broad-band, and the vehicle follows their low frequencies. `drake_quad.analysis.tracking_error` flies hovers
and so includes them; docs/how_to/linear_models.md says how large they are.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.analysis.closed_loop import in_hover, loop_with_noise, without_losses
from drake_quad.errors import InputError
from drake_quad.scenario import Scenario


class LinearHoverError(NamedTuple):
    """Position error in hover, as a linear model has it.

    Attributes:
        offset: (3,) mean along X, Y, Z, m.
        deviation: (3,) standard deviation along X, Y, Z, m.
    """

    offset: np.ndarray
    deviation: np.ndarray

    @property
    def rms(self) -> float:
        """RMS distance from the reference, m."""
        return float(np.sqrt(self.offset @ self.offset + self.deviation @ self.deviation))


def linear_hover_error(scenario: Scenario) -> LinearHoverError:
    """Return the position error in hover from the linear model of a scenario's loop.

    The vehicle hovers where the scenario's route hovers, or at (0, 0, 1). Lost frames and packets, gusts, sines of
    wind, the battery and rotor failures are left out.

    Raises:
        InputError: the scenario holds a distribution, or its loop is not stable, has no equilibrium or cannot be
            differentiated.
    """
    loop, beside = loop_with_noise(without_losses(in_hover(scenario)))
    system = loop.system
    seen = system.between(system.inputs, ["state.x", "state.y", "state.z"]).connected()
    size = float(np.abs(seen.poles()).max(initial=0.0))
    if size >= 1.0:
        raise InputError(f"the loop of {scenario.name} is not stable in hover: a multiplier is {size:.4f}")
    covariance = scipy.linalg.solve_discrete_lyapunov(seen.A, seen.B @ seen.B.T) if len(seen.A) else seen.A
    variance = np.einsum("ij,jk,ik->i", seen.C, covariance, seen.C)
    return LinearHoverError(beside[:3], np.sqrt(np.maximum(variance, 0.0)))
