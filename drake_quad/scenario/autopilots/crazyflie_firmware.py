"""The Crazyflie's firmware on board, in the scenario language."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.crazyflie.system import CrazyflieController
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.stick_firmware import StickFirmware

_ANGLE_GAIN = 6.0  # 1/s; default of the firmware's parameters pid_attitude.roll_kp and pitch_kp
_RATE_GAIN = 30.0  # 1/s; an assumption about the rate loop


@AUTOPILOTS.register
class CrazyflieFirmwareSettings(StickFirmware):
    """A controller and the power distribution of the Crazyflie's firmware, by its Python bindings `cffirmware`.

    The attitude target on the command link is converted to commands of roll, pitch, yaw rate and thrust, as a radio
    sends them. The firmware receives the readings of the scenario's first gyroscope and accelerometer. Without these
    sensors, it receives the body rates and the specific force of the true or estimated motion. Its pose is true, or
    that of the scenario's estimator.
    """

    controller: ClassVar = CrazyflieController
    kind: Literal["crazyflie_firmware"]
    stabilizer_controller: Literal["pid", "mellinger", "lee"] = Field(
        default="pid",
        description="controller of the firmware, as in its parameter stabilizer.controller; mellinger and lee need the"
        " mode angle",
    )
    stabilizer_estimator: Literal["none", "kalman"] = Field(
        default="none",
        description="estimator of the firmware: none (the attitude is given) or kalman (its Kalman filter estimates the"
        " attitude from gyroscope, accelerometer and a pose every 10 ms), as in its parameter stabilizer.estimator",
    )

    def setting_lines(self) -> tuple[str, ...]:
        """Return the names of the controller and of the estimator."""
        return (self.stabilizer_controller, self.stabilizer_estimator)

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the controller does not fit the mode."""
        super().check_fits(scenario)
        if self.mode == "acro" and self.stabilizer_controller != "pid":
            demand = "must be pid in the mode acro, since the others ignore commanded body rates"
            raise scenario.field_error(demand, "laboratory", "autopilot", "stabilizer_controller")

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response of roll and pitch that controllers assume, with the gains of the PID."""
        gain = self.attitude_gain if self.mode == "acro" else _ANGLE_GAIN
        omega = math.sqrt(gain * _RATE_GAIN)
        return SecondOrderResponse(float(f"{omega:.4g}"), float(f"{0.5 * _RATE_GAIN / omega:.4g}"))
