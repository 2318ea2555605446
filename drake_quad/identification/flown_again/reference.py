"""The reference of a log as a route that can be flown: a smooth path through its samples, or held setpoints."""

import math
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path, power_basis
from drake_quad.scenario.limits import SHORTEST
from drake_quad.scenario.routes.setpoints import SetpointsRoute
from drake_quad.scenario.routes.trajectory import Knot, TrajectoryRoute, YawKnot

# Between knots, s: from wide to as narrow as a path of degree 7 that nobody could fly anyway.
_SPACINGS = (0.5, 0.25, 0.125, 0.0625)
# Largest distance from the logged reference: what is cut to mm on three axes is off by up to 1.7 mm.
TOLERANCE = 2e-3
# References are sent at 20 Hz or faster, s; what stays as it is for longer stands still.
_LONGEST_HOLD = 0.05
# Weight of snap beside the position, for what the samples leave open, as in a gap.
_RIDGE = 1e-9
# Share of the rest before the log that is spent on getting to the speed with which it begins.
_RUN_UP = 0.5
# From the place of a vehicle that lifts off to the first setpoint, s: less than the period of any control.
_AT_ONCE = 2.0 * SHORTEST
# Weight of a first knot that is known to be at rest.
_AT_REST = 1e3


class LoggedReference(NamedTuple):
    """The reference of a log as a route.

    Attributes:
        route: smooth path from rest through the logged reference; or the logged setpoints, each held until the next.
        start: time in the route of the log's first sample, s; negative if the route begins later in the log.
        deviation: largest distance of the route from the logged position, m.
        jump: time in the log at which the reference jumps most, s; None for a smooth path.
    """

    route: TrajectoryRoute | SetpointsRoute
    start: float
    deviation: float
    jump: float | None = None

    def __str__(self) -> str:
        if isinstance(self.route, SetpointsRoute):
            number = len(self.route.setpoints)
            return f"{number:,} setpoints, each held until the next, since they jump at {self.jump:.2f} s"
        pieces = len(self.route.knots or ()) - 1
        return f"{pieces} pieces of degree 7, within {1e3 * self.deviation:.2f} mm of the log's"


def logged_reference(
    record: FlightRecord, *, rest: float = 0.0, tolerance: float = TOLERANCE, lift_off: int | None = None
) -> LoggedReference:
    """Return the reference of a log as a path of degree 7 with a continuous jerk, or as setpoints.

    The path is the one of least squares through the logged positions and velocities (if any), between knots as wide
    apart as the tolerance allows. A value that is held for some samples, since it is sent more slowly than it is
    logged, counts in the middle of them. Yaw is the logged one, or the median of the flown one if none is logged.

    Before it the route is at rest, so that integrators find what they have to hold; a log that begins on its way is
    run up to.

    If no smooth path is near enough, as where the reference jumps, and no velocity of the reference is logged, the
    route consists of the logged setpoints. Each is held until the next, as an autopilot holds it. If the vehicle takes
    off in the log, these setpoints begin at the lift-off, with the vehicle at rest where it stands, since a vehicle of
    the laboratory cannot stand on the ground.

    Args:
        record: record of a flight, with the position of the reference.
        rest: duration of the rest before the first sample, s.
        tolerance: largest distance from the logged position, m.
        lift_off: index of the sample at which the vehicle leaves the ground; None if the log begins in the air.

    Raises:
        InputError: no position of the reference is logged, it is on its way at the first sample and there is no time to
            run up to it, or it jumps and its velocity is logged.
    """
    logged = [record.of("reference_position")]
    if record.reference_velocity is not None:
        logged.append(record.reference_velocity)
    # Where a gap follows, nothing else tells.
    at_rest = np.array_equal(logged[0][0], logged[0][1]) and not any(values[0].any() for values in logged[1:])
    time, position, *faster = _sent(record.time, logged)
    samples, end = [position, *faster], float(record.time[-1])
    for spacing in _SPACINGS:
        path = _fitted(time, samples, end=end, spacing=spacing, orders=4, at_rest=at_rest)
        distance = np.linalg.norm(evaluate(path, time).T - position, axis=1)
        if distance.max() <= tolerance:
            break
    else:
        if record.reference_velocity is None:
            return _held(record, rest, lift_off)
        worst = int(np.argmax(distance))
        raise InputError(
            f"no smooth path follows the reference of the log {shown(record.name)} to within {1e3 * tolerance:g} mm:"
            f" at {time[worst]:.3f} s the nearest is {1e3 * distance[worst]:.2g} mm away; does it jump there?"
        )
    knots = _knots(path)
    if rest > 0.0:
        knots = [*_approach(knots[0], rest), *(knot.model_copy(update={"time": knot.time + rest}) for knot in knots)]
    elif np.linalg.norm(knots[0].velocity) > tolerance:
        raise InputError(f"the reference of the log {shown(record.name)} is on its way at once: rest must not be 0")
    route = TrajectoryRoute(kind="trajectory", knots=tuple(knots), yaw_knots=_yaw_knots(record, rest))
    return LoggedReference(route, rest, float(distance.max()))


def _held(record: FlightRecord, rest: float, lift_off: int | None) -> LoggedReference:
    """Return the logged setpoints as a route that begins at the lift-off, if any, or after a rest (s) at the first."""
    position = record.of("reference_position")
    yaw = np.full(len(position), _flown_yaw(record))
    if record.reference_yaw is not None:
        yaw = np.unwrap(record.reference_yaw)
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    rows = np.column_stack([record.time, position, yaw])
    first, start = (0, rest) if lift_off is None else (lift_off, _AT_ONCE - float(record.time[lift_off]))
    rows = rows[first:]
    changed = (np.diff(rows[:, 1:], axis=0) != 0.0).any(axis=1)
    rows = rows[np.append(True, changed & (np.diff(rows[:, 0]) > _AT_ONCE))]
    rows[:, 0] += start
    if lift_off is not None:
        rows = np.vstack([[0.0, *record.of("position")[first], rows[0, 4]], rows])
    rows[0, 0] = 0.0
    last_hold = max(_AT_ONCE, float(record.time[-1]) + start - rows[-1, 0])
    route = SetpointsRoute(kind="setpoints", setpoints=tuple(map(tuple, rows.tolist())), last_hold=last_hold)
    return LoggedReference(route, start, 0.0, float(record.time[int(np.argmax(steps)) + 1]))


def _flown_yaw(record: FlightRecord) -> float:
    """Return the median of the flown yaw, rad; 0 if it is not logged."""
    return 0.0 if record.attitude is None else float(np.median(np.unwrap(record.attitude[:, 2])))


def _sent(time: np.ndarray, logged: list[np.ndarray]) -> list[np.ndarray]:
    """(m,) times and (m, 3) signals in which each value that is held for a short while stands once, in its middle."""
    first = np.flatnonzero(np.append(True, np.any(np.diff(np.hstack(logged), axis=0) != 0.0, axis=1)))
    last = np.append(first[1:], len(time)) - 1
    for_long = np.repeat(time[last] - time[first] > _LONGEST_HOLD, last - first + 1)
    run = np.repeat(np.arange(len(first)), last - first + 1)
    middle = np.where(for_long, time, 0.5 * (time[first] + time[last])[run])
    kept = for_long | np.isin(np.arange(len(time)), first)
    return [middle[kept], *(values[kept] for values in logged)]


def _fitted(
    time: np.ndarray, samples: list[np.ndarray], *, end: float, spacing: float, orders: int, at_rest: bool = False
) -> PolynomialPath:
    """The path from 0 to the end of least squares through the derivatives (n, axes) of order 0, 1, ... at times (n,).

    Args:
        time: s.
        samples: derivatives of each order that is known, in m and s.
        end: s.
        spacing: of the knots, at most, s.
        orders: derivatives that go on through a knot, the position included.
        at_rest: whether it begins at rest.
    """
    count = max(math.ceil(end / spacing), 1)
    knots, h = np.linspace(0.0, end, count + 1), end / count
    segment = np.clip((time / h).astype(int), 0, count - 1)
    s = (time - knots[segment]) / h
    # What derivatives of the knots before and after a sample, times powers of h, do to it.
    unit = np.eye(2 * orders).reshape(2 * orders, 2, orders).transpose(1, 2, 0)
    basis = hermite_path(np.array([0.0, 1.0]), unit).coefficients[0]
    rows = [power_basis(order, s, 2 * orders) @ basis * h**-order for order in range(len(samples))]
    ends = power_basis(orders, np.linspace(0.0, 1.0, orders), 2 * orders) @ basis * np.sqrt(_RIDGE)
    normal, right = np.zeros(((count + 1) * orders,) * 2), np.zeros(((count + 1) * orders, samples[0].shape[1]))
    for k in range(count):
        place, chosen = slice(k * orders, (k + 2) * orders), segment == k
        normal[place, place] += ends.T @ ends
        for row, values in zip(rows, samples, strict=True):
            normal[place, place] += row[chosen].T @ row[chosen]
            right[place] += row[chosen].T @ values[chosen]
    if at_rest:
        moving = np.arange(1, orders)
        normal[moving, moving] += _AT_REST
    derivatives = np.linalg.solve(normal, right).reshape(count + 1, orders, -1)
    return hermite_path(knots, derivatives * h ** -np.arange(orders)[:, np.newaxis])


def _knots(path: PolynomialPath) -> list[Knot]:
    derivatives = [evaluate(path, path.times, order).T.tolist() for order in range(4)]
    return [
        Knot(time=time, position=position, velocity=velocity, acceleration=acceleration, jerk=jerk)
        for time, position, velocity, acceleration, jerk in zip(path.times.tolist(), *derivatives, strict=True)
    ]


def _approach(first: Knot, rest: float) -> list[Knot]:
    """Rest, and then a run-up to the first knot of a path; at rest where that begins so."""
    run_up = _RUN_UP * rest
    back = np.array(first.position) - 0.5 * run_up * np.array(first.velocity)
    place = tuple(back.tolist())
    return [Knot(time=0.0, position=place), Knot(time=rest - run_up, position=place)]


def _yaw_knots(record: FlightRecord, rest: float) -> tuple[YawKnot, ...]:
    """The yaw of the reference over the whole route."""
    end = float(record.time[-1]) + rest
    if record.reference_yaw is None:
        flown = _flown_yaw(record)
        return YawKnot(time=0.0, yaw=flown), YawKnot(time=end, yaw=flown)
    yaw = np.unwrap(record.reference_yaw)[:, np.newaxis]
    path = _fitted(record.time, [yaw], end=float(record.time[-1]), spacing=_SPACINGS[0], orders=2)
    angles, rates = (evaluate(path, path.times, order)[0].tolist() for order in range(2))
    found = [
        YawKnot(time=time + rest, yaw=angle, yaw_rate=rate)
        for time, angle, rate in zip(path.times.tolist(), angles, rates, strict=True)
    ]
    return (YawKnot(time=0.0, yaw=found[0].yaw), *found) if rest > 0.0 else tuple(found)
