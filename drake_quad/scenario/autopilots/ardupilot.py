"""ArduPilot on board, in the scenario language."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.ardupilot.system import ArduPilotController
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.stick_firmware import StickFirmware
from drake_quad.scenario.networks.learned import allow_file_name

# Default of ArduPilot's gain ATC_ANG_RLL_P, 1/s, and an assumption about its rate loop, 1/s.
_ANGLE_GAIN = 4.5
_RATE_GAIN = 40.0


@AUTOPILOTS.register
class ArduPilotSettings(StickFirmware):
    """ArduPilot, which the user starts, in lockstep with the simulation over its JSON interface.

    The attitude target on the command link is converted to the positions of sticks, for the flight modes Stabilize
    (angle) and Acro. Readings of the scenario's first gyroscope and accelerometer reach the firmware, or exact values
    without these sensors. ArduPilot estimates the attitude itself.
    """

    controller: ClassVar = ArduPilotController
    kind: Literal["ardupilot"]
    port: Annotated[int, Field(ge=1024, le=65535)] = Field(
        default=9002, description="network port at which ArduPilot finds the simulation; vehicle i uses port + 10 i (1)"
    )
    parameters: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="lines of ArduPilot's parameter file, or the file itself, relative to the folder of the scenario's"
        " file; only FRAME_TYPE and the ranges of the sticks are used, since ArduPilot itself reads the file",
        json_schema_extra=allow_file_name,
    )

    def setting_lines(self) -> tuple[str, ...]:
        """Return the lines with parameters of ArduPilot."""
        return self.parameters

    def network_port(self) -> int:
        """Return the network port of the first vehicle's firmware."""
        return self.port

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of roll and pitch that controllers assume."""
        gain = self.attitude_gain if self.mode == "acro" else _ANGLE_GAIN
        omega = math.sqrt(gain * _RATE_GAIN)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * _RATE_GAIN / omega:.4g}"))
