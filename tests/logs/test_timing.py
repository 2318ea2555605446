"""Tests of logs whose clocks have jumps, repeated times, gaps and jitter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from written_logs import DATA

from drake_quad.identification.windows import segment_numbers
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.logs.timing import gaps, increasing_samples, timing_remarks


def record(time):
    return FlightRecord("log", np.array(time), thrust_fraction=np.array(time))


@pytest.mark.parametrize(
    ("time", "expected", "phrases"),
    [
        ([0, 1, 2, 3], [0, 1, 2, 3], []),
        ([0, 1, 1, 2], [0, 1, 2], ["1 sample left out: they repeat the time"]),
        ([0, 1, 2, 1.5, 3], [0, 1, 2, 3], ["1 sample left out: the clock goes back once, by up to 0.5 s at 2 s"]),
        ([0, 1, 9e5, 2, 3], [0, 1, 2, 3], ["1 sample left out: the clock goes back once, by up to 9e+05 s"]),
        ([0, 1, 2, 3, 0, 1], [0, 1, 2, 3], ["2 samples left out: the clock goes back once, by up to 3 s at 3 s"]),
        ([0, 1, 0, 1, 2, 3], [0, 1, 2, 3], ["2 samples left out: the clock goes back once"]),
        ([0, np.nan, 1, np.inf, 2], [0, 1, 2], ["2 samples left out: their time is not a number"]),
        ([0, 1, 1, np.nan, 3, 2, 4], [0, 1, 3, 4], ["not a number", "repeat", "goes back once, by up to 1 s at 3 s"]),
    ],
)
def test_samples_out_of_order_are_left_out(time, expected, phrases):
    chosen, remarks = increasing_samples(np.array(time, dtype=float))
    assert np.array(time)[chosen].tolist() == expected
    assert len(remarks) == len(phrases)
    for remark, each in zip(remarks, phrases, strict=True):
        assert each in remark


@given(arrays(float, st.integers(0, 30), elements=st.floats(-5.0, 5.0).map(lambda t: round(t, 1)) | st.just(np.nan)))
def test_the_times_of_kept_samples_increase_and_increasing_times_are_all_kept(time):
    chosen, remarks = increasing_samples(time)
    assert np.all(np.diff(time[chosen]) > 0.0)
    assert bool(remarks) == (not chosen.all())
    in_order = np.unique(time[np.isfinite(time)])
    assert increasing_samples(in_order)[0].all()


def test_a_record_is_divided_at_its_gaps():
    time = [0.0, 1.0, 2.0, 7.0, 8.0, 9.0, 12.5, 16.0, 17.0]
    assert np.flatnonzero(gaps(np.array(time))).tolist() == [2, 5, 6]
    assert segment_numbers(record(time)).tolist() == [0, 0, 0, 1, 1, 1, 2, 3, 3]
    (remark,) = timing_remarks(np.array(time))
    assert remark == (
        "3 gaps (steps of more than 3 times the median of 1 s), 12 s in total; the longest lasts 5 s, from 2 s on"
    )


def test_a_record_without_gaps_is_one_part():
    assert segment_numbers(record([0.0, 1.0, 2.5])).tolist() == [0, 0, 0]
    assert not [*timing_remarks(np.arange(10.0))]


def test_jitter_is_reported_with_its_amplitude():
    time = np.arange(1000.0) + np.tile([0.0, 0.1], 500)
    (remark,) = timing_remarks(time)
    assert "uneven: the median is 1.1 s, the standard deviation 0.1 s, and the range 0.9 to 1.1 s" in remark


def test_the_gap_in_a_real_log_is_found():
    record = read_log(DATA / "crazyflie/crazyswarm2/log145.xz")
    before, after = (record.subset(segment_numbers(record) == number) for number in range(2))
    assert len(before.time) + len(after.time) == len(record.time)
    assert after.time[0] - before.time[-1] == pytest.approx(1.129973)
    np.testing.assert_array_equal(after.position, record.position[len(before.time) :])
