"""Linear-quadratic-Gaussian (LQG) control in the scenario language, with its models and weights."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
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
from drake_quad.control.lqg.laws import LqgParameters, TargetParameters, ThrustParameters, TorqueParameters
from drake_quad.control.lqg.system import LinearQuadraticGaussian, build_lqg_control
from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.process_settings import without_warnings
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import MaxThrust, MinThrust, ThrustVectoringSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, is_set
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.plausible import (
    PLAUSIBLE_ATTITUDE_NOISE,
    PLAUSIBLE_DELAY,
    PLAUSIBLE_LAG,
    PLAUSIBLE_POSITION_NOISE,
)
from drake_quad.scenario.quantities import (
    FixedAngleNoise,
    FixedNonNegative,
    FixedPositive,
    FixedSpan,
    NonNegative,
    Tilt,
)
from drake_quad.scenario.setting import ControlSetting

ModelledDelay = Annotated[int, Field(ge=0, le=20), PLAUSIBLE_DELAY]


class ColouredNoise(Model):
    """White noise filtered by a lag: 1 / (1 + T s) for first order, 1 / (1 + T s)² for second order."""

    deviation: FixedPositive = Field(description="standard deviation, in the unit of the quantity")
    time: FixedSpan = Field(description="time constant T of the lag (s)")

    def noise(self) -> ChainNoise:
        """Return the noise parameters for the design model."""
        return ChainNoise(self.deviation, self.time)


class Axis(Model):
    """Base class of `VerticalAxis` and `LateralAxis`, with the fields that both have."""

    name: ClassVar[str]

    first: ColouredNoise = Field(
        description="disturbing acceleration, white noise filtered by a first-order lag (m/s²)"
    )
    second: ColouredNoise = Field(
        description="disturbing acceleration, white noise filtered by a critically damped second-order lag (m/s²)"
    )
    command_noise: FixedNonNegative = Field(
        default=0.0,
        description="spectral density of white noise on the command, which makes the design robust to model errors"
        " (unit of the command times √s)",
    )
    position_noise: Annotated[FixedPositive, PLAUSIBLE_POSITION_NOISE] = Field(
        description="standard deviation of the position in a camera frame (m)"
    )
    command_weight: FixedPositive = Field(
        description="weight ρ in the cost, the sum of p² + ρ u² with the position p and the command u; u is in m/s², or"
        " in m/s⁴ if the link carries torques"
    )

    @abstractmethod
    def model(self) -> ContinuousModel:
        """Return the continuous-time model of an axis, for which the gains are computed."""

    def loop(self, times: Timing, gravity: float) -> AxisLoop:
        """Design the Kalman filter and the regulator of the axis.

        Raises:
            InputError: if the design fails numerically because the axis has very different time constants or
                magnitudes.
        """
        try:
            # Ignore warnings about ill-conditioned matrices. If the design really fails, SciPy raises an error.
            with np.errstate(all="ignore"), without_warnings():
                noise = np.array(self._noise(gravity))
                return axis_loop(self.model(), times, noise=noise, command_weight=self.command_weight)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"control.{self.name}: no Kalman filter or regulator can be computed; choose times, deviations and"
                " weights of more similar magnitude"
            ) from error

    def _noise(self, gravity: float) -> list[float]:
        return [self.position_noise]

    def _disturbances(self, bias: ChainNoise | None) -> Disturbances:
        return Disturbances(self.first.noise(), self.second.noise(), bias, self.command_noise)


class VerticalAxis(Axis):
    """Design model of the response from command to height, with the weights of filter and regulator."""

    lag: Annotated[FixedSpan, PLAUSIBLE_LAG] = Field(description="time constant of the thrust (s)")
    name: ClassVar = "vertical"

    def model(self) -> ContinuousModel:
        """Return the design model of the height."""
        return vertical_model(self.lag, self._disturbances(None))


class LateralAxis(Axis):
    """Design model of the response from command to x and y, with the weights of filter and regulator."""

    lag: Annotated[FixedSpan | None, PLAUSIBLE_LAG] = Field(
        default=None,
        description="time constant of the rotors (s); required if there is no autopilot; with an autopilot, omit it"
        " if the attitude response includes it",
    )
    natural_frequency: FixedPositive | None = Field(
        default=None, description="natural frequency ω of the attitude response (rad/s); required with an autopilot"
    )
    damping: FixedPositive | None = Field(
        default=None, description="damping ratio ζ of the attitude response (1); required with an autopilot"
    )
    bias: ColouredNoise = Field(
        description="disturbing angular acceleration times gravity, white noise filtered by a first-order lag (m/s⁴)"
    )
    attitude_noise: Annotated[FixedAngleNoise, PLAUSIBLE_ATTITUDE_NOISE] = Field(
        description="standard deviation of roll and pitch in a camera frame (rad)"
    )
    name: ClassVar = "lateral"

    def model(self) -> ContinuousModel:
        """Return the design model of x and of y."""
        omega, zeta = self.natural_frequency, self.damping
        response = None if omega is None or zeta is None else SecondOrderResponse(omega, zeta)
        return lateral_model(self.lag, response, self._disturbances(self.bias.noise()))

    def _noise(self, gravity: float) -> list[float]:
        return [self.position_noise, self.attitude_noise * gravity]


class YawPd(Model):
    """PD controller of the yaw."""

    k_p: NonNegative = Field(description="gain of the yaw error (1/s²)")
    k_d: NonNegative = Field(description="gain of the yaw rate error (1/s)")


@CONTROLS.register
class LqgControl(Control):
    """A Kalman filter and a linear-quadratic regulator that replace the whole cascade. The design uses `nominal`."""

    kind: Literal["lqg"]
    delay_ticks: ModelledDelay = Field(
        description="modelled delay from a tick to the effect of its command, in control ticks",
    )
    lateral: LateralAxis
    vertical: VerticalAxis
    network: Network | None = Field(  # type: ignore[misc]
        default=None, description="fuzzy network that corrects the command; none if not given"
    )
    yaw: YawPd | None = Field(
        default=None,
        description="yaw controller; required if there is no autopilot; otherwise it must be omitted or null",
    )
    max_tilt: Tilt = Field(
        default=0.6, description="tilt in hover that corresponds to the largest commanded horizontal acceleration (rad)"
    )
    min_thrust: MinThrust = Field(default=0.3, description="smallest vertical thrust, relative to the weight (1)")
    max_thrust: MaxThrust = Field(default=1.8, description="largest thrust, relative to the weight (1)")
    max_snap: FixedPositive = Field(
        default=400.0, description="largest command along x and along y if the link carries torques (m/s⁴)"
    )
    # True for kinds that add a quadratic programme to the regulator.
    takes_perturbation: ClassVar = False
    # Names of fields that have an effect only if the command link carries torques.
    torque_fields: ClassVar[tuple[str, ...]] = ("max_snap",)

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as limits on torques if an autopilot controls the attitude."""
        yield from super().inactive_settings(flight, path)
        autopilot = flight.scenario.laboratory.autopilot
        for name in self.torque_fields if autopilot.controls_attitude else ():
            if is_set(self, name):
                yield InactiveSetting(f"{path}.{name}", f"laboratory.autopilot.kind is {autopilot.kind}")

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the design model or the periods are incompatible with the laboratory.

        If there is no autopilot, the model needs the rotor lag and a yaw controller. Otherwise it needs the attitude
        response. The frame period must not be longer than the tick period.
        """
        laboratory, autopilot = scenario.laboratory, scenario.laboratory.autopilot
        frame, tick = laboratory.motion_capture.period, laboratory.command_link.period
        if frame > tick:
            demand = f"must not be longer than the period of the command link, {tick} s, with control.kind {self.kind}"
            raise scenario.field_error(demand, "laboratory", "motion_capture", "period")
        on_the_ground: tuple[tuple[str, ...], ...] = (("yaw",),)
        on_board = ("lateral", "natural_frequency"), ("lateral", "damping")
        for path in on_board if autopilot.controls_attitude else (("lateral", "lag"), *on_the_ground):
            if reduce(getattr, path, self) is None:
                raise PydanticCustomError("missing", "is missing", {"path": ("control", *path)})
        for path in on_the_ground if autopilot.controls_attitude else on_board:
            if reduce(getattr, path, self) is not None:
                demand = f"must be left out, or null, with laboratory.autopilot of kind {autopilot.kind}"
                raise scenario.field_error(demand, "control", *path)

    def timing(self, frame: float, tick: float) -> Timing:
        """Return the frame and tick periods, s, together with the delay of the design model."""
        return Timing(frame, tick, self.delay_ticks)

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build the controller and, if it has one, its network."""
        structure = {
            "signal": setting.autopilot.command,
            "period": setting.frame,
            "tick": setting.tick,
            "takes_correction": self.network is not None,
            "takes_perturbation": self.takes_perturbation,
            "loses_frames": setting.loses_frames,
        }
        recipes = {"regulator": Recipe(LinearQuadraticGaussian, structure, self._parameters(setting))}
        if self.network is not None:
            recipes |= self.network.recipes(setting.tick, setting.plan)
        return recipes

    def _parameters(self, setting: ControlSetting) -> LqgParameters:
        times, nominal = self.timing(setting.frame, setting.tick), setting.nominal
        # A command is held for one tick, so the feed-forward is computed for the middle of that tick.
        lead = (times.delay_ticks + 0.5) * times.tick
        limits = self.limits().thrust_limits(nominal)
        thrust = ThrustParameters(nominal.mass, nominal.gravity, *limits, lead + self.vertical.lag)
        lateral: Any = self.lateral
        torques = target = None
        if self.yaw is not None:
            yaw = self.yaw.k_p, self.yaw.k_d
            torques = TorqueParameters(*nominal.inertia, *yaw, self.max_snap, lead + lateral.lag)
        else:
            omega, zeta = lateral.natural_frequency, lateral.damping
            slower = 2.0 * zeta / omega
            lead += lateral.lag or 0.0
            target = TargetParameters(lead + slower, 0.5 * lead**2 + lead * slower + 1.0 / omega**2)
        loops = [axis.loop(times, nominal.gravity) for axis in (self.lateral, self.vertical)]
        return LqgParameters(loops[0], loops[1], thrust, torques, target)

    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Return the diagram of the controller, including its network and its quadratic programme if it has them."""
        network = None if self.network is None else self.network.build(systems)
        return build_lqg_control(systems["regulator"], network, systems.get("programme"))

    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust that the regulator obeys."""
        return ThrustVectoringSettings.model_construct(
            max_tilt=self.max_tilt, min_thrust=self.min_thrust, max_thrust=self.max_thrust
        )
