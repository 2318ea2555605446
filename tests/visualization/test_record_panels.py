"""Tests that each panel of a flight log's plot shows its signals in the unit of its label."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from drake_quad.logs.record import COLUMNS, FlightRecord
from drake_quad.visualization.record_plots import plot_record
from drake_quad.visualization.style import AXIS_COLORS, BLACK, ROTOR_COLORS

DEGREES_PER_RADIAN = 180.0 / np.pi
XYZ, ANGLES, RATES = ("x", "y", "z"), ("roll", "pitch", "yaw"), ("p", "q", "r")
ROTOR_NAMES = tuple(f"rotor {i}" for i in (1, 2, 3, 4))
# Measured signal and command, names of the columns, unit, and factor from the SI unit.
PANELS = (
    ("position", "reference_position", XYZ, "m", 1.0),
    ("velocity", "reference_velocity", XYZ, "m/s", 1.0),
    ("reference_acceleration", None, XYZ, "m/s²", 1.0),
    ("attitude", "attitude_command", ANGLES, "deg", DEGREES_PER_RADIAN),
    ("reference_yaw", None, (), "deg", DEGREES_PER_RADIAN),
    ("body_rates", "body_rate_command", RATES, "deg/s", DEGREES_PER_RADIAN),
    ("specific_force", None, XYZ, "m/s²", 1.0),
    ("rotor_speed", "rotor_speed_command", ROTOR_NAMES, "rad/s", 1.0),
    ("motor_command", None, ROTOR_NAMES, "%", 100.0),
    ("thrust_command", None, (), "N", 1.0),
    ("thrust_fraction", "hover_thrust_fraction", (), "%", 100.0),
    ("torque_command", None, XYZ, "mN m", 1000.0),
    ("wind", None, XYZ, "m/s", 1.0),
    ("residual_force", None, XYZ, "N", 1.0),
    ("battery_voltage", None, (), "V", 1.0),
)


def record(time, *names):
    """Return a flight log with random signals."""
    rng = np.random.default_rng(3)
    return FlightRecord(
        "a log", time, **{name: rng.uniform(size=(len(time), COLUMNS[name])).squeeze() for name in names}
    )


@pytest.mark.slow
def test_every_panel_has_its_signals_in_its_unit():
    log = record(2.0 + 0.01 * np.arange(50), *COLUMNS)
    figure = plot_record(log)
    assert len(figure.axes) == len(PANELS)
    for axes, (name, command, names, unit, factor) in zip(figure.axes, PANELS, strict=True):
        words = axes.get_ylabel().partition("\n")[0]
        assert axes.get_ylabel() == f"{words}\n({unit})"
        assert words.split(",")[0].split()[0] in name.replace("_", " ").split()
        count = max(len(names), 1)
        colors = ROTOR_COLORS if names == ROTOR_NAMES else tuple(AXIS_COLORS.values()) if names else (BLACK,)
        assert len(axes.lines) == (count if command is None else 2 * count)
        for lines, signal in ((axes.lines[:count], name), (axes.lines[count:], command)):
            columns = getattr(log, signal or name).reshape(50, -1).T
            for line, values, color in zip(lines, columns, colors[: len(lines)], strict=signal is not None):
                np.testing.assert_allclose(line.get_xydata(), np.stack([log.time, factor * values], axis=1))
                assert to_hex(line.get_color()) == to_hex(color)
                assert (line.get_linestyle() == "-") == (signal == name)
        legend = axes.get_legend()
        assert tuple(text.get_text() for text in legend.texts) == names if names else legend is None
    assert [axes.get_xlabel() for axes in figure.axes] == [*[""] * (len(PANELS) - 1), "time (s)"]
    assert figure.axes[0].get_xlim() == (2.0, 2.49)
    assert figure.get_suptitle() == "a log: 0.5 s at 100 Hz"


def test_a_panel_without_a_measured_signal_shows_the_command_as_a_solid_curve():
    time = 0.01 * np.arange(50)
    figure = plot_record(record(time, "attitude_command", "hover_thrust_fraction"))
    attitude, hover = figure.axes
    assert [line.get_linestyle() for line in attitude.lines] == ["-"] * 3
    assert [text.get_text() for text in attitude.get_legend().texts] == [*ANGLES]
    assert [line.get_linestyle() for line in hover.lines] == ["-"]


@pytest.mark.parametrize(("count", "step"), [(20_000, 1), (20_001, 2), (50_000, 3)])
def test_a_long_log_is_thinned_to_twenty_thousand_samples_and_broken_at_its_gaps(count, step):
    time = 0.001 * np.arange(count)
    time[10_000:] += 1.0
    log = record(time, "battery_voltage")
    (axes,) = plot_record(log).axes
    (line,) = axes.lines
    x, y = line.get_xydata().T
    (gap,) = np.flatnonzero(np.isnan(x))
    assert np.isnan(y[gap])
    assert x[gap - 1] < 10.0 <= x[gap + 1] - 1.0
    is_shown = np.isfinite(x)
    np.testing.assert_array_equal(x[is_shown], time[::step])
    np.testing.assert_array_equal(y[is_shown], log.battery_voltage[::step])
    (span,) = axes.patches
    assert (span.get_x(), span.get_width()) == pytest.approx((9.999, 1.001))
