"""The numbers of the evaluation, and how its folder holds them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from drake_quad.evaluation.families import FAMILY_OF, FIRST_JUDGED
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.results import read_groups, write_groups

_FLIGHT_KEYS = ("laboratory", "controller")
_TRAIT_KEYS = ("family", "controller")
# Number of digits of the numbers in the files, more than any comparison needs.
_DIGITS = 9
# Where more laps than one are flown, of which the last counts, and where designs with other limits are flown.
LAPS_IN, PRICED_IN, PRICED = "high wind", "high wind", "priced"
# Designs with other limits on the sensitivity, and what is designed so.
SENSITIVITIES, PRICED_CONTROLLERS = (1.6, 1.9, 2.6, 3.0), ("indi", "lqg")


class Traits(NamedTuple):
    """What a controller is in a family of laboratories, beside its errors; NaN where there is no such number.

    Attributes:
        sensitivity: largest peak of |1 / (1 + L)| where commands go over the link, of the middle plant; with a network,
            without it.
        delay: least delay margin there, s.
        delay_flown: that is stood beyond the laboratory's own, s; infinite if none that was tried made a vehicle crash,
            negative if vehicles crash without any.
        lone: CPU time of the whole loop a tick of a vehicle that flies alone, s.
        fleet: of one in a fleet of all samples, s.
    """

    sensitivity: float
    delay: float
    delay_flown: float
    lone: float
    fleet: float


@dataclass(frozen=True)
class Evaluation:
    """Everything that was flown, in numbers.

    Attributes:
        flights: metrics of the judged samples, by laboratory and controller.
        traits: by family and controller.
    """

    flights: Mapping[str, Mapping[str, Metrics]]
    traits: Mapping[str, Mapping[str, Traits]]

    @property
    def controllers(self) -> list[str]:
        """All controllers that flew in a laboratory of a family."""
        flown = (name for place in FAMILY_OF for name in self.flights.get(place, ()) if "@" not in name)
        return list(dict.fromkeys(flown))


def in_laps(count: int) -> str:
    """The laboratory in which so many laps are flown, of which the last counts."""
    return f"{LAPS_IN}, lap {count}"


def priced_name(controller: str, sensitivity: float) -> str:
    """A controller that is designed with another limit on the peak sensitivity."""
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
    """Read what `write_evaluation` left in a folder.

    Raises:
        InputError: a file is missing, or holds something else.
    """
    flights: dict[str, dict[str, Metrics]] = {}
    for (place, name), columns in read_groups(folder / "flights.csv", _FLIGHT_KEYS, Metrics._fields).items():
        flights.setdefault(place, {})[name] = Metrics(*(columns[field] for field in Metrics._fields))
    traits: dict[str, dict[str, Traits]] = {}
    for (family, name), columns in read_groups(folder / "traits.csv", _TRAIT_KEYS, Traits._fields).items():
        traits.setdefault(family, {})[name] = Traits(*(float(columns[field][0]) for field in Traits._fields))
    return Evaluation(flights, traits)
