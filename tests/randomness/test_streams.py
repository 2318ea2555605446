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
    word,
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
    words = word(state, np.arange(5))
    assert words.tolist() == expected
    np.testing.assert_array_equal(uniform_numbers(state, 0, 5)[:, 0], [uniform_number(each) for each in words])
    pairs = np.array([normal_pair(each) for each in words])
    np.testing.assert_allclose(normal_pairs(state, 0, 5)[:, :, 0].T, pairs, rtol=1e-14)
    np.testing.assert_array_equal(normal_pairs(state, 3, 2), normal_pairs(state, 0, 5)[:, 3:])


def test_mixing_is_one_to_one():
    states = np.arange(200_000, dtype=np.uint64)
    assert np.unique(mixed(states)).size == states.size


@pytest.fixture(scope="module")
def states():
    return stream_states(7, range(500), Kind.NOISE, "motion_capture.camera_noise")


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


@pytest.mark.parametrize("bits", [0, 2**64 - 1])
def test_extreme_words_make_numbers_like_others(bits):
    assert 0.0 < uniform_number(np.uint64(bits)) < 1.0
    assert np.isfinite(normal_pair(np.uint64(bits))).all()


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
