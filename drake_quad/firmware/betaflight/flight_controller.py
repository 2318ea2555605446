"""Betaflight on a simulated flight controller: start, command line, and steps."""

import contextlib
import socket
from typing import Any

from drake_quad.firmware.betaflight.installation import firmware_program, lockstep_library
from drake_quad.firmware.betaflight.messages import NUM_CHANNELS, Reply, Sensors, request, request_without_inputs
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.process import LockstepProcess

SETTINGS_FILE = "eeprom.bin"
"""File in which the firmware stores its settings."""
_NAME = "Betaflight"
_SERIAL_PORT = "serial_5761"  # socket of the first serial port, which answers to MSP and to the command line
_NS = 1_000_000_000  # nanoseconds in a second
_STEP = 0.001  # s; step while the vehicle does not fly
_PROMPT = "\n# "  # output of the command line when it waits for a command
_MAX_STEPS_PER_COMMAND = 5000  # the longest command, `dump all`, takes a few hundred steps
_MAX_SERIAL_BYTES = 65_536  # bytes that are read at once
_MAX_INITIALIZATION_STEPS = 10_000  # the initialization takes 500 steps
ROLL, PITCH, THROTTLE, YAW = 0, 1, 2, 3
"""Indices of the channels of the sticks."""
LOW_PULSE, MIDDLE_PULSE, HIGH_PULSE = 1000, 1500, 2000
"""Shortest, middle and longest pulse of a channel, µs."""
# Vehicle that rests on level ground, in standard gravity and at the pressure of the standard atmosphere at sea level.
_RESTING = Sensors(
    rates=(0.0, 0.0, 0.0),
    force=(0.0, 0.0, -9.80665),
    quaternion=(1.0, 0.0, 0.0, 0.0),
    velocity=(0.0, 0.0, 0.0),
    position=(0.0, 0.0, 0.0),
    pressure=101_325.0,
)


class Betaflight:
    """Process with Betaflight, whose time begins at 1 s.

    Args:
        settings: content of the file with the stored settings; None for the default settings.

    Attributes:
        folder: working folder of the process.
        sensors: state of the vehicle that the firmware receives in the next step.
        channels: (16,) pulse widths of the channels of the remote control in the next step, µs.

    Raises:
        FirmwareError: if the process cannot be started.
        ImportError: if the package `betaflight` is not installed.
        InputError: if there is no C compiler.
    """

    def __init__(self, settings: bytes | None = None) -> None:
        self._process = LockstepProcess(
            [str(firmware_program())],
            _NAME,
            environment={"LD_PRELOAD": str(lockstep_library())},
            files={} if settings is None else {SETTINGS_FILE: settings},
        )
        self.folder = self._process.folder
        self._serial: Any = None
        self.sensors = _RESTING
        self.channels = [MIDDLE_PULSE, MIDDLE_PULSE, LOW_PULSE, MIDDLE_PULSE, *[LOW_PULSE] * (NUM_CHANNELS - 4)]
        self._until = self._reply().now

    @property
    def time(self) -> float:
        """Time of the firmware, s."""
        return self._until / _NS

    def send(self, duration: float, *, runs_serial: bool = False) -> None:
        """Ask the firmware to run for a duration (s) with the current `sensors` and `channels`.

        Args:
            duration: duration, s.
            runs_serial: True to serve the serial ports too, which only the command line needs.

        Raises:
            FirmwareError: if the firmware has ended.
        """
        self._until += round(duration * _NS)
        self._process.send(request(self._until, self.sensors, self.channels, runs_serial=runs_serial))

    def receive(self) -> tuple[float, float, float, float]:
        """Return the (4,) commands of Betaflight's motors 1 to 4, from 0 to 1, at the end of a step.

        Raises:
            FirmwareError: if the firmware has ended or does not answer.
        """
        return self._reply().motors

    def run(self, duration: float) -> tuple[float, float, float, float]:
        """Run for a duration (s) in steps of 1 ms with constant inputs, and return the motor commands at the end."""
        motors = (0.0, 0.0, 0.0, 0.0)
        for _ in range(round(duration / _STEP)):
            self.send(_STEP)
            motors = self.receive()
        return motors

    def initialize(self) -> None:
        """Run the initialization, in which the firmware loses its receiver if channels are sent before the end.

        Raises:
            FirmwareError: if the initialization does not end.
        """
        for _ in range(_MAX_INITIALIZATION_STEPS):
            self._until += round(_STEP * _NS)
            self._process.send(request_without_inputs(self._until))
            reply = self._reply()
            if reply.is_running:
                self._until = reply.now
                return
        raise FirmwareError(f"{_NAME} did not finish its initialization")

    def open_command_line(self) -> None:
        """Open the command line of the firmware. The vehicle then cannot be armed before a restart.

        Raises:
            FirmwareError: if the command line does not open.
        """
        self._serial = socket.socket(socket.AF_UNIX)
        self._serial.connect(str(self.folder / _SERIAL_PORT))
        self._serial.setblocking(False)
        # The firmware tells a request for the command line from binary data by a pause after the character #.
        self._answer("#")

    def command(self, line: str) -> str:
        """Execute a command on the command line, and return what it prints.

        Raises:
            FirmwareError: if the firmware does not finish the command.
        """
        printed = self._answer(f"{line}\n").replace("\r", "")
        _, _, result = printed.partition("\n")  # the first line repeats the command
        return result.removesuffix(_PROMPT).strip()

    def saved_settings(self) -> bytes:
        """Store the settings, and return the content of the file that contains them."""
        self.command("save noreboot")
        return (self.folder / SETTINGS_FILE).read_bytes()

    def _answer(self, text: str) -> str:
        self._serial.sendall(text.encode())
        answer = ""
        for _ in range(_MAX_STEPS_PER_COMMAND):
            self.send(_STEP, runs_serial=True)
            self.receive()
            with contextlib.suppress(BlockingIOError):
                answer += self._serial.recv(_MAX_SERIAL_BYTES).decode(errors="replace")
            if answer.endswith(_PROMPT):
                return answer
        raise FirmwareError(f"{_NAME} did not answer to {text.strip()!r} on its command line")

    def close(self) -> None:
        """Stop the firmware."""
        if self._serial is not None:
            self._serial.close()
        self._process.close()

    def _reply(self) -> Reply:
        message = self._process.receive()
        reply = Reply.of(message)
        if reply is None:
            self.close()
            raise FirmwareError(
                f"{_NAME} sent {len(message)} bytes that are no reply; install the package betaflight again"
            )
        return reply
