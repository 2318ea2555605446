"""From a scenario's space to the room in which its vehicle flies."""

from drake_quad.errors import InputError
from drake_quad.framework.elementary import sqrt
from drake_quad.scenario import Mission, Scenario
from drake_quad.scenario.layouts import rotors_of
from drake_quad.space.space import Space


def space_of(mission: Mission, *, tracking_error: float = 0.0) -> Space | None:
    """Return the obstacles of a scenario with the clearances of the nominal vehicle; None if there are no obstacles.

    Args:
        mission: scenario or mission with the obstacles and the nominal vehicle.
        tracking_error: predicted RMS position error, m. It only affects the clearance of a plan.
    """
    if mission.space is None:
        return None
    # The nominal centre of mass is at the origin of the rotors' layout.
    farthest = max(sqrt(float(r.x**2 + r.y**2 + r.z**2)) for r in rotors_of(mission.nominal))
    return mission.space.room(farthest, tracking_error)


def space_to_plan_in(mission: Mission) -> Space | None:
    """Return `space_of` with the tracking error that `space.tracking` multiplies; the error is predicted if needed.

    Raises:
        InputError: if the prediction is not possible, see `believed_tracking_error`.
    """
    if mission.space is None or not mission.space.tracking:
        return space_of(mission)
    if not isinstance(mission, Scenario):
        raise InputError("space.tracking asks for a prediction, but without laboratory and control there is none")
    # Imported here because the prediction simulates hovers, and simulations import the assembly.
    from drake_quad.analysis.tracking_error import believed_tracking_error

    try:
        predicted = believed_tracking_error(mission)
    except InputError as error:
        raise InputError(f"space.tracking: {error}") from error
    return space_of(mission, tracking_error=predicted.rms.value)
