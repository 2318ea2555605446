"""Time steps of the vehicle with constant inputs, and the time derivative of its state.

The rotor speeds do not depend on the rigid body, and their response to a constant command has a closed form. A step
therefore computes the rotor speeds exactly at its start, middle and end. With the resulting wrenches, the step
integrates the rigid body, and the slung load if there is one, by the classical fourth-order Runge–Kutta method. The
attitude is integrated as a quaternion (`drake_quad.vehicle.attitude_kinematics`) and the rod of a slung load as a
direction in W (`drake_quad.vehicle.slung_load`), so that a step has no singularity. The battery voltage at the start of
the step applies to the whole step.
"""

from typing import Any, NamedTuple, TypeVar

from drake_quad.framework.elementary import where
from drake_quad.geometry.axes import BodyAxes
from drake_quad.signals import (
    Attitude,
    BodyRates,
    Charge,
    Crashed,
    RotorSpeed,
    Row,
    State,
    Swing,
    Throttle,
    VehicleAcceleration,
    Wind,
)
from drake_quad.vehicle.attitude_kinematics import AttitudeKinematics
from drake_quad.vehicle.battery import Battery, battery_load, charge_rate, rotor_battery_load, rotor_power
from drake_quad.vehicle.dynamics import Motion, target_rotor_speed
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors, speed_factors
from drake_quad.vehicle.motion import accelerations, rotor_state, rotor_states_over_step
from drake_quad.vehicle.motors import rotor_accelerations, rotor_speeds_of_throttles
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.runge_kutta import runge_kutta_step
from drake_quad.vehicle.slung_load import Rod, rod_from_swing, swing_from_rod, swing_rates

_Record = TypeVar("_Record")


class VehicleState(NamedTuple):
    """Complete state of a vehicle, or its time derivative.

    Attributes:
        body: position, attitude, velocity and body rates.
        rotors: rotor speeds.
        swing: swing of a slung load; None if there is none.
        charge: charge drawn from the battery; None if there is no battery.
    """

    body: State
    rotors: RotorSpeed
    swing: Swing | None = None
    charge: Charge | None = None


def quadrotor_step(
    body: State,
    rotors: RotorSpeed,
    swing: Swing | None,
    charge: Charge | None,
    command: RotorSpeed | Throttle,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    faults: RotorFaults | None,
    effects: Effects,
    time: Row,
    time_step: float,
    kinematics: AttitudeKinematics,
) -> VehicleState:
    """Return the state of the vehicle at the end of a step.

    Args:
        body: state of the rigid body at the start of the step.
        rotors: rotor speeds at the start of the step.
        swing: swing of a slung load at the start of the step; None if there is none.
        charge: charge drawn from the battery up to the start of the step; None if there is no battery.
        command: commanded rotor speeds, which are clipped to the rotors' limits, or throttles.
        wind: velocity of the air in W.
        crashed: nonzero for a vehicle whose state is frozen; None if all vehicles fly.
        parameters: parameters of the vehicle.
        faults: faults of the rotors, evaluated at the middle of the step; None if there are none.
        effects: effects on the vehicle. A payload acts during the step if it is attached at the middle of the step.
        time: time at the end of the step, s.
        time_step: time step h, s.
        kinematics: `RIGID_KINEMATICS` or `SMALL_ANGLE_KINEMATICS`.
    """
    before = VehicleState(body, rotors, swing, charge)
    target = rotor_target(before, command, parameters, faults, effects, time - 0.5 * time_step)
    after = flying_step(before, target, wind, parameters, effects, time, time_step, kinematics)
    return freeze_crashed(crashed, before, after)


def rotor_target(
    state: VehicleState,
    command: RotorSpeed | Throttle,
    parameters: QuadrotorParameters,
    faults: RotorFaults | None,
    effects: Effects,
    time: Row,
) -> RotorSpeed:
    """Return the speeds that the rotors approach, given the faults, the battery and the thrust curve.

    The arguments are as in `quadrotor_step`, except that `time` is the time at which the faults are evaluated, s.
    """
    factors = SpeedFactors() if faults is None else speed_factors(faults, time)
    if effects.battery is not None and state.charge is not None:
        power = rotor_power(state.rotors, parameters)
        fraction = battery_load(state.charge, power, effects.battery).voltage / effects.battery.voltage
        factors = SpeedFactors._make(factor * fraction for factor in factors)
    if effects.thrust_curve is not None:
        command = rotor_speeds_of_throttles(Throttle(*command), effects.thrust_curve, parameters)
    return target_rotor_speed(RotorSpeed(*command), parameters, factors)


class IntegratedState(NamedTuple):
    """Quantities that a step integrates, except for the position, or their time derivatives.

    Attributes:
        attitude: coordinates of an `IntegratedAttitude`.
        motion: velocity and body rates.
        rod: rod of a slung load; None if there is none.
    """

    attitude: Any
    motion: Motion
    rod: Rod | None


def flying_step(
    before: VehicleState,
    target: RotorSpeed,
    wind: Wind,
    parameters: QuadrotorParameters,
    effects: Effects,
    time: Row,
    time_step: float,
    kinematics: AttitudeKinematics,
) -> VehicleState:
    """Return the state at the end of a step of a vehicle that has not crashed, given the target rotor speeds."""
    body, half = before.body, 0.5 * time_step
    rotors_of_stages = start, middle, end = rotor_states_over_step(before.rotors, target, half, parameters, effects)
    # Each stage of the Runge-Kutta method: state of the rotors, and time since the start of the step, s.
    stages = (start, 0.0), (middle, half), (middle, half), (end, time_step)
    attitude = kinematics.integrated(Attitude(body.roll, body.pitch, body.yaw))
    payload_time = 0.0 if effects.payload is None else time - half

    def derivative(stage: int, at: IntegratedState, stage_before: IntegratedState) -> IntegratedState:
        rotors, elapsed = stages[stage]
        needs_height = stage > 0 and effects.depend_on_height
        height = body.z + elapsed * stage_before.motion.v_z if needs_height else body.z
        motion = at.motion
        rates = attitude.rates(at.attitude, BodyRates(motion.p, motion.q, motion.r))
        axes = attitude.axes(at.attitude)
        return IntegratedState(
            rates, *accelerations(axes, motion, at.rod, height, rotors, wind, parameters, effects, payload_time)
        )

    moving = IntegratedState(
        attitude.start, Motion.of(body), None if before.swing is None else rod_from_swing(before.swing)
    )
    step = runge_kutta_step(moving, derivative, time_step)
    moving, sixth = step.end, time_step / 6.0
    # The derivative of the position is the velocity, which is itself a state. The method therefore computes the change
    # of position from a weighted mean of the velocities at the stages.
    motion_1, motion_2, motion_3, motion_4 = (stage.motion for stage in step.stages)
    x = body.x + sixth * (motion_1.v_x + 2.0 * (motion_2.v_x + motion_3.v_x) + motion_4.v_x)
    y = body.y + sixth * (motion_1.v_y + 2.0 * (motion_2.v_y + motion_3.v_y) + motion_4.v_y)
    z = body.z + sixth * (motion_1.v_z + 2.0 * (motion_2.v_z + motion_3.v_z) + motion_4.v_z)
    state = State(x, y, z, *attitude.attitude(moving.attitude), *moving.motion)
    swing = None if moving.rod is None else swing_from_rod(moving.rod)
    charge = before.charge
    if effects.battery is not None and charge is not None:
        rates = (_discharge_rate(charge, rotors.speed, parameters, effects.battery) for rotors in rotors_of_stages)
        (rate_1,), (rate_2,), (rate_3,) = rates
        charge = Charge(charge.drawn + sixth * (rate_1 + 4.0 * rate_2 + rate_3))
    return VehicleState(state, end.speed, swing, charge)


def _discharge_rate(charge: Charge, speed: RotorSpeed, parameters: QuadrotorParameters, battery: Battery) -> Charge:
    """Return the rate at which the rotors draw charge from the battery."""
    return charge_rate(rotor_battery_load(charge, speed, parameters, battery).current)


def quadrotor_derivatives(
    state: VehicleState,
    command: RotorSpeed | Throttle,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    faults: RotorFaults | None,
    effects: Effects,
    time: Row,
    kinematics: AttitudeKinematics,
) -> VehicleState:
    """Return the time derivative of a vehicle's state; the arguments are as in `quadrotor_step`."""
    body = state.body
    target = rotor_target(state, command, parameters, faults, effects, time)
    rotors = rotor_state(state.rotors, target, parameters, effects)
    attitude, motion = Attitude(body.roll, body.pitch, body.yaw), Motion.of(body)
    rod = None if state.swing is None else rod_from_swing(state.swing)
    axes = BodyAxes.of(*attitude)
    derivatives = accelerations(axes, motion, rod, body.z, rotors, wind, parameters, effects, time)
    angle_rates = kinematics.angle_rates(BodyRates(motion.p, motion.q, motion.r), attitude)
    swing = None if state.swing is None or derivatives.rod is None else swing_rates(state.swing, derivatives.rod.rate)
    charge = state.charge
    if effects.battery is not None and charge is not None:
        charge = _discharge_rate(charge, state.rotors, parameters, effects.battery)
    derivative = VehicleState(
        State(body.v_x, body.v_y, body.v_z, *angle_rates, *derivatives.motion),
        rotor_accelerations(state.rotors, target, parameters, effects.spin_down),
        swing,
        charge,
    )
    return freeze_crashed(crashed, zeros_like(derivative), derivative)


def vehicle_acceleration(state: VehicleState, *others: Any) -> VehicleAcceleration:
    """Return the acceleration of the vehicle, zero after a crash; the arguments are as in `quadrotor_derivatives`."""
    derivative = quadrotor_derivatives(state, *others).body
    return VehicleAcceleration(derivative.v_x, derivative.v_y, derivative.v_z, derivative.p, derivative.q, derivative.r)


def stepping_acceleration(
    body: State, rotors: RotorSpeed, swing: Swing | None, charge: Charge | None, *others: Any
) -> VehicleAcceleration:
    """Return the acceleration of a vehicle with a discrete state, like `vehicle_acceleration`."""
    return vehicle_acceleration(VehicleState(body, rotors, swing, charge), *others)


def freeze_crashed(crashed: Crashed | None, stopped: _Record, flying: _Record) -> _Record:
    """Return `stopped` for vehicles that have crashed and `flying` for others; `flying` if `crashed` is None."""
    return flying if crashed is None else where(crashed.crashed != 0.0, stopped, flying)


def zeros_like(record: Any) -> Any:
    """Return a record with zero in place of each value; a field that is None stays None."""
    if isinstance(record, tuple):
        return type(record)._make(map(zeros_like, record))  # type: ignore[attr-defined]
    return None if record is None else 0.0
