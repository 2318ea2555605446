"""Tuning under a limit on the scale of all random parameters up to which hover is certified to be stable.

A certificate takes a minute, which is too long for each candidate of a search. The search therefore computes exact
loops along a few critical directions of the parameters. They bound the scale of a candidate from above. The result of a
search is certified. If its certified scale is below the limit, the direction of its unstable loop becomes another
critical direction, and the search is repeated.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.design.certificate import GAP_GOAL, Certificate, certify_hover
from drake_quad.design.tuning import Budget, Knob, TuningResult, tune, with_numbers
from drake_quad.design.uncertain_hover import Failure, UncertainHover
from drake_quad.linear.fractional_model import spectral_radii
from drake_quad.linear.hover_fleet import HoverFleet
from drake_quad.process_settings import single_threaded_blas
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.models import Scenario

_NUM_FIRST_DIRECTIONS = 8  # critical directions of the first search
_NUM_CORNERS = 64  # corners of the box from which they are chosen
_MAX_SEARCHES = 4
# Scales at which the loops along a direction are computed, relative to the limit; between them, the spectral radius is
# interpolated.
_GRID = np.array([0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5])


class CertifiedTuning(NamedTuple):
    """Tuned parameters with their certificate.

    Attributes:
        result: result of the last search.
        certificate: certificate of the tuned loop.
        num_searches: number of searches.
    """

    result: TuningResult
    certificate: Certificate
    num_searches: int


def tune_certified(
    scenario: Scenario,
    knobs: Sequence[Knob],
    limit_fractions: Callable[[Scenario], np.ndarray],
    scale: float,
    *,
    budget: Budget = Budget(),
) -> CertifiedTuning:
    """Tune the parameters of a controller so that hover is certified up to a scale of the random parameters.

    Args:
        scenario: scenario with distributions and the controller.
        knobs: parameters to tune, with their ranges.
        limit_fractions: function that returns how well the loops of a scenario meet other limits, as in `tune`.
        scale: smallest certified scale.
        budget: budget of each search.

    Returns:
        The first result whose certificate meets the limit, or else the result with the largest certified scale.

    Raises:
        InputError: under the conditions of `certify_hover`.
    """
    limit = ScaleLimit(scenario, scale)

    def all_fractions(candidate: Scenario) -> np.ndarray:
        fractions = limit_fractions(candidate)
        return np.append(fractions, limit.fraction(candidate)) if fractions.all() else fractions

    found: list[CertifiedTuning] = []
    while len(found) < _MAX_SEARCHES:
        result = tune([scenario], knobs, all_fractions, budget=budget)
        certificate = certify_hover(with_numbers(scenario, knobs, result.values))
        found.append(CertifiedTuning(result, certificate, len(found) + 1))
        if certificate.stable_scale >= scale:
            return found[-1]
        for failure in (certificate.unstable, certificate.lost):
            if failure.values:
                limit.add(failure)
    return max(found, key=lambda each: each.certificate.stable_scale)


class ScaleLimit:
    """Limit on the smallest scale at which a loop along critical directions is unstable.

    Args:
        scenario: scenario with distributions and any parameters of the controller. The first critical directions lead
            to the corners of the box at which its loops are closest to instability.
        scale: smallest certified scale. The limit on exact loops is larger by the gap of a certificate.
    """

    def __init__(self, scenario: Scenario, scale: float) -> None:
        self._scale = scale / GAP_GOAL
        self._hover = hover = UncertainHover(scenario, UserSystems(), lambda count, step: None)
        k = len(hover.ranges)
        corners = np.unique(hover.generator.choice([-1.0, 1.0], (_NUM_CORNERS, k)), axis=0)
        directions, combinations = hover.everywhere(corners)
        radii = hover.radii(self._scale * directions, combinations, "corners")
        critical = np.argsort(-np.nan_to_num(radii, nan=np.inf))[:_NUM_FIRST_DIRECTIONS]
        self._directions, self._combinations = directions[critical], combinations[critical]

    def add(self, failure: Failure) -> None:
        """Add the direction of a combination of parameters at which hover fails."""
        z, combination = self._hover.scaled(failure.values)
        self._directions = np.vstack([self._directions, z / max(np.abs(z).max(), 1e-9)])
        self._combinations = np.append(self._combinations, combination)

    def fraction(self, scenario: Scenario) -> float:
        """Return the smallest scale of an unstable loop, relative to the limit, up to the largest one of the grid."""
        hover, count = self._hover, len(self._directions)
        z = (self._scale * _GRID[:, np.newaxis, np.newaxis] * self._directions).reshape(-1, len(hover.ranges))
        values = hover.all_values(z, np.tile(self._combinations, len(_GRID)))
        # The delay lines of a fleet are as long as its longest delay, so the fleet contains the largest choices.
        longest = np.append(values[0, : len(hover.ranges)], hover.combinations.max(axis=0))
        fields = [*(each.field for each in hover.ranges), *(each.field for each in hover.choices)]
        with single_threaded_blas():
            fleet = HoverFleet(symmetric_hover(at_rest(median_scenario(scenario))), fields)
            radii = spectral_radii(fleet(np.vstack([values, longest]))[:-1]).reshape(len(_GRID), count)
        return min(_crossing(column) for column in radii.T)


def _crossing(radii: np.ndarray) -> float:
    """Return the first point of the grid at which interpolated spectral radii reach 1; NaN is a failure."""
    failing = np.flatnonzero(~(radii < 1.0))
    if not len(failing):
        return float(_GRID[-1])
    i = int(failing[0])
    if i == 0:
        return 0.0
    low, high = radii[i - 1], radii[i]
    part = (1.0 - low) / (high - low) if np.isfinite(high) else 0.5
    return float(_GRID[i - 1] + part * (_GRID[i] - _GRID[i - 1]))
