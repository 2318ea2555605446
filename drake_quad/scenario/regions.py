"""Regions for waypoints and corridors in the scenario language."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from drake_quad.errors import InputError
from drake_quad.reference.regions import Box, Corridor, Polytope
from drake_quad.scenario.distributions import Model, omits_defaults, validation_error
from drake_quad.scenario.quantities import FixedPositive, Point

_MAX_HALF_SPACES = 100  # of one corridor
_MIN_NORMAL_LENGTH = 1e-9  # the direction of a shorter normal is numerically undefined


def _check_corners(region: Model, lowest: Sequence[float], highest: Sequence[float]) -> None:
    for i, (low, high) in enumerate(zip(lowest, highest, strict=True)):
        if low > high:
            raise region.field_error(f"must not be smaller than the same coordinate of min, {low}", "max", i)


class BoxRegion(Model):
    """An axis-aligned box."""

    min: Point = Field(description="lowest corner, in W (m)")
    max: Point = Field(description="highest corner, in W (m)")

    @model_validator(mode="after")
    def _not_empty(self) -> "BoxRegion":
        _check_corners(self, self.min, self.max)
        return self

    def box(self) -> Box:
        """Return the region as a `Box` of the path planner."""
        return Box(self.min, self.max)


class HalfSpace(Model):
    """All points on the side of a plane that is opposite to its normal."""

    normal: Point = Field(description="normal of the plane in W, of any length (1), which points out of the half-space")
    point: Point = Field(description="any point on the plane, in W (m)")

    @model_validator(mode="after")
    def _has_a_direction(self) -> "HalfSpace":
        if not np.linalg.norm(self.normal) > _MIN_NORMAL_LENGTH:
            raise self.field_error("must not be zero", "normal")
        return self


class CorridorRegion(Model):
    """A box, an intersection of half-spaces, or the intersection of a box with half-spaces."""

    min: Point | None = Field(default=None, description="lowest corner, in W (m)")
    max: Point | None = Field(default=None, description="highest corner, in W (m)")
    half_spaces: (
        Annotated[tuple[HalfSpace, ...], Field(strict=False, min_length=1, max_length=_MAX_HALF_SPACES)] | None
    ) = Field(default=None, description="half-spaces whose intersection is the corridor")

    _serialized = omits_defaults("min", "max", "half_spaces")

    @model_validator(mode="after")
    def _not_empty(self) -> "CorridorRegion":
        if (self.min is None) != (self.max is None):
            missing = "min" if self.min is None else "max"
            raise self.field_error("must be given, since a box needs both corners", missing)
        if self.min is None and self.half_spaces is None:
            raise validation_error("must have min and max, or half_spaces, or all three")
        if self.min is not None and self.max is not None:
            _check_corners(self, self.min, self.max)
        if self.half_spaces is not None:
            try:
                region = self.region()
            except InputError:
                region = None
            parts = "its half-spaces" if self.min is None else "its box and its half-spaces"
            if region is None:
                common = "no point"
            elif isinstance(region, Polytope) and region.is_flat:
                common = "only a plane, a line or a point"
            else:
                return self
            raise validation_error(f"must have a volume, but {parts} have {common} in common")
        return self

    def region(self) -> Corridor | None:
        """Convert the region to a corridor for the planner; None if the box does not intersect the half-spaces.

        Raises:
            InputError: if the half-spaces have no point in common.
        """
        box = None if self.min is None or self.max is None else Box(self.min, self.max)
        if self.half_spaces is None:
            return box
        normals = np.array([half_space.normal for half_space in self.half_spaces])
        points = np.array([half_space.point for half_space in self.half_spaces])
        polytope = Polytope(normals, (normals * points).sum(axis=1))
        return polytope if box is None else polytope.intersection(box)


class SphereRegion(Model):
    """A ball."""

    centre: Point = Field(description="centre, in W (m)")
    radius: FixedPositive = Field(description="radius (m)")
