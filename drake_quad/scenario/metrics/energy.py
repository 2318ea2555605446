"""Energy of a flight."""

from drake_quad.scenario.metrics.metric import metric
from drake_quad.signals import BatteryLoad, Row


@metric("J", over_time="integral", label="energy from the battery", value_range="nonnegative")
def energy(battery: BatteryLoad) -> Row:
    """Energy drawn from the battery; the vehicle must have a `battery`."""
    return battery.voltage * battery.current
