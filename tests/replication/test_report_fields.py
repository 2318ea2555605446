"""Tests of sentences and tables in the report of the replication, for invented findings."""

from pathlib import Path

import numpy as np
from invented_experiment import paper_scenario

from drake_quad import load_scenario
from drake_quad.files import read_table
from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication import report
from drake_quad.replication.baseline_comparison import COMPARED_CONTROLLERS, FairEntry
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL
from drake_quad.replication.effort import EffortMatch, published_ratios, published_scatter
from drake_quad.replication.measures import EFFORTS, OUR_EFFORT
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, Runs, published_table
from drake_quad.replication.results import Experiment, select_cells
from drake_quad.replication.table_ii import QUANTITIES, TableEntry, table_markdown
from drake_quad.reports.claims import Claim
from drake_quad.reports.page import image
from drake_quad.statistics.interval import Interval
from drake_quad.studies.statistics import compare_studies
from drake_quad.studies.study import Study

NAN = float("nan")


def entry(cell, quantity, printed, mean, crashed=0):
    """Return an invented entry of Table II, given its value in the paper and its simulated mean."""
    runs = Runs((mean, mean, mean), mean)
    return TableEntry(Cell(*cell), quantity, Runs((printed,) * 3, printed), runs, Interval(mean, mean, mean), crashed)


def entries_of_table(crashed=0):
    """Return invented entries for seven cells (combinations of controller and wind) of the paper's Table II.

    The calibration fits the errors of two cells, and the paper does not give the error of one cell. All control efforts
    are three times those in the paper.

    Args:
        crashed: number of flights of each cell that crash.
    """
    errors = {
        PD_CELL: (1.0, 0.99),
        NETWORK_CELL: (0.5, 0.51),
        ("low_wind", "pd"): (0.8, 0.9),
        ("low_wind", "pd_t2fnn"): (0.5, 0.49),
        ("high_wind", "pd"): (0.8, 0.86),
        ("high_wind", "pd_t1fnn"): (NAN, 0.7),
        ("high_wind", "pd_t2fnn"): (0.5, 0.4),
    }
    result = [entry(cell, "rmse", *numbers, crashed) for cell, numbers in errors.items()]
    return result + [entry(cell, name, 1.0, 3.0, 900) for cell in errors for name in ("effort_x", "effort_y")]


def test_predictions_of_table_ii_are_counted_without_the_fitted_cells():
    entries = entries_of_table(crashed=3)
    fields = report._table_fields(entries)
    assert (fields["off_pd"], fields["off_network"]) == ("-1.0 %", "+2.0 %")
    assert (fields["predicted"], fields["within"]) == (4, 2)
    assert fields["exceptions"] == (
        f"; the exceptions are {CONTROLLERS['pd']} in low wind (+12.5 %),"
        f" {CONTROLLERS['pd_t2fnn']} in high wind (-20.0 %)"
    )
    assert fields["spread"] == "-20.0 to +12.5 %"
    assert fields["crashes"] == "21 samples crashed; means are those of the others."
    for name in QUANTITIES:
        assert fields[f"table_{name}"] == table_markdown(entries, name)
    accurate_entries = [each for each in entries_of_table() if abs(each.deviation) < 0.1]
    fields = report._table_fields(accurate_entries)
    assert fields["exceptions"] == ""
    assert fields["within"] == fields["predicted"] == 2
    assert fields["crashes"] == "No sample crashed."


def test_a_claim_has_a_section_with_its_rule_and_its_evidence():
    claims = [
        Claim("a is less than b", "ours", "holds", "a rule", printed="print", details="cells", figure="gains"),
        Claim("c", "o", "does not hold", "r", printed="p"),
    ]
    fields = report._claim_fields(claims)
    first, *_ = fields["claims"].split("### 2. C\n\n")
    assert first == (
        "### 1. A is less than b\n\nThe paper: print. Here: ours.\n\nVerdict: **holds**. Rule: a rule.\n\n"
        f"Details: cells.\n\n{image('gains', report.CAPTIONS['gains'])}\n\n"
    )
    assert fields["claims"].count("Details") == 1
    assert fields["claims"].count("<img") == 1
    header, _, row, _ = fields["verdicts"].split("\n")
    assert header == "| claim | the paper's evidence | ours, with 95 % intervals | verdict |"
    assert row == "| a is less than b | print | ours | **holds** |"


def test_the_comparison_with_other_controllers_has_a_row_for_each_controller_and_wind():
    rng = np.random.default_rng(1)
    cells = {
        cell: Study(
            paper_scenario(), 27.0, np.arange(9), {},
            Metrics(*((1.0 + 0.1 * i) * rng.uniform(0.9, 1.1, 9) for _ in Metrics._fields[1:]), np.full(9, np.inf)),
        )
        for i, cell in enumerate(select_cells(COMPARED_CONTROLLERS))
    }  # fmt: skip
    numbers = {
        cell: FairEntry(cell, *(Interval(0.1 * i + j, 0.1 * i + j - 0.01, 0.1 * i + j + 0.01) for j in range(1, 7)))
        for i, cell in enumerate(cells)
    }
    result = Experiment(cells, *[{}] * 6)
    fields = report._fair_fields(result, [*numbers.values()])
    rows = [line.strip("| ").split(" | ") for line in fields["fair"].split("\n")[2:]]
    for row, (cell, each) in zip(rows, numbers.items(), strict=True):
        over_pd, over_network = (fraction.ratio() for fraction in (each.over_pd, each.over_network))
        assert row == [
            WINDS[cell.wind],
            COMPARED_CONTROLLERS[cell.controller],
            *(mean.text() for mean in (each.rmse, each.peak_error, each.effort_x, each.effort_y)),
            "1" if cell.controller == "pd" else over_pd,
            "1" if cell.controller == "pd_t2fnn" else over_network,
        ]
    for name in ("pd_retuned", "pd_feed_forward"):
        fractions = (f"{numbers[Cell(wind, name)].over_network.percent()} ({words})" for wind, words in WINDS.items())
        assert fields[f"{name}_over_network"] == ", ".join(fractions)
    network_ratios = (
        compare_studies(cells[Cell(wind, "pd_feed_forward_t2fnn")], cells[Cell(wind, "pd_feed_forward")]).ratio
        for wind in WINDS
    )
    expected = (
        f"{fraction.percent()} ({words})" for fraction, words in zip(network_ratios, WINDS.values(), strict=True)
    )
    assert fields["network_over_feed_forward"] == ", ".join(expected)


def test_the_table_of_effort_definitions_begins_with_the_printed_ratios():
    matches = [
        EffortMatch("command_peak", 1.234, 2.345, Interval(1.1, 1.0, 1.2)),
        EffortMatch(OUR_EFFORT, 3.0, 4.0, Interval(1.5, 1.4, 1.6)),
    ]
    fields = report._effort_fields(matches)
    rows = [line.strip("| ").split(" | ") for line in fields["effort"].split("\n")[2:]]
    x, y = published_ratios()
    assert rows[0][:3] == ["*printed*", f"{x:.2f}", f"{y:.2f}"]
    assert rows[1] == ["largest absolute command", "1.23", "2.35", matches[0].distance.ratio()]
    assert rows[2][0] == f"{EFFORTS[OUR_EFFORT].definition} (ours)"
    assert fields["closest"] == "the largest absolute command"
    assert fields["scatter"] == published_scatter()


def test_the_calibration_table_lists_our_errors_beside_the_errors_that_the_paper_prints():
    calibration = read_table(Path(report.__file__).parent / "calibration.csv")
    fields = report._calibration_fields()
    rows = [line.strip("| ").split(" | ") for line in fields["calibration"].split("\n")]
    assert rows[0] == ["printed", *(each.label for each in HYPOTHESES.values())]
    table = published_table()
    keys = zip(calibration["hypothesis"], calibration["wind"], calibration["controller"], strict=True)
    errors = dict(zip(keys, calibration["rmse_m"], strict=True))
    for row, (cell, line) in zip(rows[2:], table.items(), strict=True):
        fitted = " (fitted)" if cell in (PD_CELL, NETWORK_CELL) else ""
        assert row[:2] == [f"{WINDS[cell.wind]}{fitted}", CONTROLLERS[cell.controller]]
        assert row[2] == ("–" if np.isnan(line.rmse.mean) else f"{line.rmse.mean:.3f}")
        for text, name in zip(row[3:], HYPOTHESES, strict=True):
            ours = errors[name, *cell]
            off = ours / line.rmse.mean - 1.0
            assert text == f"{ours:.3f}" + ("" if np.isnan(off) else f" ({100.0 * off:+.1f} %)")
    for name, words in zip(HYPOTHESES, fields["fitted"].split("\n"), strict=True):
        first = list(calibration["hypothesis"]).index(name)
        pd, network = (float(calibration[column][first]) for column in ("pd_number", "network_number"))
        each = HYPOTHESES[name]
        assert words == f"- {each.label}: {each.pd.label}: {pd:.4g}; {each.network.label}: {network:.4g}."
        off = [
            100.0 * (errors[name, *cell] / line.rmse.mean - 1.0)
            for cell, line in table.items()
            if cell not in (PD_CELL, NETWORK_CELL) and np.isfinite(line.rmse.mean)
        ]
        assert fields[f"spread_{name}"] == f"{min(off):+.1f} to {max(off):+.1f} %"


def test_the_committed_report_has_the_current_assumptions_and_calibration(root):
    """The assumptions are table rows in the template, whose placeholders are replaced by values from a scenario."""
    text = (root / "docs" / "replication" / "report.md").read_text(encoding="utf-8")
    template = Path(report.__file__).with_name("report_template.md").read_text(encoding="utf-8")
    scenario = load_scenario("diagrams/paper.yaml:low_wind_pd_t2fnn")
    rows = [line for line in template.split("\n") if line.startswith("| ")]
    assert len(rows) == 2 + 27
    assert "\n".join(rows).format_map(report._scenario_fields(scenario)) in text
    for words in report._calibration_fields().values():
        assert words in text
