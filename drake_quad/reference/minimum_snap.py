"""Minimum-snap interpolation: the algebra, in segment-local unit time.

On segment i, of duration T_i, an axis flies p(s) = Σ c_k s^k, k = 0..7, with s = (t - t_i) / T_i in [0, 1]
(paper eq (20)). The cost is ∫ (d⁴p/dt⁴)² dt, summed over the segments (paper eqs (18), (19)).

A degree-7 segment is fixed by its boundary derivatives, position to jerk at both ends. Positions are the
waypoints; velocity, acceleration and jerk are given at some waypoints, zero at both ends of the path (paper, section
on the trajectory); what is left, three numbers a waypoint and axis, is shared by the two segments that meet there, so
that the path has three continuous derivatives by construction. The cost is a positive definite quadratic form in these
numbers whose matrix is block tridiagonal, so its minimum costs one banded Cholesky factorisation: linear in the
number of segments. At the minimum the fourth to sixth derivatives are continuous too (paper eq (21)), but where a
derivative is given.

Every quantity is scaled by the duration of the shorter segment that it touches, and the matrix to unit diagonal;
absolute time never enters. That keeps 0.2 s segments beside 20 s ones accurate.

In these units the form's entries are powers of the durations, so its derivatives with respect to them are as simple as
the form itself: the gradient of the cost costs no further solution (envelope theorem), and how the path answers to
every duration costs one with as many right-hand sides.
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

DEGREE = 7
FREE = 3  # velocity, acceleration, jerk: what a waypoint leaves free
START, END = slice(1, 4), slice(5, 8)  # velocity to jerk within a segment's boundary derivatives
# The order of each boundary derivative: position to jerk at the start, position to jerk at the end.
ORDERS = np.array([0, 1, 2, 3, 0, 1, 2, 3])


def _snap_form() -> np.ndarray:
    """(8, 8) matrix of ∫₀¹ (d⁴p/ds⁴)² ds as a quadratic form in the coefficients."""
    falling = np.array([math.perm(k, 4) for k in range(DEGREE + 1)], dtype=float)
    exponent = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1)) - 7.0
    return np.outer(falling, falling) / np.where(exponent > 0, exponent, 1.0)


_SNAP_FORM = _snap_form()
FROM_BOUNDARY = hermite_matrix(4)
BOUNDARY_FORM = np.round(FROM_BOUNDARY.T @ _SNAP_FORM @ FROM_BOUNDARY)
# (4, 8) matrix whose product with boundary derivatives has the segment's cost as its square. A sum of squares stays
# exact, and positive, where the form would be the difference of large numbers.
_ROOT = np.linalg.cholesky(_SNAP_FORM[4:, 4:]).T @ FROM_BOUNDARY[4:]


def minimum_snap(waypoints: ArrayLike, times: ArrayLike, derivatives: ArrayLike | None = None) -> PolynomialPath:
    """Returns the path of least integrated squared snap through waypoints at given times.

    This is the fast path: the same problem as `minimum_snap_program` without its inequalities.

    Args:
        waypoints: (segments + 1, axes) points to pass, m.
        times: (segments + 1,) when to pass them, strictly increasing, s.
        derivatives: (segments + 1, 3, axes) velocity (m/s), acceleration (m/s²) and jerk (m/s³) at the waypoints, NaN
            where the path is free to choose; if not given, rest at both ends and freedom in between.

    Raises:
        InputError: a shape does not fit, a number is not finite or the times do not increase.
    """
    points, times = checked_waypoints(waypoints, times)
    return MinimumSnap(points, np.diff(times), derivatives).path()._replace(times=times)


def rest_at_ends(count: int, axes: int) -> np.ndarray:
    """(count, 3, axes) derivatives at so many waypoints: zero at the first and the last, NaN for free in between."""
    derivatives = np.full((count, FREE, axes), np.nan)
    derivatives[[0, -1]] = 0.0
    return derivatives


class Contact(NamedTuple):
    """A place at which a path is held along a direction, as by a wall that it touches.

    Attributes:
        segment: index.
        s: place on the segment, 0 to 1.
        direction: (axes,) unit vector, or the index of an axis.
        position: along it, m.
    """

    segment: int
    s: float
    direction: np.ndarray | int
    position: float


class MinimumSnap:
    """The minimum-snap path through points, and how it changes with its durations.

    Args:
        points: (segments + 1, axes), m.
        durations: (segments,) positive, s.
        derivatives: as for `minimum_snap`; a derivative is given on all axes or on none.
        contacts: where the path is held too.

    Attributes:
        boundary: (segments, 8, axes) boundary derivatives of each segment with respect to s, position relative to its
            start; m.
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
        if given.shape != (len(points), FREE, axes):
            raise InputError(f"the derivatives have the shape {given.shape}, but must have {(len(points), FREE, axes)}")
        self._fixed = ~np.isnan(given).any(axis=2)
        if (self._fixed != ~np.isnan(given).all(axis=2)).any():
            raise InputError("velocity, acceleration and jerk at a waypoint are given on all axes or on none")
        unit = waypoint_units(durations)
        self._scales = boundary_scales(durations, unit)
        self._weight = (durations.min() / durations) ** 7.0

        known = np.where(self._fixed[:, :, np.newaxis], given, 0.0)
        known *= (unit[:, np.newaxis] ** np.arange(1, FREE + 1))[:, :, np.newaxis]
        self.boundary = self._to_boundary(known)
        self.boundary[:, 4] = np.diff(points, axis=0)
        # From boundary derivatives to the position at each contact.
        self._contact_bases = [power_basis(0, contact.s, DEGREE + 1) @ FROM_BOUNDARY for contact in self.contacts]
        identity = np.eye(axes)
        self._directions = np.array(
            [
                identity[contact.direction] if isinstance(contact.direction, int) else contact.direction
                for contact in self.contacts
            ]
        ).reshape(-1, axes)
        self._forces = np.zeros(len(self.contacts))
        if not self._fixed.all():
            self._factorise()
            if self.contacts:
                self._hold()
            # Position enters only through its change over the segment: the rows of the form cancel on constants.
            pull = -self._pull(BOUNDARY_FORM @ self.boundary)
            gaps = np.array(
                [
                    contact.position - direction @ points[contact.segment]
                    for contact, direction in zip(self.contacts, self._directions, strict=True)
                ]
            )
            answer, self._forces = self._answer(pull, gaps - self._at_contacts(self.boundary))
            self.boundary += self._to_boundary(answer)

    def path(self) -> PolynomialPath:
        """The path, beginning at time zero."""
        coefficients = FROM_BOUNDARY @ self.boundary
        coefficients[:, 0] = self.points[:-1]
        return PolynomialPath(np.concatenate([[0.0], np.cumsum(self.durations)]), coefficients)

    @cached_property
    def cost(self) -> float:
        """The integral of the squared snap over the path, summed over the axes, m²/s⁷."""
        roots = _ROOT @ self.boundary
        return float(np.einsum("n,nka,nka->", self.durations**-7.0, roots, roots))

    def cost_gradient(self) -> np.ndarray:
        """(segments,) derivatives of the cost with respect to the durations, m²/s⁸."""
        roots, growth = _ROOT @ self.boundary, _ROOT @ (ORDERS[:, np.newaxis] * self.boundary)
        gradient = np.einsum("n,nka,nka->n", self.durations**-8.0, roots, 2.0 * growth - 7.0 * roots)
        # The forces are in the units of the form, in which the weight of the shortest segment is one.
        shortest = self.durations.min()
        shifts = self._at_contacts(ORDERS[:, np.newaxis] * self.boundary)
        for contact, force, shift in zip(self.contacts, self._forces, shifts, strict=True):
            gradient[contact.segment] += 2.0 * force * shift / (shortest**7.0 * self.durations[contact.segment])
        return np.asarray(gradient)

    def boundary_gradient(self) -> np.ndarray:
        """(segments, 8, axes, segments) derivatives of `boundary` with respect to the logarithms of the durations."""
        segments, _, axes = self.boundary.shape
        every = np.arange(segments)
        growth = ORDERS[:, np.newaxis] * self.boundary
        gradient = np.zeros((segments, 8, axes, segments))
        if not self._fixed.all():
            form = BOUNDARY_FORM @ self.boundary
            residual = ORDERS[:, np.newaxis] * form - 7.0 * form + BOUNDARY_FORM @ growth
            # A duration acts on its own segment's residual only; then everything answers.
            local = np.zeros((segments, 8, axes, segments))
            local[every, :, :, every] = residual
            gaps = np.zeros((len(self.contacts), segments))
            for i, (segment, *_) in enumerate(self.contacts):
                force, direction = self._forces[i] / self._weight[segment], self._directions[i]
                local[segment, :, :, segment] += np.outer(force * ORDERS * self._contact_bases[i], direction)
                gaps[i, segment] = -self._contact_bases[i] @ growth[segment] @ direction
            pull = -self._pull(local.reshape(segments, 8, axes * segments))
            answer, _ = self._answer(pull, gaps)
            gradient += self._to_boundary(answer).reshape(gradient.shape)
        gradient[every, :, :, every] += growth
        return gradient

    def _to_boundary(self, shared: np.ndarray) -> np.ndarray:
        """From (waypoints, 3, columns) derivatives in the waypoints' units to (segments, 8, columns) in segments'."""
        boundary = np.zeros((len(shared) - 1, 8, shared.shape[2]))
        boundary[:, START] = shared[:-1] * self._scales[:, START, np.newaxis]
        boundary[:, END] = shared[1:] * self._scales[:, END, np.newaxis]
        return boundary

    def _pull(self, forces: np.ndarray) -> np.ndarray:
        """The transpose of `_to_boundary`, weighted by the segments' share in the cost; zero where all is given."""
        weighted = forces * (self._scales * self._weight[:, np.newaxis])[:, :, np.newaxis]
        pull = np.zeros((len(forces) + 1, FREE, forces.shape[2]))
        pull[:-1] += weighted[:, START]
        pull[1:] += weighted[:, END]
        pull[self._fixed] = 0.0
        return pull

    def _factorise(self) -> None:
        scales = self._scales
        form = BOUNDARY_FORM * scales[:, :, np.newaxis] * scales[:, np.newaxis, :]
        form *= self._weight[:, np.newaxis, np.newaxis]
        diagonal = np.zeros((len(form) + 1, FREE, FREE))
        diagonal[:-1] += form[:, START, START]
        diagonal[1:] += form[:, END, END]
        coupling = form[:, END, START]

        size = FREE * len(diagonal)
        bands = np.zeros((2 * FREE, size))
        for row in range(FREE):
            for column in range(FREE):
                if row >= column:
                    bands[row - column, column::FREE] = diagonal[:, row, column]
                bands[FREE + row - column, column : size - FREE : FREE] = coupling[:, row, column]
        unit = 1.0 / np.sqrt(bands[0])
        # Without their couplings, rows of what is given leave it as it is.
        free = np.where(self._fixed.ravel(), 0.0, unit)
        for distance in range(1, 2 * FREE):
            bands[distance, : size - distance] *= free[: size - distance] * free[distance:]
        bands[0] = 1.0
        self._unit = unit
        self._factor = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False)

    def _hold(self) -> None:
        """Prepares the contacts: how the path answers to a unit force at each."""
        size = len(self._unit)
        self._rows = np.zeros((len(self.contacts), size))
        for row, contact, basis in zip(self._rows, self.contacts, self._contact_bases, strict=True):
            scaled, at = basis * self._scales[contact.segment], FREE * contact.segment
            row[at : at + FREE], row[at + FREE : at + 2 * FREE] = scaled[START], scaled[END]
        self._rows[:, self._fixed.ravel()] = 0.0
        self._answers = self._solve(self._rows.T.reshape(size // FREE, FREE, -1)).reshape(size, -1)

    def _at_contacts(self, boundary: np.ndarray) -> np.ndarray:
        """(contacts,) what boundary derivatives (segments, 8, axes) make of the position along each, m."""
        return np.array(
            [
                basis @ boundary[contact.segment] @ direction
                for contact, basis, direction in zip(self.contacts, self._contact_bases, self._directions, strict=True)
            ]
        )

    def _answer(self, pull: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives that answer to a pull and move the contacts by given gaps, and the contacts' forces.

        Args:
            pull: (waypoints, 3, axes × columns).
            gaps: (contacts,) + columns, m.
        """
        answer = self._solve(pull)
        if not self.contacts:
            return answer, np.zeros_like(gaps)
        by_axis = answer.reshape(len(self._unit), self.points.shape[1], -1)
        missing = np.einsum("cu,ca,uan->cn", self._rows, self._directions, by_axis) - gaps.reshape(len(gaps), -1)
        # A force along one direction moves the path along another by their common part.
        response = (self._rows @ self._answers) * (self._directions @ self._directions.T)
        # Least squares, should two contacts say the same.
        forces = np.linalg.lstsq(response, missing, rcond=1e-12)[0]
        by_axis -= np.einsum("uc,ca,cn->uan", self._answers, self._directions, forces)
        forces = forces.reshape(gaps.shape)
        return by_axis.reshape(answer.shape), forces

    def _solve(self, pull: np.ndarray) -> np.ndarray:
        """(waypoints, 3, columns) the derivatives in the waypoints' units that answer to a pull."""
        right_side = pull.reshape(len(self._unit), -1) * self._unit[:, np.newaxis]
        solution = scipy.linalg.cho_solve_banded((self._factor, True), right_side, overwrite_b=True, check_finite=False)
        return np.asarray(solution * self._unit[:, np.newaxis]).reshape(pull.shape)


def snap_cost(path: PolynomialPath) -> np.ndarray:
    """Returns the (axes,) integrals of the squared snap over the path, m²/s⁷."""
    c = path.coefficients
    return np.einsum("nka,kl,nla,n->a", c, _SNAP_FORM, c, path.durations**-7.0)


def waypoint_units(durations: np.ndarray) -> np.ndarray:
    """(segments + 1,) the waypoints' own units of time: the duration of the shorter segment there, s."""
    inner = np.minimum(durations[:-1], durations[1:])
    return np.concatenate([durations[:1], inner, durations[-1:]])


def boundary_scales(durations: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(segments, 8) factors from derivatives in the waypoints' units of time to those in the segment's."""
    ratio = np.repeat(np.column_stack([durations / unit[:-1], durations / unit[1:]]), 4, axis=1)
    return np.asarray(ratio**ORDERS)


def checked_waypoints(waypoints: ArrayLike, times: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Returns both as float arrays, (segments + 1, axes) and (segments + 1,), or raises InputError."""
    points, instants = np.array(waypoints, dtype=float), np.array(times, dtype=float)
    if points.ndim != 2 or len(points) < 2 or instants.shape != (len(points),):
        raise InputError(
            f"waypoints of shape {points.shape} with times of shape {instants.shape}: "
            "two or more waypoints are needed, as rows, and one time for each"
        )
    if not (np.isfinite(points).all() and np.isfinite(instants).all()):
        raise InputError("waypoints and times must be finite numbers")
    late = np.flatnonzero(np.diff(instants) <= 0.0)
    if late.size:
        i = late[0]
        raise InputError(
            f"waypoint times must increase, but time {i + 1} is {instants[i + 1]:g} s after {instants[i]:g} s"
        )
    return points, instants
