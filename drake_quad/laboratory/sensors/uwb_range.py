"""Ultra-wideband radio: distance to an anchor.

    reading = |p + R_WB r - a| + b + σ n + o

with the position r of the antenna in B, the position a of the anchor in W, a bias b, and standard normal n. o is zero
except for outliers: with a given probability, a reflection is received instead of the direct signal, and o is the
magnitude of a normal number, since a reflected path is longer. A reading is missing beyond the range of the radio.
"""

from typing import Annotated, NamedTuple

import scipy

from drake_quad.framework.elementary import where
from drake_quad.geometry.axes import Vector, length, minus
from drake_quad.laboratory.sensors.mounting import SensorPosition, axes_of, place
from drake_quad.laboratory.sensors.sensor import Sample, SensorLaw
from drake_quad.signals import Number, PositionW, Quantity, Row, State


class AnchorDistance(NamedTuple):
    """Distance between the antenna and an anchor."""

    distance: Annotated[Row, Quantity("m")]


class Anchor(NamedTuple):
    """Position of an anchor."""

    x: PositionW
    y: PositionW
    z: PositionW


class Outliers(NamedTuple):
    """Outliers: distances that are too long because a reflection is received.

    Attributes:
        threshold: a reading is an outlier if a standard normal sample is below this number.
        deviation: standard deviation of the normal number whose magnitude is added.
    """

    threshold: Number
    deviation: Annotated[Row, Quantity("m", sign="nonnegative")]

    @classmethod
    def of(cls, rate: Row, deviation: Row) -> "Outliers":
        """Return the parameters for a probability of outliers and a standard deviation, m; arguments may be arrays."""
        return cls(scipy.special.ndtri(rate), deviation)


class UwbErrors(NamedTuple):
    """Errors that can be switched off; None for an error that is switched off.

    Attributes:
        outlier_rate: parameters of the outliers.
    """

    outlier_rate: Outliers | None = None


class UwbParameters(NamedTuple):
    """Positions of antenna and anchor, and errors of the distance.

    Attributes:
        anchor: position of the anchor.
        position: position of the antenna on the vehicle.
        max_distance: range of the radio.
        bias: constant error of the readings.
        distance_noise: standard deviation of the noise of a reading.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    anchor: Anchor
    position: SensorPosition = SensorPosition()
    max_distance: Annotated[Row, Quantity("m")] = 100.0
    bias: Annotated[Row, Quantity("m")] = 0.0
    distance_noise: Annotated[Row, Quantity("m", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0
    errors: UwbErrors = UwbErrors()


class OutlierNoise(NamedTuple):
    """Standard normal samples that determine whether a reading is an outlier, and the size of the outlier."""

    outlier: Number
    size: Number


class UwbNoise(NamedTuple):
    """Standard normal samples for a reading.

    Attributes:
        white: sample for the white noise.
        outlier_rate: samples that determine whether the reading is an outlier, and its size; None if outliers are
            switched off.
    """

    white: Number
    outlier_rate: OutlierNoise | None


def uwb_noise(parameters: UwbParameters) -> UwbNoise:
    """Return a noise record of zeros for a reading; the fields of errors that are switched off are None."""
    return UwbNoise(0.0, None if parameters.errors.outlier_rate is None else OutlierNoise(0.0, 0.0))


def uwb_reading(parameters: UwbParameters, noise: UwbNoise | None, state: State) -> Sample:
    """Return a distance to an anchor, with noise unless `noise` is None."""
    antenna = place(state, axes_of(state), parameters.position)
    true = length(minus(antenna, Vector(*parameters.anchor)))
    reading = true + parameters.bias
    if noise is not None:
        reading = reading + parameters.distance_noise * noise.white
        outliers = parameters.errors.outlier_rate
        if outliers is not None and noise.outlier_rate is not None:
            is_outlier = noise.outlier_rate.outlier < outliers.threshold
            reading = reading + where(is_outlier, outliers.deviation * abs(noise.outlier_rate.size), 0.0)
    return Sample(AnchorDistance(reading), true <= parameters.max_distance)


UWB_RANGE = SensorLaw(AnchorDistance, uwb_reading, ("state",), noise=uwb_noise, can_miss=True)
"""Measurement law of a distance to an ultra-wideband anchor."""
