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
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from drake_quad.compiled import compiled, formula
from drake_quad.elementary import log, sin_cos, sqrt
from drake_quad.seeding import child_words

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
        seed: of the study.
        samples: their N numbers in the study.
        kind: of what is drawn.
        name: of what it is for.
    """
    label = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
    return mixed(_sample_words(seed, tuple(samples), kind) ^ np.uint64(label))


@functools.lru_cache(maxsize=8)
def _sample_words(seed: int, samples: tuple[int, ...], kind: Kind) -> np.ndarray:
    """The (N,) numbers that tell the samples apart, uint64."""
    return child_words(seed, np.array(samples), int(kind))


@formula
def mixed(state: Any) -> Any:
    """SplitMix64's number for each state, uint64."""
    state = (state ^ (state >> _SHIFTS[0])) * _FACTORS[0]
    state = (state ^ (state >> _SHIFTS[1])) * _FACTORS[1]
    return state ^ (state >> _SHIFTS[2])


@formula
def word(state: Any, k: int) -> Any:
    """Number k of a stream with this state, uint64."""
    return mixed(state + np.uint64(k + 1) * _GAMMA)


@formula
def uniform_number(word: Any) -> Any:
    """A number between 0 and 1, and neither of them, from 52 bits of a word."""
    return (np.float64(word >> _FRACTION) + 0.5) * 2.0**-52


@formula
def normal_pair(word: Any) -> tuple[Any, Any]:
    """Two normal numbers, by Box and Muller: √(-2 ln u) times sine and cosine of 2π v, u and v of 32 bits each."""
    radius = sqrt(-2.0 * log((np.float64(word & _LOW_HALF) + 0.5) * 2.0**-32))
    sine, cosine = sin_cos(np.float64(word >> _HALF) * (math.tau * 2.0**-32))
    return radius * sine, radius * cosine


@compiled
def uniform_numbers(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (count, N) uniform numbers of N streams, from number `first` on."""
    numbers = np.empty((count, states.size))
    for k in range(count):
        for i in range(states.size):
            numbers[k, i] = uniform_number(word(states[i], first + k))
    return numbers


@compiled
def normal_pairs(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (2, count, N) standard normal numbers that `count` words of N streams make, from word `first` on."""
    pairs = np.empty((2, count, states.size))
    if count > states.size:  # the inner loop should be the longer one
        for i in range(states.size):
            for k in range(count):
                pairs[0, k, i], pairs[1, k, i] = normal_pair(word(states[i], first + k))
    else:
        for k in range(count):
            for i in range(states.size):
                pairs[0, k, i], pairs[1, k, i] = normal_pair(word(states[i], first + k))
    return pairs


def parameter_numbers(seed: int, samples: Sequence[int], path: str) -> np.ndarray:
    """The (N,) numbers in (0, 1) from which the field at a path is drawn."""
    return uniform_numbers(stream_states(seed, samples, Kind.PARAMETERS, path), 0, 1)[0]
