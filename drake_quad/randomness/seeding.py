"""NumPy's SeedSequence for arrays of samples.

Simulating a flight takes three milliseconds, so the 12 µs of each `numpy.random.SeedSequence` are noticeable. This
module implements the algorithm of SeedSequence, which is M. E. O'Neill's seed_seq_fe ("Developing a seed_seq
alternative", 2015), on arrays. A test compares the module with NumPy.
"""

from typing import Any

import numpy as np

# Constants of seed_seq_fe, with the names of NumPy's implementation.
_INIT_A = 0x43B0D7E5
_MULT_A = 0x931E8875
_INIT_B = 0x8B51F9DD
_MULT_B = 0x58F38DED
_MIX_MULT_L = np.uint32(0xCA01F9DD)
_MIX_MULT_R = np.uint32(0x4973F715)
_XSHIFT = np.uint32(16)
_POOL_SIZE = 4
_MASK_32 = 0xFFFFFFFF


class _Hash:
    """Hash function of 32-bit words, whose constant changes with every call."""

    def __init__(self, constant: int, factor: int) -> None:
        self._constant, self._factor = constant, factor

    def __call__(self, words: np.ndarray) -> np.ndarray:
        words = words ^ np.uint32(self._constant)
        self._constant = self._constant * self._factor & _MASK_32
        words = words * np.uint32(self._constant)
        return words ^ (words >> _XSHIFT)


def child_words(entropy: int | np.ndarray, samples: np.ndarray, kind: int) -> np.ndarray:
    """Return the (n,) first 64 bits of `SeedSequence(entropy, spawn_key=(sample, kind))` for each sample.

    Args:
        entropy: entropy, at least 0, or (n,) numbers below 2⁶³, one for each sample.
        samples: (n,) indices of samples, from 0 to 2³² - 1.
        kind: number that stands for the use of the random numbers, from 0 to 2³² - 1; see `StreamKind`.
    """
    words = [np.broadcast_to(word, len(samples)).astype(np.uint32) for word in _words(entropy)]
    words += [samples.astype(np.uint32), np.full(len(samples), kind, dtype=np.uint32)]
    hash_a = _Hash(_INIT_A, _MULT_A)
    pool = [hash_a(word) for word in words[:_POOL_SIZE]]
    for source in range(_POOL_SIZE):
        for target in range(_POOL_SIZE):
            if source != target:
                pool[target] = _mix(pool[target], hash_a(pool[source]))
    for word in words[_POOL_SIZE:]:
        pool = [_mix(each, hash_a(word)) for each in pool]
    hash_b = _Hash(_INIT_B, _MULT_B)
    low, high = (hash_b(each).astype(np.uint64) for each in pool[:2])
    return low | (high << np.uint64(32))


def _words(entropy: int | np.ndarray) -> list[Any]:
    """Return the 32-bit words of one number or an array, least significant word first, padded with zeros."""
    words = [entropy & _MASK_32]
    while np.any(entropy := entropy >> 32):
        words.append(entropy & _MASK_32)
    return words + [0] * (_POOL_SIZE - len(words))


def _mix(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    result: np.ndarray = _MIX_MULT_L * x - _MIX_MULT_R * y
    return result ^ (result >> _XSHIFT)
