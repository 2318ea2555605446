"""Record of the scenario properties on which the control depends."""

from typing import NamedTuple

from drake_quad.reference.plan import Plan
from drake_quad.scenario.autopilots.autopilot import Autopilot
from drake_quad.space.space import Space
from drake_quad.vehicle.parameters import QuadrotorParameters


class ControlSetting(NamedTuple):
    """Scenario properties on which the systems of the control depend.

    Attributes:
        nominal: parameters of the nominal vehicle.
        plan: plan that is flown.
        tick: period of the control, s.
        frame: period of the cameras, s.
        loses_frames: True if the cameras can lose frames.
        autopilot: autopilot on board.
        space: obstacles with the clearances for the nominal vehicle; None if there are no obstacles.
    """

    nominal: QuadrotorParameters
    plan: Plan
    tick: float
    frame: float
    loses_frames: bool
    autopilot: Autopilot
    space: Space | None
