"""Base class of controls (the controllers on the ground), and their registry `CONTROLS`.

To add a control, extend `Control` and register the class with `CONTROLS.register`.
"""

from abc import abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydrake.systems.framework import Diagram

from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.controls.thrust_vectoring import ThrustVectoringSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.setting import ControlSetting
from drake_quad.scenario.unions import OpenUnion


class Control(Model):
    """Controller on the ground. In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        network: fuzzy network that corrects the command of the controller; None without a network.
        user_system_paths: path prefixes of the systems that a user's system replaces, by the name of the user's system.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, this annotation would change the order of the fields of subclasses
        network: ClassVar[Network | None]
    user_system_paths: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({})

    @abstractmethod
    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build all systems of the control, by their paths in the diagram."""

    @abstractmethod
    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Build the diagram `control`, which computes the command for the vehicle from `measurement` and `reference`.

        Args:
            systems: systems built from the recipes, by their paths.
            user_systems: user's systems, by the names in `user_system_paths`.
        """

    @abstractmethod
    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust that the control obeys."""

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the control does not fit the other parts of its `Scenario`."""

    def loop_period(self, tick: float) -> float:
        """Return the longest period of a loop of the control, s, given the tick period (s)."""
        return tick

    def commands_rates_only(self) -> bool:
        """Return whether the control commands body rates without an attitude to an autopilot."""
        return False

    def cascade(self) -> Any:
        """Return the control if it is a cascade; None otherwise."""
        return None

    def parts(self) -> list[str]:
        """Return a short description of each part of the control, such as its kind."""
        return [self.kind]

    def preview_times(self) -> tuple[float, ...]:
        """Return the preview times of the control: it reads the reference at these times after the present, s."""
        return ()

    def sensor_signals(self) -> tuple[str, ...]:
        """Return the names of the sensor signals that the control reads, such as `accelerometer`."""
        return ()

    def contains_user_system(self) -> bool:
        """Return whether the control contains a user's Python system."""
        return False

    def policy_rows(self) -> dict[str, int]:
        """Return the size of a policy's `observation` and `action`; empty for a control without a policy."""
        return {}

    def lacks_policy(self) -> bool:
        """Return whether the control can only fly with a user's policy."""
        return False

    def policy_fields(self) -> dict[str, Any]:
        """Return the fields that a control of kind `policy` inherits when it replaces this control."""
        return {}


CONTROLS = OpenUnion(Control, "network", default_kind="cascade")
"""Registry of the kinds of controls."""

AnyControl = Annotated[Control, CONTROLS]
