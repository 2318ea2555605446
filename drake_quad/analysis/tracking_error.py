"""How far from its reference a vehicle hovers in wind and noise, as its linear model predicts.

Between two ticks of the loop in hover, x⁺ = A x + B w with normal numbers w of deviation 1: what the filters of the
turbulence, the cameras and the gyroscope are fed with. The covariance of x is then

    P = A P Aᵀ + B Bᵀ

and position deviates from the reference by what steady wind leaves of it, and by the square root of its part of P.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.analysis.closed_loop import in_hover, loop_with_noise, with_believed_vehicle
from drake_quad.assembly.planning import plan_route
from drake_quad.errors import InputError
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario import Scenario
from drake_quad.scenario.routes import HoverRoute

# Where fans blow, the wind depends on the place; so many places along the route are looked at.
_PLACES = 9


class TrackingError(NamedTuple):
    """The error of the position in hover.

    Attributes:
        offset: (3,) mean along X, Y, Z, m.
        deviation: (3,) standard deviation along X, Y, Z, m.
    """

    offset: np.ndarray
    deviation: np.ndarray

    @property
    def rms(self) -> float:
        """Of the distance from the reference, m."""
        return float(np.sqrt(self.offset @ self.offset + self.deviation @ self.deviation))


def hover_error(scenario: Scenario) -> TrackingError:
    """The error of the vehicle as it is, where a scenario's route hovers or at (0, 0, 1).

    Lost frames and packets, gusts, sines, the battery and rotor failures are left out.

    Raises:
        InputError: the scenario holds a distribution, or its loop is not stable, has no equilibrium or cannot be
            differentiated.
    """
    loop, beside = loop_with_noise(in_hover(scenario))
    system = loop.system
    seen = system.between(system.inputs, ["state.x", "state.y", "state.z"]).connected()
    size = float(np.abs(seen.poles()).max(initial=0.0))
    if size >= 1.0:
        raise InputError(f"the loop of {scenario.name} is not stable in hover: a multiplier is {size:.4f}")
    covariance = scipy.linalg.solve_discrete_lyapunov(seen.A, seen.B @ seen.B.T) if len(seen.A) else seen.A
    variance = np.einsum("ij,jk,ik->i", seen.C, covariance, seen.C)
    return TrackingError(beside[:3], np.sqrt(np.maximum(variance, 0.0)))


def believed_tracking_error(scenario: Scenario) -> TrackingError:
    """The error of the vehicle that the ground believes in, in a scenario's wind: what a plan can allow for.

    Where fans blow, it is the largest of hovers along the route, planned as if there were no obstacles.

    Raises:
        InputError: as `hover_error`, or there is wind that is no part of a linear model.
    """
    for number, source in enumerate(scenario.laboratory.wind):
        if source.kind in ("gust", "sine"):
            raise InputError(
                f"laboratory.wind.{number} is a {source.kind}, which is neither steady nor turbulence: no linear model"
                " predicts an RMS error in it"
            )
    believed = with_believed_vehicle(scenario).model_copy(update={"space": None})
    if not any(source.kind == "fan" for source in scenario.laboratory.wind):
        return hover_error(believed.model_copy(update={"route": HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))}))
    path = plan_route(believed).path
    places = np.transpose(evaluate(path, np.linspace(path.times[0], path.times[-1], _PLACES)))
    routes = [HoverRoute(kind="hover", position=tuple(place.tolist())) for place in places]
    return max(
        (hover_error(believed.model_copy(update={"route": route})) for route in routes), key=lambda each: each.rms
    )
