"""Minimum-snap planning with inequality constraints, as a Drake MathematicalProgram."""

from enum import Enum

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolutionResult, SolverOptions

from drake_quad.process_settings import without_drake_remarks
from drake_quad.reference.minimum_snap import (
    BOUNDARY_FORM,
    DEGREE,
    FROM_BOUNDARY,
    NUM_FREE,
    MinimumSnap,
    boundary_scales,
    waypoint_units,
)
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import (
    PolynomialPath,
    knots,
    norm_peaks,
    peak_norm,
    power_basis,
)
from drake_quad.reference.regions import Box, Sphere
from drake_quad.reference.walls import WallApproach, wall_approaches

# Solver tolerances, tried in this order. Clarabel may fail to reach the smallest tolerance if a problem is barely
# feasible. Clarabel's default is 1e-8.
_SOLVER_TOLERANCES = (1e-9, 1e-7, 1e-5)
# Smallest violation, relative to the limits, at which a problem counts as infeasible.
_MIN_RELATIVE_EXCESS = 1e-4
# The program bounds a path only at single points. With these margins, the path also stays within limits and corridors
# between the points.
_LIMIT_MARGIN = 1e-4  # relative to the limit
WALL_MARGIN = 1e-5  # relative to the largest extent of the corridor
# Largest distance by which a path may leave a corridor, relative to the largest extent of the corridor. It is needed
# because no margin is possible at a waypoint on a wall.
_WALL_TOLERANCE = 1e-7
_MAX_ROUNDS = 25  # largest number of rounds; each round solves the program and adds bounds
# Weight of the snap cost relative to the weight of the slack, which is the violation of the relaxed constraints. The
# snap cost only selects among paths with equal slack.
_SNAP_WEIGHT_WITH_SLACK = 1e-6


class InfeasibleError(Exception):
    """Error for a problem without a solution at the given times."""


class SolverError(RuntimeError):
    """Error for a failure of the solver."""


PLANNING_ERRORS = (InfeasibleError, SolverError)
"""Errors that mean that no path was found."""


def constrained_minimum_snap(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Return the path with the smallest integrated squared snap that satisfies the constraints of a problem.

    Args:
        problem: constraints of the path.
        durations: (segments,) durations, s.

    Raises:
        InfeasibleError: if there is no such path.
        SolverError: if the solver fails.
    """
    if problem.has_closed_form_path:
        path = MinimumSnap(problem.representatives(), durations, problem.derivatives).path()
        if all(peak_norm(path, order) <= _with_rounding(limit) for order, limit in problem.limits.by_order.items()):
            return path
    try:
        return MinimumSnapProgram(problem, durations).solve()
    except SolverError:
        # If a problem is only just infeasible, the solver may find neither a path nor a proof of infeasibility.
        relaxed = MinimumSnapProgram(problem, durations, slack=RelaxedBounds.LIMITS)
        relaxed.solve()
        if relaxed.excess > _MIN_RELATIVE_EXCESS:
            raise InfeasibleError from None
        raise


def _with_rounding(limit: float) -> float:
    """Return a limit with an allowance for rounding errors."""
    return limit * (1.0 + 1e-9)


class RelaxedBounds(Enum):
    """Type of constraint that a program may violate. The program then minimises the violation instead of the snap."""

    LIMITS = "limits"  # the program minimises the largest excess over a limit, relative to this limit
    CORRIDORS = "corridors"  # the program minimises the largest distance outside a corridor, m


class MinimumSnapProgram:
    """Program whose solution is the path with the smallest integrated squared snap (paper eqs (18)-(21)).

    The variables are the free positions, velocities, accelerations and jerks at the waypoints, relative to the
    unconstrained path through a point of each waypoint's region. They are scaled to similar magnitudes for any
    durations, and they are zero if no constraint is active. Both segments that meet at a waypoint share its variables,
    so the path has three continuous derivatives. Without inequalities, six derivatives are continuous at the optimum.
    At an active bound, the fourth to sixth derivatives can jump.

    A limit or a corridor is an inequality for each of infinitely many points of a segment. The program starts without
    these inequalities. `solve` adds them at the points where the solution violates them most, until there is no
    violation.

    Args:
        problem: constraints of the path.
        durations: (segments,) durations, s.
        slack: constraints that may be violated; None if all must be satisfied.

    Attributes:
        program: Drake's MathematicalProgram, to which constraints can be added.
        variables: (segments + 1, 4, axes) decision variables, in units of `scales`; None for given values.
        scales: (segments + 1, 4) factors from a variable to position, velocity, acceleration and jerk, in m and s.
        excess: violation of the relaxed constraints after `solve`.
    """

    def __init__(self, problem: PathProblem, durations: np.ndarray, *, slack: RelaxedBounds | None = None) -> None:
        self._problem, self._durations = problem, durations
        self._points = problem.representatives()
        unconstrained = MinimumSnap(self._points, durations, problem.derivatives)
        unit = waypoint_units(durations)
        in_units = _variable_scales(unconstrained, unit)
        self.scales = in_units / unit[:, np.newaxis] ** np.arange(NUM_FREE + 1)
        self._to_segment = boundary_scales(durations, unit) * np.hstack([in_units[:-1], in_units[1:]])
        self.program = MathematicalProgram()
        self.excess = 0.0
        self._slack = slack
        # Without slack, this array of variables is empty.
        self._slack_variable = self.program.NewContinuousVariables(0 if slack is None else 1, "slack")
        base = knots(unconstrained.path(), NUM_FREE + 1) / self.scales[:, :, np.newaxis]
        base[:, 0] = 0.0  # position variables are relative to a point of each waypoint's region
        self._declare_variables(base)
        self._add_cost(unconstrained.cost)
        self._add_waypoints()

    def solve(self) -> PolynomialPath:
        """Solve the program repeatedly, with additional bounds, until the path satisfies limits and corridors.

        Raises:
            InfeasibleError: if there is no such path.
            SolverError: if the solver fails.
        """
        for _ in range(_MAX_ROUNDS):
            path = self._solve_once()
            if not self._tighten(path):
                return path
        raise SolverError(
            f"the path still violates a limit or corridor after {_MAX_ROUNDS} rounds of additional bounds"
        )

    def bound_norm(self, segment: int, s: float, order: int, bound: float) -> None:
        """Bound the norm of a time derivative at one point of a segment, by a Lorentz cone constraint.

        Args:
            segment: index of the segment.
            s: unit time on the segment, 0 to 1.
            order: order of the derivative, 1 for the velocity.
            bound: largest norm, m/s for the velocity, m/s² for the acceleration.
        """
        rows, variables, constant = self._derivative(segment, s, order)
        matrix = np.vstack([np.zeros(rows.shape[1]), rows / bound])
        offset = np.concatenate([[1.0], constant / bound])
        if self._slack is RelaxedBounds.LIMITS:
            matrix = np.column_stack([matrix, np.eye(len(matrix))[:, 0]])
            variables = np.concatenate([variables, self._slack_variable])
        if len(variables):
            self.program.AddLorentzConeConstraint(matrix, offset, variables)
        elif np.linalg.norm(offset[1:]) > 1.0:
            raise InfeasibleError

    def bound_position(self, segment: int, s: float, direction: np.ndarray | int, low: float, high: float) -> None:
        """Bound the position along a direction at one point of a segment.

        Args:
            segment: index of the segment.
            s: unit time on the segment, 0 to 1.
            direction: (axes,) unit vector, or the index of an axis.
            low: smallest position along the direction, m, or -inf.
            high: largest position along the direction, m.
        """
        rows, variables, constant = self._derivative(segment, s, 0)
        if isinstance(direction, int):
            direction = np.eye(len(rows))[direction]
        row = direction @ rows
        is_used = row != 0.0
        row, variables = row[is_used], variables[is_used]
        size = float(np.abs(row).max(initial=0.0)) or 1.0
        known = float(direction @ constant)
        low, high = low - known, high - known
        if self._slack is RelaxedBounds.CORRIDORS:
            for sign, bound in ((1.0, low), (-1.0, -high)):
                if np.isfinite(bound):
                    matrix = np.append(sign * row, 1.0)[np.newaxis] / size
                    both = np.concatenate([variables, self._slack_variable])
                    self.program.AddLinearConstraint(matrix, [bound / size], [np.inf], both)
        elif len(variables):
            self.program.AddLinearConstraint(row[np.newaxis] / size, [low / size], [high / size], variables)
        elif low > 0.0 or high < 0.0:
            raise InfeasibleError

    def _declare_variables(self, unconstrained: np.ndarray) -> None:
        """Create the variables, and the base values of the path to which they are added, all in units of `scales`."""
        problem = self._problem
        axes = self._points.shape[1]
        self._base = np.zeros((len(self._points), NUM_FREE + 1, axes))
        self._base[:, 1:] = problem.derivatives / self.scales[:, 1:, np.newaxis]
        for i in range(len(self._points)):
            box = problem.allowed_box(i)
            if box is not None:
                self._base[i, 0, box.low < box.high] = np.nan
            else:
                self._base[i, 0] = np.nan
        for i, corridor in enumerate(problem.corridors):
            if isinstance(corridor, Box):
                # Along an axis on which the corridor has no extent, the path cannot move.
                flat = corridor.low == corridor.high
                self._base[i : i + 2, 1:, flat] = 0.0  # `PathProblem` checks that given derivatives are also zero
        self._free = np.isnan(self._base)
        self._base[self._free] = unconstrained[self._free]
        self.variables = np.full(self._base.shape, None, dtype=object)
        self.variables[self._free] = self.program.NewContinuousVariables(int(self._free.sum()), "d")

    def _add_cost(self, total: float) -> None:
        """Add the snap cost, divided by the cost `total` of a similar path to improve the scaling."""
        weights = self._durations**-7.0 / (total if total > 0.0 else (self._durations**-7.0).max())
        if self._slack is not None:
            weights = _SNAP_WEIGHT_WITH_SLACK * weights
            self.program.AddLinearCost(self._slack_variable[0])
            self.program.AddBoundingBoxConstraint(0.0, np.inf, self._slack_variable[0])
        for segment, weight in enumerate(weights):
            variables, free, boundary = self._local(segment)
            for axis, is_used in enumerate(free.T):
                if is_used.any():
                    matrix = np.diag(self._to_segment[segment])[:, is_used]
                    form = matrix.T @ BOUNDARY_FORM * weight
                    self.program.AddQuadraticCost(
                        2.0 * form @ matrix, 2.0 * form @ boundary[:, axis], variables[is_used, axis], is_convex=True
                    )

    def _add_waypoints(self) -> None:
        """Constrain the path to pass through the region of each waypoint."""
        for i, region in enumerate(self._problem.waypoints):
            position, length = self.variables[i, 0], self.scales[i, 0]
            box = self._problem.allowed_box(i)
            for axis, variable in enumerate(position):
                if variable is not None and box is not None:
                    low, high = box.low[axis] - self._points[i, axis], box.high[axis] - self._points[i, axis]
                    self.program.AddBoundingBoxConstraint(low / length, high / length, variable)
            free, faces = self._free[i, 0], self._problem.allowed_polytope(i)
            if faces is not None and free.any():
                offsets = (faces.offsets - faces.normals @ self._points[i]) / length
                unbounded = np.full(len(offsets), -np.inf)
                self.program.AddLinearConstraint(faces.normals[:, free], unbounded, offsets, position[free])
            if isinstance(region, Sphere):
                matrix = np.vstack([np.zeros(free.sum()), np.eye(len(position))[:, free] * length / region.radius])
                offset = np.concatenate([[1.0], (self._points[i] - region.centre) / region.radius])
                if free.any():
                    self.program.AddLorentzConeConstraint(matrix, offset, position[free])

    def _local(self, segment: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a segment's variables, a mask of the free values, and the values if all variables are zero.

        Each of the three arrays has the shape (8, axes). A value that is given has no variable: its entry is None.
        """
        local, free, base = (
            values[segment : segment + 2].reshape(2 * (NUM_FREE + 1), -1)
            for values in (self.variables, self._free, self._base)
        )
        boundary = base * self._to_segment[segment][:, np.newaxis]
        boundary[NUM_FREE + 1] += self._points[segment + 1] - self._points[segment]
        return local, free, boundary

    def _derivative(self, segment: int, s: float, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a time derivative of the position at a point of a segment, as a linear function of the variables.

        Returns:
            (axes, n) matrix, (n,) variables and (axes,) constant term.
        """
        variables, free, boundary = self._local(segment)
        basis = power_basis(order, s, DEGREE + 1) @ FROM_BOUNDARY * self._durations[segment] ** -float(order)
        free = free.T
        rows = np.zeros((len(free), int(free.sum())))
        axis, entry = np.nonzero(free)
        rows[axis, np.arange(len(axis))] = (basis * self._to_segment[segment])[entry]
        constant = basis @ boundary
        if order == 0:
            constant = constant + self._points[segment]
        return rows, variables.T[free], constant

    def _solve_once(self) -> PolynomialPath:
        """Solve the optimisation problem with its present constraints."""
        values = self._base.copy()
        # Clarabel fails for a program without variables.
        if self.program.num_vars():
            self._optimise(values)
        boundary = np.concatenate([values[:-1], values[1:]], axis=1) * self._to_segment[:, :, np.newaxis]
        boundary[:, NUM_FREE + 1] += np.diff(self._points, axis=0)
        coefficients = FROM_BOUNDARY @ boundary
        coefficients[:, 0] += self._points[:-1]
        return PolynomialPath(np.concatenate([[0.0], np.cumsum(self._durations)]), coefficients)

    def _optimise(self, values: np.ndarray) -> None:
        """Solve the optimisation problem and add its solution to `values`."""
        for tolerance in _SOLVER_TOLERANCES:
            options = SolverOptions()
            for name in ("tol_feas", "tol_gap_abs", "tol_gap_rel"):
                options.SetOption(ClarabelSolver.id(), name, tolerance)
            with without_drake_remarks():
                result = ClarabelSolver().Solve(self.program, None, options)
            status = result.get_solution_result()
            if status != SolutionResult.kSolverSpecificError:
                break
        if status == SolutionResult.kInfeasibleConstraints:
            raise InfeasibleError
        if not result.is_success():
            raise SolverError(f"the minimum-snap program was not solved: {status.name}")
        values[self._free] += result.GetSolution(self.variables[self._free])
        if self._slack is not None:
            self.excess = float(result.GetSolution(self._slack_variable[0]))

    def _tighten(self, path: PolynomialPath) -> bool:
        """Add bounds where the path violates a limit or a corridor, and return whether any bound was added."""
        is_violated = False
        fraction = 1.0 + (self.excess if self._slack is RelaxedBounds.LIMITS else 0.0)
        for order, limit in self._problem.limits.by_order.items():
            peaks = norm_peaks(path, order)
            violates = peaks.norm > _with_rounding(limit) * fraction
            for segment, s in zip(peaks.segment[violates], peaks.s[violates], strict=True):
                is_violated = True
                self.bound_norm(int(segment), float(s), order, (1.0 - _LIMIT_MARGIN) * limit)
        return self._tighten_walls(path) or is_violated

    def _tighten_walls(self, path: PolynomialPath) -> bool:
        """Add bounds where the path leaves a corridor, and return whether any bound was added."""
        is_violated = False
        allowed_excess = self.excess if self._slack is RelaxedBounds.CORRIDORS else 0.0
        for approach in wall_approaches(path, self._problem.corridors):
            if approach.clearance >= -(_WALL_TOLERANCE * approach.size + allowed_excess):
                continue
            is_violated = True
            low, high = self._walls_with_margin(approach)
            self.bound_position(approach.segment, approach.s, approach.direction, low, high)
        return is_violated

    def _walls_with_margin(self, approach: WallApproach) -> tuple[float, float]:
        """Return lower and upper bounds for a position across a corridor, with a margin to the walls.

        The margin is at most half of the distance between the wall and the allowed point that is farthest from it, for
        both waypoints of the segment.
        """
        ends = (approach.segment, approach.segment + 1)
        margin = WALL_MARGIN * approach.size
        if not np.isfinite(approach.low):
            depths = [approach.high - approach.direction @ self._problem.inner_point(i) for i in ends]
            return approach.low, approach.high - max(min(margin, *(0.5 * depth for depth in depths)), 0.0)
        axis = int(np.argmax(approach.direction))
        boxes = [box for i in ends if (box := self._problem.allowed_box(i)) is not None]
        return (
            approach.low + min([margin, *(0.5 * (box.high[axis] - approach.low) for box in boxes)]),
            approach.high - min([margin, *(0.5 * (approach.high - box.low[axis]) for box in boxes)]),
        )


def _variable_scales(path: MinimumSnap, unit: np.ndarray) -> np.ndarray:
    """Return (waypoints, 4) scales of position, velocity, acceleration and jerk, in each waypoint's unit of time.

    If one of them changes by its scale, the snap cost increases by about the snap cost of the given path.
    """
    scales = boundary_scales(path.durations, unit)
    costs = np.diag(BOUNDARY_FORM) * scales**2 * path.durations[:, np.newaxis] ** -7.0
    curvature = np.zeros((len(unit), NUM_FREE + 1))
    curvature[:-1] += costs[:, : NUM_FREE + 1]
    curvature[1:] += costs[:, NUM_FREE + 1 :]
    # If the cost is zero, any scale will do.
    return np.asarray(np.sqrt((path.cost if path.cost > 0.0 else 1.0) / curvature))
