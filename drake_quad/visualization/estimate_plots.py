"""Plot of the errors of an estimate of a logged flight."""

import numpy as np
from matplotlib.figure import Figure

from drake_quad.identification.logged_estimate import EstimateErrors, LoggedEstimate
from drake_quad.signals import EstimateDeviation
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLUE, VERMILION

_NUM_SIGMAS = 2.0


def plot_estimate(estimate: LoggedEstimate, on_board: EstimateErrors | None = None) -> Figure:
    """Plot the errors of position, velocity, tilt and yaw over time, with the deviations that the filter estimates.

    Args:
        estimate: estimate of the filter.
        on_board: errors of an estimate from on board; None if there is none. It has one sample more than `estimate`.
    """
    deviations = EstimateDeviation(*estimate.deviations.T)
    panels = (
        ("position error (mm)", 1e3, "position", (deviations.x, deviations.y, deviations.z)),
        ("velocity error (cm/s)", 1e2, "velocity", (deviations.v_x, deviations.v_y, deviations.v_z)),
        ("tilt error (mrad)", 1e3, "tilt", (deviations.rotation_x, deviations.rotation_y)),
        ("yaw error (mrad)", 1e3, "yaw", (deviations.rotation_z,)),
    )
    with new_panels(9.0, 7.6, len(panels), 1, sharex=True) as (figure, grid):
        for (axes,), (label, factor, name, deviation) in zip(grid, panels, strict=True):
            limit = _NUM_SIGMAS * np.sqrt(np.sum(np.square(deviation), axis=0))
            axes.fill_between(
                estimate.time, 0.0, factor * limit, color=BLUE, alpha=0.2, lw=0.0, label="2 standard deviations"
            )
            if on_board is not None:
                axes.plot(estimate.time, factor * _size(getattr(on_board, name)[1:]), color=VERMILION, label="on board")
            axes.plot(estimate.time, factor * _size(getattr(estimate.errors, name)), color=BLUE, label="this filter")
            largest = np.max(_size(getattr(estimate.errors, name))[estimate.is_flying])
            if on_board is not None:
                largest = max(largest, float(np.max(_size(getattr(on_board, name)[1:])[estimate.is_flying])))
            axes.set(ylabel=label, ylim=(0.0, 1.1 * factor * largest))
        axes.set(xlabel="time (s)", xlim=(float(estimate.time[0]), float(estimate.time[-1])))
        figure.align_ylabels()
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
        return figure


def _size(error: np.ndarray) -> np.ndarray:
    return np.linalg.norm(error, axis=1) if error.ndim > 1 else np.abs(error)
