"""Position, velocity and axes of a sensor that is fixed to the vehicle."""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, cross, plus
from drake_quad.signals import Quantity, Row, State


class SensorPosition(NamedTuple):
    """Position of a sensor relative to the centre of mass."""

    x: Annotated[Row, Quantity("m", "B")] = 0.0
    y: Annotated[Row, Quantity("m", "B")] = 0.0
    z: Annotated[Row, Quantity("m", "B")] = 0.0


def axes_of(state: State) -> BodyAxes:
    """Return the axes of the body frame B of a vehicle, as vectors in W."""
    return BodyAxes.of(state.roll, state.pitch, state.yaw)


def place(state: State, axes: BodyAxes, position: SensorPosition) -> Vector:
    """Return the position of a sensor in W, m."""
    return plus(Vector(state.x, state.y, state.z), axes.in_world(Vector(*position)))


def lever_velocity(state: State, position: SensorPosition) -> Vector:
    """Return the velocity ω × r of a sensor relative to the centre of mass, along the axes of B, m/s."""
    return cross(Vector(state.p, state.q, state.r), Vector(*position))
