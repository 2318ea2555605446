"""Results of the evaluation, and the files that store them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from drake_quad.evaluation.families import FAMILY_OF, FIRST_EVALUATION_SAMPLE
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.results import read_groups, write_groups

_FLIGHT_KEYS = ("laboratory", "controller")
_TRAIT_KEYS = ("family", "controller")
_NUM_DIGITS = 9  # significant digits in the files
LAPS_LABORATORY = "high wind"  # laboratory in which networks with the position as input fly several laps
# "Priced" designs are controllers that were designed with other limits on the peak sensitivity than the default. They
# show the price of a stability margin: by how much a stricter limit increases the tracking error.
SENSITIVITY_VARIANTS = "priced"  # name of the file with the sensitivity variants
SENSITIVITY_VARIANT_LABORATORY = "high wind"  # laboratory in which these variants are tuned and flown
SENSITIVITY_VARIANT_CONTROLLERS = ("indi", "lqg")  # controllers that have sensitivity variants
SENSITIVITY_LIMITS = (1.6, 1.9, 2.6, 3.0)  # limits on the peak sensitivity of the variants


class Traits(NamedTuple):
    """Margins and computing times of a controller in a family of laboratories. A value that does not exist is NaN.

    The margins are computed for the loops at the command link, with the median plant and without a network.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)|, where L is the loop transfer function.
        delay: smallest delay margin, s.
        delay_flown: largest additional delay that is tolerated in flight, s; infinite if no sample crashes with any
            delay, and negative if a sample crashes without additional delay.
        lone: CPU time per tick of the whole loop for a single vehicle, s.
        fleet: CPU time per tick and vehicle of the whole loop in a fleet of all samples, s.
        stable_scale: scale of the ranges of all random parameters up to which hover is certified to be stable.
        unstable_scale: smallest scale with an unstable loop.
        not_certified: reason why there is no certificate; empty if there is one.
    """

    sensitivity: float
    delay: float
    delay_flown: float
    lone: float
    fleet: float
    stable_scale: float = math.nan
    unstable_scale: float = math.nan
    not_certified: str = ""


@dataclass(frozen=True)
class Evaluation:
    """Results of all flights of the evaluation.

    Attributes:
        flights: metrics of the samples, by laboratory and controller.
        traits: margins and computing times, by family and controller.
    """

    flights: Mapping[str, Mapping[str, Metrics]]
    traits: Mapping[str, Mapping[str, Traits]]

    @property
    def controllers(self) -> list[str]:
        """Names of all controllers that were flown, except designs with other limits on the peak sensitivity."""
        results = (name for laboratory in FAMILY_OF for name in self.flights.get(laboratory, ()) if "@" not in name)
        return list(dict.fromkeys(results))


def laboratory_with_laps(count: int) -> str:
    """Return the name under which the results with a number of laps are stored. Metrics are those of the last lap."""
    return f"{LAPS_LABORATORY}, lap {count}"


def sensitivity_variant_name(controller: str, sensitivity: float) -> str:
    """Return the name of a controller that is designed with a limit on the peak sensitivity, such as `indi@1.6`."""
    return f"{controller}@{sensitivity:g}"


def write_evaluation(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write a file with a row per flight, and a file with a row per controller and family; return both paths."""
    flights: dict[tuple[str, ...], dict[str, Any]] = {
        (laboratory, name): {
            "sample": range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + len(metrics.rmse)),
            **metrics._asdict(),
        }
        for laboratory, results in evaluation.flights.items()
        for name, metrics in results.items()
    }
    traits: dict[tuple[str, ...], dict[str, Any]] = {
        (family, name): {field: [value] for field, value in each._asdict().items()}
        for family, results in evaluation.traits.items()
        for name, each in results.items()
    }
    return [
        write_groups(folder / "flights.csv", _FLIGHT_KEYS, flights, digits=_NUM_DIGITS),
        write_groups(folder / "traits.csv", _TRAIT_KEYS, traits, digits=_NUM_DIGITS),
    ]


def read_evaluation(folder: Path) -> Evaluation:
    """Read the results that `write_evaluation` wrote to a folder.

    Raises:
        InputError: if a file is missing or invalid.
    """
    flights: dict[str, dict[str, Metrics]] = {}
    for (laboratory, name), columns in read_groups(folder / "flights.csv", _FLIGHT_KEYS, Metrics._fields).items():
        flights.setdefault(laboratory, {})[name] = Metrics(*(columns[field] for field in Metrics._fields))
    traits: dict[str, dict[str, Traits]] = {}
    for (family, name), columns in read_groups(folder / "traits.csv", _TRAIT_KEYS, Traits._fields).items():
        traits.setdefault(family, {})[name] = _traits_of({field: columns[field][0] for field in Traits._fields})
    return Evaluation(flights, traits)


def _traits_of(cells: Mapping[str, Any]) -> Traits:
    """Return the `Traits` in a row of the results file; an empty cell becomes NaN."""
    numbers = {field: float(cell) for field, cell in cells.items() if field != "not_certified"}
    reason = cells["not_certified"]
    return Traits(**numbers, not_certified=str(reason) if isinstance(reason, str) else "")
