"""Stability margins of a loop in which a sensor or a controller is slower than the command link.

Such a loop is periodic: its response to an offset depends on the tick at which the offset acts. Lifting (see
`drake_quad.linear.sampled_system.lifted`) turns the N ticks of a period into N inputs and N outputs, so that the
sensitivity S is a matrix (N, N). All definitions become those of a time-invariant loop if N is 1:

- The sensitivity peak is the largest singular value of S. It is the largest factor by which the loop increases the
  root mean square of an offset.
- The disk margin is 1 over the largest singular value of S - I/2. It holds for factors that change from tick to tick.
- For a factor or a delay Δ, which acts on the signal in the loop, the stability limit is the smallest Δ for which
  det(S + Δ (I - S)) is zero at some frequency. Before this limit, the curve of the determinant does not encircle zero.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from drake_quad.linear.margins import Margins, decibel, frequencies, near_modes
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.process_settings import single_threaded_blas

_NUM_FREQUENCIES = 400  # points of the first grid, which ends at half the frequency of the common period
_NUM_NEAR = 33  # number of frequencies that refine the two grid steps around a critical frequency
# Ranges in which limits are sought. A larger limit counts as infinite, and a smaller factor than 1 / _MAX_FACTOR as 0.
_MAX_FACTOR = 1e4
_MIN_DELAY = 1e-5  # s
_MAX_DELAY = 10.0  # s
_NUM_CHANGES = 60  # number of changes, from small to large, among which the first unstable one is sought
_NUM_BISECTIONS = 24  # number of bisections between a stable and an unstable change
_MAX_LIMIT_ERROR = 0.1  # largest relative error of a limit that is found on the first grid
_NUM_REFINEMENTS = 2  # number of times that the grid is refined around the critical frequencies
_HALF_POWER = math.sqrt(0.5)  # magnitude of -3 dB
_MIN_FEEDBACK = 1e-9  # a signal has no feedback if |S - 1| is smaller than this value at all frequencies


def periodic_margins(closed: SampledSystem, *, points: int = _NUM_FREQUENCIES) -> Margins | None:
    """Return the margins of a signal; None if the signal is not fed back.

    Crossover and bandwidth refer to the part of the response that has the same frequency as the offset.

    Args:
        closed: stable lifted system from the offsets on the signal in N ticks to the signal in these ticks.
        points: number of frequencies on the first grid. The grid is then refined around the critical frequencies. With
            400 frequencies, the relative error of a margin is about 1e-5.
    """
    with single_threaded_blas():
        grid = frequencies(closed.period, points=points)
        loop = _LiftedSensitivity(closed, np.sort([*grid, *near_modes(closed, grid)]))
        if np.abs(loop.T).max() < _MIN_FEEDBACK:
            return None
        factors = np.geomspace(1.0, _MAX_FACTOR, _NUM_CHANGES)
        delays = np.append(0.0, np.geomspace(_MIN_DELAY, _MAX_DELAY, _NUM_CHANGES))
        increased = _Limit(_LiftedSensitivity.with_factor, loop, factors)
        reduced = _Limit(_LiftedSensitivity.with_factor, loop, 1.0 / factors)
        turned = _Limit(_LiftedSensitivity.with_phase, loop, np.linspace(0.0, math.pi, _NUM_CHANGES))
        delayed = _Limit(_LiftedSensitivity.with_delay, loop, delays)
        limits = [increased, reduced, turned, delayed]
        for _ in range(_NUM_REFINEMENTS):
            critical = [limit.critical(loop) for limit in limits if limit.value is not None]
            loop = loop.refined([*critical, *(int(np.argmax(loop.sizes(shift))) for shift in (0.0, 0.5))])
            for limit in limits:
                limit.refine(loop)
        frequency, sensitivity = loop.fundamental()
        crossovers = _falling_crossings(frequency, np.abs(1.0 / sensitivity - 1.0), 1.0)
        return Margins(
            gain=math.inf if increased.value is None else decibel(increased.value),
            gain_reduction=math.inf if reduced.value is None else -decibel(reduced.value),
            phase=math.inf if turned.value is None else math.degrees(turned.value),
            delay=math.inf if delayed.value is None else delayed.value,
            disk=1.0 / float(loop.sizes(0.5).max()),
            crossover=float(np.max(crossovers, initial=0.0)),
            sensitivity=float(loop.sizes(0.0).max()),
            bandwidth=_bandwidth(frequency, np.abs(1.0 - sensitivity)),
        )


class _LiftedSensitivity:
    """Sensitivity matrices of a lifted loop with N ticks on a grid of frequencies.

    Args:
        closed: stable lifted system from the offsets on the signal to the signal.
        grid: (points,) increasing frequencies up to half the frequency of the common period, rad/s.

    Attributes:
        S: (points, N, N) sensitivity.
        T: (points, N, N) I - S.
    """

    def __init__(self, closed: SampledSystem, grid: np.ndarray) -> None:
        N = len(closed.inputs)
        self._closed, self._grid = closed, grid
        self.S = closed.response(np.exp(1j * grid * closed.period))
        self.T = np.eye(N) - self.S
        self._eigenvalues = np.linalg.eigvals(self.T)
        # A lifted signal at a grid frequency contains all frequencies that differ from it by multiples of 2π over the
        # common period. Each column of `basis` is a signal that oscillates at one of these frequencies.
        tick = closed.period / N
        angles = grid[:, np.newaxis] * tick + 2.0 * math.pi / N * np.arange(N)
        angles -= 2.0 * math.pi * np.rint(angles / (2.0 * math.pi))
        basis = np.exp(1j * angles[:, np.newaxis, :] * np.arange(N)[:, np.newaxis]) / math.sqrt(N)
        self._frequencies = angles / tick  # (points, N), rad/s
        self._T_by_frequency = basis.conj().swapaxes(1, 2) @ self.T @ basis

    def refined(self, critical: Sequence[int]) -> "_LiftedSensitivity":
        """Return the matrices on a grid with more points around the frequencies of the given indices."""
        last = len(self._grid) - 1
        ends = [(self._grid[max(i - 1, 0)], self._grid[min(i + 1, last)]) for i in critical]
        near = [np.linspace(*pair, _NUM_NEAR)[1:-1] for pair in ends]
        return _LiftedSensitivity(self._closed, np.unique(np.concatenate([self._grid, *near])))

    def sizes(self, shift: float) -> np.ndarray:
        """Return the largest singular value of S - shift I at each of the grid points, (points,)."""
        return np.linalg.norm(self.S - shift * np.eye(self.S.shape[1]), 2, axis=(1, 2))

    def with_factor(self, factor: complex) -> np.ndarray:
        """Return det(S + Δ T) at each grid point, (points,), if the loop signal is multiplied by a factor Δ."""
        return np.prod(1.0 - (1.0 - factor) * self._eigenvalues, axis=1)

    def with_phase(self, phase: float) -> np.ndarray:
        """Return det(S + Δ T) (2 points,) for the factor exp(-i phase), at negative and positive frequencies."""
        turn = np.exp(1j * phase)
        return np.concatenate([self.with_factor(turn).conj()[::-1], self.with_factor(turn.conj())])

    def with_delay(self, delay: float) -> np.ndarray:
        """Return det(S + Δ T) at each grid point, (points,), if the loop signal is delayed (s)."""
        change = 1.0 - np.exp(-1j * self._frequencies * delay)
        return np.linalg.det(np.eye(self.S.shape[1]) - change[:, :, np.newaxis] * self._T_by_frequency)

    def fundamental(self) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies (N points,) of the offset, rad/s, and the sensitivity at the same frequency.

        Some of the values are those at the negative frequency, whose complex conjugates are those at the positive one.
        """
        order = np.argsort(np.abs(self._frequencies), axis=None)
        frequency = self._frequencies.ravel()[order]
        value = 1.0 - np.diagonal(self._T_by_frequency, axis1=1, axis2=2).ravel()[order]
        return np.abs(frequency), value


class _Limit:
    """Stability limit: the smallest change of a loop at which the curve of a determinant encircles zero.

    Args:
        determinant: function of the loop and the change that returns the determinant at all frequencies.
        loop: loop on a coarse grid.
        changes: changes of increasing size, of which the first is no change.

    Attributes:
        value: limit; None if none of the changes makes the loop unstable.
    """

    def __init__(
        self,
        determinant: Callable[[_LiftedSensitivity, float], np.ndarray],
        loop: _LiftedSensitivity,
        changes: np.ndarray,
    ) -> None:
        self._determinant = determinant
        unstable = next((i for i in range(1, len(changes)) if self._is_unstable(loop, changes[i])), None)
        self.value = None if unstable is None else self._between(loop, changes[unstable - 1], changes[unstable])
        self._nominal = changes[0]

    def refine(self, loop: _LiftedSensitivity) -> None:
        """Determine the stability limit more precisely, given the loop on a finer frequency grid."""
        if self.value is not None:
            ends = (1.0 - _MAX_LIMIT_ERROR) * self.value, (1.0 + _MAX_LIMIT_ERROR) * self.value
            self.value = self._between(loop, *(ends if self.value > self._nominal else ends[::-1]))

    def critical(self, loop: _LiftedSensitivity) -> int:
        """Return the index of the grid frequency at which the loop becomes unstable at the stability limit."""
        assert self.value is not None
        sizes, points = np.abs(self._determinant(loop, self.value)), len(loop.S)
        # The curve of `with_phase` also has the negative frequencies, in reverse order.
        return int(np.argmin(np.minimum(sizes[:points][::-1], sizes[points:]) if len(sizes) > points else sizes))

    def _between(self, loop: _LiftedSensitivity, stable: float, unstable: float) -> float:
        for _ in range(_NUM_BISECTIONS):
            middle = 0.5 * (stable + unstable)
            stable, unstable = (stable, middle) if self._is_unstable(loop, middle) else (middle, unstable)
        return float(0.5 * (stable + unstable))

    def _is_unstable(self, loop: _LiftedSensitivity, change: float) -> bool:
        return _encircles_zero(self._determinant(loop, change))


def _encircles_zero(curve: np.ndarray) -> bool:
    """Return True if a curve, completed by its complex conjugate, encircles zero."""
    return abs(float(np.sum(np.angle(curve[1:] / curve[:-1])))) > 0.5 * math.pi


def _bandwidth(frequency: np.ndarray, size: np.ndarray) -> float:
    """Return the lowest frequency at which the magnitude of I - S falls below -3 dB, rad/s.

    As in `drake_quad.linear.margins`, the result is 0 if the magnitude is below -3 dB already at the first frequency,
    and infinite if it is above -3 dB at all frequencies.
    """
    if size[0] < _HALF_POWER:
        return 0.0
    return float(np.min(_falling_crossings(frequency, size, _HALF_POWER), initial=np.inf))


def _falling_crossings(frequency: np.ndarray, size: np.ndarray, level: float) -> np.ndarray:
    """Return the frequencies at which a magnitude falls below a level, by logarithmic interpolation."""
    excess = np.log(np.maximum(size, 1e-300) / level)
    falls = np.flatnonzero((excess[:-1] > 0.0) & (excess[1:] <= 0.0))
    fraction = excess[falls] / (excess[falls] - excess[falls + 1])
    return frequency[falls] ** (1.0 - fraction) * frequency[falls + 1] ** fraction
