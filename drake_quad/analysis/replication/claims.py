"""What the paper claims, what its print says for it, what ours says, and a verdict with the interval behind it."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from drake_quad.analysis.monte_carlo.statistics import Comparison, Interval, compare, mean_interval
from drake_quad.analysis.replication.experiment import Experiment
from drake_quad.analysis.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.analysis.replication.sweeps import EXPONENTS, NOISE, SHARES, Sweep
from drake_quad.flight import Flight

Verdict = Literal["holds", "holds in part", "does not hold", "cannot be decided"]
_NETWORKS = ("pd_t1fnn", "pd_t2fnn", "pd_t2fnn_wide")
# Of the best error: within that, gains are called as good.
_AS_GOOD = 1.2


class Claim(NamedTuple):
    """A claim of the paper.

    Attributes:
        words: what is claimed.
        printed: the evidence that the paper prints.
        ours: what the replication finds, with 95 % intervals.
        verdict: on it.
        why: the rule by which the verdict follows.
    """

    words: str
    printed: str
    ours: str
    verdict: Verdict
    why: str


def all_claims(found: Experiment) -> list[Claim]:
    """Every claim, in the order of the report."""
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


def beside_pd(found: Experiment, wind: str, controller: str, metric: str = "rmse") -> Comparison:
    """A controller beside the PD in the same wind."""
    return compare(found.cells[Cell(wind, controller)], found.cells[Cell(wind, "pd")], metric)


def reduction(found: Experiment, wind: str, controller: str, metric: str = "rmse") -> Interval:
    """By which share a controller makes a metric of the PD smaller."""
    share = beside_pd(found, wind, controller, metric).share
    return Interval(1.0 - share.value, 1.0 - share.high, 1.0 - share.low)


def half_the_error(found: Experiment) -> Claim:
    """Type 2 is 50 % better than PD."""
    cuts = {
        (wind, controller): reduction(found, wind, controller)
        for wind in WINDS
        for controller in ("pd_t2fnn", "pd_t2fnn_wide")
    }
    return Claim(
        "PD+T2FNN is 50 % better than PD",
        "Table II: 42 to 48 %, and no cell reaches 50",
        _listed(cuts),
        _all_or_some([cut.low >= 0.5 for cut in cuts.values()], [cut.high >= 0.5 for cut in cuts.values()]),
        "holds if every interval lies above 50 %, in part if one reaches it",
    )


def reduction_without_wind(found: Experiment) -> Claim:
    """The error without wind is about 43 % smaller."""
    cut = reduction(found, "no_wind", "pd_t2fnn")
    other = {("no_wind", name): reduction(found, "no_wind", name) for name in ("pd_t1fnn", "pd_t2fnn_wide")}
    return Claim(
        "without wind the error is about 43 % smaller",
        "Table II: 0.972 and 0.547 m, 44 %",
        f"{percent(cut)}, fitted; not fitted: {_listed(other)}",
        "cannot be decided",
        "the numbers were fitted to these two cells",
    )


def type_2_beats_type_1(found: Experiment) -> Claim:
    """Type 2 beats type 1 by 2 to 7 %."""
    gains = {}
    for wind in WINDS:
        for controller in ("pd_t2fnn", "pd_t2fnn_wide"):
            share = compare(found.cells[Cell(wind, controller)], found.cells[Cell(wind, "pd_t1fnn")]).share
            gains[wind, controller] = Interval(1.0 - share.value, 1.0 - share.high, 1.0 - share.low)
    over_noise = [_advantage(found.noise, "noise", level) for level in NOISE]
    over_q = [_advantage(found.shares, "q", share) for share in SHARES]
    windy = [gain for (wind, _), gain in gains.items() if wind != "no_wind"]
    best = max((*over_noise, *over_q), key=lambda gain: gain.value)
    return Claim(
        "type 2 beats type 1 by 2 to 7 %",
        "Table II in wind: 5 to 7 %, of three runs each, which is not significant (Welch, p ≈ 0.35)",
        f"{_listed(gains)}; with noise from none to 20 mm {_range(over_noise)}; with q from 0 to 1 {_range(over_q)}",
        _all_or_some([gain.low >= 0.02 for gain in windy], [gain.high >= 0.02 for gain in [*windy, best]]),
        "holds if every interval in wind lies above 2 %, in part if one reaches it, also at other noise or q",
    )


def wider_under_noise(found: Experiment) -> Claim:
    """More noise favours wider membership functions."""
    gains = []
    for level in NOISE:
        narrow, wide = (_rmse(found.noise, "noise", level, name) for name in ("pd_t2fnn", "pd_t2fnn_wide"))
        gains.append(mean_interval(1.0 - wide / narrow))
    narrow, wide = (
        _rmse(found.noise, "noise", NOISE[-1], name) / _rmse(found.noise, "noise", NOISE[0], name)
        for name in ("pd_t2fnn", "pd_t2fnn_wide")
    )
    trend = mean_interval(narrow - wide)
    text = ", ".join(f"{1e3 * level:g} mm {percent(gain)}" for level, gain in zip(NOISE, gains, strict=True))
    return Claim(
        "more noise favours wider membership functions",
        "Table II: 0.507 and 0.505 m in low wind, which is not significant (p ≈ 0.9); its noise is not varied",
        f"the wider sets are better by: {text}; from none to 20 mm they gain {percent(trend)} on the narrower",
        "holds" if gains[-1].low > 0.0 and trend.low > 0.0 else "holds in part" if trend.low > 0.0 else "does not hold",
        "holds if the wider sets gain with noise and are better at 20 mm, in part if they only gain",
    )


def peak_without_wind(found: Experiment) -> Claim:
    """The peak falls from 1.3 to 0.8 m."""
    pd, network = (mean_interval(found.cells[Cell("no_wind", name)].metrics.peak_error) for name in ("pd", "pd_t2fnn"))
    cut = reduction(found, "no_wind", "pd_t2fnn", "peak_error")
    return Claim(
        "without wind the peak error falls from 1.3 to 0.8 m",
        "Fig. 9: about 1.3 and 0.8 m, 38 %",
        f"{metres(pd)} and {metres(network)}, {percent(cut)} less",
        "holds" if cut.high >= 0.38 else "holds in part" if cut.low > 0.0 else "does not hold",
        "holds if the interval reaches 38 %, in part if the peak falls at all",
    )


def smaller_peaks_in_wind(found: Experiment) -> Claim:
    """Type 2 has smaller peaks than type 1 in wind."""
    differences = {
        (wind, name): compare(
            found.cells[Cell(wind, name)], found.cells[Cell(wind, "pd_t1fnn")], "peak_error"
        ).difference
        for wind in ("low_wind", "high_wind")
        for name in ("pd_t2fnn", "pd_t2fnn_wide")
    }
    text = "; ".join(
        f"{WINDS[wind]}, {CONTROLLERS[name]} {1e3 * each.value:+.1f} mm [{1e3 * each.low:+.1f}, {1e3 * each.high:+.1f}]"
        for (wind, name), each in differences.items()
    )
    return Claim(
        "in wind type 2 has smaller error peaks than type 1",
        "Figs 10 and 11, one run each",
        f"peaks beside those of type 1: {text}",
        _all_or_some(
            [each.high < 0.0 for each in differences.values()], [each.low < 0.0 for each in differences.values()]
        ),
        "holds if every interval lies below zero, in part if one reaches below it",
    )


def pd_tends_to_zero(found: Experiment) -> Claim:
    """The PD's output tends to zero as the network takes over, and comes back at each change of segment."""
    flights = [flight for wind in WINDS for flight in found.flights[Cell(wind, "pd_t2fnn")]]
    fade = mean_interval(np.array([_late_over_early(flight) for flight in flights]))
    back = mean_interval(np.array([_after_over_before(flight) for flight in flights]))
    return Claim(
        "the PD's output tends to zero as the network takes over, and comes back at each change of segment",
        "Figs 12 and 13, one run",
        f"the PD's output in the last quarter of a flight is {percent(fade)} of that in the first, and in the second"
        f" after a change of segment {percent(back)} of that in the second before",
        "holds"
        if fade.high < 0.5 and back.low > 1.0
        else "holds in part"
        if fade.high < 1.0 or back.low > 1.0
        else "does not hold",
        "holds if less than half is left and more comes back, in part if one of the two",
    )


def least_effort(found: Experiment) -> Claim:
    """The PD costs the least effort."""
    shares = {
        (wind, name, axis): beside_pd(found, wind, name, f"effort_{axis}").share
        for wind in WINDS
        for name in _NETWORKS
        for axis in "xy"
    }
    text = "; ".join(
        f"{WINDS[wind]}, {CONTROLLERS[name]} on {axis.upper()} {ratio(each)}"
        for (wind, name, axis), each in shares.items()
    )
    return Claim(
        "the PD costs the least effort",
        "Table II: the networks 1.3 to 3.4 times as much",
        f"times the PD's effort: {text}",
        _all_or_some([each.low > 1.0 for each in shares.values()], [each.high > 1.0 for each in shares.values()]),
        "holds if every interval lies above 1, in part if one reaches above it",
    )


def insensitive_to_wind(found: Experiment) -> Claim:
    """The error does not rise in wind."""
    rises = {}
    for name in CONTROLLERS:
        for wind in ("low_wind", "high_wind"):
            share = compare(found.cells[Cell(wind, name)], found.cells[Cell("no_wind", name)]).share
            rises[wind, name] = Interval(share.value - 1.0, share.low - 1.0, share.high - 1.0)
    return Claim(
        "the controllers are insensitive to wind",
        "Table II: PD 0.972, 0.970 and 0.954 m, PD+T2FNN 0.547, 0.505 to 0.507 and 0.526 m",
        f"beside no wind: {_listed(rises)}",
        _all_or_some([abs(each.high) < 0.02 for each in rises.values()], [each.high < 0.1 for each in rises.values()]),
        "holds if no error rises by 2 %, in part if some rise by less than 10 %",
    )


def straight_against_curved(found: Experiment) -> Claim:
    """A PD tuned on straight lines is worse on curves, and one tuned on curves oscillates on straight lines."""
    legs = found.legs
    curved = mean_interval(legs.errors.curved[0] / legs.errors.curved[1] - 1.0)
    swing = mean_interval(legs.errors.swing[1] / legs.errors.swing[0] - 1.0)
    gains = [f"k_P = {k_p:.2f}, k_D = {k_d:.2f}" for k_p, k_d in zip(legs.k_p, legs.k_d, strict=True)]
    return Claim(
        "an aggressive PD tuned on straight lines is worse on curves, one tuned on curves oscillates on straight lines",
        "words, no numbers",
        f"best on straight lines: {gains[0]}, on curves: {gains[1]}; the first is {percent(curved)} worse on curves;"
        f" the second's command moves {percent(swing)} more on straight lines",
        _all_or_some([curved.low > 0.0, swing.low > 0.0], [curved.low > 0.0, swing.low > 0.0]),
        "holds if both intervals lie above zero, in part if one does",
    )


def circle_of_gains(found: Experiment) -> Claim:
    """With a network any gains that stabilise will do."""
    pd, network = (mean_interval(as_good(found.maps[name])) for name in ("pd", "pd_t2fnn"))
    more = mean_interval(as_good(found.maps["pd_t2fnn"]) - as_good(found.maps["pd"]))
    return Claim(
        "with the network any PD gains that stabilise will do: a circle around the optimal point",
        "words, no numbers",
        f"within 20 % of the best error are {percent(pd)} of the gains that stabilise the PD, and {percent(network)} of"
        f" those that stabilise it with the network; difference {percent(more)}",
        "holds" if more.low > 0.0 and network.low > 0.5 else "holds in part" if more.low > 0.0 else "does not hold",
        "holds if the share grows and is more than half, in part if it only grows",
    )


def as_good(sweep: Sweep) -> np.ndarray:
    """(samples,) share of the gains without a crash whose error is within 20 % of the best."""
    rmse = np.where(sweep.metrics.crashed, np.nan, sweep.metrics.rmse)
    best = np.nanmin(rmse, axis=0)
    shares: np.ndarray = (rmse <= _AS_GOOD * best).sum(axis=0) / np.isfinite(rmse).sum(axis=0)
    return shares


def _rmse(sweep: Sweep, number: str, value: float, controller: str) -> np.ndarray:
    """(samples,) RMSE with a value of a number and a controller's exponents."""
    a1, a2 = EXPONENTS[controller]
    chosen = (sweep.settings[number] == value) & (sweep.settings["a1"] == a1) & (sweep.settings["a2"] == a2)
    (place,) = np.flatnonzero(chosen)
    return np.where(sweep.metrics.crashed[place], np.nan, sweep.metrics.rmse[place])


def _advantage(sweep: Sweep, number: str, value: float) -> Interval:
    """By which share type 2 is better than type 1, with the exponents that are better."""
    gains = (
        mean_interval(1.0 - _rmse(sweep, number, value, name) / _rmse(sweep, number, value, "pd_t1fnn"))
        for name in ("pd_t2fnn", "pd_t2fnn_wide")
    )
    return max(gains, key=lambda gain: gain.value)


def _late_over_early(flight: Flight) -> float:
    """Root mean square of the PD's horizontal output in the last quarter of a flight over that in the first."""
    squared = np.sum(flight["pd"][:, 0:2] ** 2, axis=1)
    quarter = len(squared) // 4
    return float(np.sqrt(squared[-quarter:].mean() / squared[:quarter].mean()))


def _after_over_before(flight: Flight) -> float:
    """The same in the second after the changes of segment over that in the second before."""
    squared = np.sum(flight["pd"][:, 0:2] ** 2, axis=1)
    changes = flight.plan.leg_times[2:]
    after, before = (
        np.any([(flight.time >= t + first) & (flight.time < t + first + 1.0) for t in changes], axis=0)
        for first in (0.0, -1.0)
    )
    return float(np.sqrt(squared[after].mean() / squared[before].mean()))


def _all_or_some(every: Sequence[bool], some: Sequence[bool]) -> Verdict:
    return "holds" if all(every) else "holds in part" if any(some) else "does not hold"


def _listed(shares: dict[tuple[str, str], Interval]) -> str:
    return "; ".join(f"{WINDS[wind]}, {CONTROLLERS[name]} {percent(each)}" for (wind, name), each in shares.items())


def _range(shares: Sequence[Interval]) -> str:
    low, high = min(shares, key=lambda each: each.value), max(shares, key=lambda each: each.value)
    return f"{percent(low)} to {percent(high)}"


def percent(share: Interval) -> str:
    """A share with its interval, in per cent."""
    return f"{100.0 * share.value:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}]"


def metres(length: Interval) -> str:
    """A length with its interval."""
    return f"{length.value:.3f} m [{length.low:.3f}, {length.high:.3f}]"


def ratio(share: Interval) -> str:
    """A ratio with its interval."""
    return f"{share.value:.2f} [{share.low:.2f}, {share.high:.2f}]"
