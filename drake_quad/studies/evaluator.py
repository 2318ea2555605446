"""Metrics of flights as a function of points of the unit cube, for tools that choose the samples themselves.

Such tools estimate probabilities of rare events or sensitivity indices, or search for the worst case. A point has a
coordinate for each independent random number of the scenario. Uniformly distributed points correspond to the samples of
a study. Integers determine wind and noise, one for the whole flight or one for each period of it.
"""

import math
import uuid
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import coordinates
from drake_quad.scenario.models import NoiseSamples, Scenario
from drake_quad.statistics.subset_simulation import NOISE_SEED_BOUND
from drake_quad.studies.flying import (
    BatchJob,
    build_before_fork,
    build_point_batch,
    code_versions,
    default_batch_size,
    delete_fleets,
    fly_points,
    get_fleet,
    point_rows,
)
from drake_quad.studies.processes import Workers, check_importable
from drake_quad.studies.worker_pool import WorkerPool, fly_batches, size_of_batches


class Evaluator:
    """Function that maps points of the unit cube, and integers that determine wind and noise, to flight metrics.

    Args:
        scenario: scenario with distributions.
        num_vehicles: largest number of vehicles of a fleet.
        noise_period: length of the periods whose wind and noise are determined by separate numbers, s; None for one
            number for the whole flight.
        user_systems: functions that create the user's systems for N vehicles.
        compiled: True to compile the diagram to machine code.
        pool: workers that fly the points, such as `Workers` or a Dask cluster from `dask_pool`; by default, a few
            fleets in this process. The metrics do not depend on the workers.

    Attributes:
        scenario: scenario.
        names: names of the d coordinates: paths of fields, and shared variables.
        num_periods: number of periods of the noise.
        num_flights: number of flights so far.
        plan: plan that is flown.

    Raises:
        InputError: if the scenario has no distribution or cannot be flown by a fleet, or if workers cannot import the
            user's systems.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        num_vehicles: int = 1024,
        noise_period: float | None = None,
        user_systems: UserSystems = UserSystems(),
        compiled: bool = True,
        pool: WorkerPool | None = None,
    ) -> None:
        self.names, self.num_flights, self.num_periods = coordinates(scenario), 0, 1
        if not self.names and noise_period is None:
            raise InputError(f"{scenario.name} contains no distribution, so there is nothing to vary")
        self.plan = plan = plan_route(scenario)
        if noise_period is not None:
            self.num_periods = math.ceil(flight_duration(scenario, plan) / noise_period)
            noise = NoiseSamples(period=noise_period, samples=(0,) * self.num_periods)
            scenario = scenario.model_copy(update={"noise": noise})
        if scenario.laboratory.autopilot.is_firmware:
            num_vehicles = min(num_vehicles, default_batch_size(scenario))
        self.scenario, self._pool, self._fleets = scenario, pool, dict[int, StudyFleet]()
        # A worker compares these versions with those of its own code.
        code = {} if pool is None else code_versions(user_systems)
        self._job = BatchJob(uuid.uuid4().hex, code, scenario, plan, num_vehicles, user_systems, compiled)
        if pool is None:
            get_fleet(self._job, self._fleets, num_vehicles)
        elif isinstance(pool, Workers):
            check_importable({**user_systems.specified, "a kind that the scenario uses": scenario})

    def __call__(self, points: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Metrics:
        """Fly a vehicle for each point, and return the metrics, (n,) arrays.

        Args:
            points: (n, d) points between 0 and 1.
            noise: integers from 0 to 2³¹ - 1 that determine wind and noise: one for all flights, (n,) for the flights,
                or (n, num_periods) for the periods of each flight. Integer i selects the wind and the noise of sample i
                of the scenario's study.

        Raises:
            InputError: if points or noise have the wrong shape or are out of range.
            RuntimeError: if workers cannot fly a point.
        """
        indices, parts = zip(*self.batches(points, noise), strict=True)
        order = np.argsort(np.concatenate(indices))
        return parts[0].with_values(np.concatenate(values)[order] for values in zip(*parts, strict=True))

    def batches(self, points: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Iterator[tuple[np.ndarray, Metrics]]:
        """Fly a vehicle for each point, and yield the indices and the metrics of the points of each finished batch.

        Batches are yielded in the order in which they end. The arguments and errors are those of `__call__`.
        """
        points = np.asarray(points, dtype=float)
        if points.ndim != 2 or points.shape[1] != len(self.names) or not len(points):
            raise InputError(f"points have the shape {points.shape}, but must have (n, {len(self.names)})")
        if not np.all((points >= 0.0) & (points <= 1.0)):
            raise InputError("points must be between 0 and 1")
        numbers, shape = np.asarray(noise), (len(points), self.num_periods)
        if numbers.dtype.kind not in "iu" or numbers.shape not in ((), shape[:1], shape):
            raise InputError(
                f"the noise seed must be a whole number, {len(points)} whole numbers, or whole numbers of the shape"
                f" {shape}"
            )
        numbers = np.broadcast_to(numbers[:, None] if numbers.ndim == 1 else numbers, shape)
        if not np.all((numbers >= 0) & (numbers < NOISE_SEED_BOUND)):
            raise InputError(f"the noise seed must be at least 0 and below {NOISE_SEED_BOUND}")
        flights = np.column_stack([np.arange(len(points)), points, numbers])
        for rows in self._flown(flights):
            self.num_flights += len(rows)
            yield rows[:, 0].astype(int), self.scenario.metrics_type(*rows[:, 1:].T)

    def metrics_at_normal_points(self, points: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Metrics:
        """Return the metrics at (n, d) points of standard normal space; `noise` is as in `__call__`."""
        return self(scipy.special.ndtr(np.asarray(points, dtype=float)), noise)

    def scenario_at(self, point: Any, noise: int | Sequence[int] | np.ndarray = 0) -> Scenario:
        """Return the scenario at a point (d,) of the unit cube, without distributions, as `simulate` flies it.

        Args:
            point: (d,) point.
            noise: integer that determines wind and noise, or (num_periods,) integers, one for each period.
        """
        numbers = np.broadcast_to(np.asarray(noise), self.num_periods)
        return build_point_batch(self.scenario, np.concatenate([[0.0], point, numbers])[None]).vehicle_scenario(0)

    def _flown(self, flights: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the result of `fly_points` for each finished batch of flights (n, 1 + d + num_periods)."""
        if self._pool is None:
            for part in _parts(flights, self._job.num_vehicles):
                yield point_rows(get_fleet(self._job, self._fleets, len(part)), part)
            return
        size = size_of_batches(len(flights), self._pool.num_workers, None, self._job.num_vehicles)
        job = self._job._replace(num_vehicles=size)
        build_before_fork(self._pool, job)
        try:
            for outcome in fly_batches(self._pool, partial(fly_points, job), _parts(flights, size)):
                if outcome.reason:
                    raise RuntimeError(f"a flight could not be simulated: {outcome.reason}")
                yield outcome.result
        finally:
            self._pool.abandon()
            delete_fleets()


def _parts(flights: np.ndarray, size: int) -> list[np.ndarray]:
    return [flights[first : first + size] for first in range(0, len(flights), size)]
