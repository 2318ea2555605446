"""Obstacles of a scenario with the clearances of its vehicle."""

from drake_quad.framework.elementary import sqrt
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Mission
from drake_quad.space.space import Space


def space_of(mission: Mission, *, tracking_error: float = 0.0) -> Space | None:
    """Return the obstacles of a scenario with the clearances of the nominal vehicle; None if there are no obstacles.

    Args:
        mission: scenario or mission with the obstacles and the nominal vehicle.
        tracking_error: predicted RMS position error, m, which only affects the clearance of a plan.
    """
    if mission.space is None:
        return None
    # The centre of mass of the nominal vehicle is at the origin of the layout of its rotors.
    farthest = max(sqrt(float(r.x**2 + r.y**2 + r.z**2)) for r in rotors_of(mission.nominal))
    return mission.space.room(farthest, tracking_error)
