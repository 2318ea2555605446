"""Firmware that a user starts, and that the simulation flies with the channels of a remote control."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.firmware.motors import rotor_commands
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.pilot import FlightControllerInput
from drake_quad.firmware.sticks import PulseTable

ADDRESS = "127.0.0.1"
"""Address at which a firmware finds the simulation. Only programs on this computer can reach it."""
START_TIMEOUT = 60.0
"""Real time for which a flight waits for the firmware, s."""
STEP_TIMEOUT = 20.0
"""Real time for which a step waits for the firmware, s."""

_STANDARD_GRAVITY = 9.80665  # m/s²
_LOW, _MIDDLE, _HIGH = 1000, 1500, 2000  # µs
_ENDS = np.array([float(_LOW), float(_HIGH)])
# Channels from 1 on: roll, pitch, throttle, yaw, flight mode, one that is not used, the switch that arms, and another
# that is not used.
_RESTING_CHANNELS = (_MIDDLE, _MIDDLE, _LOW, _MIDDLE, _LOW, _LOW, _LOW, _LOW)
_ROLL, _PITCH, _THROTTLE, _YAW, _MODE, _ARM = 0, 1, 2, 3, 4, 6
_ALIGNMENT_TIME = 20.0  # s until the attitude estimator has aligned itself
_ARMING_TIME = 3.0  # s until the motors turn at idle speed
_THROTTLE_PULSES = np.arange(1000.0, 2001.0, 50.0)  # µs; positions of the stick in the throttle calibration
_SETTLING_TIME = 0.3  # s until the motors have settled at each position
_HOVER_TIME = 1.0  # s for which the sticks command hover before the flight begins


class Motion(NamedTuple):
    """Motion of the vehicle, with the axes forward, right and down, and north, east and down.

    Attributes:
        gyro: body rates, rad/s.
        accel_body: specific force along the axes of the body, m/s².
        position: position north, east and down, m.
        quaternion: rotation (w, x, y, z) from the axes of the body to north, east and down.
        velocity: velocity north, east and down, m/s.
        pressure: pressure of the air, Pa.
    """

    gyro: tuple[float, float, float]
    accel_body: tuple[float, float, float]
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    velocity: tuple[float, float, float]
    pressure: float


class StickRanges(NamedTuple):
    """Commands at the largest pulse widths; at the smallest pulse widths, they have the opposite sign.

    Attributes:
        roll: roll (rad) or body rate (rad/s), positive to the right.
        pitch: pitch (rad) or body rate (rad/s), positive if the nose goes down.
        yaw_rate: yaw rate (rad/s), positive to the left.
    """

    roll: float
    pitch: float
    yaw_rate: float


class Connection(Protocol):
    """Connection to a firmware, which answers every message with the commands of its motors."""

    def send(self, time: float, motion: Motion, channels: Sequence[int]) -> None:
        """Send the motion of the vehicle and the channels of the remote control (µs) at a time of the simulation, s.

        Raises:
            FirmwareError: if the firmware cannot be reached.
        """

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) motor commands that the firmware computes from the last message, from 0 to 1.

        Raises:
            FirmwareError: if the firmware does not answer.
        """

    def close(self) -> None:
        """Close the connection."""


def parameters_of(
    lines: Sequence[str], defaults: Mapping[str, float], fields: Callable[[str], Sequence[str]]
) -> dict[str, float]:
    """Return the parameters on which the sticks depend, given the lines of a parameter file.

    Args:
        lines: lines of the file. Empty lines, and lines that begin with #, are ignored.
        defaults: default of each parameter; other parameters are ignored.
        fields: function that returns the name and the value in a line, as texts.

    Raises:
        InputError: if a line has another format.
    """
    parameters = dict(defaults)
    for line in lines:
        text = line.split("#")[0].strip()
        if not text:
            continue
        try:
            name, value = fields(text)
            number = float(value)
        except ValueError:
            raise InputError(
                f"laboratory.autopilot.parameters: the line {short_repr(line)} must contain the name and the value of a"
                " parameter"
            ) from None
        if name in parameters:
            parameters[name] = number
    return parameters


class RemoteControlledFirmware:
    """Flight controller of one vehicle that is flown with the channels of a remote control, armed and in hover.

    Before the flight, the firmware receives the motion of a vehicle that rests at the start. It aligns its attitude
    estimate and is armed. The motor commands at 21 positions of the throttle stick are measured, and the sticks command
    hover for a second.

    The inputs are the rows of a `FlightControllerInput`. The outputs are the scaled commands of the rotors.

    Args:
        options: options of the flight controller.
        inputs: inputs at the start of the flight.
        connection: connection to the firmware, which `close` closes.
        motors: index of the firmware's motor for each rotor.
        ranges: commands at the largest pulse widths.
        not_armed: error message if the motors do not follow the throttle stick.

    Attributes:
        initial_commands: (4,) scaled commands of rotors 1 to 4 before the first step.

    Raises:
        FirmwareError: if the firmware does not answer.
        InputError: if the firmware does not arm.
    """

    def __init__(
        self,
        options: FlightControllerOptions,
        inputs: np.ndarray,
        *,
        connection: Connection,
        motors: tuple[int, ...],
        ranges: StickRanges,
        not_armed: str,
    ) -> None:
        self._options, self._connection, self._motors = options, connection, motors
        self._roll, self._pitch, self._yaw = (PulseTable(np.array([-end, end]), _ENDS) for end in ranges)
        self._channels = list(_RESTING_CHANNELS)
        self._channels[_MODE] = _LOW if options.mode == "angle" else _HIGH
        self._steps = 0
        try:
            self.initial_commands = self._take_off(FlightControllerInput._make(inputs.tolist()), not_armed)
        except BaseException:
            self.close()
            raise

    def _take_off(self, start: FlightControllerInput, not_armed: str) -> tuple[float, ...]:
        """Arm the vehicle, measure its throttle curve, command hover, and return the commands of the rotors."""
        yaw = math.atan2(
            2.0 * (start.q_w * start.q_z + start.q_x * start.q_y), 1.0 - 2.0 * (start.q_y**2 + start.q_z**2)
        )
        self._motion = Motion(
            (0.0, 0.0, 0.0),
            (0.0, 0.0, -_STANDARD_GRAVITY),
            (start.x, -start.y, -start.z),
            (math.cos(0.5 * yaw), 0.0, 0.0, -math.sin(0.5 * yaw)),
            (0.0, 0.0, 0.0),
            start.pressure,
        )
        self._run(_ALIGNMENT_TIME)
        self._channels[_ARM] = _HIGH
        self._run(_ARMING_TIME)
        commands = []
        for pulse in _THROTTLE_PULSES:
            self._channels[_THROTTLE] = round(pulse)
            commands.append(float(np.mean(self._run(_SETTLING_TIME))))
        if not commands[-1] > commands[0]:
            raise InputError(not_armed)
        self._throttle = PulseTable(np.maximum.accumulate(commands), _THROTTLE_PULSES)
        self._set_sticks(0.0, 0.0, 0.0, self._options.hover_command)
        return self._scaled(self._run(_HOVER_TIME))

    def send(self, inputs: np.ndarray) -> None:
        """Start a step, given the inputs.

        Raises:
            FirmwareError: if the firmware cannot be reached.
        """
        (p, q, r, f_x, f_y, f_z, q_w, q_x, q_y, q_z, v_x, v_y, v_z, x, y, z, pressure, *sticks) = inputs.tolist()
        self._motion = Motion(
            (p, -q, -r), (f_x, -f_y, -f_z), (x, -y, -z), (q_w, q_x, -q_y, -q_z), (v_x, -v_y, -v_z), pressure
        )
        self._set_sticks(*sticks)
        self._send()

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) scaled commands of rotors 1 to 4 at the end of a step.

        Raises:
            FirmwareError: if the firmware does not answer, or its motor commands are not between 0 and 1.
        """
        return self._scaled(self._connection.receive())

    def close(self) -> None:
        """Close the connection to the firmware."""
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
