"""From a scenario's space to the room in which its vehicle flies."""

from drake_quad.errors import InputError
from drake_quad.framework.elementary import sqrt
from drake_quad.scenario import Mission, Scenario
from drake_quad.scenario.layouts import rotors_of
from drake_quad.space.space import Space


def space_of(mission: Mission, *, tracking_error: float = 0.0) -> Space | None:
    """The obstacles of a scenario, and how far the nominal vehicle's centre of mass keeps from them; None without any.

    Args:
        mission: what flies where.
        tracking_error: that is predicted, RMS, m. Only a plan's clearance depends on it.
    """
    if mission.space is None:
        return None
    # The ground believes that the centre of mass is at the origin of the rotors' layout.
    farthest = max(sqrt(float(r.x**2 + r.y**2 + r.z**2)) for r in rotors_of(mission.nominal))
    return mission.space.room(farthest, tracking_error)


def space_to_plan_in(mission: Mission) -> Space | None:
    """The same with the share of the tracking error that is asked for, as the linear model of the loop predicts it.

    Raises:
        InputError: nothing predicts it.
    """
    if mission.space is None or not mission.space.tracking:
        return space_of(mission)
    if not isinstance(mission, Scenario):
        raise InputError("space.tracking asks for a prediction, but without laboratory and control there is none")
    # Linear models are made of what is assembled here.
    from drake_quad.analysis.tracking_error import believed_tracking_error

    try:
        predicted = believed_tracking_error(mission)
    except InputError as error:
        raise InputError(f"space.tracking: {error}") from error
    return space_of(mission, tracking_error=predicted.rms)
