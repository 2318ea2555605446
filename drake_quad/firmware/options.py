"""Options of flight controllers."""

from typing import NamedTuple

from drake_quad.firmware.pilot import Mode
from drake_quad.vehicle.rotors import Rotors


class FlightControllerOptions(NamedTuple):
    """Options of a flight controller whose firmware is flown with sticks.

    Attributes:
        period: period of a step, s.
        mode: flight mode.
        settings: lines with settings of the firmware.
        rotors: rotors of the nominal vehicle.
        hover_command: motor command in hover, from 0 to 1.
        scale: factor from a motor command to the output, such as the largest rotor speed.
        commands_throttle: True if the outputs are throttles, False if they are rotor speeds.
        port: network port of the first vehicle's firmware; 0 if the firmware uses no network.
    """

    period: float
    mode: Mode
    settings: tuple[str, ...]
    rotors: Rotors
    hover_command: float
    scale: float
    commands_throttle: bool
    port: int = 0
