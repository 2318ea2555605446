"""Estimates of an identification: values, covariance and sources, and reasons why parameters are not identified."""

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, lookup, short_repr, shorten_text
from drake_quad.identification.evidence import quantile, ratio
from drake_quad.identification.random_effects import Variation
from drake_quad.scenario.correlation import checked_deviations
from drake_quad.scenario.declarations import Declaration, quantities_in
from drake_quad.scenario.models import Laboratory, Vehicle
from drake_quad.scenario.paths import join_path
from drake_quad.statistics.interval import Interval


@functools.cache
def declaration_at(path: str) -> Declaration:
    """Return the unit and the bounds of a parameter, or of a list of parameters.

    Any quantity of a vehicle and its laboratory can be a parameter.

    Args:
        path: path inside `vehicle`, or path that starts with `autopilot` or `laboratory`.

    Raises:
        InputError: if no parameter has this path.
    """
    # `functools.cache` does not cache exceptions, so parameters of effects that are registered later are found.
    declarations = dict(quantities_in(Vehicle))
    for inner, declaration in quantities_in(Laboratory):
        declarations[inner if inner.startswith("autopilot.") else f"laboratory.{inner}"] = declaration
    return lookup(declarations, path, "parameter of a vehicle or its laboratory")


def split_name(name: str) -> tuple[str, int | None]:
    """Return the path of a parameter, and its index in a list (from 0), or None for a single number.

    Raises:
        InputError: if no parameter has this name.
    """
    match = re.fullmatch(r"([\w.]+?)(?:\[(\d)\])?", name)
    path, index = (match[1], match[2]) if match else (name, None)
    count = declaration_at(path).items
    if (index is None) != (count == 0) or (index is not None and int(index) >= count):
        allowed = f"{path}[0] to {path}[{count - 1}]" if count else path
        raise InputError(f"{short_repr(name)} is not a parameter; it must be {allowed}")
    return path, None if index is None else int(index)


def declaration_of(name: str) -> Declaration:
    """Return the unit and the bounds of a parameter.

    Raises:
        InputError: if no parameter has this name.
    """
    return declaration_at(split_name(name)[0])


def scenario_path(name: str) -> str:
    """Return the path of a parameter in a scenario: `vehicle.inertia.0` for `inertia[0]`.

    Raises:
        InputError: if no parameter has this name.
    """
    path, index = split_name(name)
    return field_path(path) if index is None else join_path(field_path(path), index)


def field_path(path: str) -> str:
    """Return the path of a field in a scenario, such as `laboratory.autopilot.damping` for `autopilot.damping`."""
    if path.startswith("laboratory."):
        return path
    return join_path("laboratory" if path.startswith("autopilot.") else "vehicle", path)


class Source(NamedTuple):
    """Source of an estimate.

    Attributes:
        method: method of identification, for example "prediction errors of attitude and position".
        log: name of the log to which the method was applied.
    """

    method: str
    log: str

    def __str__(self) -> str:
        return f"{self.method}, {self.log}"


class ExplainedVariance(NamedTuple):
    """Explained variance of the output that a parameter affects most.

    Attributes:
        fraction: fraction of the output variance that the vehicle explains in held-out flight.
        output: name of the output, for example "specific force along z".
    """

    fraction: float
    output: str


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimated parameters of a vehicle and its laboratory, with their covariance.

    Attributes:
        names: (n,) names as in the scenario language, with indices in brackets: `mass`, `inertia[0]`,
            `motors.curve[1]`, `autopilot.damping[2]`, `laboratory.motion_capture.position_noise`; see `declaration_at`.
        values: (n,) values in SI units.
        covariance: (n, n) covariance of the estimation errors.
        degrees_of_freedom: (n,) degrees of freedom of the errors, which follow Student's t-distribution; or one number
            for all errors.
        sources: (n,) sources of each estimate, or a single source for all.
        explained_variance: explained variance by the name of the parameter, if it is known.
        not_identified: reason why the log does not identify a parameter, by the name of the parameter. If such a
            parameter has an estimate, it is a coefficient of a thrust curve that is known only at the thrusts of the
            flight.
        variation: variation of the parameters from one stretch of flight to the next, in addition to the errors of the
            mean parameters; None if it is unknown.
        flight_variation: variation from one flight to the next, in addition to the variation within a flight; None if
            it is unknown.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    degrees_of_freedom: np.ndarray | float
    sources: tuple[tuple[Source, ...], ...] | Source
    explained_variance: Mapping[str, ExplainedVariance] = field(default_factory=dict)
    not_identified: Mapping[str, str] = field(default_factory=dict)
    variation: Variation | None = None
    flight_variation: Variation | None = None

    def __post_init__(self) -> None:
        """Check the fields, and convert them to arrays with one item per parameter.

        Raises:
            InputError: if a name is unknown or occurs twice, shapes do not agree, or a variance or the degrees of
                freedom are not positive.
        """
        names = tuple(self.names)
        for name in (*names, *self.explained_variance, *self.not_identified):
            split_name(name)
        repeated = next((name for name in names if names.count(name) > 1), None)
        if repeated is not None:
            raise InputError(f"{short_repr(repeated)} is estimated twice")
        values, covariance = np.array(self.values, dtype=float), np.array(self.covariance, dtype=float)
        checked_deviations(names, values, covariance)
        freedom = np.broadcast_to(np.asarray(self.degrees_of_freedom, dtype=float), (len(names),)).copy()
        if not np.all(freedom > 0.0):
            raise InputError("degrees of freedom must be larger than 0")
        sources = ((self.sources,),) * len(names) if isinstance(self.sources, Source) else tuple(self.sources)
        if len(sources) != len(names):
            raise InputError(
                f"sources must have an item for each of the {len(names)} estimates, not {len(sources)} items"
            )
        for name, value in (
            ("names", names),
            ("values", values),
            ("covariance", 0.5 * (covariance + covariance.T)),
            ("degrees_of_freedom", freedom),
            ("sources", sources),
        ):
            object.__setattr__(self, name, value)

    def __str__(self) -> str:
        """Return a line for each estimate, with its unit and 95 % interval, and for each unidentified parameter."""
        rows = zip(self.names, self.values, self.intervals(), self.units, strict=True)
        lines = [
            f"{name}: {Interval(value, *ends).text(unit='' if unit == '1' else unit)}"
            for name, value, ends, unit in rows
            if name not in self.not_identified
        ]
        return "\n".join(
            [*lines, *(f"not identified: {name}: {reason}" for name, reason in self.not_identified.items())]
        )

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the logs identify."""
        return tuple(name for name in self.names if name not in self.not_identified)

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (n,) of the errors of the n estimates, in the units of the parameters."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """Correlations (n, n) between the errors of the n estimates."""
        return self.covariance / np.outer(self.deviations, self.deviations)

    @property
    def units(self) -> tuple[str, ...]:
        """Units (n,) of the n estimated parameters."""
        return tuple(declaration_of(name).unit for name in self.names)

    @property
    def variation_known(self) -> np.ndarray:
        """Mask (n,) of the parameters whose variation between flights is known."""
        known = np.zeros(len(self.names), dtype=bool)
        for each in self._variations:
            known |= np.isfinite(np.diag(each.covariance))
        return known

    @property
    def _variations(self) -> list[Variation]:
        return [each for each in (self.variation, self.flight_variation) if each is not None]

    def quantiles(self) -> np.ndarray:
        """Return the half-width of each 95 % confidence interval (n,) in standard deviations."""
        return quantile(self.degrees_of_freedom)

    def intervals(self) -> np.ndarray:
        """Return the lower and upper end of the 95 % confidence interval of each value, (n, 2)."""
        half_widths = self.quantiles() * self.deviations
        return np.stack([self.values - half_widths, self.values + half_widths], axis=1)

    def value(self, name: str) -> float:
        """Return the estimate of a parameter.

        Raises:
            InputError: if the parameter is not estimated.
        """
        if name not in self.names:
            reason = f": {self.not_identified[name]}" if name in self.not_identified else ""
            raise InputError(f"there is no estimate of {shorten_text(name)}{reason}")
        return float(self.values[self.names.index(name)])

    def sources_of(self, index: int) -> tuple[Source, ...]:
        """Return the sources of an estimate, given its index."""
        assert not isinstance(self.sources, Source)
        return self.sources[index]

    def subset(self, names: Sequence[str]) -> "Estimates":
        """Return the estimates of some parameters, in the given order.

        Raises:
            InputError: if one of the parameters is not estimated.
        """
        for name in names:
            self.value(name)
        indices = [self.names.index(name) for name in names]
        return replace(
            self,
            names=tuple(names),
            values=self.values[indices],
            covariance=self.covariance[np.ix_(indices, indices)],
            degrees_of_freedom=np.asarray(self.degrees_of_freedom)[indices],
            sources=tuple(self.sources_of(index) for index in indices),
            explained_variance={name: fraction for name, fraction in self.explained_variance.items() if name in names},
            variation=None if self.variation is None else self.variation.subset(indices),
            flight_variation=None if self.flight_variation is None else self.flight_variation.subset(indices),
        )

    def for_new_flight(self) -> "Estimates":
        """Return the estimates with the covariance that applies to a stretch of a new flight.

        The covariance is the sum of three covariances: that of the errors, that of the variation from stretch to
        stretch, and that of the variation from flight to flight. The degrees of freedom follow F. E. Satterthwaite
        (Biometrics Bulletin 2, 1946). The covariance of a parameter with unknown variation is unchanged.
        """
        if not self._variations:
            return self
        covariance, parts = self.covariance, np.diag(self.covariance) ** 2 / self.degrees_of_freedom
        for each in self._variations:
            variation = np.nan_to_num(each.covariance)
            covariance = covariance + variation
            parts = parts + np.diag(variation) ** 2 / each.degrees_of_freedom
        return replace(
            self,
            covariance=covariance,
            degrees_of_freedom=ratio(np.diag(covariance) ** 2, parts, np.inf),
            variation=None,
            flight_variation=None,
        )
