"""Tests that the plot of a flight log shows each signal once, in its unit, and the gaps of the log."""

import numpy as np
import pytest

from drake_quad.logs.record import COLUMNS, FlightRecord
from drake_quad.visualization.record_plots import plot_record

TIME = np.concatenate([np.arange(10) * 0.01, 0.5 + np.arange(10) * 0.01])  # s, with a gap of 0.4 s


def record(*names):
    signals = {name: np.ones((20, COLUMNS[name]) if COLUMNS[name] > 1 else 20) for name in names}
    return FlightRecord("log", TIME, **signals)


@pytest.mark.slow
def test_each_logged_signal_is_drawn():
    figure = plot_record(record(*COLUMNS))
    assert sum(len(axes.lines) for axes in figure.axes) == sum(COLUMNS.values())


@pytest.mark.slow
def test_units_gaps_and_commands_are_drawn():
    (axes,) = plot_record(record("attitude", "attitude_command")).axes
    assert axes.get_ylabel() == "attitude\n(deg)"
    measured, commanded = axes.lines[0], axes.lines[3]
    assert measured.get_linestyle() == "-"
    assert commanded.get_linestyle() != "-"
    values = measured.get_ydata()
    assert np.nanmax(values) == pytest.approx(np.degrees(1.0))
    assert np.flatnonzero(np.isnan(values)).tolist() == [10]
    (gap,) = axes.patches
    assert (gap.get_x(), gap.get_width()) == pytest.approx((0.09, 0.41))
