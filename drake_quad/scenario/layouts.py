"""Rotor layouts of the scenario language."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.framework.elementary import sqrt
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Position, Positive
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotor, Rotors

_DIRECTIONS = {"clockwise": CLOCKWISE, "anticlockwise": ANTICLOCKWISE}
_Turns = Literal["clockwise", "anticlockwise"]


class RotorLayout(Model):
    """Positions and directions of rotation of four rotors.

    Numbers that a study draws are (N,) arrays when the methods are called for a fleet.

    Attributes:
        is_paired: whether all airframes with the layout have their rotors in pairs, see `paired_rotor_action`.
        has_sides: whether a crossbar leads to a bar on each side; else each rotor has an arm from the middle.
    """

    kind: str
    is_paired: ClassVar[bool]
    has_sides: ClassVar[bool]

    @property
    @abstractmethod
    def has_distances(self) -> bool:
        """True if the layout determines the positions of its rotors; else the arm length does."""

    @abstractmethod
    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors of an airframe with this layout."""


LAYOUTS = OpenUnion(RotorLayout)
"""Kinds of layouts."""

Layout = Annotated[RotorLayout, LAYOUTS]


class _Alternating(RotorLayout):
    """Four rotors that are alike, numbered clockwise from the front; neighbours turn against each other."""

    rotor_1_turns: _Turns = Field(default="clockwise", description="seen from above")
    length: Positive | None = Field(
        default=None, description="between the rotors in front and those at the back, in place of arm_length (m)"
    )
    width: Positive | None = Field(
        default=None, description="between the rotors on the right and those on the left, with length (m)"
    )
    is_paired: ClassVar = True
    has_sides: ClassVar = False
    _shape: ClassVar[Callable[..., Rotors]] = Rotors.x
    # Distance between opposite sides over the arm length.
    _distance_per_arm: ClassVar = sqrt(2.0)

    @model_validator(mode="after")
    def _both_or_none(self) -> "_Alternating":
        if (self.length is None) != (self.width is None):
            given, other = ("length", "width") if self.width is None else ("width", "length")
            raise PydanticCustomError("distances", "must have {other} beside {given}", {"other": other, "given": given})
        return self

    @property
    def has_distances(self) -> bool:
        """True if there are a length and a width."""
        return self.length is not None

    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors of an airframe, which all have its thrust factor and drag factor."""
        distance = self._distance_per_arm * airframe.arm_length if self.length is None else None
        return type(self)._shape(
            length=self.length if distance is None else distance,
            width=self.width if distance is None else distance,
            rotor_1_direction=_DIRECTIONS[self.rotor_1_turns],
            thrust_factor=airframe.thrust_factor,
            drag_factor=airframe.drag_factor,
        )


@LAYOUTS.member
class PlusLayout(_Alternating):
    """Rotors in front (1), on the right (2), at the back (3) and on the left (4)."""

    kind: Literal["plus"]
    _shape: ClassVar = Rotors.plus
    _distance_per_arm: ClassVar = 2.0


@LAYOUTS.member
class XLayout(_Alternating):
    """Rotors on the right in front (1) and at the back (2), on the left at the back (3) and in front (4)."""

    kind: Literal["x"]


@LAYOUTS.member
class HLayout(_Alternating):
    """As an x, where front and back are not as far apart as right and left."""

    kind: Literal["h"]
    length: Positive = Field(description="between the rotors in front and those at the back (m)")
    width: Positive = Field(description="between the rotors on the right and those on the left (m)")
    has_sides: ClassVar = True


class RotorPlace(Model):
    """One rotor."""

    position: Position = Field(
        description="in B, seen from the origin of the layout, where the centre of mass is unless `centre_of_mass` says"
        " otherwise (m)"
    )
    turns: _Turns = Field(description="seen from above")
    thrust_factor: Positive | None = Field(default=None, description="b; that of the airframe if not given (N s²)")
    drag_factor: Positive | None = Field(default=None, description="d; that of the airframe if not given (N m s²)")


@LAYOUTS.member
class RotorsLayout(RotorLayout):
    """Any four rotors, numbered from 1 in their order."""

    kind: Literal["rotors"]
    rotors: Annotated[tuple[RotorPlace, RotorPlace, RotorPlace, RotorPlace], Field(strict=False)] = Field(
        description="rotors 1 to 4"
    )
    is_paired: ClassVar = False
    has_sides: ClassVar = False

    @property
    def has_distances(self) -> bool:
        """True."""
        return True

    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors, with the factors of the airframe where they have none of their own."""
        return Rotors._make(_rotor(place, airframe) for place in self.rotors)


def rotors_of(airframe: Any) -> Rotors:
    """Return the rotors of an airframe of a scenario, or of a `Batch.fleet_scenario`."""
    return airframe.layout.rotors_of(airframe)


def arms_of(airframe: Any) -> tuple[float, float]:
    """Return the distances of the nearest and the farthest rotor from the middle of an airframe, from above, m."""
    arms = [sqrt(float(rotor.x * rotor.x + rotor.y * rotor.y)) for rotor in rotors_of(airframe)]
    return min(arms), max(arms)


def arm_length_of(airframe: Any) -> float:
    """Return the mean of the distances of the nearest and the farthest rotor from the middle of an airframe, m."""
    return 0.5 * sum(arms_of(airframe)) if airframe.layout.has_distances else float(airframe.arm_length)


def _rotor(place: Any, airframe: Any) -> Rotor:
    x, y, z = place.position
    return Rotor(
        x,
        y,
        z,
        _DIRECTIONS[place.turns],
        airframe.thrust_factor if place.thrust_factor is None else place.thrust_factor,
        airframe.drag_factor if place.drag_factor is None else place.drag_factor,
    )
