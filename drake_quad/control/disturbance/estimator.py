"""Estimator of a disturbing acceleration, as a Drake system."""

from typing import Annotated, Any, NamedTuple

from drake_quad.control.disturbance.laws import AxisMeasurement, ModelIncrement
from drake_quad.control.disturbance.response import AxisCommand, response_step
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Quantity, Row, State


class EstimatorParameters(NamedTuple):
    """Parameters of a `DisturbanceEstimator`.

    Attributes:
        laws: estimation laws for X, Y and Z, all of the same type, from `drake_quad.control.disturbance.laws`.
        lags: modelled time constants of the responses to feedback and to feed-forward, for X, Y and Z, s.
        limit: largest absolute value of the output on each axis, m/s².
        start: initial position of the vehicle, m.
    """

    laws: tuple[Any, ...]
    lags: tuple[AxisCommand, ...]
    limit: Annotated[Row, Quantity("m/s²")]
    start: PerAxis


ZERO_COMMANDS = (AxisCommand(0.0, 0.0),) * 3
"""Commands on X, Y and Z of a vehicle at rest."""


def initial_memories(parameters: Any) -> tuple[Any, ...]:
    """Return the initial memory of each axis's estimation law, for a vehicle at rest at its initial position."""
    return tuple([law.initial_memory(start) for law, start in zip(parameters.laws, parameters.start, strict=True)])


def measured_on_axes(state: State) -> tuple[AxisMeasurement, ...]:
    """Return the measured position and velocity along X, Y and Z."""
    return AxisMeasurement(state.x, state.v_x), AxisMeasurement(state.y, state.v_y), AxisMeasurement(state.z, state.v_z)


def estimate(
    memory: tuple[Any, ...], measured: tuple[AxisMeasurement, ...], laws: tuple[Any, ...], limit: Row, period: float
) -> tuple[tuple[Any, ...], tuple[Row, ...]]:
    """Correct the state of the disturbance estimator on each axis with a measurement.

    Returns:
        The corrected states, and the saturated disturbances in m/s².
    """
    corrected = tuple(
        [
            law.correct(before, measurement, period)
            for law, before, measurement in zip(laws, memory, measured, strict=True)
        ]
    )
    return corrected, tuple([maximum(minimum(after.disturbance, limit), -limit) for after in corrected])


def predict(
    corrected: tuple[Any, ...],
    modelled_response: tuple[AxisCommand, ...],
    commands: tuple[AxisCommand, ...],
    laws: tuple[Any, ...],
    lags: tuple[AxisCommand, ...],
    period: float,
) -> tuple[tuple[Any, ...], tuple[AxisCommand, ...]]:
    """Predict the state of the law of each axis and the modelled response until the next tick.

    Args:
        corrected: state of each law after the measurement of this tick.
        modelled_response: modelled response of each axis at this tick to earlier commands.
        commands: commands that act on the vehicle from this tick on.
        laws: law of each axis.
        lags: modelled time constants, s.
        period: tick period, s.
    """
    responses = [response_step(*axis, period) for axis in zip(modelled_response, commands, lags, strict=True)]
    memory = [
        law.predict(before, ModelIncrement(velocity, distance), period)
        for law, before, (_, velocity, distance) in zip(laws, corrected, responses, strict=True)
    ]
    return tuple(memory), tuple([after for after, _, _ in responses])


def shift_delay_line(sent: Any, in_transit: tuple[Any, ...]) -> tuple[Any, tuple[Any, ...]]:
    """Return the command that leaves a delay line at a tick, and the new content of the line, latest command first."""
    *others, arrived = (sent, *in_transit)
    return arrived, tuple(others)


def limited_disturbance(
    memory: tuple[Any, ...], measurement: State, parameters: EstimatorParameters, period: float
) -> Acceleration:
    """Return the estimated disturbance at a tick, m/s², saturated at the estimator's limit."""
    _, limited = estimate(memory, measured_on_axes(measurement), parameters.laws, parameters.limit, period)
    return Acceleration(*limited)


def next_memory(
    memory: tuple[Any, ...],
    modelled_response: tuple[AxisCommand, ...],
    in_transit: tuple[tuple[AxisCommand, ...], ...],
    measurement: State,
    command: Acceleration,
    correction: Acceleration,
    feed_forward: Acceleration,
    parameters: EstimatorParameters,
    period: float,
) -> tuple[Any, ...]:
    """Return the states of a `DisturbanceEstimator` at the next tick."""
    corrected, _ = estimate(memory, measured_on_axes(measurement), parameters.laws, parameters.limit, period)
    sent = tuple(
        [
            AxisCommand(total + learned - feed_forward_part, feed_forward_part)
            for total, learned, feed_forward_part in zip(command, correction, feed_forward, strict=True)
        ]
    )
    arrived, next_in_transit = shift_delay_line(sent, in_transit)
    memory, modelled_response = predict(corrected, modelled_response, arrived, parameters.laws, parameters.lags, period)
    return memory, modelled_response, next_in_transit


@fleet_system(float, AutoDiffXd)
class DisturbanceEstimator(FleetSystem):
    """Estimator of the disturbing acceleration d on each axis: v' = a + d.

    .. pydrake_system::

        name: DisturbanceEstimator
        input_ports:
        - measurement
        - acceleration_command
        - correction
        - feed_forward
        output_ports:
        - disturbance

    `disturbance` is d in W, saturated at a limit. It is computed from the `measurement` of this tick and from all
    earlier measurements and commands. a is the modelled response to `acceleration_command` + `correction`: a delay in
    whole ticks, then a lag. The time constant for the `feed_forward` part of the command is separate. `correction` is
    the part of the disturbance that a network has already subtracted from the command, so that the estimate does not
    include it. `correction` and `feed_forward` are zero if not connected. The command is only sampled at the ticks, so
    that it may depend on the disturbance.

    The states are `memory` (memory of the law), `modelled_response` (modelled response) and, if there is a delay,
    `commands_in_transit` (commands in the delay line). The only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period, s.
        delay_ticks: modelled delay from a command to its effect, in whole ticks.
        parameters: laws, time constants and limit.
    """

    def declare(self, *, period: float = 0.02, delay_ticks: int = 0, parameters: EstimatorParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, command = self.input("measurement"), self.input("acceleration_command")
        zero = Acceleration(0.0, 0.0, 0.0)
        correction = self.input("correction", absent=zero)
        feed_forward = self.input("feed_forward", absent=zero)
        parameter = self.parameter("parameters", lambda parameters: parameters)
        memory, modelled_response = (
            self.state("memory", initial_memories),
            self.state("modelled_response", lambda _: ZERO_COMMANDS),
        )
        in_transit = self.state("commands_in_transit", lambda _: (ZERO_COMMANDS,) * delay_ticks) if delay_ticks else ()
        writes = memory, modelled_response, in_transit
        reads = measurement, command, correction, feed_forward, parameter, period
        self.update(period, next_memory, *writes, *reads, writes=writes)
        self.output("disturbance", limited_disturbance, memory, measurement, parameter, period)
