"""Where the rotors are, in the scenario language."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.framework.elementary import sqrt
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Position, Positive
from drake_quad.signals import Row
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotor, Rotors

_DIRECTIONS = {"clockwise": CLOCKWISE, "anticlockwise": ANTICLOCKWISE}
_Turns = Literal["clockwise", "anticlockwise"]


class _Alternating(Model):
    """Four rotors that are alike, numbered clockwise from the front; neighbours turn against each other."""

    rotor_1_turns: _Turns = Field(default="clockwise", description="seen from above")


class _Measured(_Alternating):
    length: Positive | None = Field(
        default=None, description="between the rotors in front and those at the back, in place of arm_length (m)"
    )
    width: Positive | None = Field(
        default=None, description="between the rotors on the right and those on the left, with length (m)"
    )

    @model_validator(mode="after")
    def _both_or_none(self) -> "_Measured":
        if (self.length is None) != (self.width is None):
            given, other = ("length", "width") if self.width is None else ("width", "length")
            raise PydanticCustomError("distances", "must have {other} beside {given}", {"other": other, "given": given})
        return self


class PlusLayout(_Measured):
    """Rotors in front (1), on the right (2), at the back (3) and on the left (4)."""

    kind: Literal["plus"]


class XLayout(_Measured):
    """Rotors on the right in front (1) and at the back (2), on the left at the back (3) and in front (4)."""

    kind: Literal["x"]


class HLayout(_Alternating):
    """As an x, where front and back are not as far apart as right and left."""

    kind: Literal["h"]
    length: Positive = Field(description="between the rotors in front and those at the back (m)")
    width: Positive = Field(description="between the rotors on the right and those on the left (m)")


class RotorPlace(Model):
    """One rotor."""

    position: Position = Field(
        description="in B, seen from the origin of the layout, where the centre of mass is unless `centre_of_mass` says"
        " otherwise (m)"
    )
    turns: _Turns = Field(description="seen from above")
    thrust_factor: Positive | None = Field(default=None, description="b; that of the airframe if not given (N s²)")
    drag_factor: Positive | None = Field(default=None, description="d; that of the airframe if not given (N m s²)")


class RotorsLayout(Model):
    """Any four rotors, numbered from 1 in their order."""

    kind: Literal["rotors"]
    rotors: Annotated[tuple[RotorPlace, RotorPlace, RotorPlace, RotorPlace], Field(strict=False)] = Field(
        description="rotors 1 to 4"
    )


Layout = Annotated[PlusLayout | XLayout | HLayout | RotorsLayout, Field(discriminator="kind")]


def rotors_of(airframe: Any) -> Rotors:
    """The rotors of an airframe of a scenario, or of a `Batch.fleet_scenario`."""
    layout = airframe.layout
    if layout.kind == "rotors":
        return Rotors._make(_rotor(place, airframe) for place in layout.rotors)
    length, width = _distances(airframe)
    shape = Rotors.plus if layout.kind == "plus" else Rotors.x
    return shape(
        length=length,
        width=width,
        rotor_1_direction=_DIRECTIONS[layout.rotor_1_turns],
        thrust_factor=airframe.thrust_factor,
        drag_factor=airframe.drag_factor,
    )


def are_paired(layout: Layout) -> bool:
    """True if all airframes of a layout have their rotors in pairs, see `paired_rotor_action`."""
    return layout.kind != "rotors"


def has_distances(layout: Layout) -> bool:
    """True if a layout says where its rotors are; else the arm length does."""
    return isinstance(layout, RotorsLayout) or layout.length is not None


def implied_arms(layout: Any) -> tuple[float, float]:
    """How far the nearest and the farthest rotor are from the middle, seen from above (m), in a layout of numbers."""
    if layout.kind == "rotors":
        arms = [sqrt(x * x + y * y) for x, y, _ in (place.position for place in layout.rotors)]
    elif layout.kind == "plus":
        arms = [0.5 * layout.length, 0.5 * layout.width]
    else:
        arms = [0.5 * sqrt(layout.length**2 + layout.width**2)]
    return min(arms), max(arms)


def arm_length_of(airframe: Any) -> float:
    """Return the mean of the distances of the nearest and the farthest rotor from the middle of an airframe, m."""
    return 0.5 * sum(implied_arms(airframe.layout)) if has_distances(airframe.layout) else float(airframe.arm_length)


def _distances(airframe: Any) -> tuple[Row, Row]:
    """From front to back and from right to left, m."""
    layout = airframe.layout
    if layout.length is not None:
        return layout.length, layout.width
    distance = (2.0 if layout.kind == "plus" else sqrt(2.0)) * airframe.arm_length
    return distance, distance


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
