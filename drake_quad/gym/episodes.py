"""Where the episodes of an environment begin.

Episode j of a vehicle with seed s is sample j of the study of seed s: what is drawn for it, its wind and its noise. It
depends on nothing else, so that a vehicle flies the same in any environment, and as `simulate(..., seed=s, sample=j)`.

To make a context what a sample needs takes milliseconds, for one vehicle about as long as for hundreds. So episodes
are made ready by the hundred, some for each vehicle.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet
from drake_quad.compilation.clocked_fleet import Beginning, Beginnings
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario

# Episodes that are made at once: from there on, one takes little less in a larger batch, and memory grows.
_FEWEST_AT_ONCE, _MOST_AT_ONCE = 32, 512
# Episodes that are ready for each vehicle: as many as make about so many in all, within bounds.
_FEWEST_READY, _MOST_READY, _READY = 2, 32, 4096


class Episode(NamedTuple):
    """Which sample a vehicle flies.

    Attributes:
        seed: of the study.
        sample: its number.
    """

    seed: int
    sample: int


class Episodes:
    """The episodes of the vehicles of an environment, one after another.

    Args:
        scenario: of the environment.
        plan: that is flown.
        num_vehicles: N.
        shown: names of the diagram's output ports that are seen when an episode begins.

    Attributes:
        seeds: (N,) of the vehicles.
        samples: (N,) the episodes that they fly; -1 before the first.
    """

    def __init__(self, scenario: Scenario, plan: Plan, num_vehicles: int, *, shown: tuple[str, ...]) -> None:
        self._scenario, self._plan = scenario, plan
        self._at_once = min(max(num_vehicles, _FEWEST_AT_ONCE), _MOST_AT_ONCE)
        self._ahead = min(max(_READY // num_vehicles, _FEWEST_READY), _MOST_READY)
        batch = Batch.draw(scenario, range(self._at_once))
        self._diagram = build_fleet_diagram(batch, plan, open_action=True)
        self._context = self._diagram.CreateDefaultContext()
        self._beginning = Beginning(self._diagram, shown=shown)
        first = self._beginning.of(self._context)
        places = num_vehicles, self._ahead
        self._ready = Beginnings._make(np.empty((*places, rows.shape[1])) for rows in first)
        self.seeds, self.samples = np.zeros(num_vehicles, dtype=np.int64), np.full(num_vehicles, -1)
        # The first episode of each vehicle that is not ready.
        self._next = np.zeros(num_vehicles, dtype=np.int64)

    def seed(self, vehicles: np.ndarray, seeds: np.ndarray) -> None:
        """Gives seeds to vehicles, whose episodes are counted from 0 again."""
        self.seeds[vehicles], self.samples[vehicles], self._next[vehicles] = seeds, -1, 0

    def begin(self, vehicles: np.ndarray) -> Beginnings:
        """The next episodes of k vehicles, given their numbers, as they begin: (k, rows)."""
        samples = self.samples[vehicles] + 1
        self.samples[vehicles] = samples
        if (samples >= self._next[vehicles]).any():
            self._make_ready()
        place = samples % self._ahead
        return Beginnings._make(rows[vehicles, place] for rows in self._ready)

    def episode(self, vehicle: int) -> Episode:
        """The one that a vehicle flies."""
        return Episode(int(self.seeds[vehicle]), int(self.samples[vehicle]))

    def _make_ready(self) -> None:
        """Makes ready what is not: those that the vehicles fly now, where they have just begun, and the next ones."""
        counts = np.maximum(self.samples, 0) + self._ahead - self._next
        vehicles = np.repeat(np.arange(len(counts)), counts)
        firsts = np.repeat(np.cumsum(counts) - counts, counts)
        samples = self._next[vehicles] + np.arange(len(vehicles)) - firsts
        for begin in range(0, len(vehicles), self._at_once):
            some = slice(begin, begin + self._at_once)
            self._make(vehicles[some], samples[some])
        self._next += counts

    def _make(self, vehicles: np.ndarray, samples: np.ndarray) -> None:
        seeds = self.seeds[vehicles].tolist()
        batch = Batch.draw(self._scenario, samples.tolist(), seeds=seeds).padded(self._at_once)
        reset_fleet(self._diagram, self._context, batch, self._plan)
        for ready, made in zip(self._ready, self._beginning.of(self._context), strict=True):
            ready[vehicles, samples % self._ahead] = made[: len(vehicles)]
