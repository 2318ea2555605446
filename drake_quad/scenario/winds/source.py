"""Sources of wind, and the questions about them that the rest of the library asks.

A wind of your own is a class that extends `WindSource` and is registered with `WINDS.member`.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from drake_quad.framework.elementary import sin_cos
from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.fans import Jet
from drake_quad.scenario.distributions import Model, refused
from drake_quad.scenario.quantities import Direction, NonNegative, Position
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import Row, VelocityW, Wind


class WindSurroundings(NamedTuple):
    """Properties of the laboratory that a source may depend on.

    Attributes:
        steady_wind: sum of all steady winds.
        period: time for which each sample of the wind is held, s.
    """

    steady_wind: Wind
    period: float


class WindSource(Model):
    """Source of wind. Numbers that a study draws are (N,) arrays when its methods are called for a fleet.

    Attributes:
        depends_on_place: whether the mean wind differs from place to place.
        depends_on_time: whether the mean wind changes during a flight.
    """

    kind: str
    depends_on_place: ClassVar[bool]
    depends_on_time: ClassVar[bool]

    def steady_wind(self) -> Wind:
        """Return the part of the wind that is the same everywhere and always, m/s."""
        return Wind(0.0, 0.0, 0.0)

    def jets(self) -> tuple[Jet, ...]:
        """Return the free jets of the source."""
        return ()

    @abstractmethod
    def max_speed(self) -> VelocityW:
        """Return the largest speed of the mean wind beyond its steady part, m/s."""

    @abstractmethod
    def without_turbulence(self) -> "WindSource | None":
        """Return the source without its random part; None if nothing remains."""

    @abstractmethod
    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe for the system that makes this wind."""

    @classmethod
    def recipes(cls, sources: Sequence["WindSource"], surroundings: WindSurroundings) -> dict[str, Recipe]:
        """Return the recipes for all sources of this kind in a laboratory, by name.

        Seeds depend on the names. Sources are counted by kind, so that a source of another kind changes no turbulence.
        """
        return {f"{source.kind}_{i}": source.recipe(surroundings) for i, source in enumerate(sources)}


WINDS = OpenUnion(WindSource)
"""Kinds of sources of wind."""

AnyWindSource = Annotated[WindSource, WINDS]


class BlowingSource(WindSource):
    """Air that moves at a velocity, or level at a speed in a heading."""

    velocity: Position | None = Field(default=None, description="of the air at its height, in W (m/s)")
    speed: NonNegative | None = Field(default=None, description="of the air, in place of a velocity (m/s)")
    heading: Direction | None = Field(
        default=None, description="to which it blows, with a speed, from X towards Y (rad)"
    )

    @model_validator(mode="after")
    def _one_motion(self) -> "BlowingSource":
        given = [name for name in ("velocity", "speed", "heading") if getattr(self, name) is not None]
        if given not in (["velocity"], ["speed", "heading"]):
            found = " and ".join(given) or "neither"
            raise refused(f"must have a velocity, or speed and heading, not {found}")
        return self

    def full_velocity(self) -> Wind:
        """Return the velocity of the air at its height, m/s."""
        if self.velocity is not None:
            return Wind(*self.velocity)
        assert self.speed is not None
        assert self.heading is not None
        sin_heading, cos_heading = sin_cos(self.heading)
        return Wind(self.speed * cos_heading, self.speed * sin_heading, 0.0)

    def max_speed(self) -> VelocityW:
        """Return the speed of the air at its height, m/s."""
        return speed(self.full_velocity())

    def without_turbulence(self) -> WindSource | None:
        """Return the source itself, which is not random."""
        return self


def steady_wind(sources: Iterable[WindSource]) -> Wind:
    """Return the sum of the steady parts of sources of wind, m/s."""
    winds = [source.steady_wind() for source in sources]
    return Wind._make(sum(parts, start=0.0) for parts in zip(Wind(0.0, 0.0, 0.0), *winds, strict=True))


def jets(sources: Iterable[WindSource]) -> tuple[Jet, ...]:
    """Return the free jets of sources of wind."""
    return tuple([jet for source in sources for jet in source.jets()])


def speed(wind: Wind) -> Row:
    """Return the speed of the air, m/s."""
    squares: Any = sum(part * part for part in wind)
    return np.sqrt(squares)
