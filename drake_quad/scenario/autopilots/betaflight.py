"""Betaflight on board, in the scenario language."""

import math
import re
from collections.abc import Iterator
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.firmware.betaflight.system import BetaflightOptions, betaflight_in_the_loop
from drake_quad.firmware.pilot import Mode, PilotParameters, StickPilot, motor_command
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, Autopilot
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, is_set
from drake_quad.scenario.networks.learned import allow_file_name
from drake_quad.scenario.quantities import FixedPositive, Period
from drake_quad.vehicle.motors import ThrustCurve, mean_thrust_factor
from drake_quad.vehicle.parameters import QuadrotorParameters

_DEFAULT_ANGLE_GAIN = 50.0  # default of Betaflight's setting `angle_p_gain`
_ANGLE_GAIN_UNIT = 0.1  # 1/s, gain from the error of the angle to a body rate per unit of `angle_p_gain`
_ANGLE_GAIN_PATTERN = re.compile(r"\s*set\s+angle_p_gain\s*=\s*(\d+)\s*")
# Gain of a proportional rate loop with which an attitude loop responds to a step as in each flight mode, 1/s. It was
# fitted to a step of 0.2 rad in roll by the vehicle `racer` with Betaflight's default settings, with a deviation of 1 %
# (angle) and 2 % (acro) of the step. In angle mode, Betaflight filters the output of its attitude loop.
_RATE_GAINS = {"angle": 49.0, "acro": 72.0}


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
        description="lines of Betaflight's command line, such as `set d_roll = 35`, or a file that contains the output"
        " of `diff`, relative to the folder of the scenario's file; lines that describe the board are ignored",
        json_schema_extra=allow_file_name,
    )
    attitude_gain: FixedPositive = Field(
        default=8.0,
        description="gain from the error of roll and pitch to a body rate in acro mode (1/s); the default is an"
        " assumption",
    )
    yaw_gain: FixedPositive = Field(
        default=3.0, description="gain from the error of the yaw to a yaw rate (1/s); the default is an assumption"
    )

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

    def recipes(
        self, nominal: QuadrotorParameters, *, settings: Any, follows_attitude: bool, curve: ThrustCurve | None
    ) -> dict[str, Recipe]:
        """Return the recipes to build the pilot, and the firmware that commands the motors."""
        thrust_factor, max_speed = float(mean_thrust_factor(nominal)), float(nominal.max_rotor_speed)
        pilot = PilotParameters(self.attitude_gain, self.yaw_gain, thrust_factor, max_speed, nominal.gravity, curve)
        weight = nominal.mass * nominal.gravity
        options = BetaflightOptions(
            self.period,
            self.mode,
            self.settings,
            nominal.rotors,
            float(np.clip(motor_command(weight, pilot), 0.0, 1.0)),
            max_speed if curve is None else 1.0,
        )
        command = "rotor_speed_command" if curve is None else "throttle_command"
        return {
            "autopilot": Recipe(StickPilot, {"mode": self.mode, "follows_attitude": follows_attitude}, pilot),
            "firmware": Recipe(betaflight_in_the_loop, {"options": options, "command": command}, None),
        }

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield the gain of the attitude loop on the companion computer if Betaflight controls the attitude itself."""
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
