"""Claims about the evaluated controllers, with verdicts from the confidence intervals of paired comparisons."""

import itertools
from collections.abc import Mapping

import numpy as np

from drake_quad.evaluation.entries import NETWORK_BASES, POSITION_NETWORK_BASES, controller_entries
from drake_quad.evaluation.families import FAMILY_OF
from drake_quad.evaluation.results import (
    LAPS_LABORATORY,
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANT_LABORATORY,
    SENSITIVITY_VARIANTS,
    Evaluation,
    Traits,
    laboratory_with_laps,
)
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.claims import Claim, reduction, verdict_from_conditions
from drake_quad.statistics.interval import Interval
from drake_quad.studies.statistics import Comparison, compare, values_without_crashes


class _ControllerNames(dict[str, str]):
    """Name of each controller in the report, by its name in files. A user's controller has the same name in both."""

    def __missing__(self, name: str) -> str:
        return name


CONTROLLER_NAMES = _ControllerNames(
    {name: entry.label for name, entry in controller_entries(on_board=False, position_networks=True).items()}
)


def all_claims(evaluation: Evaluation) -> list[Claim]:
    """Return all claims whose controllers were flown, in the order of the report."""
    networks = [judge_network(evaluation, f"{name}_t2fnn", name) for name in ("pd", *NETWORK_BASES)]
    maps = [judge_network(evaluation, f"{name}_t2fnn_map", name) for name in POSITION_NETWORK_BASES]
    others = [
        judge_smaller_error(
            evaluation,
            "pd_t2fnn",
            "pd_t1fnn",
            "with the PD, a type-2 network has a smaller error than a type-1 network",
        ),
        judge_smaller_error(
            evaluation,
            "pd_t2fnn_adaptive",
            "pd_t2fnn",
            "with the PD, a type-2 network with adaptive sets has a smaller error than one with fixed sets",
        ),
        judge_smaller_error(
            evaluation,
            "pd_t2fnn_map",
            "pd_t2fnn",
            "with the PD, a type-2 network with the position as input has a smaller error than one with the tracking"
            " error",
        ),
    ]
    laps = [judge_learning_in_laps(evaluation, name) for name in POSITION_NETWORK_BASES]
    return [each for each in (*networks, *maps, *others, *laps, judge_price_of_margin(evaluation)) if each is not None]


def comparisons_by_laboratory(evaluation: Evaluation, controller: str, other: str) -> dict[str, Comparison]:
    """Compare two controllers on the same samples in each laboratory in which both were flown.

    Args:
        evaluation: results of all controllers.
        controller: name of the controller.
        other: name of the controller to compare with.

    Returns:
        Comparisons by laboratory.
    """
    return {
        laboratory: compare_common_samples(
            evaluation.flights[laboratory][controller], evaluation.flights[laboratory][other]
        )
        for laboratory in FAMILY_OF
        if {controller, other} <= evaluation.flights.get(laboratory, {}).keys()
    }


def compare_common_samples(metrics: Metrics, baseline: Metrics) -> Comparison:
    """Compare two controllers on the samples that both have flown, which are the first samples of each."""
    count = min(len(metrics.rmse), len(baseline.rmse))
    return compare(metrics.take(slice(count)), baseline.take(slice(count)))


def judge_network(evaluation: Evaluation, network: str, base: str) -> Claim | None:
    """Judge the claim that adding a network to a controller reduces the error; None if there are no flights."""
    kind = " with the position as input" if network.endswith("map") else ""
    statement = f"adding a type-2 network{kind} to {CONTROLLER_NAMES[base]} reduces the error"
    claim = judge_smaller_error(evaluation, network, base, statement)
    return claim and claim._replace(evidence=claim.evidence + _tolerated_delays_text(evaluation, network, base))


def _tolerated_delays_text(evaluation: Evaluation, network: str, base: str) -> str:
    """Return a text on how adding a network to a controller changes the tolerated delay in each family.

    The text is empty if no family contains results of both controllers.
    """
    both = {name: traits for name, traits in evaluation.traits.items() if {network, base} <= traits.keys()}
    changes = [
        f"{delay_text(traits[base].delay_flown)} to {delay_text(traits[network].delay_flown)} ({name})"
        for name, traits in both.items()
    ]
    return f"; the tolerated delay changes from {', '.join(changes)}" if changes else ""


def judge_smaller_error(evaluation: Evaluation, controller: str, other: str, statement: str) -> Claim | None:
    """Judge the claim that a controller has a smaller error than another controller and does not crash more often.

    Args:
        evaluation: results of all controllers.
        controller: name of the controller.
        other: name of the controller to compare with.
        statement: text of the claim.

    Returns:
        The claim; None if there is no laboratory in which both controllers were flown.
    """
    compared = comparisons_by_laboratory(evaluation, controller, other)
    if not compared:
        return None
    reductions = {laboratory: reduction(each.ratio) for laboratory, each in compared.items()}
    return Claim(
        statement,
        f"reduction of the RMSE: {proportions_text(reductions)}{_crash_text(compared)}",
        verdict_from_conditions([_is_error_smaller(each) for each in compared.values()]),
        "holds if the error is smaller, without more crashes, in every laboratory; holds in part if this is true in at"
        " least one",
    )


def _is_error_smaller(comparison: Comparison) -> bool | None:
    """Return True if the error is smaller without significantly more crashes; None if the interval is inconclusive."""
    if comparison.crashed > comparison.baseline_crashed and comparison.crash_significance < 0.05:
        return False
    return reduction(comparison.ratio).is_above(0.0)


def judge_learning_in_laps(evaluation: Evaluation, base: str) -> Claim | None:
    """Judge the claim that a network with the position as input learns, over several laps, to reduce the error.

    Args:
        evaluation: results of all controllers.
        base: name of the controller without the network.

    Returns:
        The claim; None if fewer than two laps were flown.
    """
    network = f"{base}_t2fnn_map"
    counts = lap_counts(evaluation, network)
    if len(counts) < 2:
        return None
    first, last = (evaluation.flights[laboratory_with_laps(count)] for count in (counts[0], counts[-1]))
    learned, gained = (
        compare_common_samples(last[network], first[network]),
        compare_common_samples(last[network], last[base]),
    )
    return Claim(
        f"over several laps in {LAPS_LABORATORY}, a network with the position as input that is added to"
        f" {CONTROLLER_NAMES[base]} learns to reduce the error",
        f"in lap {counts[-1]} its RMSE is smaller by {reduction(learned.ratio).percent()} than in lap {counts[0]}, and"
        f" by {reduction(gained.ratio).percent()} than without the network in the same lap"
        f"{_crash_text({'compared with the first lap': learned, 'compared with no network': gained})}",
        verdict_from_conditions([_is_error_smaller(learned), _is_error_smaller(gained)]),
        "holds if both reductions are above zero, without more crashes; holds in part if one of them is",
    )


def lap_counts(evaluation: Evaluation, controller: str) -> list[int]:
    """Return the numbers of laps (1, 2, ...) with which a controller was flown."""
    return list(
        itertools.takewhile(
            lambda n: controller in evaluation.flights.get(laboratory_with_laps(n), {}), itertools.count(1)
        )
    )


def judge_price_of_margin(evaluation: Evaluation) -> Claim | None:
    """Judge the claim that a smaller stability margin reduces the error; None if no controller has several designs."""
    parts, conditions = [], []
    for controller in SENSITIVITY_VARIANT_CONTROLLERS:
        designs = designs_by_sensitivity(evaluation, controller)
        for (_, tight), (_, loose) in itertools.pairwise(designs):
            conditions.append(reduction(compare_common_samples(loose, tight).ratio).is_above(0.0))
        if len(designs) > 1:
            (first, tight), *_, (last, loose) = designs
            gain = reduction(compare_common_samples(loose, tight).ratio).percent()
            parts.append(
                f"with a peak sensitivity of {last.sensitivity:.2f} instead of {first.sensitivity:.2f}, the RMSE of"
                f" {CONTROLLER_NAMES[controller]} is smaller by {gain}, and the tolerated delay"
                f" changes from {delay_text(first.delay_flown)} to {delay_text(last.delay_flown)}"
            )
    if not parts:
        return None
    return Claim(
        "a larger stability margin costs accuracy",
        "; ".join(parts),
        verdict_from_conditions(conditions),
        "holds if every design has a smaller error than the design with the next larger margin; holds in part if at"
        " least one has",
    )


def designs_by_sensitivity(evaluation: Evaluation, controller: str) -> list[tuple[Traits, Metrics]]:
    """Return the designs of a controller and their flights, sorted by peak sensitivity."""
    traits = {
        name: each
        for name, each in evaluation.traits.get(SENSITIVITY_VARIANTS, {}).items()
        if name.startswith(f"{controller}@")
    }
    if controller in evaluation.traits.get(FAMILY_OF[SENSITIVITY_VARIANT_LABORATORY], {}):
        traits[controller] = evaluation.traits[FAMILY_OF[SENSITIVITY_VARIANT_LABORATORY]][controller]
    designs = [(each, evaluation.flights[SENSITIVITY_VARIANT_LABORATORY][name]) for name, each in traits.items()]
    return sorted(designs, key=lambda design: design[0].sensitivity)


def best_controllers(evaluation: Evaluation, laboratory: str) -> list[str]:
    """Return the controller with the smallest mean RMSE in a laboratory, followed by the equally good controllers.

    Controllers that crash in more than 5 % of the samples are excluded, unless all controllers do. A controller counts
    as equally good if the paired comparison shows no significant difference between its error and the smallest one. The
    best controller is selected from the controllers that flew all samples.
    """
    results = {name: each for name, each in evaluation.flights[laboratory].items() if "@" not in name}
    safe = {name: each for name, each in results.items() if np.mean(each.crashed) <= 0.05} or results
    num_samples = max(len(each.rmse) for each in safe.values())
    candidates = [name for name, each in safe.items() if len(each.rmse) == num_samples]
    best = min(candidates, key=lambda name: float(values_without_crashes(safe[name], "rmse").mean()))
    others = [
        name
        for name in safe
        if name != best and reduction(compare_common_samples(safe[name], safe[best]).ratio).is_above(0.0) is None
    ]
    return [best, *others]


def delay_text(delay: float) -> str:
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


def proportions_text(fractions: Mapping[str, Interval]) -> str:
    """Return, as text, a fraction for each laboratory."""
    return "; ".join(f"{each.percent()} ({laboratory})" for laboratory, each in fractions.items())


def _crash_text(comparisons: Mapping[str, Comparison]) -> str:
    """Return, as text, the number of samples in each laboratory on which only one of two controllers crashes."""
    parts = [
        f"{laboratory}: {each.crashed} samples crash only in this case, {each.baseline_crashed} only in the compared"
        f" case (p = {each.crash_significance:.2g})"
        for laboratory, each in comparisons.items()
        if each.crashed or each.baseline_crashed
    ]
    return "; " + "; ".join(parts) if parts else ""
