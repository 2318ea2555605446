"""Attitude control on board: from an attitude target to a wrench.

An attitude loop converts the attitude error to commanded body rates. A rate loop converts the difference between these
commands and the rates that a gyroscope measures to torques. Both loops are proportional, and both can be extended by
the terms of `drake_quad.pid.loop`. The extended loops reproduce the loops of PX4 (PX4 User Guide, "Controller diagrams:
multicopter attitude and angular rate controller", docs.px4.io; D. Brescianini, M. Hehn and R. D'Andrea, "Nonlinear
quadrocopter attitude control", ETH Zurich 2013) or of the Crazyflie's firmware (Bitcraze, crazyflie-firmware 2025.12,
`attitude_pid_controller.c`):

    attitude    errors of roll, pitch and yaw (Crazyflie), or a rotation error with reduced weight of the yaw (PX4)
    rate        PID with integral, filtered derivative, feed-forward and limits
"""

from typing import Annotated, NamedTuple

from pydrake.common import RandomDistribution

from drake_quad.framework.elementary import arctan2, exp, sin_cos, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.axes import TINY, Vector
from drake_quad.geometry.flatness import in_heading
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.pid.filters import EMPTY_FILTER, FilterState, LowPass, filter_step
from drake_quad.pid.loop import Memory, Terms, pid, saturate
from drake_quad.signals import (
    Angle,
    Attitude,
    AttitudeTarget,
    BodyRateB,
    BodyRates,
    Gain,
    Number,
    Quantity,
    Row,
    State,
    Time,
    Wrench,
)
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.runge_kutta import euler_step


class LoopGains(NamedTuple):
    """Proportional gain of a control loop for each axis."""

    roll: Gain
    pitch: Gain
    yaw: Gain


class Gyroscope(NamedTuple):
    """Errors of a gyroscope.

    Attributes:
        noise: standard deviation of the noise of a sample on each axis.
        bias: constant error of the measured body rates.
    """

    noise: BodyRateB = 0.0
    bias: BodyRates = BodyRates(0.0, 0.0, 0.0)


class NeglectedDrag(NamedTuple):
    """Drag that an attitude estimator neglects.

    A vehicle that flies at constant velocity leans forward, so that its thrust balances the drag. An estimator whose
    model contains no drag underestimates this tilt. At velocity v, its error is the angle d v / g once the correction
    of the attitude by position measurements has settled. This correction has a first-order lag.

    Attributes:
        tilt_per_speed: ratio d / g of the tilt error to the velocity.
        time: time constant of the correction.
    """

    tilt_per_speed: Annotated[Row, Quantity("rad s/m")]
    time: Time


class LeanError(NamedTuple):
    """Error of the estimated thrust direction along X and Y of W."""

    x: Angle
    y: Angle


class LoopAxisTerms(NamedTuple):
    """Terms of a loop for each axis, in addition to the proportional term."""

    roll: Terms
    pitch: Terms
    yaw: Terms


class AutopilotParameters(NamedTuple):
    """Parameters of an autopilot and of its sensors; None for an optional part that the autopilot does not contain.

    Attributes:
        k_attitude: gains of the attitude loop, from attitude error to body rate.
        k_rate: gains of the rate loop, from body rate error to angular acceleration.
        inertia: moments of inertia in the autopilot's model of the vehicle.
        gyroscope: errors of the gyroscope.
        attitude_noise: standard deviation of the noise of the estimated roll, pitch and yaw.
        initial: wrench that is output before the first wrench is computed.
        attitude: further terms of the attitude loop, whose output is a body rate.
        rate: further terms of the rate loop, whose output is an angular acceleration.
        gyroscope_filter: low-pass filter of the measured body rates.
        max_rates: largest commanded body rates.
        yaw_weight: weight of the yaw in the rotation error; None if the loop uses the errors of roll, pitch and yaw.
        neglected_drag: drag that the attitude estimator neglects; None if the estimator is exact.
    """

    k_attitude: LoopGains
    k_rate: LoopGains
    inertia: Inertia = Inertia()
    gyroscope: Gyroscope = Gyroscope()
    attitude_noise: Angle = 0.0
    initial: Wrench = Wrench(0.0, 0.0, 0.0, 0.0)
    attitude: LoopAxisTerms | None = None
    rate: LoopAxisTerms | None = None
    gyroscope_filter: LowPass | None = None
    max_rates: BodyRates | None = None
    yaw_weight: Number | None = None
    neglected_drag: NeglectedDrag | None = None


class LoopRules(NamedTuple):
    """Variants of the attitude loop and of the rate loop.

    Attributes:
        gyroscopic: True if the gyroscopic torque ω × I ω is added.
        attitude_integrates_first: True if the integral of the attitude loop includes the error of the current tick.
        rate_integrates_first: True if the integral of the rate loop includes the error of the current tick.
    """

    gyroscopic: bool = True
    attitude_integrates_first: bool = False
    rate_integrates_first: bool = False


class LoopMemory(NamedTuple):
    """Internal state of a control loop for each axis, such as the value of its integral."""

    roll: Memory
    pitch: Memory
    yaw: Memory

    @classmethod
    def of(cls, terms: LoopAxisTerms | None) -> "LoopMemory":
        """Return the internal state before the first tick."""
        return cls(*[Memory.of(each) for each in terms or (None, None, None)])


class AutopilotMemory(NamedTuple):
    """State of an autopilot, except for its wrench.

    Attributes:
        attitude: internal state of the attitude loop.
        rate: internal state of the rate loop.
        gyroscope: states of the filters of p, q and r; None if there is no filter.
        lean: error of the estimated thrust direction; None if the estimator is exact.
    """

    attitude: LoopMemory
    rate: LoopMemory
    gyroscope: tuple[FilterState, FilterState, FilterState] | None
    lean: LeanError | None

    @classmethod
    def of(cls, parameters: AutopilotParameters) -> "AutopilotMemory":
        """Return the internal state before the first tick."""
        gyroscope = None if parameters.gyroscope_filter is None else (EMPTY_FILTER, EMPTY_FILTER, EMPTY_FILTER)
        lean = None if parameters.neglected_drag is None else LeanError(0.0, 0.0)
        return cls(LoopMemory.of(parameters.attitude), LoopMemory.of(parameters.rate), gyroscope, lean)


class SensorNoise(NamedTuple):
    """Standard normal samples for the noise of the gyroscope and of the estimated attitude."""

    rates: tuple[Number, Number, Number]
    attitude: tuple[Number, Number, Number]


def estimated_attitude_and_rates(
    state: State, noise: SensorNoise | None, parameters: AutopilotParameters, lean: LeanError | None = None
) -> tuple[Attitude, BodyRates]:
    """Return the autopilot's estimates of attitude and body rates.

    Args:
        state: true state of the vehicle.
        noise: standard normal samples; None if there is no noise.
        parameters: parameters of the autopilot.
        lean: error of the estimated thrust direction; None if the estimator is exact.
    """
    bias = parameters.gyroscope.bias
    attitude = Attitude(state.roll, state.pitch, state.yaw)
    rates = BodyRates(state.p + bias.p, state.q + bias.q, state.r + bias.r)
    if lean is not None:
        forward, left, _ = in_heading(Vector(lean.x, lean.y, 0.0), *sin_cos(state.yaw))
        attitude = attitude._replace(roll=attitude.roll - left, pitch=attitude.pitch + forward)
    if noise is None:
        return attitude, rates
    rate_noise, attitude_noise = parameters.gyroscope.noise, parameters.attitude_noise
    return euler_step(attitude, noise.attitude, attitude_noise), euler_step(rates, noise.rates, rate_noise)


def next_lean_error(lean: LeanError, state: State, drag: NeglectedDrag, period: Time) -> LeanError:
    """Return the error of the estimated thrust direction one period later.

    Args:
        lean: error at the start of the period.
        state: state of the vehicle at the end of the period.
        drag: drag that the estimator neglects.
        period: duration of the period, s.
    """
    gain = 1.0 - exp(-period / drag.time)
    return LeanError(
        lean.x + gain * (-drag.tilt_per_speed * state.v_x - lean.x),
        lean.y + gain * (-drag.tilt_per_speed * state.v_y - lean.y),
    )


def rotation_error(attitude: Attitude, target: Attitude, yaw_weight: Number) -> BodyRates:
    """Return the attitude error along the axes of B as PX4 defines it, in rad for small errors.

    The rotation to the target is decomposed into a rotation about z_B, followed by a rotation that tilts the thrust
    axis along the shortest path. The angle of the first rotation is multiplied by `yaw_weight`, since rotors produce
    little yaw torque. The error is twice the vector part of the resulting quaternion. Its yaw component is divided by
    the weight, so that the weight does not change the yaw gain.

    Args:
        attitude: estimated attitude.
        target: commanded attitude.
        yaw_weight: weight of the yaw, in (0, 1].
    """
    w, x, y, z = Quaternion.of(*attitude).relative_quaternion(Quaternion.of(*target))
    # Two quaternions of opposite sign describe the same rotation. The sign selects the quaternion with the smaller
    # angle.
    sign = where(w < 0.0, -1.0, 1.0)
    w, x, y, z = sign * w, sign * x, sign * y, sign * z
    upright = sqrt(w * w + z * z + TINY)
    cosine, sine = w / upright, z / upright
    tilt_x, tilt_y = x * cosine - y * sine, x * sine + y * cosine
    sine, cosine = sin_cos(yaw_weight * arctan2(sine, cosine))
    return BodyRates(
        2.0 * (tilt_x * cosine + tilt_y * sine),
        2.0 * (tilt_y * cosine - tilt_x * sine),
        2.0 * upright * sine / yaw_weight,
    )


def _commanded_rates(
    target: AttitudeTarget,
    attitude: Attitude,
    parameters: AutopilotParameters,
    memory: LoopMemory,
    period: Time,
    rules: LoopRules,
) -> tuple[BodyRates, LoopMemory]:
    """Return the commanded body rates, and the internal state of the attitude loop after the tick."""
    k_attitude = parameters.k_attitude
    wanted = Attitude(target.roll, target.pitch, target.yaw)
    if parameters.yaw_weight is None:
        results = [
            pid(r, y, k, terms, before, period, is_angle=turns, integrates_first=rules.attitude_integrates_first)
            for r, y, k, terms, before, turns in zip(
                *(
                    wanted,
                    attitude,
                    k_attitude,
                    parameters.attitude or (None, None, None),
                    memory,
                    (False, False, True),
                ),
                strict=True,
            )
        ]
        p, q, r = (result for result, _ in results)
        memory = LoopMemory(*[after for _, after in results])
    else:
        p, q, r = (
            k * error
            for k, error in zip(k_attitude, rotation_error(attitude, wanted, parameters.yaw_weight), strict=True)
        )
    rates = BodyRates(target.p + p, target.q + q, target.r + r)
    if parameters.max_rates is not None:
        rates = BodyRates(*[saturate(rate, limit) for rate, limit in zip(rates, parameters.max_rates, strict=True)])
    return rates, memory


def autopilot_step(
    target: AttitudeTarget,
    state: State,
    noise: SensorNoise | None,
    parameters: AutopilotParameters,
    memory: AutopilotMemory | None,
    period: Time,
    rules: LoopRules = LoopRules(),
) -> tuple[Wrench, AutopilotMemory | None]:
    """Return the wrench and the internal state of an `AttitudeAutopilot` after a tick.

    Args:
        target: attitude target that the autopilot received over the link.
        state: true state of the vehicle.
        noise: standard normal samples for the noise of the sensors; None if there is no noise.
        parameters: parameters of the autopilot.
        memory: internal state after the previous tick; None for an autopilot without an internal state.
        period: tick period h of the autopilot, s.
        rules: variants of the loops.
    """
    i_xx, i_yy, i_zz = parameters.inertia
    attitude_memory, rate_memory, gyroscope, lean = memory or AutopilotMemory.of(parameters)
    if parameters.neglected_drag is not None:
        assert lean is not None
        lean = next_lean_error(lean, state, parameters.neglected_drag, period)
    attitude, rates = estimated_attitude_and_rates(state, noise, parameters, lean)
    if parameters.gyroscope_filter is not None:
        assert gyroscope is not None
        low_pass = parameters.gyroscope_filter
        filtered_rates = (filter_step(rate, low_pass, delayed) for rate, delayed in zip(rates, gyroscope, strict=True))
        (p, delayed_p), (q, delayed_q), (r, delayed_r) = filtered_rates
        rates, gyroscope = BodyRates(p, q, r), (delayed_p, delayed_q, delayed_r)
    wanted, attitude_memory = _commanded_rates(target, attitude, parameters, attitude_memory, period, rules)
    results = [
        pid(r, y, k, terms, before, period, integrates_first=rules.rate_integrates_first)
        for r, y, k, terms, before in zip(
            wanted, rates, parameters.k_rate, parameters.rate or (None, None, None), rate_memory, strict=True
        )
    ]
    (roll, pitch, yaw), (p, q, r) = (result for result, _ in results), rates
    tau_x, tau_y, tau_z = i_xx * roll, i_yy * pitch, i_zz * yaw
    if rules.gyroscopic:
        tau_x = tau_x + (i_zz - i_yy) * q * r
        tau_y = tau_y + (i_xx - i_zz) * p * r
        tau_z = tau_z + (i_yy - i_xx) * p * q
    wrench = Wrench(target.thrust, tau_x, tau_y, tau_z)
    if memory is None:
        return wrench, None
    return wrench, AutopilotMemory(attitude_memory, LoopMemory(*[after for _, after in results]), gyroscope, lean)


@fleet_system(float, AutoDiffXd)
class AttitudeAutopilot(FleetSystem):
    """Attitude and rate loops on board: τ = I k_rate (ω_r + k_attitude e - ω) + ω × I ω in B, with optional terms.

    .. pydrake_system::

        name: AttitudeAutopilot
        input_ports:
        - attitude_target
        - state
        - sensor_noise
        output_ports:
        - wrench

    e is the attitude in the `attitude_target` minus the attitude of the vehicle, with the yaw error between -π and π.
    ω_r are the body rates in the target, and ω are the body rates that the gyroscope measures. The thrust in the target
    is passed on unchanged. The autopilot is on board, so it uses the `state` without delay. It holds the `wrench` until
    its next tick:

        state, target ●━━━━━○
                      ●━━━━━○ wrench
                      0     h

    A target that arrives at a tick of the autopilot takes effect at the next tick. `sensor_noise` is a random input
    with standard normal samples for the gyroscope and the attitude. The port exists only if there is noise.

    `AutopilotParameters` lists the optional parts: integrals, filtered derivatives, feed-forward and limits of both
    loops, a filter for the gyroscope, and a rotation error that replaces the errors of the angles.

    The states are `wrench` and, if a part has an internal state, `memory`. The only parameter of the context is
    `autopilot`.

    Args:
        num_vehicles: number N of vehicles.
        period: tick period h of the autopilot, s. The default, 2.5 ms, corresponds to 400 Hz, the default of PX4's
            parameter IMU_GYRO_RATEMAX.
        noisy: True if the sensors have noise.
        rules: variants of the attitude loop and of the rate loop.
        parameters: gains, parameters of the sensors, and the autopilot's model of the vehicle.
    """

    def declare(
        self,
        *,
        period: float = 0.0025,
        noisy: bool = False,
        rules: LoopRules = LoopRules(),
        parameters: AutopilotParameters,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        parameter = self.parameter("autopilot", lambda parameters: parameters)
        target, state = self.input("attitude_target"), self.input("state")
        noise = None
        if noisy:
            noise = self.random_input("sensor_noise", SensorNoise, RandomDistribution.kGaussian, period=period)
        wrench = self.state("wrench", lambda parameters: parameters.initial)
        remembers = layout_of(AutopilotMemory, AutopilotMemory.of(parameters)).num_rows > 0
        memory = self.state("memory", AutopilotMemory.of) if remembers else None
        arguments = target, state, noise, parameter, memory, period, rules
        self.update(period, autopilot_step, *arguments, writes=[wrench, memory])
        self.state_output(wrench)


def wrench_without_torque(target: AttitudeTarget) -> Wrench:
    """Return a wrench with the thrust of an attitude target and without torques."""
    return Wrench(target.thrust, 0.0, 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class ThrustOnly(FleetSystem):
    """Wrench with the thrust of an attitude target and without torques, for an `AttitudeResponseQuadrotor`.

    .. pydrake_system::

        name: ThrustOnly
        input_ports:
        - attitude_target
        output_ports:
        - wrench

    The torques of the `wrench` are zero, since the model of the vehicle contains its attitude loop.

    Args:
        num_vehicles: number N of vehicles.
    """

    def declare(self) -> None:
        """Declare the ports of this system."""
        self.output("wrench", wrench_without_torque, self.input("attitude_target"))
