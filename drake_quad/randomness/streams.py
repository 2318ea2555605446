"""Where every random number of a study comes from.

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
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from drake_quad.framework.elementary import bits_of, float_of, log, sin_cos, sqrt
from drake_quad.framework.formulas import run_on_arrays
from drake_quad.randomness.seeding import child_words
from drake_quad.signals import Row

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Of a number's 64 bits the first 52 make a uniform number: with half a bit more it is a float still, and below 1.
_FRACTION = np.uint64(12)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)
_HALF, _LOW_HALF = np.uint64(32), np.uint64(2**32 - 1)


class Kind(IntEnum):
    """Of random numbers, as in the second entry of a seed sequence's spawn key."""

    PARAMETERS = 0
    WIND = 1
    NOISE = 2


def stream_states(seed: int, samples: Sequence[int], kind: Kind, name: str) -> np.ndarray:
    """Where the streams of some samples begin: the (N,) states of SplitMix64, from NumPy's seed sequences.

    Args:
        seed: of all samples.
        samples: N numbers of samples.
        kind: what the numbers are for.
        name: of the stream, unlike that of any other of its kind.
    """
    label = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    states: np.ndarray = mixed(_sample_words(seed, tuple(samples), kind) ^ np.uint64(label))
    return states


@functools.lru_cache(maxsize=8)
def _sample_words(seed: int, samples: tuple[int, ...], kind: Kind) -> np.ndarray:
    """The (N,) numbers that tell the samples apart, uint64."""
    return child_words(seed, np.array(samples), int(kind))


def words(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """What the words of N streams are mixed from, (count, N) uint64, from word `first` on."""
    places = np.arange(first + 1, first + 1 + count, dtype=np.uint64)
    moved: np.ndarray = states + (places * _GAMMA)[:, None]
    return moved


def mixed(state: Any) -> Any:
    """SplitMix64's word for each state, uint64."""
    state = (state ^ (state >> _SHIFTS[0])) * _FACTORS[0]
    state = (state ^ (state >> _SHIFTS[1])) * _FACTORS[1]
    return state ^ (state >> _SHIFTS[2])


def uniform_number(state: Row) -> Row:
    """A number between 0 and 1, and neither of them, from 52 bits of a word; given the bits of the word's state."""
    return (float_of(mixed(bits_of(state)) >> _FRACTION) + 0.5) * 2.0**-52


def normal_pair(state: Row) -> tuple[Row, Row]:
    """Two normal numbers, by Box and Muller: √(-2 ln u) times sine and cosine of 2π v, u and v of 32 bits each."""
    word = mixed(bits_of(state))
    radius = sqrt(-2.0 * log((float_of(word & _LOW_HALF) + 0.5) * 2.0**-32))
    sine, cosine = sin_cos(float_of(word >> _HALF) * (math.tau * 2.0**-32))
    return radius * sine, radius * cosine


def uniform_numbers(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (count, N) uniform numbers of N streams, from number `first` on."""
    (numbers,) = _made(uniform_number, 1, words(states, first, count))
    return numbers


def normal_pairs(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (2, count, N) standard normal numbers that `count` words of N streams make, from word `first` on."""
    return _made(normal_pair, 2, words(states, first, count))


def _made(formula: Callable[..., Any], num_rows: int, states: np.ndarray) -> np.ndarray:
    """The (rows, count, N) numbers that a formula makes of (count, N) states."""
    return run_on_arrays(formula, [states.ravel().view(float)], num_rows).reshape(num_rows, *states.shape)


def parameter_numbers(seed: int, samples: Sequence[int], path: str) -> np.ndarray:
    """The (N,) numbers in (0, 1) from which the field at a path is drawn."""
    (numbers,) = uniform_numbers(stream_states(seed, samples, Kind.PARAMETERS, path), 0, 1)
    drawn: np.ndarray = numbers
    return drawn
