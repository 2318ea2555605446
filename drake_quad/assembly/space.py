"""From a scenario's space to the room in which its vehicle flies."""

from drake_quad.framework.elementary import sqrt
from drake_quad.scenario import Mission
from drake_quad.scenario.layouts import rotors_of
from drake_quad.space.space import Space


def space_of(mission: Mission, *, tracking_error: float = 0.0) -> Space | None:
    """The obstacles of a scenario, and how far the nominal vehicle's centre of mass keeps from them; None without any.

    Args:
        mission: what flies where.
        tracking_error: that is predicted, RMS, m.
    """
    if mission.space is None:
        return None
    # The ground believes that the centre of mass is in the middle of the rotors.
    farthest = max(sqrt(float(r.x**2 + r.y**2 + r.z**2)) for r in rotors_of(mission.nominal))
    return mission.space.room(farthest, tracking_error)
