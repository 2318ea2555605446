"""Covariance of an error-state Kalman filter: propagation, and correction by one scalar measurement at a time.

Over a time Δt, the errors (`drake_quad.estimation.estimate`) change according to

    δp⁺ = δp + Δt δv
    δv⁺ = δv - [Δv]× δθ - S δb_a + noise
    δθ⁺ = δθ - S δb_g + noise
    δb⁺ = δb + noise

where Δv is the integral of the specific force in W, and S is the integral of R_WB. The noise of both sensors is equal
on all axes, so it remains a multiple of the identity matrix after a rotation. The transition matrix F = 1 + N contains
only 27 elements other than zeros and ones. F P Fᵀ is computed block by block with 420 multiplications, whereas two
products of dense matrices would need 6750. The rows are updated in the order p, v, θ, since each of them depends only
on rows that are updated later.

A scalar measurement y = h(x) + n with the derivatives H and the variance r subtracts a matrix of rank 1:

    c = P Hᵀ,   s = H c + r,   P⁺ = P - c cᵀ / s

P⁺ is symmetric, since only its upper triangle is stored. Joseph's form is more accurate but needs three times as many
multiplications. The correction multiplies the variance H P Hᵀ by r / s, which is computed as a difference of two nearly
equal numbers if H P Hᵀ / r is large. Joseph's form is needed only if this ratio approaches the inverse of the rounding
error, 10¹⁶. The standard deviations of the initial estimate limit the ratio to much smaller values.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple

from drake_quad.estimation.estimate import ErrorState, InertialIncrement
from drake_quad.framework.elementary import sqrt, total, where
from drake_quad.geometry.axes import TINY, BodyAxes, Vector
from drake_quad.signals import EstimateDeviation, Number, Quantity, Row

_NUM_ERRORS = len(EstimateDeviation._fields)


class _Blocks(NamedTuple):
    """Indices of the errors in a row of the covariance, in the order of `ErrorState`."""

    position: range
    velocity: range
    rotation: range
    gyroscope_bias: range
    accelerometer_bias: range


_INDICES = _Blocks._make(range(i, i + 3) for i in range(0, _NUM_ERRORS, 3))  # indices of each block in the error vector


class Covariance(NamedTuple):
    """Covariance of the errors of an estimate.

    Attributes:
        upper_triangle: 120 elements of the upper triangle, row by row.
    """

    upper_triangle: tuple[Row, ...]

    @classmethod
    def diagonal(cls, deviations: Iterable[Row]) -> "Covariance":
        """Return the covariance of independent errors with given standard deviations."""
        variances = [each * each for each in deviations]
        return cls(tuple([variances[i] if i == j else 0.0 for i in range(_NUM_ERRORS) for j in range(i, _NUM_ERRORS)]))

    @classmethod
    def of(cls, matrix: Sequence[Sequence[Row]]) -> "Covariance":
        """Return the covariance with the elements in the upper triangle of a symmetric matrix."""
        return cls(tuple([matrix[i][j] for i in range(_NUM_ERRORS) for j in range(i, _NUM_ERRORS)]))

    def matrix(self) -> list[list[Row]]:
        """Return all elements of the covariance matrix, row by row."""
        rows = iter(self.upper_triangle)
        matrix: list[list[Any]] = [[None] * _NUM_ERRORS for _ in range(_NUM_ERRORS)]
        for i in range(_NUM_ERRORS):
            for j in range(i, _NUM_ERRORS):
                matrix[i][j] = matrix[j][i] = next(rows)
        return matrix

    def deviations(self) -> EstimateDeviation:
        """Return the standard deviations of the errors of the estimate."""
        matrix = self.matrix()
        return EstimateDeviation._make(sqrt(matrix[i][i]) for i in range(_NUM_ERRORS))


class InertialNoise(NamedTuple):
    """Noise of the inertial measurement unit, equal on all axes.

    Attributes:
        gyroscope: square root of the spectral density of the gyroscope's white noise.
        accelerometer: square root of the spectral density of the accelerometer's white noise.
        gyroscope_walk: square root of the spectral density of the rate of change of the gyroscope's bias.
        accelerometer_walk: square root of the spectral density of the rate of change of the accelerometer's bias.
    """

    gyroscope: Annotated[Row, Quantity("rad/√s", sign="nonnegative")]
    accelerometer: Annotated[Row, Quantity("m/s/√s", sign="nonnegative")]
    gyroscope_walk: Annotated[Row, Quantity("rad/s/√s", sign="nonnegative")]
    accelerometer_walk: Annotated[Row, Quantity("m/s²/√s", sign="nonnegative")]


class ScalarMeasurement(NamedTuple):
    """Scalar measurement, linearised at an estimate.

    Attributes:
        innovation: measured minus predicted value.
        derivatives: derivatives of the predicted value with respect to the errors; None for a derivative that is zero.
        deviation: standard deviation of the measurement noise.
        reset: field of `ErrorState` that the measurement resets if its innovation is beyond the limit of the gate.
    """

    innovation: Row
    derivatives: Any
    deviation: Row
    reset: str = "position"


def propagate(covariance: Covariance, increment: InertialIncrement, axes: BodyAxes, noise: InertialNoise) -> Covariance:
    """Return the covariance at the end of an increment, given the axes of the body in W at its beginning."""
    matrix = covariance.matrix()
    time, (x, y, z) = increment.duration, axes.in_world(increment.velocity)
    rotations = [axes.in_world(column) for column in increment.rotations]
    negative_rotations = [[-element for element in row] for row in zip(*rotations, strict=True)]
    _add_rows(
        matrix, _INDICES.position, _INDICES.velocity, [[time, None, None], [None, time, None], [None, None, time]]
    )
    _add_rows(matrix, _INDICES.velocity, _INDICES.rotation, [[None, z, -y], [-z, None, x], [y, -x, None]])
    _add_rows(matrix, _INDICES.velocity, _INDICES.accelerometer_bias, negative_rotations)
    _add_rows(matrix, _INDICES.rotation, _INDICES.gyroscope_bias, negative_rotations)
    for indices, density in (
        (_INDICES.velocity, noise.accelerometer),
        (_INDICES.rotation, noise.gyroscope),
        (_INDICES.gyroscope_bias, noise.gyroscope_walk),
        (_INDICES.accelerometer_bias, noise.accelerometer_walk),
    ):
        variance = density * density * time
        for i in indices:
            matrix[i][i] = matrix[i][i] + variance
    return Covariance.of(matrix)


class Gate(NamedTuple):
    """Treatment of measurements that do not agree with the estimate.

    Attributes:
        squared_limit: limit of the squared normalised innovation, which is the squared innovation divided by its
            variance.
        resets: True if measurements beyond `squared_limit` reset the estimate; False if they change nothing.
        time: time since the last reading within `squared_limit`, in seconds; only needed for a reset.
    """

    squared_limit: Number
    resets: bool
    time: Row


def corrected_error(
    covariance: Covariance, measurements: Iterable[ScalarMeasurement], gate: Gate
) -> tuple[ErrorState, Covariance, tuple[Number, ...]]:
    """Return the estimated error, its covariance and the normalised innovations, given scalar measurements.

    The noises of the measurements are independent. The measurements are linearised at the same estimate.

    Before a measurement with the innovation ν resets the estimate, the variance of the measured quantity is increased
    by ν². The added error belongs to the field `reset` and is independent of all other errors. Without it, a jump of
    the measured position would also change the estimated attitude strongly. If `reset` is the position, the variance
    of the velocity is increased by (ν / τ)², where τ is the time of the gate, since an error of the velocity during τ
    can explain the innovation.

    Args:
        covariance: covariance before the first measurement.
        measurements: scalar measurements.
        gate: treatment of measurements that do not agree with the estimate.
    """
    matrix = covariance.matrix()
    error = [0.0] * _NUM_ERRORS
    normalised: list[Row] = []
    for innovation, derivatives, deviation, reset in measurements:
        nonzero = [(i, each) for i, each in enumerate(_flat(derivatives)) if each is not None]
        gains = [total([_product(each, row[i]) for i, each in nonzero]) for row in matrix]
        variance = total([_product(each, gains[i]) for i, each in nonzero]) + deviation * deviation
        remaining = innovation - total([_product(each, error[i]) for i, each in nonzero])
        squared = remaining * remaining
        is_used = squared <= gate.squared_limit * variance
        normalised.append(remaining / sqrt(variance))
        increase = where(is_used, 0.0, squared)
        change = zip(getattr(_INDICES, reset), shortest_change(getattr(derivatives, reset)), strict=True)
        direction = [(i, weight) for i, weight in change if weight is not None]
        for i, weight in direction:
            gains[i] = gains[i] + weight * increase
        added = where(gate.resets, increase, 0.0)
        _add_variance(matrix, direction, added)
        if reset == "position":
            to_velocity = _INDICES.velocity.start - _INDICES.position.start
            _add_variance(
                matrix, [(i + to_velocity, weight) for i, weight in direction], added / (gate.time * gate.time)
            )
        factor = where(gate.resets | is_used, 1.0 / (variance + increase), 0.0)
        for i in range(_NUM_ERRORS):
            gain = gains[i] * factor
            error[i] = error[i] + gain * remaining
            for j in range(i, _NUM_ERRORS):
                matrix[i][j] = matrix[j][i] = matrix[i][j] - gain * gains[j]
    blocks = ErrorState._make(Vector(*error[i : i + 3]) for i in range(0, _NUM_ERRORS, 3))
    return blocks, Covariance.of(matrix), tuple(normalised)


def _add_variance(matrix: list[list[Row]], direction: Sequence[tuple[int, Row]], variance: Row) -> None:
    """Add the variance of an independent error to a covariance.

    Args:
        matrix: covariance, which is changed.
        direction: direction of the error, as pairs of an index and a component.
        variance: variance of the error.
    """
    for i, weight in direction:
        for j, other in direction:
            if j >= i:
                matrix[i][j] = matrix[j][i] = matrix[i][j] + weight * other * variance


def shortest_change(derivatives: Vector) -> Vector:
    """Return the shortest change of a vector that changes a predicted value by 1, given the derivatives of the value.

    None stands for zero, both in the derivatives and in the result.
    """
    nonzero = [each for each in derivatives if each is not None]
    if len(nonzero) == 1:
        return Vector._make(None if each is None else 1.0 / each for each in derivatives)
    scale = 1.0 / (total([each * each for each in nonzero]) + TINY)
    return Vector._make(None if each is None else scale * each for each in derivatives)


def _flat(derivatives: Any) -> list[Any]:
    """Return the 15 derivatives of an `ErrorState` as a list; None for a derivative that is zero."""
    return [each for block in derivatives for each in (block or (None, None, None))]


def _product(factor: Any, row: Row) -> Row:
    """Return the product of a factor and a row, without a multiplication if the factor is the constant 1."""
    return row if factor.__class__ is float and factor == 1.0 else factor * row


def _add_rows(matrix: list[list[Row]], targets: range, sources: range, factors: Sequence[Sequence[Any]]) -> None:
    """Update a covariance matrix for errors x_i that are replaced by x_i + Σ_j a_ij x_j, for targets i and sources j.

    Args:
        matrix: covariance of the errors, which is changed.
        targets: indices i.
        sources: indices j, none of which is a target.
        factors: numbers a_ij; None for zero.
    """
    targets_and_terms = [
        (i, [(j, factor) for j, factor in zip(sources, row, strict=True) if factor is not None])
        for i, row in zip(targets, factors, strict=True)
    ]
    before = {(i, j): matrix[i][j] for i in targets for j in sources}
    for k in range(_NUM_ERRORS):
        if k not in targets:
            for i, terms in targets_and_terms:
                matrix[i][k] = matrix[k][i] = matrix[i][k] + total([a * matrix[j][k] for j, a in terms])
    # Let B, C and D be the blocks (sources, sources), (targets, sources) and (targets, targets) before the change, and
    # A the factors. The block (targets, sources) is now Y = C + A B, and D becomes D + A Cᵀ + Y Aᵀ.
    for i, terms in targets_and_terms:
        for k, other_terms in targets_and_terms:
            if k >= i:
                first = total([a * before[k, j] for j, a in terms])
                second = total([a * matrix[i][j] for j, a in other_terms])
                matrix[i][k] = matrix[k][i] = matrix[i][k] + (first + second)
