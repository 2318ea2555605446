"""Autopilots, and the questions about them that the rest of the library asks.

An autopilot of your own is a class that extends `Autopilot` and is registered with `AUTOPILOTS.member`.
"""

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.control.position import FeedForward
from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.command_link import Command
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import AngleRate
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorNumbers

Commanded = Literal["attitude", "rates", "wrench"]
"""Command of a control in addition to the thrust, before any attitude control on the ground converts it to torques."""


class Autopilot(Model):
    """Autopilot on board. Numbers that a study draws are (N,) arrays when its recipes are made for a fleet.

    Attributes:
        period: period of the loops on board, s; None if there are none.
        command: signal that the link carries.
        accepts: what a control may command.
        feeds_forward: derivatives of the reference up to which a control may feed forward.
        noise_free: values of its fields without random errors.
        bias_free: values of its fields without constant errors.
        loop_gains: fields with the gains of its attitude and rate loops; None if it has none that can be designed.
        models_vehicle: whether it describes the vehicle's response as a whole, and so was identified with one vehicle.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, pydantic would order the fields of members by this annotation
        period: ClassVar[float | None]
    command: ClassVar[Command]
    accepts: ClassVar[tuple[Commanded, ...]]
    feeds_forward: ClassVar[tuple[FeedForward, ...]]
    noise_free: ClassVar[dict[str, Any]] = {}
    bias_free: ClassVar[dict[str, Any]] = {}
    loop_gains: ClassVar[tuple[str, str] | None] = None
    models_vehicle: ClassVar[bool] = False

    @property
    def controls_attitude(self) -> bool:
        """True if attitude is controlled on board instead of on the ground."""
        return self.command == "attitude_target"

    @abstractmethod
    def answer(self) -> SecondOrderResponse | None:
        """Return the lag of second order by which roll and pitch follow commands; None if no attitude is commanded."""

    @abstractmethod
    def recipes(self, believed: QuadrotorParameters, *, written: Any, heeds_attitude: bool) -> dict[str, Recipe]:
        """Return the recipe for the system `autopilot` between link and allocation; none if there is no such system.

        Args:
            believed: parameters of the nominal vehicle.
            written: the autopilot as a scenario has it, whose distributions decide which imperfections there are.
            heeds_attitude: False if body rates are commanded without an attitude.
        """

    def vehicle_recipe(self, structure: dict[str, Any], numbers: QuadrotorNumbers) -> Recipe:
        """Return the recipe for the vehicle, given the structure and the numbers of a `Quadrotor`."""
        return Recipe(Quadrotor, structure, numbers)

    def fastest_decay(self) -> AngleRate:
        """Return the rate of the fastest decay that the vehicle has because of it, 1/s."""
        return 0.0

    def without_noise(self) -> "Autopilot":
        """Return the autopilot without random errors."""
        return self.model_copy(update=self.noise_free)

    def without_bias(self) -> "Autopilot":
        """Return the autopilot without constant errors."""
        return self.model_copy(update=self.bias_free)

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the vehicle or the link of a `Scenario` does not fit the autopilot."""


AUTOPILOTS = OpenUnion(Autopilot, "period")
"""Kinds of autopilots."""

AnyAutopilot = Annotated[Autopilot, AUTOPILOTS]
