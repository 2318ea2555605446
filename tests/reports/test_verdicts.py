"""Tests that verdicts follow from their conditions, and that the committed pages show the committed claims."""

import csv
import re

import pytest

from drake_quad.evaluation import report as evaluation_report
from drake_quad.replication import report as replication_report
from drake_quad.reports.claims import (
    Claim,
    reduction,
    verdict_counts,
    verdict_from_conditions,
    verdict_table,
    write_claims,
)
from drake_quad.reports.page import image
from drake_quad.statistics.interval import Interval

CLAIMS = [
    Claim("a is less than b", evidence="1 [0, 2]", verdict="holds", rule="a rule", printed="2"),
    Claim("c", evidence="3", verdict="does not hold", rule="r"),
    Claim("d, e", evidence="4", verdict="does not hold", rule="r"),
]


@pytest.mark.parametrize(
    ("necessary", "sufficient", "verdict"),
    [
        ([True, True], [], "holds"),
        ([True, False], [], "holds in part"),
        ([True, None], [False], "holds in part"),
        ([False, None], [True], "holds in part"),
        ([False, False], [], "does not hold"),
        ([False, None], [], "cannot be decided"),
        ([False], [None], "cannot be decided"),
    ],
)
def test_verdicts_follow_from_conditions(necessary, sufficient, verdict):
    assert verdict_from_conditions(necessary, *sufficient) == verdict


def test_a_reduction_is_one_minus_the_ratio():
    """The lower end of the ratio gives the upper end of the reduction."""
    assert reduction(Interval(0.75, 0.5, 1.25)) == (0.25, -0.25, 0.5)


def test_a_table_of_verdicts_has_the_chosen_fields_and_the_verdict_in_bold():
    header, line, first, *others = verdict_table(CLAIMS, {"claim": "statement", "theirs": "printed"}).split("\n")
    assert (header, line) == ("| claim | theirs | verdict |", "| --- | --- | --- |")
    assert first == "| a is less than b | 2 | **holds** |"
    assert len(others) == 2


def test_verdicts_are_counted_in_order_of_their_frequency():
    assert verdict_counts(CLAIMS) == "2 × does not hold, 1 × holds"


def test_claims_are_written_under_the_headings_of_their_report(tmp_path):
    path = write_claims(tmp_path / "claims.csv", CLAIMS, {"statement": "statement", "rule": "rule"})
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert rows == [{"statement": claim.statement, "rule": claim.rule} for claim in CLAIMS]


@pytest.mark.parametrize(
    ("report", "folder", "file", "width", "max_bytes"),
    [
        (replication_report, "replication", "claims", 420, 60_000),
        (evaluation_report, "controllers", "answers", 640, 100_000),
    ],
)
def test_a_committed_page_is_up_to_date(root, report, folder, file, width, max_bytes):
    """The page shows the claims of the committed CSV file, and all figures with their captions."""
    text = (root / "docs" / folder / "report.md").read_text(encoding="utf-8")
    with (root / "docs" / folder / f"{file}.csv").open(encoding="utf-8") as committed:
        rows = [{report._FILE_COLUMNS[name]: cell for name, cell in row.items()} for row in csv.DictReader(committed)]
    claims = [Claim(**row) for row in rows]
    assert f"{verdict_table(claims, report._REPORT_COLUMNS)}\n" in text
    assert f"The verdicts are: {verdict_counts(claims)}." in text
    for name, caption in report.CAPTIONS.items():
        assert image(name, caption, width=width) in text
    figures = re.findall(r'src="figures/(\w+)\.png"', text)
    assert set(figures) == set(report.CAPTIONS)
    for name in figures:
        assert (root / "docs" / folder / "figures" / f"{name}.png").stat().st_size < max_bytes
