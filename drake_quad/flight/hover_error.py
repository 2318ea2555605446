"""Prediction of the position error in hover, by simulation with wind and noise.

Flights in hover are simulated in the laboratory of the scenario, including lost frames and packets. A linear model
(`drake_quad.linear.hover_covariance`) omits these losses, and the nonlinear effects of products of noise signals.
Losses and nonlinear effects together cause most of the error in weak wind. Flights are simulated until the confidence
interval of the RMS error is narrow enough. This takes about a second for most controllers.
"""

import math
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.route import plan_route_in_space
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.hovering import in_hover, with_nominal_vehicle
from drake_quad.scenario.models import MetricWindow, Scenario
from drake_quad.scenario.paths import with_values
from drake_quad.scenario.routes.hover import HoverRoute
from drake_quad.statistics.estimates import mean_interval, without_negative_part
from drake_quad.statistics.interval import Interval

SETTLING_TIME = 20.0
"""Time from the start of a flight in hover after which errors count, s.

It is several time constants of the slowest integrator of the shipped controllers.
"""

HOVER_TIME = 40.0
"""Duration of a flight in hover, s."""

_FLEET_SIZE = 64  # number of flights that are simulated at once
_MAX_NUM_FLIGHTS = 1024  # no more flights are simulated, even if the intervals are still too wide
# Flights are simulated until the half-width of each 95 % interval is below one of two limits: a limit relative to the
# RMS error, and an absolute limit for axes whose only errors are rounding errors.
_RELATIVE_PRECISION = 0.05
_ABSOLUTE_PRECISION = 1e-7  # m
# The seed is fixed, so that a plan does not depend on the seed of a study.
_SEED = 20_261_107
# Number of points along the route at which flights in hover are simulated if the wind depends on the position.
_NUM_ROUTE_POINTS = 9


class HoverError(NamedTuple):
    """RMS position error in hover, m, with 95 % confidence intervals.

    Attributes:
        x: RMS error along X.
        y: RMS error along Y.
        z: RMS error along Z.
        rms: RMS distance from the reference.
        num_hovers: number of simulated flights.
    """

    x: Interval
    y: Interval
    z: Interval
    rms: Interval
    num_hovers: int


def hover_error(scenario: Scenario, *, seed: int = _SEED) -> HoverError:
    """Simulate the true vehicle in hover and return its RMS error between `SETTLING_TIME` and `HOVER_TIME`.

    The vehicle hovers at the position of the scenario's route if the route is of kind `hover`, else at (0, 0, 1). Winds
    that depend on time, the battery and rotor failures are omitted. The error of an adaptive controller may still
    change after `HOVER_TIME`.

    Args:
        scenario: scenario without distributions.
        seed: seed of wind and noise.

    Raises:
        InputError: if the scenario contains a distribution, or a flight crashes.
    """
    hovering = _hover_scenario(scenario, seed)
    fleet = StudyFleet(hovering, plan_route_in_space(hovering, None).plan, _FLEET_SIZE)
    squares = np.empty((4, 0))
    while True:
        num_flown = squares.shape[1]
        metrics = fleet.fly(range(num_flown, num_flown + _FLEET_SIZE))
        _check_no_crash(scenario, metrics)
        errors = metrics.rmse_x, metrics.rmse_y, metrics.rmse_z, metrics.rmse
        squares = np.concatenate([squares, np.square(errors)], axis=1)
        intervals = [_rms_interval(each) for each in squares]
        if all(map(_is_precise, intervals)) or squares.shape[1] >= _MAX_NUM_FLIGHTS:
            x, y, z, rms = intervals
            return HoverError(x, y, z, rms, squares.shape[1])


def nominal_tracking_error(scenario: Scenario) -> HoverError:
    """Return the `hover_error` of the nominal vehicle in the wind of a scenario.

    A planner can use this error, since it does not depend on the unknown true vehicle. If a wind depends on the
    position, the vehicle hovers at several points along the route, and the largest error is returned. These points are
    on a route that is planned without obstacles.

    Raises:
        InputError: if `hover_error` raises it, or if a wind depends on time.
    """
    for number, source in enumerate(scenario.laboratory.wind):
        if source.depends_on_time:
            raise InputError(
                f"laboratory.wind.{number} is a {source.kind}, which depends on time; the tracking error can be"
                " predicted only for steady wind and turbulence"
            )
    nominal = with_nominal_vehicle(scenario).model_copy(update={"space": None})
    points = [np.array(HoverRoute(kind="hover").position)]
    if any(source.depends_on_position for source in scenario.laboratory.wind):
        path = plan_route_in_space(nominal, None).plan.path
        points = list(np.transpose(evaluate(path, np.linspace(path.times[0], path.times[-1], _NUM_ROUTE_POINTS))))
    routes = [HoverRoute(kind="hover", position=tuple(point.tolist())) for point in points]
    errors = (hover_error(nominal.model_copy(update={"route": route})) for route in routes)
    return max(errors, key=lambda error: error.rms.value)


def _hover_scenario(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with a route of kind `hover` and with metrics that begin at `SETTLING_TIME`."""
    hovering = in_hover(scenario)
    # The simulation of a fleet needs a time step. The shortest period of the scenario is compatible with all other
    # periods, and is short enough for an accurate Runge-Kutta step.
    time_step = hovering.vehicle.time_step or min(hovering.periods.values())
    timing = {"route.duration": HOVER_TIME, "vehicle.time_step": time_step, "seed": seed}
    return with_values(hovering, {**timing, "metrics": MetricWindow(start=SETTLING_TIME)})


def _check_no_crash(scenario: Scenario, metrics: Metrics) -> None:
    crashed = metrics.crashed
    if crashed.any():
        raise InputError(
            f"cannot predict the RMS error in hover: {crashed.sum()} of {len(crashed)} flights of {scenario.name}"
            f" crash, the first after {metrics.crash_time.min():.1f} s"
        )


def _rms_interval(squares: np.ndarray) -> Interval:
    """Return the RMS error and its confidence interval, given the mean squared errors (n,) of independent flights."""
    return Interval(*(math.sqrt(end) for end in without_negative_part(mean_interval(squares))))


def _is_precise(error: Interval) -> bool:
    """Return whether the confidence interval of an error is narrow enough."""
    half_width = 0.5 * (error.high - error.low)
    return half_width <= max(_RELATIVE_PRECISION * error.value, _ABSOLUTE_PRECISION)
