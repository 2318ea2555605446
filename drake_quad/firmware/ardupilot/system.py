"""ArduPilot as the flight controller of a vehicle."""

import math
from collections.abc import Sequence

import numpy as np

from drake_quad.errors import InputError
from drake_quad.firmware.ardupilot.connection import ArduPilotConnection
from drake_quad.firmware.motors import PLUS_ANGLE, X_ANGLE, Mixer, Motor, motors_of_rotors
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.remote_control import RemoteControlledFirmware, StickRanges, parameters_of
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


def fields_of(line: str) -> Sequence[str]:
    """Return the name and the value in a line of a parameter file, which are separated by a comma or by spaces.

    ArduPilot 4.7 calls ANGLE_MAX (hundredths of a degree) ATC_ANGLE_MAX (degrees).
    """
    words = line.replace(",", " ").split()
    if words[0] == "ATC_ANGLE_MAX":
        return "ANGLE_MAX", *[str(100.0 * float(value)) for value in words[1:]]
    return words


class ArduPilotController(RemoteControlledFirmware):
    """Flight controller of one vehicle with ArduPilot, armed and commanded to hover.

    Args:
        options: options of the flight controller. Vehicle i of a fleet uses `options.port + 10 i`, as ArduPilot's
            instances do.
        vehicle: number of the vehicle in the fleet.
        inputs: inputs at the start of the flight.

    Raises:
        FirmwareError: if ArduPilot does not connect or does not answer.
        InputError: if the frame of ArduPilot does not fit the vehicle, or it does not arm.
    """

    def __init__(self, options: FlightControllerOptions, vehicle: int, inputs: np.ndarray) -> None:
        parameters = parameters_of(options.settings, DEFAULT_PARAMETERS, fields_of)
        mixer = _MIXERS.get(int(parameters["FRAME_TYPE"]))
        if mixer is None:
            raise InputError("laboratory.autopilot.parameters: FRAME_TYPE must be 0 (plus) or 1 (x)")
        motors = motors_of_rotors(
            options.rotors,
            mixer,
            shape_advice="set FRAME_TYPE to 0 (plus) or 1 (x) in ArduPilot and in laboratory.autopilot.parameters",
            turns_advice="change the directions of rotation in nominal.layout",
        )
        is_angle_mode = options.mode == "angle"
        tilt = math.radians(0.01 * parameters["ANGLE_MAX"] if is_angle_mode else parameters["ACRO_RP_RATE"])
        yaw_rate = math.radians(parameters["PILOT_Y_RATE" if is_angle_mode else "ACRO_Y_RATE"])
        super().__init__(
            options,
            inputs,
            connection=ArduPilotConnection(options.port + 10 * vehicle),
            motors=motors,
            # Large pulse widths mean nose up, and a turn to the right.
            ranges=StickRanges(tilt, -tilt, -yaw_rate),
            not_armed="ArduPilot does not arm, or its motors do not follow the throttle stick; start it with the"
            " parameters in diagrams/firmware/ardupilot.param",
        )
