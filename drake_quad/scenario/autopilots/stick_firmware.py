"""Base class of autopilots that are firmware for pilots, in the scenario language."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from drake_quad.firmware.options import FlightControllerOptions
from drake_quad.firmware.pilot import Mode, PilotParameters, StickPilot, motor_command
from drake_quad.firmware.system import firmware_in_the_loop
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import Autopilot
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, is_set
from drake_quad.scenario.quantities import FixedPositive, Period
from drake_quad.vehicle.motors import ThrustCurve, mean_thrust_factor
from drake_quad.vehicle.parameters import QuadrotorParameters


class StickFirmware(Autopilot):
    """Firmware that is flown with sticks.

    Attributes:
        controller: class of the flight controllers.
    """

    command: ClassVar = "attitude_target"
    accepts: ClassVar = ("attitude", "rates")
    feeds_forward: ClassVar = ("none", "acceleration", "jerk")
    is_firmware: ClassVar = True
    controller: ClassVar[Any]
    period: Period = Field(  # type: ignore[misc]
        default=0.00125, description="period of the exchange with the firmware, whose own loops may be faster (s)"
    )
    mode: Mode = Field(
        default="angle",
        description="flight mode: angle (the firmware controls roll, pitch and body rates) or acro (only body rates)",
    )
    attitude_gain: FixedPositive = Field(
        default=8.0,
        description="gain from the error of roll and pitch to a body rate in acro mode (1/s); the default is an"
        " assumption",
    )
    yaw_gain: FixedPositive = Field(
        default=3.0, description="gain from the error of the yaw to a yaw rate (1/s); the default is an assumption"
    )

    @abstractmethod
    def setting_lines(self) -> tuple[str, ...]:
        """Return the lines with settings of the firmware."""

    def network_port(self) -> int:
        """Return the network port of the first vehicle's firmware; 0 if the firmware uses no network."""
        return 0

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipes to build the pilot, and the firmware that commands the motors."""
        thrust_factor, max_speed = float(mean_thrust_factor(nominal)), float(nominal.max_rotor_speed)
        pilot = PilotParameters(self.attitude_gain, self.yaw_gain, thrust_factor, max_speed, nominal.gravity, curve)
        weight = nominal.mass * nominal.gravity
        options = FlightControllerOptions(
            self.period,
            self.mode,
            self.setting_lines(),
            nominal.rotors,
            float(np.clip(motor_command(weight, pilot), 0.0, 1.0)),
            max_speed if curve is None else 1.0,
            curve is not None,
            self.network_port(),
        )
        command = "rotor_speed_command" if curve is None else "throttle_command"
        return {
            "autopilot": Recipe(StickPilot, {"mode": self.mode, "follows_attitude": follows_attitude}, pilot),
            "firmware": Recipe(
                firmware_in_the_loop, {"controller": self.controller, "options": options, "command": command}, None
            ),
        }

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield the gain of the companion computer's attitude loop if the firmware controls the attitude."""
        yield from super().inactive_settings(flight, path)
        if self.mode == "angle" and is_set(self, "attitude_gain"):
            yield InactiveSetting(f"{path}.attitude_gain", f"{path}.mode is {self.mode}")

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the period is too long, or the control commands body rates in angle mode."""
        link = scenario.laboratory.command_link.period
        if not self.period <= link:
            demand = f"must not be longer than the period of the command link, {link} s"
            raise scenario.field_error(demand, "laboratory", "autopilot", "period")
        if self.mode == "angle" and scenario.control.commands_rates_only():
            demand = "must be acro, since the control commands body rates without an attitude"
            raise scenario.field_error(demand, "laboratory", "autopilot", "mode")
