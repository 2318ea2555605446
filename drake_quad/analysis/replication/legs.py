"""Errors leg by leg: what gains that suit straight lines do on curves."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.analysis.replication.sweeps import with_settings
from drake_quad.flight import Flight, simulate_samples
from drake_quad.scenario import Scenario

STRAIGHT = ("climb", "straight", "descent", "return")
CURVED = ("circle", "turn", "curve")


class LegErrors(NamedTuple):
    """RMSE over the straight and over the curved legs, m, and how much the command swings on the straight ones.

    Attributes:
        straight: m.
        curved: m.
        swing: total variation of the horizontal command a second on the straight legs, m/s³.
    """

    straight: np.ndarray
    curved: np.ndarray
    swing: np.ndarray


def leg_errors(flights: Sequence[Flight]) -> LegErrors:
    """(flights,) errors of flights of the paper's route; NaN for those that crashed."""
    rows = [_of_flight(flight) if not flight.metrics.crashed else (np.nan,) * 3 for flight in flights]
    return LegErrors(*np.array(rows).T)


def _of_flight(flight: Flight) -> tuple[float, float, float]:
    names = np.array([leg.name for leg in flight.plan.legs])
    leg = names[np.searchsorted(flight.plan.leg_times, flight.time, side="right") - 1]
    squared = np.sum((flight["reference"][:, 0:3] - flight["state"][:, 0:3]) ** 2, axis=1)
    straight, curved = np.isin(leg, STRAIGHT), np.isin(leg, CURVED)
    steps = np.abs(np.diff(flight["acceleration_command"][:, 0:2], axis=0)).sum(axis=1)
    both = straight[1:] & straight[:-1]
    period = flight.time[1] - flight.time[0]
    return (
        float(np.sqrt(squared[straight].mean())),
        float(np.sqrt(squared[curved].mean())),
        float(steps[both].sum() / (both.sum() * period)),
    )


def fly_legs(scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int]) -> LegErrors:
    """The (settings, samples) errors leg by leg of a scenario with other numbers, in one recorded fleet."""
    count = len(next(iter(settings.values())))
    varied = with_settings(scenario, settings, len(samples))
    errors = leg_errors(simulate_samples(varied, [*samples] * count))
    return LegErrors(*(values.reshape(count, -1) for values in errors))
