"""Base class of wind sources, and their registry `WINDS`.

To add a source, extend `WindSource` and register the class with `WINDS.register`.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from drake_quad.framework.elementary import sin_cos
from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.fans import Jet
from drake_quad.scenario.distributions import Model, validation_error
from drake_quad.scenario.plausible import Plausible
from drake_quad.scenario.quantities import Direction, NonNegative, Position
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import Row, VelocityW, Wind


class WindSurroundings(NamedTuple):
    """Laboratory properties on which a wind source may depend.

    Attributes:
        steady_wind: sum of all steady winds.
        period: period for which each wind sample is held, s.
    """

    steady_wind: Wind
    period: float


class WindSource(Model):
    """Wind source. In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        depends_on_position: True if the mean wind depends on the position.
        depends_on_time: True if the mean wind changes during a flight.
    """

    kind: str
    depends_on_position: ClassVar[bool]
    depends_on_time: ClassVar[bool]

    def steady_wind(self) -> Wind:
        """Return the part of the wind that is independent of position and time, m/s."""
        return Wind(0.0, 0.0, 0.0)

    def jets(self) -> tuple[Jet, ...]:
        """Return the free jets of the wind source; only fans have any."""
        return ()

    @abstractmethod
    def max_speed(self) -> VelocityW:
        """Return the largest speed of the part of the mean wind that varies with time or position, m/s."""

    @abstractmethod
    def without_turbulence(self) -> "WindSource | None":
        """Return the wind source without its random part; None if no wind remains."""

    @abstractmethod
    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build the system that computes this wind."""

    @classmethod
    def recipes(cls, sources: Sequence["WindSource"], surroundings: WindSurroundings) -> dict[str, Recipe]:
        """Return the recipes to build all sources of this kind in a laboratory, by name.

        The random numbers of a source depend on its name. The names number the sources within their kind, so adding a
        source of another kind does not change the turbulence.
        """
        return {f"{source.kind}_{i}": source.recipe(surroundings) for i, source in enumerate(sources)}


WINDS = OpenUnion(WindSource)
"""Registry of the kinds of wind sources."""

AnyWindSource = Annotated[WindSource, WINDS]

# The strongest hurricanes have wind speeds of 85 m/s.
_PLAUSIBLE_WIND = Plausible("m/s", "km/h", 1.0 / 3.6, upper=85.0)


class BlowingSource(WindSource):
    """Wind whose velocity is given as a vector, or as a horizontal speed and a heading."""

    velocity: Annotated[Position | None, _PLAUSIBLE_WIND] = Field(
        default=None, description="velocity of the air in W (m/s); the peak velocity of a gust or a sine"
    )
    speed: Annotated[NonNegative | None, _PLAUSIBLE_WIND] = Field(
        default=None,
        description="horizontal speed of the air (m/s), the peak speed of a gust or a sine; speed and heading replace"
        " velocity",
    )
    heading: Direction | None = Field(
        default=None,
        description="direction towards which the wind blows, from X towards Y (rad); required if speed is given",
    )
    strength_fields: ClassVar = ("velocity", "speed")

    @model_validator(mode="after")
    def _has_one_form(self) -> "BlowingSource":
        specified = [name for name in ("velocity", "speed", "heading") if getattr(self, name) is not None]
        if specified not in (["velocity"], ["speed", "heading"]):
            specified_text = " and ".join(specified) or "none of them"
            raise validation_error(f"must have either a velocity or both speed and heading, not {specified_text}")
        return self

    def full_velocity(self) -> Wind:
        """Return the peak wind velocity, m/s."""
        if self.velocity is not None:
            return Wind(*self.velocity)
        assert self.speed is not None
        assert self.heading is not None
        sin_heading, cos_heading = sin_cos(self.heading)
        return Wind(self.speed * cos_heading, self.speed * sin_heading, 0.0)

    def max_speed(self) -> VelocityW:
        """Return the peak wind speed, m/s."""
        return speed(self.full_velocity())

    def without_turbulence(self) -> WindSource | None:
        """Return the wind source itself, which has no random part."""
        return self


def steady_wind(sources: Iterable[WindSource]) -> Wind:
    """Return the sum of the steady winds of all sources, m/s."""
    winds = [source.steady_wind() for source in sources]
    return Wind._make(sum(parts, start=0.0) for parts in zip(Wind(0.0, 0.0, 0.0), *winds, strict=True))


def jets(sources: Iterable[WindSource]) -> tuple[Jet, ...]:
    """Return the free jets of all sources."""
    return tuple([jet for source in sources for jet in source.jets()])


def speed(wind: Wind) -> Row:
    """Return the magnitude of a wind velocity, m/s."""
    squares: Any = sum(part * part for part in wind)
    return np.sqrt(squares)
