"""The referee of a flight: who has crashed, and how well it goes."""

import math
from typing import Any, NamedTuple

import numpy as np

from drake_quad.elementary import Row, every, minimum, where
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


# Rows of inputs that are not connected.
_NO_COMMAND, _NO_SHORTFALL = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)


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
        state = self.input_rows(context, self._state)
        reference = self.input_rows(context, self._reference)
        command = self.optional_input_rows(context, self._command, default=_NO_COMMAND)
        error = [reference[0] - state[0], reference[1] - state[1], reference[2] - state[2]]
        (crash_time,) = self.state_rows(context, self._crash_time)
        within = self._within_limits(state, error, command)
        flying = within & (crash_time == math.inf)
        time = context.get_time()
        if not every(flying):
            crash_time = where(flying, crash_time, minimum(crash_time, time))
            self.write(discrete_state.get_mutable_vector(self._crash_time), [crash_time])
            self.write(discrete_state.get_mutable_vector(self._crashed), [where(flying, 0.0, 1.0)])
        if self._window[0] <= time <= self._window[1]:
            self._count(context, discrete_state.get_mutable_vector(self._sums), error, command, flying)

    def _within_limits(self, state: Any, error: Any, command: Any) -> Row:
        """Mask of the vehicles within all limits; NaN is beyond any."""
        tilt, reach, height = self._limits
        distance = error[0] * error[0] + error[1] * error[1] + error[2] * error[2]
        total = command[0] + command[1] + command[2]
        return (
            (abs(state[3]) <= tilt)
            & (abs(state[4]) <= tilt)
            & (distance <= reach * reach)
            & (state[2] >= height)
            & (total - total == 0.0)
        )

    def _count(self, context: Any, vector: Any, error: Any, command: Any, flying: Row) -> None:
        lost = self.optional_input_rows(context, self._shortfall, default=_NO_SHORTFALL)
        saturated = (lost[0] != 0.0) | (lost[1] != 0.0) | (lost[2] != 0.0) | (lost[3] != 0.0)
        before = self.rows(vector)
        after = add_tick(before, error, command, where(saturated, 1.0, 0.0))
        if not every(flying):
            after = [where(flying, new, old) for new, old in zip(after, before, strict=True)]
        self.write(vector, after)
