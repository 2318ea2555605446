"""Minimum snap as a MathematicalProgram over the coefficients: the form that takes further constraints."""

import math

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import ClarabelSolver, MathematicalProgram, MathematicalProgramResult, SolverOptions

from drake_quad.reference.minimum_snap import (
    DEGREE,
    SNAP_FORM,
    PolynomialPath,
    boundary_derivatives,
    checked_waypoints,
    minimum_snap,
    snap_cost,
)

# Clarabel's own is 1e-8, which leaves the higher derivatives of long segments beside short ones discontinuous.
_TOLERANCE = 1e-13


class MinimumSnapProgram:
    """The quadratic program whose solution is the path of least integrated squared snap (paper eqs (18)-(21)).

    The variables are the coefficients of every segment and axis in segment-local unit time, each divided by the size
    that it has in the solution without further constraints: so all are of order one, however much the durations
    differ. Position is relative to the segment's first waypoint.

    Args:
        waypoints: (segments + 1, axes) points to pass, m.
        times: (segments + 1,) when to pass them, strictly increasing, s.
        continuity: how many derivatives are continuous at the waypoints, 3 to 6. The program as it stands has one
            solution, with six, whatever is demanded; with further constraints it may have fewer.

    Attributes:
        program: Drake's MathematicalProgram, to which constraints may be added.
        variables: (segments, degree + 1, axes) decision variables.
        scales: (segments, degree + 1) what turns a variable into a coefficient, m.

    Raises:
        InputError: a shape does not fit, a number is not finite or the times do not increase.
    """

    def __init__(self, waypoints: ArrayLike, times: ArrayLike, *, continuity: int = 6) -> None:
        self._points, self._times = checked_waypoints(waypoints, times)
        unconstrained = minimum_snap(self._points, self._times)
        self.scales = _sizes(unconstrained)
        self.program = MathematicalProgram()
        shape = (len(self._points) - 1, DEGREE + 1, self._points.shape[1])
        self.variables = self.program.NewContinuousVariables(int(np.prod(shape)), "c").reshape(shape)

        self._add_cost(unconstrained)
        last = shape[0] - 1
        steps = np.diff(self._points, axis=0)
        for i, step in enumerate(steps):
            self._equate([(i, 0, 0.0)], np.zeros_like(step))
            self._equate([(i, 0, 1.0)], step)
        for order in (1, 2, 3):
            self._equate([(0, order, 0.0)], np.zeros(shape[2]))
            self._equate([(last, order, 1.0)], np.zeros(shape[2]))
        for i in range(last):
            for order in range(1, continuity + 1):
                self._equate([(i, order, 1.0), (i + 1, order, 0.0)], np.zeros(shape[2]))

    def solve(self) -> PolynomialPath:
        """Solves the program.

        Raises:
            RuntimeError: the solver found no solution.
        """
        options = SolverOptions()
        for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
            options.SetOption(ClarabelSolver.id(), name, _TOLERANCE)
        result: MathematicalProgramResult = ClarabelSolver().Solve(self.program, None, options)
        if not result.is_success():
            raise RuntimeError(f"the minimum-snap program was not solved: {result.get_solution_result().name}")
        solution = result.GetSolution(self.variables.ravel()).reshape(self.variables.shape)
        coefficients = solution * self.scales[:, :, np.newaxis]
        coefficients[:, 0] += self._points[:-1]
        return PolynomialPath(self._times, coefficients)

    def _add_cost(self, unconstrained: PolynomialPath) -> None:
        total = snap_cost(unconstrained).sum()
        for variables, scale, duration in zip(self.variables, self.scales, unconstrained.durations, strict=True):
            form = 2.0 * duration**-7.0 / total * SNAP_FORM * np.outer(scale, scale)
            for axis in variables.T:
                self.program.AddQuadraticCost(form, np.zeros(DEGREE + 1), axis, is_convex=True)

    def _equate(self, ends: list[tuple[int, int, float]], value: np.ndarray) -> None:
        """Demands, on each axis, that a derivative at one segment end, or the jump between two, has a value.

        Args:
            ends: (segment, order, s) of one end, or of two whose derivatives in time are subtracted.
            value: (axes,).
        """
        row = np.concatenate(
            [
                sign * boundary_derivatives(order, s) * self.scales[i] / (self._times[i + 1] - self._times[i]) ** order
                for sign, (i, order, s) in zip((1.0, -1.0), ends, strict=False)
            ]
        )
        size = np.abs(row).max()
        for axis, demanded in enumerate(value):
            variables = np.concatenate([self.variables[i, :, axis] for i, _, _ in ends])
            self.program.AddLinearEqualityConstraint(row[np.newaxis] / size, [demanded / size], variables)


def _sizes(path: PolynomialPath) -> np.ndarray:
    """(segments, 8) how large |d^k p/ds^k| / k! gets on each segment, over the axes; 1 m for the position.

    Symmetry makes some of them vanish; those are taken as a thousandth of the order below.
    """
    powers = np.arange(DEGREE + 1)
    binomial = np.array([[math.comb(j, k) for j in powers] for k in powers], dtype=float)
    exponent = np.maximum(powers[np.newaxis, :] - powers[:, np.newaxis], 0)
    samples = np.array([binomial * s**exponent for s in np.linspace(0.0, 1.0, 5)])
    sizes = np.abs(np.einsum("skj,nja->snka", samples, path.coefficients)).max(axis=(0, 3))
    sizes[:, 0] = 1.0
    for k in powers[1:]:
        sizes[:, k] = np.maximum(sizes[:, k], 1e-3 * np.minimum(sizes[:, k - 1], 1.0))
    return sizes
