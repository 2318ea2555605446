"""Metrics of flights as a function of points of the unit cube, for tools that choose the samples themselves.

Such tools estimate probabilities of rare events or sensitivity indices, or search for the worst case. A point has a
coordinate for each independent random number of the scenario. Uniform points have the distribution of the samples of a
study.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import fly_with_metrics
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch, coordinates
from drake_quad.scenario.models import Scenario

_MAX_NOISE = 2**31


class Evaluator:
    """Function from points of the unit cube, and numbers that determine wind and noise, to the metrics of flights.

    Args:
        scenario: scenario with distributions.
        num_vehicles: largest number of vehicles that fly at the same time.
        own: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.

    Attributes:
        scenario: scenario.
        names: names of the d coordinates: paths of fields, and shared variables.
        num_flights: number of flights so far.

    Raises:
        InputError: if the scenario has no distribution, or cannot be flown by a fleet.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        num_vehicles: int = 1024,
        own: UserSystems = UserSystems(),
        compiled: bool = True,
    ) -> None:
        self.scenario, self.names, self.num_flights = scenario, coordinates(scenario), 0
        if not self.names:
            raise InputError(f"{scenario.name} contains no distribution, so there is nothing to vary")
        self._fleet = StudyFleet(scenario, plan_route(scenario), num_vehicles, user_systems=own, compiled=compiled)

    def __call__(self, points: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Metrics:
        """Fly a vehicle for each point, and return the metrics, (n,) arrays.

        Args:
            points: (n, d) points between 0 and 1.
            noise: number that determines wind and noise, or (n,) numbers, from 0 to 2³¹ - 1. The flight with the
                number i has the wind and the noise of sample i of the scenario's study.

        Raises:
            InputError: if the points or the numbers have the wrong shape or are out of range.
        """
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != len(self.names) or not len(points):
            raise InputError(f"points have the shape {points.shape}, but must have (n, {len(self.names)})")
        if not np.all((points >= 0.0) & (points <= 1.0)):
            raise InputError("points must be between 0 and 1")
        numbers = np.broadcast_to(np.asarray(noise), len(points)) if np.ndim(noise) == 0 else np.asarray(noise)
        if numbers.shape != (len(points),) or numbers.dtype.kind not in "iu":
            raise InputError(f"noise must be a whole number or {len(points)} whole numbers")
        if not np.all((numbers >= 0) & (numbers < _MAX_NOISE)):
            raise InputError(f"noise must be at least 0 and below {_MAX_NOISE}")
        size = self._fleet.num_vehicles
        parts = [slice(first, first + size) for first in range(0, len(points), size)]
        flown = [self._fly(points[part], numbers[part].tolist()) for part in parts]
        self.num_flights += len(points)
        return flown[0].with_values(np.concatenate(values) for values in zip(*flown, strict=True))

    def at_normal(self, points: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Metrics:
        """Return the metrics at (n, d) points of standard normal space; `noise` is as in a call."""
        return self(scipy.special.ndtr(np.asarray(points, dtype=float)), noise)

    def scenario_at(self, point: Any, noise: int = 0) -> Scenario:
        """Return the scenario at a point (d,) of the unit cube, without distributions, as `simulate` flies it."""
        return Batch.at_points(self.scenario, np.asarray(point, dtype=float)[None], [noise]).scenario_of(0)

    def _fly(self, points: np.ndarray, samples: list[int]) -> Metrics:
        return fly_with_metrics(self._fleet, Batch.at_points(self.scenario, points, samples))
