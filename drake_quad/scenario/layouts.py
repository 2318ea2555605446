"""Rotor layouts in the scenario language."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.framework.elementary import sqrt
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import Position, Positive
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotor, Rotors

_DIRECTIONS = {"clockwise": CLOCKWISE, "anticlockwise": ANTICLOCKWISE}
_Turns = Literal["clockwise", "anticlockwise"]


class RotorLayout(Model):
    """Positions and directions of rotation of four rotors.

    In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        is_paired: True if opposite rotors of every airframe with this layout form pairs; see `paired_rotor_action`.
        has_side_bars: True if animations show the frame as an H, with a bar on each side; False if they show an arm
            from the middle to every rotor.
    """

    kind: str
    is_paired: ClassVar[bool]
    has_side_bars: ClassVar[bool]

    @property
    @abstractmethod
    def has_distances(self) -> bool:
        """True if the layout itself determines the rotor positions, False if the arm length does."""

    @abstractmethod
    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors of an airframe with this layout."""


LAYOUTS = OpenUnion(RotorLayout)
"""Kinds of layouts."""

Layout = Annotated[RotorLayout, LAYOUTS]


class _Alternating(RotorLayout):
    """Four equal rotors, numbered clockwise from the front; neighbouring rotors turn in opposite directions."""

    rotor_1_turns: _Turns = Field(default="clockwise", description="direction of rotation of rotor 1, seen from above")
    length: Annotated[Positive | None, PLAUSIBLE_SIZE] = Field(
        default=None,
        description="distance between the front and the rear rotors (m); length and width replace arm_length",
    )
    width: Annotated[Positive | None, PLAUSIBLE_SIZE] = Field(
        default=None,
        description="distance between the right and the left rotors (m); length and width replace arm_length",
    )
    is_paired: ClassVar = True
    has_side_bars: ClassVar = False
    _shape: ClassVar[Callable[..., Rotors]] = Rotors.x
    # Default `length` and `width`, as a multiple of the arm length.
    _distance_per_arm: ClassVar = sqrt(2.0)

    @model_validator(mode="after")
    def _both_or_none(self) -> "_Alternating":
        if (self.length is None) != (self.width is None):
            specified, other = ("length", "width") if self.width is None else ("width", "length")
            demand = "must have {other} and {given}, or neither of them"
            raise PydanticCustomError("distances", demand, {"other": other, "given": specified})
        return self

    @property
    def has_distances(self) -> bool:
        """True if the layout has a length and a width, which determine the rotor positions."""
        return self.length is not None

    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors of an airframe, all with the airframe's thrust factor and drag factor."""
        distance = self._distance_per_arm * airframe.arm_length if self.length is None else None
        return type(self)._shape(
            length=self.length if distance is None else distance,
            width=self.width if distance is None else distance,
            rotor_1_direction=_DIRECTIONS[self.rotor_1_turns],
            thrust_factor=airframe.thrust_factor,
            drag_factor=airframe.drag_factor,
        )


@LAYOUTS.register
class PlusLayout(_Alternating):
    """Rotor 1 in front, 2 on the right, 3 at the rear, 4 on the left."""

    kind: Literal["plus"]
    _shape: ClassVar = Rotors.plus
    _distance_per_arm: ClassVar = 2.0


@LAYOUTS.register
class XLayout(_Alternating):
    """Rotor 1 in front on the right, 2 at the rear on the right, 3 at the rear on the left, 4 in front on the left."""

    kind: Literal["x"]


@LAYOUTS.register
class HLayout(_Alternating):
    """Rotors numbered as in the layout `x`, with a length that differs from the width."""

    kind: Literal["h"]
    length: Annotated[Positive, PLAUSIBLE_SIZE] = Field(
        description="distance between the front and the rear rotors (m)"
    )
    width: Annotated[Positive, PLAUSIBLE_SIZE] = Field(description="distance between the right and the left rotors (m)")
    has_side_bars: ClassVar = True


class RotorPlacement(Model):
    """Position, direction of rotation and factors of one rotor."""

    position: Annotated[Position, PLAUSIBLE_SIZE] = Field(
        description="position in B relative to the origin of the layout (m), which is the centre of mass unless"
        " `centre_of_mass` is given"
    )
    turns: _Turns = Field(description="direction of rotation, seen from above")
    thrust_factor: Positive | None = Field(
        default=None, description="thrust factor b of the rotor (N s²); by default, that of the airframe"
    )
    drag_factor: Positive | None = Field(
        default=None, description="drag factor d of the rotor (N m s²); by default, that of the airframe"
    )


@LAYOUTS.register
class RotorsLayout(RotorLayout):
    """Four rotors at any positions, numbered from 1 in the order in which they are listed."""

    kind: Literal["rotors"]
    rotors: Annotated[tuple[RotorPlacement, RotorPlacement, RotorPlacement, RotorPlacement], Field(strict=False)] = (
        Field(description="rotors 1 to 4, in this order")
    )
    is_paired: ClassVar = False
    has_side_bars: ClassVar = False

    @property
    def has_distances(self) -> bool:
        """True, since every rotor has a position."""
        return True

    def rotors_of(self, airframe: Any) -> Rotors:
        """Return the rotors. The factors of the airframe apply to rotors without their own thrust or drag factor."""
        return Rotors._make(_rotor(placement, airframe) for placement in self.rotors)


def rotors_of(airframe: Any) -> Rotors:
    """Return the rotors of an airframe of a scenario, or of all vehicles in `Batch.fleet_scenario`."""
    return airframe.layout.rotors_of(airframe)


def arm_length_range(airframe: Any) -> tuple[float, float]:
    """Return the smallest and the largest horizontal distance between a rotor and the middle of an airframe, m."""
    arms = [sqrt(float(rotor.x * rotor.x + rotor.y * rotor.y)) for rotor in rotors_of(airframe)]
    return min(arms), max(arms)


def arm_length_of(airframe: Any) -> float:
    """Return the arm length of an airframe, m.

    If the layout itself determines the rotor positions, the result is the mean of the shortest and the longest arm.
    """
    return 0.5 * sum(arm_length_range(airframe)) if airframe.layout.has_distances else float(airframe.arm_length)


def _rotor(placement: Any, airframe: Any) -> Rotor:
    x, y, z = placement.position
    return Rotor(
        x,
        y,
        z,
        _DIRECTIONS[placement.turns],
        airframe.thrust_factor if placement.thrust_factor is None else placement.thrust_factor,
        airframe.drag_factor if placement.drag_factor is None else placement.drag_factor,
    )
