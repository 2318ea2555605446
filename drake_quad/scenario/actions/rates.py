"""Thrust and body rates as a policy action."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field
from pydantic_core import PydanticCustomError

from drake_quad.control.policy.actions import RatesScale
from drake_quad.control.policy.actuation import OffboardRateActuation, OnboardRateActuation
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.scenario.actions.action import ACTIONS, ThrustAction
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings
from drake_quad.scenario.autopilots.autopilot import Autopilot
from drake_quad.scenario.plausible import PLAUSIBLE_MAX_RATES
from drake_quad.scenario.quantities import FixedPositives, Gains
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import BodyRates


@ACTIONS.register
class RatesAction(ThrustAction):
    """Action with thrust and body rates."""

    kind: Literal["rates"]
    max_rates: Annotated[FixedPositives, PLAUSIBLE_MAX_RATES] = Field(
        default=(6.0, 6.0, 3.0), description="p, q, r that an action of 1 commands (rad/s)"
    )
    k_rate: Gains | None = Field(
        default=None,
        description="gain from the body rate error to an angular acceleration if there is no autopilot (1/s); by"
        " default, k_d of the attitude controller",
    )
    commands: ClassVar = "rates"

    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build a rate loop on the ground, or a system that commands the rate loop on board."""
        on_board = setting.autopilot.controls_attitude
        gains: Any = (0.0, 0.0, 0.0) if on_board else self.k_rate
        if gains is None and attitude is not None:
            gains = attitude.k_d
        rates = BodyRates(*self.max_rates)
        scale = RatesScale(self.thrusts(setting.nominal), rates, PerAngle(*gains), *setting.nominal.inertia)
        return Recipe(OnboardRateActuation if on_board else OffboardRateActuation, {}, scale)

    def needs_attitude(self, autopilot: Autopilot) -> bool:
        """Return whether the rate loop takes its gains from an attitude controller on the ground."""
        return self.k_rate is None and not autopilot.controls_attitude

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if rate loop gains are missing, or given for a rate loop on board."""
        super().check_fits(scenario)
        autopilot = scenario.laboratory.autopilot
        if scenario.control.attitude is None and self.needs_attitude(autopilot):
            raise PydanticCustomError("missing", "is missing", {"path": ("control", "action", "k_rate")})
        if self.k_rate is not None and autopilot.controls_attitude:
            demand = f"must be left out, or null, since laboratory.autopilot of kind {autopilot.kind} has its own gains"
            raise scenario.field_error(demand, "control", "action", "k_rate")
