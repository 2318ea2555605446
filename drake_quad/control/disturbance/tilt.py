"""Estimator of a disturbing acceleration from the measured direction of the thrust."""

from typing import Annotated, Any, NamedTuple

from drake_quad.control.disturbance.estimator import estimate, initial_memories, measured_on_axes, shift_delay_line
from drake_quad.control.disturbance.laws import ModelIncrement
from drake_quad.control.disturbance.response import lag_step
from drake_quad.framework.elementary import sqrt
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Quantity, Row, State, Time

_Specific = Annotated[Row, Quantity("m/s²")]


class TiltEstimatorParameters(NamedTuple):
    """Parameters of a `TiltDisturbanceEstimator`.

    Attributes:
        laws: estimation laws for X, Y and Z, all of the same type, from `drake_quad.control.disturbance.laws`.
        lag: modelled time constant of the thrust, s.
        gravity: g of the nominal model, m/s².
        limit: largest absolute value of the output on each axis, m/s².
        start: initial position of the vehicle, m.
    """

    laws: tuple[Any, ...]
    lag: Time
    gravity: _Specific
    limit: _Specific
    start: PerAxis


class KnownAccelerations(NamedTuple):
    """Accelerations at a tick that are not part of the estimated disturbance.

    Attributes:
        thrust_and_weight: acceleration due to thrust and weight, which depends on the tilt.
        learned: disturbance that a network has learned; it acts from this tick to the next.
    """

    thrust_and_weight: Acceleration
    learned: Acceleration


class SpecificThrust(NamedTuple):
    """Thrust divided by mass, F / m."""

    thrust: _Specific


def tilted_acceleration(measurement: State, thrust: SpecificThrust, gravity: Row) -> Acceleration:
    """Return the acceleration (F / m) z_B - g due to thrust and weight, with the measured z_B."""
    x, y, z = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw).z
    return Acceleration(thrust.thrust * x, thrust.thrust * y, thrust.thrust * z - gravity)


def estimate_by_tilt(
    memory: tuple[Any, ...],
    known_accelerations: KnownAccelerations,
    thrust: SpecificThrust,
    measurement: State,
    parameters: TiltEstimatorParameters,
    period: float,
) -> tuple[tuple[Any, ...], tuple[Row, ...], Acceleration]:
    """Return memory and disturbance on each axis after the measurement, and the acceleration due to thrust and weight.

    Args:
        memory: memory of each axis after the previous tick.
        known_accelerations: known accelerations at the previous tick.
        thrust: modelled thrust divided by mass at this tick.
        measurement: measured state of the vehicle.
        parameters: parameters of the estimator.
        period: tick period, s.
    """
    thrust_and_weight = tilted_acceleration(measurement, thrust, parameters.gravity)
    # The acceleration due to thrust and weight is assumed to be linear in time between two ticks.
    predicted = tuple(
        [
            law.predict(
                corrected,
                ModelIncrement(
                    period * (0.5 * (first + last) + learned),
                    period * period * (first / 3.0 + last / 6.0 + 0.5 * learned),
                ),
                period,
            )
            for law, corrected, first, last, learned in zip(
                parameters.laws,
                memory,
                known_accelerations.thrust_and_weight,
                thrust_and_weight,
                known_accelerations.learned,
                strict=True,
            )
        ]
    )
    corrected, limited = estimate(predicted, measured_on_axes(measurement), parameters.laws, parameters.limit, period)
    return corrected, limited, thrust_and_weight


def disturbance_by_tilt(*arguments: Any) -> Acceleration:
    """Return the estimated disturbance; the arguments are as in `estimate_by_tilt`."""
    _, limited, _ = estimate_by_tilt(*arguments)
    return Acceleration(*limited)


def next_tilt_states(
    memory: tuple[Any, ...],
    known_accelerations: KnownAccelerations,
    thrust: SpecificThrust,
    in_transit: tuple[SpecificThrust, ...],
    measurement: State,
    command: Acceleration,
    learned: Acceleration,
    parameters: TiltEstimatorParameters,
    period: float,
) -> Any:
    """Return the states of a `TiltDisturbanceEstimator` at the next tick."""
    corrected, _, thrust_and_weight = estimate_by_tilt(
        memory, known_accelerations, thrust, measurement, parameters, period
    )
    up = command.z + parameters.gravity
    sent = SpecificThrust(sqrt(command.x * command.x + command.y * command.y + up * up))
    arrived, next_in_transit = shift_delay_line(sent, in_transit)
    after = SpecificThrust(lag_step(thrust.thrust, arrived.thrust, parameters.lag, period).after)
    return corrected, KnownAccelerations(thrust_and_weight, learned), after, next_in_transit


@fleet_system(float, AutoDiffXd)
class TiltDisturbanceEstimator(FleetSystem):
    """Estimator of the acceleration d that is not due to thrust or weight: v' = (F / m) z_B - g + d.

    .. pydrake_system::

        name: TiltDisturbanceEstimator
        input_ports:
        - measurement
        - acceleration_command
        - learned_disturbance
        output_ports:
        - disturbance

    `disturbance` is d in W, saturated at a limit. It is computed from the `measurement` of this tick and from all
    earlier measurements and commands. The direction z_B of the thrust is measured, as in the papers on L1 and
    Neural-Fly, so that the estimator needs no model of the attitude loop. The magnitude of the thrust is modelled: F /
    m follows the norm of `acceleration_command` + g with a delay in whole ticks and a lag. `learned_disturbance` is the
    part of the disturbance that a network already compensates, so that the estimate does not include it; it is zero if
    not connected. These two inputs are only sampled at the ticks, so that the command may depend on the disturbance.

    The states are `memory` (memory of the law after the previous tick), `known_accelerations` (known accelerations at
    the previous tick), `thrust` and, if there is a delay, `thrust_in_transit` (commands in the delay line). The only
    parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period, s.
        delay_ticks: modelled delay from a commanded thrust to its effect, in whole ticks.
        parameters: laws, time constant, g and limit.
    """

    def declare(self, *, period: float = 0.02, delay_ticks: int = 0, parameters: TiltEstimatorParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, command = self.input("measurement"), self.input("acceleration_command")
        zero = Acceleration(0.0, 0.0, 0.0)
        learned = self.input("learned_disturbance", absent=zero)
        parameter = self.parameter("parameters", lambda parameters: parameters)
        memory = self.state("memory", initial_memories)
        known_accelerations = self.state("known_accelerations", lambda _: KnownAccelerations(zero, zero))
        thrust = self.state("thrust", _hover)
        in_transit: Any = ()
        if delay_ticks:
            in_transit = self.state("thrust_in_transit", lambda parameters: (_hover(parameters),) * delay_ticks)
        writes = memory, known_accelerations, thrust, in_transit
        reads = measurement, command, learned, parameter, period
        self.update(period, next_tilt_states, *writes, *reads, writes=writes)
        self.output(
            "disturbance", disturbance_by_tilt, memory, known_accelerations, thrust, measurement, parameter, period
        )


def _hover(parameters: TiltEstimatorParameters) -> SpecificThrust:
    return SpecificThrust(parameters.gravity)
