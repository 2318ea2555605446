"""Correlated distributions: fields of a scenario that share standard normal variables.

A field with a normal distribution and `shared: {a: 0.6, b: -0.3}` is drawn from

    z = 0.6 u_a - 0.3 u_b + √(1 - 0.6² - 0.3²) u.

All variables are standard normal. In each sample, u_a and u_b are drawn once for all fields that name them, and u is
drawn only for this field. The value of the field is the quantile of its distribution at the probability Φ(z). Each
field therefore has exactly the distribution that the scenario gives it, including limits. The joint distribution of two
fields is a Gaussian copula. To compute its correlation, multiply the two coefficients of each shared variable, and add
the products.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, short_repr
from drake_quad.randomness.streams import Seeds, parameter_numbers
from drake_quad.scenario.distributions import Distribution

MIN_PROBABILITY = 2.0**-53
"""Probabilities are clipped to [p, 1 - p] with this p, which is half the distance between adjacent uniform numbers."""
# Magnitude below which a correlation counts as zero.
_MIN_CORRELATION = 1e-3
# Accuracy levels for the weights of shared variables: the smallest weight that is not omitted, and the number of
# decimals. The first level that reproduces the covariance is used. A coarse level fails, for example, if a sum of
# strongly correlated fields has a much smaller variance than the fields themselves.
_ACCURACY_LEVELS = ((1e-3, 4), (1e-4, 6), (1e-6, 8), (0.0, 12))
# Relative tolerance on the variance of any weighted sum of fields.
_VARIANCE_TOLERANCE = 0.02
# Variance of a weighted sum, relative to the variances of the fields, below which it counts as zero.
_MIN_VARIANCE = 1e-9
# Tolerance for rounding errors in the symmetry and the eigenvalues of a given covariance matrix.
_MATRIX_TOLERANCE = 1e-6


def shared_names(distributions: Iterable[Distribution]) -> list[str]:
    """Return the names of the shared variables of distributions, in the order of their first use."""
    return list(dict.fromkeys(name for each in distributions for name in each.correlations))


def drawn_values(
    seed: Seeds, samples: Sequence[int], distributions: Mapping[str, Distribution]
) -> dict[str, np.ndarray]:
    """Draw samples of distributions.

    Args:
        seed: seed of all samples, or N seeds.
        samples: (N,) indices of the samples.
        distributions: distributions by the name of their stream of random numbers.

    Returns:
        (N,) drawn numbers by the name of the stream.
    """
    return values_at(distributions, lambda stream: parameter_numbers(seed, samples, stream))


def values_at(distributions: Mapping[str, Distribution], uniform: Callable[[str], np.ndarray]) -> dict[str, np.ndarray]:
    """Return values of distributions, given uniform numbers.

    Args:
        distributions: distributions by the name of their stream of random numbers.
        uniform: function that returns the (N,) uniform numbers in (0, 1) of a stream, given its name. Each shared
            variable also has a stream; see `shared_stream`.

    Returns:
        (N,) values by the name of the stream.
    """
    common = {name: scipy.special.ndtri(uniform(shared_stream(name))) for name in shared_names(distributions.values())}

    def probability(stream: str, weights: Mapping[str, float]) -> np.ndarray:
        if not weights:
            return uniform(stream)
        independent_weight = math.sqrt(max(0.0, 1.0 - math.fsum(weight * weight for weight in weights.values())))
        total = independent_weight * scipy.special.ndtri(uniform(stream))
        for name, weight in weights.items():
            total = total + weight * common[name]
        # Φ of a weighted sum can round to 0 or 1, at which quantiles are infinite.
        return np.clip(scipy.special.ndtr(total), MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)

    return {
        stream: np.asarray(each.quantile(probability(stream, each.correlations)))
        for stream, each in distributions.items()
    }


def shared_stream(name: str) -> str:
    """Return the stream name of a shared variable. It contains a space, so it differs from all paths."""
    return f"shared {name}"


def correlation_matrix(distributions: Sequence[Distribution]) -> np.ndarray:
    """Return the (n, n) correlation matrix of the standard normal variables behind n distributions.

    The drawn values are correlated slightly less if limits truncate much of a distribution.
    """
    names = shared_names(distributions)
    rows = [[each.correlations.get(name, 0.0) for name in names] for each in distributions]
    weights = np.reshape(rows, (len(distributions), len(names)))
    matrix = weights @ weights.T
    np.fill_diagonal(matrix, 1.0)
    return matrix


class CorrelatedPair(NamedTuple):
    """Two correlated fields.

    Attributes:
        first: path of one field.
        second: path of the other field.
        correlation: correlation of the standard normal variables behind the two fields.
    """

    first: str
    second: str
    correlation: float


def correlated_pairs(distributions: Mapping[str, Distribution]) -> list[CorrelatedPair]:
    """Return the pairs of correlated fields, sorted from the strongest to the weakest correlation.

    Args:
        distributions: distributions by the path of their field, as from `distributions_in`.
    """
    chosen = {path: each for path, each in distributions.items() if each.correlations}
    paths, matrix = list(chosen), correlation_matrix(list(chosen.values()))
    pairs = [
        CorrelatedPair(paths[i], paths[j], float(matrix[i, j]))
        for i in range(len(paths))
        for j in range(i + 1, len(paths))
        if abs(matrix[i, j]) >= _MIN_CORRELATION
    ]
    return sorted(pairs, key=lambda pair: -abs(pair.correlation))


def correlated_groups(distributions: Mapping[str, Distribution]) -> dict[str, tuple[str, ...]]:
    """Return the group of each correlated field, by the path of the field.

    A group contains all fields that are correlated directly or through other fields. Fields without any correlation are
    omitted.

    Args:
        distributions: distributions by the path of their field, as from `distributions_in`.
    """
    paths = [path for path, each in distributions.items() if each.correlations]
    related = np.abs(correlation_matrix([distributions[path] for path in paths])) >= _MIN_CORRELATION
    _, groups = scipy.sparse.csgraph.connected_components(related, directed=False)
    members = {group: tuple(np.array(paths)[groups == group].tolist()) for group in set(groups.tolist())}
    return {path: members[group] for path, group in zip(paths, groups.tolist(), strict=True) if len(members[group]) > 1}


def correlated_normals(
    names: Sequence[str], mean: np.ndarray, covariance: np.ndarray, *, prefix: str = "common"
) -> dict[str, dict[str, Any]]:
    """Express a covariance matrix in the scenario language, as a normal distribution for each named quantity.

    Quantities that are correlated, directly or through others, form a group with shared variables. If V Λ Vᵀ is the
    correlation matrix of a group and λ its smallest eigenvalue, the weights of the shared variables are V √(Λ - λ). The
    remaining variance of each quantity is independent. The Cholesky factor is used instead if it has fewer nonzero
    weights.

    Negligible variables and decimals are omitted. The standard deviations of the quantities are exactly the given ones,
    and the standard deviation of any weighted sum is correct to one per cent unless it is almost zero.

    Args:
        names: names of the n quantities, such as paths of fields.
        mean: (n,) means.
        covariance: (n, n) covariance matrix, symmetric and positive semidefinite, with a positive diagonal.
        prefix: prefix of the names of the shared variables, `prefix_1`, `prefix_2` and so on.

    Returns:
        The YAML value of each quantity: `normal` with `mean`, `standard_deviation` and, if it is correlated, `shared`.

    Raises:
        InputError: if the shapes do not match, a number is not finite, a variance is not positive, or the matrix is
            not symmetric and positive semidefinite.
    """
    mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    deviation = checked_deviations(names, mean, covariance)
    correlation = covariance / np.outer(deviation, deviation)
    if len(names) and np.linalg.eigvalsh(correlation)[0] < -_MATRIX_TOLERANCE * len(names):
        raise InputError(
            "the covariance matrix is not positive semidefinite, so it cannot be the covariance of random numbers"
        )
    weights = _weights(correlation)
    result: dict[str, dict[str, Any]] = {}
    for name, centre, spread, row in zip(names, mean, deviation, weights, strict=True):
        shared = {f"{prefix}_{k + 1}": float(weight) for k, weight in enumerate(row) if weight != 0.0}
        normal: dict[str, Any] = {"mean": float(centre), "standard_deviation": float(spread)}
        result[name] = {"normal": {**normal, "shared": shared} if shared else normal}
    return result


def checked_deviations(names: Sequence[str], mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Check means and a covariance matrix, and return the (n,) standard deviations.

    Args:
        names: names of the n quantities.
        mean: (n,) means.
        covariance: (n, n) covariance matrix.

    Raises:
        InputError: if the shapes do not match, a number is not finite, a variance is not positive, or the matrix is
            not symmetric.
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
                f"{short_repr(name)} has mean {centre:g} and variance {each:g}; both must be finite, and the variance"
                " positive"
            )
    deviation: np.ndarray = np.sqrt(variance)
    scale = np.outer(deviation, deviation)
    if not np.all(np.abs(covariance - covariance.T) <= _MATRIX_TOLERANCE * scale):
        raise InputError("the covariance matrix is not symmetric")
    return deviation


def _weights(correlation: np.ndarray) -> np.ndarray:
    """Return the (n, k) weights of k shared variables, rounded as coarsely as the tolerances allow."""
    for min_weight, decimals in _ACCURACY_LEVELS:
        weights = _grouped_weights(correlation, min_weight, decimals)
        if _agrees(weights, correlation):
            break
    return weights


def _grouped_weights(correlation: np.ndarray, min_weight: float, decimals: int) -> np.ndarray:
    """Return the (n, k) weights, with separate shared variables for each group of correlated quantities.

    Args:
        correlation: (n, n) correlation matrix.
        min_weight: threshold for correlations and weights. Two quantities with a larger correlation belong to the same
            group. Smaller weights are replaced by 0.
        decimals: number of decimals of the weights.
    """
    count = len(correlation)
    _, groups = scipy.sparse.csgraph.connected_components(np.abs(correlation) > min_weight, directed=False)
    columns = [np.zeros((count, 0))]
    for group in range(groups.max(initial=-1) + 1):
        members = np.flatnonzero(groups == group)
        part = correlation[np.ix_(members, members)]
        candidates = [
            _rounded_factors(factors, part, min_weight, decimals)
            for factors in (_eigenvalue_factors(part), _cholesky_factor(part))
        ]
        # Prefer accurate weights, and among these the weights with the fewest nonzero numbers.
        kept = min(candidates, key=lambda each: (not _agrees(each, part), np.count_nonzero(each)))
        columns.append(np.zeros((count, kept.shape[1])))
        columns[-1][members] = kept
    return np.hstack(columns)


def _rounded_factors(factors: np.ndarray, correlation: np.ndarray, min_weight: float, decimals: int) -> np.ndarray:
    """Round factors, and drop unnecessary columns.

    A column is unnecessary if the factors are accurate enough without it, or if it has only one nonzero factor.
    """
    # Numbers are rounded towards 0, so that the sum of the squares of a row does not increase.
    rounded = np.trunc(factors * 10.0**decimals) / 10.0**decimals
    rounded = np.where(np.abs(rounded) < min_weight, 0.0, rounded)
    sufficient = (k for k in range(len(correlation)) if _agrees(rounded[:, :k], correlation))
    kept = rounded[:, : next(sufficient, len(correlation))]
    return kept[:, np.count_nonzero(kept, axis=0) > 1]


def _cholesky_factor(correlation: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor (n, n), scaled so that the rows have unit length."""
    try:
        factors: np.ndarray = np.linalg.cholesky(correlation + _MIN_VARIANCE * np.eye(len(correlation)))
    except np.linalg.LinAlgError:
        return _eigenvalue_factors(correlation)
    return factors / np.linalg.norm(factors, axis=1, keepdims=True)


def _eigenvalue_factors(correlation: np.ndarray) -> np.ndarray:
    """Return the (n, n) factors V √(Λ - λ) for eigenvectors V, eigenvalues Λ and the smallest eigenvalue λ."""
    eigenvalues, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    factors: np.ndarray = vectors[:, ::-1] * np.sqrt(np.maximum(eigenvalues[::-1] - max(eigenvalues[0], 0.0), 0.0))
    # The sign of an eigenvector is arbitrary, so its entry with the largest magnitude is made positive.
    signs = np.sign(factors[np.argmax(np.abs(factors), axis=0), np.arange(len(eigenvalues))])
    return factors * np.where(signs == 0.0, 1.0, signs)


def _agrees(weights: np.ndarray, correlation: np.ndarray) -> bool:
    """Return whether the weights (n, k) of the shared variables reproduce a correlation matrix (n, n).

    The correlation matrix that follows from the weights is accepted if every linear combination of the quantities has
    the same variance with both matrices. The relative tolerance is `_VARIANCE_TOLERANCE`. For combinations with almost
    no variance, `_MIN_VARIANCE` is added to the reference.
    """
    achieved = weights @ weights.T
    np.fill_diagonal(achieved, 1.0)
    scale = correlation + _MIN_VARIANCE * np.eye(len(correlation))
    errors = scipy.linalg.eigh(achieved - correlation, scale, eigvals_only=True)
    return bool(np.all(np.abs(errors) < _VARIANCE_TOLERANCE))
