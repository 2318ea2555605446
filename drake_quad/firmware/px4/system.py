"""PX4 as the flight controller of a vehicle."""

import math
from collections.abc import Sequence

import numpy as np

from drake_quad.firmware.motors import X_ANGLE, Mixer, Motor, motors_of_rotors
from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.px4.connection import Px4Connection
from drake_quad.firmware.remote_control import RemoteControlledFirmware, StickRanges, parameters_of
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE

# Motors of PX4's generic quadrotor in an x.
_MIXER = Mixer(
    (Motor(-45.0, ANTICLOCKWISE), Motor(135.0, ANTICLOCKWISE), Motor(45.0, CLOCKWISE), Motor(-135.0, CLOCKWISE)),
    X_ANGLE,
)
DEFAULT_PARAMETERS = {
    "MPC_MAN_TILT_MAX": 45.0,  # °
    "MPC_MAN_Y_MAX": 200.0,  # °/s
    "MC_ACRO_R_MAX": 360.0,  # °/s
    "MC_ACRO_P_MAX": 360.0,  # °/s
    "MC_ACRO_Y_MAX": 200.0,  # °/s
}
"""Parameters on which the positions of the sticks depend, with their values in diagrams/firmware/px4.env."""


def fields_of(line: str) -> Sequence[str]:
    """Return the name and the value in a line with a parameter of PX4.

    The line is an environment variable (PX4_PARAM_NAME=VALUE), a command of PX4's shell (param set NAME VALUE), a line
    of QGroundControl's parameter file (vehicle, component, NAME, VALUE, type), or NAME VALUE.
    """
    words = line.removeprefix("PX4_PARAM_").replace("=", " ").replace(",", " ").split()
    if words[:2] == ["param", "set"]:
        return words[2:]
    return words[2:4] if len(words) == 5 else words


class Px4Controller(RemoteControlledFirmware):
    """Flight controller of one vehicle with PX4, armed and commanded to hover.

    Args:
        options: options of the flight controller. Vehicle i of a fleet uses `options.port + i`, as PX4's instances do.
        vehicle: number of the vehicle in the fleet.
        inputs: inputs at the start of the flight.

    Raises:
        FirmwareError: if PX4 does not connect or does not answer.
        ImportError: if the library pymavlink is not installed.
        InputError: if PX4's motors do not fit the vehicle, or PX4 does not arm.
    """

    def __init__(self, options: FlightControllerOptions, vehicle: int, inputs: np.ndarray) -> None:
        parameters = parameters_of(options.settings, DEFAULT_PARAMETERS, fields_of)
        motors = motors_of_rotors(
            options.rotors,
            _MIXER,
            shape_advice="choose a vehicle whose rotors form an x",
            turns_advice="change the directions of rotation in nominal.layout",
        )
        names = ("MPC_MAN_TILT_MAX", "MPC_MAN_TILT_MAX", "MPC_MAN_Y_MAX")
        if options.mode == "acro":
            names = ("MC_ACRO_R_MAX", "MC_ACRO_P_MAX", "MC_ACRO_Y_MAX")
        roll, pitch, yaw_rate = (math.radians(parameters[name]) for name in names)
        super().__init__(
            options,
            inputs,
            connection=Px4Connection(options.port + vehicle, seed=vehicle),
            motors=motors,
            # Large pulse widths mean nose down, and a turn to the right.
            ranges=StickRanges(roll, pitch, -yaw_rate),
            not_armed="PX4 does not arm, or its motors do not follow the throttle stick; start it with the"
            " parameters in diagrams/firmware/px4.env",
        )
