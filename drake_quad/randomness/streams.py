"""Streams of the random numbers of a study.

A study has one seed, and each of its samples three kinds of random numbers: drawn parameters, wind, and noise. Every
one has a stream of its own, named by kind and by what it is for. So a sample is the same whatever else is drawn, in
which order, beside which other samples and on which machine.

NumPy's generators draw for one sample at a time, which took a seventh of the time of a fleet's flight. So the numbers
of a stream are those of SplitMix64 (G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom number
generators", OOPSLA 2014), which makes number k of every stream at once from k alone: its state moves by a constant
and is mixed.
"""

import functools
import hashlib
import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.elementary import float_of, log, sin_cos, sqrt, untyped, where, word_of
from drake_quad.framework.formulas import Tick
from drake_quad.randomness.seeding import child_words
from drake_quad.signals import Number, Row

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Of a number's 64 bits the first 52 make a uniform number: with half a bit more it is a float still, and below 1.
_FRACTION = np.uint64(12)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
_HALF, _LOW_HALF = np.uint64(32), np.uint64(2**32 - 1)


class StreamKind(IntEnum):
    """Of random numbers, as in the second entry of a seed sequence's spawn key."""

    PARAMETERS = 0
    WIND = 1
    NOISE = 2


# That of all samples, or one for each.
Seeds = int | tuple[int, ...]


def stream_states(seed: Seeds, samples: Sequence[int], kind: StreamKind, name: str) -> np.ndarray:
    """Return the initial states (N,) of the streams of some samples: SplitMix64 states from NumPy's seed sequences.

    Args:
        seed: of all samples, or of each.
        samples: N numbers of samples.
        kind: what the numbers are for.
        name: of the stream, unlike that of any other of its kind.
    """
    label = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    return mixed(_sample_words(seed, tuple(samples), kind) ^ np.uint64(label))


@functools.lru_cache(maxsize=8)
def _sample_words(seed: Seeds, samples: tuple[int, ...], kind: StreamKind) -> np.ndarray:
    """Return the (N,) numbers that tell the samples apart, uint64."""
    return child_words(seed if isinstance(seed, int) else np.array(seed), np.array(samples), int(kind))


class StreamState(NamedTuple):
    """Initial state of a stream: the halves of SplitMix64's state, two whole numbers.

    Attributes:
        high: of 32 bits.
        low: of 32 bits.
    """

    high: Number
    low: Number

    @classmethod
    def of(cls, states: np.ndarray) -> "StreamState":
        """Return the halves of uint64 states."""
        return cls(untyped((states >> _HALF).astype(float)), untyped((states & _LOW_HALF).astype(float)))

    @property
    def word(self) -> Any:
        """The state, uint64."""
        return (word_of(self.high) << _HALF) | word_of(self.low)


def random_numbers(state: StreamState, tick: Tick, num_rows: int, normal: bool) -> tuple[Row, ...]:
    """Return the numbers of a stream at a tick.

    Args:
        state: of the stream.
        tick: among those of the stream.
        num_rows: numbers of a tick.
        normal: whether they are standard normal; else they are uniform from 0 to 1.
    """
    word = state.word
    if normal:
        # A word makes two: one for a tick, one for the next.
        first = tick.pair * float(num_rows)
        pairs = [normal_pair(moved(word, first + float(row))) for row in range(num_rows)]
        return tuple([where(tick.second, second, number) for number, second in pairs])
    first = (2.0 * tick.pair + where(tick.second, 1.0, 0.0)) * float(num_rows)
    return tuple([uniform_number(moved(word, first + float(row))) for row in range(num_rows)])


def moved(word: Any, number: Row) -> Any:
    """Return the state from which the word `number` of a stream, counted from 0, is mixed."""
    return word + word_of(number + 1.0) * _GAMMA


def mixed(state: Any) -> Any:
    """SplitMix64's word for each state, uint64."""
    state = (state ^ (state >> _SHIFTS[0])) * _FACTORS[0]
    state = (state ^ (state >> _SHIFTS[1])) * _FACTORS[1]
    return state ^ (state >> _SHIFTS[2])


def uniform_number(state: Any) -> Row:
    """Return a number between 0 and 1, and neither of them, from 52 bits of a word; given the word's state, uint64."""
    return (float_of(mixed(state) >> _FRACTION) + 0.5) * 2.0**-52


def normal_pair(state: Any) -> tuple[Row, Row]:
    """Two normal numbers, by Box and Muller: √(-2 ln u) times sine and cosine of 2π v, u and v of 32 bits each."""
    word = mixed(state)
    radius = sqrt(-2.0 * log((float_of(word & _LOW_HALF) + 0.5) * 2.0**-32, normal=True))
    sine, cosine = sin_cos(float_of(word >> _HALF) * (math.tau * 2.0**-32))
    return radius * sine, radius * cosine


def parameter_numbers(seed: Seeds, samples: Sequence[int], path: str) -> np.ndarray:
    """Return the (N,) numbers in (0, 1) from which the field at a path is drawn."""
    return untyped(uniform_number(moved(stream_states(seed, samples, StreamKind.PARAMETERS, path), 0.0)))
