"""Noise and biases of the inertial sensors in a logged flight.

The variance of white noise follows from second differences of the readings x (T. Gasser, L. Sroka and C.
Jennen-Steinmetz, Biometrika 73, 1986),

    σ² = mean((x_{k-1} - 2 x_k + x_{k+1})²) / 6.

Second differences contain hardly any slow motion. They contain vibration and fast motion of the vehicle, which a filter
must treat as noise as well. The biases are those at the end of an estimate of the flight
(`drake_quad.identification.logged_estimate`). If the innovations of this estimate are larger than the filter expects,
the standard deviations of the biases are increased by the same factor.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.identification.logged_estimate import LoggedEstimate
from drake_quad.identification.result import EstimatedValue
from drake_quad.logs.record import FlightRecord

_NUM_BLOCKS = 20  # blocks of a flight whose means are treated as independent
_MAX_JITTER = 0.1  # largest deviation of a sampling interval from the median, relative to the median


class InertialErrors(NamedTuple):
    """Errors of an inertial sensor on its three axes.

    Attributes:
        kind: type of the sensor in the scenario language.
        period: sampling period, s.
        noise_density: noise density on each axis, in rad/s/√Hz or m/s²/√Hz.
        bias: bias on each axis, in rad/s or m/s².
    """

    kind: str
    period: float
    noise_density: tuple[EstimatedValue, ...]
    bias: tuple[EstimatedValue, ...]

    def settings(self) -> dict[str, object]:
        """Return the settings of this sensor in the scenario language.

        A scenario has one noise density for all axes; it is the root mean square over the axes.
        """
        densities = [each.value for each in self.noise_density]
        return {
            "kind": self.kind,
            "period": self.period,
            "noise_density": float(f"{np.sqrt(np.mean(np.square(densities))):.3g}"),
            "bias": [float(f"{each.value:.3g}") for each in self.bias],
        }


def inertial_errors(record: FlightRecord, estimate: LoggedEstimate) -> tuple[InertialErrors, InertialErrors]:
    """Return the errors of the gyroscope and of the accelerometer during a flight.

    Args:
        record: log with body rates and specific force.
        estimate: estimate of the same flight.

    Raises:
        InputError: if too few samples of the log have a constant period.
    """
    used = _is_regular(record.time)
    used &= np.interp(record.time[1:-1], estimate.time, estimate.is_flying) > 0.5
    if used.sum() < 2 * _NUM_BLOCKS:
        raise InputError(
            f"cannot estimate the noise of the inertial sensors: only {used.sum()} samples of the log {record.name} are"
            " in flight and have a constant period"
        )
    factor = np.sqrt(max(1.0, estimate.mean_squared_innovation))
    sensors = []
    for kind, signal, biases, first, unit in (
        ("gyroscope", "body_rates", estimate.gyroscope_bias, 9, "rad/s"),
        ("accelerometer", "specific_force", estimate.accelerometer_bias, 12, "m/s²"),
    ):
        deviations = factor * estimate.deviations[-1, first : first + 3]
        densities = _noise_densities(record.of(signal), used, estimate.period, f"{unit}/√Hz")
        bias = tuple(EstimatedValue(float(b), float(d), unit) for b, d in zip(biases, deviations, strict=True))
        sensors.append(InertialErrors(kind, estimate.period, densities, bias))
    gyroscope, accelerometer = sensors
    return gyroscope, accelerometer


def _is_regular(time: np.ndarray) -> np.ndarray:
    """Return a mask (n - 2,) of the inner samples whose distances to both neighbours are close to the median."""
    steps = np.diff(time)
    regular = np.abs(steps - np.median(steps)) < _MAX_JITTER * np.median(steps)
    return np.asarray(regular[:-1] & regular[1:])


def _noise_densities(values: np.ndarray, used: np.ndarray, period: float, unit: str) -> tuple[EstimatedValue, ...]:
    """Return the noise density of each column of readings (n, 3) at the inner samples in a mask (n - 2,)."""
    squares = (values[:-2] - 2.0 * values[1:-1] + values[2:])[used] ** 2 / 6.0
    blocks = np.array([block.mean(axis=0) for block in np.array_split(squares, _NUM_BLOCKS)])
    variances = squares.mean(axis=0)
    deviations = blocks.std(axis=0, ddof=1) / np.sqrt(_NUM_BLOCKS)
    sigmas = np.sqrt(variances)
    # The deviation of a square root is that of the number, divided by twice the root.
    errors = np.divide(deviations, 2.0 * sigmas, out=np.zeros(len(sigmas)), where=sigmas > 0.0)
    return tuple(
        EstimatedValue(float(np.sqrt(period) * sigma), float(np.sqrt(period) * error), unit, _NUM_BLOCKS - 1.0)
        for sigma, error in zip(sigmas, errors, strict=True)
    )
