"""Everything that the report says in numbers, and its files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.replication.claims import Claim, all_claims, write_claims
from drake_quad.files import read_table
from drake_quad.replication.effort import EffortMatch, effort_matches, write_efforts
from drake_quad.replication.fair import FairEntry, fair_entries, write_fair
from drake_quad.replication.results import Experiment
from drake_quad.replication.table_ii import QUANTITIES, Entry, table_entries, table_markdown, write_table
from drake_quad.files import write_text


class Tables(NamedTuple):
    """The tables of the report.

    Attributes:
        entries: of Table II.
        claims: with their verdicts.
        fair: comparison with controllers that the paper does not have.
        efforts: definitions of control effort, the closest first.
        calibration: columns of the file that `scripts/calibrate_paper.py` writes.
    """

    entries: Sequence[Entry]
    claims: Sequence[Claim]
    fair: Sequence[FairEntry]
    efforts: Sequence[EffortMatch]
    calibration: Mapping[str, np.ndarray]


def read_tables(folder: Path, found: Experiment) -> Tables:
    """Makes the tables of an experiment, beside the calibration in its folder.

    Raises:
        InputError: the calibration is missing.
    """
    calibration = read_table(folder / "calibration.csv")
    return Tables(
        table_entries(found.cells), all_claims(found), fair_entries(found), effort_matches(found), calibration
    )


def write_tables(folder: Path, tables: Tables) -> list[Path]:
    """Writes all tables but the calibration, which is there, and returns the files; Table II also as Markdown."""
    sections = (f"## {words}\n\n{table_markdown(tables.entries, name)}\n" for name, words in QUANTITIES.items())
    return [
        write_table(folder / "table_ii.csv", tables.entries),
        write_text(folder / "table_ii.md", "# Table II\n\n" + "\n".join(sections)),
        write_claims(folder / "claims.csv", tables.claims),
        write_fair(folder / "fair.csv", tables.fair),
        write_efforts(folder / "effort.csv", tables.efforts),
    ]
