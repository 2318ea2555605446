"""Attitude control on board: from an attitude target to a wrench.

A loop of the attitude turns its error into body rates, and a loop of the body rates, on a gyroscope, turns these into
torques. Both are proportional, and both can have the further terms of `drake_quad.pid.loop`. With them the loops are
those of PX4 (PX4 User Guide, "Controller diagrams: multicopter attitude and angular rate controller", docs.px4.io;
D. Brescianini, M. Hehn and R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich 2013) or those of the
Crazyflie's firmware (Bitcraze, crazyflie-firmware 2025.12, `attitude_pid_controller.c`):

    attitude    error of roll, pitch and yaw (Crazyflie), or of the rotation with a weight of the yaw (PX4)
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
from drake_quad.pid.filters import EMPTY_FILTER, FilterState, LowPass, filtered
from drake_quad.pid.loop import Memory, Terms, pid, saturated
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


class NeglectedDrag(NamedTuple):
    """Drag that an estimator of the attitude neglects.

    Where the model of the estimator has no drag, it takes the force of the air for a tilt. In flight at v the estimated
    thrust points by d v / g less in the direction of flight than the true one, once the correction of the attitude by
    the position has settled. The lag of this correction is first order.

    Attributes:
        lean: d / g, error of the tilt over the velocity.
        time: time constant of the correction.
    """

    lean: Annotated[Row, Quantity("rad s/m")]
    time: Time


class LeanError(NamedTuple):
    """Error of the estimated direction of the thrust along X and Y."""

    x: Angle
    y: Angle


class LoopAxisTerms(NamedTuple):
    """Terms of a loop about each axis beside the proportional one."""

    roll: Terms
    pitch: Terms
    yaw: Terms


class AutopilotNumbers(NamedTuple):
    """Gains, sensors and believed numbers of an autopilot, which lacks the parts that are None.

    Attributes:
        k_attitude: body rate over attitude error.
        k_rate: angular acceleration over error of the body rate.
        inertia: believed moments of inertia.
        gyroscope: errors of the gyroscope.
        attitude_noise: standard deviation of the estimates of roll, pitch and yaw.
        initial: wrench before the first is computed.
        attitude: further terms of the loop of the attitude, whose output is a body rate.
        rate: further terms of the loop of the body rates, whose output is an angular acceleration.
        gyroscope_filter: filter of the gyroscope.
        max_rates: largest commanded body rates.
        yaw_weight: weight of the yaw in the error of the rotation; None for errors of roll, pitch and yaw.
        neglected_drag: drag that the estimator of the attitude neglects; None if it is exact.
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
    """Variants of the loops.

    Attributes:
        gyroscopic: True if the torque ω × I ω is added.
        attitude_integrates_first: True if the integral of the attitude loop has the error of its own instant.
        rate_integrates_first: the same for the rate loop.
    """

    gyroscopic: bool = True
    attitude_integrates_first: bool = False
    rate_integrates_first: bool = False


class LoopMemory(NamedTuple):
    """Memory of a loop about each axis."""

    roll: Memory
    pitch: Memory
    yaw: Memory

    @classmethod
    def of(cls, terms: LoopAxisTerms | None) -> "LoopMemory":
        """Return the memory before the first instant."""
        return cls(*[Memory.of(each) for each in terms or (None, None, None)])


class AutopilotMemory(NamedTuple):
    """State of an autopilot beside its wrench.

    Attributes:
        attitude: memory of the loop of the attitude.
        rate: memory of the loop of the body rates.
        gyroscope: states of the filters of p, q and r; None without a filter.
        lean: error of the estimated tilt; None without one.
    """

    attitude: LoopMemory
    rate: LoopMemory
    gyroscope: tuple[FilterState, FilterState, FilterState] | None
    lean: LeanError | None

    @classmethod
    def of(cls, numbers: AutopilotNumbers) -> "AutopilotMemory":
        """Return the memory before the first instant."""
        gyroscope = None if numbers.gyroscope_filter is None else (EMPTY_FILTER, EMPTY_FILTER, EMPTY_FILTER)
        lean = None if numbers.neglected_drag is None else LeanError(0.0, 0.0)
        return cls(LoopMemory.of(numbers.attitude), LoopMemory.of(numbers.rate), gyroscope, lean)


class SensorNoise(NamedTuple):
    """Normal numbers for the noise of gyroscope and attitude."""

    rates: tuple[Number, Number, Number]
    attitude: tuple[Number, Number, Number]


def sensed(
    state: State, noise: SensorNoise | None, numbers: AutopilotNumbers, lean: LeanError | None = None
) -> tuple[Attitude, BodyRates]:
    """Return attitude and body rates as the autopilot estimates them.

    Args:
        state: state of the vehicle.
        noise: normal numbers for the noise; None if there is none.
        numbers: numbers of the autopilot.
        lean: error of the estimated tilt; None without one.
    """
    bias = numbers.gyroscope.bias
    attitude = Attitude(state.roll, state.pitch, state.yaw)
    rates = BodyRates(state.p + bias.p, state.q + bias.q, state.r + bias.r)
    if lean is not None:
        forward, left, _ = in_heading(Vector(lean.x, lean.y, 0.0), *sin_cos(state.yaw))
        attitude = attitude._replace(roll=attitude.roll - left, pitch=attitude.pitch + forward)
    if noise is None:
        return attitude, rates
    turning, leaning = numbers.gyroscope.noise, numbers.attitude_noise
    return moved(attitude, noise.attitude, leaning), moved(rates, noise.rates, turning)


def lean_after(lean: LeanError, state: State, drag: NeglectedDrag, period: Time) -> LeanError:
    """Return the error of the estimated tilt a period (s) later, for the velocity at its end."""
    gain = 1.0 - exp(-period / drag.time)
    return LeanError(
        lean.x + gain * (-drag.lean * state.v_x - lean.x), lean.y + gain * (-drag.lean * state.v_y - lean.y)
    )


def rotation_error(attitude: Attitude, target: Attitude, yaw_weight: Number) -> BodyRates:
    """Return the error of the attitude along the axes of B as PX4 defines it, in rad for small errors.

    The rotation to the target is taken apart into a rotation about z_B and one that then tilts the thrust axis by the
    shortest way. The angle of the first is reduced to its share `yaw_weight`, since rotors have little yaw torque, and
    the error is twice the vector part of the quaternion that results. The yaw is divided by the weight, so that the
    weight does not change the gain of the yaw.

    Args:
        attitude: estimated.
        target: commanded.
        yaw_weight: in (0, 1].
    """
    w, x, y, z = Quaternion.of(*attitude).turn_to(Quaternion.of(*target))
    # Two quaternions describe the rotation; the one with the smaller angle is taken.
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


def _rates_wanted(
    target: AttitudeTarget,
    attitude: Attitude,
    numbers: AutopilotNumbers,
    memory: LoopMemory,
    period: Time,
    rules: LoopRules,
) -> tuple[BodyRates, LoopMemory]:
    """Return the commanded body rates, and the memory of the attitude loop."""
    k_attitude = numbers.k_attitude
    wanted = Attitude(target.roll, target.pitch, target.yaw)
    if numbers.yaw_weight is None:
        answers = [
            pid(r, y, k, terms, before, period, is_angle=turns, integrates_first=rules.attitude_integrates_first)
            for r, y, k, terms, before, turns in zip(
                *(wanted, attitude, k_attitude, numbers.attitude or (None, None, None), memory, (False, False, True)),
                strict=True,
            )
        ]
        p, q, r = (answer for answer, _ in answers)
        memory = LoopMemory(*[after for _, after in answers])
    else:
        p, q, r = (
            k * error for k, error in zip(k_attitude, rotation_error(attitude, wanted, numbers.yaw_weight), strict=True)
        )
    rates = BodyRates(target.p + p, target.q + q, target.r + r)
    if numbers.max_rates is not None:
        rates = BodyRates(*[saturated(rate, limit) for rate, limit in zip(rates, numbers.max_rates, strict=True)])
    return rates, memory


def autopilot_law(
    target: AttitudeTarget,
    state: State,
    noise: SensorNoise | None,
    numbers: AutopilotNumbers,
    memory: AutopilotMemory | None,
    period: Time,
    rules: LoopRules = LoopRules(),
) -> tuple[Wrench, AutopilotMemory | None]:
    """Return the wrench of an `AttitudeAutopilot`, and its memory.

    Args:
        target: that came over the link.
        state: of the vehicle.
        noise: of the sensors; None if there is none.
        numbers: of the autopilot.
        memory: of the instant before; None if nothing is remembered.
        period: h, s.
        rules: variants of the loops.
    """
    i_xx, i_yy, i_zz = numbers.inertia
    attitude_memory, rate_memory, gyroscope, lean = memory or AutopilotMemory.of(numbers)
    if numbers.neglected_drag is not None:
        assert lean is not None
        lean = lean_after(lean, state, numbers.neglected_drag, period)
    attitude, rates = sensed(state, noise, numbers, lean)
    if numbers.gyroscope_filter is not None:
        assert gyroscope is not None
        low_pass = numbers.gyroscope_filter
        shown = (filtered(rate, low_pass, delayed) for rate, delayed in zip(rates, gyroscope, strict=True))
        (p, delayed_p), (q, delayed_q), (r, delayed_r) = shown
        rates, gyroscope = BodyRates(p, q, r), (delayed_p, delayed_q, delayed_r)
    wanted, attitude_memory = _rates_wanted(target, attitude, numbers, attitude_memory, period, rules)
    answers = [
        pid(r, y, k, terms, before, period, integrates_first=rules.rate_integrates_first)
        for r, y, k, terms, before in zip(
            wanted, rates, numbers.k_rate, numbers.rate or (None, None, None), rate_memory, strict=True
        )
    ]
    (roll, pitch, yaw), (p, q, r) = (answer for answer, _ in answers), rates
    tau_x, tau_y, tau_z = i_xx * roll, i_yy * pitch, i_zz * yaw
    if rules.gyroscopic:
        tau_x = tau_x + (i_zz - i_yy) * q * r
        tau_y = tau_y + (i_xx - i_zz) * p * r
        tau_z = tau_z + (i_yy - i_xx) * p * q
    wrench = Wrench(target.thrust, tau_x, tau_y, tau_z)
    if memory is None:
        return wrench, None
    return wrench, AutopilotMemory(attitude_memory, LoopMemory(*[after for _, after in answers]), gyroscope, lean)


@fleet_system(float, AutoDiffXd)
class AttitudeAutopilot(FleetSystem):
    """Attitude and rate loop on board: τ = I k_rate (ω_r + k_attitude e - ω) + ω × I ω in B, and further terms.

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

    Integrals, filtered derivatives, feed-forward and limits of both loops, a filter of the gyroscope, and an error of
    the rotation in place of the angles are there if the numbers have them; see `AutopilotNumbers`.

    The states are `wrench` and, if anything is remembered, `memory`. The only parameter of the context is `autopilot`.

    Args:
        num_vehicles: N.
        period: h, s. 2.5 ms by default, as the 400 Hz of PX4's parameter IMU_GYRO_RATEMAX.
        noisy: whether there is noise.
        rules: variants of the loops.
        numbers: gains, sensors, and believed numbers of the vehicle.
    """

    def declare(
        self,
        *,
        period: float = 0.0025,
        noisy: bool = False,
        rules: LoopRules = LoopRules(),
        numbers: AutopilotNumbers,
    ) -> None:
        """Declare ports, states and parameters."""
        parameter = self.parameter("autopilot", lambda numbers: numbers)
        target, state = self.input("attitude_target"), self.input("state")
        noise = None
        if noisy:
            noise = self.random_input("sensor_noise", SensorNoise, RandomDistribution.kGaussian, period=period)
        wrench = self.state("wrench", lambda numbers: numbers.initial)
        remembers = layout_of(AutopilotMemory, AutopilotMemory.of(numbers)).num_rows > 0
        memory = self.state("memory", AutopilotMemory.of) if remembers else None
        reads = target, state, noise, parameter, memory, period, rules
        self.update(period, autopilot_law, *reads, writes=[wrench, memory])
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
