"""The referee of a flight: who has crashed, and how well it goes."""

import math
from typing import Any, NamedTuple

import numpy as np

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


# A wrench that the rotors can give comes back from the allocation to rounding, some 1e-15 N or N m.
_SATURATED = 1e-9


@fleet_system(float, AutoDiffXd)
class FlightMonitor(FleetSystem):
    """Calls crashes and gathers the sums from which the metrics follow.

    .. pydrake_system::

        name: FlightMonitor
        input_ports:
        - state
        - reference
        - acceleration_command
        - wrench
        - shortfall
        output_ports:
        - crashed
        - crash_time

    At every tick of the control it compares the true position in `state` (12 rows) with that in `reference` (11) and
    adds to the sums of `drake_quad.laboratory.metrics`. A vehicle has crashed when it is beyond a limit or when the
    commanded `wrench` (4) is not finite: `crashed` (1) is then 1 instead of 0, and `crash_time` (1) is that tick (s)
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
        self._wrench = self.input("wrench", 4)
        self._shortfall = self.input("shortfall", 4)
        self._crashed = self.discrete_state([0.0])
        self._crash_time = self.discrete_state([math.inf])
        self._sums = self.discrete_state([0.0] * NUM_SUMS)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._watch)
        self.DeclareStateOutputPort("crashed", self._crashed)
        self.DeclareStateOutputPort("crash_time", self._crash_time)

    def metrics(self, context: Any) -> Metrics:
        """The metrics so far, (N,) arrays; those of what is not connected are NaN."""
        sums = context.get_discrete_state(self._sums).CopyToVector().reshape(NUM_SUMS, self.num_vehicles)
        if not self._command.HasValue(context):
            sums[5:11] = np.nan
        if not self._shortfall.HasValue(context):
            sums[14] = np.nan
        return summarized(sums, context.get_discrete_state(self._crash_time).CopyToVector(), self._period)

    def _watch(self, context: Any, discrete_state: Any) -> None:
        state = self.input_rows(context, self._state)
        reference = self.input_rows(context, self._reference)
        error = [wanted - actual for wanted, actual in zip(reference[:3], state[:3], strict=True)]
        flying = self._flying(state, error, self.input_rows(context, self._wrench))

        time = context.get_time()
        crashed = discrete_state.get_mutable_vector(self._crashed)
        before = self.values(crashed) != 0.0
        if not flying.all():
            crash_time = discrete_state.get_mutable_vector(self._crash_time)
            times = np.where(before | flying, self.values(crash_time), time)
            crash_time.SetFromVector(times)
            crashed.SetFromVector(np.where(before | ~flying, 1.0, 0.0))
        counts = flying & ~before
        if counts.any() and self._window[0] <= time <= self._window[1]:
            self._count(context, discrete_state.get_mutable_vector(self._sums), error, counts)

    def _flying(self, state: Any, error: Any, wrench: Any) -> np.ndarray:
        """The (N,) mask of the vehicles within all limits; NaN is beyond any."""
        roll, pitch = state[3], state[4]
        distance = error[0] * error[0] + error[1] * error[1] + error[2] * error[2]
        total = wrench[0] + wrench[1] + wrench[2] + wrench[3]
        tilt, reach, height = self._limits
        flying = (
            (abs(roll) <= tilt)
            & (abs(pitch) <= tilt)
            & (distance <= reach * reach)
            & (state[2] >= height)
            & (total - total == 0.0)
        )
        return np.atleast_1d(np.asarray(flying, dtype=bool))

    def _count(self, context: Any, vector: Any, error: Any, counts: np.ndarray) -> None:
        command = self._optional(context, self._command, 3)
        shortfall = self._optional(context, self._shortfall, 4)
        saturated = sum(abs(row) for row in shortfall) > _SATURATED
        old = self.rows(self.values(vector))
        new = add_tick(old, error, command, saturated * 1.0)
        if not counts.all():
            new = [np.where(counts, after, before) for before, after in zip(old, new, strict=True)]
        self.write(vector, new)

    def _optional(self, context: Any, port: Any, rows: int) -> Any:
        value = self.EvalVectorInput(context, port.get_index())
        return [0.0] * rows if value is None else self.rows(self.values(value))
