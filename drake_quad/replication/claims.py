"""Claims of the paper, with its evidence, our evidence, and a verdict that follows from the intervals."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import scipy

from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell, printed_table
from drake_quad.replication.results import MAPPED, Experiment, cells_of
from drake_quad.replication.sweeps import EXPONENTS, NOISE, Q_VALUES, SLOPES, Sweep
from drake_quad.reports.claims import Claim, judge, reduction
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.ratios import linearized_ratio, ratio_of_means

_NETWORKS = ("pd_t1fnn", "pd_t2fnn", "pd_t2fnn_wide")
_GAINS = {"k_p": "k_P", "k_d": "k_D"}
_TYPE_2 = ("pd_t2fnn", "pd_t2fnn_wide")
_IN_WIND = ("low_wind", "high_wind")
# Largest error, relative to the best one, of gains that count as equally good.
_MAX_ERROR_RATIO = 1.2


def all_claims(found: Experiment) -> list[Claim]:
    """Return all claims in the order of the report."""
    return [
        half_the_error(found),
        reduction_without_wind(found),
        type_2_beats_type_1(found),
        wider_under_noise(found),
        peak_without_wind(found),
        smaller_peaks_in_wind(found),
        pd_tends_to_zero(found),
        least_effort(found),
        insensitive_to_wind(found),
        straight_against_curved(found),
        circle_of_gains(found),
    ]


def half_the_error(found: Experiment) -> Claim:
    """Judge the claim that type 2 is 50 % better than PD."""
    cuts = {cell: _reduction(found, cell, "pd") for cell in cells_of(_TYPE_2)}
    over_slope = {wind: [_cut_at(found, wind, slope) for slope in SLOPES] for wind in WINDS}
    best = max((cut for cuts in over_slope.values() for cut in cuts), key=lambda cut: cut.value)
    slopes = "; ".join(f"{WINDS[wind]} {_range(each)}" for wind, each in over_slope.items())
    return Claim(
        "PD+T2FNN is 50 % better than PD",
        f"{_range(cuts.values())} over winds and widths; λ, which is fitted, makes it {best.percent()} at best",
        judge([cut.is_above(0.5) for cut in cuts.values()], best.is_above(0.5)),
        "holds if all are above 50 %, in part if some are, also with another λ",
        printed=f"Table II: {_span(_printed_reductions(cuts, 'pd'), 100.0, '.0f')} %",
        details=f"{_listed(cuts)}; over λ from {SLOPES[0]:g} to {SLOPES[-1]:g} 1/s, {slopes}",
    )


def reduction_without_wind(found: Experiment) -> Claim:
    """Judge the claim that the error without wind is about 43 % smaller."""
    pd, network = (printed_table()[Cell("no_wind", name)].rmse.mean for name in ("pd", "pd_t2fnn"))
    cut = _reduction(found, Cell("no_wind", "pd_t2fnn"), "pd")
    other = {cell: _reduction(found, cell, "pd") for cell in cells_of(("pd_t1fnn", "pd_t2fnn_wide"), ["no_wind"])}
    return Claim(
        "without wind the error is about 43 % smaller",
        f"{cut.percent()}, fitted; not fitted: {_listed(other)}",
        "cannot be decided",
        "the numbers were fitted to these two cells",
        printed=f"Table II: {pd:.3f} and {network:.3f} m, {100.0 * (1.0 - network / pd):.0f} %",
    )


def type_2_beats_type_1(found: Experiment) -> Claim:
    """Judge the claim that type 2 beats type 1 by 2 to 7 %."""
    gains = {cell: _reduction(found, cell, "pd_t1fnn") for cell in cells_of(_TYPE_2)}
    windy = {cell: gain for cell, gain in gains.items() if cell.wind != "no_wind"}
    over_noise = [_advantage(found.noise, "noise", level) for level in NOISE]
    over_q = [_advantage(found.q, "q", q) for q in Q_VALUES]
    only_upper, *mixed, _ = over_q
    best = max((*over_noise, *mixed), key=lambda gain: gain.value)
    return Claim(
        "type 2 beats type 1 by 2 to 7 %",
        f"in wind {_range(windy.values())}; the better width, without wind, with noise from 0 to 20 mm"
        f" {_range(over_noise)}, with q from 0.25 to 0.75 {_range(mixed)}; {only_upper.percent()} with"
        " q = 0, where only the upper memberships are left",
        judge([gain.is_above(0.02) for gain in windy.values()], best.is_above(0.02)),
        "holds if all in wind are above 2 %, in part if some are, also with other noise or a q within 0 and 1",
        printed=f"Table II in wind: {_span(_printed_reductions(windy, 'pd_t1fnn'), 100.0, '.0f')} %,"
        f" of three runs each, which is not significant (in low wind {_welch('pd_t1fnn', 'pd_t2fnn')})",
        details=_listed(gains),
        figure="advantage",
    )


def wider_under_noise(found: Experiment) -> Claim:
    """Judge the claim that more noise favours wider membership functions."""
    errors = [[_rmse(found.noise, "noise", level, name) for name in _TYPE_2] for level in NOISE]
    gains = [_cut(wide, narrow) for narrow, wide in errors]
    trend = _more_cut(errors[-1], errors[0])
    printed = [printed_table()[Cell("low_wind", name)].rmse.mean for name in _TYPE_2]
    text = ", ".join(f"{1e3 * level:g} mm {(-gain).percent()}" for level, gain in zip(NOISE, gains, strict=True))
    return Claim(
        "more noise favours wider membership functions",
        f"the error with wider sets is larger by {(-gains[0]).percent()} without position noise and by"
        f" {(-gains[-1]).percent()} with 20 mm: they gain {trend.percent()}",
        judge([gains[-1].is_above(0.0), trend.is_above(0.0)]),
        "holds if the wider sets gain with noise and are better at 20 mm, in part if one of the two",
        printed=f"Table II in low wind: {printed[0]:.3f} and {printed[1]:.3f} m, which is not significant"
        f" ({_welch(*_TYPE_2)}); noise is not varied",
        details=f"larger by, at {text}; noise that adds the same to both errors makes a difference smaller, too",
    )


def peak_without_wind(found: Experiment) -> Claim:
    """Judge the claim that the peak error without wind falls from 1.3 to 0.8 m."""
    pd, network = (
        _mean(np.asarray(found.cells[Cell("no_wind", name)].metrics.peak_error)) for name in ("pd", "pd_t2fnn")
    )
    cut = _reduction(found, Cell("no_wind", "pd_t2fnn"), "pd", "peak_error")
    return Claim(
        "without wind the peak error falls from 1.3 to 0.8 m",
        f"{pd.metres()} and {network.metres()}, {cut.percent()} less",
        judge([cut.is_above(0.38)], cut.is_above(0.0)),
        "holds if the peak falls by 38 %, in part if it falls at all",
        printed="Fig. 9: about 1.3 and 0.8 m, 38 %",
    )


def smaller_peaks_in_wind(found: Experiment) -> Claim:
    """Judge the claim that type 2 has smaller error peaks than type 1 in wind."""
    differences = {
        cell: found.comparison(cell, Cell(cell.wind, "pd_t1fnn"), "peak_error").difference
        for cell in cells_of(_TYPE_2, _IN_WIND)
    }
    low, high = _ends(differences.values())
    return Claim(
        "in wind type 2 has smaller error peaks than type 1",
        f"peaks beside those of type 1: {low.millimetres()} to {high.millimetres()}",
        judge([(-each).is_above(0.0) for each in differences.values()]),
        "holds if all are below zero, in part if some are",
        printed="Figs 10 and 11, one run each",
        details=_listed(differences, Interval.millimetres),
    )


def pd_tends_to_zero(found: Experiment) -> Claim:
    """Judge the claim that the PD's output tends to zero as the network learns, and returns at changes of segment."""
    fades, returns = (
        {cell: _mean(found.recorded[cell][measure]) for cell in cells_of(("pd", "pd_t2fnn"))}
        for measure in ("pd_fade", "pd_return")
    )
    fade, back = (each[Cell("no_wind", "pd_t2fnn")] for each in (fades, returns))
    return Claim(
        "the PD's output tends to zero as the network takes over, and comes back at each change of segment",
        f"without wind the PD's output in the last quarter of a flight is on average {fade.percent()} of that in the"
        f" quarter after the rise, and in the 1 s after a change of segment {back.percent()} of that in the 1 s before",
        judge([(-fade).is_above(-0.5), back.is_above(1.0)]),
        "holds if less than half is left and more comes back, in part if one of the two",
        printed="Figs 12 and 13, one run",
        details=f"left is, {_listed(fades)}; after a change, {_listed(returns)}",
    )


def least_effort(found: Experiment) -> Claim:
    """Judge the claim that the PD costs the least effort."""
    shares = {
        (cell, axis): found.comparison(cell, Cell(cell.wind, "pd"), f"effort_{axis}").share
        for cell in cells_of(_NETWORKS)
        for axis in "xy"
    }
    low, high = _ends(shares.values())
    printed = [share for shares in printed_effort_ratios().values() for share in shares if np.isfinite(share)]
    text = "; ".join(f"{cell.words} on {axis.upper()} {each.ratio()}" for (cell, axis), each in shares.items())
    return Claim(
        "the PD costs the least effort",
        f"{low.ratio()} to {high.ratio()} times the PD's effort",
        judge([each.is_above(1.0) for each in shares.values()]),
        "holds if all are above 1, in part if some are",
        printed=f"Table II: the networks {_span(printed, 1.0, '.1f')} times as much",
        details=text,
    )


def insensitive_to_wind(found: Experiment) -> Claim:
    """Judge the claim that the controllers are insensitive to wind."""
    rises = {
        cell: found.comparison(cell, Cell("no_wind", name)).share.plus(-1.0)
        for name in CONTROLLERS
        for cell in cells_of([name], _IN_WIND)
    }
    return Claim(
        "the controllers are insensitive to wind",
        f"errors rise by {_range(rises.values())}",
        judge(
            [(-each).is_above(-0.02) for each in rises.values()],
            *((-each).is_above(-0.1) for each in rises.values()),
        ),
        "holds if no error rises by 2 %, in part if some rise by less than 10 %",
        printed="Table II, from no wind to high: "
        + "; ".join(f"{CONTROLLERS[name]} {_levels(name)} m" for name in ("pd", "pd_t2fnn")),
        details=_listed(rises),
    )


def straight_against_curved(found: Experiment) -> Claim:
    """Judge the claim that a PD tuned on straight lines is worse on curves, and that one tuned on curves oscillates.

    Gains are chosen on the first half of the samples and compared on the second half.
    """
    straight, curved, swing = found.legs.metrics
    half = len(found.legs.samples) // 2
    # The mean is NaN if a sample crashed, so that gains with a crash are not chosen.
    on_straight, on_curved = (int(np.nanargmin(each[:, :half].mean(axis=1))) for each in (straight, curved))
    worse = ratio_of_means(curved[on_straight, half:], curved[on_curved, half:]).plus(-1.0)
    livelier = ratio_of_means(swing[on_curved, half:], swing[on_straight, half:])
    gains = [
        " and ".join(f"{symbol} = {found.legs.settings[name][best]:.2f}" for name, symbol in _GAINS.items())
        for best in (on_straight, on_curved)
    ]
    return Claim(
        "an aggressive PD tuned on straight lines is worse on curves, one tuned on curves oscillates on straight lines",
        f"best on straight lines are {gains[0]}, on curves {gains[1]}; on other samples the first are {worse.percent()}"
        f" worse on curves, and on straight lines the command of the second moves {livelier.ratio()} times as much",
        judge([worse.is_above(0.0), livelier.is_above(1.0)]),
        "holds if the first are worse on curves and the second move more on straight lines, in part if one of the two",
        printed="words, no numbers",
    )


def circle_of_gains(found: Experiment) -> Claim:
    """Judge the claim that with a network any stabilising gains will do."""
    pd, network = (_mean(as_good(found.maps[name])) for name in MAPPED)
    more = _mean(as_good(found.maps["pd_t2fnn"]) - as_good(found.maps["pd"]))
    typical = [_mean(typical_over_best(found.maps[name])) for name in MAPPED]
    best = [_mean(np.nanmin(_errors(found.maps[name]), axis=0)) for name in MAPPED]
    return Claim(
        "with the network any PD gains that stabilise will do: a circle around the optimal point",
        f"on average over samples, within 20 % of the best error are {pd.percent()} of the gains that stabilise the PD,"
        f" and {network.percent()} of those that stabilise it with the network; half of these gains have more than"
        f" {typical[0].ratio()} times the best error, and {typical[1].ratio()} times with the network; the best errors"
        f" are {best[0].metres()} and {best[1].metres()}",
        judge([more.is_above(0.0), network.is_above(0.5)]),
        "holds if the share grows and is more than half, in part if one of the two",
        printed="words, no numbers",
        details=f"{_box(found.maps['pd'])}; a sample crashes with {_crashing(found.maps['pd'])} of them, and with"
        f" {_crashing(found.maps['pd_t2fnn'])} with the network; the share is {more.percent()} larger with it",
        figure="gains",
    )


def as_good(sweep: Sweep) -> np.ndarray:
    """Return the share (samples,) of the gains without a crash whose error is within 20 % of the best."""
    rmse = _errors(sweep)
    best = np.nanmin(rmse, axis=0)
    shares: np.ndarray = (rmse <= _MAX_ERROR_RATIO * best).sum(axis=0) / np.isfinite(rmse).sum(axis=0)
    return shares


def typical_over_best(sweep: Sweep) -> np.ndarray:
    """Return the ratio (samples,) of the median error to the best error over the gains without a crash."""
    rmse = _errors(sweep)
    return np.asarray(np.nanmedian(rmse, axis=0) / np.nanmin(rmse, axis=0))


def advantage(sweep: Sweep, number: str, value: float, controller: str) -> Interval:
    """Return the relative reduction of a controller's mean error, compared with type 1, for one value of a setting.

    Args:
        sweep: sweep over the setting.
        number: name of the setting.
        value: value of the setting.
        controller: name of a type-2 controller.
    """
    return _cut(_rmse(sweep, number, value, controller), _rmse(sweep, number, value, "pd_t1fnn"))


def printed_effort_ratios() -> dict[Cell, tuple[float, float]]:
    """Return the ratios of each network's printed mean effort to the PD's in the same wind, on X and on Y, by cell.

    A ratio is NaN if one of the two efforts is missing in the paper.
    """
    table = printed_table()
    return {
        cell: (
            line.effort_x.mean / table[Cell(cell.wind, "pd")].effort_x.mean,
            line.effort_y.mean / table[Cell(cell.wind, "pd")].effort_y.mean,
        )
        for cell, line in table.items()
        if cell.controller != "pd"
    }


def _reduction(found: Experiment, cell: Cell, baseline: str, metric: str = "rmse") -> Interval:
    """Return the relative reduction of the mean of a metric, compared with another controller in the same wind."""
    return reduction(found.comparison(cell, Cell(cell.wind, baseline), metric).share)


def _printed_reductions(cells: Iterable[Cell], baseline: str) -> list[float]:
    """Return the relative reductions of the printed mean errors, compared with a controller, where they are printed."""
    means = {cell: line.rmse.mean for cell, line in printed_table().items() if np.isfinite(line.rmse.mean)}
    return [1.0 - means[cell] / means[Cell(cell.wind, baseline)] for cell in cells if cell in means]


def _rmse(sweep: Sweep, number: str, value: float, controller: str) -> np.ndarray:
    """Return the RMSE (samples,) for one value of a setting and the exponents of a controller.

    Args:
        sweep: sweep over the setting.
        number: name of the setting.
        value: value of the setting.
        controller: name of a controller with a network.
    """
    a1, a2 = EXPONENTS[controller]
    chosen = (sweep.settings[number] == value) & (sweep.settings["a1"] == a1) & (sweep.settings["a2"] == a2)
    (place,) = np.flatnonzero(chosen)
    errors: np.ndarray = _errors(sweep)[place]
    return errors


def _advantage(sweep: Sweep, number: str, value: float) -> Interval:
    """Return the relative reduction of the mean error by the better controller of type 2, compared with type 1.

    Args:
        sweep: sweep over the setting.
        number: name of the setting.
        value: value of the setting.
    """
    return max((advantage(sweep, number, value, name) for name in _TYPE_2), key=lambda gain: gain.value)


def _errors(sweep: Sweep) -> np.ndarray:
    """Return the RMSE (settings, samples) of a sweep; NaN for samples that crashed."""
    return np.where(sweep.metrics.crashed, np.nan, sweep.metrics.rmse)


def _cut_at(found: Experiment, wind: str, slope: float) -> Interval:
    """Return the relative reduction of the PD's mean error by PD+T2FNN with a slope λ."""
    sweep = found.slopes[wind]
    (place,) = np.flatnonzero(sweep.settings["slope"] == slope)
    pd = found.cells[Cell(wind, "pd")].metrics
    baseline = np.where(pd.crashed, np.nan, pd.rmse)[sweep.samples]
    return _cut(_errors(sweep)[place], baseline)


def _cut(errors: np.ndarray, baseline: np.ndarray) -> Interval:
    """Return the relative reduction of the mean of errors (samples,), compared with a baseline; crashes are NaN."""
    both = np.isfinite(errors) & np.isfinite(baseline)
    return reduction(ratio_of_means(errors[both], baseline[both]))


def _more_cut(pair: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> Interval:
    """Return the difference between the reductions (`_cut`) of two pairs of baseline and errors."""
    every = np.isfinite([*pair, *other]).all(axis=0)
    ratio, other_ratio = (linearized_ratio(errors[every], baseline[every]) for baseline, errors in (pair, other))
    return mean_interval(other_ratio - ratio)


def _box(sweep: Sweep) -> str:
    """Return the grid of gains of a map as text."""
    k_p, k_d = (np.unique(sweep.settings[name]) for name in _GAINS)
    return (
        f"{len(k_p)} × {len(k_d)} gains, k_P from {k_p[0]:g} to {k_p[-1]:g} 1/s² and k_D from {k_d[0]:g} to {k_d[-1]:g}"
        f" 1/s, in equal ratios, {len(sweep.samples)} samples each"
    )


def _crashing(sweep: Sweep) -> int:
    """Return the number of settings with which a sample crashes."""
    return int(sweep.metrics.crashed.any(axis=1).sum())


def _mean(values: np.ndarray) -> Interval:
    """Return the mean of the finite values; samples that crashed are NaN."""
    return mean_interval(values[np.isfinite(values)])


def _welch(first: str, second: str) -> str:
    """Return the p-value of Welch's test on the printed runs of two controllers in low wind as text."""
    runs = [printed_table()[Cell("low_wind", name)].rmse.runs for name in (first, second)]
    return f"Welch, p = {scipy.stats.ttest_ind(*runs, equal_var=False).pvalue:.2f}"


def _levels(controller: str) -> str:
    """Return the printed mean errors of a controller in all winds as text."""
    means = [
        printed_table()[cell].rmse.mean
        for cell in (Cell(wind, controller) for wind in WINDS)
        if cell in printed_table()
    ]
    return ", ".join("–" if np.isnan(mean) else f"{mean:.3f}" for mean in means)


def _span(values: Sequence[float] | np.ndarray, size: float, form: str) -> str:
    """Return the smallest and the largest value as text.

    Args:
        values: values.
        size: factor by which the values are multiplied.
        form: format of a number.
    """
    return f"{size * min(values):{form}} to {size * max(values):{form}}"


def _listed(numbers: Mapping[Cell, Interval], text: Callable[[Interval], str] = Interval.percent) -> str:
    """Return numbers by cell as text."""
    return "; ".join(f"{cell.words} {text(number)}" for cell, number in numbers.items())


def _ends(estimates: Iterable[Interval]) -> tuple[Interval, Interval]:
    """Return the smallest and the largest estimate."""
    ordered = sorted(estimates)
    return ordered[0], ordered[-1]


def _range(shares: Iterable[Interval]) -> str:
    """Return the smallest and the largest share as text, in per cent."""
    low, high = _ends(shares)
    return f"{low.percent()} to {high.percent()}"
