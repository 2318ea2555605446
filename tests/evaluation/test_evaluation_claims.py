"""Tests of the verdicts on claims, by comparison with independent computations from invented flights."""

import re

import numpy as np
import pytest
from invented_flights import NUM_FLIGHTS, evaluation, flights

from drake_quad.errors import InputError
from drake_quad.evaluation.claims import all_claims, best_controllers, comparisons_by_laboratory, judge_price_of_margin
from drake_quad.evaluation.families import FAMILIES
from drake_quad.evaluation.report import report_markdown, write_summary
from drake_quad.evaluation.results import laboratory_with_laps, read_evaluation, write_evaluation
from drake_quad.files import read_table
from drake_quad.reports.claims import reduction
from drake_quad.statistics.estimates import proportion_interval


def verdicts(evaluation_results):
    return {each.statement: each.verdict for each in all_claims(evaluation_results)}


NETWORK_CLAIM = "adding a type-2 network to PD reduces the error"
TYPE_2_CLAIM = "with the PD, a type-2 network has a smaller error than a type-1 network"


def test_claims_about_effective_networks_hold_and_about_neutral_ones_are_undecided():
    result = verdicts(evaluation())
    assert result[NETWORK_CLAIM] == result[TYPE_2_CLAIM] == "holds"
    assert result["adding a type-2 network to INDI reduces the error"] == "cannot be decided"


def test_a_claim_about_a_harmful_network_does_not_hold():
    result = verdicts(evaluation(type_1_ratio=1.1, type_2_ratio=1.05))
    assert result[NETWORK_CLAIM] == result[TYPE_2_CLAIM] == "does not hold"


def test_crashes_with_a_network_make_its_claim_hold_in_part():
    result = verdicts(evaluation(crashed=range(8)))
    assert result[NETWORK_CLAIM] == "holds in part"
    (text,) = (each.evidence for each in all_claims(evaluation(crashed=range(8))) if each.statement == NETWORK_CLAIM)
    assert "outdoor: 8 samples crash only in this case, 0 only in the compared case (p = 0.0078)" in text
    assert verdicts(evaluation(crashed=range(2)))[NETWORK_CLAIM] == "holds"


def test_reductions_are_paired_by_sample():
    compared = comparisons_by_laboratory(evaluation(type_1_ratio=0.9, type_2_ratio=0.8), "pd_t2fnn", "pd")
    assert list(compared) == [*FAMILIES["laboratory"].laboratories, "outdoor"]
    for each in compared.values():
        assert reduction(each.ratio).value == pytest.approx(0.28, abs=0.002)
        # The scatter of 10 % between samples cancels in a paired comparison.
        assert reduction(each.ratio).high - reduction(each.ratio).low < 0.002


def test_learning_in_laps_must_improve_on_the_first_lap_and_on_flights_without_a_network():
    (claim,) = (each for each in all_claims(evaluation()) if each.statement.startswith("over several laps"))
    assert claim.verdict == "holds"
    assert claim.evidence.startswith("in lap 3 its RMSE is smaller by 75.")


@pytest.mark.parametrize(("num_laps", "num_claims"), [(1, 0), (2, 1)])
def test_learning_in_laps_is_judged_from_two_laps_on(num_laps, num_claims):
    result = evaluation()
    for count in range(num_laps + 1, 4):
        result.flights.pop(laboratory_with_laps(count))
    assert sum(each.statement.startswith("over several laps") for each in all_claims(result)) == num_claims


def test_the_claim_that_margin_costs_accuracy_holds_if_every_smaller_margin_reduces_the_error():
    result = evaluation()
    claim = judge_price_of_margin(result)
    assert claim.verdict == "holds"
    assert "with a peak sensitivity of 3.00 instead of 1.60, the RMSE of INDI is smaller by 50." in claim.evidence
    assert "from 62 ms to 33 ms" in claim.evidence
    result.flights["high wind"]["indi@3"] = flights(0.05, scatter=6)
    assert judge_price_of_margin(result).verdict == "holds in part"


def test_the_best_controller_has_the_smallest_error_among_those_that_rarely_crash():
    result = evaluation()
    assert sorted(best_controllers(result, "low wind")) == ["indi", "indi_t2fnn"]
    result.flights["low wind"]["pd"] = flights(0.03)
    assert best_controllers(result, "low wind") == ["pd"]
    result.flights["low wind"]["pd"] = flights(0.2, crashed=[1])
    assert sorted(best_controllers(result, "low wind")) == ["indi", "indi_t2fnn"]
    result.flights["low wind"]["pd"] = flights(0.03, crashed=range(4))
    assert sorted(best_controllers(result, "low wind")) == ["indi", "indi_t2fnn"]


def test_an_evaluation_is_read_as_it_was_written(tmp_path):
    result = evaluation(crashed=[1])
    flights_file, traits_file = write_evaluation(tmp_path, result)
    assert (flights_file.name, traits_file.name) == ("flights.csv", "traits.csv")
    reread = read_evaluation(tmp_path)
    for family, traits in result.traits.items():
        assert list(reread.traits[family]) == list(traits)
        read, written = ([*values.values()] for values in (reread.traits[family], traits))
        np.testing.assert_allclose([each[:-1] for each in read], [each[:-1] for each in written], rtol=1e-8)
        assert [each.not_certified for each in read] == [each.not_certified for each in written]
    assert {laboratory: list(flown) for laboratory, flown in reread.flights.items()} == {
        laboratory: list(flown) for laboratory, flown in result.flights.items()
    }
    for laboratory, flown in result.flights.items():
        for name, metrics in flown.items():
            np.testing.assert_allclose(reread.flights[laboratory][name], metrics, rtol=1e-8)
    assert read_table(flights_file)["sample"].min() == 1000
    flights_file.write_text("laboratory,controller\noutdoor,pd\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"flights.csv has no column rmse"):
        read_evaluation(tmp_path)


def test_the_report_agrees_with_the_evaluation(tmp_path):
    result = evaluation(crashed=range(8))
    result.flights["low wind"]["indi_t2fnn"] = flights(0.05)
    text = report_markdown(result, all_claims(result), ["errors"])
    mean, pd = (result.flights["low wind"][name].rmse.mean() for name in ("indi", "pd"))
    best, ratio = re.search(r"- low wind: INDI, (\S+) cm \[.*; the RMSE of the tuned PD is (\S+) \[", text).groups()
    assert float(best) == pytest.approx(100.0 * mean, rel=1e-3)
    assert float(ratio) == pytest.approx(pd / mean, rel=1e-3)
    assert f"PD + type 2 (outdoor): {proportion_interval(8, NUM_FLIGHTS).percent()}" in text
    assert "figures/errors.png" in text
    assert "figures/laps.png" not in text
    assert "- robustness: PD, PID" in text
    summary = read_table(write_summary(tmp_path / "summary.csv", result))
    row = (summary["laboratory"] == "outdoor") & (summary["controller"] == "pd_t2fnn")
    assert summary["crashes"][row] == 0.2
    assert summary["rmse"][row] == pytest.approx(result.flights["outdoor"]["pd_t2fnn"].rmse[8:].mean(), rel=1e-5)
