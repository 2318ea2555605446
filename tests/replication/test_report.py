"""Tests that the reports of an invented experiment and of the committed one agree with their tables."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from invented_experiment import invented_experiment

from drake_quad import load_scenario
from drake_quad.replication import report as report_module
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table
from drake_quad.replication.report import CAPTIONS, collect_findings, write_report
from drake_quad.statistics.interval import Interval

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs" / "replication"
CALIBRATION_FILE = ROOT / "drake_quad" / "replication" / "calibration.csv"


@pytest.fixture(scope="module")
def written_report(tmp_path_factory):
    """Return the folder and the files of a report without figures."""
    folder = tmp_path_factory.mktemp("paper")
    (folder / "figures").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_module, "paper_figures", lambda result, flights: ())
        for name in CAPTIONS:
            (folder / "figures" / f"{name}.png").write_bytes(name.encode())
        result = invented_experiment()
        return folder, write_report(folder, result, collect_findings(result), {})


@pytest.fixture(scope="module")
def report(written_report):
    folder, _ = written_report
    return (folder / "report.md").read_text(encoding="utf-8")


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def sections(text):
    """Return the text of each section of a report, by its heading."""
    parts = re.split(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.slow
def test_a_report_has_a_file_for_each_table(written_report):
    folder, files = written_report
    names = [
        "table_ii.csv",
        "table_ii.md",
        "claims.csv",
        "fair.csv",
        "effort.csv",
        "report.md",
        "report.html",
        "figures",
    ]
    assert files == [folder / name for name in names]
    assert all(file.exists() for file in files)
    assert (folder / "calibration.csv").read_bytes() == CALIBRATION_FILE.read_bytes()
    assert list(rows_of(folder / "claims.csv")[0]) == [
        "claim",
        "printed",
        "ours",
        "verdict",
        "rule",
        "details",
        "figure",
    ]
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(CAPTIONS)


@pytest.mark.slow
def test_table_ii_of_the_report_agrees_with_its_file(written_report, report):
    folder, _ = written_report
    rows = {(row["wind"], row["controller"], row["quantity"]): row for row in rows_of(folder / "table_ii.csv")}
    check_table(report, rows)
    tables = (folder / "table_ii.md").read_text(encoding="utf-8")
    titles = re.findall("^## (.*)$", tables, re.MULTILINE)
    assert titles == ["RMSE (m)", "control effort on X (m²/s⁴)", "control effort on Y (m²/s⁴)"]
    for title in titles:
        table = sections(tables)[title].strip()
        assert table in report


def check_table(text, written_report):
    """Check that the cells of the report contain all values of the CSV file."""
    titles = {
        "rmse": "RMSE (m)",
        "effort_x": "Control effort on X (m²/s⁴)",
        "effort_y": "Control effort on Y (m²/s⁴)",
    }
    for quantity, title in titles.items():
        lines = [line for line in sections(text)[title].splitlines() if re.match(r"\| (no|low|high) wind", line)]
        assert len(lines) == len(WINDS) * len(CONTROLLERS)
        for line in lines:
            wind, controller, printed, printed_mean, ours, ours_mean, mean, off = line.strip("| ").split(" | ")
            (row,) = (
                row
                for (key_wind, key_controller, key), row in written_report.items()
                if (WINDS[key_wind], CONTROLLERS[key_controller], key) == (wind, controller, quantity)
            )
            rounded = {name: f"{float(value):.3f}" if value else "–" for name, value in list(row.items())[3:11]}
            assert printed.split(", ") == [rounded[f"printed_run{i}"] for i in (1, 2, 3)]
            assert ours.split(", ") == [rounded[f"ours_run{i}"] for i in (1, 2, 3)]
            assert (printed_mean, ours_mean) == (rounded["printed_mean"], rounded["ours_mean"])
            assert mean == Interval(*(float(row[name]) for name in ("mean", "low", "high"))).text()
            if row["printed_mean"]:
                assert off == f"{100 * (float(row['mean']) / float(row['printed_mean']) - 1):+.1f} %"
            else:
                assert off == "–"


@pytest.mark.slow
def test_all_fields_of_the_template_are_filled(report):
    assert not re.search(r"[{}]", report)
    assert "nan" not in report


def test_the_committed_report_agrees_with_its_tables():
    text = (DOCS / "report.md").read_text(encoding="utf-8")
    check_table(
        text, {(row["wind"], row["controller"], row["quantity"]): row for row in rows_of(DOCS / "table_ii.csv")}
    )


def test_the_committed_table_has_the_printed_values_and_reproduces_the_fitted_cells():
    rows = {
        Cell(row["wind"], row["controller"]): row for row in rows_of(DOCS / "table_ii.csv") if row["quantity"] == "rmse"
    }
    for cell in (Cell("no_wind", "pd"), Cell("no_wind", "pd_t2fnn")):
        assert float(rows[cell]["mean"]) == pytest.approx(published_table()[cell].rmse.mean, rel=0.02)
    for cell, line in published_table().items():
        assert rows[cell]["printed_mean"] == ("" if np.isnan(line.rmse.mean) else repr(line.rmse.mean))


def test_the_scenarios_have_the_calibrated_values():
    row = next(row for row in rows_of(CALIBRATION_FILE) if row["hypothesis"] == "measurement")
    control = load_scenario(f"{ROOT}/diagrams/paper.yaml:low_wind_pd_t2fnn").control
    position = control.position
    assert position.k_p[0] == pytest.approx(float(row["pd_number"]) ** 2, rel=2e-3)
    assert position.k_d[0] == pytest.approx(1.4 * float(row["pd_number"]), rel=2e-3)
    assert control.network.learning.slope == pytest.approx(float(row["network_number"]), rel=2e-3)


def test_the_readme_states_the_committed_verdicts():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for claim in rows_of(DOCS / "claims.csv"):
        assert f"| {claim['claim']} | {claim['verdict']} |" in readme
