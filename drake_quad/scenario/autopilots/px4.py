"""PX4 on board, in the scenario language."""

from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.firmware.px4.system import Px4Controller
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.remote_controlled_firmware import Port, RemoteControlledFirmwareSettings
from drake_quad.scenario.quantities import Period


@AUTOPILOTS.register
class Px4Settings(RemoteControlledFirmwareSettings):
    """PX4, which the user starts, in lockstep with the simulation over MAVLink.

    The attitude target on the command link is converted to the positions of sticks, for the flight modes Stabilized
    (angle) and Acro. The firmware receives the readings of the scenario's first gyroscope and accelerometer. Without
    these sensors, it receives the body rates and the specific force of the true or estimated motion. PX4
    estimates the attitude itself.
    """

    controller: ClassVar = Px4Controller
    angle_gain: ClassVar = 6.5  # default of MC_ROLL_P
    kind: Literal["px4"]
    period: Period = Field(  # type: ignore[misc]
        default=0.0025, description="period of the exchange with PX4, and of its rate loop (s)"
    )
    port: Port = Field(
        default=4560, description="network port at which PX4 finds the simulation; vehicle i uses port + i (1)"
    )
