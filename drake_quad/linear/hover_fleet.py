"""Exact linear models of the loops of many vehicles that hover at the same time.

`closed_loop` linearises the loop of one scenario with AutoDiffXd, which takes seconds. A search over parameters needs
thousands of loops that differ only in some numbers. This module simulates these loops as the vehicles of one fleet. It
differentiates the map of the state over a period by central differences of fourth order, for all vehicles at once.
"""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.flight.mission import plan_route
from drake_quad.linear.closed_loop import PASSIVE_SYSTEMS, common_period, rotor_rows, rotor_speed_to_wrench_matrix
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import initialize_without_events, settle, tick_after
from drake_quad.process_settings import single_threaded_blas
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario

_EQUILIBRIUM_TOLERANCE = 1e-9  # largest change of the state over a period in an equilibrium, in SI units
_MAX_NEWTON_STEPS = 20  # largest number of steps until an equilibrium is found
# Newton's method computes new derivatives if the state change over a period after a step exceeds this fraction of the
# state change before the step.
_MAX_CHANGE_RATIO = 0.1
_DIFFERENCE_STEP = 1e-3  # finite-difference step in SI units; relative to the state if its magnitude exceeds 1
_MAX_STEP = 1e4  # in SI units; a larger Newton step is rejected, since it results from a nearly singular matrix
_REGULARISATION = 1e-11  # makes the matrix of Newton's method regular if a state never changes


class HoverFleet:
    """Loops of a scenario in hover, as a function of some of its fields.

    The rows and columns of the rotor speeds in the system matrices are transformed to thrust and torques of the rotors,
    so that the axes of a symmetric vehicle are decoupled.

    Args:
        resting: scenario of `at_rest` or `symmetric_hover`.
        fields: paths of the k fields that differ from loop to loop.
        user_systems: functions that create the user's systems for N vehicles.

    Attributes:
        resting: scenario.
        fields: paths of the fields.
        user_systems: functions that create the user's systems.
        period: sampling period of the loops, s.
        states: names of the n states, known after the first call. The states with the names of the four rotor speeds
            are thrust and torques of the rotors.
    """

    def __init__(self, resting: Scenario, fields: Sequence[str], *, user_systems: UserSystems = UserSystems()) -> None:
        self.resting, self.fields = resting, tuple(fields)
        self.states: tuple[str, ...] = ()
        self.period = common_period(resting)
        self._plan, self.user_systems = plan_route(resting), user_systems
        self._pattern = rotor_speed_to_wrench_matrix(resting)

    def __call__(self, values: np.ndarray, states: np.ndarray | None = None) -> np.ndarray:
        """Return the system matrices (N, n, n) of the loops, NaN for loops without an equilibrium near hover.

        Args:
            values: (N, k) values of the fields of each loop.
            states: indices of the n states whose rows and columns are returned; all by default. A selection saves
                time.
        """
        N = len(values)
        varying = {field: values[:, i].copy() for i, field in enumerate(self.fields)}
        batch = Batch(self.resting, (0,) * N, varying)
        diagram = build_fleet_diagram(batch, self._plan, user_systems=self.user_systems.build(N))
        period_map = _PeriodMap(diagram, N, self.period)
        self.states = period_map.states
        # Saturated and diverging loops overflow, and are then reported as NaN.
        with np.errstate(all="ignore"), single_threaded_blas():
            x, unsettled = _equilibria(period_map)
            rows, kept = rotor_rows(self.states), np.arange(len(x)) if states is None else states
            # Thrust and torques depend on the speeds of all rotors, so all or none of these speeds are needed.
            columns = {*kept} | ({*rows} if {*rows} & {*kept} else set())
            A = period_map.jacobian(x, 4, sorted(columns))
        A[unsettled] = np.nan
        if len(rows) == len(self._pattern):
            A[:, rows] = self._pattern @ A[:, rows]
            A[:, :, rows] = A[:, :, rows] @ np.linalg.inv(self._pattern)
        return A if states is None else A[:, kept][:, :, kept]


def _equilibria(period_map: "_PeriodMap") -> tuple[np.ndarray, np.ndarray]:
    """Return the equilibria (n, N) near hover, and the mask (N,) of the loops in which none is found."""
    x, unsettled = _newton(period_map, period_map.settled)
    if unsettled.any():
        other, lost = _newton(period_map, np.where(unsettled, period_map.initial, x))
        x, unsettled = np.where(unsettled, other, x), lost
    return x, unsettled


def _newton(period_map: "_PeriodMap", start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the results (n, N) of Newton's method, and the mask (N,) of the loops in which it has not converged."""
    x = start.copy()
    inverse = np.broadcast_to(np.eye(len(x)), (x.shape[1], len(x), len(x))).copy()
    largest = np.full(x.shape[1], 0.0)
    for _ in range(_MAX_NEWTON_STEPS):
        change = period_map(x) - x
        before, largest = largest, np.abs(change).max(axis=0)
        unsettled = ~(largest < _EQUILIBRIUM_TOLERANCE)
        active = unsettled & np.isfinite(change).all(axis=0)
        if not active.any():
            break
        # The derivatives are computed again only if the method converges slowly with the old derivatives.
        if (largest > _MAX_CHANGE_RATIO * before)[active].any():
            matrix = (1.0 + _REGULARISATION) * np.eye(len(x)) - period_map.jacobian(x, 2)
            matrix[~np.isfinite(matrix).all(axis=(1, 2))] = np.eye(len(x))
            new = np.linalg.inv(matrix)
            # If a command is saturated, it does not depend on the state, and the matrix is nearly singular. Such a loop
            # keeps the inverse of an earlier matrix.
            regular = np.abs(_times(new, change)).max(axis=0) < _MAX_STEP
            inverse[regular] = new[regular]
        x[:, active] += _times(inverse, change)[:, active]
    return x, unsettled


def _times(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Multiply N matrices (N, n, n) by N columns (n, N), and return the N products (n, N)."""
    return (matrices @ columns.T[:, :, np.newaxis])[:, :, 0].T


class _PeriodMap:
    """Map Φ of the states of N loops over a period, from just before the events of a tick to the next tick."""

    def __init__(self, diagram: Diagram, num_vehicles: int, period: float) -> None:
        self._diagram, self._context = diagram, diagram.CreateDefaultContext()
        self._layout = ContextVector(diagram, excluded_systems=PASSIVE_SYSTEMS)
        self._order = self._layout.vehicle_rows(num_vehicles)
        self.initial = self._read(diagram, self._context)
        settle(diagram, self._context, period)
        self._next = tick_after(self._context.get_time(), period)
        self._simulator, self._saved = Simulator(diagram, self._context), self._context.Clone()
        names = self._layout.names if num_vehicles == 1 else [each.rpartition(".")[0] for each in self._layout.names]
        self.states = tuple(names[first] for first in self._order[:, 0])
        self.settled = self._read(diagram, self._context)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the states (n, N) of the N loops after one period, given the states x before it."""
        numbers = np.empty(x.size)
        numbers[self._order] = x
        # The monitor remembers a crash, which must not affect the next call.
        self._context.SetTimeStateAndParametersFrom(self._saved)
        self._layout.write(self._diagram, self._context, numbers)
        initialize_without_events(self._simulator)
        self._simulator.AdvanceTo(self._next)
        return self._read(self._diagram, self._context)

    def jacobian(self, x: np.ndarray, order: int, columns: Sequence[int] | None = None) -> np.ndarray:
        """Return the derivatives (N, n, n) of the map, by central differences of order 2 or 4.

        Args:
            x: (n, N) states.
            order: order of the differences.
            columns: indices of the states with respect to which the map is differentiated; the derivatives with respect
                to other states are zero.
        """
        n, N = x.shape
        A = np.zeros((N, n, n))
        for j in range(n) if columns is None else columns:
            step = _DIFFERENCE_STEP * np.maximum(1.0, np.abs(x[j]))
            slopes = []
            for factor in (1.0, 2.0)[: order // 2]:
                after = []
                for sign in (factor, -factor):
                    shifted = x.copy()
                    shifted[j] += sign * step
                    after.append(self(shifted))
                slopes.append((after[0] - after[1]) / (2.0 * factor * step))
            A[:, :, j] = (slopes[0] if order == 2 else (4.0 * slopes[0] - slopes[1]) / 3.0).T
        return A

    def _read(self, diagram: Diagram, context: Context) -> np.ndarray:
        return self._layout.read(diagram, context)[self._order]
