"""What an identification found: numbers with their covariance, what they rest on, and what the log does not tell."""

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
    """What numbers of a kind are.

    Attributes:
        unit: of them; "1" for a ratio.
        least: that the scenario language allows.
        most: that it allows.
        items: of its list; 0 for a single number.
        whole: whether it counts something.
    """

    unit: str
    least: float = -LARGEST
    most: float = LARGEST
    items: int = 0
    whole: bool = False


def _positive(unit: str, items: int = 0) -> Kind:
    return Kind(unit, SMALLEST, items=items)


def _not_negative(unit: str, items: int = 0) -> Kind:
    return Kind(unit, 0.0, items=items)


_TICKS = Kind("1", 0.0, 50.0, whole=True)
_SHARE = Kind("1", 0.0, 1.0)

# By the path in `vehicle`, or from `autopilot` or `laboratory` on; units and limits are those of the scenario language.
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


def split(name: str) -> tuple[str, int | None]:
    """The path of a list and the place in it, counted from 0, of the name of a number; no place if it is no item.

    Raises:
        InputError: no number of a vehicle or its laboratory is called so.
    """
    found = re.fullmatch(r"([\w.]+?)(?:\[(\d)\])?", name)
    path, place = (found[1], found[2]) if found else (name, None)
    if path not in KINDS:
        close = difflib.get_close_matches(path, KINDS, 1)
        more = f"; did you mean {close[0]}?" if close else f"; allowed are {listed([*KINDS], len(KINDS))}"
        raise InputError(f"{shown(name)} is no number that can be identified{more}")
    count = KINDS[path].items
    if (place is None) != (count == 0) or (place is not None and int(place) >= count):
        allowed = f"{path}[0] to {path}[{count - 1}]" if count else path
        raise InputError(f"{shown(name)} is no number that can be identified, which are {allowed}")
    return path, None if place is None else int(place)


def kind_of(name: str) -> Kind:
    """What kind a number is of.

    Raises:
        InputError: no number is called so.
    """
    return KINDS[split(name)[0]]


def scenario_path(name: str) -> str:
    """The path of a number in a scenario: `vehicle.inertia.0` of `inertia[0]`.

    Raises:
        InputError: no number is called so.
    """
    path, place = split(name)
    return field_path(path) if place is None else joined(field_path(path), place)


def field_path(path: str) -> str:
    """The path in a scenario of a field of `KINDS`: `laboratory.autopilot.damping` of `autopilot.damping`."""
    if path.startswith("laboratory."):
        return path
    return joined("laboratory" if path.startswith("autopilot.") else "vehicle", path)


class Source(NamedTuple):
    """Where an estimate is from.

    Attributes:
        method: of identification, as in "multiple shooting on body rates".
        log: that it was applied to.
    """

    method: str
    log: str

    def __str__(self) -> str:
        return f"{self.method}, {self.log}"


class Explained(NamedTuple):
    """What a number is good for.

    Attributes:
        share: of the variance of an output that it explains, on flights that were held out, 1.
        output: which, as in "acceleration along z".
    """

    share: float
    output: str


def quantile(degrees_of_freedom: np.ndarray | float, level: float = CONFIDENCE) -> np.ndarray:
    """By how many standard deviations an interval reaches to each side, by Student's distribution.

    Args:
        degrees_of_freedom: of any shape; with infinitely many the distribution is the normal one.
        level: of confidence.
    """
    return np.asarray(scipy.stats.t.ppf(0.5 * (1.0 + level), degrees_of_freedom))


@dataclass(frozen=True, eq=False)
class Estimates:
    """Numbers of a vehicle and its laboratory, with a covariance.

    Attributes:
        names: (n,) as in the scenario language, items in brackets: `mass`, `inertia[0]`, `motors.curve[1]`,
            `autopilot.damping[2]`, `laboratory.motion_capture.position_noise`; see `KINDS`.
        values: (n,) in SI units.
        covariance: (n, n) of the values' errors.
        degrees_of_freedom: (n,) of Student's distribution of each error; one number stands for all.
        sources: (n,) what each is from, one or several; a single source stands for all.
        explained: share of variance, by name, where it is known.
        not_seen: reason, by its name, why the log does not identify a parameter. The estimate of such a parameter, if
            there is one, is the value of the data sheet, as far as the log narrows it.
        remarks: further sentences on how the numbers came about.
        variation: what the numbers vary by from one stretch of flight to the next, beside the errors of their mean;
            None if it is known of none.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    degrees_of_freedom: np.ndarray | float
    sources: tuple[tuple[Source, ...], ...] | Source
    explained: Mapping[str, Explained] = field(default_factory=dict)
    not_seen: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    variation: Variation | None = None

    def __post_init__(self) -> None:
        """Refuses what is no record.

        Raises:
            InputError: a name is unknown or there twice, shapes do not fit, a variance is not positive, or degrees of
                freedom are not.
        """
        names = tuple(self.names)
        for name in (*names, *self.explained, *self.not_seen):
            split(name)
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"{shown(twice)} is estimated twice")
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
            if name not in self.not_seen
        ]
        return "\n".join([*found, *(f"not identified: {name}: {why}" for name, why in self.not_seen.items())])

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the logs identify."""
        return tuple(name for name in self.names if name not in self.not_seen)

    @property
    def deviations(self) -> np.ndarray:
        """(n,) standard deviations of the errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> np.ndarray:
        """(n, n) correlations of the errors."""
        return self.covariance / np.outer(self.deviations, self.deviations)

    @property
    def units(self) -> tuple[str, ...]:
        """(n,) units of the values."""
        return tuple(kind_of(name).unit for name in self.names)

    @property
    def variation_known(self) -> np.ndarray:
        """(n,) True for numbers of which it is known what they vary by."""
        if self.variation is None:
            return np.zeros(len(self.names), dtype=bool)
        return np.isfinite(np.diag(self.variation.covariance))

    def quantiles(self, level: float = CONFIDENCE) -> np.ndarray:
        """(n,) by how many standard deviations an interval reaches to each side, by Student's distribution."""
        return quantile(self.degrees_of_freedom, level)

    def intervals(self, level: float = CONFIDENCE) -> np.ndarray:
        """(n, 2) ends of the interval of each value.

        Args:
            level: of confidence.
        """
        reach = self.quantiles(level) * self.deviations
        return np.stack([self.values - reach, self.values + reach], axis=1)

    def value(self, name: str) -> float:
        """The estimate of a number.

        Raises:
            InputError: there is none.
        """
        if name not in self.names:
            why = f": {self.not_seen[name]}" if name in self.not_seen else ""
            raise InputError(f"there is no estimate of {shortened(name)}{why}")
        return float(self.values[self.names.index(name)])

    def sources_of(self, place: int) -> tuple[Source, ...]:
        """What the number at a place among the names is from."""
        assert not isinstance(self.sources, Source)
        return self.sources[place]

    def part(self, names: Sequence[str]) -> "Estimates":
        """Some of the estimates, in this order.

        Raises:
            InputError: one of them is not there.
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
        )

    def elsewhere(self) -> "Estimates":
        """The same as another stretch of flight will show it: off by the error of the mean, and by what varies.

        Degrees of freedom of the sum are those of F. E. Satterthwaite (Biometrics Bulletin 2, 1946). Numbers are as
        they are where it is not known what they vary by.
        """
        if self.variation is None:
            return self
        more = np.nan_to_num(self.variation.covariance)
        own, varied = np.diag(self.covariance), np.diag(more)
        parts = own**2 / self.degrees_of_freedom + varied**2 / self.variation.degrees_of_freedom
        return replace(
            self,
            covariance=self.covariance + more,
            degrees_of_freedom=(own + varied) ** 2 / parts,
            variation=None,
        )
