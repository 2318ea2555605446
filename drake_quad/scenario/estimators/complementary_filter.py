"""Complementary filter in the scenario language."""

from typing import Any, ClassVar, Literal

from pydantic import Field

from drake_quad.estimation.complementary_filter import ComplementaryFilter, ComplementaryParameters, TimeConstants
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import record_like
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.estimators.estimator import ESTIMATORS
from drake_quad.scenario.estimators.inertial import (
    AIDING_DESCRIPTION,
    InertialEstimator,
    InitialEstimate,
    aiding_sensor,
)
from drake_quad.scenario.quantities import FixedSpan
from drake_quad.signals import State


class TimeConstantSettings(Model):
    """Time constants with which the estimate follows the sensors."""

    tilt: FixedSpan = Field(default=2.0, description="roll and pitch, which follow the accelerometer (s)")
    bias: FixedSpan = Field(default=20.0, description="bias of the gyroscope (s)")
    rotation: FixedSpan = Field(default=0.5, description="measured attitude, yaw or magnetic field (s)")
    velocity: FixedSpan = Field(default=0.2, description="measured velocity or flow (s)")
    position: FixedSpan = Field(default=0.2, description="measured position, height or distance (s)")


class UnweightedAiding(Model):
    """Empty mapping, which selects a sensor to correct the estimate."""


@ESTIMATORS.register
class ComplementaryFilterSettings(InertialEstimator):
    """Complementary filter on board: a simple alternative to a Kalman filter, with fixed gains.

    By default, the estimate begins with the true state. Latencies and the positions of the sensors are ignored.
    """

    kind: Literal["complementary_filter"]
    aiding: dict[str, UnweightedAiding] | None = Field(default=None, description=AIDING_DESCRIPTION)
    time_constants: TimeConstantSettings = TimeConstantSettings()
    initial_estimate: InitialEstimate = InitialEstimate()
    default_aiding: ClassVar = UnweightedAiding()

    def recipe(self, scenario: Any, fleet: Any, start: State) -> Recipe:
        """Return the recipe for the filters of a fleet."""
        period = scenario.laboratory.named_sensors["gyroscope"].period
        sources = self.sources(scenario.laboratory, fleet.laboratory)
        parameters = ComplementaryParameters(
            record_like(TimeConstants, self.time_constants),
            tuple([each.fleet.aiding_parameters((1.0,) * each.settings.num_components) for each in sources.values()]),
            self.first_estimate(fleet, start),
            gravity=scenario.nominal.gravity,
        )
        aiding = tuple([aiding_sensor(name, each.settings, period) for name, each in sources.items()])
        return Recipe(ComplementaryFilter, {"aiding": aiding, "period": period}, parameters)
