"""Families of laboratories: one design serves all laboratories of a family, and is trained in some of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.evaluation.entries import ControllerEntry, entries_of
from drake_quad.scenario.files.loading import Override, load_scenario
from drake_quad.scenario.models import Scenario

# The first of the samples on which controllers are judged; those on which they are trained begin with 0.
FIRST_JUDGED = 1000


class LaboratoryFamily(NamedTuple):
    """Laboratories for which a controller has one design.

    Attributes:
        laboratories: FILE:NAME of each in the folder of diagrams, by the name that the report has for it.
        trained: the laboratories in which designs are trained; the limit on the loops is that of the first.
        windiest: the laboratory in which delay is added until vehicles crash.
        on_board: whether attitude is controlled on board.
        maps: whether there is a network that learns over the position, for what comes back at the same place.
        laps: overrides under which such a network is trained.
    """

    laboratories: dict[str, str]
    trained: tuple[str, ...]
    windiest: str
    on_board: bool = False
    maps: bool = False
    laps: tuple[str, ...] = ()

    @property
    def entries(self) -> dict[str, ControllerEntry]:
        """The controllers that are designed for the family, by name."""
        return entries_of(on_board=self.on_board, maps=self.maps)

    def scenario(
        self,
        diagrams: Path,
        laboratory: str,
        layers: Sequence[str | Path] = (),
        overrides: Sequence[str | Override] = (),
    ) -> Scenario:
        """One of the laboratories, with layers and overrides.

        Args:
            diagrams: folder of the shipped scenarios.
            laboratory: its name in the report.
            layers: FILE:NAMEs that are laid over it, such as a controller.
            overrides: assignments, which win.
        """
        return load_scenario(diagrams / self.laboratories[laboratory], overrides, layers=layers)


def laps_of(count: int) -> tuple[str, ...]:
    """Overrides for so many laps, of which the last counts."""
    return f"route.laps={count}", f"metrics.first_lap={count}"


FAMILIES = {
    "laboratory": LaboratoryFamily(
        {
            "no wind": "laboratory.yaml:nominal",
            "low wind": "laboratory.yaml:low_wind",
            "high wind": "laboratory.yaml:high_wind",
        },
        ("low wind", "high wind"),
        "high wind",
        maps=True,
        laps=laps_of(3),
    ),
    "outdoor": LaboratoryFamily({"outdoor": "outdoor.yaml"}, ("outdoor",), "outdoor"),
    "robustness": LaboratoryFamily({"robustness": "robustness.yaml"}, ("robustness",), "robustness"),
    # The route has laps anyway.
    "neural_fly": LaboratoryFamily(
        {
            "still air": "neural_fly.yaml:still",
            "4 m/s": "neural_fly.yaml:wind_4",
            "8 m/s": "neural_fly.yaml:wind_8",
            "12 m/s": "neural_fly.yaml:wind_12",
            "8 m/s, sine": "neural_fly.yaml:wind_8_sine",
        },
        ("8 m/s", "12 m/s"),
        "12 m/s",
        on_board=True,
        maps=True,
    ),
}
# Names of the families by the names of their laboratories.
FAMILY_OF = {place: name for name, family in FAMILIES.items() for place in family.laboratories}
