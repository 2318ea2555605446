"""Tests that flight records have increasing times and one row per sample in each signal."""

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.logs.record import COLUMNS, FlightRecord

TIME = np.array([1.0, 1.1, 1.2, 1.6])  # s, with a gap


@pytest.mark.parametrize(
    "time", [np.array([1.0]), np.empty(0), np.array([0.0, 0.2, 0.1]), np.array([0.0, 0.1, 0.1]), np.zeros((3, 1))]
)
def test_the_times_of_a_record_must_increase(time):
    with pytest.raises(InputError, match="^the log 'flown' must have at least two samples with increasing times$"):
        FlightRecord("flown", time)


@pytest.mark.parametrize("name", COLUMNS)
def test_a_signal_has_a_row_of_numbers_for_every_sample(name):
    columns = COLUMNS[name]
    shape = (len(TIME), columns) if columns > 1 else (len(TIME),)
    record = FlightRecord("flown", TIME, **{name: np.zeros(shape)})
    assert record.names == (name,)
    assert record.of(name).shape == shape
    for wrong in ((*shape[:1], columns + 1), (shape[0] - 1, *shape[1:])):
        with pytest.raises(InputError, match=f"^{name} of the log 'flown' has shape"):
            FlightRecord("flown", TIME, **{name: np.zeros(wrong)})
    values = np.zeros(shape)
    values[2:, ...] = np.nan
    with pytest.raises(InputError, match=f"^{name} of the log 'flown' is not a number at 1.2 s, sample 2$"):
        FlightRecord("flown", TIME, **{name: values})


def test_a_part_of_a_record_has_the_times_and_rows_of_its_samples():
    record = FlightRecord("flown", TIME, position=np.arange(12.0).reshape(4, 3), thrust_fraction=np.arange(4.0))
    for chosen in (slice(1, 3), np.array([False, True, True, False])):
        part = record.subset(chosen)
        np.testing.assert_array_equal(part.time, [1.1, 1.2])
        np.testing.assert_array_equal(part.position, [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])
        np.testing.assert_array_equal(part.thrust_fraction, [1.0, 2.0])
        assert part.names == ("position", "thrust_fraction")


def test_a_summary_states_duration_rate_signals_and_missing_signals():
    record = FlightRecord("flown", TIME, thrust_fraction=np.arange(4.0))
    assert record.period == pytest.approx(0.1)
    assert repr(record) == "<FlightRecord flown: 0.6 s, 4 samples at 10 Hz; thrust_fraction>"
    with pytest.raises(InputError, match="^the log 'flown' lacks position; it has thrust_fraction$"):
        record.of("position")
    with pytest.raises(InputError, match="^the log 'flown' lacks position; it has no signals$"):
        FlightRecord("flown", TIME).of("position")
