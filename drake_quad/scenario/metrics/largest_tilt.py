"""Largest tilt of the vehicle."""

from drake_quad.framework.elementary import arctan2, cos, maximum, sqrt
from drake_quad.scenario.metrics.metric import metric
from drake_quad.signals import Angle, State


@metric("rad", over_time="max", label="largest tilt")
def largest_tilt(state: State) -> Angle:
    """Largest angle between the thrust axis and the vertical; π for a vehicle that is upside down."""
    cosine = cos(state.roll) * cos(state.pitch)
    return arctan2(sqrt(maximum(1.0 - cosine * cosine, 0.0)), cosine)
