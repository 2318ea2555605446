"""Random numbers of a sample: SplitMix64 with NumPy's seed sequences, and the method of Box and Muller."""

import hashlib
import math

import numpy as np

# Kinds of streams.
PARAMETERS = 0
WIND = 1
NOISE = 2
_MASK = 2**64 - 1  # 64-bit words


def mix_bits(word):
    """Apply the mixing function of SplitMix64 to a 64-bit word."""
    word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 & _MASK
    word = (word ^ (word >> 27)) * 0x94D049BB133111EB & _MASK
    return word ^ (word >> 31)


class Stream:
    """Stream of random numbers for a port.

    Args:
        seed: seed of the study.
        sample: index of the sample in the study.
        kind: WIND or NOISE.
        name: name of the system and its port.
        rows: number of random numbers for each tick.
    """

    def __init__(self, seed, sample, kind, name, rows):
        sequence = np.random.SeedSequence(entropy=seed, spawn_key=(sample, kind))
        label = int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest(), "little")
        self.state, self.rows = mix_bits(int(sequence.generate_state(1, np.uint64)[0]) ^ label), rows

    def word(self, k):
        """Return word k of the stream, 64 bits."""
        return mix_bits(self.state + (k + 1) * 0x9E3779B97F4A7C15 & _MASK)

    def uniform(self, tick):
        """Return uniform numbers (rows,) between 0 and 1, with 52 bits."""
        return np.array([((self.word(tick * self.rows + i) >> 12) + 0.5) * 2.0**-52 for i in range(self.rows)])

    def normal(self, tick):
        """Return standard normal numbers (rows,). Each word gives two, for an even tick and for the next tick."""
        numbers = []
        for i in range(self.rows):
            word = self.word((tick // 2) * self.rows + i)
            radius = math.sqrt(-2.0 * math.log(((word & 0xFFFFFFFF) + 0.5) * 2.0**-32))
            angle = math.tau * (word >> 32) * 2.0**-32
            numbers.append(radius * (math.cos(angle) if tick % 2 else math.sin(angle)))
        return np.array(numbers)
