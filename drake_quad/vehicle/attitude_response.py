"""Quadrotor with a second-order model of its closed attitude loop.

The model describes an autopilot together with its vehicle, as identified from flights. Each angle follows its command
according to

    φ̈ = ω_n² (φ_r - φ) - 2 ζ ω_n φ̇

The thrust follows its command with the lag of the rotors. The torques of the rotors have no effect, since the attitude
response includes them. The equations of translation are the same as for a `Quadrotor`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from drake_quad.framework.elementary import wrap_angle
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.kinematics import angular_acceleration, small_rotation
from drake_quad.signals import (
    Angle,
    AngleAcceleration,
    AngleRate,
    AngularAcceleration,
    Attitude,
    AttitudeTarget,
    BodyRates,
    Crashed,
    Number,
    PositionW,
    RotorSpeed,
    Row,
    State,
    Throttle,
    VehicleAcceleration,
    VelocityW,
    Wind,
)
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.dynamics import Motion
from drake_quad.vehicle.effects import NO_EFFECTS, Effects
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.motion import RotorState, accelerations, rotor_state, rotor_states_over_step
from drake_quad.vehicle.motors import rotor_accelerations
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Kinematics, QuadrotorConfig, initial_state
from drake_quad.vehicle.runge_kutta import runge_kutta_step
from drake_quad.vehicle.stepping import VehicleState, freeze_crashed, rotor_target, zeros_like

ATTITUDE_RESPONSE_EFFECTS = ("body_drag", "rotor_aerodynamics", "ground_effect", "spin_down", "thrust_curve", "loads")
"""Names of the supported effects. The other effects act on the attitude, whose response already includes them."""


class NaturalFrequencies(NamedTuple):
    """Natural frequency of each angle's response."""

    roll: AngleRate
    pitch: AngleRate
    yaw: AngleRate


class DampingRatios(NamedTuple):
    """Damping ratio of each angle's response."""

    roll: Number
    pitch: Number
    yaw: Number


class AttitudeResponse(NamedTuple):
    """Second-order response of the attitude to its command.

    Attributes:
        natural_frequency: natural frequencies ω_n.
        damping: damping ratios ζ.
    """

    natural_frequency: NaturalFrequencies
    damping: DampingRatios


class AttitudeResponseConfig(NamedTuple):
    """Parameters that can differ between the vehicles of a fleet.

    Attributes:
        vehicle: parameters as for a `Quadrotor`.
        response: response of the attitude.
    """

    vehicle: QuadrotorConfig
    response: AttitudeResponse


class AttitudeResponseBody(NamedTuple):
    """Position, attitude, velocity and rates of roll, pitch and yaw."""

    x: PositionW
    y: PositionW
    z: PositionW
    roll: Angle
    pitch: Angle
    yaw: Angle
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    roll_rate: AngleRate
    pitch_rate: AngleRate
    yaw_rate: AngleRate


class AttitudeResponseState(NamedTuple):
    """State of the body and of the rotors, or its time derivative."""

    body: AttitudeResponseBody
    rotors: RotorSpeed


BodyRatesOf = Callable[[Attitude, Attitude], BodyRates]
"""Function that returns the body rates, given the rates of the angles and the attitude."""


def _angle_rates_as_body_rates(rates: Attitude, attitude: Attitude) -> BodyRates:
    """Return the angle rates as body rates, the small-angle approximation of eq (3) of the paper."""
    return BodyRates(*rates)


def _angle_accelerations_as_body(accelerations: Attitude, *_: Attitude) -> AngularAcceleration:
    """Return the second derivatives of the angles as angular acceleration, the small-angle approximation of eq (3)."""
    return AngularAcceleration(*accelerations)


_BODY_RATES: dict[str, BodyRatesOf] = {"exact": small_rotation, "small_angle": _angle_rates_as_body_rates}
_BODY_ACCELERATIONS: dict[str, Callable[[Attitude, Attitude, Attitude], AngularAcceleration]] = {
    "exact": angular_acceleration,
    "small_angle": _angle_accelerations_as_body,
}


def state_from_body(body: AttitudeResponseBody, body_rates: BodyRatesOf) -> State:
    """Return the state of the vehicle, with body rates in place of angle rates.

    Args:
        body: state of the body.
        body_rates: function that returns the body rates, given the angle rates and the attitude.
    """
    x, y, z, roll, pitch, yaw, v_x, v_y, v_z, *rates = body
    p, q, r = body_rates(Attitude(*rates), Attitude(roll, pitch, yaw))
    return State(x, y, z, roll, pitch, yaw, v_x, v_y, v_z, p, q, r)


def _angle_acceleration(error: Row, rate: Row, natural_frequency: Row, damping: Row) -> AngleAcceleration:
    """Return the second derivative of an angle (rad/s²), given its error (rad) and its rate (rad/s)."""
    return natural_frequency * (natural_frequency * error - 2.0 * damping * rate)


def body_derivatives(
    body: AttitudeResponseBody,
    rotors: RotorState,
    target: AttitudeTarget,
    wind: Wind,
    parameters: QuadrotorParameters,
    response: AttitudeResponse,
    effects: Effects,
) -> AttitudeResponseBody:
    """Return the time derivative of the body.

    Args:
        body: state of the body.
        rotors: state of the rotors at this instant; only their forces are used.
        target: commanded attitude.
        wind: velocity of the air in W.
        parameters: parameters of the vehicle.
        response: response of the attitude.
        effects: effects on the vehicle.
    """
    # The body rates can be zero here. They affect only the angular acceleration, and the result takes the angular
    # acceleration from the attitude response instead.
    motion = Motion(body.v_x, body.v_y, body.v_z, 0.0, 0.0, 0.0)
    axes = BodyAxes.of(body.roll, body.pitch, body.yaw)
    body_accelerations, _ = accelerations(axes, motion, None, body.z, rotors, wind, parameters, effects)
    frequency, damping = response
    return AttitudeResponseBody(
        body.v_x,
        body.v_y,
        body.v_z,
        body.roll_rate,
        body.pitch_rate,
        body.yaw_rate,
        body_accelerations.v_x,
        body_accelerations.v_y,
        body_accelerations.v_z,
        _angle_acceleration(target.roll - body.roll, body.roll_rate, frequency.roll, damping.roll),
        _angle_acceleration(target.pitch - body.pitch, body.pitch_rate, frequency.pitch, damping.pitch),
        _angle_acceleration(wrap_angle(target.yaw - body.yaw), body.yaw_rate, frequency.yaw, damping.yaw),
    )


def attitude_response_step(
    body: AttitudeResponseBody,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    target: AttitudeTarget,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    response: AttitudeResponse,
    faults: RotorFaults | None,
    effects: Effects,
    time: Row,
    time_step: float,
    kinematics: Kinematics,
) -> AttitudeResponseState:
    """Return the state at the end of a step of the classical fourth-order Runge–Kutta method.

    Args:
        body: state of the body at the start of the step.
        rotors: rotor speeds at the start of the step.
        command: commanded rotor speeds, which are clipped to the rotors' limits, or throttles.
        target: commanded attitude.
        wind: velocity of the air in W.
        crashed: nonzero for a vehicle whose state is frozen; None if all vehicles fly.
        parameters: parameters of the vehicle.
        response: response of the attitude.
        faults: faults of the rotors, evaluated at the middle of the step; None if there are none.
        effects: effects of motors and air on the vehicle.
        time: time at the end of the step, s.
        time_step: time step h, s.
        kinematics: "exact" or "small_angle".
    """
    half = 0.5 * time_step
    before = VehicleState(state_from_body(body, _BODY_RATES[kinematics]), rotors)
    goal = rotor_target(before, command, parameters, faults, effects, time - half)
    start, middle, end = rotor_states_over_step(rotors, goal, half, parameters, effects)
    rotors_of_stages = start, middle, middle, end

    def derivative(stage: int, at: AttitudeResponseBody, _: AttitudeResponseBody) -> AttitudeResponseBody:
        return body_derivatives(at, rotors_of_stages[stage], target, wind, parameters, response, effects)

    after = AttitudeResponseState(runge_kutta_step(body, derivative, time_step).end, end.speed)
    return freeze_crashed(crashed, AttitudeResponseState(body, rotors), after)


def attitude_response_derivatives(
    state: AttitudeResponseState,
    command: RotorSpeed | Throttle,
    target: AttitudeTarget,
    wind: Wind,
    crashed: Crashed | None,
    parameters: QuadrotorParameters,
    response: AttitudeResponse,
    faults: RotorFaults | None,
    effects: Effects,
    time: Row,
    kinematics: Kinematics,
) -> AttitudeResponseState:
    """Return the time derivative of the state; the arguments are as in `attitude_response_step`."""
    now = VehicleState(state_from_body(state.body, _BODY_RATES[kinematics]), state.rotors)
    goal = rotor_target(now, command, parameters, faults, effects, time)
    rotors = rotor_state(state.rotors, goal, parameters, effects)
    derivative = AttitudeResponseState(
        body_derivatives(state.body, rotors, target, wind, parameters, response, effects),
        rotor_accelerations(state.rotors, goal, parameters, effects.spin_down),
    )
    return freeze_crashed(crashed, zeros_like(derivative), derivative)


def vehicle_acceleration(state: AttitudeResponseState, *others: Any) -> VehicleAcceleration:
    """Return the acceleration of the vehicle, zero after a crash; see `attitude_response_derivatives`."""
    *_, kinematics = others
    derivative, body = attitude_response_derivatives(state, *others).body, state.body
    # The angle rates are read from the state derivative, which is zero for a crashed vehicle.
    angular = _BODY_ACCELERATIONS[kinematics](
        Attitude(derivative.roll_rate, derivative.pitch_rate, derivative.yaw_rate),
        Attitude(derivative.roll, derivative.pitch, derivative.yaw),
        Attitude(body.roll, body.pitch, body.yaw),
    )
    return VehicleAcceleration(derivative.v_x, derivative.v_y, derivative.v_z, *angular)


def stepping_acceleration(body: AttitudeResponseBody, rotors: RotorSpeed, *others: Any) -> VehicleAcceleration:
    """Return the acceleration of a vehicle with a discrete state, like `vehicle_acceleration`."""
    return vehicle_acceleration(AttitudeResponseState(body, rotors), *others)


def _initial_state(config: AttitudeResponseConfig) -> AttitudeResponseState:
    """Return the state of a vehicle with a prescribed attitude response at time 0."""
    vehicle = config.vehicle
    body, rotors, _, _ = initial_state(vehicle.parameters, vehicle.start, vehicle.effects, vehicle.motion)
    x, y, z, roll, pitch, yaw, v_x, v_y, v_z, p, q, r = body
    roll_rate, pitch_rate, yaw_rate = RIGID_KINEMATICS.angle_rates(BodyRates(p, q, r), Attitude(roll, pitch, yaw))
    return AttitudeResponseState(
        AttitudeResponseBody(x, y, z, roll, pitch, yaw, v_x, v_y, v_z, roll_rate, pitch_rate, yaw_rate), rotors
    )


def _state_output(state: AttitudeResponseState, body_rates: BodyRatesOf) -> State:
    """Return the output `state` of a vehicle with a continuous state."""
    return state_from_body(state.body, body_rates)


@fleet_system(float, AutoDiffXd)
class AttitudeResponseQuadrotor(FleetSystem):
    """Quadrotor with autopilot, or a fleet of them, whose attitude follows its command with a second-order response.

    .. pydrake_system::

        name: AttitudeResponseQuadrotor
        input_ports:
        - rotor_speed_command
        - attitude_target
        - wind
        - crashed
        output_ports:
        - state
        - rotor_speed
        - acceleration

    The system is a point mass with an attitude. Thrust, gravity and drag accelerate it as they accelerate a
    `Quadrotor` (`drake_quad.vehicle.dynamics`). The attitude follows the angles in the `attitude_target`; the thrust
    and the body rates in the target have no effect. The system uses the total thrust of the rotors, but neither their
    torques nor the moments of inertia.

    Ports, time steps, faults and inputs that are not connected are treated as in a `Quadrotor`. The discrete state
    consists of the groups `state`, an `AttitudeResponseBody`, and `rotor_speed`. The continuous state is an
    `AttitudeResponseState`. The parameters of the context are `parameters` and `response`, for vehicles with faults
    also `faults`, and for vehicles with effects also `effects`.

    Args:
        num_vehicles: number N of vehicles.
        time_step: time step h, s, 10 ms by default; 0 for a continuous state.
        kinematics: "exact", or "small_angle" to use the angle rates as body rates.
        faulty: True if rotors may have faults.
        effects: names of the effects that are switched on, a subset of `ATTITUDE_RESPONSE_EFFECTS`.
        parameters: parameters of the vehicles.

    Raises:
        ValueError: if an effect has no parameters or is not supported.
    """

    def declare(
        self,
        *,
        time_step: float = 0.01,
        kinematics: Kinematics = "exact",
        faulty: bool = False,
        effects: tuple[str, ...] = (),
        parameters: AttitudeResponseConfig,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        unknown = set(effects).difference(ATTITUDE_RESPONSE_EFFECTS)
        if unknown:
            raise ValueError(
                f"an AttitudeResponseQuadrotor does not support these effects: {', '.join(sorted(unknown))}"
            )
        self.time_step = time_step
        vehicle = self.parameter("parameters", lambda parameters: parameters.vehicle.parameters)
        response = self.parameter("response", lambda parameters: parameters.response)
        faults = self.parameter("faults", lambda parameters: parameters.vehicle.faults) if faulty else None
        command = self.input("throttle_command" if "thrust_curve" in effects else "rotor_speed_command")
        target = self.input("attitude_target")
        inputs = command, target, self.input("wind", absent=Wind(0.0, 0.0, 0.0)), self.input("crashed", absent=None)
        effect_parameters: Any = NO_EFFECTS
        if effects:
            effect_parameters = self.parameter("effects", lambda parameters: parameters.vehicle.effects.only(effects))
        constants = vehicle, response, faults, effect_parameters, TIME if faulty else 0.0
        body_rates = _BODY_RATES[kinematics]
        if time_step > 0.0:
            body = self.state("state", lambda parameters: _initial_state(parameters).body)
            rotors = self.state("rotor_speed", lambda parameters: _initial_state(parameters).rotors)
            arguments = body, rotors, *inputs, *constants, time_step, kinematics
            self.update(
                time_step, attitude_response_step, *arguments, writes=[body, rotors], unrestricted=True, at_start=False
            )
            self.output("state", state_from_body, body, body_rates)
            self.state_output(rotors)
            self.output("acceleration", stepping_acceleration, body, rotors, *inputs, *constants, kinematics)
        else:
            state = self.continuous_state(_initial_state)
            self.derivative(attitude_response_derivatives, state, *inputs, *constants, kinematics)
            self.output("state", _state_output, state, body_rates)
            self.output("rotor_speed", getattr, state, "rotors")
            self.output("acceleration", vehicle_acceleration, state, *inputs, *constants, kinematics)
