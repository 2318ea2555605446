"""From a scenario's space to the room in which its vehicle flies."""

from drake_quad.errors import InputError
from drake_quad.framework.elementary import sqrt
from drake_quad.scenario import Mission
from drake_quad.scenario.layouts import rotors_of
from drake_quad.space.space import Space


def space_of(mission: Mission, *, tracking_error: float | None = None) -> Space | None:
    """The obstacles of a scenario, and how far the nominal vehicle's centre of mass keeps from them; None without any.

    Args:
        mission: what flies where.
        tracking_error: that is predicted, RMS, m.

    Raises:
        InputError: a share of the tracking error is asked for, and it is not given.
    """
    if mission.space is None:
        return None
    if mission.space.tracking and tracking_error is None:
        raise InputError("space.tracking is given, but no scenario's tracking error is predicted yet; leave it out")
    # The ground believes that the centre of mass is in the middle of the rotors.
    farthest = max(sqrt(float(r.x**2 + r.y**2 + r.z**2)) for r in rotors_of(mission.nominal))
    return mission.space.room(farthest, tracking_error or 0.0)
