"""Estimates of several logs, or by several methods, made into one.

Generalised least squares: of estimates θ_i with covariances C_i it is P⁻¹ Σ C_i⁻¹ θ_i, with covariance P⁻¹ and
P = Σ C_i⁻¹. Of a single number that several give, this is the mean weighted by inverse variances. What only one gives
stays as it is, unless it is correlated with something that others give, too.

Logs may disagree by more than their errors: a battery was another, or a model lacks something. Then errors are made
larger by R. T. Birge's ratio √(χ² / ν) ("The calculation of errors by the method of least squares", Physical Review 40,
1932), for each number and then for all together, and the degrees of freedom are those of the disagreement.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, listed
from drake_quad.identification.results.estimates import Estimates, Source, kind_of

# Of agreement: estimates of the same number that would differ as much in fewer cases are said to disagree.
SIGNIFICANT = 0.05
# Of the unit diagonal of a correlation matrix, so that one of estimates that determine each other can be inverted.
_RIDGE = 1e-10


class _Given(NamedTuple):
    """One estimate of a number: in which of the records, and where in that."""

    record: int
    place: int


def merged(records: Sequence[Estimates]) -> Estimates:
    """Makes one of several records of estimates.

    Records are taken for independent of each other. Those of one log are not: of a number that several methods find in
    the same log, the surest estimate counts. Where several estimates of a number disagree (χ² at 5 %), errors grow
    until they do not, and a remark says so.

    Args:
        records: at least one.

    Raises:
        InputError: there is none.
    """
    if not records:
        raise InputError("there are no estimates to merge")
    records, remarks = _of_different_logs(records)
    names = list(dict.fromkeys(name for record in records for name in record.names))
    given = {name: _given(records, name) for name in names}
    ratios, disagreements = _ratios(records, given)
    remarks += disagreements
    inflated = [_inflated(record, ratios) for record in records]
    values, covariance, misfit = _least_squares(inflated, names)
    freedom = np.array([_freedom(inflated, given[name]) for name in names])
    freedom = np.where([ratios[name] > 1.0 for name in names], np.minimum(freedom, _surplus(given, names)), freedom)
    surplus = sum(len(each) - 1 for each in given.values())
    if surplus and scipy.stats.chi2.sf(misfit, surplus) < SIGNIFICANT:
        ratio = misfit / surplus
        several = [len(given[name]) > 1 for name in names]
        covariance = covariance * ratio
        freedom = np.where(several, np.minimum(freedom, surplus), freedom)
        remarks.append(
            f"together, the estimates of {listed([*itertools.compress(names, several)])} disagree (χ² ="
            f" {misfit:.3g} with {surplus} degrees of freedom): all deviations are {np.sqrt(ratio):.3g} times as large"
        )
    surest = {name: min(given[name], key=lambda each: records[each.record].deviations[each.place]) for name in names}
    return Estimates(
        tuple(names),
        values,
        covariance,
        freedom,
        tuple(_sources(records, given[name]) for name in names),
        explained={
            name: records[each.record].explained[name]
            for name, each in surest.items()
            if name in records[each.record].explained
        },
        not_seen={name: why for record in reversed(records) for name, why in record.not_seen.items()},
        remarks=tuple(dict.fromkeys([*(remark for record in records for remark in record.remarks), *remarks])),
    )


def _given(records: Sequence[Estimates], name: str) -> list[_Given]:
    return [_Given(i, record.names.index(name)) for i, record in enumerate(records) if name in record.names]


def _sources(records: Sequence[Estimates], given: Sequence[_Given]) -> tuple[Source, ...]:
    return tuple(dict.fromkeys(source for i, place in given for source in records[i].sources_of(place)))


def _of_different_logs(records: Sequence[Estimates]) -> tuple[list[Estimates], list[str]]:
    """The records without estimates of numbers that the same log gives more surely, and sentences that say so."""
    left_out: list[set[str]] = [set() for _ in records]
    remarks = []
    for name in dict.fromkeys(name for record in records for name in record.names):
        taken: dict[str, Source] = {}
        for i, place in sorted(_given(records, name), key=lambda each: records[each.record].deviations[each.place]):
            sources = records[i].sources_of(place)
            known = next((taken[source.log] for source in sources if source.log in taken), None)
            if known is None:
                taken.update({source.log: source for source in sources})
                continue
            left_out[i].add(name)
            value, deviation = records[i].values[place], records[i].deviations[place]
            remarks.append(
                f"{name} is {value:.4g} ± {deviation:.2g} {kind_of(name).unit} by {sources[0].method} too, which does"
                f" not count beside {known.method}: it is of the same log, {known.log}"
            )
    kept = [
        record.part([name for name in record.names if name not in gone]) if gone else record
        for record, gone in zip(records, left_out, strict=True)
    ]
    return kept, remarks


def _ratios(records: Sequence[Estimates], given: dict[str, list[_Given]]) -> tuple[dict[str, float], list[str]]:
    """By what each number's variance grows so that its estimates agree, and a sentence for each that did not."""
    ratios, remarks = {}, []
    for name, all_given in given.items():
        ratios[name] = 1.0
        values = np.array([records[i].values[place] for i, place in all_given])
        deviations = np.array([records[i].deviations[place] for i, place in all_given])
        surplus = len(values) - 1
        misfit = float(np.sum(((values - np.average(values, weights=deviations**-2)) / deviations) ** 2))
        if surplus and scipy.stats.chi2.sf(misfit, surplus) < SIGNIFICANT:
            ratios[name] = misfit / surplus
            said = [f"{value:.4g} ± {deviation:.2g}" for value, deviation in zip(values, deviations, strict=True)]
            remarks.append(
                f"estimates of {name} disagree: {listed(said)} {kind_of(name).unit} (χ² = {misfit:.3g} with {surplus}"
                f" degrees of freedom); deviations are {np.sqrt(ratios[name]):.3g} times as large"
            )
    return ratios, remarks


def _inflated(record: Estimates, ratios: dict[str, float]) -> Estimates:
    factors = np.sqrt([ratios[name] for name in record.names])
    return replace(record, covariance=record.covariance * np.outer(factors, factors))


def _least_squares(records: Sequence[Estimates], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, float]:
    """Values and covariance of all numbers, and the χ² of all estimates about them."""
    scale = np.zeros(len(names))
    places = [[names.index(name) for name in record.names] for record in records]
    for record, own in zip(records, places, strict=True):
        scale[own] = np.maximum(scale[own], record.deviations)
    precision, weighted = np.zeros((len(names), len(names))), np.zeros(len(names))
    inverses = []
    for record, own in zip(records, places, strict=True):
        covariance = record.covariance / np.outer(record.deviations, record.deviations)
        relative = scale[own] / record.deviations
        inverse = np.linalg.inv(covariance + _RIDGE * np.eye(len(own))) * np.outer(relative, relative)
        inverses.append(inverse)
        precision[np.ix_(own, own)] += inverse
        weighted[own] += inverse @ (record.values / scale[own])
    covariance = np.linalg.inv(precision)
    values = covariance @ weighted
    rests = [record.values / scale[own] - values[own] for record, own in zip(records, places, strict=True)]
    misfit = sum(float(rest @ inverse @ rest) for rest, inverse in zip(rests, inverses, strict=True))
    return values * scale, covariance * np.outer(scale, scale), misfit


def _freedom(records: Sequence[Estimates], given: Sequence[_Given]) -> float:
    """Degrees of freedom of a weighted mean, after B. L. Welch and F. E. Satterthwaite."""
    weights = np.array([records[i].deviations[place] ** -2 for i, place in given])
    own = np.array([np.asarray(records[i].degrees_of_freedom)[place] for i, place in given])
    total = float(np.sum((weights / weights.sum()) ** 2 / own))
    return 1.0 / total if total else np.inf


def _surplus(given: dict[str, list[_Given]], names: Sequence[str]) -> np.ndarray:
    return np.array([max(len(given[name]) - 1, 1) for name in names])
