"""Estimates of an identification: values, covariance, sources, and reasons for parameters that are not identified."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, listed, shortened, shown
from drake_quad.identification.random_effects import Variation
from drake_quad.scenario.correlation import checked_deviations
from drake_quad.scenario.limits import LARGEST, LONGEST, SHORTEST, SMALLEST
from drake_quad.scenario.paths import joined
from drake_quad.statistics.interval import CONFIDENCE, Interval


class Kind(NamedTuple):
    """Unit and range of a parameter.

    Attributes:
        unit: unit; "1" for a ratio.
        lower: smallest value that the scenario language allows.
        upper: largest value that it allows.
        items: number of items of a list; 0 for a single number.
        integer: whether the parameter is an integer.
    """

    unit: str
    lower: float = -LARGEST
    upper: float = LARGEST
    items: int = 0
    integer: bool = False


def _positive(unit: str, items: int = 0) -> Kind:
    return Kind(unit, SMALLEST, items=items)


def _not_negative(unit: str, items: int = 0) -> Kind:
    return Kind(unit, 0.0, items=items)


_TICKS = Kind("1", 0.0, 50.0, integer=True)
_SHARE = Kind("1", 0.0, 1.0)

# Keys are paths inside `vehicle`, or paths that start with `autopilot` or `laboratory`.
KINDS = {
    "mass": _positive("kg"),
    "inertia": _positive("kg m²", 3),
    "rotor_inertia": _not_negative("kg m²"),
    "thrust_factor": _positive("N s²"),
    "drag_factor": _positive("N m s²"),
    "arm_length": _positive("m"),
    "thrust_factor_error": Kind("1", -1.0 + SMALLEST, items=4),
    "centre_of_mass": Kind("m", items=2),
    "linear_drag": _not_negative("N s/m"),
    "quadratic_drag": _not_negative("N s²/m²"),
    "rotor_time_constant": Kind("s", SHORTEST, LONGEST),
    "rotor_time_constant_down": Kind("s", SHORTEST, LONGEST),
    "motors.curve": Kind("N", items=3),
    "body_drag.linear": _not_negative("N s/m", 3),
    "body_drag.quadratic": _not_negative("N s²/m²", 3),
    "body_drag.centre_of_pressure": Kind("m", items=3),
    "trim_force.x": Kind("N"),
    "trim_force.y": Kind("N"),
    "rotor_aerodynamics.lift": _not_negative("N s²/m²"),
    "rotor_aerodynamics.climb": Kind("N s/m"),
    "rotor_aerodynamics.drag": _not_negative("N s²/m"),
    "rotor_aerodynamics.inflow": _not_negative("N s²/m"),
    "autopilot.natural_frequency": _positive("rad/s", 3),
    "autopilot.damping": _positive("1", 3),
    "autopilot.gyroscope_noise": _not_negative("rad/s"),
    "autopilot.gyroscope_bias": Kind("rad/s", items=3),
    "autopilot.attitude_noise": _not_negative("rad"),
    "laboratory.motion_capture.position_noise": _not_negative("m"),
    "laboratory.motion_capture.attitude_noise": _not_negative("rad"),
    "laboratory.motion_capture.misalignment": Kind("rad", items=3),
    "laboratory.motion_capture.derivative_bandwidth": _positive("rad/s"),
    "laboratory.motion_capture.dropout_rate": _SHARE,
    "laboratory.motion_capture.latency_frames": _TICKS,
    "laboratory.command_link.delay_ticks": _TICKS,
    "laboratory.command_link.loss_rate": _SHARE,
}


def split_name(name: str) -> tuple[str, int | None]:
    """Return the path of a parameter, and its place in a list, counted from 0; None if it is a single number.

    Raises:
        InputError: if no number of a vehicle or its laboratory has this name.
    """
    found = re.fullmatch(r"([\w.]+?)(?:\[(\d)\])?", name)
    path, place = (found[1], found[2]) if found else (name, None)
    if path not in KINDS:
        close = difflib.get_close_matches(path, KINDS, 1)
        hint = f"; did you mean {close[0]}?" if close else f"; allowed are {listed([*KINDS], len(KINDS))}"
        raise InputError(f"{shown(name)} is no number that can be identified{hint}")
    count = KINDS[path].items
    if (place is None) != (count == 0) or (place is not None and int(place) >= count):
        allowed = f"{path}[0] to {path}[{count - 1}]" if count else path
        raise InputError(f"{shown(name)} is no number that can be identified, which are {allowed}")
    return path, None if place is None else int(place)


def kind_of(name: str) -> Kind:
    """Return unit and range of a parameter.

    Raises:
        InputError: if no parameter has this name.
    """
    path, _ = split_name(name)
    return KINDS[path]


def scenario_path(name: str) -> str:
    """Return the path of a parameter in a scenario: `vehicle.inertia.0` for `inertia[0]`.

    Raises:
        InputError: if no parameter has this name.
    """
    path, place = split_name(name)
    return field_path(path) if place is None else joined(field_path(path), place)


def field_path(path: str) -> str:
    """Return the path in a scenario of a field of `KINDS`: `laboratory.autopilot.damping` for `autopilot.damping`."""
    if path.startswith("laboratory."):
        return path
    return joined("laboratory" if path.startswith("autopilot.") else "vehicle", path)


class Source(NamedTuple):
    """Source of an estimate.

    Attributes:
        method: method of identification, as in "prediction errors of attitude and position".
        log: name of the log that it was applied to.
    """

    method: str
    log: str

    def __str__(self) -> str:
        return f"{self.method}, {self.log}"


class Explained(NamedTuple):
    """Share of an output that a vehicle explains, for the output that a parameter affects most.

    Attributes:
        share: explained share of the variance of the output in held-out flight, 1.
        output: name of the output, as in "specific force along z".
    """

    share: float
    output: str


def quantile(degrees_of_freedom: np.ndarray | float, level: float = CONFIDENCE) -> np.ndarray:
    """Return half of the length of a confidence interval in standard deviations, by Student's distribution.

    Args:
        degrees_of_freedom: degrees of freedom, of any shape; infinite for the normal distribution.
        level: confidence level.
    """
    return np.asarray(scipy.stats.t.ppf(0.5 * (1.0 + level), degrees_of_freedom))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimated parameters of a vehicle and its laboratory, with their covariance.

    Attributes:
        names: (n,) names as in the scenario language, with places in brackets: `mass`, `inertia[0]`, `motors.curve[1]`,
            `autopilot.damping[2]`, `laboratory.motion_capture.position_noise`; see `KINDS`.
        values: (n,) values in SI units.
        covariance: (n, n) covariance of their errors.
        degrees_of_freedom: (n,) degrees of freedom of Student's distribution of each error, or one number for all.
        sources: (n,) sources of each estimate, or a single source for all.
        explained: share of an output that is explained, by the name of the parameter, where it is known.
        not_identified: reason why the log does not identify a parameter, by its name. The estimate of such a parameter,
            if there is one, is the value of the data sheet, as far as the log narrows it.
        remarks: further sentences on the estimates.
        variation: variation of the parameters from one stretch of flight to the next, in addition to the errors of
            their means; None if it is unknown.
        flight_variation: variation from one flight to the next, in addition to that within a flight; None if it is
            unknown.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    degrees_of_freedom: np.ndarray | float
    sources: tuple[tuple[Source, ...], ...] | Source
    explained: Mapping[str, Explained] = field(default_factory=dict)
    not_identified: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    variation: Variation | None = None
    flight_variation: Variation | None = None

    def __post_init__(self) -> None:
        """Check the fields, and convert them to arrays with one item per parameter.

        Raises:
            InputError: if a name is unknown or occurs twice, shapes do not agree, a variance is not positive, or the
                degrees of freedom are not.
        """
        names = tuple(self.names)
        for name in (*names, *self.explained, *self.not_identified):
            split_name(name)
        repeated = next((name for name in names if names.count(name) > 1), None)
        if repeated is not None:
            raise InputError(f"{shown(repeated)} is estimated twice")
        values, covariance = np.array(self.values, dtype=float), np.array(self.covariance, dtype=float)
        checked_deviations(names, values, covariance)
        freedom = np.broadcast_to(np.asarray(self.degrees_of_freedom, dtype=float), (len(names),)).copy()
        if not np.all(freedom > 0.0):
            raise InputError("degrees of freedom must be larger than 0")
        sources = ((self.sources,),) * len(names) if isinstance(self.sources, Source) else tuple(self.sources)
        if len(sources) != len(names):
            raise InputError(f"{len(names)} estimates need as many sources, not {len(sources)}")
        for name, value in (
            ("names", names),
            ("values", values),
            ("covariance", 0.5 * (covariance + covariance.T)),
            ("degrees_of_freedom", freedom),
            ("sources", sources),
        ):
            object.__setattr__(self, name, value)

    def __str__(self) -> str:
        """Return a line for each parameter with its unit and 95 % interval, and one for each not identified."""
        rows = zip(self.names, self.values, self.intervals(), self.units, strict=True)
        found = [
            f"{name}: {Interval(value, *ends).text(unit='' if unit == '1' else unit)}"
            for name, value, ends, unit in rows
            if name not in self.not_identified
        ]
        return "\n".join([*found, *(f"not identified: {name}: {why}" for name, why in self.not_identified.items())])

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the logs identify."""
        return tuple(name for name in self.names if name not in self.not_identified)

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (n,) of the errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """Correlations (n, n) of the errors."""
        return self.covariance / np.outer(self.deviations, self.deviations)

    @property
    def units(self) -> tuple[str, ...]:
        """Units (n,) of the values."""
        return tuple(kind_of(name).unit for name in self.names)

    @property
    def variation_known(self) -> np.ndarray:
        """Mask (n,) of the parameters whose variation is known."""
        known = np.zeros(len(self.names), dtype=bool)
        for each in self._variations:
            known |= np.isfinite(np.diag(each.covariance))
        return known

    @property
    def _variations(self) -> list[Variation]:
        return [each for each in (self.variation, self.flight_variation) if each is not None]

    def quantiles(self, level: float = CONFIDENCE) -> np.ndarray:
        """Return half of the length of each confidence interval (n,) in standard deviations."""
        return quantile(self.degrees_of_freedom, level)

    def intervals(self, level: float = CONFIDENCE) -> np.ndarray:
        """Return lower and upper end of the confidence interval of each value, (n, 2).

        Args:
            level: confidence level.
        """
        reach = self.quantiles(level) * self.deviations
        return np.stack([self.values - reach, self.values + reach], axis=1)

    def value(self, name: str) -> float:
        """Return the estimate of a parameter.

        Raises:
            InputError: if it is not estimated.
        """
        if name not in self.names:
            why = f": {self.not_identified[name]}" if name in self.not_identified else ""
            raise InputError(f"there is no estimate of {shortened(name)}{why}")
        return float(self.values[self.names.index(name)])

    def sources_of(self, place: int) -> tuple[Source, ...]:
        """Return the sources of the estimate at a place among the names."""
        assert not isinstance(self.sources, Source)
        return self.sources[place]

    def part(self, names: Sequence[str]) -> "Estimates":
        """Return some of the estimates, in this order.

        Raises:
            InputError: if one of them is not estimated.
        """
        for name in names:
            self.value(name)
        places = [self.names.index(name) for name in names]
        return replace(
            self,
            names=tuple(names),
            values=self.values[places],
            covariance=self.covariance[np.ix_(places, places)],
            degrees_of_freedom=np.asarray(self.degrees_of_freedom)[places],
            sources=tuple(self.sources_of(place) for place in places),
            explained={name: share for name, share in self.explained.items() if name in names},
            variation=None if self.variation is None else self.variation.part(places),
            flight_variation=None if self.flight_variation is None else self.flight_variation.part(places),
        )

    def for_new_flight(self) -> "Estimates":
        """Return the estimates with the covariance for another stretch of another flight.

        The covariance is the sum of that of the errors and of the variations from stretch to stretch and from flight to
        flight, with the degrees of freedom of F. E. Satterthwaite (Biometrics Bulletin 2, 1946). A parameter of unknown
        variation keeps its covariance.
        """
        if not self._variations:
            return self
        covariance, parts = self.covariance, np.diag(self.covariance) ** 2 / self.degrees_of_freedom
        for each in self._variations:
            between = np.nan_to_num(each.covariance)
            covariance = covariance + between
            parts = parts + np.diag(between) ** 2 / each.degrees_of_freedom
        return replace(
            self,
            covariance=covariance,
            degrees_of_freedom=np.diag(covariance) ** 2 / parts,
            variation=None,
            flight_variation=None,
        )
