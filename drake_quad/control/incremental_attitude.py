"""Attitude control by incremental nonlinear dynamic inversion: from the attitude error to a torque."""

import operator
from typing import Any, NamedTuple

from drake_quad.control.attitude import AttitudeParameters, attitude_inputs, pd_angular_acceleration
from drake_quad.control.disturbance.estimator import ZERO_COMMANDS, estimate, predict, shift_delay_line
from drake_quad.control.disturbance.laws import AxisMeasurement, IncrementalLaw
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.kinematics import euler_torque
from drake_quad.signals import AngularAcceleration, Attitude, BodyAccelerationB, BodyRates, Row, State, Time, Torque


class IncrementalAttitudeParameters(NamedTuple):
    """Parameters of an `IncrementalAttitudeController`.

    Attributes:
        attitude: gains and inertia.
        law: filter of the measured and the modelled angular accelerations.
        lag: modelled time constant from a torque command to the angular acceleration.
        limit: largest angular acceleration that is compensated on each axis.
    """

    attitude: AttitudeParameters
    law: IncrementalLaw
    lag: Time
    limit: BodyAccelerationB


def _corrected_command(memory: tuple[Any, ...], *arguments: Any) -> tuple[tuple[Any, ...], AngularAcceleration]:
    """Return the memory corrected by the measurement, and the commanded angular acceleration α_c - d.

    The arguments are as in `incremental_torque`.
    """
    measurement, attitude, rates, acceleration, parameters, period = arguments
    gains = parameters.attitude
    # The law differentiates only the body rates and does not use the angles.
    measured = tuple([AxisMeasurement(0.0, rate) for rate in (measurement.p, measurement.q, measurement.r)])
    corrected, disturbance = estimate(memory, measured, (parameters.law,) * 3, parameters.limit, period)
    total = pd_angular_acceleration(measurement, attitude, rates, acceleration, gains.k_p, gains.k_d)
    return corrected, AngularAcceleration._make(map(operator.sub, total, disturbance))


def incremental_torque(
    memory: tuple[Any, ...],
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    parameters: IncrementalAttitudeParameters,
    period: float,
) -> Torque:
    """Return the torque of an `IncrementalAttitudeController`.

    Args:
        memory: memory of the law on each axis.
        measurement: measured state of the vehicle.
        attitude: commanded attitude.
        rates: commanded body rates.
        acceleration: commanded angular acceleration.
        parameters: gains, inertia and filter.
        period: tick period, s.
    """
    _, commanded = _corrected_command(memory, measurement, attitude, rates, acceleration, parameters, period)
    _, _, *inertia = parameters.attitude
    return euler_torque(commanded, rates, *inertia)


def next_incremental_memory(
    memory: tuple[Any, ...],
    modelled_response: tuple[AxisCommand, ...],
    in_transit: tuple[tuple[Row, ...], ...],
    *arguments: Any,
) -> Any:
    """Return the next states: memory of the law, modelled response and, with a delay, commands in transit."""
    *_, parameters, period = arguments
    corrected, commanded = _corrected_command(memory, *arguments)
    arrived, next_in_transit = shift_delay_line(tuple(commanded), in_transit)
    commands = tuple([AxisCommand(each, 0.0) for each in arrived])
    lags = (AxisCommand(parameters.lag, parameters.lag),) * 3
    after, modelled_response = predict(corrected, modelled_response, commands, (parameters.law,) * 3, lags, period)
    return after, modelled_response, next_in_transit


@fleet_system(float, AutoDiffXd)
class IncrementalAttitudeController(FleetSystem):
    """Incremental nonlinear dynamic inversion (INDI) of the attitude: τ = I (α_c - d) + ω_r × I ω_r in B.

    .. pydrake_system::

        name: IncrementalAttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    α_c = k_P e + k_D ė + ω̇_r is the angular acceleration that an `AttitudeController` commands for the same inputs.
    d = H (ω̇ - α) is the angular acceleration that the model does not explain, saturated on each axis. ω̇ is the
    derivative of the measured body rates, and H is the filter of an `IncrementalLaw`. The angular acceleration α is
    modelled, since rotor speeds are not measured: it follows the command α_c - d with a delay in whole ticks and the
    lag of the rotors. The gyroscopic torque of the commanded body rates ω_r is a feed-forward and not part of the
    model. With τ_f = I H α and ω̇_f = H ω̇ the torque without this feed-forward is τ_f + I (α_c - ω̇_f), as in E. J. J.
    Smeur, Q. P. Chu and G. C. H. E. de Croon, "Adaptive incremental nonlinear dynamic inversion for attitude control of
    micro air vehicles", JGCD 39, 2016.

    The states are `memory` (memory of the law), `modelled_response` (modelled response) and, if there is a delay,
    `commands_in_transit` (commands in the delay line). The only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period, s.
        delay_ticks: modelled delay from a torque command to its effect, in whole ticks.
        parameters: gains, inertia and filter.
    """

    def declare(self, *, period: float = 0.02, delay_ticks: int = 0, parameters: IncrementalAttitudeParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, attitude, rates, acceleration, parameter = attitude_inputs(self)
        memory = self.state("memory", lambda parameters: (parameters.law.initial_memory(0.0),) * 3)
        modelled_response = self.state("modelled_response", lambda _: ZERO_COMMANDS)
        in_transit = self.state("commands_in_transit", lambda _: ((0.0,) * 3,) * delay_ticks) if delay_ticks else ()
        reads = measurement, attitude, rates, acceleration, parameter, period
        writes = memory, modelled_response, in_transit
        self.update(period, next_incremental_memory, *writes, *reads, writes=writes)
        self.output("torque", incremental_torque, memory, *reads)
