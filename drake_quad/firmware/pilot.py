"""Inputs of a flight controller: motion of the vehicle, and commands of a pilot that follow from an attitude target.

In angle mode, the firmware controls roll and pitch. In acro mode it controls the body rates, and an attitude loop on a
companion computer follows the commanded attitude. The stick for the yaw commands a rate in both modes, so the pilot
controls the yaw angle.
"""

from typing import Annotated, Literal, NamedTuple

from drake_quad.framework.elementary import exp, maximum, sqrt, wrap_angle
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.laboratory.sensors.accelerometer import SpecificForce, specific_force
from drake_quad.laboratory.sensors.mounting import SensorPosition
from drake_quad.signals import (
    SIGNALS,
    AccelerationB,
    AngleRate,
    AttitudeTarget,
    BodyRateB,
    BodyRates,
    Gain,
    Number,
    PositionW,
    Quantity,
    Row,
    State,
    VehicleAcceleration,
    VelocityW,
)
from drake_quad.vehicle.motors import ThrustCurve, throttle_from_thrust

Mode = Literal["angle", "acro"]
"""Flight modes of firmware for pilots."""

# Pressure of the standard atmosphere at sea level, and the height over which it falls by a factor of e (ISO 2533).
_SEA_LEVEL_PRESSURE = 101_325.0  # Pa
_SCALE_HEIGHT = 8434.5  # m; R T / g for dry air of 15 °C


class FlightControllerInput(NamedTuple):
    """Input of a flight controller in a step: readings of sensors, motion of the vehicle, and commands of the pilot.

    Attributes:
        p: measured body rate about x.
        q: measured body rate about y.
        r: measured body rate about z.
        f_x: measured specific force along x.
        f_y: measured specific force along y.
        f_z: measured specific force along z.
        q_w: first component of the quaternion of the attitude.
        q_x: second component of the quaternion.
        q_y: third component of the quaternion.
        q_z: fourth component of the quaternion.
        v_x: velocity along X.
        v_y: velocity along Y.
        v_z: velocity along Z.
        x: position along X.
        y: position along Y.
        z: position along Z.
        pressure: pressure of the air.
        roll: commanded roll in angle mode (rad), or body rate about x in acro mode (rad/s).
        pitch: commanded pitch in angle mode (rad), or body rate about y in acro mode (rad/s).
        yaw_rate: commanded body rate about z.
        motor: commanded mean of the motor commands; 1 is the largest thrust.
    """

    p: BodyRateB
    q: BodyRateB
    r: BodyRateB
    f_x: AccelerationB
    f_y: AccelerationB
    f_z: AccelerationB
    q_w: Number
    q_x: Number
    q_y: Number
    q_z: Number
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW
    x: PositionW
    y: PositionW
    z: PositionW
    pressure: Annotated[Row, Quantity("Pa")]
    roll: Number
    pitch: Number
    yaw_rate: AngleRate
    motor: Number


SIGNALS["flight_controller_input"] = FlightControllerInput


class PilotParameters(NamedTuple):
    """Parameters of the pilot, who converts an attitude target to the commands of the sticks.

    Attributes:
        attitude_gain: gain from the error of roll or pitch to a body rate, for the acro mode.
        yaw_gain: gain from the error of the yaw to a yaw rate.
        thrust_factor: thrust factor b of a rotor; not used with a thrust curve.
        max_rotor_speed: rotor speed at the motor command 1; not used with a thrust curve.
        gravity: gravitational acceleration g.
        curve: thrust of a rotor as a function of the motor command; None if the rotor speed is proportional to the
            motor command.
    """

    attitude_gain: Gain
    yaw_gain: Gain
    thrust_factor: Annotated[Row, Quantity("N s²")]
    max_rotor_speed: AngleRate
    gravity: Annotated[Row, Quantity("m/s²")]
    curve: ThrustCurve | None = None


def motor_command(thrust: Annotated[Row, Quantity("N")], parameters: PilotParameters) -> Number:
    """Return the motor command with which four rotors produce a thrust without torques; 1 is the largest thrust."""
    rotor_thrust = 0.25 * maximum(thrust, 0.0)
    if parameters.curve is not None:
        return throttle_from_thrust(rotor_thrust, parameters.curve)
    return sqrt(rotor_thrust / parameters.thrust_factor) / parameters.max_rotor_speed


def rate_command(
    target: AttitudeTarget, state: State, attitude_gain: Gain, yaw_gain: Gain, follows_attitude: bool
) -> BodyRates:
    """Return the body rates that an attitude target commands.

    Args:
        target: attitude target.
        state: motion of the vehicle.
        attitude_gain: gain from the error of roll or pitch to a body rate.
        yaw_gain: gain from the error of the yaw to a yaw rate.
        follows_attitude: False if body rates are commanded without an attitude.
    """
    if not follows_attitude:
        return BodyRates(target.p, target.q, target.r)
    return BodyRates(
        target.p + attitude_gain * (target.roll - state.roll),
        target.q + attitude_gain * (target.pitch - state.pitch),
        target.r + yaw_gain * wrap_angle(target.yaw - state.yaw),
    )


def flight_controller_input(
    target: AttitudeTarget,
    state: State,
    acceleration: VehicleAcceleration,
    gyroscope: BodyRates | None,
    accelerometer: SpecificForce | None,
    parameters: PilotParameters,
    mode: Mode,
    follows_attitude: bool,
) -> FlightControllerInput:
    """Return the input of a flight controller.

    Args:
        target: attitude target that arrived over the command link.
        state: motion of the vehicle, true or estimated.
        acceleration: acceleration of the vehicle.
        gyroscope: reading of the gyroscope; None to use the rates in `state`.
        accelerometer: reading of the accelerometer; None to compute the specific force from the acceleration.
        parameters: parameters of the pilot.
        mode: flight mode.
        follows_attitude: False if body rates are commanded without an attitude.
    """
    rates = BodyRates(state.p, state.q, state.r) if gyroscope is None else gyroscope
    force = accelerometer
    if force is None:
        force = SpecificForce(*specific_force(state, acceleration, SensorPosition(), parameters.gravity))
    q_w, q_x, q_y, q_z = Quaternion.of(state.roll, state.pitch, state.yaw)
    roll, pitch, yaw_rate = rate_command(target, state, parameters.attitude_gain, parameters.yaw_gain, follows_attitude)
    if mode == "angle":
        roll, pitch = target.roll, target.pitch
    return FlightControllerInput(
        *rates,
        *force,
        q_w,
        q_x,
        q_y,
        q_z,
        state.v_x,
        state.v_y,
        state.v_z,
        state.x,
        state.y,
        state.z,
        _SEA_LEVEL_PRESSURE * exp(-state.z / _SCALE_HEIGHT),
        roll,
        pitch,
        yaw_rate,
        motor_command(target.thrust, parameters),
    )


@fleet_system(float, AutoDiffXd)
class StickPilot(FleetSystem):
    """Pilot and sensors of a flight controller: its inputs from the motion of the vehicle and an attitude target.

    .. pydrake_system::

        name: StickPilot
        input_ports:
        - attitude_target
        - state
        - acceleration
        - gyroscope
        - accelerometer
        output_ports:
        - flight_controller_input

    `gyroscope` and `accelerometer` are readings of sensors. Without them, the firmware receives the rates in `state`
    and the exact specific force. The only parameter of the context is `pilot`.

    Args:
        num_vehicles: number N of vehicles.
        mode: flight mode.
        follows_attitude: False if body rates are commanded without an attitude.
        parameters: parameters of the pilot.
    """

    def declare(self, *, mode: Mode = "angle", follows_attitude: bool = True, parameters: PilotParameters) -> None:
        """Declare the ports and parameters of this system."""
        pilot = self.parameter("pilot", lambda parameters: parameters)
        motion = self.input("attitude_target"), self.input("state"), self.input("acceleration")
        gyroscope = self.input("gyroscope", layout=layout_of(BodyRates), absent=None)
        accelerometer = self.input("accelerometer", layout=layout_of(SpecificForce), absent=None)
        arguments = *motion, gyroscope, accelerometer, pilot, mode, follows_attitude
        self.output("flight_controller_input", flight_controller_input, *arguments)
