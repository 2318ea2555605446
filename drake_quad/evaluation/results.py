"""The numbers of the evaluation, and how its folder holds them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.evaluation.families import FAMILIES
from drake_quad.files import read_table, write_table
from drake_quad.laboratory.metrics import Metrics

FLIGHTS, TRAITS = "flights.csv", "traits.csv"
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
        places = [place for family in FAMILIES.values() for place in family.laboratories]
        return list(dict.fromkeys(name for place in places for name in self.flights.get(place, ()) if "@" not in name))


def in_laps(count: int) -> str:
    """The laboratory in which so many laps are flown, of which the last counts."""
    return f"{LAPS_IN}, lap {count}"


def priced_name(controller: str, sensitivity: float) -> str:
    """A controller that is designed with another limit on the peak sensitivity."""
    return f"{controller}@{sensitivity:g}"


def write_flights(path: Path, flights: Mapping[str, Mapping[str, Metrics]], first: int) -> Path:
    """Writes a row for each flight, and returns the path.

    Args:
        path: of the file.
        flights: by laboratory and controller.
        first: number of the first sample.
    """
    rows = [
        (place, name, first + sample, *values)
        for place, found in flights.items()
        for name, metrics in found.items()
        for sample, values in enumerate(np.transpose(metrics))
    ]
    header = ("laboratory", "controller", "sample", *Metrics._fields)
    return write_table(path, dict(zip(header, zip(*rows, strict=True), strict=True)), digits=9)


def write_traits(path: Path, traits: Mapping[str, Mapping[str, Traits]]) -> Path:
    """Writes a row for each controller of each family, and returns the path."""
    rows = [(family, name, *each) for family, found in traits.items() for name, each in found.items()]
    header = ("family", "controller", *Traits._fields)
    return write_table(path, dict(zip(header, zip(*rows, strict=True), strict=True)), digits=9)


def read_evaluation(folder: Path) -> Evaluation:
    """Reads what `judge_controllers` left in a folder.

    Raises:
        InputError: a file is missing, or holds something else.
    """
    flights, traits = read_table(folder / FLIGHTS), read_table(folder / TRAITS)
    for name, found, wanted in ((FLIGHTS, flights, ("laboratory", *Metrics._fields)), (TRAITS, traits, Traits._fields)):
        missing = [column for column in wanted if column not in found]
        if missing:
            raise InputError(f"{folder / name} has no column {missing[0]}")
    metrics = Metrics(*(flights[name] for name in Metrics._fields))
    keys = _keys(flights, "laboratory", "controller")
    flown: dict[str, dict[str, Metrics]] = {}
    for place, name in dict.fromkeys(keys):
        chosen = np.array([key == (place, name) for key in keys])
        flown.setdefault(place, {})[name] = metrics.taken(chosen)
    told: dict[str, dict[str, Traits]] = {}
    for i, (family, name) in enumerate(_keys(traits, "family", "controller")):
        told.setdefault(family, {})[name] = Traits(*(float(traits[field][i]) for field in Traits._fields))
    return Evaluation(flown, told)


def _keys(columns: Mapping[str, np.ndarray], first: str, second: str) -> Sequence[tuple[str, str]]:
    return list(zip(map(str, columns[first]), map(str, columns[second]), strict=True))
