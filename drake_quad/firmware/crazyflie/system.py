"""The Crazyflie's firmware as the flight controller of a vehicle."""

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np

from drake_quad.errors import InputError
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.crazyflie.server import REPLY, REQUEST
from drake_quad.firmware.motors import X_ANGLE, Mixer, Motor, motors_of_rotors, rotor_commands
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.pilot import FlightControllerInput
from drake_quad.firmware.process import LockstepProcess
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE

_NAME = "The Crazyflie's firmware"
MIXER = Mixer(
    (Motor(-45.0, ANTICLOCKWISE), Motor(-135.0, CLOCKWISE), Motor(135.0, ANTICLOCKWISE), Motor(45.0, CLOCKWISE)),
    X_ANGLE,
)
_TICK = 0.001  # s; period of the firmware's main loop
_ROUNDING = 1e-6  # largest rounding error of a time, in ticks


class CrazyflieController:
    """Flight controller of one vehicle with a controller of the Crazyflie's firmware.

    The inputs are the rows of a `FlightControllerInput`. The outputs are the scaled commands of the rotors. The
    firmware commands thrusts, which are proportional to squared rotor speeds.

    Args:
        options: options of the flight controller. The settings are the names of the controller and of the estimator.
        vehicle: number of the vehicle in the fleet.
        inputs: inputs at the start of the flight.

    Attributes:
        initial_commands: (4,) scaled commands of rotors 1 to 4 before the first step.

    Raises:
        FirmwareError: if the firmware fails.
        InputError: if `cffirmware` cannot be imported, or the rotors do not fit the firmware.
    """

    def __init__(self, options: FlightControllerOptions, vehicle: int, inputs: np.ndarray) -> None:
        self._options = options
        self._motors = motors_of_rotors(
            options.rotors,
            MIXER,
            shape_advice="choose a layout of kind x",
            turns_advice="change rotor_1_turns in nominal.layout",
        )
        self._process = LockstepProcess(
            [sys.executable, str(Path(__file__).with_name("server.py")), *options.settings],
            _NAME,
            environment={"PYTHONPATH": str(_bindings_folder()), "PYTHONDONTWRITEBYTECODE": "1"},
        )
        self._process.receive()
        self._time, self._ticks = 0.0, 0
        thrust = self._thrust(options.hover_command)
        self.initial_commands = rotor_commands([self._command(thrust)] * 4, self._motors, options.scale)

    def send(self, inputs: np.ndarray) -> None:
        """Start a step, given the inputs.

        Raises:
            FirmwareError: if the firmware has ended.
        """
        given = FlightControllerInput._make(inputs.tolist())
        self._time += self._options.period
        ticks = math.floor(self._time / _TICK + _ROUNDING) - self._ticks
        self._ticks += ticks
        motion = *given[:10], given.x, given.y, given.z
        commands = given.roll, given.pitch, given.yaw_rate, self._thrust(given.motor)
        self._process.send(REQUEST.pack(ticks, self._options.mode == "acro", *motion, *commands))

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) scaled commands of rotors 1 to 4 at the end of a step.

        Raises:
            FirmwareError: if the firmware has ended or does not answer.
        """
        reply = self._process.receive()
        if len(reply) != REPLY.size:
            self.close()
            raise FirmwareError(
                f"{_NAME} sent {len(reply)} bytes instead of {REPLY.size}; build its Python bindings again"
            )
        commands = [self._command(thrust) for thrust in REPLY.unpack(reply)]
        return rotor_commands(commands, self._motors, self._options.scale)

    def close(self) -> None:
        """Stop the firmware."""
        self._process.close()

    def _thrust(self, command: float) -> float:
        """Return the thrust relative to the largest thrust, given the motor command."""
        return command if self._options.commands_throttle else command * command

    def _command(self, thrust: float) -> float:
        """Return the motor command for a thrust relative to the largest thrust."""
        return thrust if self._options.commands_throttle else math.sqrt(thrust)


def _bindings_folder() -> Path:
    """Return the folder that contains the firmware's bindings.

    Raises:
        InputError: if there are no bindings.
    """
    found = importlib.util.find_spec("cffirmware")
    if found is None or found.origin is None:
        raise InputError(
            "cffirmware is not installed; build it in a checkout of the Crazyflie's firmware by `make cf2_defconfig`"
            " and `make bindings_python`, and add the folder build to PYTHONPATH"
        )
    return Path(found.origin).parent
