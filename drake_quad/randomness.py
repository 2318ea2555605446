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
from collections.abc import Sequence
from enum import IntEnum

import numpy as np

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
# Of a number's 64 bits the first 52 make a uniform number: with half a bit more it is a float still, and below 1.
_FRACTION = np.uint64(12)


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
    sequences = [np.random.SeedSequence(entropy=seed, spawn_key=(sample, int(kind))) for sample in samples]
    return np.concatenate([sequence.generate_state(1, np.uint64) for sequence in sequences])


def mixed(state: np.ndarray) -> np.ndarray:
    """SplitMix64's number for each state, uint64."""
    result = state ^ (state >> np.uint64(30))
    result *= _FACTORS[0]
    result ^= result >> np.uint64(27)
    result *= _FACTORS[1]
    result ^= result >> np.uint64(31)
    return result


def words(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (count, N) numbers of N streams, uint64, from number `first` on."""
    steps = np.arange(first + 1, first + 1 + count, dtype=np.uint64) * _GAMMA
    return mixed(states + steps[:, None])


def uniform_numbers(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (count, N) uniform numbers in (0, 1) of N streams, from number `first` on."""
    numbers = (words(states, first, count) >> _FRACTION).astype(float)
    numbers += 0.5
    numbers *= 2.0**-52
    return numbers


def normal_pairs(states: np.ndarray, first: int, count: int) -> np.ndarray:
    """The (2, count, N) standard normal numbers that `count` numbers of N streams make, from number `first` on.

    By Box and Muller: √(-2 ln u) times sine and cosine of 2π v, with u and v from 32 bits each, in single precision.
    """
    halves = words(states, first, count).astype("<u8", copy=False).view("<u4").reshape(count, -1, 2)
    radius = halves[:, :, 0].astype(np.float32)
    radius += np.float32(0.5)
    radius *= np.float32(2.0**-32)
    np.log(radius, out=radius)
    radius *= np.float32(-2.0)
    np.sqrt(radius, out=radius)
    angle = halves[:, :, 1].astype(np.float32)
    angle *= np.float32(2.0 * np.pi * 2.0**-32)
    pairs = np.empty((2, *angle.shape), np.float32)
    np.sin(angle, out=pairs[0])
    np.cos(angle, out=pairs[1])
    pairs *= radius
    return pairs


def parameter_numbers(seed: int, samples: Sequence[int], path: str) -> np.ndarray:
    """The (N,) numbers in (0, 1) from which the field at a path is drawn."""
    return uniform_numbers(stream_states(seed, samples, Kind.PARAMETERS, path), 0, 1)[0]
