"""Requirements in the scenario language, based on signal temporal logic."""

import math
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from drake_quad.errors import InputError
from drake_quad.laboratory import requirements
from drake_quad.laboratory.derived_signals import scalar_signal
from drake_quad.laboratory.metrics import Accumulator, Metric
from drake_quad.scenario.distributions import Model, Real, validation_error
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, late_setting
from drake_quad.scenario.metrics.metric import Appearance
from drake_quad.scenario.quantities import FixedMoment


class Condition(Model):
    """Condition on signals: bounds on a scalar signal, or a combination of conditions."""

    signal: str | None = Field(default=None, description="derived signal, or component of a signal such as `state.z`")
    above: Real | None = Field(default=None, description="lower bound, in the unit of the signal")
    below: Real | None = Field(default=None, description="upper bound, in the unit of the signal")
    all: Annotated[tuple["Condition", ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="conditions that must all hold, in place of a signal"
    )
    any: Annotated[tuple["Condition", ...], Field(strict=False, min_length=1)] | None = Field(
        default=None, description="conditions of which at least one must hold, in place of a signal"
    )

    @field_validator("signal")
    @classmethod
    def _is_a_scalar_signal(cls, name: str | None) -> str | None:
        try:
            if name is not None:
                scalar_signal(name)
        except InputError as error:
            raise validation_error(f"must be a scalar signal: {error}") from None
        return name

    @model_validator(mode="after")
    def _is_of_one_form(self) -> "Condition":
        if [self.signal, self.all, self.any].count(None) != 2:
            raise validation_error("must have exactly one of the fields `signal`, `all` and `any`")
        bounded = self.above is not None or self.below is not None
        if bounded != (self.signal is not None):
            raise validation_error("must have a bound (`above` or `below`) if it has a `signal`, and otherwise none")
        if self.above is not None and self.below is not None and not self.above < self.below:
            raise self.field_error(f"must be larger than `above`, {self.above}", "below")
        if len(units := self.units()) > 1:
            raise validation_error(
                f"must not combine signals in {' and '.join(sorted(units))}, since their margins cannot be compared;"
                " write a requirement for each"
            )
        return self

    def units(self) -> set[str]:
        """Return the units of all signals in the condition."""
        if self.signal is not None:
            return {scalar_signal(self.signal).unit}
        return {unit for each in (*(self.all or ()), *(self.any or ())) for unit in each.units()}

    def formula(self) -> requirements.Condition:
        """Return the formula for the margin of the condition."""
        if self.signal is None:
            rule, conditions = ("any", self.any or ()) if self.all is None else ("all", self.all)
            return requirements.Combination(rule, tuple(each.formula() for each in conditions))  # type: ignore[arg-type]
        signal = scalar_signal(self.signal)
        lower = -math.inf if self.above is None else self.above
        return requirements.Bound(
            signal.formula, signal.arguments, lower, math.inf if self.below is None else self.below
        )


class Requirement(Model):
    """Requirement on a flight. It is satisfied if its robustness is at least 0."""

    always: Condition | None = Field(
        default=None, description="condition that must hold at all ticks of the requirement's window"
    )
    eventually: Condition | None = Field(
        default=None, description="condition that must hold at one or more ticks of the requirement's window"
    )
    until: Condition | None = Field(
        default=None,
        description="condition that must hold at one tick of the requirement's window; up to this tick, the condition"
        " of `always` must hold from the start of the flight",
    )
    after: FixedMoment = Field(default=0.0, description="start of the requirement's window (s)")
    before: FixedMoment | None = Field(
        default=None, description="end of the requirement's window (s); the end of the flight if not given"
    )

    @model_validator(mode="after")
    def _is_of_one_form(self) -> "Requirement":
        if (self.always is None) == (self.eventually is None):
            raise validation_error("must have either `always` or `eventually`")
        if self.until is not None and self.always is None:
            raise validation_error("must have `always` if it has `until`")
        if self.before is not None and not self.before > self.after:
            raise self.field_error(f"must be later than `after`, {self.after}", "before")
        if len(units := {unit for each in self._conditions() for unit in each.units()}) > 1:
            raise validation_error(
                f"must not combine signals in {' and '.join(sorted(units))}, since their margins cannot be compared"
            )
        return self

    def _conditions(self) -> list[Condition]:
        return [each for each in (self.always, self.eventually, self.until) if each is not None]

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as a time window after the end of the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "after", flight, path)

    def definition(self, name: str) -> Metric:
        """Define the robustness as a metric with the given name."""
        (unit,) = self._conditions()[0].units()
        label = f"robustness of {name.replace('_', ' ')}"
        return Appearance(unit, label, larger_is_better=True).metric(name, self._accumulator(), requirements.robustness)

    def _accumulator(self) -> Accumulator:
        window = self.after, math.inf if self.before is None else self.before
        if self.eventually is not None:
            return requirements.eventually(self.eventually.formula(), *window)
        assert self.always is not None
        if self.until is not None:
            return requirements.holds_until(self.always.formula(), self.until.formula(), *window)
        return requirements.always(self.always.formula(), *window)
