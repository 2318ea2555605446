"""Optical flow: angular velocity of the ground in the image of a camera that looks along -z of the body.

    flow_x = v_x / d - q + σ n        flow_y = v_y / d + p + σ n

with the velocity v of the sensor along the axes of B, the body rates p and q, the distance d to the ground along -z of
B, and standard normal n. Without noise, v_x is (flow_x + q) d, and v_y is (flow_y - p) d. The ground is a horizontal
plane. The model neglects the slope of the ground in the image of a tilted camera, and the corners of the image.

A reading is missing if the distance is outside the range of the camera, or if the flow is larger than the largest flow
for which successive images can be matched.
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.mounting import SensorPosition, axes_of, lever_velocity
from drake_quad.laboratory.sensors.range_finder import distance_to_ground
from drake_quad.laboratory.sensors.sensor import Sample, SensorLaw
from drake_quad.signals import Number, PositionW, Quantity, Row, State

_Flow = Annotated[Row, Quantity("rad/s", "B")]


class Flow(NamedTuple):
    """Angular velocity of the ground in the image along x and y of B, in the direction of the motion of the vehicle."""

    x: _Flow
    y: _Flow


class OpticalFlowParameters(NamedTuple):
    """Position, range and errors of an optical flow sensor.

    Attributes:
        position: position of the sensor.
        ground: height of the ground in W.
        min_distance: smallest distance at which the camera is in focus.
        max_distance: largest distance at which the texture of the ground is visible.
        max_flow: largest flow on each axis.
        flow_noise: standard deviation of the noise of a reading on each axis.
        scale_error: relative scale error of the readings.
        latency_samples: latency, a whole number of periods.
    """

    position: SensorPosition = SensorPosition()
    ground: PositionW = 0.0
    min_distance: Annotated[Row, Quantity("m")] = 0.0
    max_distance: Annotated[Row, Quantity("m")] = 100.0
    max_flow: Annotated[Row, Quantity("rad/s")] = 100.0
    flow_noise: Annotated[Row, Quantity("rad/s", sign="nonnegative")] = 0.0
    scale_error: Number = 0.0
    latency_samples: Number = 0.0


def optical_flow_reading(parameters: OpticalFlowParameters, noise: Flow | None, state: State) -> Sample:
    """Return a reading of an optical flow sensor, with noise unless `noise` is None."""
    velocity = axes_of(state).in_body(Vector(state.v_x, state.v_y, state.v_z))
    lever = lever_velocity(state, parameters.position)
    distance, points_down = distance_to_ground(state, parameters.position, parameters.ground)
    true = Flow((velocity.x + lever.x) / distance - state.q, (velocity.y + lever.y) / distance + state.p)
    is_near = points_down & (distance >= parameters.min_distance) & (distance <= parameters.max_distance)
    valid = is_near & (abs(true.x) <= parameters.max_flow) & (abs(true.y) <= parameters.max_flow)
    flow = Flow._make((1.0 + parameters.scale_error) * part for part in true)
    if noise is not None:
        flow = Flow._make(part + parameters.flow_noise * number for part, number in zip(flow, noise, strict=True))
    return Sample(flow, valid)


OPTICAL_FLOW = SensorLaw(Flow, optical_flow_reading, ("state",), can_miss=True)
"""Measurement law of optical flow."""
