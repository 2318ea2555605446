"""Plots of the errors of a state estimate in a logged and in a simulated flight."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.flight.flight import Flight
from drake_quad.framework.elementary import wrap_angle
from drake_quad.signals import EstimateDeviation
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLUE, VERMILION

if TYPE_CHECKING:  # importing the identification package would delay the plots of a flight
    from drake_quad.identification.logged_estimate import EstimateErrors, LoggedEstimate

_NUM_SIGMAS = 2.0  # half-width of the shaded bands, in standard deviations
_MAX_INNOVATION = 6.0  # largest normalised innovation on the axis


class _Panel(NamedTuple):
    """Panel of a plot: its label, the factor from SI to its unit, the error, and the components of its deviation."""

    label: str
    factor: float
    error: str
    deviations: tuple[str, ...]


_PANELS = (
    _Panel("position error (cm)", 1e2, "position", ("x", "y", "z")),
    _Panel("velocity error (cm/s)", 1e2, "velocity", ("v_x", "v_y", "v_z")),
    _Panel("tilt error (mrad)", 1e3, "tilt", ("rotation_x", "rotation_y")),
    _Panel("yaw error (mrad)", 1e3, "yaw", ("rotation_z",)),
)


def plot_estimate(estimate: "LoggedEstimate", on_board: "EstimateErrors | None" = None) -> Figure:
    """Plot the errors of position, velocity, tilt and yaw over time, with the filter's own standard deviations.

    Args:
        estimate: estimate of the filter.
        on_board: errors of an on-board estimate, with one sample before the first sample of `estimate`; None if there
            is no such estimate.
    """
    deviations = EstimateDeviation(*estimate.deviations.T)
    with new_panels(9.0, 7.6, len(_PANELS), 1, sharex=True) as (figure, grid):
        for (axes,), panel in zip(grid, _PANELS, strict=True):
            _draw_deviation(axes, panel, estimate.time, deviations)
            curves = {"this filter": (_size(getattr(estimate.errors, panel.error)), BLUE)}
            if on_board is not None:
                curves = {"on board": (_size(getattr(on_board, panel.error)[1:]), VERMILION)} | curves
            for label, (error, color) in curves.items():
                axes.plot(estimate.time, panel.factor * error, color=color, label=label)
            largest = max(np.max(error[estimate.is_flying]) for error, _ in curves.values())
            axes.set(ylabel=panel.label, ylim=(0.0, 1.1 * panel.factor * largest))
        axes.set(xlabel="time (s)", xlim=(float(estimate.time[0]), float(estimate.time[-1])))
        figure.align_ylabels()
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
        return figure


def plot_flown_estimate(flight: Flight) -> Figure:
    """Plot the estimation errors of a simulated flight, with the filter's own standard deviations, and the innovations.

    A filter without a covariance has neither standard deviations nor innovations.
    """
    measurement, state = flight.record("measurement"), flight.record("state")
    errors: dict[str, np.ndarray] = {
        "position": np.array([measurement.x - state.x, measurement.y - state.y, measurement.z - state.z]).T,
        "velocity": np.array([measurement.v_x - state.v_x, measurement.v_y - state.v_y, measurement.v_z - state.v_z]).T,
        "tilt": np.array([measurement.roll - state.roll, measurement.pitch - state.pitch]).T,
        "yaw": np.asarray(wrap_angle(measurement.yaw - state.yaw)),
    }
    has_covariance = "estimate_deviation" in flight.signals
    num_panels = len(_PANELS) + has_covariance
    with new_panels(9.0, 1.9 * num_panels, num_panels, 1, sharex=True) as (figure, grid):
        for (axes,), panel in zip(grid, _PANELS, strict=False):
            if has_covariance:
                _draw_deviation(axes, panel, flight.time, flight.record("estimate_deviation"))
            axes.plot(flight.time, panel.factor * _size(errors[panel.error]), color=BLUE, label="error")
            axes.set(ylabel=panel.label)
            axes.set_ylim(bottom=0.0)
        if has_covariance:
            _draw_innovations(grid[-1, 0], flight)
        grid[-1, 0].set(xlabel="time (s)", xlim=(0.0, float(flight.time[-1])))
        figure.align_ylabels()
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
        return figure


def _draw_deviation(axes: Axes, panel: _Panel, time: np.ndarray, deviation: EstimateDeviation) -> None:
    limit = _NUM_SIGMAS * np.sqrt(sum(np.square(getattr(deviation, name)) for name in panel.deviations))
    axes.fill_between(time, 0.0, panel.factor * limit, color=BLUE, alpha=0.2, lw=0.0, label="2 standard deviations")


def _draw_innovations(axes: Axes, flight: Flight) -> None:
    axes.axhspan(-_NUM_SIGMAS, _NUM_SIGMAS, color=BLUE, alpha=0.2, lw=0.0)
    axes.plot(flight.time, flight["innovation"], ".", color=BLUE, markersize=1.0)
    axes.set(ylabel="innovations\n(standard deviations)", ylim=(-_MAX_INNOVATION, _MAX_INNOVATION))


def _size(error: np.ndarray) -> np.ndarray:
    return np.linalg.norm(error, axis=1) if error.ndim > 1 else np.abs(error)
