"""Tests of the sorted indices of missing samples."""

import numpy as np
import pytest

from drake_quad.studies.missing_samples import MissingSamples


@pytest.mark.parametrize("seed", range(5))
def test_missing_samples_are_the_complement_of_the_present_ones(seed):
    rng = np.random.default_rng(seed)
    present = rng.permutation(50)[: rng.integers(51)]
    missing = MissingSamples(50, present)
    expected = sorted({*range(50)} - {*present.tolist()})
    assert [*missing] == expected
    assert len(missing) == len(expected)
    for first, last in rng.integers(55, size=(20, 2)).tolist():
        assert missing[first:last] == expected[first:last]


def test_an_index_beyond_the_end_is_an_error():
    missing = MissingSamples(3, np.array([1.0]))
    assert (missing[0], missing[-1]) == (0, 2)
    assert all(type(sample) is int for sample in missing)
    with pytest.raises(IndexError):
        missing[2]


def test_missing_samples_are_not_stored_in_a_list():
    missing = MissingSamples(2**31 - 1, np.array([2.0**30]))
    assert missing[2**30 - 1 : 2**30 + 1] == [2**30 - 1, 2**30 + 1]
    assert len(missing) == 2**31 - 2
