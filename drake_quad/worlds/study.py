"""Monte Carlo studies of worlds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drake_quad.errors import InputError
from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.statistics.interval import Interval
from drake_quad.worlds.simulation import WorldSimulation
from drake_quad.worlds.world import World
from drake_quad.worlds.world_diagram import draw_batches

_MAX_WORLDS = 256  # worlds that fly side by side


@dataclass(frozen=True)
class WorldStudy:
    """Results of the samples of a world.

    Attributes:
        world: world that was flown.
        metrics: metrics of each vehicle by its name, (samples,) arrays.
        smallest_clearances: (samples, vehicles) smallest distance of a vehicle's sphere from those of all others, m;
            negative for vehicles that have collided.
    """

    world: World
    metrics: dict[str, Metrics]
    smallest_clearances: np.ndarray

    @property
    def collided(self) -> np.ndarray:
        """True for each sample in which vehicles have collided, (samples,)."""
        collided: np.ndarray = (self.smallest_clearances < 0.0).any(axis=1)
        return collided

    @property
    def collision_probability(self) -> Interval:
        """Probability that vehicles collide, with its 95 % interval."""
        return proportion_interval(int(self.collided.sum()), len(self.collided))


def study_world(
    world: World,
    num_samples: int,
    *,
    seed: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> WorldStudy:
    """Fly samples of a world, side by side in machine code.

    Args:
        world: world to fly, whose scenarios may contain distributions.
        num_samples: number of samples.
        seed: seed of the samples; by default the seed of each scenario.
        progress: function that is called with the number of samples that have been flown since the last call.

    Raises:
        InputError: if the number of samples is not positive, or a vehicle cannot fly its route.
    """
    if num_samples < 1:
        raise InputError(f"num_samples is {num_samples}, but must be at least 1")
    size = min(num_samples, _MAX_WORLDS)
    simulation: WorldSimulation | None = None
    metrics: dict[str, list[Metrics]] = {name: [] for name in world.vehicles}
    clearances: list[np.ndarray] = []
    for first in range(0, num_samples, size):
        count = min(size, num_samples - first)
        # A smaller last batch is filled with copies of its last sample.
        samples = [min(first + k, num_samples - 1) for k in range(size)]
        batches = draw_batches(world, samples, seed=seed)
        if simulation is None:
            simulation = WorldSimulation(world, batches, record=False, compiled=True)
        simulation.reset(batches)
        simulation.fly()
        for name, parts in metrics.items():
            parts.append(simulation.metrics(name).take(slice(count)))
        clearances.append(simulation.smallest_clearances()[:count])
        if progress is not None:
            progress(count)
    joined = {name: type(parts[0])(*map(np.concatenate, zip(*parts, strict=True))) for name, parts in metrics.items()}
    return WorldStudy(world, joined, np.concatenate(clearances))
