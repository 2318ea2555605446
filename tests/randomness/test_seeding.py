"""Comparison of the seeding of samples with the seed sequences of NumPy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_quad.randomness.seeding import child_words


@given(
    entropy=st.integers(0, 2**63 - 1) | st.integers(0, 2**200),
    samples=st.lists(st.integers(0, 2**31 - 1), min_size=1, max_size=4),
    kind=st.integers(0, 2),
)
def test_child_words_agree_with_numpys_seed_sequence(entropy, samples, kind):
    actual = child_words(entropy, np.array(samples), kind)
    for word, sample in zip(actual, samples, strict=True):
        sequence = np.random.SeedSequence(entropy, spawn_key=(sample, kind))
        assert word == sequence.generate_state(1, np.uint64)[0]


@pytest.mark.slow
@given(seeds=st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=5), kind=st.integers(0, 2))
def test_child_words_of_several_seeds_equal_the_words_of_each_seed_alone(seeds, kind):
    samples = np.arange(len(seeds)) * 7
    actual = child_words(np.array(seeds), samples, kind)
    assert actual.tolist() == [
        child_words(seed, np.array([sample]), kind)[0] for seed, sample in zip(seeds, samples, strict=True)
    ]
