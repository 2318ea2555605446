"""The findings of the replication: everything that its report says in numbers."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.files import write_text
from drake_quad.replication.claims import Claim, all_claims, write_claims
from drake_quad.replication.effort import EffortMatch, effort_matches, write_efforts
from drake_quad.replication.fair import FairEntry, fair_entries, write_fair
from drake_quad.replication.results import Experiment
from drake_quad.replication.table_ii import QUANTITIES, Entry, table_entries, table_markdown, write_entries


class Findings(NamedTuple):
    """What follows from an experiment.

    Attributes:
        entries: of Table II.
        claims: of the paper, with verdicts.
        fair: the comparison with controllers that the paper does not have.
        efforts: definitions of control effort, the closest first.
        calibration: columns of the file that `scripts/development/calibrate_paper.py` writes.
    """

    entries: Sequence[Entry]
    claims: Sequence[Claim]
    fair: Sequence[FairEntry]
    efforts: Sequence[EffortMatch]
    calibration: Mapping[str, np.ndarray]


def findings_of(found: Experiment, calibration: Mapping[str, np.ndarray]) -> Findings:
    """The findings of an experiment that was flown with the numbers of a calibration."""
    return Findings(
        table_entries(found.cells), all_claims(found), fair_entries(found), effort_matches(found), calibration
    )


def write_findings(folder: Path, findings: Findings) -> list[Path]:
    """Writes all findings but the calibration, which has its file, and returns the files."""
    sections = (f"## {words}\n\n{table_markdown(findings.entries, name)}\n" for name, words in QUANTITIES.items())
    return [
        write_entries(folder / "table_ii.csv", findings.entries),
        write_text(folder / "table_ii.md", "# Table II\n\n" + "\n".join(sections)),
        write_claims(folder / "claims.csv", findings.claims),
        write_fair(folder / "fair.csv", findings.fair),
        write_efforts(folder / "effort.csv", findings.efforts),
    ]
