"""Betaflight on board, in the scenario language."""

import math
import re
from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.betaflight.system import BetaflightController
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.stick_firmware import StickFirmware
from drake_quad.scenario.networks.learned import allow_file_name

_DEFAULT_ANGLE_GAIN = 50.0  # default of Betaflight's setting `angle_p_gain`
_ANGLE_GAIN_UNIT = 0.1  # 1/s, gain from the error of the angle to a body rate per unit of `angle_p_gain`
_ANGLE_GAIN_PATTERN = re.compile(r"\s*set\s+angle_p_gain\s*=\s*(\d+)\s*")
# Gain of a proportional rate loop with which an attitude loop responds to a step as in each flight mode, 1/s. It was
# fitted to a step of 0.2 rad in roll by the vehicle `racer` with Betaflight's default settings, with a deviation of 1 %
# (angle) and 2 % (acro) of the step. In angle mode, Betaflight filters the output of its attitude loop.
_RATE_GAINS = {"angle": 49.0, "acro": 72.0}


@AUTOPILOTS.register
class BetaflightSettings(StickFirmware):
    """Betaflight, as unmodified firmware in its own process, which flies in lockstep with the simulation.

    The attitude target on the command link is converted to the commands of sticks. In angle mode, Betaflight controls
    roll and pitch. In acro mode it controls body rates, and a companion computer controls roll and pitch. In both modes
    the yaw is controlled by the yaw stick. The firmware receives the readings of the scenario's first gyroscope
    and accelerometer. Without these sensors, it receives the body rates and the specific force of the true or estimated
    motion. The attitude is true or estimated, too: the simulator build of Betaflight does not estimate it itself.
    """

    controller: ClassVar = BetaflightController
    kind: Literal["betaflight"]
    settings: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="lines of Betaflight's command line, such as `set d_roll = 35`, or a file that contains the output"
        " of `diff`, relative to the folder of the scenario's file; lines that describe the board are ignored",
        json_schema_extra=allow_file_name,
    )

    def setting_lines(self) -> tuple[str, ...]:
        """Return the lines with settings of Betaflight."""
        return self.settings

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of roll and pitch that controllers assume."""
        gain = self.attitude_gain if self.mode == "acro" else _ANGLE_GAIN_UNIT * self._angle_gain()
        rate_gain = _RATE_GAINS[self.mode]
        omega = math.sqrt(gain * rate_gain)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * rate_gain / omega:.4g}"))

    def _angle_gain(self) -> float:
        """Return the value of Betaflight's setting `angle_p_gain`."""
        values = [match.group(1) for match in map(_ANGLE_GAIN_PATTERN.fullmatch, self.settings) if match]
        return float(values[-1]) if values else _DEFAULT_ANGLE_GAIN
