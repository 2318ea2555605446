"""ArduPilot on board, in the scenario language."""

from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.firmware.ardupilot.system import ArduPilotController
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.autopilots.remote_controlled_firmware import Port, RemoteControlledFirmwareSettings


@AUTOPILOTS.register
class ArduPilotSettings(RemoteControlledFirmwareSettings):
    """ArduPilot, which the user starts, in lockstep with the simulation over its JSON interface.

    The attitude target on the command link is converted to the positions of sticks, for the flight modes Stabilize
    (angle) and Acro. The firmware receives the readings of the scenario's first gyroscope and accelerometer. Without
    these sensors, it receives the body rates and the specific force of the true or estimated motion. ArduPilot
    estimates the attitude itself.
    """

    controller: ClassVar = ArduPilotController
    angle_gain: ClassVar = 4.5  # default of ATC_ANG_RLL_P
    kind: Literal["ardupilot"]
    port: Port = Field(
        default=9002, description="network port at which ArduPilot finds the simulation; vehicle i uses port + 10 i (1)"
    )
