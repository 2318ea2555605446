"""Claims of the evaluation, with verdicts that follow from intervals of paired comparisons."""

import itertools
from collections.abc import Mapping

import numpy as np

from drake_quad.evaluation.entries import AROUND, MAPPED, entries_of
from drake_quad.evaluation.families import FAMILY_OF
from drake_quad.evaluation.results import (
    LAPS_IN,
    PRICED,
    PRICED_CONTROLLERS,
    PRICED_IN,
    Evaluation,
    Traits,
    in_laps,
)
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.claims import Claim, judge, reduction
from drake_quad.statistics.interval import Interval
from drake_quad.studies.statistics import Comparison, compare, values_without_crashes


class _Words(dict[str, str]):
    """Names of controllers in the report by their names in files; a user's controller has the same name in both."""

    def __missing__(self, name: str) -> str:
        return name


WORDS = _Words({name: entry.words for name, entry in entries_of(on_board=False, maps=True).items()})


def all_claims(found: Evaluation) -> list[Claim]:
    """Return all claims for which there are flights, in the order of the report."""
    networks = [helps(found, f"{name}_t2fnn", name) for name in ("pd", *AROUND)]
    maps = [helps(found, f"{name}_t2fnn_map", name) for name in MAPPED]
    others = [
        less(found, "pd_t2fnn", "pd_t1fnn", "type 2 is better than type 1 around the PD"),
        less(found, "pd_t2fnn_adaptive", "pd_t2fnn", "sets that learn are better than sets that stay, around the PD"),
        less(
            found, "pd_t2fnn_map", "pd_t2fnn", "around the PD, rules over the position are better than over the error"
        ),
    ]
    laps = [learns_in_laps(found, name) for name in MAPPED]
    return [each for each in (*networks, *maps, *others, *laps, price_of_margin(found)) if each is not None]


def effects(found: Evaluation, controller: str, other: str) -> dict[str, Comparison]:
    """Compare two controllers on the same samples in each laboratory in which both were flown.

    Args:
        found: numbers of the evaluation.
        controller: name of the controller.
        other: name of the baseline.

    Returns:
        Comparisons by laboratory.
    """
    return {
        place: beside(found.flights[place][controller], found.flights[place][other])
        for place in FAMILY_OF
        if {controller, other} <= found.flights.get(place, {}).keys()
    }


def beside(metrics: Metrics, baseline: Metrics) -> Comparison:
    """Compare two controllers on the samples that both flew, which are the first samples of each."""
    count = min(len(metrics.rmse), len(baseline.rmse))
    return compare(metrics.take(slice(count)), baseline.take(slice(count)))


def helps(found: Evaluation, network: str, base: str) -> Claim | None:
    """Judge the claim that adding a network to a controller reduces its error; None if there are no flights."""
    kind = "over the position " if network.endswith("map") else ""
    claim = less(found, network, base, f"a network of type 2 {kind}around {WORDS[base]} makes its error smaller")
    return claim and claim._replace(evidence=claim.evidence + _stood(found, network, base))


def _stood(found: Evaluation, network: str, base: str) -> str:
    """Return text that says how a network changes the tolerated delay in each family; empty without flights."""
    both = {name: traits for name, traits in found.traits.items() if {network, base} <= traits.keys()}
    changes = [
        f"{delay_words(traits[base].delay_flown)} to {delay_words(traits[network].delay_flown)} ({name})"
        for name, traits in both.items()
    ]
    return f"; the delay that it stands goes from {', '.join(changes)}" if changes else ""


def less(found: Evaluation, controller: str, other: str, statement: str) -> Claim | None:
    """Judge the claim that a controller has a smaller error than another one and does not crash more often.

    Args:
        found: numbers of the evaluation.
        controller: name of the controller.
        other: name of the baseline.
        statement: statement of the claim.

    Returns:
        The claim; None if there is no laboratory in which both controllers were flown.
    """
    compared = effects(found, controller, other)
    if not compared:
        return None
    cuts = {place: reduction(each.share) for place, each in compared.items()}
    return Claim(
        statement,
        f"RMSE is less by {listed(cuts)}{_crashes(compared)}",
        judge([_smaller(each) for each in compared.values()]),
        "holds if it is so in every laboratory, and no more vehicles crash; in part if in some",
    )


def _smaller(compared: Comparison) -> bool | None:
    """Return whether the error is smaller without significantly more crashes; None if the interval leaves it open."""
    if compared.crashed > compared.baseline_crashed and compared.crash_significance < 0.05:
        return False
    return reduction(compared.share).is_above(0.0)


def learns_in_laps(found: Evaluation, base: str) -> Claim | None:
    """Judge the claim that a network over the position learns a map that reduces the error in later laps.

    Args:
        found: numbers of the evaluation.
        base: name of the controller without the network.

    Returns:
        The claim; None if fewer than two laps were flown.
    """
    network = f"{base}_t2fnn_map"
    flown = laps_flown(found, network)
    if len(flown) < 2:
        return None
    first, last = (found.flights[in_laps(count)] for count in (flown[0], flown[-1]))
    learned, gained = beside(last[network], first[network]), beside(last[network], last[base])
    return Claim(
        f"in laps of {LAPS_IN} a network over the position around {WORDS[base]} learns a map that serves again",
        f"in lap {flown[-1]} its RMSE is less by {reduction(learned.share).percent()} than in lap {flown[0]}, and by"
        f" {reduction(gained.share).percent()} than without the network in the same lap"
        f"{_crashes({'against the first lap': learned, 'against no network': gained})}",
        judge([_smaller(learned), _smaller(gained)]),
        "holds if both are above zero, and no more vehicles crash; in part if one of the two",
    )


def laps_flown(found: Evaluation, controller: str) -> list[int]:
    """Return the numbers of laps with which a controller was flown, from 1 on."""
    return list(itertools.takewhile(lambda n: controller in found.flights.get(in_laps(n), {}), itertools.count(1)))


def price_of_margin(found: Evaluation) -> Claim | None:
    """Judge the claim that a smaller stability margin reduces the error; None if there are no such designs."""
    parts, needed = [], []
    for controller in PRICED_CONTROLLERS:
        designs = priced(found, controller)
        for (_, tight), (_, loose) in itertools.pairwise(designs):
            needed.append(reduction(beside(loose, tight).share).is_above(0.0))
        if len(designs) > 1:
            (first, tight), *_, (last, loose) = designs
            gain = reduction(beside(loose, tight).share).percent()
            parts.append(
                f"with a peak sensitivity of {last.sensitivity:.2f} in place of {first.sensitivity:.2f} the RMSE of"
                f" {WORDS[controller]} is less by {gain}, and the delay that it stands"
                f" goes from {delay_words(first.delay_flown)} to {delay_words(last.delay_flown)}"
            )
    if not parts:
        return None
    return Claim(
        "margin is paid for with error",
        "; ".join(parts),
        judge(needed),
        "holds if every design with less margin errs less than the one before; in part if some do",
    )


def priced(found: Evaluation, controller: str) -> list[tuple[Traits, Metrics]]:
    """Return the designs of a controller in the order of their peak sensitivities, with their flights."""
    own = {name: each for name, each in found.traits.get(PRICED, {}).items() if name.startswith(f"{controller}@")}
    if controller in found.traits.get(FAMILY_OF[PRICED_IN], {}):
        own[controller] = found.traits[FAMILY_OF[PRICED_IN]][controller]
    designs = [(each, found.flights[PRICED_IN][name]) for name, each in own.items()]
    return sorted(designs, key=lambda design: design[0].sensitivity)


def best_in(found: Evaluation, place: str) -> list[str]:
    """Return the controller with the smallest mean RMSE in a laboratory, followed by those that are equally good.

    Controllers that crash in more than 5 % of the samples are excluded, unless all do. A controller is equally good if
    the paired interval does not distinguish its error from the smallest one. Only controllers that flew all samples can
    be the best one.
    """
    flown = {name: each for name, each in found.flights[place].items() if "@" not in name}
    safe = {name: each for name, each in flown.items() if np.mean(each.crashed) <= 0.05} or flown
    most = max(len(each.rmse) for each in safe.values())
    whole = [name for name, each in safe.items() if len(each.rmse) == most]
    best = min(whole, key=lambda name: float(values_without_crashes(safe[name], "rmse").mean()))
    others = [
        name for name in safe if name != best and reduction(beside(safe[name], safe[best]).share).is_above(0.0) is None
    ]
    return [best, *others]


def delay_words(delay: float) -> str:
    """Return a tolerated delay as text; see `Traits.delay_flown`."""
    return (
        "–"
        if np.isnan(delay)
        else "none"
        if delay < 0.0
        else "all tried"
        if np.isinf(delay)
        else f"{1e3 * delay:.0f} ms"
    )


def listed(shares: Mapping[str, Interval]) -> str:
    """Return shares by laboratory as text."""
    return "; ".join(f"{each.percent()} ({place})" for place, each in shares.items())


def _crashes(compared: Mapping[str, Comparison]) -> str:
    """Return the number of samples on which only one of two controllers crashes as text, by laboratory."""
    parts = [
        f"{place}: {each.crashed} samples crash with it alone, {each.baseline_crashed} with the other alone"
        f" (p = {each.crash_significance:.2g})"
        for place, each in compared.items()
        if each.crashed or each.baseline_crashed
    ]
    return "; " + "; ".join(parts) if parts else ""
