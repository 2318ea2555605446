"""The estimator of a disturbing acceleration as a Drake system."""

from typing import Annotated, Any, NamedTuple

from drake_quad.control.disturbance.laws import Gained, Measured
from drake_quad.control.disturbance.response import AxisCommand, responded
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Quantity, Row, State


class EstimatorNumbers(NamedTuple):
    """What an estimator goes by.

    Attributes:
        laws: records of one kind from `drake_quad.control.disturbance.laws`, on X, Y and Z.
        lags: of what follows the command, on X, Y and Z, s.
        limit: largest disturbance that is shown on an axis.
        start: where the vehicle is at the beginning, m.
    """

    laws: tuple[Any, ...]
    lags: tuple[AxisCommand, ...]
    limit: Annotated[Row, Quantity("m/s²")]
    start: PerAxis = PerAxis(0.0, 0.0, 0.0)


STILL = (AxisCommand(0.0, 0.0),) * 3
"""The commands on three axes of a vehicle at rest."""


def memory_at_rest(numbers: Any) -> tuple[Any, ...]:
    """The memory of each axis of an estimator with these numbers, for a vehicle that rests where it begins."""
    return tuple([law.at_rest(start) for law, start in zip(numbers.laws, numbers.start, strict=True)])


def measured_on_axes(state: State) -> tuple[Measured, ...]:
    """Position and velocity on X, Y and Z."""
    return Measured(state.x, state.v_x), Measured(state.y, state.v_y), Measured(state.z, state.v_z)


def estimate(
    memory: tuple[Any, ...], measured: tuple[Measured, ...], laws: tuple[Any, ...], limit: Row, period: float
) -> tuple[tuple[Any, ...], tuple[Row, ...]]:
    """The memory of each axis after what is measured at a tick, and its disturbance within a limit."""
    known = tuple(
        [law.corrected(before, seen, period) for law, before, seen in zip(laws, memory, measured, strict=True)]
    )
    return known, tuple([maximum(minimum(after.disturbance, limit), -limit) for after in known])


def predict(
    known: tuple[Any, ...],
    following: tuple[AxisCommand, ...],
    commands: tuple[AxisCommand, ...],
    laws: tuple[Any, ...],
    lags: tuple[AxisCommand, ...],
    period: float,
) -> tuple[tuple[Any, ...], tuple[AxisCommand, ...]]:
    """The memory of each axis at the next tick, and how the vehicle follows its command there.

    Args:
        known: memory after what was measured.
        following: how the vehicle follows its commands at the tick.
        commands: that are there at the tick.
        laws: of each axis.
        lags: s.
        period: of the ticks, s.
    """
    moved = [responded(*axis, period) for axis in zip(following, commands, lags, strict=True)]
    memory = [
        law.predicted(before, Gained(velocity, distance), period)
        for law, before, (_, velocity, distance) in zip(laws, known, moved, strict=True)
    ]
    return tuple(memory), tuple([after for after, _, _ in moved])


def waited(sent: Any, under_way: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    """What arrives of what is sent at each tick, and what is under way then, the newest first."""
    *others, arrived = (sent, *under_way)
    return arrived, tuple(others)


def shown_disturbance(
    memory: tuple[Any, ...], measurement: State, numbers: EstimatorNumbers, period: float
) -> Acceleration:
    """The disturbance from what is known and what is measured at a tick, m/s²."""
    _, shown = estimate(memory, measured_on_axes(measurement), numbers.laws, numbers.limit, period)
    return Acceleration(*shown)


def next_memory(
    memory: tuple[Any, ...],
    following: tuple[AxisCommand, ...],
    under_way: tuple[tuple[AxisCommand, ...], ...],
    measurement: State,
    command: Acceleration,
    correction: Acceleration,
    feed_forward: Acceleration,
    numbers: EstimatorNumbers,
    period: float,
) -> tuple[Any, ...]:
    """What the states of a `DisturbanceEstimator` hold a tick later."""
    known, _ = estimate(memory, measured_on_axes(measurement), numbers.laws, numbers.limit, period)
    sent = tuple(
        [
            AxisCommand(whole + learned - known_before, known_before)
            for whole, learned, known_before in zip(command, correction, feed_forward, strict=True)
        ]
    )
    arrived, on_the_way = waited(sent, under_way)
    memory, following = predict(known, following, arrived, numbers.laws, numbers.lags, period)
    return memory, following, on_the_way


@fleet_system(float, AutoDiffXd)
class DisturbanceEstimator(FleetSystem):
    """Estimates the acceleration that is not commanded: v' = a + d.

    .. pydrake_system::

        name: DisturbanceEstimator
        input_ports:
        - measurement
        - acceleration_command
        - correction
        - feed_forward
        output_ports:
        - disturbance

    `disturbance` is d in W, within a limit, from the `measurement` of this tick and all that was measured and commanded
    before. a is how the vehicle is believed to follow `acceleration_command` + `correction`, which a network takes away
    and which is no longer the estimator's: whole ticks of delay, then a lag, with a time constant of its own for what
    of it is `feed_forward`. Both are zero if not connected. The command is read at the ticks only, so that it may
    depend on the disturbance.

    The states are `memory`, that of the law, `following`, how the command is followed, and `commands_under_way`, if
    there is a delay; the only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        delay_ticks: whole ticks from a command to what it does, believed.
        numbers: to estimate by.
    """

    def declare(self, *, period: float = 0.02, delay_ticks: int = 0, numbers: EstimatorNumbers) -> None:
        """Declares the system."""
        measurement, command = self.input("measurement"), self.input("acceleration_command")
        nothing = Acceleration(0.0, 0.0, 0.0)
        correction = self.input("correction", absent=nothing)
        feed_forward = self.input("feed_forward", absent=nothing)
        parameter = self.parameter("numbers", lambda numbers: numbers)
        memory, following = self.state("memory", memory_at_rest), self.state("following", lambda _: STILL)
        under_way = self.state("commands_under_way", lambda _: (STILL,) * delay_ticks) if delay_ticks else ()
        writes = memory, following, under_way
        reads = measurement, command, correction, feed_forward, parameter, period
        self.update(period, next_memory, *writes, *reads, writes=writes)
        self.output("disturbance", shown_disturbance, memory, measurement, parameter, period)
