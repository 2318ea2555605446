"""Distributions in the scenario language, any of which can replace the value of a physical quantity."""

import math
import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from functools import reduce
from operator import or_
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, get_args

import numpy as np
import scipy
from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from drake_quad.errors import join_names, short_repr
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, declared_inactive_settings
from drake_quad.scenario.limits import MAX_MAGNITUDE, MIN_MAGNITUDE
from drake_quad.scenario.user_code import import_option

Real = Annotated[float, Field(ge=-MAX_MAGNITUDE, le=MAX_MAGNITUDE)]
# Pattern for the name of a shared variable.
_SHARED_NAME_PATTERN = "[A-Za-z_][A-Za-z0-9_]{0,59}"
# Largest rounding error in the sum of the squared correlations of a field.
_CORRELATION_TOLERANCE = 1e-12
_AnyDistribution = TypeVar("_AnyDistribution", bound="Distribution")


class Model(BaseModel):
    """Base class of all mappings in the scenario language: immutable, without unknown fields, type coercion or NaN.

    Attributes:
        strength_fields: names of fields. The mapping has no effect if all of them are zero. Empty if the mapping always
            has an effect.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, validate_default=True)
    strength_fields: ClassVar[tuple[str, ...]] = ()

    def __str__(self) -> str:
        """Return the same text as `repr`."""
        return repr(self)

    @model_validator(mode="before")
    @classmethod
    def _no_unknown_field(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise PydanticCustomError(
                        "unknown_field",
                        "is unknown; allowed are {allowed}",
                        {"path": (key,), "fields": [*cls.model_fields], "allowed": join_names([*cls.model_fields])},
                    )
        elif not isinstance(data, Model):
            raise validation_error(f"must be a mapping of fields such as {join_names([*cls.model_fields], 4)}")
        return data

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield the settings of this mapping that have no effect on a flight, excluding nested mappings."""
        yield from declared_inactive_settings(self, path)

    def implausible_fields(self) -> Iterator[tuple[str, str]]:
        """Yield the path and a clause with the reason for each field that is implausible given other fields."""
        return iter(())

    @classmethod
    def registration_option(cls) -> str:
        """Return the command-line option that registers this model; empty for a model of this library."""
        return import_option(cls)

    def field_error(self, demand: str, *path: str | int) -> PydanticCustomError:
        """Return a validation error about a field of this mapping, which reports the value of the field.

        Args:
            demand: requirement on the value, such as "must be finite".
            path: keys and indices that lead from this mapping to the field.
        """
        value: Any = self
        for key in path:
            value = getattr(value, str(key)) if isinstance(value, Model) else value[key]
        return validation_error(demand, path=path, value=value)


def validation_error(demand: str, **context: Any) -> PydanticCustomError:
    """Return a validation error whose message states a requirement on the value, such as "must be finite"."""
    return PydanticCustomError("refused", "{demand}", {"demand": demand, **context})


def omits_defaults(*names: str) -> Any:
    """Return a serializer that omits the given fields of a model if they have their default values.

    Use it for fields that a later version adds. A study is identified by the hash of its document, so documents without
    these fields must not change.
    """

    @model_serializer(mode="wrap")
    def serialize(self: Model, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = write(self)
        omitted = {name for name in names if getattr(self, name) == type(self).model_fields[name].default}
        return {name: value for name, value in fields.items() if name not in omitted}

    return serialize


class Range(Model):
    """Interval between a smaller and a larger number."""

    min: Real = Field(description="smallest value")
    max: Real = Field(description="largest value")

    @model_validator(mode="after")
    def _max_exceeds_min(self) -> "Range":
        if not self.min < self.max:
            raise self.field_error(f"must be larger than min, {self.min}", "max")
        return self


class PositiveRange(Range):
    """Interval between a smaller and a larger positive number."""

    min: Annotated[float, Field(ge=MIN_MAGNITUDE, le=MAX_MAGNITUDE)] = Field(description="smallest value")


class NormalParameters(Model):
    """A normal distribution, truncated at its limits if it has any."""

    mean: Real = Field(description="mean of the normal distribution before truncation")
    standard_deviation: Annotated[float, Field(gt=0.0, le=MAX_MAGNITUDE)] = Field(
        description="standard deviation of the normal distribution before truncation"
    )
    min: Real | None = Field(default=None, description="lower limit; none if not given")
    max: Real | None = Field(default=None, description="upper limit; none if not given")
    shared: dict[str, Annotated[float, Field(ge=-1.0, le=1.0)]] = Field(
        default={},
        description="correlations with shared standard normal variables, by the name of the variable; for each sample,"
        " a variable is drawn once for all fields that name it; the squares of a field's correlations sum to at most 1",
        json_schema_extra={"propertyNames": {"pattern": f"^{_SHARED_NAME_PATTERN}$"}},
    )

    @field_validator("shared")
    @classmethod
    def _correlations_are_valid(cls, shared: dict[str, float]) -> dict[str, float]:
        wrong_name = next((name for name in shared if not re.fullmatch(_SHARED_NAME_PATTERN, name)), None)
        if wrong_name is not None:
            raise validation_error(
                f"must not have the name {short_repr(wrong_name)}; the name of a shared variable must consist of at"
                " most 60 letters, digits and '_', and must not begin with a digit"
            )
        total = math.fsum(each * each for each in shared.values())
        if total > 1.0 + _CORRELATION_TOLERANCE:
            raise validation_error(f"must have correlations whose squares sum to at most 1, not {total:.6g}")
        return shared

    _serialized = omits_defaults("shared")

    @model_validator(mode="after")
    def _limits_around_mean(self) -> "NormalParameters":
        if self.min is not None and self.min > self.mean:
            raise self.field_error(f"must not be larger than the mean, {self.mean}", "min")
        if self.max is not None and self.max < self.mean:
            raise self.field_error(f"must not be smaller than the mean, {self.mean}", "max")
        return self


class Distribution(Model):
    """Distribution of a number. A scenario contains it as a mapping whose only field is the name of the distribution.

    Attributes:
        parameters: type of the parameters in a YAML document.
        dimensionless: names of the parameters that do not have the unit of the number, such as correlations.
    """

    parameters: ClassVar[type | UnionType] = Mapping
    dimensionless: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def extremes(self) -> tuple[float | None, float | None]:
        """Return the smallest and the largest possible value; None for a bound that does not exist."""

    @abstractmethod
    def quantile(self, probability: Any) -> Any:
        """Return the quantile of the distribution at a probability, a number or an array."""

    @property
    def values(self) -> tuple[float, ...] | None:
        """All possible values; None if there are infinitely many."""
        return None

    @property
    def correlations(self) -> Mapping[str, float]:
        """Correlations with shared standard normal variables, by the name of the variable."""
        return {}


DISTRIBUTIONS: dict[str, type[Distribution]] = {}
"""Classes of distributions, by the name of the distribution."""


def _register(model: type[_AnyDistribution]) -> type[_AnyDistribution]:
    """Add a class to `DISTRIBUTIONS`, under the name of its only field."""
    (name,) = model.model_fields
    DISTRIBUTIONS[name] = model
    return model


@_register
class Uniform(Distribution):
    """Uniform distribution: all numbers of an interval are equally likely."""

    uniform: Range

    def __repr__(self) -> str:
        """Return a short text such as `uniform(0.64, 0.72)`."""
        return f"uniform({self.uniform.min:g}, {self.uniform.max:g})"

    def extremes(self) -> tuple[float | None, float | None]:
        """Return the smallest and the largest possible value; None for a bound that does not exist."""
        return self.uniform.min, self.uniform.max

    def quantile(self, probability: Any) -> Any:
        """Return the quantile at a probability."""
        return self.uniform.min + probability * (self.uniform.max - self.uniform.min)


@_register
class LogUniform(Distribution):
    """Log-uniform distribution: the logarithm is uniformly distributed, as for scale factors."""

    log_uniform: PositiveRange

    def __repr__(self) -> str:
        """Return a short text such as `log_uniform(0.001, 1)`."""
        return f"log_uniform({self.log_uniform.min:g}, {self.log_uniform.max:g})"

    def extremes(self) -> tuple[float | None, float | None]:
        """Return the smallest and the largest possible value; None for a bound that does not exist."""
        return self.log_uniform.min, self.log_uniform.max

    def quantile(self, probability: Any) -> Any:
        """Return the quantile at a probability."""
        return self.log_uniform.min * (self.log_uniform.max / self.log_uniform.min) ** probability


@_register
class Normal(Distribution):
    """Normal distribution, optionally correlated with other normal distributions.

    A field that permits only a range of values requires the limits `min` and `max` within this range.
    """

    normal: NormalParameters
    dimensionless: ClassVar = ("shared",)

    def __repr__(self) -> str:
        """Return a short text such as `normal(0.7, 0.03, min=0.6)`."""
        normal = self.normal
        limits = [
            f"{name}={limit:g}" for name, limit in (("min", normal.min), ("max", normal.max)) if limit is not None
        ]
        shared = [f"shared={normal.shared}"] if normal.shared else []
        return f"normal({', '.join([f'{normal.mean:g}', f'{normal.standard_deviation:g}', *limits, *shared])})"

    def extremes(self) -> tuple[float | None, float | None]:
        """Return the smallest and the largest possible value; None for a bound that does not exist."""
        return self.normal.min, self.normal.max

    @property
    def correlations(self) -> Mapping[str, float]:
        """Correlations with shared standard normal variables, by the name of the variable."""
        return self.normal.shared

    def quantile(self, probability: Any) -> Any:
        """Return the quantile at a probability."""
        mean, deviation = self.normal.mean, self.normal.standard_deviation
        low, high = self.normal.min, self.normal.max
        below = 0.0 if low is None else scipy.special.ndtr((low - mean) / deviation)
        above = 1.0 if high is None else scipy.special.ndtr((high - mean) / deviation)
        value = mean + deviation * scipy.special.ndtri(below + probability * (above - below))
        return np.clip(value, low, high)


@_register
class Choice(Distribution):
    """Choice of one of several numbers, which are equally likely."""

    choice: Annotated[tuple[Real, ...], Field(strict=False, min_length=1)]
    parameters: ClassVar = list | tuple

    @property
    def values(self) -> tuple[float, ...]:
        """Numbers from which the distribution chooses."""
        return self.choice

    def __repr__(self) -> str:
        """Return a short text such as `choice(0, 1, 2)`."""
        return f"choice({', '.join(f'{each:g}' for each in self.choice)})"

    def extremes(self) -> tuple[float | None, float | None]:
        """Return the smallest and the largest possible value; None for a bound that does not exist."""
        return min(self.choice), max(self.choice)

    def quantile(self, probability: Any) -> Any:
        """Return the quantile at a probability. The numbers of the choice are used in their given order, not sorted."""
        return np.array(self.choice)[(np.asarray(probability) * len(self.choice)).astype(int)]


def is_distribution(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping from a YAML document is a distribution.

    A distribution has a single field, which contains a mapping of parameters or, for a choice, a list. The field name
    alone does not decide, since a half-space also has a field `normal`, which is a vector.

    Args:
        fields: values of the mapping by field name.
    """
    name, *others = fields or [""]
    if others or name not in DISTRIBUTIONS:
        return False
    return isinstance(fields[name], DISTRIBUTIONS[name].parameters)


def is_number_or_distribution(hint: Any) -> bool:
    """Return whether a type hint, without its annotations, is a number that a distribution may replace."""
    return any(get_args(member)[:1] == (Normal,) for member in get_args(hint))


def _tag(value: Any) -> str | None:
    if not isinstance(value, dict | Model):
        return "number"
    keys = value if isinstance(value, dict) else type(value).model_fields
    return next((name for name in DISTRIBUTIONS if name in keys), None)


if TYPE_CHECKING:
    # Type checkers see `Any`, since most code uses scenarios whose distributions have been replaced by numbers.
    NumberOrDistribution = Any
else:
    _NUMBER: Any = Annotated[Real, Tag("number")]
    NumberOrDistribution = Annotated[
        reduce(or_, (Annotated[model, Tag(name)] for name, model in DISTRIBUTIONS.items()), _NUMBER),
        Discriminator(
            _tag,
            custom_error_type="distribution",
            custom_error_message=f"must be a number or one of the distributions {', '.join(DISTRIBUTIONS)}",
        ),
    ]
