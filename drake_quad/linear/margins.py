"""Stability margins of sampled-data loops."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_quad.linear.sampled_system import SampledSystem

_MIN_FREQUENCY = 1e-4  # rad/s, smallest frequency of the grid
_NUM_FREQUENCIES = 2000  # points of the grid, which ends at the Nyquist frequency
_NUM_PARTS = 32  # subintervals into which each refinement divides an interval of the grid
_NUM_DIVISIONS = 3  # number of refinements around a peak; the relative error of the peak is then about 1e-9
_NUM_PEAKS = 8  # number of local maxima that are refined, largest first
# Largest ratio of decay rate to frequency of a narrow mode. The peak of a narrow mode may lie between two grid
# frequencies.
_MAX_NARROW_DECAY_RATIO = 0.1
_MIN_INTEGRATOR_GAIN = 1e6  # smallest |L| at zero frequency of a loop with an integrator


class Margins(NamedTuple):
    """Stability margins of a single loop with the transfer function L.

    Attributes:
        gain: gain margin, the factor by which the gain may increase, dB.
        gain_reduction: factor by which the gain may decrease, in dB as a positive number; infinite if the gain may
            become zero.
        phase: phase margin, degrees.
        delay: delay margin, the additional delay at which the loop becomes unstable, s.
        disk: disk margin, the largest α such that the loop tolerates every gain between (1 - α/2) / (1 + α/2) and its
            inverse, with the corresponding phases (P. Seiler, A. Packard and P. Gahinet, "An introduction to disk
            margins", 2020).
        crossover: highest frequency at which |L| = 1, rad/s.
        sensitivity: peak of |1 / (1 + L)|.
        bandwidth: smallest frequency at which |L / (1 + L)| falls below -3 dB, rad/s; 0 if |L / (1 + L)| is already
            below -3 dB at low frequencies.
    """

    gain: float
    gain_reduction: float
    phase: float
    delay: float
    disk: float
    crossover: float
    sensitivity: float
    bandwidth: float


def margins(loop: SampledSystem) -> Margins:
    """Return the margins of a stable loop with one input and one output.

    The margins follow from the frequency response: from the frequencies at which it crosses the negative real axis, the
    unit circle and -3 dB, and from its closest approach to -1. These points are located on a grid of 2,000 frequencies
    and refined between grid points. Polynomials in z would lose too many digits for a dozen states.
    """
    grid = frequencies(loop.period)
    response = _response(loop, grid)
    crossovers = _crossings(loop, grid, response, lambda L: 1.0 - 2.0 / (1.0 + np.abs(L)))
    phases = np.degrees(np.angle(-_response(loop, crossovers)))
    real_crossings = _crossings(loop, grid, response, lambda L: np.angle(-L))
    magnitudes = np.abs(_response(loop, real_crossings))
    gains = np.array([*1.0 / magnitudes, *(_gain_where_real(loop, z) for z in (1.0, -1.0))])
    closed = _sensitivity(loop)
    additional = np.append(near_modes(closed, grid), math.pi / loop.period)
    all_frequencies = np.append(grid, additional)
    order = np.argsort(all_frequencies)
    all_frequencies, S = all_frequencies[order], np.append(1.0 / (1.0 + response), _response(closed, additional))[order]
    return Margins(
        gain=decibel(np.min(gains[gains > 1.0], initial=np.inf)),
        gain_reduction=-decibel(np.max(gains[gains < 1.0], initial=0.0)),
        phase=float(np.min(np.abs(phases), initial=np.inf)),
        delay=float(np.min(np.radians(phases % 360.0) / crossovers, initial=np.inf)),
        disk=1.0 / _peak(closed, all_frequencies, S, lambda s: np.abs(s - 0.5)),
        crossover=float(np.max(crossovers, initial=0.0)),
        sensitivity=_peak(closed, all_frequencies, S, np.abs),
        bandwidth=_bandwidth(loop, grid, response),
    )


class FastMargins(NamedTuple):
    """Gain margins (dB), phase margins (degrees) and delay margins (s) of many loops, as arrays of equal shape."""

    gain: np.ndarray
    phase: np.ndarray
    delay: np.ndarray


def fast_margins(responses: np.ndarray, grid: np.ndarray) -> FastMargins:
    """Return the margins of many stable loops by linear interpolation on a grid, for searches and maps.

    Args:
        responses: (..., frequencies) frequency responses L of the loops on the grid.
        grid: (frequencies,) frequencies, rad/s.
    """
    size = np.log(np.maximum(np.abs(responses), 1e-300))
    angle = np.angle(-responses)  # The angle is measured from the direction of -1, so that 0 is the critical direction.
    logs = np.log(grid)
    crosses = size[..., :-1] * size[..., 1:] < 0.0
    fraction_crossed = np.where(crosses, size[..., :-1] / (size[..., :-1] - size[..., 1:] + ~crosses), 0.0)
    phase = _wrapped(angle[..., :-1] + fraction_crossed * _wrapped(np.diff(angle, axis=-1)))
    frequency = np.exp(logs[:-1] + fraction_crossed * np.diff(logs))
    # A sign change of the angle means that L passes the critical direction, unless the angle wraps around.
    flips = (angle[..., :-1] * angle[..., 1:] < 0.0) & (np.abs(np.diff(angle, axis=-1)) < np.pi)
    fraction = np.where(flips, angle[..., :-1] / (angle[..., :-1] - angle[..., 1:] + ~flips), 0.0)
    gain = -(size[..., :-1] + fraction * np.diff(size, axis=-1)) * 20.0 / math.log(10.0)
    end_gain = 20.0 * np.log10(_gain_at_nyquist_frequency(responses))
    return FastMargins(
        np.minimum(
            np.where(flips & (gain > 0.0), gain, np.inf).min(axis=-1), np.where(end_gain > 0.0, end_gain, np.inf)
        ),
        np.degrees(np.where(crosses, np.abs(phase), np.inf).min(axis=-1)),
        np.where(crosses, (phase % (2.0 * np.pi)) / frequency, np.inf).min(axis=-1),
    )


def _wrapped(angles: np.ndarray) -> np.ndarray:
    """Return angles wrapped to [-π, π], rad."""
    turns: np.ndarray = np.rint(angles / (2.0 * np.pi))
    return angles - 2.0 * np.pi * turns


def frequencies(period: float, *, points: int = _NUM_FREQUENCIES, lowest: float = _MIN_FREQUENCY) -> np.ndarray:
    """Return frequencies (points,) from `lowest` to just below the Nyquist frequency, rad/s."""
    return np.geomspace(lowest, 0.9999 * math.pi / period, points)


def _response(loop: SampledSystem, grid: np.ndarray) -> np.ndarray:
    """Return the response L (frequencies,) of a loop with one input and one output, at frequencies in rad/s."""
    return loop.response(np.exp(1j * grid * loop.period))[:, 0, 0]


def _crossings(
    loop: SampledSystem, grid: np.ndarray, response: np.ndarray, function: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return the frequencies (crossings,) at which a function of L crosses zero, with a relative error of 1e-9.

    Args:
        loop: loop with one input and one output.
        grid: (frequencies,) grid that separates the zeros of the function, rad/s.
        response: (frequencies,) frequency response L on the grid.
        function: elementwise function of L. Steps of π or more count as jumps, not as crossings.
    """
    values = function(response)
    ends = np.stack([grid[:-1], grid[1:]], axis=1)[_passes_zero(values)]
    for _ in range(2):
        inside = np.linspace(ends[:, 0], ends[:, 1], _NUM_PARTS + 1, axis=1)
        values = function(_response(loop, inside.ravel())).reshape(inside.shape)
        passes = _passes_zero(values)
        # The refinement may show that a sign change between the ends of an interval is a jump.
        real = passes.any(axis=1)
        inside, values, first = inside[real], values[real], np.argmax(passes[real], axis=1)
        pairs = np.stack([first, first + 1], axis=1)
        ends, values = (np.take_along_axis(each, pairs, axis=1) for each in (inside, values))
    (low, high), (start, end) = ends.T, values.T
    fraction = np.divide(start, start - end, out=np.zeros_like(start), where=start != end)
    return low + np.clip(fraction, 0.0, 1.0) * (high - low)


def _passes_zero(values: np.ndarray) -> np.ndarray:
    """Return a mask of the steps, along the last axis, in which values cross zero without a jump."""
    return np.diff(values > 0.0, axis=-1) & (np.abs(np.diff(values, axis=-1)) < np.pi)


def _gain_at_nyquist_frequency(responses: np.ndarray) -> np.ndarray:
    """Return the gain at which a pole crosses the unit circle at z = -1, where L is real; infinite if none crosses.

    This point corresponds to the Nyquist frequency, the end of the frequency grid.
    """
    end = responses[..., -1].real
    return np.where(end < 0.0, -1.0 / np.where(end < 0.0, end, -1.0), np.inf)


def _gain_where_real(loop: SampledSystem, z: float) -> float:
    """Return the gain at which a pole crosses the unit circle at z = 1 or -1.

    The gain is infinite if no pole can cross at this point, as at z = 1 in a loop with an integrator.
    """
    if np.abs(loop.poles() - z).min() < 1e-9:
        return math.inf
    # Rounding moves the poles of several integrators slightly away from z = 1, where L is then finite but very large.
    try:
        value = loop.response(np.array([z])).item().real
    except np.linalg.LinAlgError:
        return math.inf
    if abs(value) > _MIN_INTEGRATOR_GAIN:
        return math.inf
    return -1.0 / value if value < 0.0 else math.inf


def _sensitivity(loop: SampledSystem) -> SampledSystem:
    """Return S = 1 / (1 + L), the closed loop from an offset on the loop's signal to this signal."""
    sensitivity = 1.0 / (1.0 + loop.D)
    feedback = sensitivity * loop.C
    return replace(loop, A=loop.A - loop.B @ feedback, B=loop.B @ sensitivity, C=-feedback, D=sensitivity)


def near_modes(system: SampledSystem, grid: np.ndarray) -> np.ndarray:
    """Return additional frequencies (rad/s) around modes whose peaks can be narrower than the grid steps."""
    poles = system.poles()
    poles = poles[poles.imag > 0.0]
    frequency, decay = np.angle(poles) / system.period, -np.log(np.abs(poles)) / system.period
    narrow = decay < _MAX_NARROW_DECAY_RATIO * frequency
    frequencies_near = (
        frequency[narrow, np.newaxis] + np.outer(decay[narrow], np.linspace(-4.0, 4.0, _NUM_PARTS + 1))
    ).ravel()
    return frequencies_near[(frequencies_near > grid[0]) & (frequencies_near < grid[-1])]


def _peak(
    system: SampledSystem, grid: np.ndarray, response: np.ndarray, size: Callable[[np.ndarray], np.ndarray]
) -> float:
    """Return the largest magnitude of a response over all frequencies, with a relative error of about 1e-9.

    Args:
        system: system with one input and one output.
        grid: (frequencies,) frequencies, with at most one peak between neighbours, rad/s.
        response: (frequencies,) response of the system on the grid.
        size: elementwise function whose maximum over the response is the peak.
    """
    values = size(response)
    padded = np.pad(values, 1, constant_values=-np.inf)
    tops = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    tops = tops[np.argsort(values[tops])[-_NUM_PEAKS:]]
    low, high = grid[np.maximum(tops - 1, 0)], grid[np.minimum(tops + 1, len(grid) - 1)]
    for _ in range(_NUM_DIVISIONS):
        inside = np.linspace(low, high, _NUM_PARTS + 1, axis=1)
        values = size(_response(system, inside.ravel())).reshape(inside.shape)
        best = np.argmax(values, axis=1)[:, np.newaxis]
        low, high = (
            np.take_along_axis(inside, index, axis=1)[:, 0]
            for index in (np.maximum(best - 1, 0), np.minimum(best + 1, _NUM_PARTS))
        )
    return float(values.max())


def _bandwidth(loop: SampledSystem, grid: np.ndarray, response: np.ndarray) -> float:
    """Return the lowest frequency at which |L / (1 + L)| falls below -3 dB, rad/s.

    The result is 0 if the magnitude is below -3 dB already at the grid's first frequency, and infinite if it is above
    -3 dB at all frequencies.
    """

    def excess(L: np.ndarray) -> np.ndarray:
        return 0.5 - 1.0 / (1.0 + math.sqrt(2.0) * np.abs(L / (1.0 + L)))

    if excess(response[0]) < 0.0:
        return 0.0
    return float(np.min(_crossings(loop, grid, response, excess), initial=np.inf))


def decibel(factor: float) -> float:
    """Convert a gain factor to dB."""
    return 20.0 * math.log10(factor) if factor > 0.0 else -math.inf
