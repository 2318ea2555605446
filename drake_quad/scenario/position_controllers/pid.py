"""PID position controller, in the scenario language."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.inactive import needs
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.position_controllers.pd import PdPosition
from drake_quad.scenario.quantities import Gains, IntegrationRule, Positive
from drake_quad.scenario.setting import ControlSetting


@POSITION_CONTROLLERS.register
class PidPosition(PdPosition):
    """PD controller with an integral term, which is limited to prevent windup."""

    kind: Literal["pid"]  # type: ignore[assignment]
    k_i: Gains = Field(description="integral gain k_I on X, Y, Z (1/s³)")
    integral_limit: Annotated[Positive, needs("k_i")] = Field(
        default=2.0, description="largest acceleration that the integral commands on an axis (m/s²)"
    )
    integration: Annotated[IntegrationRule, needs("k_i")] = "forward_euler"
    has_integral: ClassVar = True

    @classmethod
    def from_pd(cls, pd: PdPosition) -> "PidPosition":
        """Convert a PD to a PID controller with zero integral gains. A PID controller is returned unchanged."""
        if isinstance(pd, PidPosition):
            return pd
        kept = {name: getattr(pd, name) for name in PdPosition.model_fields if name != "kind"}
        return cls(kind="pid", **kept, k_i=(0.0, 0.0, 0.0))

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build the PD controller and the integral."""
        structure = {"period": setting.tick, "integration": self.integration}
        gains = IntegralGains(PerAxis(*self.k_i), self.integral_limit)
        return {**super().recipes(setting), "position.integral": Recipe(IntegralCorrection, structure, gains)}
