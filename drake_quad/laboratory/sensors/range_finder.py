"""Range finder: distance to the ground along -z of the body.

    reading = (h - h_g) / cos ϑ + b + (σ + κ d) n

with the height h of the sensor, the height h_g of the ground, the tilt ϑ, the distance d, a bias b, and standard normal
n. The ground is a horizontal plane without obstacles. A reading is missing if the distance is outside the range of the
sensor, or if the sensor is below the ground or points above the horizon.
"""

from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import maximum
from drake_quad.laboratory.sensors.mounting import SensorPosition, axes_of, place
from drake_quad.laboratory.sensors.sensor import Sample, SensorLaw
from drake_quad.signals import Number, PositionW, Quantity, Row, State

# Lower bounds of the cosine of the tilt and of the distance (m), which are used as divisors. Readings are missing if
# the cosine is not above its bound.
_MIN_COSINE = 1e-3
MIN_DISTANCE = 1e-3  # m


class GroundDistance(NamedTuple):
    """Distance to the ground along -z of B."""

    distance: Annotated[Row, Quantity("m")]


class RangeFinderParameters(NamedTuple):
    """Position, range and errors of a range finder.

    Attributes:
        position: position of the sensor.
        ground: height of the ground in W.
        min_distance: smallest distance that is measured.
        max_distance: largest distance that is measured.
        bias: constant error of the readings.
        distance_noise: standard deviation σ of the noise at distance 0.
        relative_noise: ratio κ by which the standard deviation grows with the distance.
        latency_samples: latency, a whole number of periods.
    """

    position: SensorPosition = SensorPosition()
    ground: PositionW = 0.0
    min_distance: Annotated[Row, Quantity("m")] = 0.0
    max_distance: Annotated[Row, Quantity("m")] = 4.0
    bias: Annotated[Row, Quantity("m")] = 0.0
    distance_noise: Annotated[Row, Quantity("m", sign="nonnegative")] = 0.0
    relative_noise: Annotated[Row, Quantity("1", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0


def distance_to_ground(state: State, position: SensorPosition, ground: PositionW) -> tuple[Row, bool]:
    """Return the distance to the ground along -z of B, m, and whether -z points at the ground.

    The distance is at least `MIN_DISTANCE`, so that it can be a divisor.
    """
    axes = axes_of(state)
    height = place(state, axes, position).z - ground
    points_down = (axes.z.z > _MIN_COSINE) & (height > 0.0)
    return maximum(height / maximum(axes.z.z, _MIN_COSINE), MIN_DISTANCE), points_down


def range_finder_reading(parameters: RangeFinderParameters, noise: GroundDistance | None, state: State) -> Sample:
    """Return a reading of a range finder, with noise unless `noise` is None."""
    distance, points_down = distance_to_ground(state, parameters.position, parameters.ground)
    valid = points_down & (distance >= parameters.min_distance) & (distance <= parameters.max_distance)
    reading = distance + parameters.bias
    if noise is not None:
        deviation = parameters.distance_noise + parameters.relative_noise * distance
        reading = reading + deviation * noise.distance
    return Sample(GroundDistance(reading), valid)


RANGE_FINDER = SensorLaw(GroundDistance, range_finder_reading, ("state",), can_miss=True)
"""Measurement law of a range finder."""
