"""The quadratic programme of a model predictive controller, for one or two axes.

It looks for what to add to the regulator's commands over the horizon, c, and for slacks ε:

    minimise   Σ w c² + Σ ζ ε²    such that    F ξ + G c - ε <= what the reference leaves    at every tick

With w from `drake_quad.control.mpc.prediction` that is the regulator's own cost over all time (P. O. M. Scokaert and
J. B. Rawlings, "Constrained linear quadratic regulation", IEEE Transactions on Automatic Control 43(8), 1998). Where
c = 0 breaks no constraint, it is the solution.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.autodiffutils import ExtractValue

from drake_quad.control.mpc.constraints import Constraint
from drake_quad.control.mpc.least_distance import LeastDistance


class Programme:
    """A quadratic programme, built once for all states and times.

    Args:
        constraints: over one horizon.
        weight: w.
    """

    def __init__(self, constraints: Sequence[Constraint], weight: float) -> None:
        slacks = sorted({each.slack for each in constraints if each.slack is not None})
        num_ticks, num_commands = next(iter(constraints)).forced.shape
        # In variables whose squares are what they cost.
        units = [np.eye(num_ticks) / np.sqrt(slack.weight) for slack in slacks]
        slack = [[-float(each.slack == own) * unit for own, unit in zip(slacks, units)] for each in constraints]
        forced = [each.forced / np.sqrt(weight) for each in constraints]
        self._rows = np.vstack([np.hstack([held, *gives]) for held, gives in zip(forced, slack, strict=True)])
        self._free = np.vstack([each.free for each in constraints])
        self._left = np.array([each.left for each in constraints])
        self._shift = np.repeat([each.shift for each in constraints], num_ticks, axis=0)
        self._ahead = np.array([np.arange(num_ticks) + each.later for each in constraints])
        self._nearest, self._weight = LeastDistance(self._rows, group=num_ticks), weight
        self._now, self._num_axes = slice(None, num_commands, num_ticks), num_commands // num_ticks

    def added(self, tick: int, deviations: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """(axes, N) what is added to the commands of this tick, for N vehicles.

        The derivatives of AutoDiffXd are those with what binds held; a vehicle for which nothing is found, whose
        numbers have left all bounds, gets nothing.

        Args:
            tick: number of the tick, from time zero on.
            deviations: (n, N) ξ of the axes, one after another.
            correction: (3, N) τ_f.
        """
        _, num_instants = self._left.shape
        instants = np.minimum(tick + self._ahead, num_instants - 1)
        left = np.take_along_axis(self._left, instants, axis=1).reshape(-1, 1)
        bounds = left + self._shift @ correction - self._free @ deviations
        values = bounds if bounds.dtype == float else ExtractValue(bounds)
        added = np.zeros((self._num_axes, len(bounds.T)), dtype=bounds.dtype)
        for vehicle in np.flatnonzero((values < 0.0).any(axis=0) & np.isfinite(values).all(axis=0)):
            nearest = self._nearest.solve(values[:, vehicle])
            if nearest is None:
                continue
            point, binding = nearest
            if bounds.dtype != float:
                point = np.linalg.pinv(self._rows[binding]) @ bounds[binding, vehicle]
            added[:, vehicle] = point[self._now] / np.sqrt(self._weight)
        return added
