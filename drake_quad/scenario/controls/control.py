"""Controls, and the questions about them that the rest of the library asks.

A control of your own is a class that extends `Control` and is registered with `CONTROLS.member`.
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
    """All that is computed on the ground. Numbers that a study draws are (N,) arrays in `recipes` for a fleet.

    Attributes:
        network: fuzzy network around the controller; None without one.
        places: systems that a user can put into its diagram, each with how the paths of the systems begin whose place
            it takes.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, pydantic would order the fields of members by this annotation
        network: ClassVar[Network | None]
    places: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({})

    @abstractmethod
    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes for its systems, by their paths in the diagram."""

    @abstractmethod
    def build(self, systems: Mapping[str, Any], own: Mapping[str, Any]) -> Diagram:
        """Return the diagram `control`, from `measurement` and `reference` to the command over the link.

        Args:
            systems: systems that the recipes made, by their paths.
            own: systems of the user's, by the names of their `places`.
        """

    @abstractmethod
    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust."""

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if it does not fit the other parts of its `Scenario`."""

    def loop_period(self, tick: float) -> float:
        """Return the period after which its loops do the same again, s, given the period of the control."""
        return tick

    def commands_rates_alone(self) -> bool:
        """Return whether targets for an autopilot have body rates without an attitude."""
        return False

    def cascade(self) -> Any:
        """Return the control if it is a cascade, else None."""
        return None

    def parts(self) -> list[str]:
        """Return the kinds of its parts, in words."""
        return [self.kind]

    def ahead(self) -> tuple[float, ...]:
        """Return the times from now at which it looks at the reference, s."""
        return ()

    def contains_user_system(self) -> bool:
        """Return whether it contains a system in Python of the user's."""
        return False

    def policy_rows(self) -> dict[str, int]:
        """Return the number of rows of the observation and the action of its policy; empty if it has no policy."""
        return {}

    def lacks_policy(self) -> bool:
        """Return whether it can only fly with a policy of the user's."""
        return False

    def policy_fields(self) -> dict[str, Any]:
        """Return the fields that it shares with a control of kind `policy` that takes its place."""
        return {}


CONTROLS = OpenUnion(Control, "network", silent="cascade")
"""Kinds of controls."""

AnyControl = Annotated[Control, CONTROLS]
