"""Vehicle without an autopilot, in the scenario language."""

from typing import Any, ClassVar, Literal

from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.vehicle.motors import ThrustCurve
from drake_quad.vehicle.parameters import QuadrotorParameters


@AUTOPILOTS.register
class NoAutopilot(Autopilot):
    """No autopilot: the attitude is controlled on the ground, and the command link carries a wrench."""

    period: ClassVar = None
    command: ClassVar = "wrench"
    accepts: ClassVar = ("attitude", "rates", "wrench")
    feeds_forward: ClassVar = ("none", "acceleration", "jerk", "snap")
    kind: Literal["none"]

    def attitude_response(self) -> None:
        """Return None, since no attitude is commanded over the radio link."""

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return an empty mapping, since there is no system between the command link and the control allocation."""
        return {}
