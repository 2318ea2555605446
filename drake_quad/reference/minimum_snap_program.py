"""Minimum snap as a MathematicalProgram: the form that takes inequalities."""

from enum import Enum

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolutionResult, SolverOptions

from drake_quad.process_settings import without_drake_remarks
from drake_quad.reference.minimum_snap import (
    BOUNDARY_FORM,
    DEGREE,
    FREE,
    FROM_BOUNDARY,
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
from drake_quad.reference.walls import Turn, turns

# Tried in turn: near the edge of what is feasible Clarabel may make no progress towards the first. Its own is 1e-8.
_TOLERANCES = (1e-9, 1e-7, 1e-5)
# What limits must be exceeded by, as a share, for there to be no path.
_BREACH = 1e-4
# Limits are put this share lower than they are, and walls this share of a corridor's largest extent further in, so
# that they hold between the places where they are put.
_MARGIN, WALL_MARGIN = 1e-4, 1e-5
# How far a corridor may be left, where a waypoint on its wall leaves no room for a margin; a share likewise.
_WALL_TOLERANCE = 1e-7
_ROUNDS = 25
# The weight of the snap beside what is exceeded: enough to choose among paths that exceed it equally.
_SNAP_BESIDE_SLACK = 1e-6


class InfeasibleError(Exception):
    """No path keeps to all that is asked at these times."""


class SolverError(RuntimeError):
    """The solver gave up."""


NO_PATH = (InfeasibleError, SolverError)


def path_within(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Returns the path of least integrated squared snap that keeps to a problem's demands.

    Args:
        problem: what the path must keep to.
        durations: (segments,), s.

    Raises:
        InfeasibleError: there is no such path.
        SolverError: the solver gave up.
    """
    if problem.passes_points:
        path = MinimumSnap(problem.representatives(), durations, problem.derivatives).path()
        if all(peak_norm(path, order) <= _kept(limit) for order, limit in problem.limits.by_order.items()):
            return path
    try:
        return MinimumSnapProgram(problem, durations).solve()
    except SolverError:
        # Just beyond what is feasible the solver may find neither a path nor a proof that there is none.
        relaxed = MinimumSnapProgram(problem, durations, slack=RelaxedBounds.LIMITS)
        relaxed.solve()
        if relaxed.exceeded > _BREACH:
            raise InfeasibleError from None
        raise


def _kept(limit: float) -> float:
    """The largest number that counts as keeping to a limit: rounding errors are no breach."""
    return limit * (1.0 + 1e-9)


class RelaxedBounds(Enum):
    """What a program may exceed, at a price that replaces the snap: to find out by how much it must."""

    LIMITS = "limits"  # by a share of each limit
    CORRIDORS = "corridors"  # by a distance in m


class MinimumSnapProgram:
    """The program whose solution is the path of least integrated squared snap (paper eqs (18)-(21)).

    The variables are what the path is free to choose of position, velocity, acceleration and jerk at the waypoints, as
    differences from the fast path through representatives of the places; so they are of one size, and zero wherever
    nothing stands in the way, however much the durations differ. Both segments that meet at a waypoint share its
    variables, so the path has three continuous derivatives. Without inequalities six are continuous at the optimum; a
    bound that is met may break the fourth to sixth.

    A limit or corridor is infinitely many inequalities, one at every place of a segment. The program starts with none
    of them; `solve` adds those that its solution breaks most, at the peaks, until none is broken any more.

    Args:
        problem: what the path must keep to.
        durations: (segments,), s.
        slack: what may be exceeded, if anything.

    Attributes:
        program: Drake's MathematicalProgram, to which constraints may be added.
        variables: (segments + 1, 4, axes) decision variables, in units of `scales`; None where a value is given.
        scales: (segments + 1, 4) what turns a variable into position, velocity, acceleration and jerk, in m and s.
        exceeded: after `solve`, by how much the slack was used.
    """

    def __init__(self, problem: PathProblem, durations: np.ndarray, *, slack: RelaxedBounds | None = None) -> None:
        self._problem, self._durations = problem, durations
        self._points = problem.representatives()
        unconstrained = MinimumSnap(self._points, durations, problem.derivatives)
        unit = waypoint_units(durations)
        in_units = _sizes(unconstrained, unit)
        self.scales = in_units / unit[:, np.newaxis] ** np.arange(FREE + 1)
        self._to_segment = boundary_scales(durations, unit) * np.hstack([in_units[:-1], in_units[1:]])
        self.program = MathematicalProgram()
        self.exceeded = 0.0
        self._slack = slack
        # Empty without a slack.
        self._slack_variable = self.program.NewContinuousVariables(0 if slack is None else 1, "slack")
        base = knots(unconstrained.path(), FREE + 1) / self.scales[:, :, np.newaxis]
        base[:, 0] = 0.0  # positions count from the representatives
        self._declare_variables(base)
        self._add_cost(unconstrained.cost)
        self._add_places()

    def solve(self) -> PolynomialPath:
        """Solves the program, and adds bounds and solves again until the path keeps to limits and corridors.

        Raises:
            InfeasibleError: there is no such path.
            SolverError: the solver gave up.
        """
        for _ in range(_ROUNDS):
            path = self._solve_once()
            if not self._tighten(path):
                return path
        raise SolverError(f"the path still broke a limit or corridor after {_ROUNDS} rounds of adding bounds")

    def bound_norm(self, segment: int, s: float, order: int, bound: float) -> None:
        """Bounds the norm of a derivative in time at one place of a segment: a Lorentz cone.

        Args:
            segment: index.
            s: place, 0 to 1.
            order: 1 for the velocity.
            bound: in m and s.
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
        """Holds the position along a direction to an interval in m at one place of a segment.

        Args:
            segment: index.
            s: place, 0 to 1.
            direction: (axes,) unit vector, or the index of an axis.
            low: m, or -inf.
            high: m.
        """
        rows, variables, constant = self._derivative(segment, s, 0)
        if isinstance(direction, int):
            direction = np.eye(len(rows))[direction]
        row = direction @ rows
        used = row != 0.0
        row, variables = row[used], variables[used]
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
        """Sets up the variables, and what they are added to, in units of the scales."""
        problem = self._problem
        axes = self._points.shape[1]
        self._base = np.zeros((len(self._points), FREE + 1, axes))
        self._base[:, 1:] = problem.derivatives / self.scales[:, 1:, np.newaxis]
        for i in range(len(self._points)):
            room = problem.room(i)
            if room is not None:
                self._base[i, 0, room.low < room.high] = np.nan
            else:
                self._base[i, 0] = np.nan
        for i, corridor in enumerate(problem.corridors):
            if isinstance(corridor, Box):
                # A corridor without extent leaves nothing but to stay where it is.
                flat = corridor.low == corridor.high
                self._base[i : i + 2, 1:, flat] = 0.0  # what is given is zero there too, or the problem was refused
        self._free = np.isnan(self._base)
        self._base[self._free] = unconstrained[self._free]
        self.variables = np.full(self._base.shape, None, dtype=object)
        self.variables[self._free] = self.program.NewContinuousVariables(int(self._free.sum()), "d")

    def _add_cost(self, total: float) -> None:
        """Adds the snap, relative to that of another path of the same order."""
        weights = self._durations**-7.0 / (total if total > 0.0 else (self._durations**-7.0).max())
        if self._slack is not None:
            weights = _SNAP_BESIDE_SLACK * weights
            self.program.AddLinearCost(self._slack_variable[0])
            self.program.AddBoundingBoxConstraint(0.0, np.inf, self._slack_variable[0])
        for segment, weight in enumerate(weights):
            variables, free, boundary = self._local(segment)
            for axis, used in enumerate(free.T):
                if used.any():
                    matrix = np.diag(self._to_segment[segment])[:, used]
                    form = matrix.T @ BOUNDARY_FORM * weight
                    self.program.AddQuadraticCost(
                        2.0 * form @ matrix, 2.0 * form @ boundary[:, axis], variables[used, axis], is_convex=True
                    )

    def _add_places(self) -> None:
        for i, place in enumerate(self._problem.places):
            position, length = self.variables[i, 0], self.scales[i, 0]
            room = self._problem.room(i)
            for axis, variable in enumerate(position):
                if variable is not None and room is not None:
                    low, high = room.low[axis] - self._points[i, axis], room.high[axis] - self._points[i, axis]
                    self.program.AddBoundingBoxConstraint(low / length, high / length, variable)
            free, faces = self._free[i, 0], self._problem.faces(i)
            if faces is not None and free.any():
                offsets = (faces.offsets - faces.normals @ self._points[i]) / length
                unbounded = np.full(len(offsets), -np.inf)
                self.program.AddLinearConstraint(faces.normals[:, free], unbounded, offsets, position[free])
            if isinstance(place, Sphere):
                matrix = np.vstack([np.zeros(free.sum()), np.eye(len(position))[:, free] * length / place.radius])
                offset = np.concatenate([[1.0], (self._points[i] - place.centre) / place.radius])
                if free.any():
                    self.program.AddLorentzConeConstraint(matrix, offset, position[free])

    def _local(self, segment: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A segment's (8, axes) variables, where there are any, and boundary derivatives where these are zero."""
        local, free, base = (
            values[segment : segment + 2].reshape(2 * (FREE + 1), -1)
            for values in (self.variables, self._free, self._base)
        )
        boundary = base * self._to_segment[segment][:, np.newaxis]
        boundary[FREE + 1] += self._points[segment + 1] - self._points[segment]
        return local, free, boundary

    def _derivative(self, segment: int, s: float, order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(axes, n) rows, (n,) variables and (axes,) constant of a derivative in time at a place of a segment."""
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
        values = self._base.copy()
        # Clarabel does not survive a program without variables.
        if self.program.num_vars():
            self._optimise(values)
        boundary = np.concatenate([values[:-1], values[1:]], axis=1) * self._to_segment[:, :, np.newaxis]
        boundary[:, FREE + 1] += np.diff(self._points, axis=0)
        coefficients = FROM_BOUNDARY @ boundary
        coefficients[:, 0] += self._points[:-1]
        return PolynomialPath(np.concatenate([[0.0], np.cumsum(self._durations)]), coefficients)

    def _optimise(self, values: np.ndarray) -> None:
        """Solve the program and set the values of its variables."""
        for tolerance in _TOLERANCES:
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
            self.exceeded = float(result.GetSolution(self._slack_variable[0]))

    def _tighten(self, path: PolynomialPath) -> bool:
        """Adds bounds where the path breaks a limit or a corridor; returns whether it does."""
        broken = False
        share = 1.0 + (self.exceeded if self._slack is RelaxedBounds.LIMITS else 0.0)
        for order, limit in self._problem.limits.by_order.items():
            peaks = norm_peaks(path, order)
            over = peaks.norm > _kept(limit) * share
            for segment, s in zip(peaks.segment[over], peaks.s[over], strict=True):
                broken = True
                self.bound_norm(int(segment), float(s), order, (1.0 - _MARGIN) * limit)
        return self._tighten_walls(path) or broken

    def _tighten_walls(self, path: PolynomialPath) -> bool:
        broken = False
        beyond = self.exceeded if self._slack is RelaxedBounds.CORRIDORS else 0.0
        for turn in turns(path, self._problem.corridors):
            if turn.room >= -(_WALL_TOLERANCE * turn.size + beyond):
                continue
            broken = True
            low, high = self._inside(turn)
            self.bound_position(turn.segment, turn.s, turn.direction, low, high)
        return broken

    def _inside(self, turn: Turn) -> tuple[float, float]:
        """The walls with a margin, no further in than half way to where the waypoints must be."""
        ends = (turn.segment, turn.segment + 1)
        margin = WALL_MARGIN * turn.size
        if not np.isfinite(turn.low):
            depths = [turn.high - turn.direction @ self._problem.inner_point(i) for i in ends]
            return turn.low, turn.high - max(min(margin, *(0.5 * depth for depth in depths)), 0.0)
        axis = int(np.argmax(turn.direction))
        rooms = [room for i in ends if (room := self._problem.room(i)) is not None]
        return (
            turn.low + min([margin, *(0.5 * (room.high[axis] - turn.low) for room in rooms)]),
            turn.high - min([margin, *(0.5 * (turn.high - room.low[axis]) for room in rooms)]),
        )


def _sizes(path: MinimumSnap, unit: np.ndarray) -> np.ndarray:
    """(waypoints, 4) sizes of position to jerk, in the waypoints' units of time, that cost about as much as a path."""
    scales = boundary_scales(path.durations, unit)
    costs = np.diag(BOUNDARY_FORM) * scales**2 * path.durations[:, np.newaxis] ** -7.0
    curvature = np.zeros((len(unit), FREE + 1))
    curvature[:-1] += costs[:, : FREE + 1]
    curvature[1:] += costs[:, FREE + 1 :]
    # Any size will do where nothing needs to move.
    return np.asarray(np.sqrt((path.cost if path.cost > 0.0 else 1.0) / curvature))
