"""ArduPilot as the flight controller of a vehicle."""

import math

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.firmware.ardupilot.connection import ArduPilotConnection
from drake_quad.firmware.ardupilot.messages import Motion
from drake_quad.firmware.motors import PLUS_ANGLE, X_ANGLE, Mixer, Motor, motors_of_rotors, rotor_commands
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.pilot import FlightControllerInput
from drake_quad.firmware.sticks import PulseTable
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE

# Motors of ArduPilot's frames of class quad, by the parameter FRAME_TYPE.
_MIXERS = {
    0: Mixer(
        (Motor(-90.0, ANTICLOCKWISE), Motor(90.0, ANTICLOCKWISE), Motor(0.0, CLOCKWISE), Motor(180.0, CLOCKWISE)),
        PLUS_ANGLE,
    ),
    1: Mixer(
        (Motor(-45.0, ANTICLOCKWISE), Motor(135.0, ANTICLOCKWISE), Motor(45.0, CLOCKWISE), Motor(-135.0, CLOCKWISE)),
        X_ANGLE,
    ),
}
DEFAULT_PARAMETERS = {
    "FRAME_TYPE": 1.0,
    "ANGLE_MAX": 4500.0,  # hundredths of a degree
    "ACRO_RP_RATE": 360.0,  # °/s
    "ACRO_Y_RATE": 202.5,  # °/s
    "PILOT_Y_RATE": 202.5,  # °/s
}
"""Parameters on which the positions of the sticks depend, with their values in diagrams/firmware/ardupilot.param."""
_STANDARD_GRAVITY = 9.80665  # m/s²
_LOW, _MIDDLE, _HIGH = 1000, 1500, 2000  # µs
# Channels from 1 on: roll, pitch, throttle, yaw, flight mode, one that is not used, and the switch that arms.
_RESTING_CHANNELS = (_MIDDLE, _MIDDLE, _LOW, _MIDDLE, _LOW, _LOW, _LOW, _LOW)
_ROLL, _PITCH, _THROTTLE, _YAW, _MODE, _ARM = 0, 1, 2, 3, 4, 6
_ALIGNMENT_TIME = 20.0  # s until the attitude estimator has aligned itself
_ARMING_TIME = 3.0  # s until the motors turn at idle speed
_THROTTLE_PULSES = np.arange(1000.0, 2001.0, 50.0)  # µs; positions of the stick in the throttle calibration
_SETTLING_TIME = 0.3  # s until the motors have settled at each position
_HOVER_TIME = 1.0  # s for which the sticks command hover before the flight begins


def parameters_of(lines: tuple[str, ...]) -> dict[str, float]:
    """Return the parameters on which the sticks depend, given the lines of a parameter file of ArduPilot.

    A line contains the name and the value of a parameter, separated by a comma or by spaces.

    Raises:
        InputError: if a line has another format.
    """
    parameters = dict(DEFAULT_PARAMETERS)
    for line in lines:
        name, *values = line.replace(",", " ").split("#")[0].split() or [""]
        if not name:
            continue
        try:
            (value,) = map(float, values)
        except ValueError:
            raise InputError(
                f"laboratory.autopilot.parameters: the line {short_repr(line)} must contain the name and the value of a"
                " parameter"
            ) from None
        if name in parameters:
            parameters[name] = value
    return parameters


class ArduPilotController:
    """Flight controller of one vehicle with ArduPilot, armed and commanded to hover.

    The inputs are the rows of a `FlightControllerInput`. The outputs are the scaled commands of the rotors.

    Args:
        options: options of the flight controller. Vehicle i of a fleet uses `options.port + 10 i`, as ArduPilot's
            instances do.
        vehicle: number of the vehicle in the fleet.
        inputs: inputs at the start of the flight.

    Attributes:
        initial_commands: (4,) scaled commands of rotors 1 to 4 before the first step.

    Raises:
        FirmwareError: if ArduPilot does not connect or does not answer.
        InputError: if the frame of ArduPilot does not fit the vehicle, or it does not arm.
    """

    def __init__(self, options: FlightControllerOptions, vehicle: int, inputs: np.ndarray) -> None:
        parameters = parameters_of(options.settings)
        mixer = _MIXERS.get(int(parameters["FRAME_TYPE"]))
        if mixer is None:
            raise InputError("laboratory.autopilot.parameters: FRAME_TYPE must be 0 (plus) or 1 (x)")
        self._options = options
        self._motors = motors_of_rotors(
            options.rotors,
            mixer,
            shape_advice="set FRAME_TYPE to 0 (plus) or 1 (x) in ArduPilot and in laboratory.autopilot.parameters",
            turns_advice="change the directions of rotation in nominal.layout",
        )
        angle, acro = math.radians(0.01 * parameters["ANGLE_MAX"]), math.radians(parameters["ACRO_RP_RATE"])
        is_angle_mode = options.mode == "angle"
        largest = angle if is_angle_mode else acro
        yaw_rate = math.radians(parameters["PILOT_Y_RATE" if is_angle_mode else "ACRO_Y_RATE"])
        ends = np.array([float(_LOW), float(_HIGH)])
        self._roll = PulseTable(np.array([-largest, largest]), ends)
        # ArduPilot's pitch is positive if the nose is up, and its yaw rate if the vehicle turns to the right.
        self._pitch = PulseTable(np.array([largest, -largest]), ends)
        self._yaw = PulseTable(np.array([yaw_rate, -yaw_rate]), ends)
        self._channels = list(_RESTING_CHANNELS)
        self._channels[_MODE] = _LOW if is_angle_mode else _HIGH
        self._steps = 0
        self._connection = ArduPilotConnection(options.port + 10 * vehicle)
        try:
            self.initial_commands = self._take_off(FlightControllerInput._make(inputs.tolist()))
        except BaseException:
            self.close()
            raise

    def _take_off(self, start: FlightControllerInput) -> tuple[float, ...]:
        """Arm the vehicle, measure its throttle curve, command hover, and return the commands of the rotors.

        ArduPilot receives the motion of a vehicle that rests at the position and yaw of the start.
        """
        yaw = math.atan2(
            2.0 * (start.q_w * start.q_z + start.q_x * start.q_y), 1.0 - 2.0 * (start.q_y**2 + start.q_z**2)
        )
        self._motion = Motion(
            (0.0, 0.0, 0.0),
            (0.0, 0.0, -_STANDARD_GRAVITY),
            (start.x, -start.y, -start.z),
            (math.cos(0.5 * yaw), 0.0, 0.0, -math.sin(0.5 * yaw)),
            (0.0, 0.0, 0.0),
        )
        self._run(_ALIGNMENT_TIME)
        self._channels[_ARM] = _HIGH
        self._run(_ARMING_TIME)
        commands = []
        for pulse in _THROTTLE_PULSES:
            self._channels[_THROTTLE] = round(pulse)
            commands.append(float(np.mean(self._run(_SETTLING_TIME))))
        if not commands[-1] > commands[0]:
            raise InputError(
                "ArduPilot does not arm, or its motors do not follow the throttle stick; start it with the parameters"
                " in diagrams/firmware/ardupilot.param"
            )
        self._throttle = PulseTable(np.maximum.accumulate(commands), _THROTTLE_PULSES)
        self._set_sticks(0.0, 0.0, 0.0, self._options.hover_command)
        return self._scaled(self._run(_HOVER_TIME))

    def send(self, inputs: np.ndarray) -> None:
        """Start a step, given the inputs.

        Raises:
            FirmwareError: if ArduPilot cannot be reached.
        """
        (p, q, r, f_x, f_y, f_z, q_w, q_x, q_y, q_z, v_x, v_y, v_z, x, y, z, _, *sticks) = inputs.tolist()
        self._motion = Motion((p, -q, -r), (f_x, -f_y, -f_z), (x, -y, -z), (q_w, q_x, -q_y, -q_z), (v_x, -v_y, -v_z))
        self._set_sticks(*sticks)
        self._send()

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) scaled commands of rotors 1 to 4 at the end of a step.

        Raises:
            FirmwareError: if ArduPilot does not answer, or its motor commands are not between 0 and 1.
        """
        return self._scaled(self._connection.receive())

    def close(self) -> None:
        """Close the connection to ArduPilot."""
        self._connection.close()

    def _run(self, duration: float) -> tuple[float, ...]:
        """Run for a duration (s) with constant inputs, and return the motor commands at the end."""
        motors: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
        for _ in range(round(duration / self._options.period)):
            self._send()
            motors = self._connection.receive()
        return motors

    def _send(self) -> None:
        self._steps += 1
        self._connection.send(self._steps * self._options.period, self._motion, self._channels)

    def _scaled(self, motors: tuple[float, ...]) -> tuple[float, ...]:
        return rotor_commands(motors, self._motors, self._options.scale)

    def _set_sticks(self, roll: float, pitch: float, yaw_rate: float, motor: float) -> None:
        channels = self._channels
        channels[_ROLL], channels[_PITCH] = self._roll.pulse(roll), self._pitch.pulse(pitch)
        channels[_THROTTLE], channels[_YAW] = self._throttle.pulse(motor), self._yaw.pulse(yaw_rate)
