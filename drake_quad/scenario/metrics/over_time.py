"""Metrics that combine the values of a scalar signal over time: mean, RMS, largest, smallest, last value, integral."""

from typing import Any, Literal

from pydantic import Field, create_model, field_validator

from drake_quad.errors import InputError
from drake_quad.laboratory.derived_signals import scalar_signal
from drake_quad.laboratory.metrics import Metric
from drake_quad.scenario.distributions import validation_error
from drake_quad.scenario.metrics.metric import METRICS, Appearance, MetricSettings, reduced_metric

# Description of the metric that each rule computes.
_DESCRIPTIONS = {
    "mean": "Mean of a scalar signal.",
    "rms": "Root mean square of a scalar signal.",
    "max": "Largest value of a scalar signal.",
    "min": "Smallest value of a scalar signal.",
    "last": "Last value of a scalar signal.",
    "integral": "Integral of a scalar signal over time.",
}


class SignalMetric(MetricSettings):
    """Metric that combines the values of a scalar signal over time."""

    of: str = Field(description="name of a derived signal, or of a component of a signal, such as `state.z`")

    @field_validator("of")
    @classmethod
    def _is_a_scalar_signal(cls, name: str) -> str:
        try:
            scalar_signal(name)
        except InputError as error:
            raise validation_error(f"must be a scalar signal: {error}") from None
        return name

    def definition(self, name: str, scenario: Any) -> Metric:
        """Return the definition of the metric, given its name in a scenario."""
        signal = scalar_signal(self.of)
        unit = f"{signal.unit} s" if self.kind == "integral" else signal.unit
        return reduced_metric(
            name, self.kind, signal.formula, signal.arguments, Appearance(unit, value_range=signal.value_range)
        )


for _rule, _description in _DESCRIPTIONS.items():
    _name = f"{_rule.capitalize()}OverTime"
    # Pickle looks the class up by its name in this module.
    globals()[_name] = METRICS.register(
        create_model(
            _name,
            __base__=SignalMetric,
            __module__=__name__,
            __doc__=_description,
            kind=(Literal[_rule], ...),  # type: ignore[arg-type]
        )
    )
