"""The estimator of a disturbing acceleration that sees by the tilt where the thrust points."""

from typing import Annotated, Any, NamedTuple

from drake_quad.control.disturbance.estimator import estimate, measured_on_axes, memory_at_rest, waited
from drake_quad.control.disturbance.laws import Gained
from drake_quad.control.disturbance.response import lagging
from drake_quad.framework.elementary import sqrt
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Quantity, Row, State, Time

_Specific = Annotated[Row, Quantity("m/s²")]


class TiltEstimatorNumbers(NamedTuple):
    """What a `TiltDisturbanceEstimator` goes by.

    Attributes:
        laws: records of one kind from `drake_quad.control.disturbance.laws`, on X, Y and Z.
        lag: of the thrust.
        gravity: g, believed.
        limit: largest disturbance that is shown on an axis.
        start: where the vehicle is at the beginning, m.
    """

    laws: tuple[Any, ...]
    lag: Time
    gravity: _Specific
    limit: _Specific
    start: PerAxis = PerAxis(0.0, 0.0, 0.0)


class Pushed(NamedTuple):
    """What is known of the accelerations at a tick.

    Attributes:
        tilted: by thrust and weight.
        learned: what disturbs the vehicle from then on, as far as a network has learned it.
    """

    tilted: Acceleration
    learned: Acceleration


class SpecificThrust(NamedTuple):
    """Thrust over mass, F / m."""

    thrust: _Specific


def tilted_acceleration(measurement: State, thrust: SpecificThrust, gravity: Row) -> Acceleration:
    """The acceleration by thrust and weight, (F / m) z_B - g, with z_B as it is measured."""
    x, y, z = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw).z
    return Acceleration(thrust.thrust * x, thrust.thrust * y, thrust.thrust * z - gravity)


def known_by_tilt(
    memory: tuple[Any, ...],
    before: Pushed,
    thrust: SpecificThrust,
    measurement: State,
    numbers: TiltEstimatorNumbers,
    period: float,
) -> tuple[tuple[Any, ...], tuple[Row, ...], Acceleration]:
    """The memory of each axis after what is measured at a tick, the disturbance, and the acceleration by tilt there.

    Args:
        memory: of each axis, after the tick before.
        before: accelerations at the tick before.
        thrust: at this tick.
        measurement: of the vehicle's state.
        numbers: to estimate by.
        period: of the ticks, s.
    """
    tilted = tilted_acceleration(measurement, thrust, numbers.gravity)
    # Between two ticks the acceleration is taken for a straight line.
    predicted = tuple(
        [
            law.predicted(
                known,
                Gained(
                    period * (0.5 * (first + last) + learned),
                    period * period * (first / 3.0 + last / 6.0 + 0.5 * learned),
                ),
                period,
            )
            for law, known, first, last, learned in zip(
                numbers.laws, memory, before.tilted, tilted, before.learned, strict=True
            )
        ]
    )
    known, shown = estimate(predicted, measured_on_axes(measurement), numbers.laws, numbers.limit, period)
    return known, shown, tilted


def shown_by_tilt(*arguments: Any) -> Acceleration:
    """The disturbance; arguments as for `known_by_tilt`."""
    _, shown, _ = known_by_tilt(*arguments)
    return Acceleration(*shown)


def next_by_tilt(
    memory: tuple[Any, ...],
    before: Pushed,
    thrust: SpecificThrust,
    under_way: tuple[SpecificThrust, ...],
    measurement: State,
    command: Acceleration,
    learned: Acceleration,
    numbers: TiltEstimatorNumbers,
    period: float,
) -> Any:
    """What the states of a `TiltDisturbanceEstimator` hold a tick later."""
    known, _, tilted = known_by_tilt(memory, before, thrust, measurement, numbers, period)
    up = command.z + numbers.gravity
    sent = SpecificThrust(sqrt(command.x * command.x + command.y * command.y + up * up))
    arrived, on_the_way = waited(sent, under_way)
    after = SpecificThrust(lagging(thrust.thrust, arrived.thrust, numbers.lag, period).after)
    return known, Pushed(tilted, learned), after, on_the_way


@fleet_system(float, AutoDiffXd)
class TiltDisturbanceEstimator(FleetSystem):
    """Estimates the acceleration that neither thrust nor weight causes: v' = (F / m) z_B - g + d.

    .. pydrake_system::

        name: TiltDisturbanceEstimator
        input_ports:
        - measurement
        - acceleration_command
        - learned_disturbance
        output_ports:
        - disturbance

    `disturbance` is d in W, within a limit, from the `measurement` of this tick and all that was measured and commanded
    before. z_B, where the thrust points, is measured, as in the papers on L1 and Neural-Fly, so that the model does not
    wait for the attitude loop; the thrust is believed to follow the length of `acceleration_command` + g after whole
    ticks of delay with a lag. `learned_disturbance`, which a network takes away, is no longer the estimator's; it is
    zero if not connected.
    Both are read at the ticks only, so that the command may depend on the disturbance.

    The states are `memory`, that of the law after the tick before, `before`, the accelerations there, `thrust`, and
    `thrust_under_way`, if there is a delay; the only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        delay_ticks: whole ticks from a commanded thrust to what it does, believed.
        numbers: to estimate by.
    """

    def declare(self, *, period: float = 0.02, delay_ticks: int = 0, numbers: TiltEstimatorNumbers) -> None:
        """Declares the system."""
        measurement, command = self.input("measurement"), self.input("acceleration_command")
        nothing = Acceleration(0.0, 0.0, 0.0)
        learned = self.input("learned_disturbance", absent=nothing)
        parameter = self.parameter("numbers", lambda numbers: numbers)
        memory = self.state("memory", memory_at_rest)
        before = self.state("before", lambda _: Pushed(nothing, nothing))
        thrust = self.state("thrust", _hover)
        under_way: Any = ()
        if delay_ticks:
            under_way = self.state("thrust_under_way", lambda numbers: (_hover(numbers),) * delay_ticks)
        writes = memory, before, thrust, under_way
        reads = measurement, command, learned, parameter, period
        self.update(period, next_by_tilt, *writes, *reads, writes=writes)
        self.output("disturbance", shown_by_tilt, memory, before, thrust, measurement, parameter, period)


def _hover(numbers: TiltEstimatorNumbers) -> SpecificThrust:
    return SpecificThrust(numbers.gravity)
