"""Tests of the values, distributions and independence of random numbers."""

import numpy as np
import pytest
import scipy

from drake_quad.framework.formulas import CurrentTick, kernel
from drake_quad.framework.records import layout_of
from drake_quad.randomness.streams import (
    StreamKind,
    StreamState,
    normal_pair,
    parameter_numbers,
    random_numbers,
    splitmix64,
    state_of_number,
    stream_states,
    uniform_number,
)
from drake_quad.signals import Row


def numbers_of(states, ticks, *, normal):
    """Return the numbers (ticks, N) of streams with one number per tick, computed by machine code."""
    halves = np.concatenate(StreamState.of(states))
    arguments = layout_of(StreamState), CurrentTick(1.0), 1, normal
    run = kernel(random_numbers, arguments, (layout_of(tuple[Row]),), single_vehicle=False)
    numbers = np.empty((len(ticks), states.size))
    for tick, row in zip(ticks, numbers, strict=True):
        run(states.size, float(tick), row, halves)
    return numbers


def normal_pairs(states, count):
    """Return the normal numbers (2, count, N) of the first `count` 64-bit words of each stream."""
    return numbers_of(states, range(2 * count), normal=True).reshape(count, 2, -1).swapaxes(0, 1)


def test_numbers_agree_with_splitmix64():
    """The expected sequence was published for the seed 1234567."""
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    state = np.array([1234567], dtype=np.uint64)
    states = np.concatenate([state_of_number(state, float(number)) for number in range(5)])
    assert splitmix64(states).tolist() == expected
    # The expected values use 52 bits of a word for a uniform number, and 32 bits for each of its two normal numbers.
    uniform, (first, second) = numbers_of(state, range(5), normal=False)[:, 0], normal_pairs(state, 5)[:, :, 0]
    np.testing.assert_array_equal(uniform, uniform_number(states))
    np.testing.assert_array_equal(uniform, [((w >> 12) + 0.5) / 2**52 for w in expected])
    np.testing.assert_allclose([first, second], normal_pair(states), rtol=1e-14)
    radius = [np.sqrt(-2.0 * np.log(((w & 0xFFFFFFFF) + 0.5) / 2**32)) for w in expected]
    angle = [2.0 * np.pi * (w >> 32) / 2**32 for w in expected]
    np.testing.assert_allclose([first, second], [radius * np.sin(angle), radius * np.cos(angle)], rtol=1e-13)
    np.testing.assert_array_equal(numbers_of(state, [9, 6], normal=True)[:, 0], [second[4], first[3]])


def inverse_splitmix64(word):
    """Return the state with a given SplitMix64 hash, by inverting the steps of the hash with Python integers."""
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, 1)):
        shifted = word
        for _ in range(64 // shift):
            shifted = word ^ (shifted >> shift)
        word = shifted * pow(factor, -1, 2**64) % 2**64
    return word


def test_the_hash_of_splitmix64_is_invertible():
    states = np.random.default_rng(0).integers(0, 2**64, 2000, dtype=np.uint64)
    assert [inverse_splitmix64(word) for word in splitmix64(states).tolist()] == states.tolist()
    states = np.arange(200_000, dtype=np.uint64)
    assert np.unique(splitmix64(states)).size == states.size


@pytest.fixture(scope="module")
def states():
    return stream_states(7, range(500), StreamKind.NOISE, "motion_capture.camera_noise")


@pytest.mark.slow
def test_normal_numbers_have_a_normal_distribution(states):
    numbers = normal_pairs(states, 2000)
    assert scipy.stats.kstest(numbers[:, ::10].ravel(), "norm").pvalue > 1e-3
    n = numbers.size
    for power, expected, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs((numbers**power).mean() - expected) < 4.5 * np.sqrt(variance / n)
    assert (np.abs(numbers) > 5.0).sum() == pytest.approx(n * 2.0 * scipy.stats.norm.sf(5.0), abs=6.0)


def test_uniform_numbers_have_a_uniform_distribution(states):
    numbers = numbers_of(states, range(2000), normal=False)
    assert 0.0 < numbers.min() < 1e-5
    assert 1.0 - 1e-5 < numbers.max() < 1.0
    assert scipy.stats.kstest(numbers[::10].ravel(), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("word", [0, 2**64 - 1])
def test_random_bits_that_are_all_0_or_all_1_give_finite_numbers(word):
    """The test covers the NumPy formula, and machine code for which the word is the first of a stream."""
    state = np.array([inverse_splitmix64(word)], dtype=np.uint64)
    assert splitmix64(state) == word
    previous_state = state - state_of_number(np.zeros(1, dtype=np.uint64), 0.0)
    for number in (uniform_number(state), numbers_of(previous_state, [0], normal=False)):
        assert 0.0 < number < 1.0
    for pair in (normal_pair(state), normal_pairs(previous_state, 1)):
        assert np.isfinite(pair).all()


@pytest.mark.slow
def test_normal_numbers_of_different_ticks_vehicles_streams_and_seeds_are_independent(states):
    numbers = normal_pairs(states, 2000)
    limit = 4.5 / np.sqrt(numbers[0].size)
    for a, b in (
        (numbers[:, 1:], numbers[:, :-1]),
        (numbers[:, :, 1:], numbers[:, :, :-1]),
        (numbers[0], numbers[1]),
        (np.abs(numbers[0]), np.abs(numbers[1])),
        (numbers, normal_pairs(stream_states(7, range(500), StreamKind.NOISE, "command_link.noise"), 2000)),
        (numbers, normal_pairs(stream_states(7, range(500), StreamKind.WIND, "motion_capture.camera_noise"), 2000)),
        (numbers, normal_pairs(stream_states(8, range(500), StreamKind.NOISE, "motion_capture.camera_noise"), 2000)),
    ):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < limit


def test_the_numbers_of_a_sample_do_not_depend_on_its_position_in_the_fleet():
    many = stream_states(3, range(50), StreamKind.WIND, "fans.jet_noise")
    np.testing.assert_array_equal(stream_states(3, [41, 7], StreamKind.WIND, "fans.jet_noise"), many[[41, 7]])
    mass = parameter_numbers(3, range(1000), "vehicle.mass")
    np.testing.assert_array_equal(parameter_numbers(3, [9], "vehicle.mass"), mass[9:10])
    other_fields = [parameter_numbers(3, range(1000), path) for path in ("vehicle.inertia[0]", "vehicle.inertia[1]")]
    assert np.unique(np.concatenate([mass, *other_fields])).size == 3000


def test_streams_of_several_seeds_equal_the_streams_of_each_seed_alone():
    together = stream_states((3, 2**40), (7, 8), StreamKind.WIND, "gust")
    separate_states = [stream_states(seed, (sample,), StreamKind.WIND, "gust") for seed, sample in ((3, 7), (2**40, 8))]
    np.testing.assert_array_equal(together, np.concatenate(separate_states))
