"""Correlated distributions: normal variables that fields of a scenario share.

A field with a normal distribution and `shared: {a: 0.6, b: -0.3}` is drawn from

    z = 0.6 u_a - 0.3 u_b + √(1 - 0.6² - 0.3²) u,

where u_a and u_b are drawn once a sample for all fields that name them, and u is its own, all standard normal. Its
value is the quantile of Φ(z): so each field has the distribution that is written, limits and all, and two fields are
joined by a Gaussian copula whose correlation is the sum of the products of what they share.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, shown
from drake_quad.randomness.streams import Seeds, parameter_numbers
from drake_quad.scenario.distributions import Distribution, Normal

# Smallest probability of a drawn number: half the distance between uniform numbers.
_NEVER = 2.0**-53
# Smaller correlations are not reported.
_LEAST = 1e-3
# Weights of shared variables below the first number are left out, and others have so many decimals. The next is tried
# where that is too coarse, as where a sum of strongly correlated fields is known much better than any of them.
_FINER = ((1e-3, 4), (1e-4, 6), (1e-6, 8), (0.0, 12))
# Relative tolerance of the variance of a sum of fields, and the variance, relative to their own, that counts as none.
_TOLERANCE, _FLOOR = 0.02, 1e-9
# An eigenvalue of a measured correlation matrix may be negative by this much, because of rounding.
_ROUNDING = 1e-6


def shared_names(distributions: Iterable[Distribution]) -> list[str]:
    """Return the normal variables that some of the distributions share, as one comes upon them."""
    return list(dict.fromkeys(name for each in distributions for name in each.correlations))


def drawn_values(
    seed: Seeds, samples: Sequence[int], distributions: Mapping[str, Distribution]
) -> dict[str, np.ndarray]:
    """Draw samples of distributions: (N,) numbers by the name of the stream.

    Args:
        seed: of all samples, or of each.
        samples: N numbers of samples.
        distributions: by the name of the stream of each one's own numbers.
    """
    common = {
        name: _standard_normal(seed, samples, shared_stream(name)) for name in shared_names(distributions.values())
    }

    def probability(stream: str, weights: Mapping[str, float]) -> np.ndarray:
        if not weights:
            return parameter_numbers(seed, samples, stream)
        own = math.sqrt(max(0.0, 1.0 - math.fsum(weight * weight for weight in weights.values())))
        total = own * _standard_normal(seed, samples, stream)
        for name, weight in weights.items():
            total = total + weight * common[name]
        # A sum of many may be farther out than a uniform number can be, which is never 0 or 1.
        return np.clip(scipy.special.ndtr(total), _NEVER, 1.0 - _NEVER)

    return {
        stream: np.asarray(each.quantile(probability(stream, each.correlations)))
        for stream, each in distributions.items()
    }


def shared_stream(name: str) -> str:
    """Return the name of a shared variable's stream, which no field has, since paths contain no spaces."""
    return f"shared {name}"


def _standard_normal(seed: Seeds, samples: Sequence[int], stream: str) -> np.ndarray:
    return scipy.special.ndtri(parameter_numbers(seed, samples, stream))


def correlation_matrix(distributions: Sequence[Distribution]) -> np.ndarray:
    """Return the (n, n) correlations of distributions, in their standard normal form.

    Limits that cut off much make correlations of the values a little smaller.
    """
    names = shared_names(distributions)
    rows = [[each.correlations.get(name, 0.0) for name in names] for each in distributions]
    weights = np.reshape(rows, (len(distributions), len(names)))
    found = weights @ weights.T
    np.fill_diagonal(found, 1.0)
    return found


class CorrelatedPair(NamedTuple):
    """Two fields that are not drawn independently.

    Attributes:
        first: path of one field.
        second: path of the other.
        correlation: of the two in their standard normal form.
    """

    first: str
    second: str
    correlation: float


def correlated_pairs(distributions: Mapping[str, Distribution]) -> list[CorrelatedPair]:
    """Return the pairs of correlated fields, the strongest correlation first.

    Args:
        distributions: distributions by the path of their field, as from `distributions_in`.
    """
    chosen = {path: each for path, each in distributions.items() if each.correlations}
    paths, matrix = list(chosen), correlation_matrix(list(chosen.values()))
    pairs = [
        CorrelatedPair(paths[i], paths[j], float(matrix[i, j]))
        for i in range(len(paths))
        for j in range(i + 1, len(paths))
        if abs(matrix[i, j]) >= _LEAST
    ]
    return sorted(pairs, key=lambda pair: -abs(pair.correlation))


def correlated_groups(distributions: Mapping[str, Distribution]) -> dict[str, tuple[str, ...]]:
    """Return the fields that each is correlated with, itself among them, directly or through others; none that is not.

    Args:
        distributions: by the path of their field, as of `distributions_in`.
    """
    paths = [path for path, each in distributions.items() if each.correlations]
    related = np.abs(correlation_matrix([distributions[path] for path in paths])) >= _LEAST
    _, groups = scipy.sparse.csgraph.connected_components(related, directed=False)
    members = {group: tuple(np.array(paths)[groups == group].tolist()) for group in set(groups.tolist())}
    return {path: members[group] for path, group in zip(paths, groups.tolist(), strict=True) if len(members[group]) > 1}


class JointNormal(NamedTuple):
    """Means and covariance of normal distributions, before limits cut anything off.

    Attributes:
        paths: of their n fields.
        mean: (n,).
        covariance: (n, n).
    """

    paths: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray


def joint_normal(distributions: Mapping[str, Distribution]) -> JointNormal:
    """Means and covariance of all fields whose distribution is normal, as of `distributions_in`."""
    normal = {path: each for path, each in distributions.items() if isinstance(each, Normal)}
    mean = np.array([each.normal.mean for each in normal.values()])
    deviation = np.array([each.normal.standard_deviation for each in normal.values()])
    correlation = correlation_matrix(list(normal.values()))
    return JointNormal(tuple(normal), mean, correlation * np.outer(deviation, deviation))


def correlated_normals(
    names: Sequence[str], mean: np.ndarray, covariance: np.ndarray, *, prefix: str = "common"
) -> dict[str, dict[str, Any]]:
    """Write a covariance in the scenario language: a distribution for each name.

    What is correlated, directly or through others, is split into shared variables by the eigenvectors V of its
    correlations V Λ Vᵀ: with the least eigenvalue λ, the columns of V √(Λ - λ) are what each variable does to each
    name, and the rest of each name's variance is its own. Where Cholesky's factors are fewer, it is these. Variables
    and decimals that do not matter are left out: standard deviations are exactly those given, and that of any sum of
    the numbers is right to a per cent.

    Args:
        names: n of them, such as paths of fields.
        mean: (n,) of the normal distributions.
        covariance: (n, n), symmetric and positive semidefinite, with a positive diagonal.
        prefix: of the names of the shared variables, which are `prefix_1`, `prefix_2` and so on.

    Returns:
        By name what stands in YAML, `normal` with `mean`, `standard_deviation` and `shared`; without `shared` for what
        is correlated with nothing.

    Raises:
        InputError: shapes do not fit, a number is not finite, a variance is not positive, or it is no covariance.
    """
    mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    deviation = checked_deviations(names, mean, covariance)
    correlation = covariance / np.outer(deviation, deviation)
    if len(names) and np.linalg.eigvalsh(correlation)[0] < -_ROUNDING * len(names):
        raise InputError("the covariance is not positive semidefinite, so that no numbers can have it")
    weights = _weights(correlation)
    result: dict[str, dict[str, Any]] = {}
    for name, centre, spread, row in zip(names, mean, deviation, weights, strict=True):
        shared = {f"{prefix}_{k + 1}": float(weight) for k, weight in enumerate(row) if weight != 0.0}
        bell: dict[str, Any] = {"mean": float(centre), "standard_deviation": float(spread)}
        result[name] = {"normal": {**bell, "shared": shared} if shared else bell}
    return result


def checked_deviations(names: Sequence[str], mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the (n,) standard deviations of a covariance that fits names and means.

    Args:
        names: n of them.
        mean: (n,).
        covariance: (n, n).

    Raises:
        InputError: shapes do not fit, a number is not finite, a variance is not positive, or it is not symmetric.
    """
    count = len(names)
    if mean.shape != (count,) or covariance.shape != (count, count):
        raise InputError(
            f"{count} names need ({count},) means and a ({count}, {count}) covariance, not {mean.shape} and"
            f" {covariance.shape}"
        )
    variance = np.diag(covariance)
    for name, centre, each in zip(names, mean, variance, strict=True):
        if not (np.isfinite(centre) and np.isfinite(each) and each > 0.0):
            raise InputError(
                f"{shown(name)} has mean {centre:g} and variance {each:g}, which must be finite, and above 0"
            )
    deviation: np.ndarray = np.sqrt(variance)
    scale = np.outer(deviation, deviation)
    if not np.all(np.abs(covariance - covariance.T) <= _ROUNDING * scale):
        raise InputError("the covariance is not symmetric")
    return deviation


def _weights(correlation: np.ndarray) -> np.ndarray:
    """(n, k) correlations of each name with each of k shared variables, in as few decimals as do."""
    for least, decimals in _FINER:
        weights = _grouped(correlation, least, decimals)
        if _agrees(weights, correlation):
            break
    return weights


def _grouped(correlation: np.ndarray, least: float, decimals: int) -> np.ndarray:
    """Return weights without correlations and weights below `least`; each group has its own shared variables."""
    count = len(correlation)
    _, groups = scipy.sparse.csgraph.connected_components(np.abs(correlation) > least, directed=False)
    columns = [np.zeros((count, 0))]
    for group in range(groups.max(initial=-1) + 1):
        members = np.flatnonzero(groups == group)
        part = correlation[np.ix_(members, members)]
        found = [_shortened(factors, part, least, decimals) for factors in (_factors(part), _triangle(part))]
        # The fewest numbers of those that agree.
        kept = min(found, key=lambda each: (not _agrees(each, part), np.count_nonzero(each)))
        columns.append(np.zeros((count, kept.shape[1])))
        columns[-1][members] = kept
    return np.hstack(columns)


def _shortened(factors: np.ndarray, correlation: np.ndarray, least: float, decimals: int) -> np.ndarray:
    """Factors in so many decimals: the first of them that are enough, and of these all that several names share."""
    # Towards 0, so that the squares of a row never sum to more than they did.
    rounded = np.trunc(factors * 10.0**decimals) / 10.0**decimals
    rounded = np.where(np.abs(rounded) < least, 0.0, rounded)
    enough = (k for k in range(len(correlation)) if _agrees(rounded[:, :k], correlation))
    kept = rounded[:, : next(enough, len(correlation))]
    return kept[:, np.count_nonzero(kept, axis=0) > 1]


def _triangle(correlation: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor (n, n): column i has the shares of the variable that name i introduces."""
    try:
        factors: np.ndarray = np.linalg.cholesky(correlation + _FLOOR * np.eye(len(correlation)))
    except np.linalg.LinAlgError:
        return _factors(correlation)
    return factors / np.linalg.norm(factors, axis=1, keepdims=True)


def _factors(correlation: np.ndarray) -> np.ndarray:
    """Return the (n, n) factors V √(Λ - λ), those that do most first."""
    size, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    factors: np.ndarray = vectors[:, ::-1] * np.sqrt(np.maximum(size[::-1] - max(size[0], 0.0), 0.0))
    # Eigenvectors have either sign; here their largest number is positive.
    signs = np.sign(factors[np.argmax(np.abs(factors), axis=0), np.arange(len(size))])
    return factors * np.where(signs == 0.0, 1.0, signs)


def _agrees(weights: np.ndarray, correlation: np.ndarray) -> bool:
    """True if the standard deviation of any sum of the numbers is right to a per cent, or is next to nothing."""
    found = weights @ weights.T
    np.fill_diagonal(found, 1.0)
    floor = correlation + _FLOOR * np.eye(len(correlation))
    return bool(np.all(np.abs(scipy.linalg.eigh(found - correlation, floor, eigvals_only=True)) < _TOLERANCE))
