"""Certificate of stability in hover for all random parameters of a scenario at once.

The ranges of all distributions are multiplied by a scale about their centres, and every combination of values within
the scaled ranges results in a loop (see `drake_quad.design.uncertain_hover`). A certificate encloses the scale at which
the first of these loops becomes unstable. The upper bound is the scale of a loop that is unstable in its exact model.
The lower bound follows from the structured singular value of linear fractional models of the loop.

For real parameters, the structured singular value of the whole box can be far from the exact scale, and a model of the
whole box can be poor. Therefore a box that is not proved to be stable is divided into two cells along the parameter
with the largest effect, and each cell has its own model (branch and bound; M. Newlin and P. Young, "Mixed μ problems
and branch and bound techniques", 1997).
"""

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count, product
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.design.uncertain_hover import (
    MIN_DECAY,
    Choice,
    Failure,
    Part,
    Range,
    UncertainHover,
    is_unstable,
)
from drake_quad.linear.fractional_model import fit_fractional_model, fitting_points, spectral_radii
from drake_quad.process_settings import single_threaded_blas
from drake_quad.scenario.models import Scenario

MAX_SCALE = 8.0
"""Largest scale at which the search looks for unstable loops."""
_TARGET_BOUND_RATIO = 0.95  # ratio of lower to upper bound of the certified scale at which the division into cells ends
# Scale of the first cell, which contains all others, relative to the smallest scale at which a loop is unstable. It is
# only slightly above `_TARGET_BOUND_RATIO`, because a larger cell needs more divisions.
_FIRST_CELL_RATIO = 0.96
_MAX_CELLS = 150  # number of tested cells after which no cell is divided any more
# If the bound on the structured singular value of a cell exceeds this value, the computation of the bound ends, and the
# cell is divided. Only for cells that are symmetric about the centre of the ranges, the bound is always computed: it
# determines how large a box is stable.
_MAX_BOUND = 1.02
_NUM_CELLS_AT_ONCE = 16  # number of cells that are divided at the same time
_MAX_CORNERS = 64  # largest number of corners of the ranges from which the search starts
_NUM_CANDIDATES = 48  # number of random directions that each round of the search tests
_NUM_ROUNDS = 4  # number of rounds of the search, after the bisection along the directions of the corners
_NUM_BISECTIONS = 7  # number of bisections between a stable and a failing scale
_MIN_SCALE = 1e-3  # smallest scale at which the search looks for unstable loops
# Scale at which a round tests loops in its directions, relative to the smallest scale so far at which a loop is
# unstable or has no equilibrium.
_SCALE_REDUCTION = 0.97
# Factors on the scaled parameters of the unstable loop with the smallest scale. The first factor that makes the
# deviations grow fast enough to be visible in a flight is used.
_GROWTH_FACTORS = (1.0, 1.1, 1.2, 1.3, 1.5, 2.0)
_MAX_GROWTH_TIME = 10.0  # s, longest growth time of an instability that is visible in a flight of one minute


class Growth(NamedTuple):
    """Growth of the oscillation in an unstable loop that is selected to show the instability in a flight.

    Attributes:
        loop: scale and parameter values of the loop.
        time: time in which the deviation from hover grows by a factor of e, s.
    """

    loop: Failure
    time: float


@dataclass(frozen=True)
class Certificate:
    """Lower and upper bound of the scale at which hover becomes unstable.

    The ranges of all random parameters are multiplied by the scale.

    Attributes:
        stable_scale: lower bound, up to which hover is stable for all combinations of parameters; 0 if none is proved.
        unstable: unstable loop with the smallest scale that was found; this scale is the upper bound. It is infinite if
            no loop up to `MAX_SCALE` was unstable.
        without_equilibrium: combination of parameters with the smallest scale at which the loop has no equilibrium,
            because a command saturates. Its scale is infinite if all loops had an equilibrium.
        growth: loop at the scale of `unstable` or beyond whose oscillation is visible in a flight; None if no unstable
            loop was found.
        ranges: parameters with a range that act on the loop.
        choices: parameters with discrete values.
        left_out: paths of distributions that do not act on hover in still air.
        num_loops: number of loops whose exact model was computed.
        num_cells: number of cells that were tested.
    """

    stable_scale: float
    unstable: Failure
    without_equilibrium: Failure
    growth: Growth | None
    ranges: tuple[Range, ...]
    choices: tuple[Choice, ...]
    left_out: tuple[str, ...]
    num_loops: int
    num_cells: int

    @property
    def parameters(self) -> tuple[str, ...]:
        """Paths of all parameters that act on the loop: those with a range, then those with discrete values."""
        return (*(each.path for each in self.ranges), *(each.path for each in self.choices))

    @property
    def certified_box(self) -> dict[str, tuple[float, float]]:
        """Smallest and largest value of each parameter up to which all combinations are stable, by path."""
        ends = np.array([-self.stable_scale, self.stable_scale])
        box = {each.path: each.at(ends) for each in self.ranges}
        box |= {each.path: np.array([min(each.values), max(each.values)]) for each in self.choices}
        return {path: (float(low), float(high)) for path, (low, high) in box.items()}

    @property
    def gap(self) -> float:
        """Difference between the two bounds, relative to the upper one.

        The upper bound is the smallest scale at which a loop is unstable or has no equilibrium, at most `MAX_SCALE`.
        """
        failing = min(self.unstable.scale, self.without_equilibrium.scale, MAX_SCALE)
        return 1.0 - self.stable_scale / failing if failing > 0.0 else 0.0


def certify_hover(
    scenario: Scenario, *, user_systems: UserSystems = UserSystems(), progress: Callable[[int, str], None] | None = None
) -> Certificate:
    """Return the certificate of a scenario's loop. Random choices in the search follow from the scenario's seed.

    Args:
        scenario: scenario with distributions.
        user_systems: functions that create the user's systems for N vehicles.
        progress: function that is called with the number of loops computed since the last call, and a description of
            the present step.

    Raises:
        InputError: if no distribution acts on hover, the loop has no linear model, or the loop at the centre of the
            ranges has a pole at 1 or no equilibrium.
    """
    stable_scale, num_cells = 0.0, 0
    with single_threaded_blas():
        hover = UncertainHover(scenario, user_systems, progress or (lambda count, step: None))
        centre = hover.radii(*hover.with_all_combinations(np.zeros((1, len(hover.ranges)))), "centre")
        if not is_unstable(centre).any():
            _search(hover)
            stable_scale, num_cells = _certified_scale(hover)
        growth = _growth(hover) if hover.unstable.values else None
    return Certificate(
        stable_scale,
        hover.unstable,
        hover.without_equilibrium,
        growth,
        hover.ranges,
        hover.choices,
        hover.left_out,
        hover.num_loops,
        num_cells,
    )


def _search(hover: UncertainHover) -> None:
    """Search for the smallest scale at which a loop is unstable or has no equilibrium.

    The search begins with the directions from the centre of the ranges to their corners, in which each parameter is at
    an end of its range. The loops in these directions are tested at increasing scales. The direction in which a loop
    first becomes unstable is then varied at random.
    """
    k = len(hover.ranges)
    all_corners = 2**k <= _MAX_CORNERS
    corners = (
        [*product((-1.0, 1.0), repeat=k)] if all_corners else hover.generator.choice([-1.0, 1.0], (_MAX_CORNERS, k))
    )
    directions, combinations = hover.with_all_combinations(np.array(corners))
    stable, scale = 0.0, 1.0
    while not (fails := _fails(hover, scale * directions, combinations)).any() and scale < MAX_SCALE:
        stable, scale = scale, min(2.0 * scale, MAX_SCALE)
    if not fails.any():
        return
    while (
        stable == 0.0
        and scale > _MIN_SCALE
        and (fails_closer := _fails(hover, 0.5 * scale * directions, combinations)).any()
    ):
        scale, fails = 0.5 * scale, fails_closer
    stable = max(stable, 0.5 * scale)
    direction, combination, scale = _bisect(hover, directions[fails], combinations[fails], stable, scale)
    spread = 0.5
    for _ in range(_NUM_ROUNDS):
        changed = direction + spread * hover.generator.standard_normal((_NUM_CANDIDATES, k))
        changed, combinations = np.clip(changed, -1.0, 1.0), np.full(_NUM_CANDIDATES, combination)
        fails = _fails(hover, _SCALE_REDUCTION * scale * changed, combinations)
        if fails.any():
            direction, _, scale = _bisect(
                hover, changed[fails], combinations[fails], 0.8 * scale, _SCALE_REDUCTION * scale
            )
        else:
            spread *= 0.5


def _fails(hover: UncertainHover, z: np.ndarray, combinations: np.ndarray) -> np.ndarray:
    """Return the mask of the loops that are unstable or have no equilibrium."""
    radii = hover.radii(z, combinations, "search")
    return is_unstable(radii) | np.isnan(radii)


def _bisect(
    hover: UncertainHover, directions: np.ndarray, combinations: np.ndarray, stable: float, failing: float
) -> tuple[np.ndarray, int, float]:
    """Return the direction that fails at the smallest scale, its combination, and this scale.

    Args:
        hover: loops.
        directions: (K, k) directions from the centre of the ranges, in scaled parameters.
        combinations: (K,) indices of combinations of discrete values.
        stable: scale at which the loops in all directions are assumed to be stable.
        failing: scale at which the loops in all directions fail.
    """
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (stable + failing)
        fails = _fails(hover, middle * directions, combinations)
        if fails.any():
            failing, directions, combinations = middle, directions[fails], combinations[fails]
        else:
            stable = middle
    return directions[0], int(combinations[0]), failing


def _growth(hover: UncertainHover) -> Growth:
    """Return the loop that shows the instability in a flight.

    The scaled parameters of the unstable loop with the smallest scale are multiplied by each of `_GROWTH_FACTORS`. The
    result is the first loop whose growth time is at most `_MAX_GROWTH_TIME`, or else the loop with the shortest one.
    """
    z, combination = hover.scaled(hover.unstable.values)
    candidates = np.outer(_GROWTH_FACTORS, z)
    radii = hover.radii(candidates, np.full(len(candidates), combination), "growth")
    times = hover.period / np.log(np.where(is_unstable(radii), radii, 1.0 + MIN_DECAY))
    visible = np.flatnonzero(times <= _MAX_GROWTH_TIME)
    index = int(visible[0] if len(visible) else np.argmin(times))
    return Growth(hover.combined(candidates[index], combination), float(times[index]))


class _Cell(NamedTuple):
    """Box of scaled parameters for which a part of the loop is tested for stability.

    Attributes:
        part: part of the loop.
        low: (k,) lower ends of the scaled parameters.
        high: (k,) upper ends.
    """

    part: Part
    low: np.ndarray
    high: np.ndarray

    def halves(self, axis: int) -> list["_Cell"]:
        """Return the two halves along an axis."""
        middle = 0.5 * (self.low[axis] + self.high[axis])
        low, high = self.low.copy(), self.high.copy()
        low[axis] = high[axis] = middle
        return [self._replace(high=high), self._replace(low=low)]

    def min_scale(self) -> float:
        """Return the smallest scale of a combination of parameters in this cell: its smallest max |z|."""
        return float(np.maximum(np.maximum(self.low, -self.high), 0.0).max(initial=0.0))

    def min_scale_outside(self, low: np.ndarray, high: np.ndarray) -> float:
        """Return the smallest scale of a combination in this cell outside the box from `low` to `high`, both (k,)."""
        outer = [self._replace(high=np.where(axis, low, self.high)) for axis in np.eye(len(low), dtype=bool)]
        outer += [self._replace(low=np.where(axis, high, self.low)) for axis in np.eye(len(low), dtype=bool)]
        return min(each.min_scale() for each in outer)


def _certified_scale(hover: UncertainHover) -> tuple[float, int]:
    """Return the scale up to which all loops are proved to be stable, and the number of cells that were tested."""
    size = _FIRST_CELL_RATIO * min(hover.smallest_failing_scale, MAX_SCALE)
    hover.choose_exponents(size)
    untested = [
        _Cell(part, -size * np.ones(len(part.ranges)), size * np.ones(len(part.ranges))) for part in hover.parts()
    ]
    parent_scales, num_cells, serial_numbers = [0.0] * len(untested), 0, count()
    # A heap of cells that are not proved to be stable. Each entry consists of the smallest scale that is not proved in
    # the cell, a consecutive number for entries with equal scales, the axis along which the cell is divided next, and
    # the cell.
    unproved: list[tuple[float, int, int, _Cell]] = []
    while untested:
        for cell, parent_scale, (scale, axis) in zip(
            untested, parent_scales, _test_cells(hover, untested), strict=True
        ):
            if scale < math.inf:
                heapq.heappush(unproved, (max(parent_scale, scale), next(serial_numbers), axis, cell))
        num_cells += len(untested)
        untested, parent_scales = [], []
        goal = _TARGET_BOUND_RATIO * min(hover.smallest_failing_scale, MAX_SCALE)
        while unproved and unproved[0][0] < goal and len(untested) < 2 * _NUM_CELLS_AT_ONCE and num_cells < _MAX_CELLS:
            scale, _, axis, cell = heapq.heappop(unproved)
            untested += cell.halves(axis)
            parent_scales += [scale, scale]
    return min([size, *(scale for scale, *_ in unproved[:1])]), num_cells


def _test_cells(hover: UncertainHover, cells: list[_Cell]) -> list[tuple[float, int]]:
    """Return the result of the stability test for each cell: the smallest unproved scale, and an axis.

    The smallest unproved scale is the smallest scale in the cell at which stability is not proved; infinity if the
    whole cell is stable. The cell is divided along the axis, whose parameter has the largest effect.
    """
    points = [fitting_points(len(cell.low), hover.generator) for cell in cells]
    loops = hover.loops_in([(cell.part, cell.low, cell.high) for cell in cells], points)
    return [_test_cell(hover, *each) for each in zip(cells, points, loops, strict=True)]


def _test_cell(hover: UncertainHover, cell: _Cell, points: np.ndarray, loops: np.ndarray) -> tuple[float, int]:
    if not np.isfinite(loops).all() or not (spectral_radii(loops[:1]) < 1.0).all():
        return cell.min_scale(), int(np.argmax(cell.high - cell.low))
    model = fit_fractional_model(points, loops)
    try:
        is_symmetric = bool((cell.low == -cell.high).all())
        bound = model.bound(stop=1.0, limit=math.inf if is_symmetric else _MAX_BOUND)
    except ArithmeticError:
        return cell.min_scale(), int(np.argmax(model.strengths(0.0)))
    if bound.value <= 1.0:
        return math.inf, 0
    axis = int(np.argmax(model.strengths(bound.frequency)))
    if not math.isfinite(bound.value):
        return cell.min_scale(), axis
    inner = hover.shrunk(cell.part, cell.low, cell.high, 1.0 / bound.value)
    return cell.min_scale_outside(*inner), axis
