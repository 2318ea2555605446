"""Motors: thrust as a function of the throttle, and the lag from commanded to actual rotor speeds."""

from collections.abc import Callable
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import exp, maximum, minimum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import TINY
from drake_quad.signals import Quantity, RotorSpeed, Row, Throttle, Wrench
from drake_quad.vehicle.allocation import AllocationOutput, Priority, RotorModel, allocate, allocate_to_pairs
from drake_quad.vehicle.parameters import QuadrotorParameters

_Force = Annotated[Row, Quantity("N")]


class ThrustCurve(NamedTuple):
    """Thrust of a rotor as a function of its throttle u: K₀ + K₁ u + K₂ u²."""

    k_0: _Force
    k_1: _Force
    k_2: _Force


class SpinDown(NamedTuple):
    """Time constant of decelerating rotors; `rotor_time_constant` then applies only to accelerating rotors."""

    time_constant: Annotated[Row, Quantity("s")]


def mean_thrust_factor(parameters: QuadrotorParameters) -> Row:
    """Return the mean of the rotors' thrust factors b, N s²."""
    b_1, b_2, b_3, b_4 = parameters.rotors.thrust_factors
    return 0.25 * (b_1 + b_2 + b_3 + b_4)


def thrust_from_throttle(throttle: Row, curve: ThrustCurve) -> Row:
    """Return the thrust of a rotor for a throttle in [0, 1], N."""
    return curve.k_0 + throttle * (curve.k_1 + curve.k_2 * throttle)


def throttle_from_thrust(thrust: Row, curve: ThrustCurve) -> Row:
    """Return the throttle for a thrust (N), given a curve that increases over [0, 1]."""
    above = thrust - curve.k_0
    root = sqrt(maximum(curve.k_1 * curve.k_1 + 4.0 * curve.k_2 * above, 0.0))
    # The quadratic equation is solved in a form that is also valid for a straight line, k_2 = 0.
    return 2.0 * above / maximum(curve.k_1 + root, TINY)


def speed_range_of_throttles(curve: ThrustCurve, thrust_factor: Row) -> tuple[Row, Row]:
    """Return the rotor speeds (rad/s) at throttle 0 and at throttle 1.

    Args:
        curve: thrust curve of each rotor, which must increase over [0, 1].
        thrust_factor: thrust factor b of a rotor to which the curve applies exactly, N s².
    """
    return sqrt(maximum(curve.k_0, 0.0) / thrust_factor), sqrt(thrust_from_throttle(1.0, curve) / thrust_factor)


def rotor_speeds_of_throttles(command: Throttle, curve: ThrustCurve, parameters: QuadrotorParameters) -> RotorSpeed:
    """Return the rotor speeds that throttles command: √(T / b), where b is the mean thrust factor of the rotors.

    The thrust T follows from the curve. A rotor whose thrust factor differs from the mean produces T times the ratio of
    its factor to the mean. Throttles are clipped to [0, 1]; NaN becomes 0.
    """
    per_factor = 1.0 / mean_thrust_factor(parameters)
    thrusts = [thrust_from_throttle(minimum(maximum(throttle, 0.0), 1.0), curve) for throttle in command]
    return RotorSpeed._make(sqrt(maximum(thrust, TINY) * per_factor) for thrust in thrusts)


def time_constants(
    speed: RotorSpeed, target: RotorSpeed, parameters: QuadrotorParameters, spin_down: SpinDown | None
) -> RotorSpeed:
    """Return the time constant of each rotor, s, which depends on whether the rotor accelerates or decelerates.

    The time constant of a rotor at its target is the value for decelerating rotors.

    Args:
        speed: rotor speeds.
        target: speeds that the rotors approach.
        parameters: parameters of the vehicle.
        spin_down: time constant of decelerating rotors; None if it is the same in both directions.
    """
    up = parameters.rotor_time_constant
    if spin_down is None:
        return RotorSpeed(up, up, up, up)
    return RotorSpeed._make(where(to > now, up, spin_down.time_constant) for now, to in zip(speed, target, strict=True))


def lagged_speeds(speed: RotorSpeed, target: RotorSpeed, decay: RotorSpeed) -> RotorSpeed:
    """Return the rotor speeds after some time, given the factors by which their differences from the targets decay.

    Args:
        speed: initial rotor speeds.
        target: constant speeds that the rotors approach.
        decay: result of `decay_factors`.
    """
    return RotorSpeed._make(t + (w - t) * d for w, t, d in zip(speed, target, decay, strict=True))


def decay_factors(
    speed: RotorSpeed, target: RotorSpeed, time: Row, parameters: QuadrotorParameters, spin_down: SpinDown | None
) -> RotorSpeed:
    """Return exp(-time / time constant) for each rotor; time in s, other arguments as in `time_constants`.

    A rotor never passes a constant target, so its time constant does not change during this time.
    """
    if spin_down is None:
        decay = exp(-time / parameters.rotor_time_constant)
        return RotorSpeed(decay, decay, decay, decay)
    lags = time_constants(speed, target, parameters, spin_down)
    return RotorSpeed._make(exp(-time / lag) for lag in lags)


def rotor_accelerations(
    speed: RotorSpeed, target: RotorSpeed, parameters: QuadrotorParameters, spin_down: SpinDown | None
) -> RotorSpeed:
    """Return the rates dω/dt of the rotor speeds, rad/s²; the arguments are as in `time_constants`."""
    lags = time_constants(speed, target, parameters, spin_down)
    return RotorSpeed._make((t - w) / lag for w, t, lag in zip(speed, target, lags, strict=True))


class ThrottleModel(NamedTuple):
    """Autopilot's model of rotors whose motors are commanded by throttles.

    Attributes:
        rotors: model of the rotors.
        thrust_factor: thrust factor b of a rotor to which the curve applies exactly.
        curve: thrust of each rotor as a function of its throttle.
    """

    rotors: RotorModel
    thrust_factor: Annotated[Row, Quantity("N s²")]
    curve: ThrustCurve

    @classmethod
    def of(cls, parameters: QuadrotorParameters, curve: ThrustCurve) -> "ThrottleModel":
        """Return the exact model of the rotors of a vehicle, given its thrust curve."""
        return cls(RotorModel.of(parameters), mean_thrust_factor(parameters), curve)


def nominal_rotor_speeds(speed: RotorSpeed, vehicle: ThrottleModel, nominal: ThrottleModel) -> RotorSpeed:
    """Return the rotor speeds that an autopilot with an inexact model must command to obtain given actual rotor speeds.

    Args:
        speed: actual rotor speeds, within the limits of the autopilot.
        vehicle: exact model of the vehicle.
        nominal: model of the autopilot.
    """
    throttles = [throttle_from_thrust(vehicle.thrust_factor * w * w, vehicle.curve) for w in speed]
    thrusts = [thrust_from_throttle(throttle, nominal.curve) for throttle in throttles]
    return RotorSpeed._make(sqrt(thrust / nominal.thrust_factor) for thrust in thrusts)


class ThrottleAllocationOutput(NamedTuple):
    """Result of a control allocation to throttles.

    Attributes:
        throttle_command: throttles that produce the wrench, or the part of it that the rotors can produce.
        shortfall: commanded wrench minus the produced wrench; exactly zero for each part that is produced completely.
    """

    throttle_command: Throttle
    shortfall: Wrench


def allocate_throttle(
    wrench: Wrench,
    model: ThrottleModel,
    priority: Priority = "roll_pitch",
    allocation: Callable[[Wrench, RotorModel, Priority], AllocationOutput] = allocate,
) -> ThrottleAllocationOutput:
    """Return the throttles in [0, 1] for a wrench, and the part of the wrench that the rotors cannot produce.

    Args:
        wrench: commanded wrench.
        model: autopilot's model of the motors.
        priority: part of the wrench that has priority.
        allocation: `allocate` or `allocate_to_pairs`.
    """
    rotors, b, curve = model
    slowest, fastest = speed_range_of_throttles(curve, b)
    within = rotors._replace(min_speed=maximum(rotors.min_speed, slowest), max_speed=minimum(rotors.max_speed, fastest))
    allocated = allocation(wrench, within, priority)
    throttles = [throttle_from_thrust(b * speed * speed, curve) for speed in allocated.rotor_speed_command]
    return ThrottleAllocationOutput(Throttle._make(throttles), allocated.shortfall)


@fleet_system(float, AutoDiffXd)
class ThrottleAllocation(FleetSystem):
    """Control allocation on board a vehicle whose motors are commanded by throttles.

    .. pydrake_system::

        name: ThrottleAllocation
        input_ports:
        - wrench
        output_ports:
        - throttle_command_and_shortfall

    The output packs the two signals of `ThrottleAllocationOutput`. The system computes rotor speeds as an `Allocation`
    does, and converts each to a throttle u by the autopilot's thrust curve T = K₀ + K₁ u + K₂ u².

    The only parameter of the context is `model`.

    Args:
        num_vehicles: number N of vehicles.
        paired: True if all rotors are equal and in opposite pairs, which saves operations.
        priority: part of the wrench that has priority if the rotors cannot produce the whole wrench.
        parameters: autopilot's model of the motors, whose thrust curve increases over [0, 1].
    """

    def declare(self, *, paired: bool = False, priority: Priority = "roll_pitch", parameters: ThrottleModel) -> None:
        """Declare the ports and parameters of this system."""
        wrench, model = self.input("wrench"), self.parameter("model", lambda model: model)
        arguments = wrench, model, priority, allocate_to_pairs if paired else allocate
        self.packed_output("throttle_command_and_shortfall", ThrottleAllocationOutput, allocate_throttle, *arguments)
