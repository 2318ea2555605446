"""The Crazyflie's firmware on board, in the scenario language."""

import math
from typing import ClassVar, Literal

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.crazyflie.system import CrazyflieController
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.stick_firmware import StickFirmware

_ANGLE_GAIN = 6.0  # 1/s; default of the firmware's parameters pid_attitude.roll_kp and pitch_kp
_RATE_GAIN = 30.0  # 1/s; an assumption about the rate loop


@AUTOPILOTS.register
class CrazyflieFirmwareSettings(StickFirmware):
    """The PID controller and the power distribution of the Crazyflie's firmware, by its Python bindings `cffirmware`.

    The attitude target on the command link is converted to commands of roll, pitch, yaw rate and thrust, as a radio
    sends them. The firmware receives the readings of the scenario's first gyroscope and accelerometer. Without these
    sensors, it receives the body rates and the specific force of the true or estimated motion. The attitude is true, or
    that of the scenario's estimator.
    """

    controller: ClassVar = CrazyflieController
    kind: Literal["crazyflie_firmware"]

    def setting_lines(self) -> tuple[str, ...]:
        """Return an empty tuple, since the bindings have no settings."""
        return ()

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of roll and pitch that controllers assume."""
        gain = self.attitude_gain if self.mode == "acro" else _ANGLE_GAIN
        omega = math.sqrt(gain * _RATE_GAIN)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * _RATE_GAIN / omega:.4g}"))
