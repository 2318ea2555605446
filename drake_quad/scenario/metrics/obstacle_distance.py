"""Smallest distance from the obstacles."""

import math
from typing import Any, ClassVar, Literal

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.elementary import minimum
from drake_quad.laboratory.flight_monitor import Surroundings, nearest_solid
from drake_quad.laboratory.metrics import CENTIMETRES, Display
from drake_quad.scenario.metrics.metric import METRICS, MetricSettings, ValueSums
from drake_quad.signals import State


def add_distance(sums: ValueSums, state: State, *, surroundings: Surroundings) -> ValueSums:
    """Return the smallest distance so far after a further tick."""
    distance, _ = nearest_solid(state.x, state.y, state.z, surroundings.solids)
    return ValueSums(minimum(sums.value, distance - surroundings.radius))


def _value(sums: ValueSums, ticks: Any, _: float) -> Any:
    """Return the smallest distance; NaN without ticks."""
    return np.where(ticks > 0.0, sums.value, np.nan)


@METRICS.member
class ObstacleDistance(MetricSettings):
    """Smallest distance between the vehicle and the obstacles of the scenario."""

    kind: Literal["obstacle_distance"]
    unit: ClassVar[str] = "m"
    label: ClassVar[str] = "smallest distance from the obstacles"
    display: ClassVar[Display] = CENTIMETRES
    differentiable: ClassVar[bool] = False
    larger_is_better: ClassVar[bool] = True
    initial: ClassVar[Any] = ValueSums(math.inf)
    add: ClassVar = staticmethod(add_distance)
    arguments: ClassVar[tuple[str, ...]] = ("state",)
    value: ClassVar = staticmethod(_value)

    def constants(self, scenario: Any) -> dict[str, Any]:
        """Return the solids and the radius of the vehicle.

        Raises:
            InputError: if the scenario has no obstacles.
        """
        space = scenario.room()
        if space is None or not space.obstacles:
            raise InputError(f"the metric obstacle_distance needs obstacles, but {scenario.name} has no `space`")
        return {"surroundings": Surroundings(tuple(each.shape for each in space.obstacles), space.radius)}
