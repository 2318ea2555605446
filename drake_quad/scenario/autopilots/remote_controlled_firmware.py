"""Base class of autopilots that are firmware which the user starts, in the scenario language."""

import math
from typing import Annotated, ClassVar

from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.scenario.autopilots.stick_firmware import StickFirmware
from drake_quad.scenario.networks.learned import allow_file_name

Port = Annotated[int, Field(ge=1024, le=65535)]
_RATE_GAIN = 40.0  # 1/s; an assumption about the rate loop of the firmware


class RemoteControlledFirmwareSettings(StickFirmware):
    """Firmware that the user starts, and that is flown with the channels of a remote control.

    Attributes:
        angle_gain: default of the firmware's gain from an error of roll or pitch to a body rate, 1/s.
    """

    angle_gain: ClassVar[float]
    port: Port
    parameters: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="lines of the firmware's parameter file, or the file itself, relative to the folder of the"
        " scenario's file; only the parameters on which the sticks depend are used, since the firmware itself reads the"
        " file",
        json_schema_extra=allow_file_name,
    )

    def setting_lines(self) -> tuple[str, ...]:
        """Return the lines with parameters of the firmware."""
        return self.parameters

    def network_port(self) -> int:
        """Return the network port of the first vehicle's firmware."""
        return self.port

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of roll and pitch that controllers assume."""
        gain = self.attitude_gain if self.mode == "acro" else self.angle_gain
        omega = math.sqrt(gain * _RATE_GAIN)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * _RATE_GAIN / omega:.4g}"))
