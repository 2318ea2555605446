"""Metric `obstacle_distance`: smallest distance between the vehicle and the obstacles."""

import math
from typing import Any, Literal

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.elementary import minimum
from drake_quad.laboratory.flight_monitor import Surroundings, nearest_solid
from drake_quad.laboratory.metrics import Accumulator, Metric
from drake_quad.scenario.metrics.metric import METRICS, Appearance, MetricSettings, ValueSums
from drake_quad.signals import State

_APPEARANCE = Appearance("m", "smallest distance from the obstacles", larger_is_better=True)


def add_distance(sums: ValueSums, state: State, *, surroundings: Surroundings) -> ValueSums:
    """Return the smallest distance between the vehicle and the obstacles up to and including a tick."""
    distance, _ = nearest_solid(state.x, state.y, state.z, surroundings.solids)
    return ValueSums(minimum(sums.value, distance - surroundings.radius))


def _value(sums: ValueSums, ticks: Any, _: float) -> Any:
    """Return the smallest distance, or NaN if there are no ticks."""
    return np.where(ticks > 0.0, sums.value, np.nan)


@METRICS.register
class ObstacleDistance(MetricSettings):
    """Smallest distance between the vehicle and the obstacles of the scenario."""

    kind: Literal["obstacle_distance"]

    def definition(self, name: str, scenario: Any) -> Metric:
        """Return the definition of the metric, given its name in a scenario.

        Raises:
            InputError: if the scenario has no obstacles.
        """
        space = scenario.flight_space()
        if space is None or not space.obstacles:
            raise InputError(f"metrics.additional.{name} needs obstacles, but {scenario.name} has none in `space`")
        surroundings = Surroundings(tuple(each.shape for each in space.obstacles), space.radius)
        accumulator = Accumulator(ValueSums(math.inf), add_distance, ("state",), (("surroundings", surroundings),))
        return _APPEARANCE.metric(name, accumulator, _value)
