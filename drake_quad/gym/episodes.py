"""Initial values of an environment's episodes.

Episode j of a vehicle with seed s is sample j of the study with seed s: this sample determines the random parameters,
wind and noise. The flight therefore depends only on s, j and the actions. It is the same in any environment, and in
`simulate(..., seed=s, sample=j)`.

Resetting a context takes milliseconds, almost independently of the number of samples. For that reason, the initial
values of hundreds of episodes are computed at once, several episodes in advance for each vehicle.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet
from drake_quad.compilation.clocked_fleet import Initializer, InitialValues
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario

# Limits on the number of episodes that are computed at once. Larger batches need more memory and are hardly faster.
_MIN_BATCH_SIZE = 32  # episodes
_MAX_BATCH_SIZE = 512  # episodes
# Number of episodes that are computed in advance, summed over all vehicles. It is divided equally among the vehicles,
# within the following limits for each vehicle.
_TOTAL_EPISODES_AHEAD = 4096
_MIN_EPISODES_AHEAD = 2  # smallest number of episodes that are computed in advance for a vehicle
_MAX_EPISODES_AHEAD = 32  # largest number of episodes that are computed in advance for a vehicle


class Episode(NamedTuple):
    """Sample of a Monte Carlo study that is flown as an episode.

    Attributes:
        seed: seed of the study.
        sample: index of the sample.
    """

    seed: int
    sample: int


class Episodes:
    """Sequences of episodes, one for each vehicle of an environment.

    Args:
        scenario: scenario of the environment.
        plan: plan with the reference of the flights.
        num_vehicles: number N of vehicles.
        outputs: names of the diagram's output ports whose initial values are computed.

    Attributes:
        seeds: (N,) seeds of the vehicles.
        samples: (N,) indices of the current samples; -1 before the first episode.
    """

    def __init__(self, scenario: Scenario, plan: Plan, num_vehicles: int, *, outputs: tuple[str, ...]) -> None:
        self._scenario, self._plan = scenario, plan
        self._batch_size = min(max(num_vehicles, _MIN_BATCH_SIZE), _MAX_BATCH_SIZE)
        self._num_ahead = min(max(_TOTAL_EPISODES_AHEAD // num_vehicles, _MIN_EPISODES_AHEAD), _MAX_EPISODES_AHEAD)
        batch = Batch.draw(scenario, range(self._batch_size))
        self._diagram = build_fleet_diagram(batch, plan, open_action=True)
        self._context = self._diagram.CreateDefaultContext()
        self._initializer = Initializer(self._diagram, outputs=outputs)
        first = self._initializer.initial_values(self._context)
        shape = num_vehicles, self._num_ahead
        # `_ready` is a ring buffer: sample j of a vehicle is stored at the index j modulo the number of episodes ahead.
        self._ready = InitialValues._make(np.empty((*shape, rows.shape[1])) for rows in first)
        self.seeds, self.samples = np.zeros(num_vehicles, dtype=np.int64), np.full(num_vehicles, -1)
        # For each vehicle, the index of the first sample whose initial values have not been computed.
        self._next = np.zeros(num_vehicles, dtype=np.int64)

    def seed(self, vehicles: np.ndarray, seeds: np.ndarray) -> None:
        """Set the seeds of some vehicles. The next episode of each of these vehicles is sample 0."""
        self.seeds[vehicles], self.samples[vehicles], self._next[vehicles] = seeds, -1, 0

    def begin(self, vehicles: np.ndarray) -> InitialValues:
        """Start the next episodes of k vehicles, given their indices, and return their initial values."""
        samples = self.samples[vehicles] + 1
        self.samples[vehicles] = samples
        if (samples >= self._next[vehicles]).any():
            self._compute_ahead()
        index = samples % self._num_ahead
        return InitialValues._make(rows[vehicles, index] for rows in self._ready)

    def episode(self, vehicle: int) -> Episode:
        """Return the seed and the sample of the current episode of a vehicle."""
        return Episode(int(self.seeds[vehicle]), int(self.samples[vehicle]))

    def _compute_ahead(self) -> None:
        """Compute the initial values of further episodes, until the buffer of every vehicle is full.

        The buffer of a vehicle begins with its current episode.
        """
        counts = np.maximum(self.samples, 0) + self._num_ahead - self._next
        vehicles = np.repeat(np.arange(len(counts)), counts)
        firsts = np.repeat(np.cumsum(counts) - counts, counts)
        samples = self._next[vehicles] + np.arange(len(vehicles)) - firsts
        for begin in range(0, len(vehicles), self._batch_size):
            part = slice(begin, begin + self._batch_size)
            self._compute(vehicles[part], samples[part])
        self._next += counts

    def _compute(self, vehicles: np.ndarray, samples: np.ndarray) -> None:
        seeds = self.seeds[vehicles].tolist()
        batch = Batch.draw(self._scenario, samples.tolist(), seeds=seeds).padded(self._batch_size)
        reset_fleet(self._diagram, self._context, batch, self._plan)
        initial = self._initializer.initial_values(self._context)
        for ready, rows in zip(self._ready, initial, strict=True):
            ready[vehicles, samples % self._num_ahead] = rows[: len(vehicles)]
