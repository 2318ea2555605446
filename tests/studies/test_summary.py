"""Tests of summaries of studies with many, few, no and only crashes."""

import math
import re

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.laboratory.metrics import METRICS, Metrics
from drake_quad.statistics.estimates import (
    bounded_mean_interval,
    mean_interval,
    proportion_interval,
    quantile_interval,
    without_negative_part,
)
from drake_quad.studies.statistics import crash_bins, metric_mean, most_influential_path
from drake_quad.studies.study import Study
from drake_quad.studies.summary import comparison_table, crash_text, metric_table, overview_table
from drake_quad.visualization.study_plots import plot_crash_probability


def study(count, crashed, seed=0, scenario="diagrams/robustness.yaml", **parameters):
    """Return a study whose first samples crash; a fifth of the samples have saturated rotors."""
    rng = np.random.default_rng(seed)
    errors = rng.gamma(3.0, 0.02, count)
    crash_time = np.where(np.arange(count) < crashed, 3.0, math.inf)
    saturated = np.where(rng.random(count) < 0.2, 0.01, 0.0)
    numbers = dict.fromkeys(Metrics._fields, errors) | {"saturated_fraction": saturated, "crash_time": crash_time}
    return Study(load_scenario(scenario), 10.0, np.arange(count), parameters, Metrics(**numbers))


SAMPLES_AND_CRASHES = [
    (0, 0),
    (1, 0),
    (1, 1),
    (2, 0),
    (2, 1),
    (2, 2),
    (10, 5),
    (300, 0),
    (300, 3),
    (300, 297),
    (300, 300),
]


@pytest.mark.parametrize(("count", "crashed"), SAMPLES_AND_CRASHES)
def test_intervals_exclude_crashes_and_stay_within_the_possible_range(count, crashed):
    result = study(count, crashed)
    summary, words = metric_table(result), crash_text(result)
    cells = [cell for row in summary.rows for cell in row[1:-1]]
    assert len({len(row) for row in [summary.headings, *summary.rows]}) == 1
    for cell in cells:
        assert "[crash, crash]" not in cell
        assert "[–, –]" not in cell
        assert "-∞" not in cell
        assert "nan" not in cell
        assert "inf" not in cell
        numbers = [float(number) for number in re.findall(r"-?\d+\.\d+", cell)]
        assert all(number >= 0.0 for number in numbers), cell
        assert not (crashed == 0 and "crash" in cell)
    (fractions,) = (row for row in summary.rows if row[-1] == "%")
    assert all(float(number) <= 100.0 for cell in fractions[1:-1] for number in re.findall(r"\d+\.\d+", cell))
    assert words.startswith(f"{crashed} crashed, ")
    if count == crashed > 0:
        assert {cell for row in summary.rows for cell in row[3:-1]} == {"crash"}
        assert {cell for row in summary.rows for cell in row[1:3]} == {"–"}


@pytest.mark.parametrize(
    ("count", "crashed", "words"),
    [
        (300, 3, "means and standard deviations are taken over the 297 samples without a crash; quantiles are taken"),
        (2, 1, "means and standard deviations are taken over the one sample without a crash;"),
        (3, 1, "means and standard deviations are taken over the 2 samples without a crash;"),
        (3, 2, "means and standard deviations are taken over the one sample without a crash;"),
        (2, 2, "every sample crashed, so there are no means"),
        (2, 0, None),
    ],
)
def test_a_summary_states_that_means_are_over_flights_without_a_crash(count, crashed, words):
    remarks = metric_table(study(count, crashed)).remarks
    assert len(remarks) == (words is not None)
    assert all(remark.startswith(words) for remark in remarks)


def test_a_summary_has_errors_in_centimetres_and_saturation_in_per_cent():
    result = study(40, 2)
    rows = {name: getattr(result.metrics, name) * (1.0 + 0.1 * i) for i, name in enumerate(Metrics._fields[:-1])}
    result = Study(result.scenario, 10.0, result.samples, {}, result.metrics._replace(**rows))
    errors = {name for name, metric in METRICS.items() if metric.unit == "m"}
    names = {metric.label: name for name, metric in METRICS.items() if metric.display is not None}
    assert {*errors, "effort_x", "saturated_fraction"} <= {*names.values()}
    summary = metric_table(result)
    assert [row[0] for row in summary.rows] == [*names]
    assert summary.headings == ("", "mean", "std. dev.", "5 % quantile", "median", "95 % quantile", "")
    sizes = {"cm": 0.01, "m²/s⁴": 1.0, "%": 0.01}
    for label, mean, deviation, *quantiles, unit in summary.rows:
        name = names[label]
        assert (unit == "cm") == (name in errors)
        cells = rows[name][2:]
        assert mean == metric_mean(result.metrics, name).text(size=sizes[unit])
        assert float(deviation) == pytest.approx(cells.std(ddof=1) / sizes[unit], rel=0.05)
        every = np.where(result.metrics.crashed, math.inf, rows[name])
        for text, fraction in zip(quantiles, (0.05, 0.5, 0.95), strict=True):
            assert text == without_negative_part(quantile_interval(every, fraction)).text(
                size=sizes[unit], infinities=("-∞", "crash")
            )


@pytest.mark.parametrize(("count", "crashed"), [each for each in SAMPLES_AND_CRASHES if each[0]])
def test_fractions_in_a_comparison_are_not_negative_and_crashes_have_a_p_value(count, crashed):
    pairs = {"one": study(count, 0), "other": study(count, crashed, seed=1)}
    summary = comparison_table(pairs, "rmse")
    ((name, difference, fraction, better, num_pairs, crashes_of_one, significance),) = summary.rows
    assert (name, num_pairs, crashes_of_one) == ("other", f"{count - crashed}", f"{crashed} : 0")
    assert ("p = " in significance) == (crashed > 0)
    assert "-" not in fraction + better
    assert len(summary.remarks) == (crashed > 0)
    assert (difference == "–") == (count == crashed)


def study_of_throws(settling_time, recovers, crashed):
    """Return a study of thrown vehicles, given settling times (s), robustness (m) and the number of crashes."""
    scenario, count = load_scenario("upset"), len(settling_time)
    values = dict.fromkeys(scenario.metrics_type._fields, np.ones(count))
    crash_time = np.where(np.arange(count) < crashed, 1.0, math.inf)
    values |= {"settling_time": np.array(settling_time), "recovers": np.array(recovers), "crash_time": crash_time}
    return Study(scenario, 20.0, np.arange(count), {}, scenario.metrics_type(**values))


def test_an_overview_has_crashes_requirements_and_medians_of_additional_metrics_for_each_controller():
    late_times = [math.inf, math.inf, 4.0, math.inf]
    studies = {
        "good": study_of_throws([2.0, 3.0, 4.0, 9.0], [0.1] * 4, 0),
        "late": study_of_throws(late_times, [-0.1, 0.1, 0.1, -0.2], 0),
        "crashing": study_of_throws([2.0, 3.0, 4.0, 9.0], [0.1] * 4, 3),
    }
    summary = overview_table(studies)
    assert summary.headings[:4] == ("", "crashed", "recovers", "median settling time (s)")
    assert summary.headings[4:] == ("median overshoot (cm)", "median largest tilt (°)")
    good, late_times, study_with_crashes = summary.rows
    assert good[:4] == ("good", proportion_interval(0, 4).percent(), proportion_interval(4, 4).percent(), "3.00")
    assert good[4:] == ("100", "57.3")
    assert late_times[2:4] == (proportion_interval(2, 4).percent(), "∞")
    assert study_with_crashes[2:4] == (proportion_interval(1, 4).percent(), "crash")


def test_an_overview_without_requirements_and_additional_metrics_is_empty():
    assert overview_table({"one": study(4, 0), "other": study(4, 1)}).rows == []


def test_the_interval_of_a_positive_mean_is_student_s_interval_without_its_negative_part():
    result = without_negative_part(mean_interval(np.array([0.1, 0.3])))
    assert result == pytest.approx((0.2, 0.0, 0.2 + 12.706 * 0.1), rel=1e-4)
    values = np.random.default_rng(0).gamma(3.0, 0.02, 200)
    assert without_negative_part(mean_interval(values)) == mean_interval(values)


@pytest.mark.parametrize(
    ("draw", "truth"),
    [
        (lambda rng: rng.beta(0.5, 5.0, 30), 0.5 / 5.5),
        (lambda rng: rng.beta(5.0, 0.5, 30), 5.0 / 5.5),
        (lambda rng: (rng.random(30) < 0.1) * 1.0, 0.1),
        (lambda rng: (rng.random(50) < 0.05) * 0.02, 0.001),
    ],
)
def test_the_interval_of_a_mean_fraction_lies_within_0_and_1_and_has_its_nominal_coverage(draw, truth):
    rng = np.random.default_rng(3)
    result = [bounded_mean_interval(draw(rng)) for _ in range(1500)]
    assert all(0.0 <= low <= value <= high <= 1.0 for value, low, high in result)
    assert 0.92 < np.mean([low <= truth <= high for _, low, high in result]) < 0.985


def test_a_mean_fraction_of_0_or_1_has_the_interval_of_a_proportion():
    assert bounded_mean_interval(np.zeros(100)) == proportion_interval(0, 100)
    assert bounded_mean_interval(np.ones(100)) == proportion_interval(100, 100)
    assert math.isnan(bounded_mean_interval(np.zeros(1)).high)
    # The interval of a precise mean is close to Student's.
    values = np.random.default_rng(0).uniform(0.45, 0.55, 4000)
    half = 1.9605 * values.std(ddof=1) / math.sqrt(4000)
    assert bounded_mean_interval(values) == pytest.approx((values.mean(), values.mean() - half, values.mean() + half))


def test_an_extremely_wide_interval_of_a_fraction_is_0_to_1():
    """With two values and a confidence close to 1, the odds p / (1 - p) at the ends of the interval would overflow."""
    assert bounded_mean_interval(np.array([0.0, 0.1]), 0.9999) == pytest.approx((0.05, 0.0, 1.0), abs=1e-12)


def test_each_metric_has_a_suitable_interval():
    metrics = study(30, 5).metrics
    has_not_crashed = ~metrics.crashed
    assert metric_mean(metrics, "saturated_fraction") == bounded_mean_interval(
        metrics.saturated_fraction[has_not_crashed]
    )
    assert metric_mean(metrics, "rmse") == without_negative_part(mean_interval(metrics.rmse[has_not_crashed]))


def study_with_crashes(numbers, crashed, **parameters):
    result = study(len(numbers), 0, **{"vehicle.mass": np.asarray(numbers, dtype=float), **parameters})
    times = np.where(crashed, 1.0, math.inf)
    return Study(result.scenario, 10.0, result.samples, result.parameters, result.metrics._replace(crash_time=times))


def test_few_different_values_have_a_bin_each_and_many_samples_at_most_twenty_bins():
    few = np.repeat([1.0, 2.0, 3.0], [90, 5, 5])
    levels = crash_bins(study_with_crashes(few, few > 2.0), "vehicle.mass", num_bins=3)
    assert [(level.low, level.high, level.num_samples) for level in levels] == [(1, 1, 90), (2, 2, 5), (3, 3, 5)]
    assert len(crash_bins(study_with_crashes(np.arange(12_000), np.zeros(12_000, dtype=bool)), "vehicle.mass")) == 20


def test_a_comparison_shows_signed_differences_and_crashes_of_only_one_controller():
    worse = study(30, 0)
    worse = Study(worse.scenario, 10.0, worse.samples, {}, worse.metrics._replace(rmse=worse.metrics.rmse + 0.01))
    (row,) = comparison_table({"base": study(30, 0), "worse": worse}, "rmse").rows
    assert row[1].startswith("+1.00 ")  # cm
    summary = comparison_table({"base": study(30, 3), "safer": study(30, 0)}, "rmse")
    assert summary.rows[0][5] == "0 : 3"
    assert summary.rows[0][6] == "p = 0.25"
    assert len(summary.remarks) == 1


def test_bins_contain_equally_many_samples():
    numbers = np.random.default_rng(2).permutation(1000)
    levels = crash_bins(study_with_crashes(numbers, numbers >= 900), "vehicle.mass")
    assert [level.num_samples for level in levels] == [100] * 10
    assert [(level.low, level.high, level.middle) for level in levels][2] == (200.0, 299.0, 249.5)
    assert [level.probability for level in levels] == [proportion_interval(0, 100)] * 9 + [
        proportion_interval(100, 100)
    ]
    assert len(crash_bins(study_with_crashes(numbers, numbers > 3), "vehicle.mass", num_bins=4)) == 4


def test_a_discrete_parameter_has_a_bin_for_each_value_and_few_samples_have_few_bins():
    levels = crash_bins(study_with_crashes([2, 0, 1, 1, 2, 2] * 20, [True, False] * 60), "vehicle.mass")
    assert [(level.low, level.high, level.num_samples) for level in levels] == [(0, 0, 20), (1, 1, 40), (2, 2, 60)]
    assert [level.probability.value for level in levels] == [0.0, 0.5, pytest.approx(2.0 / 3.0)]
    assert [level.num_samples for level in crash_bins(study_with_crashes([3.0], [True]), "vehicle.mass")] == [1]
    assert crash_bins(study_with_crashes([], []), "vehicle.mass") == []
    # Samples with equal values are in the same bin.
    skewed = crash_bins(study_with_crashes([1.0] * 500 + [*np.linspace(2.0, 3.0, 500)], [False] * 1000), "vehicle.mass")
    assert skewed[0].num_samples == 500
    assert sum(level.num_samples for level in skewed) == 1000


def test_a_parameter_that_is_not_drawn_has_no_crash_bins():
    with pytest.raises(InputError, match="vehicle.gravity is not a drawn field .* drawn fields are: vehicle.mass"):
        crash_bins(study_with_crashes([1.0], [True]), "vehicle.gravity")
    with pytest.raises(InputError, match="the number of bins is 0; it must be at least 1"):
        crash_bins(study_with_crashes([1.0], [True]), "vehicle.mass", num_bins=0)


def test_the_most_influential_parameter_is_chosen_from_those_that_are_random_in_every_study():
    rng = np.random.default_rng(4)
    mass, drag = rng.permutation(100) / 100.0, rng.permutation(100) / 100.0
    is_light, has_large_drag = mass < 0.3, drag > 0.7
    second_parameter = {"vehicle.linear_drag": drag}
    assert most_influential_path([study_with_crashes(mass, is_light, **second_parameter)]) == "vehicle.mass"
    assert (
        most_influential_path([study_with_crashes(mass, has_large_drag, **second_parameter)]) == "vehicle.linear_drag"
    )
    assert (
        most_influential_path(
            [study_with_crashes(mass, has_large_drag, **second_parameter), study_with_crashes(mass, has_large_drag)]
        )
        == "vehicle.mass"
    )
    assert most_influential_path([study(10, 0)]) is None


def test_the_plot_shows_crash_bins_over_the_most_influential_parameter():
    rng = np.random.default_rng(0)
    mass, drag = rng.normal(0.7, 0.05, (2, 600))
    studies = {
        "pd": study_with_crashes(mass, drag > 0.77, **{"vehicle.linear_drag": drag}),
        "indi": study_with_crashes(mass, rng.random(600) < 0.05, **{"vehicle.linear_drag": drag}),
    }
    assert most_influential_path(studies.values()) == "vehicle.linear_drag"
    (axes,) = plot_crash_probability(studies).axes
    assert axes.get_xlabel() == "vehicle linear drag (N s/m)"
    levels = crash_bins(studies["pd"], "vehicle.linear_drag")
    line = next(each for each in axes.lines if str(each.get_label()).startswith("pd: "))
    np.testing.assert_allclose(line.get_xydata(), [(level.middle, level.probability.value) for level in levels])
    # The axis has the range of the drawn values, and the points of two controllers are next to each other.
    low, high = min(level.low for level in levels), max(level.high for level in levels)
    assert axes.get_xlim() == pytest.approx((low, high), abs=0.1 * (high - low))
    axes.get_figure().draw_without_rendering()
    other_points = next(each for each in axes.lines if str(each.get_label()).startswith("indi: "))
    shift = other_points.get_transform().transform((low, 0.0)) - line.get_transform().transform((low, 0.0))
    assert shift == pytest.approx([3.0 * axes.get_figure().dpi / 72.0, 0.0])
    ends = np.concatenate([bars.get_segments() for bars in axes.collections])
    expected = [[(each.middle, each.probability.low), (each.middle, each.probability.high)] for each in levels]
    for bar in expected:
        assert np.abs(ends - bar).max(axis=(1, 2)).min() < 1e-12
    (mass_axes,) = plot_crash_probability(studies, "vehicle.mass").axes
    assert mass_axes.get_xlabel() == "vehicle mass (kg)"
    with pytest.raises(InputError, match="no random parameter"):
        plot_crash_probability(study(3, 1, scenario="diagrams/hover.yaml"))
