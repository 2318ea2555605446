"""Rotors on their way to what they are told: throttles, and the lag of their speed."""

from collections.abc import Callable
from typing import Annotated, NamedTuple

from drake_quad.framework.elementary import exp, maximum, minimum, sqrt, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import TINY
from drake_quad.signals import Quantity, RotorSpeed, Row, Throttle, Wrench
from drake_quad.vehicle.allocation import Allocated, Priority, RotorModel, allocate, allocate_to_pairs
from drake_quad.vehicle.parameters import QuadrotorParameters

_Force = Annotated[Row, Quantity("N")]


class ThrustCurve(NamedTuple):
    """Thrust of a rotor over its throttle u: K₀ + K₁ u + K₂ u²."""

    k_0: _Force
    k_1: _Force
    k_2: _Force


class SpinDown(NamedTuple):
    """Lag of rotors that slow down; `rotor_time_constant` is then that of those that speed up."""

    time_constant: Annotated[Row, Quantity("s")]


def mean_thrust_factor(parameters: QuadrotorParameters) -> Row:
    """The mean of the rotors' thrust factors b, N s²."""
    b_1, b_2, b_3, b_4 = parameters.rotors.thrust_factors
    return 0.25 * (b_1 + b_2 + b_3 + b_4)


def thrust_of(throttle: Row, curve: ThrustCurve) -> Row:
    """The thrust of a rotor, N."""
    return curve.k_0 + throttle * (curve.k_1 + curve.k_2 * throttle)


def throttle_for(thrust: Row, curve: ThrustCurve) -> Row:
    """The throttle for a thrust (N), of a curve that rises over [0, 1]."""
    above = thrust - curve.k_0
    root = sqrt(maximum(curve.k_1 * curve.k_1 + 4.0 * curve.k_2 * above, 0.0))
    # Of the two ways to write the root this one holds for a straight line, too.
    return 2.0 * above / maximum(curve.k_1 + root, TINY)


def speeds_of_throttles(curve: ThrustCurve, thrust_factor: Row) -> tuple[Row, Row]:
    """The least and the largest speed (rad/s) that throttles stand for, of a curve that rises over [0, 1].

    Args:
        curve: of the thrust of each rotor.
        thrust_factor: b of a rotor whose thrust is that of the curve, N s².
    """
    return sqrt(maximum(curve.k_0, 0.0) / thrust_factor), sqrt(thrust_of(1.0, curve) / thrust_factor)


def told_by_throttle(command: Throttle, curve: ThrustCurve, parameters: QuadrotorParameters) -> RotorSpeed:
    """The rotor speeds that throttles stand for: √(T / b), with b the mean of the rotors' thrust factors.

    So a rotor whose own factor is off from the mean gives as much more or less than the curve says. A throttle is
    clipped to [0, 1], 0 if it is not a number.
    """
    per_factor = 1.0 / mean_thrust_factor(parameters)
    thrusts = [thrust_of(minimum(maximum(throttle, 0.0), 1.0), curve) for throttle in command]
    return RotorSpeed._make(sqrt(maximum(thrust, TINY) * per_factor) for thrust in thrusts)


def time_constants(
    speed: RotorSpeed, target: RotorSpeed, parameters: QuadrotorParameters, down: SpinDown | None
) -> RotorSpeed:
    """The lag of each rotor (s), by whether it speeds up or slows down; one at its target counts as slowing down."""
    up = parameters.rotor_time_constant
    if down is None:
        return RotorSpeed(up, up, up, up)
    return RotorSpeed._make(where(to > now, up, down.time_constant) for now, to in zip(speed, target, strict=True))


def lagging(speed: RotorSpeed, target: RotorSpeed, decay: RotorSpeed) -> RotorSpeed:
    """Rotor speeds some time later, on their way to a target: the decay is exp(-time / time constant) of each."""
    return RotorSpeed._make(t + (w - t) * d for w, t, d in zip(speed, target, decay, strict=True))


def decays(
    speed: RotorSpeed, target: RotorSpeed, time: Row, parameters: QuadrotorParameters, down: SpinDown | None
) -> RotorSpeed:
    """exp(-time / time constant) of each rotor. On its way to a target that is held, none turns round."""
    if down is None:
        decay = exp(-time / parameters.rotor_time_constant)
        return RotorSpeed(decay, decay, decay, decay)
    lags = time_constants(speed, target, parameters, down)
    return RotorSpeed._make(exp(-time / lag) for lag in lags)


def acceleration(
    speed: RotorSpeed, target: RotorSpeed, parameters: QuadrotorParameters, down: SpinDown | None
) -> RotorSpeed:
    """dω/dt of the rotors on their way to a target, rad/s²."""
    lags = time_constants(speed, target, parameters, down)
    return RotorSpeed._make((t - w) / lag for w, t, lag in zip(speed, target, lags, strict=True))


class ThrottleModel(NamedTuple):
    """What the autopilot believes of rotors that are told throttles.

    Attributes:
        rotors: their model.
        thrust_factor: b of a rotor whose thrust is that of the curve.
        curve: of the thrust of each over its throttle.
    """

    rotors: RotorModel
    thrust_factor: Annotated[Row, Quantity("N s²")]
    curve: ThrustCurve

    @classmethod
    def of(cls, parameters: QuadrotorParameters, curve: ThrustCurve) -> "ThrottleModel":
        """The model of a vehicle."""
        return cls(RotorModel.of(parameters), mean_thrust_factor(parameters), curve)


def told_as(speed: RotorSpeed, vehicle: ThrottleModel, believed: ThrottleModel) -> RotorSpeed:
    """The rotor speeds that the autopilot believes to command where rotors turn at some speeds, within its limits.

    Args:
        speed: of the rotors.
        vehicle: as it is.
        believed: by the autopilot.
    """
    throttles = [throttle_for(vehicle.thrust_factor * w * w, vehicle.curve) for w in speed]
    thrusts = [thrust_of(throttle, believed.curve) for throttle in throttles]
    return RotorSpeed._make(sqrt(thrust / believed.thrust_factor) for thrust in thrusts)


class AllocatedThrottle(NamedTuple):
    """Result of an allocation.

    Attributes:
        throttle_command: throttles that produce the wrench, or the part of it that the rotors can produce.
        shortfall: part of the wrench that the rotors cannot produce, exactly zero for parts that are kept.
    """

    throttle_command: Throttle
    shortfall: Wrench


def allocate_throttle(
    wrench: Wrench,
    model: ThrottleModel,
    priority: Priority = "roll_pitch",
    allocation: Callable[[Wrench, RotorModel, Priority], Allocated] = allocate,
) -> AllocatedThrottle:
    """Return the throttles in [0, 1] for a wrench, and the part of the wrench that the rotors cannot produce.

    Args:
        wrench: commanded wrench.
        model: autopilot's model of the motors.
        priority: part of the wrench that is kept first.
        allocation: `allocate` or `allocate_to_pairs`.
    """
    rotors, b, curve = model
    slowest, fastest = speeds_of_throttles(curve, b)
    within = rotors._replace(min_speed=maximum(rotors.min_speed, slowest), max_speed=minimum(rotors.max_speed, fastest))
    allocated = allocation(wrench, within, priority)
    throttles = [throttle_for(b * speed * speed, curve) for speed in allocated.rotor_speed_command]
    return AllocatedThrottle(Throttle._make(throttles), allocated.shortfall)


@fleet_system(float, AutoDiffXd)
class ThrottleAllocation(FleetSystem):
    """Control allocation on board a vehicle whose motors take throttles.

    .. pydrake_system::

        name: ThrottleAllocation
        input_ports:
        - wrench
        output_ports:
        - throttle_command_and_shortfall

    The output packs the two signals of `AllocatedThrottle`. The rotor speeds are those of an `Allocation`, each
    converted to a throttle u by the autopilot's thrust curve T = K₀ + K₁ u + K₂ u².

    The only parameter of the context is `model`.

    Args:
        num_vehicles: N.
        paired: True if all rotors are equal and in opposite pairs, which saves operations.
        priority: part of the wrench that is kept first if the rotors cannot produce the whole wrench.
        numbers: autopilot's model of the motors, whose thrust curve increases over [0, 1].
    """

    def declare(self, *, paired: bool = False, priority: Priority = "roll_pitch", numbers: ThrottleModel) -> None:
        """Declare ports and parameters."""
        wrench, model = self.input("wrench"), self.parameter("model", lambda model: model)
        reads = wrench, model, priority, allocate_to_pairs if paired else allocate
        self.packed_output("throttle_command_and_shortfall", AllocatedThrottle, allocate_throttle, *reads)
