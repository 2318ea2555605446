"""Tests of the table of values that all vehicles share."""

import numpy as np
import pytest

from drake_quad.compilation.shared_values import TIME_VALUE, SharedValues, SharedValueSource
from drake_quad.framework.formulas import CurrentTick


def no_value(path, output, time):
    raise AssertionError(path)


def test_a_shared_value_that_is_requested_twice_has_one_column_of_the_table():
    shared = SharedValues()
    ticks = CurrentTick(0.02)
    columns = [
        shared.column(0, TIME_VALUE),
        shared.column(1, TIME_VALUE),
        shared.column(0, ticks),
        shared.second(0, ticks),
        shared.column(0, CurrentTick(0.04)),
    ]
    assert columns == [0, 1, 2, 3, 4]
    assert shared.column(1, TIME_VALUE) == 1
    assert shared.column(0, CurrentTick(0.02)) == 2
    assert shared.second(0, CurrentTick(0.02)) == 3
    assert shared.width == 5


def test_a_table_contains_the_times_and_ticks_of_each_event_and_instant():
    shared = SharedValues()
    ticks = CurrentTick(0.02)
    columns = [shared.column(1, TIME_VALUE), shared.column(0, ticks), shared.second(0, ticks), shared.second(1, ticks)]
    assert columns == [0, 1, 2, 3]
    times = np.array([[0.0, 0.02], [0.06, 0.08], [0.08, 0.1]])
    np.testing.assert_array_equal(
        shared.table(times, no_value), [[0.02, 0.0, 0.0, 1.0], [0.08, 1.0, 1.0, 0.0], [0.1, 2.0, 0.0, 1.0]]
    )


def test_a_source_is_evaluated_once_for_all_its_elements():
    shared = SharedValues()
    for element in (2, 0):
        shared.column(1, SharedValueSource("reference", 0, element))
    shared.column(0, SharedValueSource("reference", 0, 1))
    evaluations = []

    def values(path, output, time):
        evaluations.append((path, output, time))
        return time + np.array([10.0, 20.0, 30.0])

    table = shared.table(np.array([[0.0, 1.0], [2.0, 3.0]]), values)
    np.testing.assert_array_equal(table, [[31.0, 11.0, 20.0], [33.0, 13.0, 22.0]])
    assert evaluations == [("reference", 0, time) for time in (1.0, 3.0, 0.0, 2.0)]


@pytest.mark.parametrize("events", [0, 2])
def test_the_table_has_a_row_for_each_event_even_if_there_are_no_shared_values(events):
    assert SharedValues().table(np.zeros((events, 1)), no_value).shape == (events, 1)
