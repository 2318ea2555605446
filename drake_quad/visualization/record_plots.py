"""Plot of all signals in a flight log over time."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.logs.record import QUANTITIES, FlightRecord
from drake_quad.logs.timing import gaps
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import AXIS_COLORS, BLACK, ROTOR_COLORS

# A log with more samples is thinned out, since a figure is only about a thousand pixels wide.
_MAX_SAMPLES = 20_000


class _Panel(NamedTuple):
    """Signals that are drawn in one panel.

    Attributes:
        label: label of the panel.
        signals: name of the measured signal, followed by the name of its reference or command, which is drawn dashed.
        names: labels of the columns of the signals; empty for a scalar.
        factor: factor from SI units to the displayed unit.
        unit: displayed unit; empty for the SI unit of the signal.
    """

    label: str
    signals: tuple[str, ...]
    names: tuple[str, ...] = ()
    factor: float = 1.0
    unit: str = ""


_AXIS_NAMES = tuple(AXIS_COLORS)
_ANGLE_NAMES = ("roll", "pitch", "yaw")
_ROTOR_NAMES = ("rotor 1", "rotor 2", "rotor 3", "rotor 4")
_DEGREES = 180.0 / np.pi  # degrees per radian
_PANELS = (
    _Panel("position", ("position", "reference_position"), _AXIS_NAMES),
    _Panel("velocity", ("velocity", "reference_velocity"), _AXIS_NAMES),
    _Panel("reference acceleration", ("reference_acceleration",), _AXIS_NAMES),
    _Panel("attitude", ("attitude", "attitude_command"), _ANGLE_NAMES, _DEGREES, "deg"),
    _Panel("reference yaw", ("reference_yaw",), (), _DEGREES, "deg"),
    _Panel("body rates", ("body_rates", "body_rate_command"), ("p", "q", "r"), _DEGREES, "deg/s"),
    _Panel("specific force", ("specific_force",), _AXIS_NAMES),
    _Panel("rotor speed", ("rotor_speed", "rotor_speed_command"), _ROTOR_NAMES),
    _Panel("motor command", ("motor_command",), _ROTOR_NAMES, 100.0, "%"),
    _Panel("thrust command", ("thrust_command",)),
    _Panel("thrust relative to full, and to hover", ("thrust_fraction", "hover_thrust_fraction"), (), 100.0, "%"),
    _Panel("torque command", ("torque_command",), _AXIS_NAMES, 1e3, "mN m"),
    _Panel("wind", ("wind",), _AXIS_NAMES),
    _Panel("residual force", ("residual_force",), _AXIS_NAMES),
    _Panel("battery", ("battery_voltage",)),
)


def plot_record(record: FlightRecord) -> Figure:
    """Plot all logged signals over time. References and commands are dashed, and gaps of the log are grey."""
    panels = [panel for panel in _PANELS if any(getattr(record, name) is not None for name in panel.signals)]
    with new_panels(9.0, 0.6 + 1.5 * len(panels), len(panels), 1, sharex=True) as (figure, grid):
        for (axes,), panel in zip(grid, panels, strict=True):
            _draw(axes, panel, record)
        axes.set(xlabel="time (s)", xlim=(float(record.time[0]), float(record.time[-1])))
        figure.align_ylabels()
        figure.suptitle(
            f"{record.name}: {record.time[-1] - record.time[0]:.1f} s at {1.0 / record.period:.0f} Hz",
            x=0.01,
            ha="left",
        )
        return figure


def _draw(axes: Axes, panel: _Panel, record: FlightRecord) -> None:
    step = -(-len(record.time) // _MAX_SAMPLES)
    # Lines are broken at gaps, since a line across a gap would show data that were not logged.
    gap_ends = 1 + np.flatnonzero(gaps(record.time))
    colors = ROTOR_COLORS if panel.names == _ROTOR_NAMES else (*AXIS_COLORS.values(),) if panel.names else (BLACK,)
    first, *_ = [name for name in panel.signals if getattr(record, name) is not None]
    for name in panel.signals:
        values = getattr(record, name)
        if values is None:
            continue
        commanded = name != first
        for column, color in enumerate(colors):
            drawn_values = panel.factor * (values[:, column] if values.ndim > 1 else values)
            label = panel.names[column] if panel.names and not commanded else None
            style: dict[str, Any] = {"linestyle": (0, (3, 1.5)), "alpha": 0.7} if commanded else {}
            axes.plot(
                *_with_breaks(record.time[::step], drawn_values[::step], gap_ends, step),
                color=color,
                label=label,
                lw=0.9,
                **style,
            )
    for end in gap_ends:
        axes.axvspan(record.time[end - 1], record.time[end], color="0.85", lw=0.0)
    axes.set_ylabel(f"{panel.label}\n({panel.unit or QUANTITIES[first].unit})")
    if panel.names:
        axes.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0)


def _with_breaks(
    time: np.ndarray, values: np.ndarray, gap_ends: np.ndarray, step: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of samples, with a NaN inserted at each gap so that Matplotlib breaks the line."""
    indices = -(-gap_ends // step)
    return np.insert(time, indices, np.nan), np.insert(values, indices, np.nan)
