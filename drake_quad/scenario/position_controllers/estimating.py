"""PD position controllers that estimate the disturbance, and the response models that they use."""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorParameters
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.disturbance.tilt import TiltDisturbanceEstimator, TiltEstimatorParameters
from drake_quad.framework.recipe import Recipe
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting
from drake_quad.scenario.plausible import PLAUSIBLE_DELAY, PLAUSIBLE_LAG
from drake_quad.scenario.position_controllers.pd import PdPosition
from drake_quad.scenario.quantities import Positive, Span, Spans
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import Row


class ModelledResponse(Model):
    """Response model: how a disturbance estimator assumes that the vehicle responds to commands."""

    kind: str
    delay_ticks: Annotated[int, Field(ge=0, le=50), PLAUSIBLE_DELAY] = Field(
        default=1, description="modelled delay from a command to its effect, in ticks of the control (1)"
    )

    @abstractmethod
    def estimator(self, laws: tuple[Any, ...], limit: Row, setting: ControlSetting) -> Recipe:
        """Return the recipe to build the estimator.

        Args:
            laws: estimation law of each axis.
            limit: largest estimate of the disturbance on an axis, m/s².
            setting: scenario properties on which the control depends.
        """

    def _structure(self, setting: ControlSetting) -> dict[str, Any]:
        return {"period": setting.tick, "delay_ticks": self.delay_ticks}


class CommandedResponse(ModelledResponse):
    """Response model in which the vehicle follows the commanded acceleration with a lag."""

    kind: Literal["commanded"]
    lag: Annotated[Spans, PLAUSIBLE_LAG] = Field(
        description="time constant on X, Y, Z of the measured acceleration, including cameras and their filters (s)"
    )
    feed_forward_lag: Annotated[Spans | None, PLAUSIBLE_LAG] = Field(
        default=None,
        description="time constant for the fed-forward part of the command, which is not delayed by the attitude if its"
        " derivatives are also fed forward (s); by default, `lag`",
    )

    def estimator(self, laws: tuple[Any, ...], limit: Row, setting: ControlSetting) -> Recipe:
        """Return the recipe to build a `DisturbanceEstimator`."""
        fed_forward = self.lag if self.feed_forward_lag is None else self.feed_forward_lag
        lags = tuple([AxisCommand(*lags) for lags in zip(self.lag, fed_forward, strict=True)])
        parameters = EstimatorParameters(laws, lags, limit, _start(setting))
        return Recipe(DisturbanceEstimator, self._structure(setting), parameters)


class TiltResponse(ModelledResponse):
    """Response model in which the thrust follows its command with a lag, along the measured body axis."""

    kind: Literal["tilt"]
    lag: Annotated[Span, PLAUSIBLE_LAG] = Field(description="time constant of the thrust (s)")

    def estimator(self, laws: tuple[Any, ...], limit: Row, setting: ControlSetting) -> Recipe:
        """Return the recipe to build a `TiltDisturbanceEstimator`."""
        parameters = TiltEstimatorParameters(laws, self.lag, setting.nominal.gravity, limit, _start(setting))
        return Recipe(TiltDisturbanceEstimator, self._structure(setting), parameters)


class EstimatingPosition(PdPosition):
    """PD controller that subtracts an estimate of the disturbance from its command."""

    response: Annotated[CommandedResponse | TiltResponse, Field(discriminator="kind")]
    disturbance_limit: Positive = Field(
        default=5.0, description="largest estimate of the disturbing acceleration on an axis (m/s²)"
    )
    estimates_disturbance: ClassVar = True

    @abstractmethod
    def law(self, axis: int, period: float) -> Any:
        """Return the estimation law of an axis, a named tuple of `drake_quad.control.disturbance.laws`.

        Args:
            axis: 0, 1 or 2 for X, Y or Z.
            period: period of the control, s.
        """

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as a lag of the feed-forward if nothing is fed forward."""
        yield from super().inactive_settings(flight, path)
        if self.feed_forward == "none" and getattr(self.response, "feed_forward_lag", None) is not None:
            yield InactiveSetting(f"{path}.response.feed_forward_lag", f"{path}.feed_forward is none")

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build the PD controller and the disturbance estimator."""
        limit: Any = self.disturbance_limit
        laws = tuple([self.law(axis, setting.tick) for axis in range(3)])
        return {**super().recipes(setting), "position.estimator": self.response.estimator(laws, limit, setting)}

    def without_estimator(self) -> PdPosition:
        """Return the PD controller without the disturbance estimate."""
        fields = {name: getattr(self, name) for name in PdPosition.model_fields if name != "kind"}
        return PdPosition(kind="pd", **fields)


def _start(setting: ControlSetting) -> PerAxis:
    return PerAxis(*map(float, setting.plan.waypoints[0]))
