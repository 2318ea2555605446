"""Tests of the tables and sentences in the report of an evaluation, with invented flights."""

import numpy as np
import pytest
from invented_flights import NUM_FLIGHTS, evaluation, flights
from test_evaluation_claims import verdicts

from drake_quad.design.tuning import Budget, LoopLimit
from drake_quad.evaluation.claims import (
    CONTROLLER_NAMES,
    all_claims,
    best_controllers,
    compare_common_samples,
    comparisons_by_laboratory,
    delay_text,
    designs_by_sensitivity,
    lap_counts,
)
from drake_quad.evaluation.entries import controller_entries
from drake_quad.evaluation.experiment import QUICK, EvaluationSizes
from drake_quad.evaluation.families import FAMILIES, FIRST_EVALUATION_SAMPLE
from drake_quad.evaluation.report import CAPTIONS, machine, report_markdown, write_summary
from drake_quad.evaluation.results import (
    SENSITIVITY_LIMITS,
    Traits,
    laboratory_with_laps,
    read_evaluation,
    write_evaluation,
)
from drake_quad.files import read_table
from drake_quad.reports.claims import reduction, verdict_counts
from drake_quad.statistics.estimates import mean_interval, proportion_interval
from drake_quad.studies.statistics import values_without_crashes


def rows_of(text):
    """Return the cells of all rows of all tables of a report."""
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in text.split("\n") if line[:2] == "| "]


def centimetres(metrics, name="rmse"):
    return mean_interval(values_without_crashes(metrics, name)).text(size=0.01)


@pytest.fixture(scope="module")
def evaluated():
    evaluated = evaluation(crashed=range(8))
    evaluated.flights["outdoor"]["mpc"] = flights(0.3).take(slice(10))
    nan = float("nan")
    evaluated.traits["outdoor"] = evaluated.traits["outdoor"] | {"mpc": Traits(nan, nan, nan, 9e-4, nan)}
    return evaluated


def test_the_committed_report_has_the_default_evaluation_sizes_and_all_claims(root):
    """The report contains the claims in the order of `all_claims`."""
    text = (root / "docs" / "controllers" / "report.md").read_text(encoding="utf-8")
    sizes = EvaluationSizes()
    assert text.startswith("#")
    for phrase in (
        f" laboratories with {sizes.samples} samples each",
        f"| MPC ({sizes.num_uncompiled_samples} samples) |",
        f"in lap {sizes.max_laps} its RMSE is smaller by",
    ):
        assert phrase in text
    budget, limit, text_in_one_line = Budget(), LoopLimit(), " ".join(text.split())
    for phrase in (
        f"none of {sizes.num_delay_samples} samples crashes",
        f"trained on {budget.samples} flights, with samples from 0 on, and evaluated on samples from"
        f" {FIRST_EVALUATION_SAMPLE} on",
        f"{budget.rounds} rounds of {budget.candidates} candidates",
        f"checked for {budget.limit_evaluations} candidates in each round",
        f"(COBYLA) of {budget.local_search_steps} steps",
        f"a peak sensitivity of at most {limit.sensitivity:g} and a delay margin of at least {1e3 * limit.delay:g} ms",
    ):
        assert phrase in text_in_one_line
    assert list(SENSITIVITY_LIMITS) == sorted(SENSITIVITY_LIMITS)
    # Each number of samples or flights in a quick evaluation is smaller than its default.
    assert all(quick < default for quick, default in zip(QUICK[:-2], sizes[:-2], strict=True))
    assert not QUICK.certifies
    evaluated = evaluation()
    for laboratory in FAMILIES["laboratory"].laboratories:
        evaluated.flights[laboratory] |= {
            "pd_t2fnn_adaptive": flights(0.1, scatter=3),
            "pd_t2fnn_map": flights(0.1, scatter=4),
        }
        evaluated.flights[laboratory] |= {
            "pid": flights(0.2),
            "pid_t2fnn": flights(0.1, scatter=3),
            "indi_t2fnn_map": flights(0.1),
        }
    statements = [each.statement for each in all_claims(evaluated)]
    shipped = [row[0] for row in rows_of(text) if row[0] in statements]
    assert statements == shipped
    assert len(statements) >= 9


def test_tolerated_delays_are_written_as_text():
    delays = (np.nan, -0.01, 0.0, 0.0624, np.inf)
    assert [delay_text(delay) for delay in delays] == ["–", "none", "0 ms", "62 ms", "all tried"]


def test_a_controller_with_fewer_samples_is_compared_only_on_its_samples():
    complete, partial = flights(0.3), flights(0.2, scatter=1).take(slice(10))
    for one, other in ((complete, partial), (partial, complete)):
        assert compare_common_samples(one, other) == compare_common_samples(
            *(each.take(slice(10)) for each in (one, other))
        )


def test_a_controller_with_fewer_samples_cannot_be_the_best():
    evaluated = evaluation()
    evaluated.flights["outdoor"] = {"pd": flights(0.2), "indi": flights(0.2001, scatter=9).take(slice(10))}
    assert best_controllers(evaluated, "outdoor") == ["pd", "indi"]
    evaluated.flights["outdoor"]["indi"] = flights(0.1).take(slice(10))
    assert best_controllers(evaluated, "outdoor") == ["pd"]
    # If all controllers crash often, the best of them is still named. Designs with other limits do not count.
    evaluated.flights["outdoor"] = {"pd": flights(0.2, crashed=range(9)), "indi@3": flights(0.1)}
    assert best_controllers(evaluated, "outdoor") == ["pd"]


def test_a_claim_does_not_hold_with_more_crashes_despite_a_smaller_error():
    evaluated = evaluation(crashed=range(8))
    for place in FAMILIES["laboratory"].laboratories:
        del evaluated.flights[place]["pd_t2fnn"]
    (claim,) = (each for each in all_claims(evaluated) if each.statement.endswith("to PD reduces the error"))
    assert claim.verdict == "does not hold"
    assert "reduction of the RMSE: 28." in claim.evidence
    # The claim holds if the controller with the network has a smaller error and the base controller crashes more often.
    evaluated.flights["outdoor"]["pd"] = flights(0.2, crashed=range(20, 40))
    evaluated.flights["outdoor"]["pd_t2fnn"] = flights(0.1, scatter=2)
    assert verdicts(evaluated)[claim.statement] == "holds"


def test_the_tolerated_delay_is_reported_for_each_family():
    evaluated = evaluation()
    evaluated.traits["outdoor"] = {**evaluated.traits["outdoor"], "pd_t2fnn": Traits(2.2, 0.06, 0.04, 1e-4, 1e-6)}
    claim = all_claims(evaluated)[0]
    assert claim.evidence.endswith(
        "; the tolerated delay changes from 90 ms to 90 ms (laboratory), 90 ms to 40 ms (outdoor)"
    )


def test_a_comparison_needs_both_controllers():
    evaluated = evaluation()
    assert "no wind" in comparisons_by_laboratory(evaluated, "pd_t1fnn", "pd")
    del evaluated.flights["no wind"]["pd_t1fnn"]
    assert "no wind" not in comparisons_by_laboratory(evaluated, "pd_t1fnn", "pd")
    assert comparisons_by_laboratory(evaluated, "l1", "pd") == {}
    statements = [each.statement for each in all_claims(evaluated)]
    assert not any("L1" in each or "with the position as input has a smaller error" in each for each in statements)
    assert lap_counts(evaluated, "pd_t2fnn_map") == [1, 2, 3]
    del evaluated.flights[laboratory_with_laps(2)]["pd_t2fnn_map"]
    assert lap_counts(evaluated, "pd_t2fnn_map") == [1]
    assert not any(each.statement.startswith("over several laps") for each in all_claims(evaluated))


def test_designs_are_ordered_by_their_peak_sensitivity():
    evaluated = evaluation()
    assert [each.sensitivity for each, _ in designs_by_sensitivity(evaluated, "indi")] == [1.6, 2.2, 3.0]
    assert designs_by_sensitivity(evaluated, "lqg") == []
    errors = [metrics.rmse.mean() for _, metrics in designs_by_sensitivity(evaluated, "indi")]
    assert errors == [evaluated.flights["high wind"][name].rmse.mean() for name in ("indi@1.6", "indi", "indi@3")]


def test_a_table_row_of_the_report_has_errors_crashes_effort_margins_and_times(evaluated):
    text = report_markdown(evaluated, all_claims(evaluated), [])
    rows, outdoor = rows_of(text), evaluated.flights["outdoor"]
    # In invented flights, the metrics after `rmse` are 0.25, 1.25, …, in the order of the fields of `Metrics`. The peak
    # error is 3.25 m, and the efforts are 4.25, 5.25 and 6.25, with the sum 15.75.
    (network,) = (row for row in rows if row[0] == "PD + type 2" and len(row) == 10)
    peak = centimetres(outdoor["pd_t2fnn"], "peak_error")
    assert network == [
        "PD + type 2", centimetres(outdoor["pd_t2fnn"]), "8", peak, "15.75", "2.20", "60", "90", "80", "1.00",
    ]  # fmt: skip
    assert peak.startswith("325")
    (mpc,) = (row for row in rows if row[0].startswith("MPC") and len(row) == 10)
    assert mpc[0] == "MPC (10 samples)"
    assert mpc[1:3] == [centimetres(outdoor["mpc"]), "0"]
    assert mpc[-5:] == ["–", "–", "–", "900", "–"]
    (pd,) = (row for row in rows if row[0] == "PD" and len(row) == 12)
    assert pd[1:4] == [centimetres(evaluated.flights[place]["pd"]) for place in FAMILIES["laboratory"].laboratories]
    assert pd[4] == "0"
    assert f"Crash probabilities: PD + type 2 (outdoor): {proportion_interval(8, NUM_FLIGHTS).percent()}." in text
    assert text.count("Crash probabilities: ") == 1
    assert "### robustness\n\nNo controller was flown here." in text


def test_the_report_has_a_column_of_certified_scales_if_a_controller_is_certified(tmp_path):
    evaluated = evaluation()
    evaluated.traits["outdoor"] = {
        "pd": Traits(2.2, 0.06, 0.09, 8e-5, 1e-6, 1.184, 1.25),
        "indi": Traits(2.2, 0.06, 0.09, 8e-5, 1e-6, 0.5, float("inf")),
        "pd_t2fnn": Traits(2.2, 0.06, 0.09, 8e-5, 1e-6, not_certified="it learns"),
    }
    write_evaluation(tmp_path, evaluated)
    text = report_markdown(read_evaluation(tmp_path), [], [])
    outdoor = text.partition("### outdoor")[2].partition("### ")[0]
    assert [row[-1].removesuffix(" |") for row in rows_of(outdoor)][2:] == [
        "1.18 (unstable at 1.25)",
        "0.50",
        "not certified",
    ]
    assert "Not certified: PD + type 2. Reason: it learns." in outdoor
    assert "certified scale |" not in text.partition("### laboratory")[2].partition("### ")[0]


def test_crashes_are_listed_laboratory_by_laboratory():
    evaluated = evaluation()
    evaluated.flights["high wind"]["pd"] = flights(0.2, crashed=range(40))
    rows = rows_of(report_markdown(evaluated, all_claims(evaluated), []))
    (pd,) = (row for row in rows if row[0] == "PD" and len(row) == 12)
    assert pd[4] == "0, 0, 40"
    # All vehicles crash, so there is no effort.
    assert pd[6] == "–"


def test_designs_with_other_sensitivity_limits_have_rows_in_the_report(evaluated):
    rows = rows_of(report_markdown(evaluated, all_claims(evaluated), []))
    errors = [centimetres(evaluated.flights["high wind"][f"indi@{limit}"]) for limit in ("1.6", "3")]
    assert [row for row in rows if row[0] == "INDI" and len(row) == 9] == [
        ["INDI", "1.6", errors[0], "0", "1.60", "50", "62", "100", "1.00"],
        ["INDI", "3", errors[1], "0", "3.00", "50", "33", "100", "1.00"],
    ]
    without = evaluation()
    del without.traits["priced"]
    assert "No design was flown." in report_markdown(without, all_claims(without), [])


def test_the_report_describes_the_protocol_with_its_values(evaluated):
    claims = all_claims(evaluated)
    text = " ".join(report_markdown(evaluated, claims, [*CAPTIONS]).split())
    budget, limit = Budget(), LoopLimit()
    for phrase in (
        f"flown in 4 laboratories with {NUM_FLIGHTS} samples each",
        f"trained on {budget.samples} flights, with samples from 0 on, and evaluated on samples from"
        f" {FIRST_EVALUATION_SAMPLE} on",
        f"{budget.rounds} rounds of {budget.candidates} candidates",
        f"a peak sensitivity of at most {limit.sensitivity:g} and a delay margin of at least {1e3 * limit.delay:g} ms",
        f"checked for {budget.limit_evaluations} candidates in each round",
        f"(COBYLA) of {budget.local_search_steps} steps",
        "trained in some of them: laboratory: low wind and high wind; outdoor: outdoor;",
        f"in machine code on {machine()}.",
    ):
        assert phrase in text
    assert all(f"figures/{name}.png" in text for name in CAPTIONS)
    entries = controller_entries(on_board=False, position_networks=True)
    rows = rows_of(report_markdown(evaluated, claims, []))
    for each in entries.values():
        tuned = f"search over {len(each.parameters)} numbers" if each.parameters else "Riccati equations"
        assert [each.label, each.plant_knowledge, tuned] in rows


def test_the_report_lists_each_rule_with_the_numbers_of_its_claims(evaluated):
    claims = all_claims(evaluated)
    text = report_markdown(evaluated, claims, [])
    for each in claims:
        assert [each.statement, each.evidence, f"**{each.verdict}**"] in rows_of(text)
    assert f"The verdicts are: {verdict_counts(claims)}." in text
    for rule in {each.rule for each in claims}:
        numbers = [str(i) for i, each in enumerate(claims, start=1) if each.rule == rule]
        assert f"- {rule}: {', '.join(numbers)}\n" in text


def test_controller_entries_without_a_design_are_listed(evaluated):
    text = report_markdown(evaluated, all_claims(evaluated), [])
    (line,) = (line for line in text.split("\n") if line.startswith("- outdoor: ") and " cm " not in line)
    known = controller_entries(on_board=False, position_networks=False)
    names = [each.label for name, each in known.items() if name not in evaluated.traits["outdoor"]]
    assert line == f"- outdoor: {', '.join(names)}"
    complete = evaluation()
    for name, family in FAMILIES.items():
        names = controller_entries(on_board=family.on_board, position_networks=family.position_networks)
        complete.traits[name] = dict.fromkeys(names, Traits(2.0, 0.1, 0.1, 1e-4, 1e-6))
        for laboratory in family.laboratories:
            complete.flights[laboratory] = {
                **complete.flights.get(laboratory, {}),
                **dict.fromkeys(names, flights(0.1)),
            }
    assert "Each controller has a design for each family of laboratories." in report_markdown(
        complete, all_claims(complete), []
    )


def test_the_best_controllers_of_each_laboratory_are_named():
    evaluated = evaluation()
    outdoor = evaluated.flights["outdoor"]
    best, equal = best_controllers(evaluated, "outdoor")
    assert {best, equal} == {"indi", "indi_t2fnn"}
    mean = mean_interval(outdoor[best].rmse).text(unit="cm", size=0.01)
    ratio = compare_common_samples(outdoor["pd"], outdoor[best]).ratio.ratio()
    others = f"not significantly different from {CONTROLLER_NAMES[equal]}"
    line = (
        f"- outdoor: {CONTROLLER_NAMES[best]}, {mean}; the RMSE of the tuned PD is {ratio} times as large; {others}\n"
    )
    assert line in report_markdown(evaluated, all_claims(evaluated), [])
    # The PD is not compared with itself.
    evaluated.flights["outdoor"] = outdoor | {"pd": flights(0.01)}
    mean = mean_interval(flights(0.01).rmse).text(unit="cm", size=0.01)
    assert f"- outdoor: PD, {mean}\n" in report_markdown(evaluated, all_claims(evaluated), [])


def test_the_summary_has_the_metrics_intervals_and_traits_of_each_controller(evaluated, tmp_path):
    summary = read_table(write_summary(tmp_path / "summary.csv", evaluated))
    row = np.flatnonzero((summary["laboratory"] == "outdoor") & (summary["controller"] == "pd_t2fnn"))[0]
    metrics = evaluated.flights["outdoor"]["pd_t2fnn"]
    mean, crashes = mean_interval(values_without_crashes(metrics, "rmse")), proportion_interval(8, NUM_FLIGHTS)
    for name, expected in (("rmse", mean), ("crashes", crashes)):
        ends = [summary[f"{name}{end}"][row] for end in ("", "_low", "_high")]
        np.testing.assert_allclose(ends, [expected.value, expected.low, expected.high], rtol=1e-5)
    assert summary["family"][row] == "outdoor"
    assert summary["samples"][row] == NUM_FLIGHTS
    assert summary["peak"][row] == 3.25
    assert [summary[f"effort_{axis}"][row] for axis in "xyz"] == [4.25, 5.25, 6.25]
    assert [summary[name][row] for name in Traits._fields[:5]] == [2.2, 0.06, 0.09, 80e-6, 1e-6]
    flown = [
        (laboratory, name)
        for laboratory in ("no wind", "low wind", "high wind")
        for name in evaluated.traits["laboratory"]
    ]
    flown += [("outdoor", name) for name in evaluated.traits["outdoor"]]
    assert list(zip(summary["laboratory"], summary["controller"], strict=True)) == flown


def test_a_larger_error_is_a_negative_reduction():
    compared = comparisons_by_laboratory(evaluation(type_1_ratio=1.1), "pd_t1fnn", "pd")["outdoor"]
    assert reduction(compared.ratio).value == pytest.approx(-0.1, abs=0.002)
    assert reduction(compared.ratio).low < reduction(compared.ratio).value < reduction(compared.ratio).high < 0.0
