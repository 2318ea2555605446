"""Minimum-snap interpolation through waypoints, as linear algebra in segment-local unit time.

On segment i of duration T_i, each axis is the polynomial p(s) = Σ c_k s^k, k = 0..7, with s = (t - t_i) / T_i in [0, 1]
(paper eq (20)). The cost is ∫ (d⁴p/dt⁴)² dt, summed over the segments (paper eqs (18), (19)).

The boundary derivatives of a segment are position, velocity, acceleration and jerk at both ends. They determine its
polynomial of degree 7. The positions are the waypoints. Velocity, acceleration and jerk are given at some waypoints,
and are zero at both ends of the path (paper, section on the trajectory). Each waypoint has three free derivatives per
axis. Both segments that meet at a waypoint share these derivatives, so the path has three continuous derivatives by
construction.

The cost is a positive definite quadratic form in the free derivatives, with a block tridiagonal matrix. Its minimum
therefore requires one banded Cholesky factorisation, whose cost is linear in the number of segments. At the minimum,
the fourth to sixth derivatives are also continuous (paper eq (21)), except where a derivative is given.

Every quantity is scaled by the duration of the shorter adjacent segment, and the matrix is scaled to unit diagonal.
Absolute time is not used. The result is therefore accurate even if segments of 0.2 s and of 20 s are adjacent.

In these units, the entries of the quadratic form are powers of the durations, so their derivatives with respect to the
durations are simple. The gradient of the cost requires no further solution (envelope theorem). The derivatives of the
path with respect to all durations require one solution, with one right-hand side per duration.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.reference.polynomial_path import PolynomialPath, hermite_matrix, power_basis

DEGREE = 7  # degree of the polynomial of a segment
NUM_FREE = 3  # velocity, acceleration and jerk, the derivatives that can be free at a waypoint
# Indices of velocity, acceleration and jerk in the 8 boundary derivatives of a segment.
START_DERIVATIVES = slice(1, 4)  # at the start of the segment
END_DERIVATIVES = slice(5, 8)  # at the end of the segment
# Order of each boundary derivative: 0 (position) to 3 (jerk) at the start, then 0 to 3 at the end.
ORDERS = np.array([0, 1, 2, 3, 0, 1, 2, 3])


def _snap_form() -> np.ndarray:
    """Return the (8, 8) matrix of the quadratic form ∫₀¹ (d⁴p/ds⁴)² ds in the polynomial coefficients."""
    falling = np.array([math.perm(k, 4) for k in range(DEGREE + 1)], dtype=float)
    exponent = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) - 7.0
    return np.outer(falling, falling) / np.where(exponent > 0, exponent, 1.0)


_SNAP_FORM = _snap_form()
FROM_BOUNDARY = hermite_matrix(4)
"""(8, 8) matrix from the boundary derivatives of a segment to its coefficients."""
BOUNDARY_FORM = np.round(FROM_BOUNDARY.T @ _SNAP_FORM @ FROM_BOUNDARY)
"""(8, 8) matrix of a segment's cost in unit time, as a quadratic form in its boundary derivatives."""
# (4, 8) matrix L with cost = |L d|² for the boundary derivatives d of a segment. This sum of squares is positive and
# accurate, even where cancellation would make the quadratic form inaccurate.
_SNAP_ROOT = np.linalg.cholesky(_SNAP_FORM[4:, 4:]).T @ FROM_BOUNDARY[4:]


def minimum_snap(waypoints: ArrayLike, times: ArrayLike, derivatives: ArrayLike | None = None) -> PolynomialPath:
    """Return the path with the smallest integrated squared snap through waypoints at given times.

    This is the problem of `minimum_snap_program` without inequalities. It has a closed-form solution.

    Args:
        waypoints: (segments + 1, axes) points to pass, m.
        times: (segments + 1,) times of the waypoints, strictly increasing, s.
        derivatives: (segments + 1, 3, axes) velocity (m/s), acceleration (m/s²) and jerk (m/s³) at the waypoints; NaN
            for free derivatives. By default the path is at rest at both ends and free in between.

    Raises:
        InputError: if shapes do not match, a number is not finite, or the times do not increase.
    """
    points, times = checked_waypoints(waypoints, times)
    return MinimumSnap(points, np.diff(times), derivatives).path()._replace(times=times)


def rest_at_ends(count: int, axes: int) -> np.ndarray:
    """Return (count, 3, axes) waypoint derivatives: zero at the first and the last waypoint, NaN (free) in between."""
    derivatives = np.full((count, NUM_FREE, axes), np.nan)
    derivatives[[0, -1]] = 0.0
    return derivatives


class Contact(NamedTuple):
    """Point of a path whose position along one direction is prescribed, such as a point where the path touches a wall.

    Attributes:
        segment: index of the segment.
        s: unit time on the segment, 0 to 1.
        direction: (axes,) unit vector, or the index of an axis.
        position: position along the direction, m.
    """

    segment: int
    s: float
    direction: np.ndarray | int
    position: float


class MinimumSnap:
    """Minimum-snap path through points, and its derivatives with respect to the durations.

    Args:
        points: (segments + 1, axes) waypoints, m.
        durations: (segments,) positive durations, s.
        derivatives: derivatives as for `minimum_snap`, each given on all axes or on none.
        contacts: points between waypoints at which the position along one direction is prescribed.

    Attributes:
        boundary: (segments, 8, axes) position, velocity, acceleration and jerk at the start and then at the end of each
            segment, as derivatives with respect to s, m. Positions are relative to the start of the segment.
    """

    def __init__(
        self,
        points: np.ndarray,
        durations: np.ndarray,
        derivatives: ArrayLike | None = None,
        *,
        contacts: Sequence[Contact] = (),
    ) -> None:
        self.points, self.durations, self.contacts = points, durations, tuple(contacts)
        axes = points.shape[1]
        given = rest_at_ends(len(points), axes) if derivatives is None else np.asarray(derivatives, dtype=float)
        if given.shape != (len(points), NUM_FREE, axes):
            raise InputError(
                f"the derivatives have the shape {given.shape}, but must have {(len(points), NUM_FREE, axes)}"
            )
        self._fixed = ~np.isnan(given).any(axis=2)
        if (self._fixed != ~np.isnan(given).all(axis=2)).any():
            raise InputError("velocity, acceleration and jerk at a waypoint must be given on all axes or on none")
        unit = waypoint_units(durations)
        self._scales = boundary_scales(durations, unit)
        self._weight = (durations.min() / durations) ** 7.0

        known = np.where(self._fixed[:, :, np.newaxis], given, 0.0)
        known *= (unit[:, np.newaxis] ** np.arange(1, NUM_FREE + 1))[:, :, np.newaxis]
        self.boundary = self._to_boundary(known)
        self.boundary[:, 4] = np.diff(points, axis=0)
        # Each row maps the boundary derivatives of a segment to the position at a `Contact`.
        self._contact_bases = [power_basis(0, contact.s, DEGREE + 1) @ FROM_BOUNDARY for contact in self.contacts]
        identity = np.eye(axes)
        self._directions = np.array(
            [
                identity[contact.direction] if isinstance(contact.direction, int) else contact.direction
                for contact in self.contacts
            ]
        ).reshape(-1, axes)
        self._multipliers = np.zeros(len(self.contacts))
        if not self._fixed.all():
            self._factorise()
            if self.contacts:
                self._prepare_contacts()
            # Only position differences over a segment matter, since the cost of a constant position is zero.
            right_side = -self._free_gradient(BOUNDARY_FORM @ self.boundary)
            gaps = np.array(
                [
                    contact.position - direction @ points[contact.segment]
                    for contact, direction in zip(self.contacts, self._directions, strict=True)
                ]
            )
            solution, self._multipliers = self._solve_with_contacts(right_side, gaps - self._at_contacts(self.boundary))
            self.boundary += self._to_boundary(solution)

    def path(self) -> PolynomialPath:
        """Return the path, which begins at time zero."""
        coefficients = FROM_BOUNDARY @ self.boundary
        coefficients[:, 0] = self.points[:-1]
        return PolynomialPath(np.concatenate([[0.0], np.cumsum(self.durations)]), coefficients)

    @cached_property
    def cost(self) -> float:
        """Integral of the squared snap over the path, summed over the axes, m²/s⁷."""
        roots = _SNAP_ROOT @ self.boundary
        return float(np.einsum("n,nka,nka->", self.durations**-7.0, roots, roots))

    def cost_gradient(self) -> np.ndarray:
        """Return the (segments,) derivatives of the cost with respect to the durations, m²/s⁸."""
        roots, growth = _SNAP_ROOT @ self.boundary, _SNAP_ROOT @ (ORDERS[:, np.newaxis] * self.boundary)
        gradient = np.einsum("n,nka,nka->n", self.durations**-8.0, roots, 2.0 * growth - 7.0 * roots)
        # The Lagrange multipliers of the contacts belong to a cost that is multiplied by the seventh power of the
        # shortest duration, so they are divided by this power.
        shortest = self.durations.min()
        shifts = self._at_contacts(ORDERS[:, np.newaxis] * self.boundary)
        for contact, multiplier, shift in zip(self.contacts, self._multipliers, shifts, strict=True):
            gradient[contact.segment] += 2.0 * multiplier * shift / (shortest**7.0 * self.durations[contact.segment])
        return np.asarray(gradient)

    def boundary_gradient(self) -> np.ndarray:
        """Return the derivatives of `boundary` with respect to the logarithms of the durations.

        Returns:
            (segments, 8, axes, segments) derivatives; the last index selects the duration.
        """
        segments, _, axes = self.boundary.shape
        indices = np.arange(segments)
        growth = ORDERS[:, np.newaxis] * self.boundary
        gradient = np.zeros((segments, 8, axes, segments))
        if not self._fixed.all():
            form = BOUNDARY_FORM @ self.boundary
            residual = ORDERS[:, np.newaxis] * form - 7.0 * form + BOUNDARY_FORM @ growth
            # A duration affects the residual of its own segment only, but the solution on all segments.
            local = np.zeros((segments, 8, axes, segments))
            local[indices, :, :, indices] = residual
            gaps = np.zeros((len(self.contacts), segments))
            for i, (segment, *_) in enumerate(self.contacts):
                multiplier, direction = self._multipliers[i] / self._weight[segment], self._directions[i]
                local[segment, :, :, segment] += np.outer(multiplier * ORDERS * self._contact_bases[i], direction)
                gaps[i, segment] = -self._contact_bases[i] @ growth[segment] @ direction
            right_side = -self._free_gradient(local.reshape(segments, 8, axes * segments))
            solution, _ = self._solve_with_contacts(right_side, gaps)
            gradient += self._to_boundary(solution).reshape(gradient.shape)
        gradient[indices, :, :, indices] += growth
        return gradient

    def _to_boundary(self, shared: np.ndarray) -> np.ndarray:
        """Convert derivatives at the waypoints to boundary derivatives of the segments, (segments, 8, columns).

        Args:
            shared: (waypoints, 3, columns) derivatives, each in the unit of time of its waypoint (`waypoint_units`).
        """
        boundary = np.zeros((len(shared) - 1, 8, shared.shape[2]))
        boundary[:, START_DERIVATIVES] = shared[:-1] * self._scales[:, START_DERIVATIVES, np.newaxis]
        boundary[:, END_DERIVATIVES] = shared[1:] * self._scales[:, END_DERIVATIVES, np.newaxis]
        return boundary

    def _free_gradient(self, boundary_gradient: np.ndarray) -> np.ndarray:
        """Return the gradient (waypoints, 3, columns) with respect to the free derivatives; zero for given derivatives.

        Args:
            boundary_gradient: (segments, 8, columns) gradient with respect to the boundary derivatives, before
                multiplication by the cost weight of each segment.
        """
        weighted = boundary_gradient * (self._scales * self._weight[:, np.newaxis])[:, :, np.newaxis]
        gradient = np.zeros((len(boundary_gradient) + 1, NUM_FREE, boundary_gradient.shape[2]))
        gradient[:-1] += weighted[:, START_DERIVATIVES]
        gradient[1:] += weighted[:, END_DERIVATIVES]
        gradient[self._fixed] = 0.0
        return gradient

    def _factorise(self) -> None:
        """Compute the banded Cholesky factor of the cost matrix for the free derivatives."""
        scales = self._scales
        form = BOUNDARY_FORM * scales[:, :, np.newaxis] * scales[:, np.newaxis, :]
        form *= self._weight[:, np.newaxis, np.newaxis]
        diagonal = np.zeros((len(form) + 1, NUM_FREE, NUM_FREE))
        diagonal[:-1] += form[:, START_DERIVATIVES, START_DERIVATIVES]
        diagonal[1:] += form[:, END_DERIVATIVES, END_DERIVATIVES]
        coupling = form[:, END_DERIVATIVES, START_DERIVATIVES]

        size = NUM_FREE * len(diagonal)
        bands = np.zeros((2 * NUM_FREE, size))
        for row in range(NUM_FREE):
            for column in range(NUM_FREE):
                if row >= column:
                    bands[row - column, column::NUM_FREE] = diagonal[:, row, column]
                bands[NUM_FREE + row - column, column : size - NUM_FREE : NUM_FREE] = coupling[:, row, column]
        unit = 1.0 / np.sqrt(bands[0])
        # The rows of given derivatives are decoupled from the other rows, and the right-hand side is zero there. The
        # solution is therefore zero for given derivatives.
        free = np.where(self._fixed.ravel(), 0.0, unit)
        for distance in range(1, 2 * NUM_FREE):
            bands[distance, : size - distance] *= free[: size - distance] * free[distance:]
        bands[0] = 1.0
        self._unit = unit
        self._factor = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False)

    def _prepare_contacts(self) -> None:
        """Compute how the free derivatives respond to a unit Lagrange multiplier of each `Contact`."""
        size = len(self._unit)
        self._rows = np.zeros((len(self.contacts), size))
        for row, contact, basis in zip(self._rows, self.contacts, self._contact_bases, strict=True):
            scaled, at = basis * self._scales[contact.segment], NUM_FREE * contact.segment
            row[at : at + NUM_FREE], row[at + NUM_FREE : at + 2 * NUM_FREE] = (
                scaled[START_DERIVATIVES],
                scaled[END_DERIVATIVES],
            )
        self._rows[:, self._fixed.ravel()] = 0.0
        self._contact_responses = self._solve(self._rows.T.reshape(size // NUM_FREE, NUM_FREE, -1)).reshape(size, -1)

    def _at_contacts(self, boundary: np.ndarray) -> np.ndarray:
        """Return the position of a path at each `Contact`, along the direction of the contact, (contacts,) in m."""
        return np.array(
            [
                basis @ boundary[contact.segment] @ direction
                for contact, basis, direction in zip(self.contacts, self._contact_bases, self._directions, strict=True)
            ]
        )

    def _solve_with_contacts(self, right_side: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the free derivatives that move the path at each `Contact`, and the contacts' Lagrange multipliers.

        Args:
            right_side: (waypoints, 3, axes × columns) right-hand side of the equations without contacts.
            gaps: (contacts,) or (contacts, columns) distances by which the path must move at each contact, along the
                direction of the contact, m.
        """
        solution = self._solve(right_side)
        if not self.contacts:
            return solution, np.zeros_like(gaps)
        by_axis = solution.reshape(len(self._unit), self.points.shape[1], -1)
        missing = np.einsum("cu,ca,uan->cn", self._rows, self._directions, by_axis) - gaps.reshape(len(gaps), -1)
        # The multiplier of one contact moves the path at another contact in proportion to the scalar product of their
        # directions.
        response = (self._rows @ self._contact_responses) * (self._directions @ self._directions.T)
        # Several contacts can prescribe linearly dependent positions, so the equations are solved by least squares.
        multipliers = np.linalg.lstsq(response, missing, rcond=1e-12)[0]
        by_axis -= np.einsum("uc,ca,cn->uan", self._contact_responses, self._directions, multipliers)
        multipliers = multipliers.reshape(gaps.shape)
        return by_axis.reshape(solution.shape), multipliers

    def _solve(self, right_side: np.ndarray) -> np.ndarray:
        """Return the (waypoints, 3, columns) free derivatives, each in the unit of time of its waypoint."""
        scaled = right_side.reshape(len(self._unit), -1) * self._unit[:, np.newaxis]
        solution = scipy.linalg.cho_solve_banded((self._factor, True), scaled, overwrite_b=True, check_finite=False)
        return np.asarray(solution * self._unit[:, np.newaxis]).reshape(right_side.shape)


def snap_cost(path: PolynomialPath) -> np.ndarray:
    """Return the (axes,) integrals of the squared snap over the path, m²/s⁷."""
    c = path.coefficients
    return np.einsum("nka,kl,nla,n->a", c, _SNAP_FORM, c, path.durations**-7.0)


def waypoint_units(durations: np.ndarray) -> np.ndarray:
    """Return the unit of time of each waypoint, (segments + 1,) in s: the duration of its shorter adjacent segment."""
    inner = np.minimum(durations[:-1], durations[1:])
    return np.concatenate([durations[:1], inner, durations[-1:]])


def boundary_scales(durations: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Return (segments, 8) factors that convert derivatives from the waypoints' units of time to unit time."""
    ratio = np.repeat(np.column_stack([durations / unit[:-1], durations / unit[1:]]), 4, axis=1)
    return np.asarray(ratio**ORDERS)


def checked_waypoints(waypoints: ArrayLike, times: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return waypoints (segments + 1, axes) and times (segments + 1,) as checked float arrays.

    Raises:
        InputError: if shapes do not match, a number is not finite, or the times do not increase.
    """
    points, instants = np.array(waypoints, dtype=float), np.array(times, dtype=float)
    if points.ndim != 2 or len(points) < 2 or instants.shape != (len(points),):
        raise InputError(
            f"the waypoints have the shape {points.shape} and the times {instants.shape}; "
            "give two or more waypoints as rows, and one time for each"
        )
    if not (np.isfinite(points).all() and np.isfinite(instants).all()):
        raise InputError("waypoints and times must be finite numbers")
    late = np.flatnonzero(np.diff(instants) <= 0.0)
    if late.size:
        i = late[0]
        raise InputError(
            f"waypoint times must increase, but waypoint {i} is passed at {instants[i]:g} s and waypoint {i + 1} at"
            f" {instants[i + 1]:g} s"
        )
    return points, instants
