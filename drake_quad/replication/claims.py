"""Claims of the paper, with the paper's evidence, our evidence, and verdicts that follow from confidence intervals."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import scipy

from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table
from drake_quad.replication.results import MAPPED_CONTROLLERS, Experiment, select_cells
from drake_quad.replication.sweeps import EXPONENTS, NOISE_LEVELS, Q_VALUES, SLOPES, Sweep
from drake_quad.reports.claims import Claim, reduction, verdict_from_conditions
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.ratios import linearized_ratio, ratio_of_means

_NETWORK_CONTROLLERS = ("pd_t1fnn", "pd_t2fnn", "pd_t2fnn_wide")
_GAIN_SYMBOLS = {"k_p": "k_P", "k_d": "k_D"}
_TYPE_2_CONTROLLERS = ("pd_t2fnn", "pd_t2fnn_wide")
_WINDS_WITH_FANS = ("low_wind", "high_wind")
_MAX_ERROR_RATIO = 1.2  # gains count as nearly best if their error is at most this multiple of the smallest error


def all_claims(experiment: Experiment) -> list[Claim]:
    """Return all claims in the order of the report."""
    return [
        judge_half_the_error(experiment),
        judge_reduction_without_wind(experiment),
        judge_type_2_beats_type_1(experiment),
        judge_wider_under_noise(experiment),
        judge_peak_without_wind(experiment),
        judge_smaller_peaks_in_wind(experiment),
        judge_pd_tends_to_zero(experiment),
        judge_least_effort(experiment),
        judge_insensitive_to_wind(experiment),
        judge_straight_against_curved(experiment),
        judge_circle_of_gains(experiment),
    ]


def judge_half_the_error(experiment: Experiment) -> Claim:
    """Judge the claim that the error with the type-2 network is 50 % smaller than with the PD alone."""
    reductions = {cell: _reduction(experiment, cell, "pd") for cell in select_cells(_TYPE_2_CONTROLLERS)}
    over_slope = {wind: [_reduction_at_slope(experiment, wind, slope) for slope in SLOPES] for wind in WINDS}
    best = max(
        (decrease for reductions in over_slope.values() for decrease in reductions), key=lambda decrease: decrease.value
    )
    slopes = "; ".join(f"{WINDS[wind]} {_range_text(each)}" for wind, each in over_slope.items())
    return Claim(
        "PD+T2FNN is 50 % better than PD",
        f"reductions of {_range_text(reductions.values())} over winds and exponents; at most {best.percent()} with"
        " a λ other than the fitted one",
        verdict_from_conditions([decrease.is_above(0.5) for decrease in reductions.values()], best.is_above(0.5)),
        "holds if all reductions are above 50 %; holds in part if at least one is, with the fitted λ or another one",
        printed=f"Table II: {_span_text(_published_reductions(reductions, 'pd'), 100.0, '.0f')} %",
        details=f"{_listed_text(reductions)}; over λ from {SLOPES[0]:g} to {SLOPES[-1]:g} 1/s, {slopes}",
    )


def judge_reduction_without_wind(experiment: Experiment) -> Claim:
    """Judge the claim that the network makes the error without wind about 43 % smaller."""
    pd, network = (published_table()[Cell("no_wind", name)].rmse.mean for name in ("pd", "pd_t2fnn"))
    decrease = _reduction(experiment, Cell("no_wind", "pd_t2fnn"), "pd")
    other = {
        cell: _reduction(experiment, cell, "pd") for cell in select_cells(("pd_t1fnn", "pd_t2fnn_wide"), ["no_wind"])
    }
    return Claim(
        "without wind the error is about 43 % smaller",
        f"a reduction of {decrease.percent()}, which is the result of the fit; reductions by the other networks, which"
        f" were not fitted: {_listed_text(other)}",
        "cannot be decided",
        "cannot be decided, since two parameters were fitted to the errors of PD and PD+T2FNN without wind",
        printed=f"Table II: {pd:.3f} and {network:.3f} m, {100.0 * (1.0 - network / pd):.0f} %",
    )


def judge_type_2_beats_type_1(experiment: Experiment) -> Claim:
    """Judge the claim that the error with the type-2 network is 2 to 7 % smaller than with the type-1 network."""
    gains = {cell: _reduction(experiment, cell, "pd_t1fnn") for cell in select_cells(_TYPE_2_CONTROLLERS)}
    windy = {cell: gain for cell, gain in gains.items() if cell.wind != "no_wind"}
    over_noise = [_best_advantage(experiment.noise, "noise", level) for level in NOISE_LEVELS]
    over_q = [_best_advantage(experiment.q, "q", q) for q in Q_VALUES]
    only_upper, *mixed, _ = over_q
    best = max((*over_noise, *mixed), key=lambda gain: gain.value)
    return Claim(
        "type 2 beats type 1 by 2 to 7 %",
        f"reductions of {_range_text(windy.values())} in wind; without wind, with the better of the two widths,"
        f" {_range_text(over_noise)} with noise from 0 to 20 mm, {_range_text(mixed)} with q from 0.25 to 0.75, and"
        f" {only_upper.percent()} with q = 0, where only the upper memberships count",
        verdict_from_conditions([gain.is_above(0.02) for gain in windy.values()], best.is_above(0.02)),
        "holds if all reductions in wind are above 2 %; holds in part if at least one of them, or at least one"
        " reduction with other noise or with a q between 0 and 1, is above 2 %",
        printed=f"Table II in wind: {_span_text(_published_reductions(windy, 'pd_t1fnn'), 100.0, '.0f')} %,"
        " from three runs each, a difference that is not significant (in low wind,"
        f" {_welch_text('pd_t1fnn', 'pd_t2fnn')})",
        details=_listed_text(gains),
        figure="advantage",
    )


def judge_wider_under_noise(experiment: Experiment) -> Claim:
    """Judge the claim that more noise favours wider membership functions."""
    errors = [
        [_errors_at_setting(experiment.noise, "noise", level, name) for name in _TYPE_2_CONTROLLERS]
        for level in NOISE_LEVELS
    ]
    gains = [_error_reduction(wide, narrow) for narrow, wide in errors]
    trend = _reduction_difference(errors[-1], errors[0])
    printed = [published_table()[Cell("low_wind", name)].rmse.mean for name in _TYPE_2_CONTROLLERS]
    text = ", ".join(
        f"{(-gain).percent()} at {1e3 * level:g} mm" for level, gain in zip(NOISE_LEVELS, gains, strict=True)
    )
    return Claim(
        "more noise favours wider membership functions",
        f"wider sets have an error that is larger by {(-gains[0]).percent()} without position noise and by"
        f" {(-gains[-1]).percent()} with 20 mm, so noise reduces their disadvantage by {trend.percent()} of the error",
        verdict_from_conditions([gains[-1].is_above(0.0), trend.is_above(0.0)]),
        "holds if noise reduces the disadvantage of the wider sets, and they have a smaller error with 20 mm of noise;"
        " holds in part if only one of these conditions is met",
        printed=f"Table II in low wind: {printed[0]:.3f} and {printed[1]:.3f} m, a difference that is not significant"
        f" ({_welch_text(*_TYPE_2_CONTROLLERS)}); noise is not varied",
        details=f"the error with wider sets is larger by {text}; noise that adds equally to both errors would also make"
        " the relative difference smaller",
    )


def judge_peak_without_wind(experiment: Experiment) -> Claim:
    """Judge the claim that the peak error without wind decreases from 1.3 to 0.8 m."""
    pd, network = (
        _mean(np.asarray(experiment.cells[Cell("no_wind", name)].metrics.peak_error)) for name in ("pd", "pd_t2fnn")
    )
    decrease = _reduction(experiment, Cell("no_wind", "pd_t2fnn"), "pd", "peak_error")
    return Claim(
        "without wind the peak error falls from 1.3 to 0.8 m",
        f"{pd.metres()} and {network.metres()}, a reduction of {decrease.percent()}",
        verdict_from_conditions([decrease.is_above(0.38)], decrease.is_above(0.0)),
        "holds if the peak falls by more than 38 %; holds in part if it falls at all",
        printed="Fig. 9: about 1.3 and 0.8 m, 38 %",
    )


def judge_smaller_peaks_in_wind(experiment: Experiment) -> Claim:
    """Judge the claim that the type-2 network has smaller error peaks than the type-1 network in wind."""
    differences = {
        cell: experiment.comparison(cell, Cell(cell.wind, "pd_t1fnn"), "peak_error").difference
        for cell in select_cells(_TYPE_2_CONTROLLERS, _WINDS_WITH_FANS)
    }
    low, high = _smallest_and_largest(differences.values())
    return Claim(
        "in wind type 2 has smaller error peaks than type 1",
        f"peaks of type 2 minus those of type 1: {low.millimetres()} to {high.millimetres()}",
        verdict_from_conditions([(-each).is_above(0.0) for each in differences.values()]),
        "holds if all differences are below zero; holds in part if at least one is",
        printed="Figs 10 and 11, one run each",
        details=_listed_text(differences, Interval.millimetres),
    )


def judge_pd_tends_to_zero(experiment: Experiment) -> Claim:
    """Judge the claim that the PD's output tends to zero as the network learns, and rises again at new segments."""
    fades, returns = (
        {cell: _mean(experiment.recorded[cell][measure]) for cell in select_cells(("pd", "pd_t2fnn"))}
        for measure in ("pd_fade", "pd_return")
    )
    fade, back = (each[Cell("no_wind", "pd_t2fnn")] for each in (fades, returns))
    return Claim(
        "the PD's output tends to zero as the network learns, and rises again at each change of segment",
        f"without wind, the RMS of the PD's output in the last quarter of a flight is {fade.percent()} of its value in"
        f" the quarter after the climb; in the 1 s after a change of segment, it is {back.percent()} of its value in"
        " the 1 s before",
        verdict_from_conditions([(-fade).is_above(-0.5), back.is_above(1.0)]),
        "holds if the first percentage is below 50 % and the second above 100 %; holds in part if only one of these"
        " conditions is met",
        printed="Figs 12 and 13, one run",
        details="RMS of the PD's output in the last quarter of a flight, relative to the quarter after the climb:"
        f" {_listed_text(fades)}; RMS of the PD's output in the 1 s after a change of segment, relative to the 1 s"
        f" before: {_listed_text(returns)}",
    )


def judge_least_effort(experiment: Experiment) -> Claim:
    """Judge the claim that the PD has the smallest control effort."""
    fractions = {
        (cell, axis): experiment.comparison(cell, Cell(cell.wind, "pd"), f"effort_{axis}").ratio
        for cell in select_cells(_NETWORK_CONTROLLERS)
        for axis in "xy"
    }
    low, high = _smallest_and_largest(fractions.values())
    printed = [
        fraction for fractions in published_effort_ratios().values() for fraction in fractions if np.isfinite(fraction)
    ]
    text = "; ".join(f"{cell.label} on {axis.upper()} {each.ratio()}" for (cell, axis), each in fractions.items())
    return Claim(
        "the PD costs the least effort",
        f"the networks need {low.ratio()} to {high.ratio()} times the PD's effort",
        verdict_from_conditions([each.is_above(1.0) for each in fractions.values()]),
        "holds if all ratios are above 1; holds in part if at least one is",
        printed=f"Table II: the networks need {_span_text(printed, 1.0, '.1f')} times the PD's effort",
        details=text,
    )


def judge_insensitive_to_wind(experiment: Experiment) -> Claim:
    """Judge the claim that the controllers are insensitive to wind."""
    rises = {
        cell: experiment.comparison(cell, Cell("no_wind", name)).ratio.plus(-1.0)
        for name in CONTROLLERS
        for cell in select_cells([name], _WINDS_WITH_FANS)
    }
    return Claim(
        "the controllers are insensitive to wind",
        f"errors increase by {_range_text(rises.values())}",
        verdict_from_conditions(
            [(-each).is_above(-0.02) for each in rises.values()],
            *((-each).is_above(-0.1) for each in rises.values()),
        ),
        "holds if all errors increase by less than 2 %; holds in part if at least one increases by less than 10 %",
        printed="Table II, without wind, in low and in high wind: "
        + "; ".join(f"{CONTROLLERS[name]} {_published_levels_text(name)} m" for name in ("pd", "pd_t2fnn")),
        details=_listed_text(rises),
    )


def judge_straight_against_curved(experiment: Experiment) -> Claim:
    """Judge the claim about PDs that are tuned only on straight lines, or only on curves.

    Gains are selected on the first half of the samples and compared on the second half.
    """
    straight, curved, swing = experiment.legs.metrics
    half = len(experiment.legs.samples) // 2
    # The mean is NaN if a sample crashed, so gains with a crash are not selected.
    on_straight, on_curved = (int(np.nanargmin(each[:, :half].mean(axis=1))) for each in (straight, curved))
    error_increase = ratio_of_means(curved[on_straight, half:], curved[on_curved, half:]).plus(-1.0)
    variation_ratio = ratio_of_means(swing[on_curved, half:], swing[on_straight, half:])
    gains = [
        " and ".join(f"{symbol} = {experiment.legs.settings[name][best]:.2f}" for name, symbol in _GAIN_SYMBOLS.items())
        for best in (on_straight, on_curved)
    ]
    return Claim(
        "an aggressive PD tuned on straight lines is worse on curves, and one tuned on curves oscillates on straight"
        " lines",
        f"the best gains are {gains[0]} on straight lines, and {gains[1]} on curves; on other samples, the error on"
        f" curves is larger by {error_increase.percent()} with the gains for straight lines than with the gains for"
        f" curves, and the variation of the command on straight lines is {variation_ratio.ratio()} times as large with"
        " the gains for curves as with the gains for straight lines",
        verdict_from_conditions([error_increase.is_above(0.0), variation_ratio.is_above(1.0)]),
        "holds if the error on curves is larger with the gains for straight lines, and the variation of the command on"
        " straight lines is larger with the gains for curves; holds in part if only one of these conditions is met",
        printed="a statement without numbers",
    )


def judge_circle_of_gains(experiment: Experiment) -> Claim:
    """Judge the claim that, with a network, any PD gains that stabilise the loop are sufficient."""
    pd, network = (_mean(near_best_fraction(experiment.maps[name])) for name in MAPPED_CONTROLLERS)
    more = _mean(near_best_fraction(experiment.maps["pd_t2fnn"]) - near_best_fraction(experiment.maps["pd"]))
    typical = [_mean(median_to_best_ratio(experiment.maps[name])) for name in MAPPED_CONTROLLERS]
    best = [_mean(np.nanmin(_errors(experiment.maps[name]), axis=0)) for name in MAPPED_CONTROLLERS]
    return Claim(
        "with the network, any PD gains that stabilise the loop suffice: a circle around the optimal point",
        f"of the gains that stabilise the loop, {pd.percent()} have an error within 20 % of the smallest error with the"
        f" PD, and {network.percent()} with PD+T2FNN; the median error is {typical[0].ratio()} times the smallest error"
        f" with the PD, and {typical[1].ratio()} times with PD+T2FNN; the smallest errors are {best[0].metres()} and"
        f" {best[1].metres()}",
        verdict_from_conditions([more.is_above(0.0), network.is_above(0.5)]),
        "holds if the fraction of gains within 20 % of the smallest error is larger with the network than with the PD,"
        " and is above 50 %; holds in part if only one of these conditions is met",
        printed="a statement without numbers",
        details=f"{_grid_text(experiment.maps['pd'])}; at least one sample crashes with"
        f" {_num_settings_with_crash(experiment.maps['pd'])} of these gains for the PD, and with"
        f" {_num_settings_with_crash(experiment.maps['pd_t2fnn'])} for PD+T2FNN; with the network, the fraction of"
        f" gains within 20 % of the smallest error is larger by {more.percent()}",
        figure="gains",
    )


def near_best_fraction(sweep: Sweep) -> np.ndarray:
    """Return the fraction (samples,) of gains without a crash whose error is at most 1.2 times the smallest error."""
    rmse = _errors(sweep)
    best = np.nanmin(rmse, axis=0)
    fractions: np.ndarray = (rmse <= _MAX_ERROR_RATIO * best).sum(axis=0) / np.isfinite(rmse).sum(axis=0)
    return fractions


def median_to_best_ratio(sweep: Sweep) -> np.ndarray:
    """Return, for each sample, the median divided by the smallest error over all gains without a crash."""
    rmse = _errors(sweep)
    return np.asarray(np.nanmedian(rmse, axis=0) / np.nanmin(rmse, axis=0))


def advantage(sweep: Sweep, setting: str, value: float, controller: str) -> Interval:
    """Return the relative reduction of the mean error by a type-2 controller, compared with type 1.

    Args:
        sweep: sweep over a setting, such as the noise.
        setting: name of the setting.
        value: value of the setting.
        controller: name of the type-2 controller.
    """
    return _error_reduction(
        _errors_at_setting(sweep, setting, value, controller), _errors_at_setting(sweep, setting, value, "pd_t1fnn")
    )


def published_effort_ratios() -> dict[Cell, tuple[float, float]]:
    """Return each network's printed mean efforts on X and Y, relative to the PD's effort in the same wind.

    The ratios are keyed by cell. A ratio is NaN if one of the two efforts is missing in the paper.
    """
    table = published_table()
    return {
        cell: (
            line.effort_x.mean / table[Cell(cell.wind, "pd")].effort_x.mean,
            line.effort_y.mean / table[Cell(cell.wind, "pd")].effort_y.mean,
        )
        for cell, line in table.items()
        if cell.controller != "pd"
    }


def _reduction(experiment: Experiment, cell: Cell, baseline: str, metric: str = "rmse") -> Interval:
    """Return the relative reduction of the mean of a metric, compared with a baseline controller in the same wind."""
    return reduction(experiment.comparison(cell, Cell(cell.wind, baseline), metric).ratio)


def _published_reductions(cells: Iterable[Cell], baseline: str) -> list[float]:
    """Return the relative reductions of the printed mean errors, compared with a baseline, for all printed cells."""
    means = {cell: line.rmse.mean for cell, line in published_table().items() if np.isfinite(line.rmse.mean)}
    return [1.0 - means[cell] / means[Cell(cell.wind, baseline)] for cell in cells if cell in means]


def _errors_at_setting(sweep: Sweep, setting: str, value: float, controller: str) -> np.ndarray:
    """Return the RMSE (samples,) of a controller for one value of a setting.

    Args:
        sweep: sweep over the setting.
        setting: name of the setting.
        value: value of the setting.
        controller: name of a controller with a network.
    """
    a1, a2 = EXPONENTS[controller]
    chosen = (sweep.settings[setting] == value) & (sweep.settings["a1"] == a1) & (sweep.settings["a2"] == a2)
    (index,) = np.flatnonzero(chosen)
    errors: np.ndarray = _errors(sweep)[index]
    return errors


def _best_advantage(sweep: Sweep, setting: str, value: float) -> Interval:
    """Return the relative reduction of the mean error by the better type-2 controller, compared with type 1."""
    return max((advantage(sweep, setting, value, name) for name in _TYPE_2_CONTROLLERS), key=lambda gain: gain.value)


def _errors(sweep: Sweep) -> np.ndarray:
    """Return the RMSE (settings, samples) of a sweep; NaN for samples that crashed."""
    return np.where(sweep.metrics.crashed, np.nan, sweep.metrics.rmse)


def _reduction_at_slope(experiment: Experiment, wind: str, slope: float) -> Interval:
    """Return the relative reduction of the mean error by PD+T2FNN with a given slope λ, compared with PD."""
    sweep = experiment.slopes[wind]
    (index,) = np.flatnonzero(sweep.settings["slope"] == slope)
    pd = experiment.cells[Cell(wind, "pd")].metrics
    baseline = np.where(pd.crashed, np.nan, pd.rmse)[sweep.samples]
    return _error_reduction(_errors(sweep)[index], baseline)


def _error_reduction(errors: np.ndarray, baseline: np.ndarray) -> Interval:
    """Return the relative reduction of the mean error, compared with a baseline.

    Args:
        errors: (samples,) errors; NaN for samples that crashed.
        baseline: (samples,) errors of the baseline; NaN for samples that crashed.
    """
    both = np.isfinite(errors) & np.isfinite(baseline)
    return reduction(ratio_of_means(errors[both], baseline[both]))


def _reduction_difference(pair: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> Interval:
    """Return the error reduction of one pair of controllers minus that of another pair.

    Args:
        pair: errors (samples,) of a baseline and of a controller.
        other: errors (samples,) of another baseline and of another controller.
    """
    valid = np.isfinite([*pair, *other]).all(axis=0)
    ratio, other_ratio = (linearized_ratio(errors[valid], baseline[valid]) for baseline, errors in (pair, other))
    return mean_interval(other_ratio - ratio)


def _grid_text(sweep: Sweep) -> str:
    """Return the size and the ranges of the grid of gains in a map, and the number of samples, as text."""
    k_p, k_d = (np.unique(sweep.settings[name]) for name in _GAIN_SYMBOLS)
    return (
        f"{len(k_p)} × {len(k_d)} gains, k_P from {k_p[0]:g} to {k_p[-1]:g} 1/s² and k_D from {k_d[0]:g} to {k_d[-1]:g}"
        f" 1/s in geometric steps, {len(sweep.samples)} samples each"
    )


def _num_settings_with_crash(sweep: Sweep) -> int:
    """Return the number of settings with which at least one sample crashes."""
    return int(sweep.metrics.crashed.any(axis=1).sum())


def _mean(values: np.ndarray) -> Interval:
    """Return the mean of the finite values. Values of crashed samples are NaN."""
    return mean_interval(values[np.isfinite(values)])


def _welch_text(first: str, second: str) -> str:
    """Return the p-value of Welch's test between the printed runs of two controllers in low wind, as text."""
    runs = [published_table()[Cell("low_wind", name)].rmse.runs for name in (first, second)]
    return f"Welch, p = {scipy.stats.ttest_ind(*runs, equal_var=False).pvalue:.2f}"


def _published_levels_text(controller: str) -> str:
    """Return the printed mean errors of a controller in all winds, as text."""
    means = [
        published_table()[cell].rmse.mean
        for cell in (Cell(wind, controller) for wind in WINDS)
        if cell in published_table()
    ]
    return ", ".join("–" if np.isnan(mean) else f"{mean:.3f}" for mean in means)


def _span_text(values: Sequence[float] | np.ndarray, factor: float, format_spec: str) -> str:
    """Return the smallest and the largest value as text.

    Args:
        values: numbers, such as relative reductions.
        factor: factor by which the values are multiplied.
        format_spec: format specification of a number, such as ".2f".
    """
    return f"{factor * min(values):{format_spec}} to {factor * max(values):{format_spec}}"


def _listed_text(numbers: Mapping[Cell, Interval], text: Callable[[Interval], str] = Interval.percent) -> str:
    """Return text that lists a number for each cell of Table II."""
    return "; ".join(f"{cell.label} {text(number)}" for cell, number in numbers.items())


def _smallest_and_largest(estimates: Iterable[Interval]) -> tuple[Interval, Interval]:
    """Return the smallest and the largest of several estimates."""
    ordered = sorted(estimates)
    return ordered[0], ordered[-1]


def _range_text(fractions: Iterable[Interval]) -> str:
    """Return the smallest and the largest value as text, in per cent."""
    low, high = _smallest_and_largest(fractions)
    return f"{low.percent()} to {high.percent()}"
