"""Quadratic programme of a model predictive controller, for one or two axes.

The variables are the perturbations c of the regulator's commands over the horizon, and the slacks ε:

    minimise   Σ w c² + Σ ζ ε²    subject to    F ξ + G c - ε <= bound    at every tick

With the weight w of `drake_quad.control.mpc.prediction`, Σ w c² is the increase of the regulator's cost over an
infinite horizon (P. O. M. Scokaert and J. B. Rawlings, "Constrained linear quadratic regulation", IEEE Transactions on
Automatic Control 43(8), 1998). If c = 0 violates no constraint, it is the solution.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.autodiffutils import ExtractValue

from drake_quad.control.mpc.constraints import Constraint
from drake_quad.control.mpc.least_distance import LeastDistance


class Programme:
    """Quadratic programme, built once for all states and times.

    Args:
        constraints: constraints over one horizon.
        weight: weight w of the perturbations.
    """

    def __init__(self, constraints: Sequence[Constraint], weight: float) -> None:
        slacks = sorted({each.slack for each in constraints if each.slack is not None})
        num_ticks, num_commands = next(iter(constraints)).forced.shape
        # The variables are scaled so that the cost of each is its square.
        scaled = [np.eye(num_ticks) / np.sqrt(slack.weight) for slack in slacks]
        slack = [
            [
                -float(each.slack == slack_of_column) * scaled_slack
                for slack_of_column, scaled_slack in zip(slacks, scaled)
            ]
            for each in constraints
        ]
        forced = [each.forced / np.sqrt(weight) for each in constraints]
        self._rows = np.vstack(
            [np.hstack([forced_rows, *slack_rows]) for forced_rows, slack_rows in zip(forced, slack, strict=True)]
        )
        self._free = np.vstack([each.free for each in constraints])
        self._bound = np.array([each.bound for each in constraints])
        self._shift = np.repeat([each.shift for each in constraints], num_ticks, axis=0)
        self._instant_offsets = np.array([np.arange(num_ticks) + each.starts_next_tick for each in constraints])
        self._nearest, self._weight = LeastDistance(self._rows, group=num_ticks), weight
        self._first_commands, self._num_axes = slice(None, num_commands, num_ticks), num_commands // num_ticks

    def perturbations(self, tick: int, deviations: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """Return the perturbations (axes, N) of the commands at this tick, for N vehicles.

        With AutoDiffXd the derivatives are computed for fixed active constraints. The perturbation is zero for a
        vehicle if the solver fails or if a value is NaN or infinite.

        Args:
            tick: number of the tick since time zero.
            deviations: (n, N) ξ of the axes, one axis after another.
            correction: (3, N) correction τ_f along X, Y and Z.
        """
        _, num_instants = self._bound.shape
        instants = np.minimum(tick + self._instant_offsets, num_instants - 1)
        bound = np.take_along_axis(self._bound, instants, axis=1).reshape(-1, 1)
        bounds = bound + self._shift @ correction - self._free @ deviations
        values = bounds if bounds.dtype == float else ExtractValue(bounds)
        perturbations = np.zeros((self._num_axes, len(bounds.T)), dtype=bounds.dtype)
        for vehicle in np.flatnonzero((values < 0.0).any(axis=0) & np.isfinite(values).all(axis=0)):
            nearest = self._nearest.solve(values[:, vehicle])
            if nearest is None:
                continue
            point, binding = nearest
            if bounds.dtype != float:
                point = np.linalg.pinv(self._rows[binding]) @ bounds[binding, vehicle]
            perturbations[:, vehicle] = point[self._first_commands] / np.sqrt(self._weight)
        return perturbations
