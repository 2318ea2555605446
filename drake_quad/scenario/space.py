"""The space of the scenario language: obstacles, and how far a plan keeps from them."""

import re
import warnings
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from drake_quad.errors import InputError, InputWarning, shortened
from drake_quad.scenario.distributions import DISTRIBUTIONS, Model, refused
from drake_quad.scenario.limits import MOST_CORNERS, MOST_OBSTACLES, MOST_POINTS
from drake_quad.scenario.quantities import PlainDirections, PlainNonNegative, PlainPositive, PlainPositives, Point
from drake_quad.scenario.regions import BoxRegion
from drake_quad.space import space as room
from drake_quad.space.shapes import Ball, Cuboid, Cylinder, Hull, hull_of, transformed_points
from drake_quad.space.simplification import MAX_GROWTH, surrounding

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,59}")
# An obstacle with one of these names would be mistaken for the key of another mapping.
_RESERVED = ("kind", *DISTRIBUTIONS)


_CENTRE = "of the solid, in W (m)"
_ROTATION = "roll, pitch and yaw of its axes in W (rad)"


class BoxObstacle(Model):
    """A box."""

    kind: Literal["box"]
    centre: Point = Field(description=_CENTRE)
    rotation: PlainDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION)
    size: PlainPositives = Field(description="along its axes (m)")

    def shape(self) -> Cuboid:
        """Return the solid."""
        return Cuboid(self.centre, self.rotation, self.size)


class CylinderObstacle(Model):
    """A cylinder, upright unless it is turned."""

    kind: Literal["cylinder"]
    centre: Point = Field(description=_CENTRE)
    rotation: PlainDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION)
    radius: PlainPositive = Field(description="radius (m)")
    height: PlainPositive = Field(description="along its axis (m)")

    def shape(self) -> Cylinder:
        """Return the solid."""
        return Cylinder(self.centre, self.rotation, self.radius, self.height)


class SphereObstacle(Model):
    """A ball."""

    kind: Literal["sphere"]
    centre: Point = Field(description=_CENTRE)
    radius: PlainPositive = Field(description="radius (m)")

    def shape(self) -> Ball:
        """Return the solid."""
        return Ball(self.centre, radius=self.radius)


class HullObstacle(Model):
    """The convex hull of points, which are scaled, turned, and moved by the centre."""

    kind: Literal["hull"]
    points: Annotated[tuple[Point, ...], Field(strict=False, min_length=4, max_length=MOST_POINTS)] = Field(
        description="at least four, not in a plane (m); or the name of a mesh file (.obj or .stl), of which only the"
        f" corners count. A hull of more than {MOST_CORNERS} corners is replaced by one around it that is larger by at"
        f" most {100.0 * MAX_GROWTH:g} % of its size"
    )
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="where the origin of the points is, in W (m)")
    rotation: PlainDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION)
    scale: PlainPositive = Field(default=1.0, description="by which the points are multiplied (1)")

    @field_validator("points")
    @classmethod
    def _few_corners(cls, points: tuple[Point, ...]) -> tuple[Point, ...]:
        try:
            hull = surrounding(points, MOST_CORNERS)
        except InputError as error:
            raise refused(str(error)) from None
        if not hull.is_simpler:
            return points
        warnings.warn(f"obstacle of kind hull: {hull}", InputWarning, stacklevel=2)
        return tuple(map(tuple, hull.corners.tolist()))

    @model_validator(mode="after")
    def _is_solid(self) -> "HullObstacle":
        try:
            self.shape()
        except InputError as error:
            raise self.wrong(str(error), "points") from None
        return self

    def shape(self) -> Hull:
        """Return the solid."""
        return hull_of(transformed_points(self.points, centre=self.centre, rotation=self.rotation, scale=self.scale))


AnyObstacle = Annotated[BoxObstacle | CylinderObstacle | SphereObstacle | HullObstacle, Field(discriminator="kind")]


class SpaceSettings(Model):
    """Obstacles: a vehicle that touches one has crashed, and plans lead around them."""

    bounds: BoxRegion | None = Field(
        default=None, description="that a plan does not leave, for the centre of mass; they are not solid"
    )
    obstacles: dict[str, AnyObstacle] = Field(default={}, description="solids by their names")
    margin: PlainNonNegative = Field(default=0.0, description="that a plan keeps from obstacles beyond the radius (m)")
    radius: PlainPositive | None = Field(
        default=None,
        description="of the vehicle around its centre of mass (m); if not given, that of the farthest rotor's centre"
        " in `nominal`",
    )
    tracking: PlainNonNegative | None = Field(
        default=None,
        description="multiple of the predicted RMS position error that a plan keeps beyond the margin (1); the error is"
        " that of hovers, flown by the nominal vehicle under the scenario's control, in its steady wind and turbulence,"
        " with its noise and losses",
    )

    @field_validator("obstacles", mode="before")
    @classmethod
    def _named(cls, obstacles: Any) -> Any:
        if not isinstance(obstacles, dict):
            raise refused("must be a mapping of names to solids")
        if len(obstacles) > MOST_OBSTACLES:
            raise refused(f"there may be {MOST_OBSTACLES} obstacles, not {len(obstacles)}")
        for name in obstacles:
            if not _NAME.fullmatch(str(name)) or name in _RESERVED:
                demand = "the name of an obstacle must be of letters, digits, '_' and '-', and none of "
                raise refused(demand + ", ".join(_RESERVED), path=(shortened(str(name)),))
        return obstacles

    def room(self, farthest_rotor: float, tracking_error: float = 0.0) -> room.Space:
        """Return the space with its solids.

        Args:
            farthest_rotor: distance of the farthest rotor's centre from the centre of mass, m.
            tracking_error: predicted RMS position error, m.
        """
        return room.Space(
            tuple(room.Obstacle(name, obstacle.shape()) for name, obstacle in self.obstacles.items()),
            farthest_rotor if self.radius is None else self.radius,
            None if self.bounds is None else self.bounds.box(),
            self.margin,
            (self.tracking or 0.0) * tracking_error,
        )
