"""Families of laboratories, the scenarios in which controllers are compared.

A controller has one design per family, trained in some laboratories of the family.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.evaluation.entries import ControllerEntry, controller_entries
from drake_quad.scenario.files.loading import Override, load_scenario
from drake_quad.scenario.models import Scenario

# Training uses the samples from 0 on, so that the training set and the samples of the evaluation are disjoint.
FIRST_EVALUATION_SAMPLE = 1000


class LaboratoryFamily(NamedTuple):
    """Family of laboratories, in all of which a controller has the same design.

    Attributes:
        laboratories: FILE:NAME of each laboratory in the folder of diagrams, by its name in the report.
        training_laboratories: names of the laboratories in which designs are trained. The stability limit is checked in
            the first of these laboratories.
        windiest_laboratory: name of the laboratory with the strongest wind, in which the tolerated delay and the
            computing times are measured.
        on_board: True if an autopilot on board the vehicle controls the attitude.
        position_networks: True to include networks whose input is the position, for disturbances that recur at the same
            position.
        lap_overrides: overrides for the training of a network whose input is the position.
    """

    laboratories: dict[str, str]
    training_laboratories: tuple[str, ...]
    windiest_laboratory: str
    on_board: bool = False
    position_networks: bool = False
    lap_overrides: tuple[str, ...] = ()

    @property
    def entries(self) -> dict[str, ControllerEntry]:
        """Controllers that are designed for the family, by name."""
        return controller_entries(on_board=self.on_board, position_networks=self.position_networks)

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
            layers: FILE:NAME of each layer that is merged over the laboratory, such as a controller.
            overrides: assignments that take precedence over the layers.
        """
        return load_scenario(diagrams / self.laboratories[laboratory], overrides, layers=layers)


def overrides_for_laps(count: int) -> tuple[str, ...]:
    """Return overrides for a number of laps. Metrics are computed over the last lap."""
    return f"route.laps={count}", f"metrics.first_lap={count}"


# Families of laboratories, keyed by name. A controller has the same design in all laboratories of a family.
FAMILIES = {
    "laboratory": LaboratoryFamily(
        {
            "no wind": "laboratory.yaml:nominal",
            "low wind": "laboratory.yaml:low_wind",
            "high wind": "laboratory.yaml:high_wind",
        },
        ("low wind", "high wind"),
        "high wind",
        position_networks=True,
        lap_overrides=overrides_for_laps(3),
    ),
    "outdoor": LaboratoryFamily({"outdoor": "outdoor.yaml"}, ("outdoor",), "outdoor"),
    "robustness": LaboratoryFamily({"robustness": "robustness.yaml"}, ("robustness",), "robustness"),
    # The family neural_fly needs no overrides for laps, since its route already consists of laps.
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
        position_networks=True,
    ),
}
# Name of the family by the name of the laboratory.
FAMILY_OF = {laboratory: name for name, family in FAMILIES.items() for laboratory in family.laboratories}
