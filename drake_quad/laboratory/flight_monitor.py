"""Flight monitor: detection of crashes, and accumulation of the metrics during a flight."""

import math
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydrake.systems.framework import Context

from drake_quad.framework.elementary import lazy_where, maximum, minimum, where
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.metrics import Accumulator, Metrics, Sums, add_tick, compute_metrics, metric_accumulators
from drake_quad.signals import (
    SIGNALS,
    Acceleration,
    AttitudeTarget,
    Crashed,
    CrashTime,
    PositionError,
    Quantity,
    Reference,
    Row,
    State,
    Wrench,
)


class CrashLimits(NamedTuple):
    """Limits beyond which a vehicle counts as crashed.

    Attributes:
        tilt: largest absolute value of roll and of pitch, rad.
        position_error: largest Euclidean position error, m.
        height: smallest z of the vehicle in W, m.
    """

    tilt: float = math.radians(80.0)
    position_error: float = 5.0
    height: float = -0.5


class Solid(Protocol):
    """Solid that a vehicle can collide with."""

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance of a point in W from the surface, m; negative inside the solid."""

    def distance_lower_bound(self, x: Row, y: Row, z: Row) -> Row | None:
        """Return a lower bound on the distance, m, that is cheaper to compute; None if the distance itself is cheap."""


class Surroundings(NamedTuple):
    """Solids around a vehicle, and the size of the vehicle.

    Attributes:
        solids: solids; a vehicle that touches one of them has crashed.
        radius: radius of the sphere around the centre of mass that contains the vehicle, m.
    """

    solids: tuple[Solid, ...] = ()
    radius: float = 0.0


class CollidedSolid(NamedTuple):
    """Solid that a vehicle crashed into.

    Attributes:
        number: number of the solid, from 1 on; 0 if the vehicle has touched none.
    """

    number: Row = 0.0


class FreeBall(NamedTuple):
    """Ball of centre-of-mass positions at which a vehicle touches no solid.

    Attributes:
        x, y, z: centre of the ball in W, m.
        radius: radius of the ball, m.
    """

    x: Row = 0.0
    y: Row = 0.0
    z: Row = 0.0
    radius: Row = 0.0


# Upper bound on the rounding error of a computed distance, m.
_DISTANCE_TOLERANCE = 1e-6


class Clearance(NamedTuple):
    """Distance of a vehicle from the nearest other vehicle.

    Attributes:
        distance: distance between the spheres around both vehicles; negative if they overlap.
    """

    distance: Annotated[Row, Quantity("m")] = math.inf


SIGNALS["clearance"] = Clearance


class Window(NamedTuple):
    """Metric window, the time interval from which the metrics of a flight are computed.

    Attributes:
        start: first instant of the window, s.
        end: last instant of the window, s.
    """

    start: float = 0.0
    end: float = math.inf


class MonitorState(NamedTuple):
    """State of the monitor for a vehicle.

    Attributes:
        crashed: 1 if the vehicle has crashed, else 0.
        crash_time: time of the crash, s; infinite if the vehicle has not crashed.
        obstacle_hit: solid that the vehicle crashed into.
        free_ball: ball in which the vehicle touches no solid.
        sums: sums from which the metrics are computed.
    """

    crashed: Crashed
    crash_time: CrashTime
    obstacle_hit: CollidedSolid
    free_ball: FreeBall
    sums: Sums


def monitor_step(
    state: State,
    reference: Reference,
    command: Acceleration,
    wrench: Wrench | None,
    target: AttitudeTarget | None,
    shortfall: Wrench,
    clearance: Clearance,
    before: CrashTime,
    obstacle_hit: CollidedSolid,
    free_ball: FreeBall,
    sums: Sums,
    time: Row,
    limits: CrashLimits,
    surroundings: Surroundings,
    window: Window,
    period: float,
    accumulators: tuple[Accumulator, ...],
    names: tuple[str, ...],
    *others: Any,
) -> MonitorState:
    """Return the monitor state of a vehicle after one more tick.

    Args:
        state: true state of the vehicle.
        reference: reference that the vehicle follows.
        command: commanded acceleration.
        wrench: wrench that is sent over the link; None with an autopilot.
        target: attitude target that is sent over the link; None without an autopilot.
        shortfall: part of the wrench that the rotors cannot produce.
        clearance: distance from the nearest other vehicle.
        before: crash time before this tick, s.
        obstacle_hit: solid that the vehicle crashed into before this tick.
        free_ball: ball in which the vehicle touches no solid.
        sums: sums before this tick.
        time: time of the tick, s.
        limits: limits beyond which a vehicle counts as crashed.
        surroundings: solids that the vehicle must not touch.
        window: metric window.
        period: duration of a tick, s.
        accumulators: accumulators of the metrics.
        names: names of the further signals that the accumulators read.
        others: values of these further signals.
    """
    error = PositionError(reference.x - state.x, reference.y - state.y, reference.z - state.z)
    total: Row = 0.0
    for part in (*command, *(wrench or ()), *(target or ())):
        total = total + part
    contact, free_ball = detect_contact(state, before.crash_time == math.inf, free_ball, surroundings)
    # Comparisons with NaN are false, so a vehicle whose state is NaN has crashed.
    flying = (
        (abs(state.roll) <= limits.tilt)
        & (abs(state.pitch) <= limits.tilt)
        & (error.x * error.x + error.y * error.y + error.z * error.z <= limits.position_error * limits.position_error)
        & (state.z >= limits.height)
        & (total - total == 0.0)
        & (contact.number == 0.0)
        & (clearance.distance >= 0.0)
        & (before.crash_time == math.inf)
    )
    signals: dict[str, Any] = {"state": state, "reference": reference, "acceleration_command": command}
    signals |= {"shortfall": shortfall, "wrench": wrench, "attitude_target": target}
    signals |= dict(zip(names, others, strict=True))
    counts = (time >= window.start) & (time <= window.end)
    values = {**signals, "time": time, "period": period}
    return MonitorState(
        Crashed(where(flying, 0.0, 1.0)),
        CrashTime(where(flying, before.crash_time, minimum(before.crash_time, time))),
        CollidedSolid(where(contact.number > 0.0, contact.number, obstacle_hit.number)),
        free_ball,
        add_tick(sums, accumulators, values, flying, counts),
    )


def detect_contact(
    state: State, flies: bool, free_ball: FreeBall, surroundings: Surroundings
) -> tuple[CollidedSolid, FreeBall]:
    """Return the solid that a flying vehicle touches, and a ball in which the vehicle touches no solid.

    A vehicle of radius r at the distance r + d from the nearest solid must move by at least d to touch a solid.
    Distances are therefore computed only when the vehicle has left the previous ball.

    Args:
        state: true state of the vehicle.
        flies: True if the vehicle has not crashed.
        free_ball: previous ball in which the vehicle touches no solid.
        surroundings: solids that the vehicle must not touch.
    """
    if not surroundings.solids:
        return CollidedSolid(), free_ball
    x, y, z = state.x - free_ball.x, state.y - free_ball.y, state.z - free_ball.z
    has_left = flies & (x * x + y * y + z * z >= free_ball.radius * free_ball.radius)
    position = state.x, state.y, state.z

    def nearest(x: Row, y: Row, z: Row) -> tuple[Row, Row]:
        return nearest_solid(x, y, z, surroundings.solids)

    distance, number = lazy_where(has_left, nearest, position, (math.inf, 0.0))
    around = FreeBall(*position, maximum(0.0, distance - (surroundings.radius + _DISTANCE_TOLERANCE)))
    return CollidedSolid(where(distance < surroundings.radius, number, 0.0)), where(has_left, around, free_ball)


def nearest_solid(x: Row, y: Row, z: Row, solids: tuple[Solid, ...]) -> tuple[Row, Row]:
    """Return the distance of a point in W from the nearest solid, m, and the number of this solid.

    Solids are numbered from 1 on. The distance is infinite and the number is 0 if there are no solids.
    """
    smallest: Row = math.inf
    number: Row = 0.0
    for i, solid in enumerate(solids, start=1):
        bound = solid.distance_lower_bound(x, y, z)
        if bound is None:
            distance = solid.distance(x, y, z)
        else:
            distance = lazy_where(bound < smallest, solid.distance, (x, y, z), math.inf)
        nearer = distance < smallest
        smallest, number = where(nearer, distance, smallest), where(nearer, float(i), number)
    return smallest, number


@fleet_system(float, AutoDiffXd)
class FlightMonitor(FleetSystem):
    """Flight monitor, which detects crashes and accumulates the sums from which the metrics are computed.

    .. pydrake_system::

        name: FlightMonitor
        input_ports:
        - state
        - reference
        - acceleration_command
        - wrench
        - attitude_target
        - shortfall
        - clearance
        output_ports:
        - crashed
        - crash_time

    At every control tick the monitor compares the true position in `state` with the position in `reference`, and
    updates the sums of `drake_quad.laboratory.metrics`. A vehicle crashes when it exceeds a limit, when the distance of
    its centre of mass from a solid is below the radius of the vehicle, or when a command is NaN or infinite. `crashed`
    is then 1 instead of 0, and `crash_time` is the time of the tick instead of infinity. The tick of a crash does not
    count for the metrics.

    The control effort is computed from `acceleration_command`, and the saturation from `shortfall`. If one of these
    inputs is not connected, it counts as zero, and the metrics that depend on it are NaN. Either `wrench` or
    `attitude_target` is connected: the command that is sent over the link. Additional metrics may need further signals,
    for which the monitor then has input ports.

    The states are `crashed`, `crash_time`, `obstacle_hit`, `free_ball` and `sums`.

    Args:
        num_vehicles: number N of vehicles.
        period: tick period, s.
        limits: limits beyond which a vehicle counts as crashed.
        surroundings: solids that a vehicle must not touch.
        window: metric window.
        metrics: class of the metrics, from `drake_quad.laboratory.metrics.metrics_type`.
        has_neighbours: True to add the input port `clearance`, the distance from the nearest other vehicle. A vehicle
            crashes if this distance is negative.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        limits: CrashLimits = CrashLimits(),
        surroundings: Surroundings = Surroundings(),
        window: Window = Window(),
        metrics: type[Metrics] = Metrics,
        has_neighbours: bool = False,
    ) -> None:
        """Declare the ports and states of this system."""
        self._period, self._metrics = period, metrics
        accumulators = metric_accumulators(metrics)
        state, reference = self.input("state"), self.input("reference")
        command = self.input("acceleration_command", absent=Acceleration(0.0, 0.0, 0.0))
        sent = self.input("wrench", absent=None), self.input("attitude_target", absent=None)
        shortfall = self.input("shortfall", absent=Wrench(0.0, 0.0, 0.0, 0.0))
        clearance = self.input("clearance") if has_neighbours else Clearance()
        signal_names = dict.fromkeys(name for accumulator in accumulators for name in accumulator.signals)
        others = {name: self.input(name) for name in signal_names if not self.HasInputPort(name)}
        crashed = self.state("crashed", lambda _: Crashed(0.0))
        crash_time = self.state("crash_time", lambda _: CrashTime(math.inf))
        obstacle_hit, free_ball = (
            self.state("obstacle_hit", lambda _: CollidedSolid()),
            self.state("free_ball", lambda _: FreeBall()),
        )
        sums = self.state("sums", lambda _: Sums.before(accumulators))
        states = crash_time, obstacle_hit, free_ball, sums
        settings = limits, surroundings, window, period, accumulators, tuple(others)
        arguments = state, reference, command, *sent, shortfall, clearance, *states, TIME, *settings, *others.values()
        self.update(period, monitor_step, *arguments, writes=[crashed, *states])
        self.state_output(crashed)
        self.state_output(crash_time)

    def metrics(self, context: Context) -> Metrics:
        """Return the metrics up to the current time, (N,) arrays.

        A metric is NaN if it is computed from an input port that is not connected.
        """
        sums, crash_time = self._arrays(context, "sums"), self._arrays(context, "crash_time").crash_time

        def is_connected(signal: str) -> bool:
            return bool(self.GetInputPort(signal).HasValue(context))

        return compute_metrics(sums, crash_time, self._period, self._metrics, is_connected)

    def obstacle_hit(self, context: Context) -> np.ndarray:
        """Return the (N,) number of the solid that each vehicle crashed into, from 1 on; 0 if it touched none."""
        return np.asarray(self._arrays(context, "obstacle_hit").number).astype(int)

    def _arrays(self, context: Context, name: str) -> Any:
        """Return a state as a record of (N,) arrays."""
        group = self.states[name]
        return group.layout.build(group.vector(self, context).CopyToVector().reshape(-1, self.num_vehicles))
