"""Time within a tube around the reference."""

from typing import Annotated

from pydantic import Field

from drake_quad.framework.elementary import where
from drake_quad.scenario.metrics.metric import metric
from drake_quad.scenario.quantities import FixedPositive
from drake_quad.signals import Reference, Row, State


@metric("s", over_time="integral", label="time within the tube", larger_is_better=True, value_range="nonnegative")
def time_in_tube(
    state: State,
    reference: Reference,
    *,
    radius: Annotated[FixedPositive, Field(description="radius of the tube (m)")] = 0.1,
) -> Row:
    """Time during which the distance from the reference is at most a radius."""
    x, y, z = state.x - reference.x, state.y - reference.y, state.z - reference.z
    return where(x * x + y * y + z * z <= radius * radius, 1.0, 0.0)
