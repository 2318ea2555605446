"""No autopilot."""

from typing import Any, ClassVar, Literal

from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.vehicle.parameters import QuadrotorParameters


@AUTOPILOTS.member
class NoAutopilot(Autopilot):
    """None: attitude is controlled on the ground, and the wrench comes over the link, as in the paper."""

    period: ClassVar = None
    command: ClassVar = "wrench"
    accepts: ClassVar = ("attitude", "rates", "wrench")
    feeds_forward: ClassVar = ("none", "acceleration", "jerk", "snap")
    kind: Literal["none"]

    def answer(self) -> None:
        """Return None."""

    def recipes(self, believed: QuadrotorParameters, *, written: Any, heeds_attitude: bool) -> dict[str, Recipe]:
        """Return no recipe."""
        return {}
