"""Base class of the position controllers, and their registry `POSITION_CONTROLLERS`.

To add a position controller, extend `PositionController` and register the class with `POSITION_CONTROLLERS.register`.
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
    """Control law from the position error to a commanded acceleration.

    In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        feed_forward: highest derivative of the reference that is fed forward.
        takes_correction: True if a fuzzy network can correct the controller, which needs the port `correction`.
        estimates_disturbance: True if the controller has the port `disturbance`, which can be an input of a network.
        has_integral: True if the controller has integral gains `k_i`.
        is_user_system: True if the controller is a user's Python system.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, this annotation would change the order of the fields of subclasses
        feed_forward: ClassVar[FeedForward]
    takes_correction: ClassVar[bool]
    estimates_disturbance: ClassVar[bool] = False
    has_integral: ClassVar[bool] = False
    is_user_system: ClassVar[bool] = False

    @abstractmethod
    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build all systems of the controller, by path.

        The path of a single system is `position`. The paths of several systems are `position.NAME`.
        """

    def build(self, systems: Mapping[str, Any], *, takes_correction: bool) -> Any:
        """Return a system with the ports that `build_position_controller` describes.

        Args:
            systems: systems built from the recipes, by their paths.
            takes_correction: True if a network corrects the output of the controller through the port `correction`.
        """
        return systems["position"]

    def without_estimator(self) -> Any:
        """Return the same controller without its disturbance estimator: the PD or PID controller that gain design uses.

        Raises:
            InputError: if the controller has no gains that can be designed.
        """
        raise InputError(f"the gains of control.position of kind {self.kind} cannot be designed; choose another kind")


POSITION_CONTROLLERS = OpenUnion(PositionController, "feed_forward")
"""Registry of the kinds of position controllers."""

AnyPositionController = Annotated[PositionController, POSITION_CONTROLLERS]
