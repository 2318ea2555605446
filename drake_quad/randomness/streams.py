"""Streams of the random numbers of a study.

A study has a seed, and each of its samples uses three kinds of random numbers: drawn parameters, wind, and noise. Every
drawn field and every port has its own stream, which is identified by its kind and name. A sample therefore does not
depend on other random numbers, the order of drawing, other samples or the machine.

NumPy's generators draw the numbers of one sample at a time, which took a seventh of the time to simulate a fleet.
Streams therefore use SplitMix64 (G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014). SplitMix64 computes number k of a stream directly from k, for all streams at once: each
number increments the state by a constant, and the number is a hash of the state.
"""

import functools
import hashlib
import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.elementary import from_uint64, log, sin_cos, sqrt, to_uint64, untyped, where
from drake_quad.framework.formulas import Tick
from drake_quad.randomness.seeding import child_words
from drake_quad.signals import Number, Row

# Constants of SplitMix64.
_GAMMA = np.uint64(0x9E3779B97F4A7C15)  # increment of the state
# Factors of the two multiplications that mix the bits of a state.
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Right shifts (bits) before these multiplications, and after the last one.
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
# A uniform number is (n + 1/2) / 2⁵², where n consists of the first 52 bits of a word. It is therefore above 0 and
# below 1.
_FRACTION_SHIFT = np.uint64(12)
_HALF_WORD_SHIFT = np.uint64(32)  # bits in half of a 64-bit word
_LOW_HALF_MASK = np.uint64(2**32 - 1)  # mask of the low 32 bits of a 64-bit word


class StreamKind(IntEnum):
    """Purpose of random numbers, which is the second entry of the spawn key of a seed sequence."""

    PARAMETERS = 0
    WIND = 1
    NOISE = 2


Seeds = int | tuple[int, ...]
"""Seed of all samples, or a tuple with the seed of each sample."""


class Samples(NamedTuple):
    """Samples of a study, one for each vehicle of a fleet.

    Attributes:
        seed: seed of all samples, or a tuple with the seed of each sample.
        indices: index of the sample of each vehicle in the first noise period.
        later_indices: indices of the vehicles' samples in each noise period after the first; empty if there is only
            one noise period.
        period: length of each noise period, s; infinite if there is only one noise period.
        wind_seed: seed of the wind, which vehicles of one world share; None for `seed`.
    """

    seed: Seeds
    indices: Sequence[int]
    later_indices: Sequence[Sequence[int]] = ()
    period: float = math.inf
    wind_seed: int | None = None

    def seed_of(self, kind: StreamKind) -> Seeds:
        """Return the seed of the streams of a kind."""
        return self.wind_seed if kind is StreamKind.WIND and self.wind_seed is not None else self.seed

    @property
    def num_periods(self) -> int:
        """Number of noise periods, in each of which a vehicle has the noise of one sample."""
        return 1 + len(self.later_indices)


def stream_states(seed: Seeds, samples: Sequence[int], kind: StreamKind, name: str) -> np.ndarray:
    """Return the initial states (N,) of the streams of some samples: SplitMix64 states from NumPy's seed sequences.

    Args:
        seed: seed of all samples, or a tuple with the seed of each sample.
        samples: indices of N samples.
        kind: purpose of the random numbers.
        name: name of the stream, which is unique among the streams of its kind.
    """
    label = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    return splitmix64(_sample_words(seed, tuple(samples), kind) ^ np.uint64(label))


@functools.lru_cache(maxsize=8)
def _sample_words(seed: Seeds, samples: tuple[int, ...], kind: StreamKind) -> np.ndarray:
    """Return the (N,) 64-bit words of the samples, uint64. The words of different samples are independent."""
    return child_words(seed if isinstance(seed, int) else np.array(seed), np.array(samples), int(kind))


class StreamState(NamedTuple):
    """Initial state of a stream: SplitMix64's state of 64 bits, as two whole numbers.

    Attributes:
        high: upper 32 bits.
        low: lower 32 bits.
    """

    high: Number
    low: Number

    @classmethod
    def of(cls, states: np.ndarray) -> "StreamState":
        """Return a `StreamState` for states that are given as an array of uint64 numbers."""
        return cls(
            untyped((states >> _HALF_WORD_SHIFT).astype(float)), untyped((states & _LOW_HALF_MASK).astype(float))
        )

    @property
    def word(self) -> Any:
        """State of the stream as a single 64-bit word (uint64)."""
        return (to_uint64(self.high) << _HALF_WORD_SHIFT) | to_uint64(self.low)


def random_numbers(state: StreamState, tick: Tick, num_rows: int, normal: bool) -> tuple[Row, ...]:
    """Return the random numbers of a stream at a tick.

    Args:
        state: initial state of the stream.
        tick: tick of the stream.
        num_rows: number of random numbers.
        normal: True for standard normal numbers, False for uniform numbers from 0 to 1.
    """
    word = state.word
    if normal:
        # A word yields two normal numbers, which are used at two successive ticks.
        first = tick.pair * float(num_rows)
        pairs = [normal_pair(state_of_number(word, first + float(row))) for row in range(num_rows)]
        return tuple([where(tick.second, second, number) for number, second in pairs])
    first = (2.0 * tick.pair + where(tick.second, 1.0, 0.0)) * float(num_rows)
    return tuple([uniform_number(state_of_number(word, first + float(row))) for row in range(num_rows)])


def state_of_number(word: Any, index: Row) -> Any:
    """Return the state for the random number with an index, counted from 0, given the initial state, both uint64."""
    return word + to_uint64(index + 1.0) * _GAMMA


def splitmix64(state: Any) -> Any:
    """Return SplitMix64's hash of each state, uint64."""
    state = (state ^ (state >> _SHIFTS[0])) * _FACTORS[0]
    state = (state ^ (state >> _SHIFTS[1])) * _FACTORS[1]
    return state ^ (state >> _SHIFTS[2])


def uniform_number(state: Any) -> Row:
    """Return a uniform number in the open interval (0, 1), given the SplitMix64 state of the number, uint64."""
    return (from_uint64(splitmix64(state) >> _FRACTION_SHIFT) + 0.5) * 2.0**-52


def normal_pair(state: Any) -> tuple[Row, Row]:
    """Return two normal numbers, given their SplitMix64 state, uint64.

    By the method of Box and Muller, the numbers are √(-2 ln u) times sine and cosine of 2π v, with u and v of 32 bits
    each.
    """
    word = splitmix64(state)
    radius = sqrt(-2.0 * log((from_uint64(word & _LOW_HALF_MASK) + 0.5) * 2.0**-32, normal=True))
    sine, cosine = sin_cos(from_uint64(word >> _HALF_WORD_SHIFT) * (math.tau * 2.0**-32))
    return radius * sine, radius * cosine


def parameter_numbers(seed: Seeds, samples: Sequence[int], path: str) -> np.ndarray:
    """Return the (N,) uniform numbers in (0, 1) from which the values of the field at a path are drawn."""
    return untyped(uniform_number(state_of_number(stream_states(seed, samples, StreamKind.PARAMETERS, path), 0.0)))
