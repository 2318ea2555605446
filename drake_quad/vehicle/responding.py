"""A quadrotor whose closed attitude loop is known as a whole: it answers to attitude commands.

Identified from flights, an autopilot with its vehicle is a lag of second order on each angle,

    φ̈ = ω_n² (φ_r - φ) - 2 ζ ω_n φ̇

and the thrust lags as the rotors do. What the rotors do to the attitude is in that answer already: only their thrust is
taken, and translation follows the same equations as for a `Quadrotor`.
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
from drake_quad.vehicle.dynamics import Motion
from drake_quad.vehicle.effects import NO_EFFECTS, Effects
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.motion import Turning, accelerations, turning, turning_over_step
from drake_quad.vehicle.motors import acceleration
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Kinematics, QuadrotorNumbers, hover
from drake_quad.vehicle.runge_kutta import runge_kutta_step
from drake_quad.vehicle.stepping import VehicleState, rotor_target, unless_crashed, zeros_like

RESPONDING_EFFECTS = ("body_drag", "rotor_aerodynamics", "ground_effect", "spin_down", "thrust_curve", "loads")
"""Effects of the air and on the motors; the response of the attitude contains what else turns a vehicle."""


class NaturalFrequencies(NamedTuple):
    """Of the answer of each angle."""

    roll: AngleRate
    pitch: AngleRate
    yaw: AngleRate


class DampingRatios(NamedTuple):
    """Of the answer of each angle."""

    roll: Number
    pitch: Number
    yaw: Number


class AttitudeResponse(NamedTuple):
    """How the attitude follows its command.

    Attributes:
        natural_frequency: ω_n.
        damping: ζ.
    """

    natural_frequency: NaturalFrequencies
    damping: DampingRatios


class RespondingNumbers(NamedTuple):
    """What may differ from vehicle to vehicle.

    Attributes:
        vehicle: as for a `Quadrotor`.
        response: of its attitude.
    """

    vehicle: QuadrotorNumbers
    response: AttitudeResponse


class RespondingBody(NamedTuple):
    """Position, attitude, velocity and rates of the angles."""

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


class RespondingState(NamedTuple):
    """Body and rotors; or their rates, per second."""

    body: RespondingBody
    rotors: RotorSpeed


BodyRatesOf = Callable[[Attitude, Attitude], BodyRates]


def _same(rates: Attitude, attitude: Attitude) -> BodyRates:
    """What eq (3) takes for (2)."""
    return BodyRates(*rates)


def _same_rates(accelerations: Attitude, *_: Attitude) -> AngularAcceleration:
    """Return the second derivatives of the angles, in place of the derivative of eq (2)."""
    return AngularAcceleration(*accelerations)


_BODY_RATES: dict[str, BodyRatesOf] = {"exact": small_rotation, "small_angle": _same}
_BODY_ACCELERATIONS: dict[str, Callable[[Attitude, Attitude, Attitude], AngularAcceleration]] = {
    "exact": angular_acceleration,
    "small_angle": _same_rates,
}


def shown_state(body: RespondingBody, body_rates: BodyRatesOf) -> State:
    """The state of the vehicle, with body rates in place of the rates of the angles.

    Args:
        body: of the vehicle.
        body_rates: from the rates of the angles and the attitude.
    """
    x, y, z, roll, pitch, yaw, v_x, v_y, v_z, *rates = body
    p, q, r = body_rates(Attitude(*rates), Attitude(roll, pitch, yaw))
    return State(x, y, z, roll, pitch, yaw, v_x, v_y, v_z, p, q, r)


def _answer(error: Row, rate: Row, natural_frequency: Row, damping: Row) -> AngleAcceleration:
    """The acceleration (rad/s²) of an angle that is behind its command by an error (rad), and its rate (rad/s)."""
    return natural_frequency * (natural_frequency * error - 2.0 * damping * rate)


def body_slope(
    body: RespondingBody,
    rotors: Turning,
    target: AttitudeTarget,
    wind: Wind,
    parameters: QuadrotorParameters,
    response: AttitudeResponse,
    effects: Effects,
) -> RespondingBody:
    """Return the time derivative of the body.

    Args:
        body: state of the body.
        rotors: rotors at this instant, of which only the forces matter.
        target: commanded attitude.
        wind: velocity of the air in W.
        parameters: parameters of the vehicle.
        response: response of the attitude.
        effects: effects on the vehicle.
    """
    # Body rates only affect the angular acceleration, which the response replaces.
    motion = Motion(body.v_x, body.v_y, body.v_z, 0.0, 0.0, 0.0)
    axes = BodyAxes.of(body.roll, body.pitch, body.yaw)
    moving, _ = accelerations(axes, motion, None, body.z, rotors, wind, parameters, effects)
    frequency, damping = response
    return RespondingBody(
        body.v_x,
        body.v_y,
        body.v_z,
        body.roll_rate,
        body.pitch_rate,
        body.yaw_rate,
        moving.v_x,
        moving.v_y,
        moving.v_z,
        _answer(target.roll - body.roll, body.roll_rate, frequency.roll, damping.roll),
        _answer(target.pitch - body.pitch, body.pitch_rate, frequency.pitch, damping.pitch),
        _answer(wrap_angle(target.yaw - body.yaw), body.yaw_rate, frequency.yaw, damping.yaw),
    )


def responding_step(
    body: RespondingBody,
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
) -> RespondingState:
    """Return the vehicle at the end of a step of the classical fourth-order Runge–Kutta method, as for a `Quadrotor`.

    Args:
        body: body at the start of the step.
        rotors: rotors at the start of the step.
        command: commanded rotor speeds, which are clipped to the rotors' limits, or throttles.
        target: commanded attitude.
        wind: velocity of the air in W.
        crashed: nonzero for a vehicle whose state is frozen; None if all vehicles fly.
        parameters: parameters of the vehicle.
        response: response of the attitude.
        faults: faults of the rotors at the middle of the step; None if there are none.
        effects: effects of motors and air on the vehicle.
        time: time at the end of the step, s.
        time_step: time step h, s.
        kinematics: "exact" or "small_angle".
    """
    half = 0.5 * time_step
    before = VehicleState(shown_state(body, _BODY_RATES[kinematics]), rotors)
    goal = rotor_target(before, command, parameters, faults, effects, time - half)
    start, middle, end = turning_over_step(rotors, goal, half, parameters, effects)
    turned = start, middle, middle, end

    def slope(stage: int, at: RespondingBody, _: RespondingBody) -> RespondingBody:
        return body_slope(at, turned[stage], target, wind, parameters, response, effects)

    after = RespondingState(runge_kutta_step(body, slope, time_step).end, end.speed)
    return unless_crashed(crashed, RespondingState(body, rotors), after)


def responding_slope(
    state: RespondingState,
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
) -> RespondingState:
    """Return the time derivative of body and rotors; arguments are those of `responding_step`."""
    now = VehicleState(shown_state(state.body, _BODY_RATES[kinematics]), state.rotors)
    goal = rotor_target(now, command, parameters, faults, effects, time)
    rotors = turning(state.rotors, goal, parameters, effects)
    slope = RespondingState(
        body_slope(state.body, rotors, target, wind, parameters, response, effects),
        acceleration(state.rotors, goal, parameters, effects.spin_down),
    )
    return unless_crashed(crashed, zeros_like(slope), slope)


def acceleration_of(state: RespondingState, *others: Any) -> VehicleAcceleration:
    """Return the acceleration of the vehicle, zero if it has crashed; arguments are those of `responding_slope`."""
    *_, kinematics = others
    slope, body = responding_slope(state, *others).body, state.body
    # The rates of the angles are those of the slope, which are zero for a vehicle that has crashed.
    turning = _BODY_ACCELERATIONS[kinematics](
        Attitude(slope.roll_rate, slope.pitch_rate, slope.yaw_rate),
        Attitude(slope.roll, slope.pitch, slope.yaw),
        Attitude(body.roll, body.pitch, body.yaw),
    )
    return VehicleAcceleration(slope.v_x, slope.v_y, slope.v_z, *turning)


def stepping_acceleration(body: RespondingBody, rotors: RotorSpeed, *others: Any) -> VehicleAcceleration:
    """Return what `acceleration_of` does, for the groups of a discrete state."""
    return acceleration_of(RespondingState(body, rotors), *others)


def _begun(numbers: RespondingNumbers) -> RespondingState:
    """The state of a vehicle that hovers in still air."""
    body, rotors, _, _ = hover(numbers.vehicle.parameters, numbers.vehicle.start, numbers.vehicle.effects)
    x, y, z, roll, pitch, yaw, v_x, v_y, v_z, _, _, _ = body
    return RespondingState(RespondingBody(x, y, z, roll, pitch, yaw, v_x, v_y, v_z, 0.0, 0.0, 0.0), rotors)


def _shown(state: RespondingState, body_rates: BodyRatesOf) -> State:
    return shown_state(state.body, body_rates)


@fleet_system(float, AutoDiffXd)
class RespondingQuadrotor(FleetSystem):
    """A quadrotor with its autopilot, or a fleet of them, whose attitude follows its command as a lag of second order.

    .. pydrake_system::

        name: RespondingQuadrotor
        input_ports:
        - rotor_speed_command
        - attitude_target
        - wind
        - crashed
        output_ports:
        - state
        - rotor_speed
        - acceleration

    A point mass with attitude: it is moved by the thrust of its rotors, gravity and drag as a `Quadrotor` is
    (`drake_quad.vehicle.dynamics`), and turned towards the `attitude_target`, of which thrust and body rates
    do not count here. Inertia and single rotors count for nothing but the sum of the thrusts.

    Ports, time steps, faults and what is not connected are as for a `Quadrotor`; the discrete state is in the groups
    `state`, a `RespondingBody`, and `rotor_speed`, the continuous one is a `RespondingState`. The parameters of the
    context are `parameters`, `response`, for a vehicle that is faulty `faults`, and, if any are on, `effects`.

    Args:
        num_vehicles: N.
        time_step: h in seconds, 10 ms by default; 0 for a continuous state.
        kinematics: "exact", or "small_angle", by which body rates are the rates of the angles.
        faulty: whether rotors may have faults.
        effects: names of those that are switched on, out of `RESPONDING_EFFECTS`.
        numbers: of the vehicles.

    Raises:
        ValueError: an effect has no numbers, or is not known here.
    """

    def declare(
        self,
        *,
        time_step: float = 0.01,
        kinematics: Kinematics = "exact",
        faulty: bool = False,
        effects: tuple[str, ...] = (),
        numbers: RespondingNumbers,
    ) -> None:
        """Declares the system."""
        unknown = set(effects).difference(RESPONDING_EFFECTS)
        if unknown:
            raise ValueError(f"an attitude that responds as a whole knows no {', '.join(sorted(unknown))}")
        self.time_step = time_step
        parameters = self.parameter("parameters", lambda numbers: numbers.vehicle.parameters)
        response = self.parameter("response", lambda numbers: numbers.response)
        faults = self.parameter("faults", lambda numbers: numbers.vehicle.faults) if faulty else None
        command = self.input("throttle_command" if "thrust_curve" in effects else "rotor_speed_command")
        target = self.input("attitude_target")
        inputs = command, target, self.input("wind", absent=Wind(0.0, 0.0, 0.0)), self.input("crashed")
        acting: Any = NO_EFFECTS
        if effects:
            acting = self.parameter("effects", lambda numbers: numbers.vehicle.effects.only(effects))
        constants = parameters, response, faults, acting, TIME if faulty else 0.0
        body_rates = _BODY_RATES[kinematics]
        if time_step > 0.0:
            body = self.state("state", lambda numbers: _begun(numbers).body)
            rotors = self.state("rotor_speed", lambda numbers: _begun(numbers).rotors)
            reads = body, rotors, *inputs, *constants, time_step, kinematics
            self.update(time_step, responding_step, *reads, writes=[body, rotors], unrestricted=True, at_start=False)
            self.output("state", shown_state, body, body_rates)
            self.state_output(rotors)
            self.output("acceleration", stepping_acceleration, body, rotors, *inputs, *constants, kinematics)
        else:
            state = self.continuous_state(_begun)
            self.derivative(responding_slope, state, *inputs, *constants, kinematics)
            self.output("state", _shown, state, body_rates)
            self.output("rotor_speed", getattr, state, "rotors")
            self.output("acceleration", acceleration_of, state, *inputs, *constants, kinematics)
