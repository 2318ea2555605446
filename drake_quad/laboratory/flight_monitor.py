"""The referee of a flight: who has crashed, and how well it goes."""

import math
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context

from drake_quad.framework.elementary import minimum, where
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.metrics import Metrics, PerAxis, Sums, add_tick, summarized
from drake_quad.signals import Acceleration, Crashed, CrashTime, PositionError, Reference, Row, State, Wrench


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
        sums: from which its metrics follow.
    """

    crashed: Crashed
    crash_time: CrashTime
    sums: Sums


def judged(
    state: State,
    reference: Reference,
    command: Acceleration,
    shortfall: Wrench,
    before: CrashTime,
    sums: Sums,
    time: Row,
    limits: CrashLimits,
    window: Window,
) -> Judgement:
    """What the monitor knows of a vehicle after one more tick.

    Args:
        state: the true one.
        reference: to follow.
        command: commanded acceleration.
        shortfall: what is given up of the wrench.
        before: when it crashed, until now.
        sums: until now.
        time: s.
        limits: beyond which a vehicle has crashed.
        window: in which ticks count.
    """
    error = PositionError(reference.x - state.x, reference.y - state.y, reference.z - state.z)
    total = command.x + command.y + command.z
    # Not a number is beyond any limit.
    flying = (
        (abs(state.roll) <= limits.tilt)
        & (abs(state.pitch) <= limits.tilt)
        & (error.x * error.x + error.y * error.y + error.z * error.z <= limits.position_error * limits.position_error)
        & (state.z >= limits.height)
        & (total - total == 0.0)
        & (before.crash_time == math.inf)
    )
    complete = True
    for part in shortfall:
        complete = complete & (part == 0.0)
    after = add_tick(sums, error, command, where(complete, 0.0, 1.0))
    counts = (time >= window.start) & (time <= window.end)
    return Judgement(
        Crashed(where(flying, 0.0, 1.0)),
        CrashTime(where(flying, before.crash_time, minimum(before.crash_time, time))),
        where(flying & counts, after, sums),
    )


@fleet_system(float, AutoDiffXd)
class FlightMonitor(FleetSystem):
    """Calls crashes and gathers the sums from which the metrics follow.

    .. pydrake_system::

        name: FlightMonitor
        input_ports:
        - state
        - reference
        - acceleration_command
        - shortfall
        output_ports:
        - crashed
        - crash_time

    At every tick of the control it compares the true position in `state` with that in `reference` and adds to the sums
    of `drake_quad.laboratory.metrics`. A vehicle has crashed when it is beyond a limit or when the commanded
    acceleration is not finite: `crashed` is then 1 instead of 0, and `crash_time` is that tick instead of infinity. The
    tick of a crash no longer counts. `acceleration_command` is what the control effort is made of and `shortfall` what
    saturation is; not connected they count as zero.

    The states are `crashed`, `crash_time` and `sums`.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        limits: beyond which a vehicle has crashed.
        window: in which ticks count for the metrics.
    """

    def declare(self, *, period: float = 0.02, limits: CrashLimits = CrashLimits(), window: Window = Window()) -> None:
        """Declares the system."""
        self._period = period
        state, reference = self.input("state"), self.input("reference")
        self._command = self.input("acceleration_command", absent=Acceleration(0.0, 0.0, 0.0))
        self._shortfall = self.input("shortfall", absent=Wrench(0.0, 0.0, 0.0, 0.0))
        crashed = self.state("crashed", lambda _: Crashed(0.0))
        crash_time, sums = self.state("crash_time", lambda _: CrashTime(math.inf)), self.state("sums", lambda _: Sums())
        reads = state, reference, self._command, self._shortfall, crash_time, sums, TIME, limits, window
        self.update(period, judged, *reads, writes=[crashed, crash_time, sums])
        self.state_output(crashed)
        self.state_output(crash_time)

    def metrics(self, context: Context) -> Metrics:
        """The metrics so far, (N,) arrays; those of what is not connected are NaN."""
        sums, unknown = self._arrays(context, "sums"), PerAxis(np.nan, np.nan, np.nan)
        if not self.get_input_port(self._command.index).HasValue(context):
            sums = sums._replace(effort=unknown, variation=unknown)
        if not self.get_input_port(self._shortfall.index).HasValue(context):
            sums = sums._replace(saturated=np.nan)
        return summarized(sums, self._arrays(context, "crash_time").crash_time, self._period)

    def _arrays(self, context: Context, name: str) -> Any:
        """The record of a state, of (N,) arrays."""
        group = self.states[name]
        return group.layout.build(group.vector(self, context).CopyToVector().reshape(-1, self.num_vehicles))
