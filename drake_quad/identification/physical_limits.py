"""Physical limits of parameters, as bounds on linear combinations of them.

Each moment of inertia of a rigid body is the sum of two second moments,

    I_x = m_y + m_z,   I_y = m_z + m_x,   I_z = m_x + m_y,   m_x, m_y, m_z ≥ 0.

The thrust K0 + K1 u + K2 u² of a motor is not negative, and does not decrease, for throttles u from 0 to 1 if

    K0 ≥ 0,   K1 ≥ 0,   K1 + 2 K2 ≥ 0.

The four rotors carry at most half of the weight at zero throttle, since the vehicle must be able to descend.

The fit takes these combinations as its search variables, so that it never violates a limit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.identification.parameters import Parameter

_INERTIA = tuple(f"inertia[{axis}]" for axis in range(3))  # names of the moments of inertia
_CURVE = tuple(f"motors.curve[{power}]" for power in range(3))  # names of the coefficients of the thrust curve
# Matrix from the moments of inertia to the second moments of the mass along x, y and z, which are never negative.
_SECOND_MOMENTS = 0.5 * np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
# Matrix from the coefficients of the thrust curve to the thrust at zero throttle, and the slopes of the curve at zero
# and at full throttle. None of these three values is negative.
_RISING_CURVE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
# Lower limit of a second moment, relative to the smallest initial moment of inertia, so that no moment of inertia is
# zero. If the initial moments of inertia imply a smaller second moment, as for a flat vehicle, that value is the limit.
_MIN_SECOND_MOMENT_RATIO = 1e-3
# Upper limit of the thrust at zero throttle, relative to the thrust of a rotor in hover.
_MAX_IDLE_THRUST_RATIO = 0.5
# A variable counts as being at a limit if its distance to the limit is less than this fraction of its scale.
_LIMIT_TOLERANCE = 1e-3


class SearchVariables(NamedTuple):
    """Search variables of a fit, which are linear combinations of the parameters.

    Attributes:
        matrix: (p, p) matrix from parameters to variables.
        inverse: (p, p) matrix from variables to parameters.
        lower: (p,) lower bounds of the variables.
        upper: (p,) upper bounds of the variables.
        scale: (p,) typical changes of the variables.
    """

    matrix: np.ndarray
    inverse: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> "SearchVariables":
        """Return the search variables: combinations of inertia or thrust curve parameters, and all other parameters."""
        names = [parameter.name for parameter in parameters]
        start, scale, lower, upper = (
            np.array([getattr(parameter, name) for parameter in parameters], dtype=float)
            for name in ("start", "scale", "lower", "upper")
        )
        matrix = np.eye(len(names))
        for group, rows in ((_INERTIA, _SECOND_MOMENTS), (_CURVE, _RISING_CURVE)):
            if not {*group} <= {*names}:
                continue
            indices = [names.index(name) for name in group]
            matrix[np.ix_(indices, indices)] = rows
            lower[indices], upper[indices] = 0.0, np.inf
            if group is _INERTIA:
                lower[indices] = np.minimum(rows @ start[indices], _MIN_SECOND_MOMENT_RATIO * start[indices].min())
            else:
                idle = names.index(_CURVE[0])
                upper[idle] = max(_MAX_IDLE_THRUST_RATIO * scale[idle], start[idle])
        return cls(matrix, np.linalg.inv(matrix), lower, upper, np.abs(matrix) @ scale)

    def limited(self, values: np.ndarray) -> np.ndarray:
        """Return a mask (p,) of the parameters whose values (p,) are at a limit.

        A limit on a combination of several parameters is ignored, since it does not fix any one of them.
        """
        variables = self.matrix @ values
        has_one_parameter = np.count_nonzero(self.matrix, axis=1) == 1
        tolerance = _LIMIT_TOLERANCE * self.scale
        return np.asarray(
            has_one_parameter & ((variables < self.lower + tolerance) | (variables > self.upper - tolerance))
        )
