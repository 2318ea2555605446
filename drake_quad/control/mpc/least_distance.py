"""Solver for the point of a polyhedron that is nearest to the origin, based on Drake's MathematicalProgram.

This problem is called least distance programming (C. L. Lawson and R. J. Hanson, "Solving least squares problems",
1974, chapter 23).
"""

from typing import NamedTuple

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram

# Tolerance on violations, relative to the largest violation at the origin. The same tolerance applies to negative
# multipliers, relative to the largest multiplier.
_TOLERANCE = 1e-9


class NearestPoint(NamedTuple):
    """Point of the polyhedron that is nearest to the origin.

    Attributes:
        point: (variables,) nearest point v.
        binding: (rows,) True for the rows that are active at the point.
    """

    point: np.ndarray
    binding: np.ndarray


class LeastDistance:
    """Minimisation of |v|² subject to G v <= h, for one G and many h.

    The program is built once. Each search begins at the origin, which is the nearest point without rows. The groups of
    rows that contain a violated row are added, and the program is solved again, until no row is violated. After each
    solution, the point is computed exactly from the active rows, without the tolerance of the solver.

    Args:
        rows: (rows, variables) matrix G.
        group: number of consecutive rows in a group. If a row is violated, its neighbours are likely to be violated.
    """

    def __init__(self, rows: np.ndarray, *, group: int) -> None:
        _, num_variables = rows.shape
        self._rows, self._group, self._solver, self._program = rows, group, ClarabelSolver(), MathematicalProgram()
        self._variables = self._program.NewContinuousVariables(num_variables, "v")
        self._program.AddQuadraticCost(2.0 * np.eye(num_variables), np.zeros(num_variables), self._variables)
        infinite = np.full(len(rows), np.inf)
        self._constraint = self._program.AddLinearConstraint(rows, -infinite, infinite, self._variables)

    def solve(self, bounds: np.ndarray) -> NearestPoint | None:
        """Return the point with the smallest |v|; None if the solver fails.

        Args:
            bounds: (rows,) bounds h.
        """
        # The bounds are scaled so that the largest violation at the origin is 1.
        scale = max(-bounds.min(), _TOLERANCE)
        point, included = np.zeros(len(self._variables)), np.zeros(len(bounds), dtype=bool)
        bounds, binding = bounds / scale, included
        while (violated := ~included & (self._rows @ point > bounds + _TOLERANCE)).any():
            included = included | violated.reshape(-1, self._group).any(axis=1).repeat(self._group)
            rows, upper = self._rows[included], bounds[included]
            self._constraint.evaluator().UpdateCoefficients(rows, np.full(len(upper), -np.inf), upper)
            result = self._solver.Solve(self._program)
            if not result.is_success():
                return None
            point, multipliers = result.GetSolution(self._variables), -result.GetDualSolution(self._constraint)
            binding = np.zeros(len(bounds), dtype=bool)
            # The multiplier or the slack of each row is zero at the exact solution. The solver returns approximations
            # of both, so a row counts as active if its multiplier is larger than its slack.
            binding[included] = multipliers > upper - rows @ point
            point = self._polished(point, bounds, included, binding)
        return NearestPoint(scale * point, binding)

    def _polished(self, point: np.ndarray, bounds: np.ndarray, included: np.ndarray, binding: np.ndarray) -> np.ndarray:
        """Return the point at which the active rows are equalities, if it satisfies the Karush-Kuhn-Tucker conditions.

        Otherwise the given point is returned.
        """
        rows = self._rows[binding]
        exact, *_ = np.linalg.lstsq(rows, bounds[binding])
        multipliers, *_ = np.linalg.lstsq(rows.T, exact)
        feasible = (self._rows[included] @ exact <= bounds[included] + _TOLERANCE).all()
        return exact if feasible and (multipliers <= _TOLERANCE * np.abs(multipliers).max(initial=0.0)).all() else point
