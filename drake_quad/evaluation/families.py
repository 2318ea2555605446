"""Families of laboratories. A controller has one design for all laboratories of a family, some of which train it."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.evaluation.entries import ControllerEntry, entries_of
from drake_quad.scenario.files.loading import Override, load_scenario
from drake_quad.scenario.models import Scenario

# Index of the first sample of the evaluation. Training uses samples from 0 on, so that the two sets are disjoint.
FIRST_JUDGED = 1000


class LaboratoryFamily(NamedTuple):
    """Laboratories for which a controller has one design.

    Attributes:
        laboratories: FILE:NAME of each laboratory in the folder of diagrams, by its name in the report.
        trained: names of the laboratories in which designs are trained; the limit applies to the loops of the first.
        windiest: name of the laboratory in which delay is added until vehicles crash.
        on_board: True if an autopilot on board controls the attitude.
        maps: True to include networks over the position, for disturbances that recur at the same place.
        laps: overrides with which a network over the position is trained.
    """

    laboratories: dict[str, str]
    trained: tuple[str, ...]
    windiest: str
    on_board: bool = False
    maps: bool = False
    laps: tuple[str, ...] = ()

    @property
    def entries(self) -> dict[str, ControllerEntry]:
        """Controllers that are designed for the family, by name."""
        return entries_of(on_board=self.on_board, maps=self.maps)

    def scenario(
        self,
        diagrams: Path,
        laboratory: str,
        layers: Sequence[str | Path] = (),
        overrides: Sequence[str | Override] = (),
    ) -> Scenario:
        """Return the scenario of a laboratory with layers and overrides.

        Args:
            diagrams: folder of the shipped scenarios.
            laboratory: name of the laboratory in the report.
            layers: FILE:NAME of each layer over the laboratory, such as a controller.
            overrides: assignments, which take precedence over the layers.
        """
        return load_scenario(diagrams / self.laboratories[laboratory], overrides, layers=layers)


def laps_of(count: int) -> tuple[str, ...]:
    """Return overrides for a number of laps, the last of which counts for the metrics."""
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
    # This family has no overrides for training in laps, since its route already consists of laps.
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
# Name of the family by the name of the laboratory.
FAMILY_OF = {place: name for name, family in FAMILIES.items() for place in family.laboratories}
