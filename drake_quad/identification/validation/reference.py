"""Conversion of a logged reference to a route: a smooth path through its samples, or held setpoints."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.logs.record import FlightRecord
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, hermite_path, power_basis
from drake_quad.scenario.limits import MIN_DURATION
from drake_quad.scenario.routes.setpoints import SetpointsRoute
from drake_quad.scenario.routes.trajectory import Knot, TrajectoryRoute, YawKnot

# Knot spacings, s, in the order in which they are tried. A path with the smallest spacing follows any feasible
# reference.
_KNOT_SPACINGS = (0.5, 0.25, 0.125, 0.0625)
TOLERANCE = 2e-3
"""Largest distance of a route from the logged reference, m. Truncation of positions to mm causes up to 1.7 mm."""
# References are sent at 20 Hz or faster. A reference that repeats a value for longer than this, in s, is at rest,
# unless it is logged more slowly than it is sent.
_MAX_REPETITION_TIME = 0.05
# Largest acceleration of a smooth path through the samples of a slowly logged reference, m/s². Such a path can follow
# even a jump, so a larger acceleration shows that the reference jumps. References for multicopters do not accelerate at
# 5 g.
_MAX_ACCELERATION = 5.0 * 9.81
# Weight of the snap relative to the position. The snap determines the path where there are no samples, for example in a
# gap.
_SNAP_WEIGHT = 1e-9
# The route begins before the log with an initial phase of `rest` seconds: standstill, then acceleration to the first
# velocity of the log. The acceleration takes this fraction of the phase.
_ACCELERATION_FRACTION = 0.5
# Largest distance between reference and vehicle at the lift-off, m, with which the route is a smooth path from the
# reference at this time. If the distance is larger, the reference has jumped to the height of the flight.
_MAX_LIFT_OFF_DISTANCE = 0.25
_REST_WEIGHT = 1e3  # weight of the derivatives at the first knot, if the path starts at rest
_LIFT_OFF_STEP = 2.0 * MIN_DURATION  # s, from lift-off to the first setpoint; shorter than the period of any controller


class LoggedReference(NamedTuple):
    """Reference of a log as a route.

    Attributes:
        route: smooth path from rest through the logged reference; or the logged setpoints, each held until the next.
        start: time on the route, s, at the first sample of the log; negative if the route begins later in the log.
        end: time in the log up to which the reference is known, s.
        deviation: largest distance of the route from the logged position, m.
        velocity_deviation: largest difference between path velocity and logged velocity, m/s; None if the path is
            fitted to the logged velocities, or none are logged.
        jump: time in the log at which the reference jumps most, s; None for a smooth path.
    """

    route: TrajectoryRoute | SetpointsRoute
    start: float
    end: float
    deviation: float
    velocity_deviation: float | None = None
    jump: float | None = None

    def __str__(self) -> str:
        if isinstance(self.route, SetpointsRoute):
            number = len(self.route.setpoints)
            return f"{number:,} setpoints, each held until the next, since they jump at {self.jump:.2f} s"
        pieces = len(self.route.knots or ()) - 1
        text = f"{pieces} pieces of degree 7, within {1e3 * self.deviation:.2f} mm of the logged positions"
        if self.velocity_deviation is None:
            return text
        return (
            f"{text}; the logged velocities are not used, since they differ from the derivatives of the logged"
            f" positions by up to {self.velocity_deviation:.2g} m/s"
        )


def logged_reference(record: FlightRecord, *, rest: float = 0.0, lift_off: int | None = None) -> LoggedReference:
    """Return the reference of a log as a path of degree 7 with a continuous jerk, or as setpoints.

    The path is the least-squares fit to the logged positions, and to the velocities if they are logged. Its knots are
    as far apart as the tolerance allows. If no such path is within the tolerance, the velocities are not used: PX4, for
    example, logs velocities that are not the derivatives of its positions while the vehicle lags behind. Yaw is the
    logged yaw of the reference, or the median yaw of the vehicle if no reference yaw is logged.

    If the reference is logged faster than it is sent, values are repeated; each value is then used once, at the middle
    of its samples. If the reference is logged more slowly than at 20 Hz, each logged value is used once, at the time at
    which it was logged. The velocities are then not used, since a path through so few samples would oscillate to follow
    velocities that contradict the positions.

    The route is at rest before the log, so that the integrators of the controller settle. If the log starts in motion,
    the route accelerates to the first velocity. If the vehicle takes off in the log, the route starts at the lift-off
    instead, since the simulation has no ground on which a vehicle could stand.

    If no reference velocity is logged, the route consists of the logged setpoints in two cases: if no smooth path is
    within the tolerance, for example because the reference jumps, and if the reference is more than 0.25 m away from
    the vehicle at the lift-off. Each setpoint is held until the next one, as in an autopilot. If the vehicle takes off
    in the log, the route then begins with the vehicle at rest where it lifts off.

    Args:
        record: record of a flight, with the position of the reference.
        rest: duration of the rest before the first sample, s.
        lift_off: index of the sample at which the vehicle leaves the ground; None if the log begins in the air.

    Raises:
        InputError: if no reference position is logged, if the reference moves at the first sample and `rest` is 0, or
            if the reference jumps and its velocity is logged.
    """
    if record.reference_velocity is None and lift_off is not None:
        distance = record.of("reference_position")[lift_off] - record.of("position")[lift_off]
        if np.linalg.norm(distance) > _MAX_LIFT_OFF_DISTANCE:
            return _setpoint_reference(record, rest, lift_off)
    begin = 0.0 if lift_off is None else float(record.time[lift_off])
    flight = record.subset(slice(lift_off, None))
    flight = _as_logged(replace(flight, time=flight.time - begin))
    try:
        path, deviation, velocity_deviation = _smooth_path(flight, begin)
    except InputError:
        if record.reference_velocity is None:
            return _setpoint_reference(record, rest, lift_off)
        raise
    knots = _knots(path)
    if rest > 0.0:
        knots = [*_approach(knots[0], rest), *(knot.model_copy(update={"time": knot.time + rest}) for knot in knots)]
    elif np.linalg.norm(knots[0].velocity) > TOLERANCE:
        raise InputError(
            f"the reference of the log {short_repr(record.name)} already moves at its first sample; rest must be"
            " larger than 0"
        )
    route = TrajectoryRoute(kind="trajectory", knots=tuple(knots), yaw_knots=_yaw_knots(flight, rest))
    return LoggedReference(route, rest - begin, begin + float(flight.time[-1]), deviation, velocity_deviation)


def _smooth_path(record: FlightRecord, begin: float) -> tuple[PolynomialPath, float, float | None]:
    """Return the path through a reference, with `deviation` and `velocity_deviation` of `LoggedReference`.

    Args:
        record: record whose time begins at 0.
        begin: time in the log at which the record begins, s.

    Raises:
        InputError: if no path is within the tolerance, or if the path through the samples of a slowly logged reference
            has too large accelerations.
    """
    logged = [record.of("reference_position")]
    if record.reference_velocity is not None:
        logged.append(record.reference_velocity)
    # The reference is at rest at the start if its first two positions are equal and its first velocity is zero. Later
    # samples are not used, since a gap may follow the second sample.
    at_rest = np.array_equal(logged[0][0], logged[0][1]) and not any(values[0].any() for values in logged[1:])
    time, *samples = _without_repetitions(record.time, logged)
    end, slow = float(record.time[-1]), is_slow(record)
    for fitted in (samples[:1],) if slow else (samples, samples[:1])[: len(samples)]:
        path, distance = _closest_path(time, fitted, end=end, at_rest=at_rest)
        if distance.max() <= TOLERANCE:
            break
    else:
        worst = int(np.argmax(distance))
        raise InputError(
            f"no smooth path fits the reference of the log {short_repr(record.name)} to within {1e3 * TOLERANCE:g} mm:"
            f" the best fit is off by {1e3 * distance[worst]:.1f} mm at {begin + time[worst]:.3f} s; a possible cause"
            " is a jump of the reference"
        )
    times = np.linspace(path.times[0], path.times[-1], 8 * len(path.times))
    max_acceleration = float(np.linalg.norm(evaluate(path, times, 2), axis=0).max())
    if slow and max_acceleration > _MAX_ACCELERATION:
        raise InputError(
            f"the reference of the log {short_repr(record.name)} cannot be flown: between samples that are"
            f" {record.reference_period:.2g} s apart, it accelerates with {max_acceleration:.0f} m/s²; a possible cause"
            " is a jump of the reference"
        )
    if len(fitted) == len(samples):
        return path, float(distance.max()), None
    difference = np.linalg.norm(evaluate(path, time, 1).T - samples[1], axis=1)
    return path, float(distance.max()), float(difference.max())


def _closest_path(
    time: np.ndarray, samples: list[np.ndarray], *, end: float, at_rest: bool
) -> tuple[PolynomialPath, np.ndarray]:
    """Return the path with the largest knot spacing within the tolerance, and its distances (n,) to the positions.

    If no path is within the tolerance, the path with the smallest spacing is returned.
    """
    for spacing in _KNOT_SPACINGS:
        path = _fitted_path(time, samples, end=end, spacing=spacing, orders=4, at_rest=at_rest)
        distance = np.linalg.norm(evaluate(path, time).T - samples[0], axis=1)
        if distance.max() <= TOLERANCE:
            break
    return path, distance


def is_slow(record: FlightRecord) -> bool:
    """Return whether the reference is logged more slowly than a controller receives it."""
    return record.reference_period > _MAX_REPETITION_TIME


def _as_logged(record: FlightRecord) -> FlightRecord:
    """If the reference is logged slowly, keep only the samples of the record at which the reference was logged.

    The reference is logged once in each of its periods, and the record repeats the value until the next period. A value
    that lasts for several periods was logged once in each of them. Records with a fast reference are returned
    unchanged.
    """
    if not is_slow(record):
        return record
    signals = [record.of("reference_position"), record.reference_velocity]
    values = np.hstack([signal for signal in signals if signal is not None])
    first = np.flatnonzero(np.append(True, np.any(np.diff(values, axis=0) != 0.0, axis=1)))
    ends = np.append(record.time[first[1:]], record.time[-1] + record.period)
    run = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(record.time))))
    begin, duration = record.time[first], ends - record.time[first]
    periods = np.maximum(np.rint(duration / record.reference_period), 1.0)
    number = np.floor((record.time - begin[run]) / duration[run] * periods[run] + 1e-6)
    return record.subset(np.append(True, (np.diff(run) > 0) | (np.diff(number) > 0.0)))


def _setpoint_reference(record: FlightRecord, rest: float, lift_off: int | None) -> LoggedReference:
    """Return the logged setpoints as a route, which begins at the lift-off or with a rest at the first setpoint."""
    position = record.of("reference_position")
    yaw = np.full(len(position), _median_yaw(record))
    if record.reference_yaw is not None:
        yaw = np.unwrap(record.reference_yaw)
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    rows = np.column_stack([record.time, position, yaw])
    first, start = (0, rest) if lift_off is None else (lift_off, _LIFT_OFF_STEP - float(record.time[lift_off]))
    rows = rows[first:]
    changed = (np.diff(rows[:, 1:], axis=0) != 0.0).any(axis=1)
    rows = rows[np.append(True, changed & (np.diff(rows[:, 0]) > _LIFT_OFF_STEP))]
    rows[:, 0] += start
    if lift_off is not None:
        rows = np.vstack([[0.0, *record.of("position")[first], rows[0, 4]], rows])
    rows[0, 0] = 0.0
    last_hold = max(_LIFT_OFF_STEP, float(record.time[-1]) + start - rows[-1, 0])
    route = SetpointsRoute(kind="setpoints", setpoints=tuple(map(tuple, rows.tolist())), last_hold=last_hold)
    jump = float(record.time[int(np.argmax(steps)) + 1])
    return LoggedReference(route, start, float(record.time[-1]), 0.0, jump=jump)


def _median_yaw(record: FlightRecord) -> float:
    """Return the median of the measured yaw, rad; 0 if it is not logged."""
    return 0.0 if record.attitude is None else float(np.median(np.unwrap(record.attitude[:, 2])))


def _without_repetitions(time: np.ndarray, logged: list[np.ndarray]) -> list[np.ndarray]:
    """Return times (m,) and signals (m, 3) in which each value that repeats for at most 50 ms occurs once.

    The time of such a value is the middle of its repetitions.
    """
    first = np.flatnonzero(np.append(True, np.any(np.diff(np.hstack(logged), axis=0) != 0.0, axis=1)))
    last = np.append(first[1:], len(time)) - 1
    at_standstill = np.repeat(time[last] - time[first] > _MAX_REPETITION_TIME, last - first + 1)
    run = np.repeat(np.arange(len(first)), last - first + 1)
    middle = np.where(at_standstill, time, 0.5 * (time[first] + time[last])[run])
    is_selected = at_standstill | np.isin(np.arange(len(time)), first)
    return [middle[is_selected], *(values[is_selected] for values in logged)]


def _fitted_path(
    time: np.ndarray, samples: list[np.ndarray], *, end: float, spacing: float, orders: int, at_rest: bool = False
) -> PolynomialPath:
    """Return the least-squares path to samples of a signal and its derivatives.

    Args:
        time: (n,) times of the samples, s.
        samples: known derivatives (n, axes) of order 0, 1, ..., in SI units.
        end: end of the path, which starts at 0, s.
        spacing: largest distance between knots, s.
        orders: number of continuous derivatives at the knots, including order 0.
        at_rest: True if the path starts at rest.
    """
    count = max(math.ceil(end / spacing), 1)
    knots, h = np.linspace(0.0, end, count + 1), end / count
    segment = np.clip((time / h).astype(int), 0, count - 1)
    s = (time - knots[segment]) / h
    # The unknowns are the derivatives at the two knots around a sample, scaled by powers of h (Hermite basis).
    unit = np.eye(2 * orders).reshape(2 * orders, 2, orders).transpose(1, 2, 0)
    basis = hermite_path(np.array([0.0, 1.0]), unit).coefficients[0]
    rows = [power_basis(order, s, 2 * orders) @ basis * h**-order for order in range(len(samples))]
    ends = power_basis(orders, np.linspace(0.0, 1.0, orders), 2 * orders) @ basis * np.sqrt(_SNAP_WEIGHT)
    normal, right_side = np.zeros(((count + 1) * orders,) * 2), np.zeros(((count + 1) * orders, samples[0].shape[1]))
    for k in range(count):
        columns, in_segment = slice(k * orders, (k + 2) * orders), segment == k
        normal[columns, columns] += ends.T @ ends
        for row, values in zip(rows, samples, strict=True):
            normal[columns, columns] += row[in_segment].T @ row[in_segment]
            right_side[columns] += row[in_segment].T @ values[in_segment]
    if at_rest:
        derivative_orders = np.arange(1, orders)
        normal[derivative_orders, derivative_orders] += _REST_WEIGHT
    derivatives = np.linalg.solve(normal, right_side).reshape(count + 1, orders, -1)
    return hermite_path(knots, derivatives * h ** -np.arange(orders)[:, np.newaxis])


def _knots(path: PolynomialPath) -> list[Knot]:
    """Return the knots of a path, with the derivatives of the position at each knot."""
    derivatives = [evaluate(path, path.times, order).T.tolist() for order in range(4)]
    return [
        Knot(time=time, position=position, velocity=velocity, acceleration=acceleration, jerk=jerk)
        for time, position, velocity, acceleration, jerk in zip(path.times.tolist(), *derivatives, strict=True)
    ]


def _approach(first: Knot, rest: float) -> list[Knot]:
    """Return two knots at rest from which the vehicle accelerates to the first knot of a path."""
    duration = _ACCELERATION_FRACTION * rest
    position = tuple((np.array(first.position) - 0.5 * duration * np.array(first.velocity)).tolist())
    return [Knot(time=0.0, position=position), Knot(time=rest - duration, position=position)]


def _yaw_knots(record: FlightRecord, rest: float) -> tuple[YawKnot, ...]:
    """Return the yaw of the reference over the whole route."""
    end = float(record.time[-1]) + rest
    if record.reference_yaw is None:
        median_yaw = _median_yaw(record)
        return YawKnot(time=0.0, yaw=median_yaw), YawKnot(time=end, yaw=median_yaw)
    yaw = np.unwrap(record.reference_yaw)[:, np.newaxis]
    path = _fitted_path(record.time, [yaw], end=float(record.time[-1]), spacing=_KNOT_SPACINGS[0], orders=2)
    angles, rates = (evaluate(path, path.times, order)[0].tolist() for order in range(2))
    knots = [
        YawKnot(time=time + rest, yaw=angle, yaw_rate=rate)
        for time, angle, rate in zip(path.times.tolist(), angles, rates, strict=True)
    ]
    return (YawKnot(time=0.0, yaw=knots[0].yaw), *knots) if rest > 0.0 else tuple(knots)
