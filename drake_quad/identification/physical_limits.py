"""Physical limits of parameters, as bounds on linear combinations of them.

The moments of inertia of a rigid body are sums of two second moments each,

    I_x = m_y + m_z,   I_y = m_z + m_x,   I_z = m_x + m_y,   m_x, m_y, m_z ≥ 0,

and the thrust K0 + K1 u + K2 u² of a motor with its own throttle u is not negative, and does not fall, for throttles
from 0 to 1 if

    K0 ≥ 0,   K1 ≥ 0,   K1 + 2 K2 ≥ 0.

At zero throttle four rotors carry at most half of the weight, since a vehicle can descend.

A search for the minimum takes these combinations as its variables, so that no limit is violated at any step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.identification.parameters import Parameter

_INERTIA = tuple(f"inertia[{axis}]" for axis in range(3))
_CURVE = tuple(f"motors.curve[{power}]" for power in range(3))
# In the following matrices, rows are search variables, and columns are parameters.
_SECOND_MOMENTS = 0.5 * np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
_RISING_CURVE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
# Second moments are at least this share of the smallest moment of inertia on the data sheet, so that a body cannot
# become a point. Identified moments of inertia have errors of 0.1 % and more, so the share excludes no flat vehicle. A
# data sheet itself may imply a second moment of zero across the plane.
_MIN_SECOND_MOMENT = 1e-3
# Largest thrust at zero throttle, relative to the thrust in hover, which is the scale of K0.
_MAX_IDLE_THRUST = 0.5
# A variable is at a limit if it is nearer to it than this share of its scale.
_AT_LIMIT = 1e-3


class SearchVariables(NamedTuple):
    """Variables of a search for parameters.

    Attributes:
        matrix: (p, p) matrix that gives the variables of parameters.
        inverse: (p, p) matrix that gives the parameters of variables.
        lower: (p,) lower bounds of the variables.
        upper: (p,) upper bounds.
        scale: (p,) usual sizes of changes.
    """

    matrix: np.ndarray
    inverse: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> "SearchVariables":
        """Return the variables of p parameters: the parameters themselves, apart from an inertia and a thrust curve."""
        names = [parameter.name for parameter in parameters]
        start, scale, lower, upper = (
            np.array([getattr(parameter, name) for parameter in parameters], dtype=float)
            for name in ("start", "scale", "lower", "upper")
        )
        matrix = np.eye(len(names))
        for group, rows in ((_INERTIA, _SECOND_MOMENTS), (_CURVE, _RISING_CURVE)):
            if not {*group} <= {*names}:
                continue
            places = [names.index(name) for name in group]
            matrix[np.ix_(places, places)] = rows
            lower[places], upper[places] = 0.0, np.inf
            if group is _INERTIA:
                lower[places] = np.minimum(rows @ start[places], _MIN_SECOND_MOMENT * start[places].min())
            else:
                level = names.index(_CURVE[0])
                upper[level] = max(_MAX_IDLE_THRUST * scale[level], start[level])
        return cls(matrix, np.linalg.inv(matrix), lower, upper, np.abs(matrix) @ scale)

    def limited(self, values: np.ndarray) -> np.ndarray:
        """Return a mask (p,) of the parameters whose values (p,) are at a limit.

        Limits on combinations of several parameters are ignored, since they do not determine a single parameter.
        """
        variables = self.matrix @ values
        own = np.count_nonzero(self.matrix, axis=1) == 1
        near = _AT_LIMIT * self.scale
        return np.asarray(own & ((variables < self.lower + near) | (variables > self.upper - near)))
