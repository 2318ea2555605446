"""How far a sampled loop is from instability."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drake_quad.analysis.sampled_system import SampledSystem

# Lowest frequency that is looked at, rad/s, and how many up to half the sampling rate.
_LOWEST, _POINTS = 1e-4, 2000
# Into how many parts the stretch between two frequencies is divided, twice, to find where L crosses something.
_PARTS = 32
# Size of L at standstill that only integrators reach.
_INTEGRATES = 1e6


class Margins(NamedTuple):
    """Margins of a loop of one signal, broken where its transfer function L is taken.

    Attributes:
        gain: factor by which the gain may rise, dB.
        gain_reduction: by which it may fall, dB, as a positive number; infinite if it may vanish.
        phase: degrees.
        delay: time by which the signal may be later, s.
        disk: largest α such that every gain between (1 - α/2) / (1 + α/2) and its inverse, with every phase to match,
            is stood (P. Seiler, A. Packard and P. Gahinet, "An introduction to disk margins", 2020).
        crossover: highest frequency at which |L| = 1, rad/s.
        sensitivity: peak of |1 / (1 + L)|.
        bandwidth: lowest frequency at which |L / (1 + L)| falls below -3 dB, rad/s.
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
    """The margins of a stable loop with one input and one output.

    Gain and phase margins are those of the frequency response itself, where it crosses the negative real axis and the
    unit circle between two of 2,000 points: a polynomial in z for a dozen states loses the digits that they need.
    """
    grid = frequencies(loop.period)
    response = _response(loop, grid)
    crossovers = _crossings(loop, grid, response, lambda L: 1.0 - 2.0 / (1.0 + np.abs(L)))
    phases = np.degrees(np.angle(-_response(loop, crossovers)))
    turns = _crossings(loop, grid, response, lambda L: np.angle(-L))
    sizes = np.abs(_response(loop, turns))
    gains = np.array([*1.0 / sizes, _gain_at_half_the_rate(response), _gain_at_standstill(loop)])
    complementary = np.abs(response / (1.0 + response))
    below = np.flatnonzero(complementary < math.sqrt(0.5))
    return Margins(
        gain=_decibel(np.min(gains[gains > 1.0], initial=np.inf)),
        gain_reduction=-_decibel(np.max(gains[gains < 1.0], initial=0.0)),
        phase=float(np.min(np.abs(phases), initial=np.inf)),
        delay=float(np.min(np.radians(phases % 360.0) / crossovers, initial=np.inf)),
        disk=float(1.0 / np.abs(1.0 / (1.0 + response) - 0.5).max()),
        crossover=float(np.max(crossovers, initial=0.0)),
        sensitivity=float(np.abs(1.0 / (1.0 + response)).max()),
        bandwidth=float(grid[below[0]]) if len(below) else math.inf,
    )


class FastMargins(NamedTuple):
    """Gain (dB), phase (degrees) and delay (s) margin of many loops at once, arrays of one shape."""

    gain: np.ndarray
    phase: np.ndarray
    delay: np.ndarray


def fast_margins(responses: np.ndarray, grid: np.ndarray) -> FastMargins:
    """The margins of many stable loops, by linear interpolation between frequencies, for searches and maps.

    Args:
        responses: (..., frequencies) of L.
        grid: (frequencies,) rad/s.
    """
    size = np.log(np.maximum(np.abs(responses), 1e-300))
    angle = np.angle(-responses)  # from -1, so that 0 is the critical point
    logs = np.log(grid)
    crosses = size[..., :-1] * size[..., 1:] < 0.0
    share = np.where(crosses, size[..., :-1] / (size[..., :-1] - size[..., 1:] + ~crosses), 0.0)
    turn = np.diff(angle, axis=-1)
    turn = turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
    phase = angle[..., :-1] + share * turn
    frequency = np.exp(logs[:-1] + share * np.diff(logs))
    # Where the curve passes the critical direction it does not jump to the other side of the circle.
    flips = (angle[..., :-1] * angle[..., 1:] < 0.0) & (np.abs(np.diff(angle, axis=-1)) < np.pi)
    part = np.where(flips, angle[..., :-1] / (angle[..., :-1] - angle[..., 1:] + ~flips), 0.0)
    gain = -(size[..., :-1] + part * np.diff(size, axis=-1)) * 20.0 / math.log(10.0)
    through = 20.0 * np.log10(_gain_at_half_the_rate(responses))
    return FastMargins(
        np.minimum(np.where(flips & (gain > 0.0), gain, np.inf).min(axis=-1), np.where(through > 0.0, through, np.inf)),
        np.degrees(np.where(crosses, np.abs(phase), np.inf).min(axis=-1)),
        np.where(crosses, (phase % (2.0 * np.pi)) / frequency, np.inf).min(axis=-1),
    )


def frequencies(period: float, *, points: int = _POINTS, lowest: float = _LOWEST) -> np.ndarray:
    """(points,) frequencies from the lowest (rad/s) up to just below half the sampling rate, rad/s."""
    return np.geomspace(lowest, 0.9999 * math.pi / period, points)


def _response(loop: SampledSystem, grid: np.ndarray) -> np.ndarray:
    """(frequencies,) L of a loop with one input and one output."""
    return loop.response(np.exp(1j * grid * loop.period))[:, 0, 0]


def _crossings(
    loop: SampledSystem, grid: np.ndarray, response: np.ndarray, of: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """(crossings,) frequencies at which a function of L passes zero without a jump, to 1e-9 of themselves.

    Args:
        loop: with one input and one output.
        grid: (frequencies,) rad/s, so dense that the function passes zero once between two of them.
        response: (frequencies,) L there.
        of: the function, elementwise; steps by π or more are jumps.
    """
    values = of(response)
    ends = np.stack([grid[:-1], grid[1:]], axis=1)[_passes_zero(values)]
    for _ in range(2):
        inside = np.linspace(ends[:, 0], ends[:, 1], _PARTS + 1, axis=1)
        values = of(_response(loop, inside.ravel())).reshape(inside.shape)
        passes = _passes_zero(values)
        # What changed sign from end to end may have done so by a jump inside.
        real = passes.any(axis=1)
        inside, values, first = inside[real], values[real], np.argmax(passes[real], axis=1)
        places = np.stack([first, first + 1], axis=1)
        ends, values = (np.take_along_axis(each, places, axis=1) for each in (inside, values))
    (low, high), (start, end) = ends.T, values.T
    share = np.divide(start, start - end, out=np.zeros_like(start), where=start != end)
    return low + np.clip(share, 0.0, 1.0) * (high - low)


def _passes_zero(values: np.ndarray) -> np.ndarray:
    """The mask of the steps along the last axis that do."""
    return np.diff(values > 0.0, axis=-1) & (np.abs(np.diff(values, axis=-1)) < np.pi)


def _gain_at_half_the_rate(responses: np.ndarray) -> np.ndarray:
    """The factor at which a pole leaves through z = -1, where L is real: the end of the grid; infinite if it cannot."""
    end = responses[..., -1].real
    return np.where(end < 0.0, -1.0 / np.where(end < 0.0, end, -1.0), np.inf)


def _gain_at_standstill(loop: SampledSystem) -> float:
    """The factor at which a pole leaves through z = 1; infinite if it cannot, as with an integrator in the loop."""
    if np.abs(loop.poles() - 1.0).min() < 1e-9:
        return math.inf
    # Rounding takes the poles of several integrators apart.
    try:
        value = loop.response(np.array([1.0])).item().real
    except np.linalg.LinAlgError:
        return math.inf
    if abs(value) > _INTEGRATES:
        return math.inf
    return -1.0 / value if value < 0.0 else math.inf


def _decibel(factor: float) -> float:
    return 20.0 * math.log10(factor) if factor > 0.0 else -math.inf
