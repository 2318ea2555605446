"""What an autopilot on board makes of an attitude target.

The structure is that of PX4: a proportional law turns the attitude error into body rates, and a loop of the body rates,
on a gyroscope, turns these into torques (PX4 User Guide, "Controller diagrams: multicopter attitude and angular rate
controller", docs.px4.io; L. Meier, D. Honegger and M. Pollefeys, "PX4: a node-based multithreaded open source robotics
framework for deeply embedded platforms", ICRA 2015). PX4 takes the attitude error from quaternions and has an integral
and a derivative in its rate loop; here errors are those of roll, pitch and yaw, and the rate loop is proportional.
"""

from typing import NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import wrapped
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Angle, Attitude, AttitudeTarget, BodyRateB, BodyRates, Gain, Number, State, Wrench
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.runge_kutta import moved


class LoopGains(NamedTuple):
    """Gains about each axis."""

    roll: Gain
    pitch: Gain
    yaw: Gain


class Gyroscope(NamedTuple):
    """By how much a gyroscope is wrong.

    Attributes:
        noise: standard deviation of a sample, on each axis.
        bias: that it always shows.
    """

    noise: BodyRateB = 0.0
    bias: BodyRates = BodyRates(0.0, 0.0, 0.0)


class AutopilotNumbers(NamedTuple):
    """Gains and senses of an autopilot, and what it believes of the vehicle.

    Attributes:
        k_attitude: body rate over attitude error.
        k_rate: angular acceleration over error of the body rate.
        inertia: believed.
        gyroscope: its errors.
        attitude_noise: standard deviation of the estimates of roll, pitch and yaw.
        initial: the wrench that is out before the first is computed.
    """

    k_attitude: LoopGains
    k_rate: LoopGains
    inertia: Inertia = Inertia()
    gyroscope: Gyroscope = Gyroscope()
    attitude_noise: Angle = 0.0
    initial: Wrench = Wrench(0.0, 0.0, 0.0, 0.0)


class SensorNoise(NamedTuple):
    """Normal numbers for the noise of gyroscope and attitude."""

    rates: tuple[Number, Number, Number]
    attitude: tuple[Number, Number, Number]


def sensed(state: State, noise: SensorNoise | None, numbers: AutopilotNumbers) -> tuple[Attitude, BodyRates]:
    """Attitude and body rates as the autopilot has them.

    Args:
        state: of the vehicle.
        noise: None if there is none.
        numbers: of the autopilot.
    """
    bias = numbers.gyroscope.bias
    attitude = Attitude(state.roll, state.pitch, state.yaw)
    rates = BodyRates(state.p + bias.p, state.q + bias.q, state.r + bias.r)
    if noise is None:
        return attitude, rates
    turning, leaning = numbers.gyroscope.noise, numbers.attitude_noise
    return moved(attitude, noise.attitude, leaning), moved(rates, noise.rates, turning)


def autopilot_law(target: AttitudeTarget, state: State, noise: SensorNoise | None, numbers: AutopilotNumbers) -> Wrench:
    """The wrench of an `AttitudeAutopilot`.

    Args:
        target: that came over the link.
        state: of the vehicle.
        noise: of the senses; None if there is none.
        numbers: of the autopilot.
    """
    k_attitude, k_rate, (i_xx, i_yy, i_zz), *_ = numbers
    attitude, (p, q, r) = sensed(state, noise, numbers)
    p_r = target.p + k_attitude.roll * (target.roll - attitude.roll)
    q_r = target.q + k_attitude.pitch * (target.pitch - attitude.pitch)
    r_r = target.r + k_attitude.yaw * wrapped(target.yaw - attitude.yaw)
    return Wrench(
        target.thrust,
        i_xx * (k_rate.roll * (p_r - p)) + (i_zz - i_yy) * q * r,
        i_yy * (k_rate.pitch * (q_r - q)) + (i_xx - i_zz) * p * r,
        i_zz * (k_rate.yaw * (r_r - r)) + (i_yy - i_xx) * p * q,
    )


@fleet_system(float, AutoDiffXd)
class AttitudeAutopilot(FleetSystem):
    """Attitude and rate loop on board: τ = I k_rate (ω_r + k_attitude e - ω) + ω × I ω in B.

    .. pydrake_system::

        name: AttitudeAutopilot
        input_ports:
        - attitude_target
        - state
        - sensor_noise
        output_ports:
        - wrench

    e is the attitude of the `attitude_target` minus the vehicle's, the yaw error wrapped to half a turn; ω_r are the
    body rates of the target, and ω those of the gyroscope. The thrust is that of the target. The autopilot is on board:
    it takes the `state` of its own instant, and holds the `wrench` until its next:

        state, target ●━━━━━○
                      ●━━━━━○ wrench
                      0     h

    A target that arrives at one of its instants is seen at the next. `sensor_noise` is random: normal numbers for
    gyroscope and attitude. The port is there if there is noise.

    The state is `wrench`; the only parameter of the context is `autopilot`.

    Args:
        num_vehicles: N.
        period: h, s. 2.5 ms by default, as the 400 Hz of PX4's parameter IMU_GYRO_RATEMAX.
        noisy: whether there is noise.
        numbers: gains, senses, and what is believed of the vehicle.
    """

    def declare(self, *, period: float = 0.0025, noisy: bool = False, numbers: AutopilotNumbers) -> None:
        """Declares the system."""
        parameter = self.parameter("autopilot", lambda numbers: numbers)
        target, state = self.input("attitude_target"), self.input("state")
        noise = None
        if noisy:
            noise = self.random_input("sensor_noise", SensorNoise, RandomDistribution.kGaussian, period=period)
        wrench = self.state("wrench", lambda numbers: numbers.initial)
        self.update(period, autopilot_law, target, state, noise, parameter, writes=[wrench])
        self.state_output(wrench)


def thrust_alone(target: AttitudeTarget) -> Wrench:
    """The thrust of an attitude target, without torques."""
    return Wrench(target.thrust, 0.0, 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class ThrustAlone(FleetSystem):
    """The thrust of an attitude target, which the rotors give evenly: for a vehicle whose attitude follows by itself.

    .. pydrake_system::

        name: ThrustAlone
        input_ports:
        - attitude_target
        output_ports:
        - wrench

    The torques of the `wrench` are zero.

    Args:
        num_vehicles: N.
    """

    def declare(self) -> None:
        """Declares the system."""
        self.output("wrench", thrust_alone, self.input("attitude_target"))
