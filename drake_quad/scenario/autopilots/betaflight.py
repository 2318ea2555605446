"""Betaflight on board, in the scenario language."""

import math
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.betaflight.laws import BetaflightPilot, Mode, PilotParameters, motor_command
from drake_quad.firmware.betaflight.system import BetaflightOptions, betaflight_in_the_loop
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.scenario.networks.learned import allow_file_name
from drake_quad.scenario.quantities import FixedPositive, Period
from drake_quad.vehicle.motors import ThrustCurve, mean_thrust_factor
from drake_quad.vehicle.parameters import QuadrotorParameters


@AUTOPILOTS.register
class BetaflightSettings(Autopilot):
    """Betaflight, as unmodified firmware in its own process, which flies in lockstep with the simulation.

    The attitude target on the command link is converted to the commands of sticks. In angle mode, Betaflight controls
    roll and pitch. In acro mode it controls body rates, and a companion computer controls roll and pitch. In both modes
    the yaw is controlled by the yaw stick. Readings of the scenario's first gyroscope and accelerometer reach the
    firmware, or exact values without these sensors. The attitude is exact, or that of the estimator: the simulator
    build of Betaflight does not estimate the attitude itself.
    """

    command: ClassVar = "attitude_target"
    accepts: ClassVar = ("attitude", "rates")
    feeds_forward: ClassVar = ("none", "acceleration", "jerk")
    is_firmware: ClassVar = True
    kind: Literal["betaflight"]
    period: Period = Field(  # type: ignore[misc]
        default=0.00125, description="period of the exchange with the firmware, whose own loops are faster (s)"
    )
    mode: Mode = Field(
        default="angle",
        description="flight mode: angle (Betaflight controls roll, pitch and body rates) or acro (only body rates)",
    )
    settings: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="lines of Betaflight's command line, such as `set d_roll = 35`, or the file of a `diff`, relative to"
        " the folder of the scenario's file; lines that describe the board are ignored",
        json_schema_extra=allow_file_name,
    )
    k_attitude: FixedPositive = Field(
        default=8.0,
        description="gain from the error of roll and pitch to a body rate in acro mode (1/s); the default is an"
        " assumption",
    )
    k_yaw: FixedPositive = Field(
        default=3.0, description="gain from the error of the yaw to a yaw rate (1/s); the default is an assumption"
    )

    def attitude_response(self) -> SecondOrderResponse:
        """Return the second-order response that controllers assume for roll and pitch."""
        # TODO measured
        return SecondOrderResponse(12.0, 0.9)

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipes to build the pilot, and the firmware that commands the motors."""
        thrust_factor, max_speed = float(mean_thrust_factor(nominal)), float(nominal.max_rotor_speed)
        pilot = PilotParameters(self.k_attitude, self.k_yaw, thrust_factor, max_speed, nominal.gravity, curve)
        weight = nominal.mass * nominal.gravity
        options = BetaflightOptions(
            self.period,
            self.mode,
            self.settings,
            tuple([*nominal.rotors]),
            float(np.clip(motor_command(weight, pilot), 0.0, 1.0)),
            max_speed if curve is None else 1.0,
        )
        command = "rotor_speed_command" if curve is None else "throttle_command"
        return {
            "autopilot": Recipe(BetaflightPilot, {"mode": self.mode, "follows_attitude": follows_attitude}, pilot),
            "firmware": Recipe(betaflight_in_the_loop, {"options": options, "command": command}, None),
        }

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the period is too long, or the control commands body rates in angle mode."""
        link = scenario.laboratory.command_link.period
        if not self.period <= link:
            demand = f"must not be longer than the period of the command link, {link} s"
            raise scenario.field_error(demand, "laboratory", "autopilot", "period")
        if self.mode == "angle" and scenario.control.commands_rates_only():
            demand = "must be acro, since the control commands body rates without an attitude"
            raise scenario.field_error(demand, "laboratory", "autopilot", "mode")
