"""Certificate of stability in hover for all random parameters of a scenario at once.

A distribution has a range: all its values, or three standard deviations about the mean where it has no limits. All
ranges are multiplied by a scale about their centres, and every combination of values within them is a possible loop. A
certificate encloses the scale at which the first of these loops becomes unstable. The lower bound follows from the
structured singular value of a linear fractional model of the loop, and the upper bound from an unstable exact loop.

The vehicle hovers in still air, and parameters that would tilt it, such as wind and an offset of the centre of mass,
are at their medians or zero as in `symmetric_hover`. The certificate names them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import decoupled_loop
from drake_quad.linear.fractional_model import STEPS, fit_fractional_model, fitting_points, spectral_radii
from drake_quad.linear.hover_fleet import HoverFleet
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.distributions import Distribution, LogUniform
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, leaves, map_leaves
from drake_quad.vehicle.rigid_body import nearest_rigid_inertia

MAX_SCALE = 8.0
"""Largest scale at which the search looks for unstable loops."""
_SIGMA = 3.0  # range of a normal distribution without limits, in standard deviations
_MIN_FRACTION = 0.1  # smallest value of a positive quantity, relative to the centre of its range
_MAX_CHOICES = 32  # largest number of combinations of discrete values
_MAX_CORNERS = 64  # largest number of corners of the box in a search
_NUM_CANDIDATES = 48  # loops of a round of the search
_NUM_ROUNDS = 3  # rounds of the search around the most unstable loop
_NUM_BISECTIONS = 7
_MIN_SCALE = 1e-3  # smallest scale of the search
_SHORTER = 0.97  # scale of a round, relative to the smallest unstable scale so far
_MAX_FITS = 6  # number of boxes to which models are fitted
# Size of the first box, relative to the smallest unstable scale, so that all its loops have an equilibrium.
_BELOW = 0.99
_CLOSE = 0.94  # a bound above this fraction of the size of a box needs no model of another box
_MAX_LOOPS = 512  # loops that are computed at the same time
_MIN_DECAY = 1e-7  # smallest distance of a pole from the unit circle that is no rounding error
_MIN_EFFECT = 1e-6  # smallest relative change of a loop by a parameter that acts on it
_MIN_COUPLING = 1e-7  # smallest entry of a system matrix, relative to the largest one of its row
_EXPONENTS = (1.0, 0.0, -0.5, -1.0)  # powers of a value on which a loop may depend linearly; 0 for the logarithm


class Range(NamedTuple):
    """Range of a random parameter.

    Attributes:
        path: path of the field with the distribution.
        field: path of the same field in the scenario in hover.
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
        """Return the values at z, which is -1 and 1 at the ends of the range; positive ranges have positive values."""
        if self.is_logarithmic:
            return np.asarray(math.sqrt(self.low * self.high) * (self.high / self.low) ** (0.5 * z))
        centre = 0.5 * (self.low + self.high)
        values = centre + 0.5 * (self.high - self.low) * z
        return np.maximum(values, min(self.low, _MIN_FRACTION * centre)) if self.low >= 0.0 else values


class Choice(NamedTuple):
    """Random parameter with a few discrete values, all of which belong to the box at any scale."""

    path: str
    field: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Certificate:
    """Bounds of the scale of the ranges at which hover becomes unstable.

    Attributes:
        stable_scale: scale up to which hover is stable for all combinations of parameters; 0 without a bound.
        unstable_scale: smallest scale at which a loop was found that is unstable, or has no equilibrium because rotors
            saturate; infinite if there is none up to `MAX_SCALE`.
        parameters: paths of the parameters with a range that act on the loop.
        choices: paths of the parameters with discrete values.
        left_out: paths of distributions that do not act on hover in still air.
        values: values of all parameters in the unstable loop, by path; empty if there is none.
        frequency: frequency at which the bound is smallest, rad/s; 0 if the whole box of the model is stable.
        model_error: relative error of the scale by the linear fractional model, which the bound contains.
        num_loops: number of exact loops.
    """

    stable_scale: float
    unstable_scale: float
    parameters: tuple[str, ...]
    choices: tuple[str, ...]
    left_out: tuple[str, ...]
    values: dict[str, float]
    frequency: float
    model_error: float
    num_loops: int


def certify_hover(
    scenario: Scenario, *, own: UserSystems = UserSystems(), progress: Callable[[int, str], None] | None = None
) -> Certificate:
    """Return the certificate of a scenario's loop, whose random choices follow from the seed of the scenario.

    Args:
        scenario: scenario with distributions.
        own: functions that create the user's systems for N vehicles.
        progress: function that is called with numbers of loops and a description of the present step.

    Raises:
        InputError: if no distribution acts on hover, or the loop has no linear model or a pole at 1.
    """
    box = _Box(scenario, own, progress or (lambda count, step: None))
    centre = box.radii(*box.everywhere(np.zeros((1, len(box.ranges)))), "centre")
    if np.abs(centre - 1.0).min() < _MIN_DECAY:
        raise InputError(
            f"the loop of {scenario.name} has poles at 1 in hover, as the weights of a network that learns, so it is"
            " not asymptotically stable and cannot be certified"
        )
    if (centre >= 1.0).any():
        return box.certificate(0.0, 0.0, np.zeros(len(box.ranges)), int(np.argmax(centre)))
    unstable_scale, z, combination = _find_unstable(box)
    stable_scale, frequency, error = 0.0, 0.0, 0.0
    size = largest = _BELOW * min(unstable_scale, MAX_SCALE)
    for _ in range(_MAX_FITS):
        found = _bound(box, size)
        if found.scale > stable_scale:
            stable_scale, frequency, error = found
        if found.scale < _CLOSE * size:
            largest = size
        elif size > _CLOSE * largest:
            break
        size = math.sqrt(max(stable_scale, 0.25 * largest) * largest)
    # Exact loops in the certified box check the model once more.
    points = np.vstack([_corners(box), box.generator.uniform(-1.0, 1.0, (_NUM_CANDIDATES, len(box.ranges)))])
    points, combinations = box.everywhere(points)
    radii = box.radii(stable_scale * points, combinations, "check")
    if (radii >= 1.0).any():
        worst = int(np.argmax(radii))
        unstable_scale, z, combination = stable_scale, points[worst] * stable_scale, int(combinations[worst])
        stable_scale = 0.0
    return box.certificate(stable_scale, unstable_scale, z, int(combination), frequency, error)


class _Box:
    """Random parameters of a scenario that act on its loop in hover, and the exact loops at their values."""

    def __init__(self, scenario: Scenario, own: UserSystems, progress: Callable[[int, str], None]) -> None:
        self._progress, self.num_loops = progress, 0
        self.generator = np.random.default_rng(scenario.seed)
        ranges, choices, self.left_out = parameters_in_hover(scenario)
        if not ranges:
            raise InputError(
                f"no distribution with a range in {scenario.name} acts on hover in still air, so there is nothing to"
                " certify; give one, such as vehicle.mass"
            )
        hovering = symmetric_hover(at_rest(median_scenario(scenario)))
        if own == UserSystems():
            decoupled_loop(hovering)  # raises InputError if the loop has no linear model
        self.choices = choices
        self.combinations = np.array([*product(*(choice.values for choice in choices))])
        if len(self.combinations) > _MAX_CHOICES:
            raise InputError(
                f"{scenario.name} has {len(self.combinations)} combinations of discrete values, but at most"
                f" {_MAX_CHOICES} can be certified"
            )
        self.ranges = ranges
        fields = [*(each.field for each in ranges), *(each.field for each in choices)]
        self._fleet = HoverFleet(hovering, fields, own=own)
        self._leave_out_inactive()

    @property
    def period(self) -> float:
        """Sampling period of the loops, s."""
        return self._fleet.period

    def values(self, z: np.ndarray) -> np.ndarray:
        """Return the values (K, k) of the parameters with a range."""
        return np.stack([each.at(column) for each, column in zip(self.ranges, z.T, strict=True)], axis=1)

    def loops(self, values: np.ndarray, combinations: np.ndarray, step: str) -> np.ndarray:
        """Return the system matrices (K, n, n) for values (K, k) of ranges, with combinations (K,) of choices."""
        rows = np.hstack([values, self.combinations[combinations]])
        loops = []
        for first in range(0, len(rows), _MAX_LOOPS):
            loops.append(self._fleet(rows[first : first + _MAX_LOOPS]))
            self.num_loops += len(loops[-1])
            self._progress(len(loops[-1]), step)
        return np.concatenate(loops)

    def all_loops(self, values: np.ndarray, step: str) -> np.ndarray:
        """Return the system matrices (K, combinations, n, n) for values (K, k) and all combinations of choices."""
        count = len(self.combinations)
        indices = np.tile(np.arange(count), len(values))
        loops = self.loops(np.repeat(values, count, axis=0), indices, step)
        return loops.reshape(len(values), count, *loops.shape[1:])

    def radii(self, z: np.ndarray, combinations: np.ndarray, step: str) -> np.ndarray:
        """Return the spectral radii (K,) at scaled parameters (K, k); infinite without an equilibrium.

        Moments of inertia that no rigid body can have are moved to the nearest possible ones in the box.
        """
        return spectral_radii(self.loops(self._with_rigid_bodies(z), combinations, step))

    def everywhere(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return each of the parameters (K, k) with each combination of choices."""
        count = len(self.combinations)
        return np.repeat(z, count, axis=0), np.tile(np.arange(count), len(z))

    def certificate(
        self,
        stable_scale: float,
        unstable_scale: float,
        z: np.ndarray,
        combination: int,
        frequency: float = 0.0,
        error: float = 0.0,
    ) -> Certificate:
        """Return the certificate with these results."""
        values: dict[str, float] = {}
        if math.isfinite(unstable_scale):
            (parameters,) = self._with_rigid_bodies(z[np.newaxis])
            paths = [*(each.path for each in self.ranges), *(each.path for each in self.choices)]
            values = dict(zip(paths, map(float, [*parameters, *self.combinations[combination]]), strict=True))
        return Certificate(
            stable_scale,
            unstable_scale,
            tuple(each.path for each in self.ranges),
            tuple(each.path for each in self.choices),
            self.left_out,
            values,
            frequency / self.period,
            error,
            self.num_loops,
        )

    def _with_rigid_bodies(self, z: np.ndarray) -> np.ndarray:
        """Return the values (K, k) of the parameters with a range, with moments of inertia of rigid bodies."""
        values = self.values(z)
        columns = {each.field: i for i, each in enumerate(self.ranges)}
        moments = [f"vehicle.inertia.{axis}" for axis in range(3)]
        used = [moment for moment in moments if moment in columns]
        if not used:
            return values
        ends = self.values(np.abs(z).max(initial=0.0) * np.array([[-1.0], [1.0]]) * np.ones(len(self.ranges)))
        fixed = dict(zip(moments, self._fleet.resting.vehicle.inertia, strict=True))
        drawn = [values[:, columns[each]] if each in used else np.full(len(values), fixed[each]) for each in moments]
        low, high = ([end[columns[each]] if each in used else fixed[each] for each in moments] for end in ends)
        rigid = nearest_rigid_inertia(drawn, low, high)
        for each in used:
            values[:, columns[each]] = rigid[moments.index(each)]
        return values

    def _leave_out_inactive(self) -> None:
        """Leave out the ranges that have no effect on any loop, such as that of a quadratic drag at rest."""
        k = len(self.ranges)
        loops = self.all_loops(self.values(np.vstack([np.zeros((1, k)), np.eye(k), -np.eye(k)])), "effects")
        sizes = np.abs(loops).max(axis=-1, keepdims=True)
        changes = np.abs(loops[1:] - loops[0]) > _MIN_EFFECT * (sizes[0] + sizes[1:])
        changes |= ~np.isfinite(loops[1:])
        acts = changes.any(axis=(1, 2, 3)).reshape(2, k).any(axis=0)
        inactive = [each for each, active in zip(self.ranges, acts, strict=True) if not active]
        if len(inactive) == k:
            raise InputError("no random parameter acts on the loop in hover, so there is nothing to certify")
        centres = {each.field: float(each.at(np.zeros(1))[0]) for each in inactive}
        hovering = map_leaves(self._fleet.resting, lambda path, value: centres.get(path, value))
        self.left_out = (*self.left_out, *(each.path for each in inactive))
        self.ranges = tuple(each for each in self.ranges if each not in inactive)
        fields = [*(each.field for each in self.ranges), *(each.field for each in self.choices)]
        self._fleet = HoverFleet(hovering, fields, own=self._fleet.own)


def parameters_in_hover(scenario: Scenario) -> tuple[tuple[Range, ...], tuple[Choice, ...], tuple[str, ...]]:
    """Return the random parameters that hover in still air contains, and the paths of all other distributions."""
    median = median_scenario(scenario)
    ranges: list[Range] = []
    choices: list[Choice] = []
    left_out: list[str] = []
    for path, distribution in distributions_in(scenario).items():
        low, high = _range_of(distribution)
        ends = [_hover_leaves(median, path, value) for value in (low, high)]
        fields = [field for field, value in ends[0].items() if field in ends[1] and value != ends[1][field]]
        if len(fields) != 1:
            left_out.append(path)
        elif distribution.values is not None:
            choices.append(Choice(path, fields[0], tuple(sorted(set(distribution.values)))))
        else:
            ranges.append(Range(path, fields[0], low, high, isinstance(distribution, LogUniform)))
    return tuple(ranges), tuple(choices), tuple(left_out)


def _hover_leaves(scenario: Scenario, path: str, value: float) -> dict[str, object]:
    """Return the leaves of a scenario in hover, with another value of a field."""
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


def _corners(box: _Box) -> np.ndarray:
    """Return corners (K, k) of the box: all, or some if there are too many."""
    k = len(box.ranges)
    if 2**k <= _MAX_CORNERS:
        return np.array([*product((-1.0, 1.0), repeat=k)])
    return box.generator.choice([-1.0, 1.0], size=(_MAX_CORNERS, k))


def _find_unstable(box: _Box) -> tuple[float, np.ndarray, int]:
    """Return the smallest scale at which an unstable loop is found, with its parameters and its combination.

    The search begins at the corners of the box. Random changes of the direction of the most unstable corner, which may
    lead to the inside of the box, then refine it.
    """
    (directions, combinations), scale = box.everywhere(_corners(box)), 1.0
    radii = box.radii(scale * directions, combinations, "search")
    while not (radii >= 1.0).any() and scale < MAX_SCALE:
        scale = min(2.0 * scale, MAX_SCALE)
        radii = box.radii(scale * directions, combinations, "search")
    if not (radii >= 1.0).any():
        return math.inf, np.zeros(len(box.ranges)), 0
    high, unstable, stable = scale, radii, 0.5 * scale if scale > 1.0 else 0.0
    while scale <= 1.0 and (radii >= 1.0).any() and scale > _MIN_SCALE:
        high, unstable = scale, radii
        scale *= 0.5
        radii = box.radii(scale * directions, combinations, "search")
        stable = scale
    scale, direction, combination = _bisect(box, directions, combinations, unstable, stable, high)
    spread = 0.5
    for _ in range(_NUM_ROUNDS):
        changed = direction + spread * box.generator.standard_normal((_NUM_CANDIDATES, len(direction)))
        changed = np.clip(changed, -1.0, 1.0)
        same = np.full(len(changed), combination)
        radii = box.radii(_SHORTER * scale * changed, same, "search")
        if (radii >= 1.0).any():
            scale, direction, _ = _bisect(box, changed, same, radii, 0.8 * scale, _SHORTER * scale)
        else:
            spread *= 0.5
    return scale, scale * direction, combination


def _bisect(
    box: _Box, directions: np.ndarray, combinations: np.ndarray, radii: np.ndarray, stable: float, unstable: float
) -> tuple[float, np.ndarray, int]:
    """Return the smallest scale at which a direction is unstable, with the direction and its combination.

    Args:
        box: random parameters.
        directions: (K, k) directions.
        combinations: (K,) combinations of choices.
        radii: (K,) spectral radii at the scale `unstable`.
        stable: scale at which all directions are taken to be stable.
        unstable: scale at which some are unstable.
    """
    order = np.argsort(-radii)
    candidates = order[radii[order] >= 1.0][:_NUM_CANDIDATES]
    best = candidates[0]
    for _ in range(_NUM_BISECTIONS):
        middle = 0.5 * (stable + unstable)
        radii = box.radii(middle * directions[candidates], combinations[candidates], "search")
        if (radii >= 1.0).any():
            best, unstable = candidates[int(np.argmax(radii))], middle
            candidates = candidates[radii >= 1.0]
        else:
            stable = middle
    return unstable, directions[best], int(combinations[best])


class _Bound(NamedTuple):
    """Scale up to which all loops are stable, the critical frequency (rad per sample), and the error of the model."""

    scale: float
    frequency: float
    error: float


def _bound(box: _Box, size: float) -> _Bound:
    """Return the bound that follows from a linear fractional model of the loops in a box of given size (scale)."""
    k = len(box.ranges)
    exponents = _best_exponents(box, size)
    points = fitting_points(k, box.generator)
    loops = box.all_loops(_warped_values(box, size, points, exponents), "model")
    if not np.isfinite(loops).all() or not (spectral_radii(loops[0]) < 1.0).all():
        return _Bound(0.0, 0.0, math.inf)
    # Eigenvalues of a loop are those of its strongly coupled groups of states.
    largest = np.abs(loops).max(axis=-1, keepdims=True)
    couples = (np.abs(loops) > _MIN_COUPLING * largest).any(axis=(0, 1))
    _, groups = scipy.sparse.csgraph.connected_components(couples, connection="strong")
    cases = []
    for group in range(groups.max() + 1):
        states = np.flatnonzero(groups == group)
        for combination in range(loops.shape[1]):
            part = loops[:, combination][:, states][:, :, states]
            cases.append((float(spectral_radii(part).max()), combination, part))
    # The model is fitted to loops in the box, so no bound below 1 is needed.
    level, frequency, worst_error = 1.0, 0.0, 0.0
    for _, _, part in sorted(cases, key=lambda case: -case[0]):
        if np.ptp(part, axis=0).max() < _MIN_EFFECT * np.abs(part).max():
            continue  # this group does not depend on the parameters
        model = fit_fractional_model(points, part)
        error = model.scale_error(points, part)
        if not math.isfinite(error):
            return _Bound(0.0, 0.0, error)
        try:
            found = model.bound(stop=level / (1.0 + error))
        except ArithmeticError:
            return _Bound(0.0, 0.0, error)
        if found.value * (1.0 + error) > level:
            level, frequency, worst_error = found.value * (1.0 + error), found.frequency, error
    return _Bound(_unwarped_scale(box, size, 1.0 / level, exponents), frequency, worst_error)


def _best_exponents(box: _Box, size: float) -> list[float]:
    """Return the exponent of each parameter for which the loop depends on the power of the value most linearly."""
    k = len(box.ranges)
    steps = np.array([0.0, *STEPS])
    points = np.zeros((k, len(steps), k))
    points[range(k), :, range(k)] = size * steps
    values = box.values(points.reshape(-1, k)).reshape(points.shape)
    loops = box.all_loops(values.reshape(-1, k), "model")
    loops = loops.reshape(k, len(steps), *loops.shape[1:])
    size_of_row = np.abs(loops[0, 0]).max(axis=-1, keepdims=True)
    flat = (loops / np.where(size_of_row > 0.0, size_of_row, 1.0)).reshape(k, len(steps), -1)
    exponents = []
    for i in range(k):
        allowed = _EXPONENTS if values[i, :, i].min() > 0.0 else _EXPONENTS[:1]
        errors = []
        for exponent in allowed:
            line = np.vander(_power(values[i, :, i], exponent), 2)
            line = line / np.abs(line).max(axis=0)
            errors.append(np.linalg.norm(flat[i] - line @ (np.linalg.pinv(line) @ flat[i])))
        exponents.append(allowed[int(np.argmin(errors))])
    return exponents


def _power(value: np.ndarray, exponent: float) -> np.ndarray:
    return np.log(value) if exponent == 0.0 else value**exponent


def _ends(box: _Box, size: float, exponents: list[float]) -> np.ndarray:
    """Return the powers (2, k) of the values at both ends of the ranges at a scale."""
    ends = box.values(size * np.array([[-1.0], [1.0]]) * np.ones(len(box.ranges)))
    return np.stack([_power(column, exponent) for column, exponent in zip(ends.T, exponents, strict=True)], axis=1)


def _warped_values(box: _Box, size: float, points: np.ndarray, exponents: list[float]) -> np.ndarray:
    """Return the values (K, k) at points between -1 and 1 in the coordinates of the powers."""
    low, high = _ends(box, size, exponents)
    powers = 0.5 * (low + high) + 0.5 * (high - low) * points
    columns = [np.exp(p) if exponent == 0.0 else p ** (1.0 / exponent) for p, exponent in zip(powers.T, exponents)]
    return np.stack(columns, axis=1)


def _unwarped_scale(box: _Box, size: float, fraction: float, exponents: list[float]) -> float:
    """Return the largest scale whose box is in a fraction of the box of the powers."""
    low, high = _ends(box, size, exponents)
    stable, unstable = 0.0, size
    for _ in range(40):
        middle = 0.5 * (stable + unstable)
        inner = (_ends(box, middle, exponents) - 0.5 * (low + high)) / (0.5 * (high - low))
        stable, unstable = (middle, unstable) if (np.abs(inner) <= fraction).all() else (stable, middle)
    return stable
