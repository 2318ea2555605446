"""Base class of autopilots, and their registry `AUTOPILOTS`.

To add an autopilot, extend `Autopilot` and register the class with `AUTOPILOTS.register`.
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
from drake_quad.vehicle.motors import ThrustCurve
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig

Commanded = Literal["attitude", "rates", "wrench"]
"""Command that a control computes in addition to the thrust, before any attitude controller on the ground."""


class Autopilot(Model):
    """Autopilot on board. In a fleet scenario, randomly drawn values are (N,) arrays.

    Attributes:
        period: period of the loops on board, s; None if there are no loops.
        command: name of the signal that the command link carries.
        accepts: types of commands that the autopilot accepts from a control on the ground.
        feeds_forward: allowed values of the field `feed_forward` of a control, which names the highest derivative of
            the reference that is fed forward.
        noise_free: field values that remove the measurement noise.
        bias_free: field values that remove the measurement bias.
        loop_gains: names of the two fields that contain the attitude and rate loop gains; None if no gains can be
            designed.
        models_vehicle: True if the autopilot describes the joint response of autopilot and vehicle, which was
            identified with one particular vehicle.
        airframe_fields: names of the fields that were identified with one particular vehicle.
        is_firmware: True if the autopilot is firmware in its own process, so that the loop has no linear model.
    """

    kind: str
    if TYPE_CHECKING:  # at runtime, this annotation would change the order of the fields of subclasses
        period: ClassVar[float | None]
    command: ClassVar[Command]
    accepts: ClassVar[tuple[Commanded, ...]]
    feeds_forward: ClassVar[tuple[FeedForward, ...]]
    noise_free: ClassVar[dict[str, Any]] = {}
    bias_free: ClassVar[dict[str, Any]] = {}
    loop_gains: ClassVar[tuple[str, str] | None] = None
    models_vehicle: ClassVar[bool] = False
    airframe_fields: ClassVar[tuple[str, ...]] = ()
    is_firmware: ClassVar[bool] = False

    @property
    def controls_attitude(self) -> bool:
        """True if the attitude is controlled on board instead of on the ground."""
        return self.command == "attitude_target"

    @abstractmethod
    def attitude_response(self) -> SecondOrderResponse | None:
        """Return the second-order response of roll and pitch to a command; None if no attitude is commanded."""

    @abstractmethod
    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipe to build the system `autopilot` between command link and control allocation, if it exists.

        A second system `firmware` replaces the control allocation.

        Args:
            nominal: parameters of the nominal vehicle.
            settings: the same autopilot in the scenario, with its distributions. An imperfection is modelled if a
                distribution or a nonzero number describes it.
            follows_attitude: False if body rates are commanded without an attitude.
            curve: thrust of a nominal rotor as a function of its throttle; None if rotor speeds are commanded.
        """

    def vehicle_recipe(self, structure: dict[str, Any], config: QuadrotorConfig) -> Recipe:
        """Return the recipe to build the vehicle, given the structure and the parameters of a `Quadrotor`."""
        return Recipe(Quadrotor, structure, config)

    def fastest_decay(self) -> AngleRate:
        """Return the fastest decay rate in the autopilot's vehicle model, 1/s; 0 if there is no vehicle model."""
        return 0.0

    def without_noise(self) -> "Autopilot":
        """Return the autopilot without measurement noise."""
        return self.model_copy(update=self.noise_free)

    def without_bias(self) -> "Autopilot":
        """Return the autopilot without measurement bias."""
        return self.model_copy(update=self.bias_free)

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the autopilot does not fit the vehicle or the command link of its `Scenario`."""


AUTOPILOTS = OpenUnion(Autopilot, "period")
"""Registry of the kinds of autopilots."""

AnyAutopilot = Annotated[Autopilot, AUTOPILOTS]
