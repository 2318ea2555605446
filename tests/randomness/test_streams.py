"""Random numbers: those of SplitMix64, distributed as they should be, and independent of everything else."""

import numpy as np
import pytest
from scipy import stats

from drake_quad.randomness.streams import (
    Kind,
    mixed,
    normal_pair,
    normal_pairs,
    parameter_numbers,
    stream_states,
    uniform_number,
    uniform_numbers,
    words,
)


def test_numbers_are_those_of_splitmix64():
    """The published sequence of the seed 1234567."""
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    state = np.array([1234567], dtype=np.uint64)
    states = words(state, 0, 5)
    assert mixed(states)[:, 0].tolist() == expected
    # In machine code as in NumPy, and as by hand: 52 bits for a uniform number, 32 for each of a pair.
    bits = states.view(float)
    np.testing.assert_array_equal(uniform_numbers(state, 0, 5), uniform_number(bits))
    np.testing.assert_array_equal(uniform_numbers(state, 0, 5)[:, 0], [((w >> 12) + 0.5) / 2**52 for w in expected])
    np.testing.assert_allclose(normal_pairs(state, 0, 5), normal_pair(bits), rtol=1e-14)
    radius = [np.sqrt(-2.0 * np.log(((w & 0xFFFFFFFF) + 0.5) / 2**32)) for w in expected]
    angle = [2.0 * np.pi * (w >> 32) / 2**32 for w in expected]
    pairs = [radius * np.sin(angle), radius * np.cos(angle)]
    np.testing.assert_allclose(normal_pairs(state, 0, 5)[:, :, 0], pairs, rtol=1e-13)
    np.testing.assert_array_equal(normal_pairs(state, 3, 2), normal_pairs(state, 0, 5)[:, 3:])


def unmixed(word):
    """The state that is mixed to a word, both 64 bits: SplitMix64's steps backwards, with whole numbers."""
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, 1)):
        shifted = word
        for _ in range(64 // shift):
            shifted = word ^ (shifted >> shift)
        word = shifted * pow(factor, -1, 2**64) % 2**64
    return word


def test_mixing_is_one_to_one():
    """It can be undone."""
    states = np.random.default_rng(0).integers(0, 2**64, 2000, dtype=np.uint64)
    assert [unmixed(word) for word in mixed(states).tolist()] == states.tolist()
    states = np.arange(200_000, dtype=np.uint64)
    assert np.unique(mixed(states)).size == states.size


@pytest.fixture(scope="module")
def states():
    return stream_states(7, range(500), Kind.NOISE, "motion_capture.camera_noise")


@pytest.mark.slow
def test_normal_numbers_are_normal(states):
    numbers = normal_pairs(states, 0, 2000)
    assert stats.kstest(numbers[:, ::10].ravel(), "norm").pvalue > 1e-3
    n = numbers.size
    for power, expected, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs((numbers**power).mean() - expected) < 4.5 * np.sqrt(variance / n)
    assert (np.abs(numbers) > 5.0).sum() == pytest.approx(n * 2.0 * stats.norm.sf(5.0), abs=6.0)


def test_uniform_numbers_are_uniform(states):
    numbers = uniform_numbers(states, 0, 2000)
    assert 0.0 < numbers.min() < 1e-5
    assert 1.0 - 1e-5 < numbers.max() < 1.0
    assert stats.kstest(numbers[::10].ravel(), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("word", [0, 2**64 - 1])
def test_extreme_words_make_numbers_like_others(word):
    """As they are written, and in machine code, where the first number of a stream is mixed from its next state."""
    state = np.array([unmixed(word)], dtype=np.uint64)
    assert mixed(state) == word
    before = state - words(np.zeros(1, dtype=np.uint64), 0, 1)[0]
    for number in (uniform_number(state.view(float)), uniform_numbers(before, 0, 1)):
        assert 0.0 < number < 1.0
    for pair in (normal_pair(state.view(float)), normal_pairs(before, 0, 1)):
        assert np.isfinite(pair).all()


@pytest.mark.slow
def test_neighbours_in_time_in_the_fleet_and_in_a_pair_are_independent(states):
    numbers = normal_pairs(states, 0, 2000)
    limit = 4.5 / np.sqrt(numbers[0].size)
    for a, b in (
        (numbers[:, 1:], numbers[:, :-1]),
        (numbers[:, :, 1:], numbers[:, :, :-1]),
        (numbers[0], numbers[1]),
        (np.abs(numbers[0]), np.abs(numbers[1])),
        (numbers, normal_pairs(stream_states(7, range(500), Kind.NOISE, "command_link.noise"), 0, 2000)),
        (numbers, normal_pairs(stream_states(7, range(500), Kind.WIND, "motion_capture.camera_noise"), 0, 2000)),
        (numbers, normal_pairs(stream_states(8, range(500), Kind.NOISE, "motion_capture.camera_noise"), 0, 2000)),
    ):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < limit


def test_a_sample_has_its_numbers_wherever_it_is():
    many = stream_states(3, range(50), Kind.WIND, "fans.jet_noise")
    np.testing.assert_array_equal(stream_states(3, [41, 7], Kind.WIND, "fans.jet_noise"), many[[41, 7]])
    mass = parameter_numbers(3, range(1000), "vehicle.mass")
    np.testing.assert_array_equal(parameter_numbers(3, [9], "vehicle.mass"), mass[9:10])
    others = [parameter_numbers(3, range(1000), path) for path in ("vehicle.inertia[0]", "vehicle.inertia[1]")]
    assert np.unique(np.concatenate([mass, *others])).size == 3000
