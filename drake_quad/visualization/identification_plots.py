"""Plots of an identification: forecasts, residuals, thrust curve, correlations, and open-loop prediction errors."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from drake_quad.identification.result import ForecastOutput, Identification
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.validation.prediction import UNITS, Predictions
from drake_quad.vehicle.motors import ThrustCurve, thrust_from_throttle
from drake_quad.visualization.names import short_name
from drake_quad.visualization.panels import new_panels, plot_intervals
from drake_quad.visualization.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, REFERENCE, VERMILION

_MAX_WINDOWS = 10  # largest number of time windows in a plot of the fit
_MAX_LABEL_LENGTH = 15  # largest number of characters per line of an axis label
_MAX_MARKED_POINTS = 20  # largest number of samples of a time window whose residuals are drawn with markers
_BAND_COLOUR = "0.92"
_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, BLACK)
# Conversion factor and label of each display unit.
_DISPLAY_UNITS = {
    "m": (1e2, "cm"),
    "rad": (180.0 / math.pi, "°"),
    "rad/s": (180.0 / math.pi, "°/s"),
    "m/s": (1.0, "m/s"),
}


def plot_fit(identification: Identification) -> Figure:
    """Plot measurements, forecasts and forecast errors in the first time windows of the held-out flight."""
    outputs = identification.outputs
    size = 10.0, 0.6 + 1.25 * len(outputs)
    with new_panels(*size, len(outputs), 2, sharex=True, width_ratios=[1.6, 1.0]) as (figure, rows):
        for (left, right), output in zip(rows, outputs, strict=True):
            _draw_windows(left, right, output)
        rows[0][0].set_title("measured and forecast")
        rows[0][1].set_title("measured minus forecast", loc="left")
        for axes in rows[-1]:
            axes.set_xlabel("time in held-out windows (s)")
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=2)
        figure.align_ylabels(rows[:, 0])
        return figure


def _draw_windows(left: Axes, right: Axes, output: ForecastOutput) -> None:
    factor, unit = _DISPLAY_UNITS.get(output.unit, (1.0, output.unit))
    for window in range(min(_MAX_WINDOWS, len(output.time))):
        time = output.time[window]
        if window % 2:
            for axes in (left, right):
                axes.axvspan(time[0], time[-1], color=_BAND_COLOUR, linewidth=0.0, zorder=0)
        measured, predicted = ("measured", "forecast") if window == 0 else (None, None)
        left.plot(time, factor * output.measured[window], color="0.45", linewidth=2.2, label=measured)
        left.plot(time, factor * output.predicted[window], color=BLUE, linewidth=1.1, label=predicted)
        right.plot(time, factor * output.residual[window], color=VERMILION, linewidth=0.8)
    left.set_ylabel("\n".join([*textwrap.wrap(output.name, _MAX_LABEL_LENGTH), f"({unit})"]))
    right.axhline(0.0, color="0.3", linewidth=0.8)
    text = (
        f"explained variance {100.0 * output.explained_variance:.1f} %"
        if output.explained_variance > 0.0
        else "no variance explained"
    )
    right.set_title(text, loc="right", fontsize=8, pad=2.0)


def plot_residuals(identification: Identification) -> Figure:
    """Plot the autocorrelation and the spectrum of the forecast errors. The spectrum of white noise is flat."""
    with new_panels(9.0, 3.4, 1, 2) as (figure, ((left, right),)):
        for i, output in enumerate(identification.outputs):
            colour, dashes = _COLOURS[i % len(_COLOURS)], ("-", "--", ":")[i // len(_COLOURS) % 3]
            style: dict[str, Any] = {"color": colour, "linestyle": dashes, "linewidth": 1.1}
            # A single point is not visible without a marker.
            style["marker"] = "." if output.residual.shape[1] <= _MAX_MARKED_POINTS else None
            lags, correlation = _autocorrelation(output)
            left.plot(lags, correlation, **style, label=output.name)
            frequency, density = _spectrum(output)
            right.loglog(frequency, density, **style)
        half_width = 1.96 / math.sqrt(identification.outputs[0].residual.size)
        left.axhspan(-half_width, half_width, color=_BAND_COLOUR, zorder=0)
        left.set(xlabel="lag (s)", ylabel="autocorrelation (1)", ylim=(-0.6, 1.05))
        right.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        right.xaxis.set_major_formatter("{x:g}")
        right.xaxis.set_minor_formatter(NullFormatter())
        right.set(xlabel="frequency (Hz)", ylabel="spectral density over variance (s)")
        figure.legend(*left.get_legend_handles_labels(), loc="outside right upper")
        return figure


def _autocorrelation(output: ForecastOutput) -> tuple[np.ndarray, np.ndarray]:
    residual = output.residual - output.residual.mean()
    samples = residual.shape[1]
    num_lags = samples // 2 + 1
    variance = float(np.mean(residual**2)) or 1.0
    correlations = [
        float(np.mean(residual[:, lag:] * residual[:, : samples - lag])) / variance for lag in range(num_lags)
    ]
    return (output.time[0, :num_lags] - output.time[0, 0]), np.array(correlations)


def _spectrum(output: ForecastOutput) -> tuple[np.ndarray, np.ndarray]:
    residual, samples = output.residual, output.residual.shape[1]
    period = float(np.median(np.diff(output.time[0])))
    taper = np.hanning(samples)
    power = np.mean(np.abs(np.fft.rfft(residual * taper, axis=1)) ** 2, axis=0)
    density = 2.0 * period * power / float(np.sum(taper**2)) / (float(np.mean(residual**2)) or 1.0)
    return np.fft.rfftfreq(samples, period)[1:], density[1:]


def plot_thrust(identification: Identification, commands: np.ndarray | None = None) -> Figure | None:
    """Plot the thrust of a rotor over its throttle with a 95 % confidence band.

    Args:
        identification: identification of the vehicle.
        commands: throttles commanded in flight, whose range from the 1 % to the 99 % quantile is shaded.

    Returns:
        The figure; None if no thrust curve was identified.
    """
    estimates = identification.estimates
    names = [f"motors.curve[{i}]" for i in range(3)]
    estimated_names = [name for name in names if name in estimates.names]
    if not estimated_names:
        return None
    curve = identification.vehicle.vehicle.motors.curve  # type: ignore[union-attr]
    throttle = np.linspace(0.0, 1.0, 101)
    indices = [estimates.names.index(name) for name in estimated_names]
    slopes = np.stack([throttle ** names.index(name) for name in estimated_names], axis=1)
    covariance = estimates.covariance[np.ix_(indices, indices)]
    deviation = np.sqrt(np.einsum("ti,ij,tj->t", slopes, covariance, slopes))
    half_width = float(estimates.quantiles()[indices].max()) * deviation
    thrust = np.asarray(thrust_from_throttle(throttle, ThrustCurve(*map(float, curve))))  # type: ignore[arg-type]
    vehicle = identification.vehicle.vehicle
    with new_panels(5.6, 3.8) as (figure, axes):
        axes.fill_between(
            throttle, thrust - half_width, thrust + half_width, color=BLUE, alpha=0.25, linewidth=0.0, label="95 %"
        )
        axes.plot(throttle, thrust, color=BLUE, label="identified")
        hover = 0.25 * float(vehicle.mass) * float(vehicle.gravity)
        axes.axhline(hover, **REFERENCE, label="hover")
        if commands is not None:
            low, high = np.quantile(commands, [0.01, 0.99])
            axes.axvspan(low, high, color=_BAND_COLOUR, zorder=0, label="flown")
        axes.set(xlabel="throttle (1)", ylabel="thrust of a rotor (N)", xlim=(0.0, 1.0), ylim=(0.0, None))
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
        return figure


def plot_correlations(estimates: Estimates) -> Figure:
    """Plot the correlation matrix of the estimation errors, as colours and numbers."""
    count = len(estimates.names)
    labels = [short_name(name) for name in estimates.names]
    size = 2.6 + 0.42 * count
    with new_panels(size + 0.6, size) as (figure, axes):
        shades = axes.imshow(estimates.correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        axes.set_xticks(range(count), labels, rotation=60, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(count), labels)
        axes.grid(visible=False)
        for i in range(count):
            for j in range(count):
                value = estimates.correlation[i, j]
                if i != j and abs(value) >= 0.05:
                    colour = "white" if abs(value) > 0.7 else "black"
                    axes.text(j, i, f"{value:.1f}", ha="center", va="center", fontsize=7, color=colour)
        figure.colorbar(shades, ax=axes, shrink=0.7, label="correlation of estimation errors (1)")
        return figure


def plot_predictions(predictions: Predictions, quantities: Sequence[str] = ("position", "attitude")) -> Figure:
    """Plot the RMS errors of open-loop predictions over the horizon, with 95 % intervals."""
    shown_quantities = [name for name in quantities if name in predictions.errors] or list(predictions.errors)[:2]
    with new_panels(4.4 * len(shown_quantities) + 0.4, 3.6, 1, len(shown_quantities)) as (figure, (row,)):
        for axes, quantity in zip(row, shown_quantities, strict=True):
            factor, unit = _DISPLAY_UNITS[UNITS[quantity]]
            for i, vehicle in enumerate(predictions.vehicles):
                errors = [predictions.rmse(quantity, vehicle, horizon) for horizon in predictions.horizons]
                value, low, high = factor * np.transpose(errors)
                known = np.isfinite(value)
                intervals = np.transpose([value, low, np.where(np.isfinite(high), high, value)])[known]
                factor_on_horizon = 1.0 + 0.03 * (i - 0.5 * (len(predictions.vehicles) - 1))
                style: dict[str, Any] = {"color": _COLOURS[i], "marker": "o", "markersize": 4, "capsize": 3}
                plot_intervals(
                    axes, factor_on_horizon * np.array(predictions.horizons)[known], intervals, label=vehicle, **style
                )
            axes.set(
                xscale="log",
                yscale="log",
                xlabel="horizon (s)",
                ylabel=f"RMS error of {quantity.replace('_', ' ')} ({unit})",
            )
            axes.set_xticks(predictions.horizons, [f"{horizon:g}" for horizon in predictions.horizons])
            axes.minorticks_off()
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=len(predictions.vehicles))
        return figure
