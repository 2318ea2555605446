"""Betaflight as the flight controller of a vehicle."""

import math

import numpy as np

from drake_quad.firmware.betaflight.flight_controller import PITCH, ROLL, THROTTLE, YAW
from drake_quad.firmware.betaflight.messages import Sensors
from drake_quad.firmware.betaflight.mixers import mixer_of
from drake_quad.firmware.betaflight.settings import armed, configured
from drake_quad.firmware.betaflight.sticks import StickTable
from drake_quad.firmware.motors import motors_of_rotors, rotor_commands
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.sticks import PulseTable

_HOVER_TIME = 1.0  # s for which the sticks command hover before a flight begins, so that all filters have settled


class BetaflightController:
    """Flight controller of one vehicle with Betaflight, armed and commanded to hover.

    The inputs are the rows of a `FlightControllerInput`. The outputs are the scaled commands of the rotors.

    Args:
        options: options of the flight controller.
        vehicle: number of the vehicle in the fleet.
        inputs: inputs at the start of the flight.

    Attributes:
        initial_commands: (4,) scaled commands of rotors 1 to 4 before the first step.

    Raises:
        FirmwareError: if the firmware fails.
        ImportError: if Betaflight is not installed.
        InputError: if the firmware refuses the settings, or the settings do not fit the vehicle.
    """

    def __init__(self, options: FlightControllerOptions, vehicle: int, inputs: np.ndarray) -> None:
        configuration = configured(options.settings)
        values = configuration.settings.values
        self._options = options
        motors_reversed = values["yaw_motors_reversed"] == "ON"
        self._motors = motors_of_rotors(
            options.rotors,
            mixer_of(configuration.settings.mixer, motors_reversed=motors_reversed),
            shape_advice="add the line `mixer QUADX` or `mixer QUADP` to laboratory.autopilot.settings",
            turns_advice=(
                f"add the line `set yaw_motors_reversed = {'OFF' if motors_reversed else 'ON'}` to"
                " laboratory.autopilot.settings"
            ),
        )
        roll, pitch, yaw = (StickTable.of(values, axis) for axis in ("roll", "pitch", "yaw"))
        if options.mode == "angle":
            max_angle = math.radians(float(values["angle_limit"]))
            roll_range = pitch_range = max_angle
        else:
            roll_range, pitch_range = math.radians(roll.max_rate), math.radians(pitch.max_rate)
        # To the right, the yaw stick commands a negative yaw rate.
        yaw_range = math.radians(yaw.max_rate) * (1.0 if values["yaw_control_reversed"] == "ON" else -1.0)
        self._roll, self._pitch, self._yaw = (
            PulseTable(stick.fractions * size, stick.pulses)
            for stick, size in ((roll, roll_range), (pitch, pitch_range), (yaw, yaw_range))
        )
        self._throttle = PulseTable(configuration.motor_commands, configuration.throttle_pulses)
        self._firmware = armed(configuration.file, configuration.settings, is_angle_mode=options.mode == "angle")
        self._set_sticks(0.0, 0.0, 0.0, options.hover_command)
        self.initial_commands = self._rotor_commands(self._firmware.run(_HOVER_TIME))

    def send(self, inputs: np.ndarray) -> None:
        """Start a step, given the inputs.

        Raises:
            FirmwareError: if the firmware has ended.
        """
        (p, q, r, f_x, f_y, f_z, q_w, q_x, q_y, q_z, v_x, v_y, v_z, _, _, z, pressure, *sticks) = inputs.tolist()
        self._firmware.sensors = Sensors(
            (p, -q, -r), (-f_x, -f_y, -f_z), (q_w, q_x, -q_y, -q_z), (v_x, v_y, v_z), (0.0, 0.0, z), pressure
        )
        self._set_sticks(*sticks)
        self._firmware.send(self._options.period)

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) scaled commands of rotors 1 to 4 at the end of a step.

        Raises:
            FirmwareError: if the firmware has ended, does not answer, or its motor commands are not between 0 and 1.
        """
        return self._rotor_commands(self._firmware.receive())

    def _rotor_commands(self, motors: tuple[float, ...]) -> tuple[float, ...]:
        return rotor_commands(motors, self._motors, self._options.scale)

    def close(self) -> None:
        """Stop the firmware."""
        self._firmware.close()

    def _set_sticks(self, roll: float, pitch: float, yaw_rate: float, motor: float) -> None:
        channels = self._firmware.channels
        channels[ROLL], channels[PITCH] = self._roll.pulse(roll), self._pitch.pulse(pitch)
        channels[THROTTLE], channels[YAW] = self._throttle.pulse(motor), self._yaw.pulse(yaw_rate)
