"""Space in the scenario language: obstacles, and the clearance between plan and obstacles."""

import re
import warnings
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from drake_quad.errors import InputError, InputWarning, shorten_text
from drake_quad.scenario.distributions import DISTRIBUTIONS, Model, validation_error
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.limits import MAX_CORNERS, MAX_OBSTACLES, MAX_POINTS
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import FixedDirections, FixedNonNegative, FixedPositive, FixedPositives, Point
from drake_quad.scenario.regions import BoxRegion
from drake_quad.space.shapes import Ball, Cuboid, Cylinder, Hull, convex_hull, transformed_points
from drake_quad.space.simplification import MAX_GROWTH, simplified_hull
from drake_quad.space.space import Obstacle, Space

_NAME_PATTERN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,59}")
# Names that obstacles must not have, since these keys have a special meaning when layers are merged.
_RESERVED_NAMES = ("kind", *DISTRIBUTIONS)


_CENTRE_DESCRIPTION = "centre of the solid, in W (m)"
_ROTATION_DESCRIPTION = "roll, pitch and yaw of the axes of the solid in W (rad)"


class BoxObstacle(Model):
    """A box."""

    kind: Literal["box"]
    centre: Point = Field(description=_CENTRE_DESCRIPTION)
    rotation: FixedDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION_DESCRIPTION)
    size: FixedPositives = Field(description="lengths of the edges along the axes of the box (m)")

    def shape(self) -> Cuboid:
        """Return the obstacle as a solid for the planner."""
        return Cuboid(self.centre, self.rotation, self.size)


class CylinderObstacle(Model):
    """A cylinder, which is upright unless it is rotated."""

    kind: Literal["cylinder"]
    centre: Point = Field(description=_CENTRE_DESCRIPTION)
    rotation: FixedDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION_DESCRIPTION)
    radius: FixedPositive = Field(description="radius (m)")
    height: FixedPositive = Field(description="height along the axis of the cylinder (m)")

    def shape(self) -> Cylinder:
        """Return the obstacle as a solid for the planner."""
        return Cylinder(self.centre, self.rotation, self.radius, self.height)


class SphereObstacle(Model):
    """A ball."""

    kind: Literal["sphere"]
    centre: Point = Field(description=_CENTRE_DESCRIPTION)
    radius: FixedPositive = Field(description="radius (m)")

    def shape(self) -> Ball:
        """Return the obstacle as a solid for the planner."""
        return Ball(self.centre, radius=self.radius)


class HullObstacle(Model):
    """The convex hull of points, which are scaled, rotated and then translated."""

    kind: Literal["hull"]
    points: Annotated[tuple[Point, ...], Field(strict=False, min_length=4, max_length=MAX_POINTS)] = Field(
        description="four points (m) or more, not in a plane; or the name of a mesh file (.obj or .stl) with points."
        f" A hull with more than {MAX_CORNERS} corners is replaced by a simpler enclosing hull, larger by at most"
        f" {100.0 * MAX_GROWTH:g} % of its size"
    )
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="position of the origin of the points, in W (m)")
    rotation: FixedDirections = Field(default=(0.0, 0.0, 0.0), description=_ROTATION_DESCRIPTION)
    scale: FixedPositive = Field(default=1.0, description="scale factor of the points (1)")

    @field_validator("points")
    @classmethod
    def _simplified(cls, points: tuple[Point, ...]) -> tuple[Point, ...]:
        try:
            hull = simplified_hull(points, MAX_CORNERS)
        except InputError as error:
            raise validation_error(str(error)) from None
        if not hull.is_simpler:
            return points
        warnings.warn(f"obstacle of kind hull: {hull}", InputWarning, stacklevel=2)
        return tuple(map(tuple, hull.corners.tolist()))

    @model_validator(mode="after")
    def _is_solid(self) -> "HullObstacle":
        try:
            self.shape()
        except InputError as error:
            raise self.field_error(str(error), "points") from None
        return self

    def shape(self) -> Hull:
        """Return the obstacle as a solid for the planner."""
        return convex_hull(
            transformed_points(self.points, centre=self.centre, rotation=self.rotation, scale=self.scale)
        )


AnyObstacle = Annotated[BoxObstacle | CylinderObstacle | SphereObstacle | HullObstacle, Field(discriminator="kind")]


class SpaceSettings(Model):
    """Obstacles that plans avoid. A vehicle that touches an obstacle counts as crashed."""

    bounds: BoxRegion | None = Field(
        default=None,
        description="box in which a plan must keep the centre of mass; a flight that leaves it is not a crash",
    )
    obstacles: dict[str, AnyObstacle] = Field(default={}, description="solids, by name")
    margin: Annotated[FixedNonNegative, needs("obstacles")] = Field(
        default=0.0, description="distance that a plan keeps from obstacles in addition to the radius (m)"
    )
    radius: Annotated[FixedPositive | None, needs("obstacles"), PLAUSIBLE_SIZE] = Field(
        default=None,
        description="radius of the vehicle around its centre of mass (m); if not given, the distance of the farthest"
        " rotor centre in `nominal`",
    )
    tracking_error_factor: Annotated[FixedNonNegative | None, needs("obstacles")] = Field(
        default=None,
        description="multiple (1) of the predicted RMS position error by which a plan increases its distance"
        " from obstacles, in addition to the margin; the prediction is for a hover of the nominal vehicle with the"
        " scenario's control, steady wind, turbulence, noise and losses",
    )

    @field_validator("obstacles", mode="before")
    @classmethod
    def _names_are_allowed(cls, obstacles: Any) -> Any:
        if not isinstance(obstacles, dict):
            raise validation_error("must be a mapping of names to solids")
        if len(obstacles) > MAX_OBSTACLES:
            raise validation_error(f"must have at most {MAX_OBSTACLES} obstacles, not {len(obstacles)}")
        for name in obstacles:
            if not _NAME_PATTERN.fullmatch(str(name)) or name in _RESERVED_NAMES:
                demand = "the name of an obstacle must consist of letters, digits, '_' and '-', and not be one of "
                raise validation_error(demand + ", ".join(_RESERVED_NAMES), path=(shorten_text(str(name)),))
        return obstacles

    def flight_space(self, farthest_rotor: float, tracking_error: float = 0.0) -> Space:
        """Return the space with its solids and clearances, in the form that planner and simulation use.

        Args:
            farthest_rotor: distance of the farthest rotor centre from the centre of mass, m.
            tracking_error: predicted RMS position error, m.
        """
        return Space(
            tuple(Obstacle(name, obstacle.shape()) for name, obstacle in self.obstacles.items()),
            farthest_rotor if self.radius is None else self.radius,
            None if self.bounds is None else self.bounds.box(),
            self.margin,
            (self.tracking_error_factor or 0.0) * tracking_error,
        )
