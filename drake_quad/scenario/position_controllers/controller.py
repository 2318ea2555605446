"""Position controllers, and the questions about them that the rest of the library asks.

A position controller of your own is a class that extends `PositionController` and is registered with
`POSITION_CONTROLLERS.member`.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from drake_quad.control.position import FeedForward
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.setting import ControlSetting
from drake_quad.scenario.unions import OpenUnion


class PositionController(Model):
    """Law from the position error to a commanded acceleration.

    Numbers that a study draws are (N,) arrays when `recipes` is called for a fleet.

    Attributes:
        feed_forward: derivative of the reference up to which it is fed forward.
        takes_correction: whether a fuzzy network can stand around it, which needs the port `correction`.
        estimates_disturbance: whether it has the port `disturbance`, which a network can look at.
        has_integral: whether it has gains `k_i` of an integral.
        is_user_system: whether it is a system in Python of the user's.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, pydantic would order the fields of members by this annotation
        feed_forward: ClassVar[FeedForward]
    takes_correction: ClassVar[bool]
    estimates_disturbance: ClassVar[bool] = False
    has_integral: ClassVar[bool] = False
    is_user_system: ClassVar[bool] = False

    @abstractmethod
    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes for its systems: `position` if there is one, else `position.NAME` for each."""

    def build(self, systems: Mapping[str, Any], *, takes_correction: bool) -> Any:
        """Return a system with the ports of `build_position_controller`.

        Args:
            systems: systems that its recipes made, by their names.
            takes_correction: whether a network stands around it.
        """
        return systems["position"]

    def plain(self) -> Any:
        """Return the PD or PID that stands in its place when gains are designed.

        Raises:
            InputError: if it has no gains that can be designed.
        """
        raise InputError(f"control.position is of kind {self.kind}, whose gains cannot be designed")


POSITION_CONTROLLERS = OpenUnion(PositionController, "feed_forward")
"""Kinds of position controllers."""

AnyPositionController = Annotated[PositionController, POSITION_CONTROLLERS]
