"""Tests of Table II as printed in the paper."""

import math

import numpy as np
import pytest

from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table


def test_the_table_has_ten_cells_with_known_names():
    table = published_table()
    assert len(table) == 10
    assert {cell.wind for cell in table} == set(WINDS)
    assert {cell.controller for cell in table} == set(CONTROLLERS)


def test_all_but_two_printed_means_agree_with_the_printed_runs():
    for cell, line in published_table().items():
        for runs in line:
            if not any(map(math.isnan, (*runs.runs, runs.mean))):
                assert np.mean(runs.runs) == pytest.approx(runs.mean, abs=1.1e-3), cell


def test_missing_values_are_nan():
    assert math.isnan(published_table()[Cell("high_wind", "pd_t2fnn")].rmse.mean)
    assert published_table()[Cell("no_wind", "pd")].rmse.mean == 0.972


def test_the_first_line_of_table_ii_has_the_printed_values():
    line = published_table()[Cell("no_wind", "pd")]
    assert line.rmse == ((0.978, 0.957, 0.981), 0.972)
    assert line.effort_x == ((0.150, 0.233, 0.216), 0.199)
    assert line.effort_y == ((0.431, 0.284, 0.493), 0.403)
