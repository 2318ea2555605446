"""The point of a polyhedron that is nearest to the origin, by Drake's MathematicalProgram.

C. L. Lawson and R. J. Hanson, "Solving least squares problems", 1974, chapter 23, call it least distance programming.
"""

from typing import NamedTuple

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram

# By how much a row may be broken, relative to the largest breach, and a multiplier have the wrong sign.
_TOLERANCE = 1e-9


class Nearest(NamedTuple):
    """The nearest point.

    Attributes:
        point: (variables,) v.
        binding: (rows,) which rows keep it from the origin.
    """

    point: np.ndarray
    binding: np.ndarray


class LeastDistance:
    """Minimises |v|² where G v <= h, for one G and many h.

    The programme is built once, and holds the groups of rows that the last points broke. Without any rows the nearest
    point is the origin, and a point that is nearest for some rows and breaks none of the others is nearest for all: so
    groups are added until none is broken. What binds is known then, and is solved for without the solver's tolerance.

    Args:
        rows: (rows, variables) G.
        group: rows that stand together: where one of them is broken, its neighbours are likely to be.
    """

    def __init__(self, rows: np.ndarray, *, group: int) -> None:
        _, num_variables = rows.shape
        self._rows, self._group, self._solver, self._program = rows, group, ClarabelSolver(), MathematicalProgram()
        self._variables = self._program.NewContinuousVariables(num_variables, "v")
        self._program.AddQuadraticCost(2.0 * np.eye(num_variables), np.zeros(num_variables), self._variables)
        free = np.full(len(rows), np.inf)
        self._held = self._program.AddLinearConstraint(rows, -free, free, self._variables)

    def solve(self, bounds: np.ndarray) -> Nearest | None:
        """The point of least |v|; None if the solver finds none.

        Args:
            bounds: (rows,) h.
        """
        # What is solved is as large as 1, whatever the size of the breach.
        size = max(-bounds.min(), _TOLERANCE)
        point, held = np.zeros(len(self._variables)), np.zeros(len(bounds), dtype=bool)
        bounds, binding = bounds / size, held
        while (broken := ~held & (self._rows @ point > bounds + _TOLERANCE)).any():
            held = held | broken.reshape(-1, self._group).any(axis=1).repeat(self._group)
            rows, most = self._rows[held], bounds[held]
            self._held.evaluator().UpdateCoefficients(rows, np.full(len(most), -np.inf), most)
            result = self._solver.Solve(self._program)
            if not result.is_success():
                return None
            point, multipliers = result.GetSolution(self._variables), -result.GetDualSolution(self._held)
            binding = np.zeros(len(bounds), dtype=bool)
            # Of the two, one is nothing where the solver converges to.
            binding[held] = multipliers > most - rows @ point
            point = self._polished(point, bounds, held, binding)
        return Nearest(size * point, binding)

    def _polished(self, point: np.ndarray, bounds: np.ndarray, held: np.ndarray, binding: np.ndarray) -> np.ndarray:
        """The point where what binds holds exactly, if Karush, Kuhn and Tucker's conditions hold with it."""
        rows = self._rows[binding]
        exact, *_ = np.linalg.lstsq(rows, bounds[binding])
        pull, *_ = np.linalg.lstsq(rows.T, exact)
        kept = (self._rows[held] @ exact <= bounds[held] + _TOLERANCE).all()
        return exact if kept and (pull <= _TOLERANCE * np.abs(pull).max(initial=0.0)).all() else point
