"""Claims of a report, and verdicts that follow from confidence intervals."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from drake_quad.reports.page import table
from drake_quad.reports.results import write_rows
from drake_quad.statistics.interval import Interval

Verdict = Literal["holds", "holds in part", "does not hold", "cannot be decided"]


class Claim(NamedTuple):
    """Claim and the verdict on it.

    Attributes:
        statement: statement that is judged.
        evidence: numbers of the experiment, with 95 % intervals.
        verdict: verdict on the claim.
        rule: rule by which the verdict follows from the evidence.
        printed: evidence in the publication that makes the claim; empty if there is none.
        details: evidence case by case; empty if `evidence` contains all of it.
        figure: name of a figure that shows the evidence; empty if there is none.
    """

    statement: str
    evidence: str
    verdict: Verdict
    rule: str
    printed: str = ""
    details: str = ""
    figure: str = ""


def verdict_from_conditions(needed: Sequence[bool | None], *enough: bool | None) -> Verdict:
    """Return the verdict that follows from conditions. A condition is None if its interval is inconclusive.

    Args:
        needed: conditions that must all be true for a claim to hold; if only some are true, the claim holds in part.
        enough: further conditions; if one of them is true, the claim holds at least in part.
    """
    if all(needed):
        return "holds"
    conditions = {*needed, *enough}
    if any(conditions):
        return "holds in part"
    return "cannot be decided" if None in conditions else "does not hold"


def reduction(ratio: Interval) -> Interval:
    """Return the relative reduction of a mean: one minus the ratio of the two means."""
    return -ratio.plus(-1.0)


def write_claims(path: Path, claims: Sequence[Claim], columns: Mapping[str, str]) -> Path:
    """Write a row for each claim, and return the path.

    Args:
        path: path of the file.
        claims: claims in the order of the rows.
        columns: names of the fields of `Claim`, by the headings of their columns.
    """
    return write_rows(path, [{name: getattr(claim, field) for name, field in columns.items()} for claim in claims])


def verdict_table(claims: Sequence[Claim], columns: Mapping[str, str]) -> str:
    """Return the claims as a table in Markdown, whose last column is the verdict.

    Args:
        claims: claims in the order of the rows.
        columns: names of the fields of `Claim` that the other columns show, by their headings.
    """
    rows = [(*(getattr(claim, field) for field in columns.values()), f"**{claim.verdict}**") for claim in claims]
    return table((*columns, "verdict"), rows)


def verdict_counts(claims: Sequence[Claim]) -> str:
    """Return a text with the number of claims per verdict, the most frequent verdict first."""
    counts = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{number} × {verdict}" for verdict, number in counts.most_common())
