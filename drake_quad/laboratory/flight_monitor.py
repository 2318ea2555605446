"""The referee of a flight: who has crashed, and how well it goes."""

import math
from typing import Any, NamedTuple, Protocol

import numpy as np
from pydrake.systems.framework import Context

from drake_quad.framework.elementary import maximum, minimum, where, where_needed
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.metrics import SUMS_OF_PORTS, Metrics, Sums, TickValues, add_tick, summarized
from drake_quad.signals import (
    Acceleration,
    AttitudeTarget,
    Crashed,
    CrashTime,
    PositionError,
    Reference,
    Row,
    State,
    Wrench,
)


class CrashLimits(NamedTuple):
    """Where a flight ends.

    Attributes:
        tilt: of roll or pitch, rad.
        position_error: Euclidean, m.
        height: a vehicle below this z has crashed, m.
    """

    tilt: float = math.radians(80.0)
    position_error: float = 5.0
    height: float = -0.5


class Solid(Protocol):
    """Something to fly into."""

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """How far a point of W is from its surface, m; negative inside."""

    def at_least(self, x: Row, y: Row, z: Row) -> Row | None:
        """A number that the distance is not below, m, and that costs less; None if the distance costs little itself."""


class Surroundings(NamedTuple):
    """What a vehicle may touch.

    Attributes:
        solids: a vehicle that touches one of them has crashed.
        radius: of the vehicle around its centre of mass, m.
    """

    solids: tuple[Solid, ...] = ()
    radius: float = 0.0


class Touched(NamedTuple):
    """What a vehicle crashed into.

    Attributes:
        number: of the solid, from 1 on; 0 if it touched none.
    """

    number: Row = 0.0


class FreeBall(NamedTuple):
    """Where a vehicle can touch nothing.

    Attributes:
        x, y, z: the middle, m.
        radius: as far as its centre of mass can be from there, m.
    """

    x: Row = 0.0
    y: Row = 0.0
    z: Row = 0.0
    radius: Row = 0.0


# What distances may be off by in floating point, m.
_ROUNDING = 1e-6


class Window(NamedTuple):
    """When a flight counts for its metrics.

    Attributes:
        start: first time that counts, s.
        end: last time that counts, s.
    """

    start: float = 0.0
    end: float = math.inf


class Judgement(NamedTuple):
    """What the monitor knows of a vehicle.

    Attributes:
        crashed: whether it has crashed.
        crash_time: when.
        touched: what it crashed into.
        free: where it can touch nothing.
        sums: from which its metrics follow.
    """

    crashed: Crashed
    crash_time: CrashTime
    touched: Touched
    free: FreeBall
    sums: Sums


def judged(
    state: State,
    reference: Reference,
    command: Acceleration,
    wrench: Wrench | None,
    target: AttitudeTarget | None,
    shortfall: Wrench,
    before: CrashTime,
    touched: Touched,
    free: FreeBall,
    sums: Sums,
    time: Row,
    limits: CrashLimits,
    surroundings: Surroundings,
    window: Window,
) -> Judgement:
    """Return the state of the monitor of a vehicle after one more tick.

    Args:
        state: true state of the vehicle.
        reference: reference that the vehicle follows.
        command: commanded acceleration.
        wrench: wrench that is sent over the link; None with an autopilot.
        target: target that is sent to an autopilot over the link; None without an autopilot.
        shortfall: part of the wrench that the rotors cannot give.
        before: crash time up to now, s.
        touched: obstacle of the crash up to now.
        free: last region that is known to be free of obstacles.
        sums: sums of the metrics up to now.
        time: time of the tick, s.
        limits: limits beyond which a vehicle has crashed.
        surroundings: obstacles that the vehicle must not touch.
        window: metric window.
    """
    error = PositionError(reference.x - state.x, reference.y - state.y, reference.z - state.z)
    total: Row = 0.0
    for part in (*command, *(wrench or ()), *(target or ())):
        total = total + part
    touch, free = touching(state, before.crash_time == math.inf, free, surroundings)
    # Not a number is beyond any limit.
    flying = (
        (abs(state.roll) <= limits.tilt)
        & (abs(state.pitch) <= limits.tilt)
        & (error.x * error.x + error.y * error.y + error.z * error.z <= limits.position_error * limits.position_error)
        & (state.z >= limits.height)
        & (total - total == 0.0)
        & (touch.number == 0.0)
        & (before.crash_time == math.inf)
    )
    complete = True
    for part in shortfall:
        complete = complete & (part == 0.0)
    after = add_tick(sums, TickValues(error, command, where(complete, 0.0, 1.0)))
    counts = (time >= window.start) & (time <= window.end)
    return Judgement(
        Crashed(where(flying, 0.0, 1.0)),
        CrashTime(where(flying, before.crash_time, minimum(before.crash_time, time))),
        Touched(where(touch.number > 0.0, touch.number, touched.number)),
        free,
        where(flying & counts, after, sums),
    )


def touching(state: State, flies: bool, free: FreeBall, surroundings: Surroundings) -> tuple[Touched, FreeBall]:
    """What a vehicle touches now if it flies, and where it can touch nothing.

    A distance changes by no more than the vehicle moves: it can touch nothing that is r + d away (r its radius) before
    it has moved by d, and until then no distance is computed.

    Args:
        state: the true one.
        flies: whether it has not crashed.
        free: where it can touch nothing, as was found last.
        surroundings: that it must not touch.
    """
    if not surroundings.solids:
        return Touched(), free
    x, y, z = state.x - free.x, state.y - free.y, state.z - free.z
    leaves = flies & (x * x + y * y + z * z >= free.radius * free.radius)
    position = state.x, state.y, state.z

    def nearest(x: Row, y: Row, z: Row) -> tuple[Row, Row]:
        return nearest_solid(x, y, z, surroundings.solids)

    distance, number = where_needed(leaves, nearest, position, (math.inf, 0.0))
    around = FreeBall(*position, maximum(0.0, distance - (surroundings.radius + _ROUNDING)))
    return Touched(where(distance < surroundings.radius, number, 0.0)), where(leaves, around, free)


def nearest_solid(x: Row, y: Row, z: Row, solids: tuple[Solid, ...]) -> tuple[Row, Row]:
    """How far a point is from the nearest solid, m, and the number of that from 1 on; infinity and 0 if none."""
    least: Row = math.inf
    number: Row = 0.0
    for i, solid in enumerate(solids, start=1):
        bound = solid.at_least(x, y, z)
        if bound is None:
            distance = solid.distance(x, y, z)
        else:
            distance = where_needed(bound < least, solid.distance, (x, y, z), math.inf)
        nearer = distance < least
        least, number = where(nearer, distance, least), where(nearer, float(i), number)
    return least, number


def _unknown(value: Any) -> Any:
    """Return NaN in place of a sum, or of each field of a record of sums."""
    return type(value)(*[np.nan] * len(value)) if hasattr(value, "_fields") else np.nan


@fleet_system(float, AutoDiffXd)
class FlightMonitor(FleetSystem):
    """Detection of crashes, and accumulation of the sums from which the metrics follow.

    .. pydrake_system::

        name: FlightMonitor
        input_ports:
        - state
        - reference
        - acceleration_command
        - wrench
        - attitude_target
        - shortfall
        output_ports:
        - crashed
        - crash_time

    At every tick of the control the monitor compares the true position in `state` with that in `reference`, and adds to
    the sums of `drake_quad.laboratory.metrics`. A vehicle has crashed when it exceeds a limit, when its centre of mass
    is nearer to a solid than its radius, or when a command is not finite. `crashed` is then 1 instead of 0, and
    `crash_time` is the time of the tick instead of infinity. The tick of a crash does not count for the metrics.

    The control effort is computed from `acceleration_command` and the saturation from `shortfall`. Both are zero if
    their port is not connected. The command over the link is `wrench` or `attitude_target`; one of them is connected.

    The states are `crashed`, `crash_time`, `touched`, `free` and `sums`.

    Args:
        num_vehicles: N.
        period: tick period, s.
        limits: limits beyond which a vehicle has crashed.
        surroundings: obstacles that a vehicle must not touch.
        window: metric window.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        limits: CrashLimits = CrashLimits(),
        surroundings: Surroundings = Surroundings(),
        window: Window = Window(),
    ) -> None:
        """Declare ports and states."""
        self._period = period
        state, reference = self.input("state"), self.input("reference")
        command = self.input("acceleration_command", absent=Acceleration(0.0, 0.0, 0.0))
        sent = self.input("wrench"), self.input("attitude_target")
        shortfall = self.input("shortfall", absent=Wrench(0.0, 0.0, 0.0, 0.0))
        crashed = self.state("crashed", lambda _: Crashed(0.0))
        crash_time, sums = self.state("crash_time", lambda _: CrashTime(math.inf)), self.state("sums", lambda _: Sums())
        touched = self.state("touched", lambda _: Touched())
        held = crash_time, touched, self.state("free", lambda _: FreeBall()), sums
        reads = state, reference, command, *sent, shortfall, *held, TIME, limits, surroundings, window
        self.update(period, judged, *reads, writes=[crashed, *held])
        self.state_output(crashed)
        self.state_output(crash_time)

    def metrics(self, context: Context) -> Metrics:
        """Return the metrics so far, (N,) arrays; those of input ports that are not connected are NaN."""
        sums = self._arrays(context, "sums")
        for port, names in SUMS_OF_PORTS.items():
            if not self.GetInputPort(port).HasValue(context):
                sums = sums._replace(**{name: _unknown(getattr(sums, name)) for name in names})
        return summarized(sums, self._arrays(context, "crash_time").crash_time, self._period)

    def touched(self, context: Context) -> np.ndarray:
        """(N,) number of the solid that each vehicle crashed into, from 1 on; 0 if it touched none."""
        return np.asarray(self._arrays(context, "touched").number).astype(int)

    def _arrays(self, context: Context, name: str) -> Any:
        """The record of a state, of (N,) arrays."""
        group = self.states[name]
        return group.layout.build(group.vector(self, context).CopyToVector().reshape(-1, self.num_vehicles))
