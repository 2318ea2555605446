"""Linear-quadratic-Gaussian control in the scenario language: what it believes, and what it weighs."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import reduce
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from pydantic_core import PydanticCustomError
from pydrake.systems.framework import Diagram

from drake_quad.control.lqg.chains import (
    ChainNoise,
    ContinuousModel,
    Disturbances,
    SecondOrderResponse,
    lateral_model,
    vertical_model,
)
from drake_quad.control.lqg.design import AxisLoop, Timing, axis_loop
from drake_quad.control.lqg.laws import LqgNumbers, TargetNumbers, ThrustNumbers, TorqueNumbers
from drake_quad.control.lqg.system import LinearQuadraticGaussian, build_lqg_control
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.process_settings import without_warnings
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import MaxThrust, MinThrust, ThrustVectoringSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.quantities import (
    NonNegative,
    PlainAngleNoise,
    PlainNonNegative,
    PlainPositive,
    PlainSpan,
    Tilt,
)
from drake_quad.scenario.setting import ControlSetting

BelievedDelay = Annotated[int, Field(ge=0, le=20)]


class ColouredNoise(Model):
    """White noise behind a lag, 1 / (1 + T s) for first order and the critically damped 1 / (1 + T s)² for second."""

    deviation: PlainPositive = Field(description="standard deviation, in the unit of what it is")
    time: PlainSpan = Field(description="T of the lag (s)")

    def noise(self) -> ChainNoise:
        """Return the record that models take."""
        return ChainNoise(self.deviation, self.time)


class Axis(Model):
    """Fields of all axes."""

    name: ClassVar[str]

    first: ColouredNoise = Field(description="disturbing acceleration, noise behind a lag of first order (m/s²)")
    second: ColouredNoise = Field(
        description="disturbing acceleration, noise behind a critically damped lag of second order (m/s²)"
    )
    command_noise: PlainNonNegative = Field(
        default=0.0,
        description="spectral density of white noise on the command, against a model that is wrong (its unit √s)",
    )
    position_noise: PlainPositive = Field(description="standard deviation in a frame (m)")
    command_weight: PlainPositive = Field(
        description="ρ of the cost, the sum of p² + ρ u² with the command u in m/s² or, torques over the link, m/s⁴"
    )

    @abstractmethod
    def model(self) -> ContinuousModel:
        """Return the model of the axis."""

    def loop(self, times: Timing, gravity: float) -> AxisLoop:
        """Return the filter and the regulator of the axis.

        Raises:
            InputError: if the times or magnitudes of the axis are too different for floating point.
        """
        try:
            # The warnings of SciPy either precede an error or do not matter.
            with np.errstate(all="ignore"), without_warnings():
                noise = np.array(self._noise(gravity))
                return axis_loop(self.model(), times, noise=noise, command_weight=self.command_weight)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"control.{self.name} has no filter or no regulator: its times, deviations or weights are too far apart"
            ) from error

    def _noise(self, gravity: float) -> list[float]:
        return [self.position_noise]

    def _disturbances(self, bias: ChainNoise | None) -> Disturbances:
        return Disturbances(self.first.noise(), self.second.noise(), bias, self.command_noise)


class VerticalAxis(Axis):
    """Believed model from the command to the height, and the weights of the design."""

    lag: PlainSpan = Field(description="of the thrust behind its command (s)")
    name: ClassVar = "vertical"

    def model(self) -> ContinuousModel:
        """Return the model of the height."""
        return vertical_model(self.lag, self._disturbances(None))


class LateralAxis(Axis):
    """Believed model from the command to x and to y, and the weights of the design."""

    lag: PlainSpan | None = Field(
        default=None,
        description="of the rotors (s); needed without an autopilot, with one none if its answer has it already",
    )
    natural_frequency: PlainPositive | None = Field(
        default=None, description="ω of the attitude's answer (rad/s); needed with an autopilot"
    )
    damping: PlainPositive | None = Field(
        default=None, description="ζ of the attitude's answer (1); needed with an autopilot"
    )
    bias: ColouredNoise = Field(description="of what turns the vehicle, noise behind a lag of first order (m/s⁴)")
    attitude_noise: PlainAngleNoise = Field(description="standard deviation in a frame (rad)")
    name: ClassVar = "lateral"

    def model(self) -> ContinuousModel:
        """Return the model of x and of y."""
        omega, zeta = self.natural_frequency, self.damping
        answer = None if omega is None or zeta is None else SecondOrderResponse(omega, zeta)
        return lateral_model(self.lag, answer, self._disturbances(self.bias.noise()))

    def _noise(self, gravity: float) -> list[float]:
        return [self.position_noise, self.attitude_noise * gravity]


class YawPd(Model):
    """PD on the yaw."""

    k_p: NonNegative = Field(description="on the yaw (1/s²)")
    k_d: NonNegative = Field(description="on its rate (1/s)")


@CONTROLS.member
class LqgControl(Control):
    """A Kalman filter and a linear-quadratic regulator in place of the whole cascade; it believes in `nominal`."""

    kind: Literal["lqg"]
    delay_ticks: BelievedDelay = Field(description="believed, from a tick to when its command acts")
    lateral: LateralAxis
    vertical: VerticalAxis
    network: Network | None = Field(  # type: ignore[misc]
        default=None, description="around the controller, if any"
    )
    yaw: YawPd | None = Field(
        default=None, description="needed without an autopilot, and to be left out, or null, with one"
    )
    max_tilt: Tilt = Field(
        default=0.6, description="whose horizontal acceleration in hover is the largest commanded (rad)"
    )
    min_thrust: MinThrust = Field(default=0.3, description="least vertical thrust, as a share of the weight (1)")
    max_thrust: MaxThrust = Field(default=1.8, description="largest thrust, as a share of the weight (1)")
    max_snap: PlainPositive = Field(
        default=400.0, description="largest command along x and along y with torques over the link (m/s⁴)"
    )
    # True for kinds that add a programme to the regulator.
    takes_perturbation: ClassVar = False

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error unless it believes in what there is between its command and the attitude."""
        laboratory, autopilot = scenario.laboratory, scenario.laboratory.autopilot
        frame, tick = laboratory.motion_capture.period, laboratory.command_link.period
        if frame > tick:
            demand = f"must not be longer than the period of the command link, {tick} s, with control.kind {self.kind}"
            raise scenario.wrong(demand, "laboratory", "motion_capture", "period")
        on_the_ground: tuple[tuple[str, ...], ...] = (("yaw",),)
        on_board = ("lateral", "natural_frequency"), ("lateral", "damping")
        for path in on_board if autopilot.controls_attitude else (("lateral", "lag"), *on_the_ground):
            if reduce(getattr, path, self) is None:
                raise PydanticCustomError("missing", "is missing", {"path": ("control", *path)})
        for path in on_the_ground if autopilot.controls_attitude else on_board:
            if reduce(getattr, path, self) is not None:
                demand = f"must be left out, or null, with laboratory.autopilot of kind {autopilot.kind}"
                raise scenario.wrong(demand, "control", *path)

    def timing(self, frame: float, tick: float) -> Timing:
        """Return the times of frames and ticks (s), and the delay that it believes in."""
        return Timing(frame, tick, self.delay_ticks)

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes for the controller and what stands beside it."""
        structure = {
            "signal": setting.autopilot.command,
            "period": setting.frame,
            "tick": setting.tick,
            "takes_correction": self.network is not None,
            "takes_perturbation": self.takes_perturbation,
            "loses_frames": setting.loses_frames,
        }
        recipes = {"regulator": Recipe(LinearQuadraticGaussian, structure, self._numbers(setting))}
        if self.network is not None:
            recipes |= self.network.recipes(setting.tick, setting.plan)
        return recipes

    def _numbers(self, setting: ControlSetting) -> LqgNumbers:
        times, believed = self.timing(setting.frame, setting.tick), setting.believed
        # A command acts for a tick, in whose middle what is fed forward shall be right.
        lead = (times.delay_ticks + 0.5) * times.tick
        limits = self.limits().thrust_limits(believed)
        thrust = ThrustNumbers(believed.mass, believed.gravity, *limits, lead + self.vertical.lag)
        lateral: Any = self.lateral
        torques = target = None
        if self.yaw is not None:
            yaw = self.yaw.k_p, self.yaw.k_d
            torques = TorqueNumbers(*believed.inertia, *yaw, self.max_snap, lead + lateral.lag)
        else:
            omega, zeta = lateral.natural_frequency, lateral.damping
            slower = 2.0 * zeta / omega
            lead += lateral.lag or 0.0
            target = TargetNumbers(lead + slower, 0.5 * lead**2 + lead * slower + 1.0 / omega**2)
        loops = [axis.loop(times, believed.gravity) for axis in (self.lateral, self.vertical)]
        return LqgNumbers(loops[0], loops[1], thrust, torques, target)

    def build(self, systems: Mapping[str, Any], own: Mapping[str, Any]) -> Diagram:
        """Return the diagram of the controller and what stands beside it."""
        network = None if self.network is None else self.network.build(systems)
        return build_lqg_control(systems["regulator"], network, systems.get("programme"))

    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust."""
        return ThrustVectoringSettings.model_construct(
            max_tilt=self.max_tilt, min_thrust=self.min_thrust, max_thrust=self.max_thrust
        )
