"""Regions of the scenario language."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from drake_quad.errors import InputError
from drake_quad.reference.regions import Box, Corridor, Polytope
from drake_quad.scenario.distributions import Model, omits_defaults, refused
from drake_quad.scenario.quantities import PlainPositive, Point

_MAX_FACES = 100
_MIN_NORMAL = 1e-9  # a shorter normal has no direction


def _check_corners(region: Model, lowest: Sequence[float], highest: Sequence[float]) -> None:
    for i, (low, high) in enumerate(zip(lowest, highest, strict=True)):
        if low > high:
            raise region.wrong(f"must not be less than that of min, {low}", "max", i)


class BoxRegion(Model):
    """An axis-aligned box."""

    min: Point = Field(description="lowest corner, in W (m)")
    max: Point = Field(description="highest corner, in W (m)")

    @model_validator(mode="after")
    def _not_empty(self) -> "BoxRegion":
        _check_corners(self, self.min, self.max)
        return self

    def box(self) -> Box:
        """Return the region as the planner has it."""
        return Box(self.min, self.max)


class HalfSpace(Model):
    """All that lies behind a plane."""

    normal: Point = Field(description="out of the half-space, in W; of any length (1)")
    point: Point = Field(description="on the plane, in W (m)")

    @model_validator(mode="after")
    def _has_a_direction(self) -> "HalfSpace":
        if not np.linalg.norm(self.normal) > _MIN_NORMAL:
            raise self.wrong("must not be zero", "normal")
        return self


class CorridorRegion(Model):
    """A box, or what lies behind planes of any direction, or both at once: the part of the box behind the planes."""

    min: Point | None = Field(default=None, description="lowest corner, in W (m)")
    max: Point | None = Field(default=None, description="highest corner, in W (m)")
    half_spaces: Annotated[tuple[HalfSpace, ...], Field(strict=False, min_length=1, max_length=_MAX_FACES)] | None = (
        Field(default=None, description="the corridor lies in all of them")
    )

    _written = omits_defaults("min", "max", "half_spaces")

    @model_validator(mode="after")
    def _not_empty(self) -> "CorridorRegion":
        if (self.min is None) != (self.max is None):
            missing = "min" if self.min is None else "max"
            raise self.wrong("must be given: a box has both corners", missing)
        if self.min is None and self.half_spaces is None:
            raise refused("must have min and max, or half_spaces, or both")
        if self.min is not None and self.max is not None:
            _check_corners(self, self.min, self.max)
        if self.half_spaces is not None:
            try:
                region = self.region()
            except InputError:
                region = None
            beside = "" if self.min is None else " of the box"
            if region is None:
                left = "no point"
            elif isinstance(region, Polytope) and region.is_flat:
                left = "no more than a plane, a line or a point"
            else:
                return self
            raise refused(f"must have room: its half-spaces leave {left}{beside}")
        return self

    def region(self) -> Corridor | None:
        """Return the region as the planner has it; None if the half-spaces leave nothing of the box.

        Raises:
            InputError: the half-spaces have no point in common.
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
    radius: PlainPositive = Field(description="radius (m)")
