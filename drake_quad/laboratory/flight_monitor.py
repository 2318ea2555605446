"""The referee of a flight: who has crashed, and how well it goes."""

import math
from typing import Any, NamedTuple

import numpy as np

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, minimum, where
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.laboratory.metrics import NUM_SUMS, Metrics, add_tick, summarized


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


@formula
def judged(
    state: Rows,
    reference: Rows,
    command: Rows,
    shortfall: Rows,
    crash_time: Rows,
    sums: Rows,
    time: Row,
    counts: float,
    tilt: float,
    reach: float,
    height: float,
) -> tuple[Rows, Rows, Rows]:
    """Whether a vehicle has crashed (1 or 0), when (s), and its sums.

    Args:
        state: 12 rows.
        reference: 11 rows.
        command: commanded acceleration, 3 rows, m/s².
        shortfall: what is given up of the wrench, 4 rows.
        crash_time: until now, s; infinite for a vehicle that has not crashed.
        sums: until now, 15 rows.
        time: s.
        counts: 1 if this tick counts for the metrics, else 0.
        tilt: the largest, rad.
        reach: the largest position error, m.
        height: the least, m.
    """
    e_x, e_y, e_z = reference[0] - state[0], reference[1] - state[1], reference[2] - state[2]
    total = command[0] + command[1] + command[2]
    # Not a number is beyond any limit.
    flying = (
        (abs(state[3]) <= tilt)
        & (abs(state[4]) <= tilt)
        & (e_x * e_x + e_y * e_y + e_z * e_z <= reach * reach)
        & (state[2] >= height)
        & (total - total == 0.0)
        & (crash_time[0] == math.inf)
    )
    lost_1, lost_2, lost_3, lost_4 = shortfall
    saturated = where((lost_1 != 0.0) | (lost_2 != 0.0) | (lost_3 != 0.0) | (lost_4 != 0.0), 1.0, 0.0)
    after = add_tick(sums, (e_x, e_y, e_z), command, saturated)
    return (
        (where(flying, 0.0, 1.0),),
        (where(flying, crash_time[0], minimum(crash_time[0], time)),),
        where(flying & (counts != 0.0), after, sums),
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

    At every tick of the control it compares the true position in `state` (12 rows) with that in `reference` (11) and
    adds to the sums of `drake_quad.laboratory.metrics`. A vehicle has crashed when it is beyond a limit or when the
    commanded acceleration is not finite: `crashed` (1) is then 1 instead of 0, and `crash_time` (1) is that tick (s)
    instead of infinity. The tick of a crash no longer counts. `acceleration_command` (3) is what the control effort
    is made of and `shortfall` (4) what saturation is; not connected they count as zero.

    Discrete-state groups: 0 `crashed`, 1 `crash_time`, 2 the 15 rows of sums.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        limits: beyond which a vehicle has crashed.
        window: first and last time that counts for the metrics, s.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.02,
        limits: CrashLimits = CrashLimits(),
        window: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._period, self._limits, self._window = period, limits, window
        self._state = self.input("state", 12)
        self._reference = self.input("reference", 11)
        self._command = self.input("acceleration_command", 3)
        self._shortfall = self.input("shortfall", 4)
        self._crashed = self.discrete_state("crashed", [0.0])
        self._crash_time = self.discrete_state("crash_time", [math.inf])
        self._sums = self.discrete_state("sums", [0.0] * NUM_SUMS)
        self._judge = self.mapped(judged, inputs=(12, 11, 3, 4, 1, NUM_SUMS), outputs=(1, 1, NUM_SUMS))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._watch)
        self.state_output(1, self._crashed)
        self.state_output(1, self._crash_time)

    def metrics(self, context: Any) -> Metrics:
        """The metrics so far, (N,) arrays; those of what is not connected are NaN."""
        sums = context.get_discrete_state(self._sums).CopyToVector().reshape(NUM_SUMS, self.num_vehicles)
        if not self.get_input_port(self._command).HasValue(context):
            sums[6:12] = np.nan
        if not self.get_input_port(self._shortfall).HasValue(context):
            sums[2] = np.nan
        return summarized(sums, context.get_discrete_state(self._crash_time).CopyToVector(), self._period)

    def _watch(self, context: Any, discrete_state: Any) -> None:
        time, (first, last) = context.get_time(), self._window
        counts = 1.0 if first <= time <= last else 0.0
        groups = [discrete_state.get_mutable_vector(i) for i in (self._crashed, self._crash_time, self._sums)]
        inputs = self.inputs(context, self._state, self._reference, self._command, self._shortfall)
        self._judge(groups, [*inputs, *groups[1:]], time, counts, *self._limits)
