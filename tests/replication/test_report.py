"""An experiment from its flights to the report, in small; and the report that is committed."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drake_quad import load_scenario
from drake_quad.files import read_table
from drake_quad.replication.experiment import Sizes, fly_experiment
from drake_quad.replication.figures import paper_figures
from drake_quad.replication.findings import findings_of, write_findings
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, printed_table
from drake_quad.replication.report import FIGURES, report_markdown
from drake_quad.replication.results import FAIR, read_experiment
from drake_quad.statistics.interval import Interval
from drake_quad.studies.processes import Workers
from drake_quad.studies.report import report_html
from drake_quad.visualization.in_print import save_small

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs" / "replication"
CALIBRATION = ROOT / "drake_quad" / "replication" / "calibration.csv"
SIZES = Sizes(cells=3, recorded=2, sweep=2, grid=3, map=2, legs=4)


def load(cell):
    """The first half of the flight, which has straight legs and curved ones."""
    return load_scenario(f"{ROOT}/diagrams/paper.yaml:{cell.scenario}", ["duration=13.5"])


@pytest.fixture(scope="module")
def workers():
    with Workers(2) as found:
        yield found


@pytest.fixture(scope="module")
def run(tmp_path_factory, workers):
    folder = tmp_path_factory.mktemp("paper")
    told = []
    flights = fly_experiment(load, SIZES, folder, workers, progress=lambda *each: told.append(each))
    (folder / "calibration.csv").write_bytes((CALIBRATION).read_bytes())
    return folder, flights, told


@pytest.fixture(scope="module")
def report(run):
    folder, *_ = run
    found = read_experiment(folder)
    tables = findings_of(found, read_table(folder / "calibration.csv"))
    write_findings(folder, tables)
    return report_markdown(found, tables)


def rows_of(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def sections(text):
    """The lines of each section of a report, by its heading."""
    parts = re.split(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.slow
def test_everything_is_flown_and_counted(run):
    folder, flights, told = run
    assert told[-1][1] == SIZES.flights
    assert {path.name for path in (folder / "cells").iterdir()} == {
        f"{wind}_{name}" for wind in WINDS for name in [*CONTROLLERS, *FAIR]
    }
    assert set(flights) == {Cell(wind, name) for wind in WINDS for name in CONTROLLERS}


@pytest.mark.slow
def test_table_ii_is_that_of_the_rows(run, report):
    folder, *_ = run
    written = {(row["wind"], row["controller"], row["quantity"]): row for row in rows_of(folder / "table_ii.csv")}
    assert len(written) == 3 * len(WINDS) * len(CONTROLLERS)
    for (wind, controller, quantity), row in written.items():
        values = [float(line[quantity]) for line in rows_of(folder / "cells" / f"{wind}_{controller}" / "results.csv")]
        assert [float(row[f"ours_run{i}"]) for i in (1, 2, 3)] == values[:3]
        assert float(row["mean"]) == pytest.approx(np.mean(values), rel=1e-9)
        # Student's t for three numbers.
        assert float(row["high"]) - float(row["mean"]) == pytest.approx(4.302653 * np.std(values, ddof=1) / 3**0.5)
    check_table(report, written)


def check_table(text, written):
    """Every number of the CSV stands where it belongs in the report."""
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
                for (key_wind, key_controller, key), row in written.items()
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
def test_the_report_says_what_its_tables_say(run, report):
    folder, *_ = run
    assert not re.search(r"[{}]", report)
    assert "nan" not in report
    for claim in rows_of(folder / "claims.csv"):
        assert f"| {claim['claim']} | {claim['printed']} | {claim['ours']} | **{claim['verdict']}** |" in report
    for row in rows_of(folder / "fair.csv"):
        rmse = Interval(*(float(row[name]) for name in ("rmse", "rmse_low", "rmse_high")))
        assert f"| {rmse.text()} |" in report
    for row in rows_of(folder / "effort.csv"):
        assert f"| {float(row['ratio_x']):.2f} | {float(row['ratio_y']):.2f} |" in report


@pytest.mark.slow
def test_the_page_needs_nothing_else(run, report):
    folder, flights, _ = run
    (folder / "figures").mkdir()
    for name, figure in paper_figures(read_experiment(folder), flights):
        save_small(figure, folder / "figures" / f"{name}.png")
        with Image.open(folder / "figures" / f"{name}.png") as image:
            # 3.5 inches with 220 dots each.
            assert image.width == 770
            assert len(image.getcolors()) > 8
    assert {path.stem for path in (folder / "figures").iterdir()} == set(FIGURES)
    page = report_html(report, folder)
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert page.count("<table>") == report.count("\n| ---") + report.count("\n|---")


@pytest.mark.slow
def test_a_resumed_experiment_keeps_its_cells(run, workers):
    folder, *_ = run
    kept = {path: path.read_bytes() for path in (folder / "cells").rglob("results.csv")}
    path = folder / "cells" / "no_wind_pid" / "results.csv"
    path.write_bytes(b"".join(kept[path].splitlines(keepends=True)[:2]))
    fly_experiment(load, SIZES, folder, workers, resume=True)
    assert {path: path.read_bytes() for path in kept} == kept


def test_the_committed_report_is_that_of_its_tables():
    text = (DOCS / "report.md").read_text(encoding="utf-8")
    written = {(row["wind"], row["controller"], row["quantity"]): row for row in rows_of(DOCS / "table_ii.csv")}
    check_table(text, written)
    for claim in rows_of(DOCS / "claims.csv"):
        assert f"| {claim['claim']} | {claim['printed']} | {claim['ours']} | **{claim['verdict']}** |" in text
    for name in re.findall(r'src="(figures/\w+\.png)"', text):
        assert (DOCS / name).stat().st_size < 60_000


def test_the_committed_table_is_calibrated_and_prints_what_the_paper_prints():
    rows = {
        Cell(row["wind"], row["controller"]): row for row in rows_of(DOCS / "table_ii.csv") if row["quantity"] == "rmse"
    }
    for cell in (Cell("no_wind", "pd"), Cell("no_wind", "pd_t2fnn")):
        assert float(rows[cell]["mean"]) == pytest.approx(printed_table()[cell].rmse.mean, rel=0.02)
    for cell, line in printed_table().items():
        assert rows[cell]["printed_mean"] == ("" if np.isnan(line.rmse.mean) else repr(line.rmse.mean))


def test_the_calibration_is_that_of_the_scenarios():
    row = next(row for row in rows_of(CALIBRATION) if row["hypothesis"] == "measurement")
    control = load(Cell("low_wind", "pd_t2fnn")).control
    position = control.position
    assert position.k_p[0] == pytest.approx(float(row["pd_number"]) ** 2, rel=2e-3)
    assert position.k_d[0] == pytest.approx(1.4 * float(row["pd_number"]), rel=2e-3)
    assert control.network.learning.slope == pytest.approx(float(row["network_number"]), rel=2e-3)


def test_the_readme_has_the_committed_verdicts():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for claim in rows_of(DOCS / "claims.csv"):
        assert f"| {claim['claim']} | {claim['verdict']} |" in readme
