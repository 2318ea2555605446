"""PD position controller, in the scenario language."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.position import (
    Derivative,
    FeedForward,
    PdGains,
    ProportionalDerivative,
    build_position_controller,
)
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS, PositionController
from drake_quad.scenario.quantities import Gains
from drake_quad.scenario.setting import ControlSetting


@POSITION_CONTROLLERS.register
class PdPosition(PositionController):
    """PD controller of the position error, eq (8) of the paper."""

    kind: Literal["pd"]
    k_p: Gains = Field(description="proportional gain k_P on X, Y, Z (1/s²)")
    k_d: Gains = Field(description="derivative gain k_D on X, Y, Z (1/s)")
    derivative: Derivative = Field(
        default="tracking_error", description="quantity that k_D multiplies: the velocity error v_r - v, or -v"
    )
    feed_forward: FeedForward = Field(  # type: ignore[misc]
        default="none", description="highest derivative of the reference that is fed forward"
    )
    takes_correction: ClassVar = True

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipe to build the PD controller. Subclasses add further recipes."""
        structure = {"derivative": self.derivative, "feeds_forward": self.feed_forward != "none"}
        gains = PdGains(PerAxis(*self.k_p), PerAxis(*self.k_d))
        return {"position.pd": Recipe(ProportionalDerivative, structure, gains)}

    def build(self, systems: Mapping[str, Any], *, takes_correction: bool) -> Any:
        """Return the diagram that sums the outputs of the PD controller, the integral and the disturbance estimator."""
        return build_position_controller(
            systems["position.pd"],
            integral=systems.get("position.integral"),
            disturbance=systems.get("position.estimator"),
            takes_correction=takes_correction,
        )

    def without_estimator(self) -> "PdPosition":
        """Return the controller itself."""
        return self
