"""Numbers of the evaluation, and the files that store them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from drake_quad.evaluation.families import FAMILY_OF, FIRST_JUDGED
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.results import read_groups, write_groups

_FLIGHT_KEYS = ("laboratory", "controller")
_TRAIT_KEYS = ("family", "controller")
# Number of significant digits in the files.
_DIGITS = 9
# Laboratory in which several laps are flown, laboratory in which designs with other limits are flown, and name of the
# file of these designs.
LAPS_IN, PRICED_IN, PRICED = "high wind", "high wind", "priced"
# Other limits on the peak sensitivity, and the controllers that are designed with them.
SENSITIVITIES, PRICED_CONTROLLERS = (1.6, 1.9, 2.6, 3.0), ("indi", "lqg")


class Traits(NamedTuple):
    """Margins and computing times of a controller in a family of laboratories; NaN if a number does not exist.

    Margins are those of the loops of the middle plant, broken at the command link, without the network of a controller.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)|.
        delay: smallest delay margin, s.
        delay_flown: largest additional delay that is tolerated in flight, s; infinite if no sample crashes with any
            delay, and negative if a sample crashes without additional delay.
        lone: CPU time of the whole loop per tick for a vehicle that flies alone, s.
        fleet: CPU time of the whole loop per tick and vehicle in a fleet of all samples, s.
    """

    sensitivity: float
    delay: float
    delay_flown: float
    lone: float
    fleet: float


@dataclass(frozen=True)
class Evaluation:
    """Numbers of all flights of the evaluation.

    Attributes:
        flights: metrics of the samples, by laboratory and controller.
        traits: margins and computing times, by family and controller.
    """

    flights: Mapping[str, Mapping[str, Metrics]]
    traits: Mapping[str, Mapping[str, Traits]]

    @property
    def controllers(self) -> list[str]:
        """Names of all controllers that were flown in a laboratory of a family."""
        flown = (name for place in FAMILY_OF for name in self.flights.get(place, ()) if "@" not in name)
        return list(dict.fromkeys(flown))


def in_laps(count: int) -> str:
    """Return the name of the laboratory with a number of laps, the last of which counts for the metrics."""
    return f"{LAPS_IN}, lap {count}"


def priced_name(controller: str, sensitivity: float) -> str:
    """Return the name of a controller that is designed with another limit on the peak sensitivity."""
    return f"{controller}@{sensitivity:g}"


def write_evaluation(folder: Path, found: Evaluation) -> list[Path]:
    """Write a row for each flight and for each controller of each family, and return the files."""
    flights: dict[tuple[str, ...], dict[str, Any]] = {
        (place, name): {"sample": range(FIRST_JUDGED, FIRST_JUDGED + len(metrics.rmse)), **metrics._asdict()}
        for place, flown in found.flights.items()
        for name, metrics in flown.items()
    }
    traits: dict[tuple[str, ...], dict[str, Any]] = {
        (family, name): {field: [value] for field, value in each._asdict().items()}
        for family, flown in found.traits.items()
        for name, each in flown.items()
    }
    return [
        write_groups(folder / "flights.csv", _FLIGHT_KEYS, flights, digits=_DIGITS),
        write_groups(folder / "traits.csv", _TRAIT_KEYS, traits, digits=_DIGITS),
    ]


def read_evaluation(folder: Path) -> Evaluation:
    """Read the numbers that `write_evaluation` wrote to a folder.

    Raises:
        InputError: a file is missing or invalid.
    """
    flights: dict[str, dict[str, Metrics]] = {}
    for (place, name), columns in read_groups(folder / "flights.csv", _FLIGHT_KEYS, Metrics._fields).items():
        flights.setdefault(place, {})[name] = Metrics(*(columns[field] for field in Metrics._fields))
    traits: dict[str, dict[str, Traits]] = {}
    for (family, name), columns in read_groups(folder / "traits.csv", _TRAIT_KEYS, Traits._fields).items():
        traits.setdefault(family, {})[name] = Traits(*(float(columns[field][0]) for field in Traits._fields))
    return Evaluation(flights, traits)
