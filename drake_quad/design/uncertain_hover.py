"""Random parameters of a scenario that act on its loop in hover, and the exact loops at their values.

A distribution has a range: all its values, or three standard deviations about the mean where it has no limits. All
ranges are multiplied by a scale about their centres. Scaled parameters z are -1 and 1 at the ends of the ranges, so
that the scale of a combination of parameters is the largest |z|.

The vehicle hovers in still air, and parameters that would tilt it, such as wind and an offset of the centre of mass,
have their medians or are zero; see `symmetric_hover`.
"""

import math
from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import decoupled_loop
from drake_quad.linear.fractional_model import STEPS, spectral_radii
from drake_quad.linear.hover_fleet import HoverFleet
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.distributions import Distribution, LogUniform
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, leaves, map_leaves
from drake_quad.vehicle.rigid_body import nearest_rigid_inertia

MIN_DECAY = 1e-6
"""A loop is unstable if a pole is outside the unit circle by more than this distance, which exceeds rounding errors."""
_SIGMA = 3.0  # range of a normal distribution without limits, in standard deviations
_MIN_FRACTION = 0.1  # smallest value of a quantity that cannot be negative, relative to the centre of its range
_MAX_CHOICES = 32  # largest number of combinations of discrete values
_MAX_LOOPS = 512  # number of loops that are computed at the same time
_NUM_PROBES = 6  # number of random combinations of parameters at which the effect of each parameter is computed
# A parameter acts on the loop if it changes an entry of the system matrix by more than this fraction of the largest
# entry in the same row.
_MIN_EFFECT = 1e-6
# States are coupled if an entry of the system matrix exceeds this fraction of the largest entry in the same row.
_MIN_COUPLING = 1e-7
# Loops are interpolated linearly in a power of each parameter. These are the exponents that are tried; 0 stands for the
# logarithm.
_EXPONENTS = (1.0, 0.0, -0.5, -1.0)


class Range(NamedTuple):
    """Range of a random parameter.

    Attributes:
        path: path of the field with the distribution.
        field: path of the field of the scenario in hover that changes with the parameter.
        low: lower end at scale 1.
        high: upper end at scale 1.
        is_logarithmic: True if the logarithm of the value is scaled.
    """

    path: str
    field: str
    low: float
    high: float
    is_logarithmic: bool

    def at(self, z: np.ndarray) -> np.ndarray:
        """Return the values at scaled parameters z, which are -1 and 1 at the ends of the range.

        If `low` is not negative, the values are clipped: they are at least a tenth of the centre of the range, or at
        least `low` if `low` is smaller.
        """
        if self.is_logarithmic:
            return np.asarray(math.sqrt(self.low * self.high) * (self.high / self.low) ** (0.5 * z))
        centre = 0.5 * (self.low + self.high)
        values = centre + 0.5 * (self.high - self.low) * z
        return np.maximum(values, min(self.low, _MIN_FRACTION * centre)) if self.low >= 0.0 else values

    def scaled(self, values: np.ndarray) -> np.ndarray:
        """Return the scaled parameters z that correspond to values."""
        if self.is_logarithmic:
            return np.asarray(2.0 * np.log(values / math.sqrt(self.low * self.high)) / math.log(self.high / self.low))
        return (2.0 * values - self.low - self.high) / (self.high - self.low)


class Choice(NamedTuple):
    """Random parameter with a few discrete values, all of which are possible at any scale."""

    path: str
    field: str
    values: tuple[float, ...]


class Failure(NamedTuple):
    """Combination of parameters at which hover is not stable.

    Attributes:
        scale: scale of the combination; infinite if none is known.
        values: values of all parameters, by path.
    """

    scale: float
    values: dict[str, float]


class Part(NamedTuple):
    """Strongly connected component of the states of a loop. Its poles are also poles of the whole loop.

    Attributes:
        states: indices of the states.
        ranges: indices of the parameters with a range that affect these states.
        combination: index of the combination of discrete values in `UncertainHover.combinations`.
    """

    states: np.ndarray
    ranges: np.ndarray
    combination: int


class UncertainHover:
    """Loops of a scenario in hover, for all combinations of its random parameters.

    Args:
        scenario: scenario with distributions. Random choices follow from its seed.
        user_systems: functions that create the user's systems for N vehicles.
        progress: function that is called with the number of loops computed since the last call, and a description of
            the present step.

    Attributes:
        ranges: parameters with a range that act on the loop.
        choices: parameters with discrete values.
        combinations: (combinations, choices) all combinations of discrete values.
        left_out: paths of distributions that do not act on hover in still air.
        unstable: unstable loop with the smallest scale so far.
        without_equilibrium: combination of parameters with the smallest scale so far at which the loop has no
            equilibrium, because a command saturates.
        num_loops: number of loops so far.
        generator: source of all random choices.

    Raises:
        InputError: if no distribution acts on hover, the scenario has a state estimator, the loop has no linear model,
            or the loop at the centre of the ranges has a pole at 1 or no equilibrium.
    """

    def __init__(self, scenario: Scenario, user_systems: UserSystems, progress: Callable[[int, str], None]) -> None:
        self._progress, self.num_loops = progress, 0
        self.generator = np.random.default_rng(scenario.seed)
        self.unstable = self.without_equilibrium = Failure(math.inf, {})
        self.ranges, self.choices, self.left_out = parameters_in_hover(scenario)
        if not self.ranges:
            raise InputError(
                f"no distribution with a range in {scenario.name} acts on hover in still air, so there is nothing to"
                " certify; give one, such as vehicle.mass"
            )
        if scenario.laboratory.estimator.integrates_sensors:
            raise InputError(
                f"cannot certify hover in {scenario.name}: it has a state estimator, and state estimators reject"
                " large deviations; set laboratory.estimator to {kind: motion_capture}"
            )
        hovering = symmetric_hover(at_rest(median_scenario(scenario)))
        if user_systems == UserSystems():
            decoupled_loop(hovering)  # raises InputError if the loop has no linear model
        self.combinations = np.array([*product(*(choice.values for choice in self.choices))])
        if len(self.combinations) > _MAX_CHOICES:
            raise InputError(
                f"{scenario.name} has {len(self.combinations)} combinations of discrete values, but at most"
                f" {_MAX_CHOICES} can be certified"
            )
        self._fleet = self._fleet_of(hovering, user_systems)
        self._check_centre(scenario.name)
        loops = self._probes()
        sizes = np.abs(loops).max(axis=-1, keepdims=True)
        changes = np.abs(loops[:, :, 1:] - loops[:, :, :1]) > _MIN_EFFECT * (sizes[:, :, 1:] + sizes[:, :, :1])
        acts = changes.any(axis=(0, 1))  # (k, n, n)
        self._leave_out(~acts.any(axis=(1, 2)))
        acts = acts[acts.any(axis=(1, 2))]
        # The eigenvalues of a loop are those of its strongly connected components.
        couples = (np.abs(loops) > _MIN_COUPLING * sizes).any(axis=(0, 1, 2))
        count, groups = scipy.sparse.csgraph.connected_components(couples, connection="strong")
        members = [np.flatnonzero(groups == group) for group in range(count)]
        self._groups = [(states, np.flatnonzero(acts[:, states][:, :, states].any(axis=(1, 2)))) for states in members]
        self._exponents = [1.0] * len(self.ranges)

    @property
    def period(self) -> float:
        """Sampling period of the loops, s."""
        return self._fleet.period

    @property
    def smallest_failing_scale(self) -> float:
        """Smallest scale found so far at which a loop is unstable or has no equilibrium."""
        return min(self.unstable.scale, self.without_equilibrium.scale)

    def parts(self) -> list[Part]:
        """Return, for each combination of discrete values, the parts that depend on a parameter with a range."""
        count = range(len(self.combinations))
        return [Part(states, ranges, i) for i in count for states, ranges in self._groups if len(ranges)]

    def radii(self, z: np.ndarray, combinations: np.ndarray, step: str) -> np.ndarray:
        """Return the spectral radii (K,) of the loops at scaled parameters (K, k); NaN without an equilibrium.

        Moments of inertia that no rigid body can have are moved to the nearest possible ones within their ranges. An
        unstable loop with a smaller scale than all before is stored in `unstable`, and a loop without an equilibrium in
        `without_equilibrium`.
        """
        values = self._with_rigid_bodies(z)
        loops = self._loops(values, combinations, step)
        radii = np.max([spectral_radii(loops[:, states][:, :, states]) for states, _ in self._groups], axis=0)
        scales = np.abs(z).max(axis=1)
        for name, mask in (("unstable", is_unstable(radii)), ("without_equilibrium", np.isnan(radii))):
            if mask.any() and (smallest := scales[mask].min()) < getattr(self, name).scale:
                row = int(np.flatnonzero(mask & (scales == smallest))[0])
                setattr(self, name, self.combined(z[row], combinations[row]))
        return radii

    def combined(self, z: np.ndarray, combination: int) -> Failure:
        """Return the scale and all parameter values of one loop.

        Args:
            z: (k,) scaled parameters.
            combination: index of the combination of discrete values.
        """
        paths = [*(each.path for each in self.ranges), *(each.path for each in self.choices)]
        numbers = self.all_values(z[np.newaxis], np.array([combination]))[0]
        return Failure(float(np.abs(z).max()), dict(zip(paths, map(float, numbers), strict=True)))

    def all_values(self, z: np.ndarray, combinations: np.ndarray) -> np.ndarray:
        """Return the values of all parameters of K loops: (K, k) in ranges, followed by (K, m) discrete values.

        Args:
            z: (K, k) scaled parameters.
            combinations: (K,) indices of combinations of the m discrete values.
        """
        return np.hstack([self._with_rigid_bodies(z), self.combinations[combinations]])

    def scaled(self, values: dict[str, float]) -> tuple[np.ndarray, int]:
        """Return the scaled parameters (k,) and the index of the combination of discrete values of one loop.

        Args:
            values: values of all parameters, by path.
        """
        z = np.array([each.scaled(np.array(values[each.path])) for each in self.ranges])
        chosen = np.array([values[each.path] for each in self.choices])
        return z, int(np.flatnonzero((self.combinations == chosen).all(axis=1))[0])

    def with_all_combinations(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Combine each row of an array (K, k) with each combination of discrete values; return rows and indices."""
        count = len(self.combinations)
        return np.repeat(z, count, axis=0), np.tile(np.arange(count), len(z))

    def choose_exponents(self, size: float) -> None:
        """Choose, for each parameter, the power of the parameter in which the loops are most nearly linear.

        The loops are compared up to the scale `size`. `loops_in` and `shrunk` then interpolate linearly between the
        powers at the ends of a cell.
        """
        k, steps = len(self.ranges), np.array([0.0, *STEPS])
        z = np.zeros((k, len(steps), k))
        z[range(k), :, range(k)] = size * steps
        values = self._values(z.reshape(-1, k))
        loops = self._loops(*self.with_all_combinations(values), "model")
        loops = loops.reshape(k, len(steps), len(self.combinations), *loops.shape[1:])
        row_sizes = np.abs(loops[0, 0]).max(axis=-1, keepdims=True)
        flat = (loops / np.where(row_sizes > 0.0, row_sizes, 1.0)).reshape(k, len(steps), -1)
        values = values.reshape(z.shape)
        for i in range(k):
            finite = np.isfinite(flat[i]).all(axis=1)
            allowed = _EXPONENTS if values[i, :, i].min() > 0.0 else _EXPONENTS[:1]
            errors = []
            for exponent in allowed:
                line = np.vander(_power(values[i, finite, i], exponent), 2)
                line = line / np.abs(line).max(axis=0)
                errors.append(np.linalg.norm(flat[i, finite] - line @ (np.linalg.pinv(line) @ flat[i, finite])))
            self._exponents[i] = allowed[int(np.argmin(errors))]

    def loops_in(self, cells: list[tuple[Part, np.ndarray, np.ndarray]], points: list[np.ndarray]) -> list[np.ndarray]:
        """Return the system matrices (K, n, n) of parts at points of their cells, and store loops that fail.

        Args:
            cells: for each cell, a part, and the lower and upper ends (k,) of the scaled parameters that affect it.
            points: for each cell, points (K, k). A coordinate is -1 at the lower end and 1 at the upper end of the
                cell.
        """
        z = [np.zeros((len(each), len(self.ranges))) for each in points]
        combinations = np.concatenate([np.full(len(p), part.combination) for (part, *_), p in zip(cells, points)])
        for (part, low, high), each, rows in zip(cells, points, z, strict=True):
            rows[:, part.ranges] = self._from_cell(part, low, high, each)
        values, ends = self._values(np.concatenate(z)), np.cumsum([len(each) for each in points])
        samples = np.split(np.arange(len(values)), ends[:-1])
        found: dict[int, np.ndarray] = {}
        # If several parts have the same states, their loops are computed in one call, with only these states.
        for states in {tuple(part.states): part.states for part, *_ in cells}.values():
            members = [i for i, (part, *_) in enumerate(cells) if np.array_equal(part.states, states)]
            chosen = np.concatenate([samples[i] for i in members])
            loops = self._loops(values[chosen], combinations[chosen], "bound", states)
            pieces = np.split(loops, np.cumsum([len(samples[i]) for i in members])[:-1])
            found.update(zip(members, pieces, strict=True))
        parts = [found[i] for i in range(len(cells))]
        radii = np.concatenate([spectral_radii(each) for each in parts])
        failing = np.flatnonzero(~(radii < 1.0 + MIN_DECAY))
        everything = np.concatenate(z)
        failing = failing[np.abs(everything[failing]).max(axis=1) < self.smallest_failing_scale]
        if len(failing):
            self.radii(everything[failing], combinations[failing], "bound")
        return parts

    def shrunk(self, part: Part, low: np.ndarray, high: np.ndarray, fraction: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower and upper ends of a smaller cell in the middle of a cell, with a fraction of its size."""
        ends = np.array([[-fraction], [fraction]]) * np.ones(len(part.ranges))
        inner_low, inner_high = self._from_cell(part, low, high, ends)
        return inner_low, inner_high

    def _from_cell(self, part: Part, low: np.ndarray, high: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the scaled parameters (K, k) at points of a cell."""
        z = []
        for i, ends, point in zip(part.ranges, np.stack([low, high], axis=1), points.T, strict=True):
            each, exponent = self.ranges[i], self._exponents[i]
            first, last = _power(each.at(ends), exponent)
            powers = 0.5 * (first + last) + 0.5 * (last - first) * point
            values = np.exp(powers) if exponent == 0.0 else powers ** (1.0 / exponent)
            z.append(np.clip(each.scaled(values), *ends))
        return np.stack(z, axis=1)

    def _fleet_of(self, hovering: Scenario, user_systems: UserSystems) -> HoverFleet:
        return HoverFleet(
            hovering,
            [*(each.field for each in self.ranges), *(each.field for each in self.choices)],
            user_systems=user_systems,
        )

    def _values(self, z: np.ndarray) -> np.ndarray:
        """Return the values (K, k) of the parameters with a range."""
        return np.stack([each.at(column) for each, column in zip(self.ranges, z.T, strict=True)], axis=1)

    def _loops(
        self, values: np.ndarray, combinations: np.ndarray, step: str, states: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the system matrices (K, n, n) of K loops.

        Args:
            values: (K, k) values of the parameters with a range.
            combinations: (K,) indices of combinations of discrete values.
            step: description of the present step, for the progress.
            states: indices of the rows and columns that are returned; None for all.
        """
        rows = np.hstack([values, self.combinations[combinations]])
        # The number of states of a fleet depends on its longest delay, which is a discrete value. A loop with the
        # largest discrete values is added to each fleet, so that all system matrices have the same size.
        longest = np.hstack([values[:1], self.combinations.max(axis=0, keepdims=True)])
        loops = []
        for first in range(0, len(rows), _MAX_LOOPS):
            loops.append(self._fleet(np.vstack([rows[first : first + _MAX_LOOPS], longest]), states)[:-1])
            self.num_loops += len(loops[-1])
            self._progress(len(loops[-1]), step)
        return np.concatenate(loops)

    def _with_rigid_bodies(self, z: np.ndarray) -> np.ndarray:
        """Return the values (K, k) of the parameters with a range.

        Moments of inertia that no rigid body can have are moved to the nearest possible ones.
        """
        values = self._values(z)
        columns = {each.field: i for i, each in enumerate(self.ranges)}
        moments = [f"vehicle.inertia.{axis}" for axis in range(3)]
        used = [moment for moment in moments if moment in columns]
        if not used:
            return values
        # Each row of z has its own scale. The moments of inertia are moved only within their ranges at this scale.
        sizes = np.abs(z).max(axis=1, keepdims=True) * np.ones_like(z)
        ends = (self._values(-sizes), self._values(sizes))
        fixed = dict(zip(moments, self._fleet.resting.vehicle.inertia, strict=True))
        drawn = [values[:, columns[each]] if each in used else np.full(len(values), fixed[each]) for each in moments]
        low, high = ([end[:, columns[each]] if each in used else fixed[each] for each in moments] for end in ends)
        rigid = nearest_rigid_inertia(drawn, low, high)
        for each in used:
            values[:, columns[each]] = rigid[moments.index(each)]
        return values

    def _check_centre(self, name: str) -> None:
        """Raise InputError if a loop at the centre of the ranges cannot be certified."""
        loops = self._loops(*self.with_all_combinations(self._values(np.zeros((1, len(self.ranges))))), "centre")
        if np.isnan(loops).any():
            raise InputError(f"the loop of {name} has no equilibrium near hover at the centre of the ranges")
        if (np.abs(spectral_radii(loops) - 1.0) <= MIN_DECAY).any():
            raise InputError(
                f"the loop of {name} has poles at 1 in hover, for example those of a learning network's weights, so it"
                " is not asymptotically stable and cannot be certified"
            )

    def _probes(self) -> np.ndarray:
        """Return loops that show which parameters change which entries of the system matrix.

        The shape is (points, combinations, 1 + k, n, n). Along the third axis, the first loop is at a random point, and
        in each of the other k loops, one parameter has another random value. A loop without an equilibrium is replaced
        by the loop at the centre.
        """
        k, count = len(self.ranges), len(self.combinations)
        old, new = self.generator.uniform(-1.0, 1.0, (2, _NUM_PROBES, k))
        z = np.repeat(old[:, np.newaxis], 1 + k, axis=1)
        z[:, range(1, 1 + k), range(k)] = new
        z = np.vstack([np.zeros((1, k)), z.reshape(-1, k)])
        loops = self._loops(*self.with_all_combinations(self._values(z)), "effects")
        loops = loops.reshape(len(z), count, *loops.shape[1:])
        finite = np.isfinite(loops[1:]).all(axis=(2, 3), keepdims=True)
        loops = np.where(finite, loops[1:], loops[0])
        return loops.reshape(_NUM_PROBES, 1 + k, *loops.shape[1:]).transpose(0, 2, 1, 3, 4)

    def _leave_out(self, inactive: np.ndarray) -> None:
        """Leave out the ranges (k,) that have no effect on any loop, such as the range of a quadratic drag at rest."""
        if inactive.all():
            raise InputError("no random parameter acts on the loop in hover, so there is nothing to certify")
        removed = [each for each, left_out in zip(self.ranges, inactive, strict=True) if left_out]
        centres = {each.field: float(each.at(np.zeros(1))[0]) for each in removed}
        hovering = map_leaves(self._fleet.resting, lambda path, value: centres.get(path, value))
        self.left_out = (*self.left_out, *(each.path for each in removed))
        self.ranges = tuple(each for each in self.ranges if each not in removed)
        self._fleet = self._fleet_of(hovering, self._fleet.user_systems)


def is_unstable(radii: np.ndarray) -> np.ndarray:
    """Return a mask that is True for the spectral radii of unstable loops."""
    return radii > 1.0 + MIN_DECAY


def _power(value: np.ndarray, exponent: float) -> np.ndarray:
    return np.log(value) if exponent == 0.0 else value**exponent


def parameters_in_hover(scenario: Scenario) -> tuple[tuple[Range, ...], tuple[Choice, ...], tuple[str, ...]]:
    """Return the random parameters on which hover in still air depends, and the paths of all other distributions."""
    median = median_scenario(scenario)
    ranges: list[Range] = []
    choices: list[Choice] = []
    left_out: list[str] = []
    for path, distribution in distributions_in(scenario).items():
        low, high = _range_of(distribution)
        ends = [_hover_fields(median, path, value) for value in (low, high)]
        fields = [field for field, value in ends[0].items() if field in ends[1] and value != ends[1][field]]
        if len(fields) != 1:
            left_out.append(path)
        elif distribution.values is not None:
            choices.append(Choice(path, fields[0], tuple(sorted(set(distribution.values)))))
        else:
            ranges.append(Range(path, fields[0], low, high, isinstance(distribution, LogUniform)))
    return tuple(ranges), tuple(choices), tuple(left_out)


def _hover_fields(scenario: Scenario, path: str, value: float) -> dict[str, object]:
    """Set a field of a scenario to a value, and return all fields of the resulting scenario in hover, by path."""
    changed = map_leaves(scenario, lambda each, old: value if each == path else old)
    return dict(leaves(symmetric_hover(at_rest(changed))))


def _range_of(distribution: Distribution) -> tuple[float, float]:
    """Return the ends of the range of a distribution at scale 1."""
    low, high = distribution.extremes()
    if low is None or high is None:
        bell = distribution.normal  # type: ignore[attr-defined]  # only normal distributions have no limits
        low = bell.mean - _SIGMA * bell.standard_deviation if low is None else low
        high = bell.mean + _SIGMA * bell.standard_deviation if high is None else high
    return float(low), float(high)
