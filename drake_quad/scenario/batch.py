"""Batches of samples of a study, each flown by one vehicle of a fleet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.randomness.streams import Samples, Seeds
from drake_quad.scenario.correlation import MIN_PROBABILITY, drawn_values, shared_names, shared_stream, values_at
from drake_quad.scenario.draws import LATIN_HYPERCUBE, SOBOL
from drake_quad.scenario.inertia import rigid_inertias
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, join_path, map_leaves, split_path


@dataclass(frozen=True)
class Batch:
    """Samples of a study, each flown by a vehicle of a fleet.

    Attributes:
        scenario: scenario of the study, with its distributions.
        samples: (N,) indices of the samples in the study, counted from 0. Together with the seed they determine wind
            and noise.
        varying: (N,) values of each field that differs between vehicles, such as a field with a distribution, by path.
        seeds: (N,) seed of each sample, used if the samples belong to several studies; None if all samples use the seed
            of the scenario.
        noise: (periods, N) indices of the samples that provide wind and noise in each period of the scenario's `noise`;
            None if the scenario determines them.
        wind_seed: seed of the wind, which vehicles of one world share; None for the seed of the samples.
    """

    scenario: Scenario
    samples: tuple[int, ...]
    varying: Mapping[str, np.ndarray]
    seeds: tuple[int, ...] | None = None
    noise: tuple[tuple[int, ...], ...] | None = None
    wind_seed: int | None = None

    @classmethod
    def draw(
        cls, scenario: Scenario, samples: Sequence[int], *, seed: int | None = None, seeds: Sequence[int] | None = None
    ) -> "Batch":
        """Draw samples of a scenario's study.

        Fields are drawn independently, unless their distributions share variables or the scenario has designed draws.
        Moments of inertia that no rigid body can have are replaced by the nearest possible moments.

        Args:
            scenario: scenario, which may contain distributions.
            samples: indices of the samples, counted from 0.
            seed: seed of the study. By default, the seed of the scenario.
            seeds: seed of each sample, if the samples belong to several studies. They are then drawn independently.

        Raises:
            InputError: if a seed or the index of a sample is negative or too large.
        """
        seed = scenario.seed if seed is None else seed
        numbered = [("seed", each, 2**63) for each in (seed, *(seeds or ()))]
        for name, number, limit in [*numbered, *(("sample", sample, 2**31) for sample in samples)]:
            if not 0 <= number < limit:
                raise InputError(f"{name} is {number}, but must be at least 0 and below {limit}")
        distributions = distributions_in(scenario)
        own_seeds = None if seeds is None else tuple(seeds)
        streams = {_stream_name(path): each for path, each in distributions.items()}
        if scenario.draws is None or own_seeds is not None or not streams:
            drawn = drawn_values(own_seeds or seed, samples, streams)
        else:
            names = [*streams, *map(shared_stream, shared_names(streams.values()))]
            drawn = values_at(streams, scenario.draws.numbers(seed, samples, names).__getitem__)
        varying = _with_rigid_bodies(scenario, {path: drawn[_stream_name(path)] for path in distributions})
        return cls(scenario.model_copy(update={"seed": seed}), tuple(samples), varying, own_seeds)

    @classmethod
    def at_points(
        cls,
        scenario: Scenario,
        points: np.ndarray,
        samples: Sequence[int],
        *,
        noise: Sequence[Sequence[int]] | None = None,
    ) -> "Batch":
        """Map points of the unit hypercube to a batch by the quantiles of the scenario's distributions.

        Args:
            scenario: scenario, which may contain distributions.
            points: (N, d) numbers between 0 and 1, one column for each of the `coordinates` of the scenario. A field
                without shared variables takes the quantile of its distribution at the number in its column.
            samples: (N,) indices of the samples whose wind and noise are used.
            noise: (periods, N) indices of the samples that provide wind and noise in each period of the scenario's
                `noise`. By default, the scenario determines them.
        """
        inside = np.clip(points, MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
        columns = dict(zip(coordinates(scenario), inside.T, strict=True))
        values = values_at(distributions_in(scenario), columns.__getitem__)
        periods = None if noise is None else tuple(tuple(each) for each in noise)
        return cls(scenario, tuple(samples), _with_rigid_bodies(scenario, values), noise=periods)

    @property
    def noise_samples(self) -> Samples:
        """Indices of the samples that determine the wind and the noise of each vehicle."""
        settings = self.scenario.noise
        if settings is None:
            return Samples(self.seed, self.samples, wind_seed=self.wind_seed)
        first, *later = self.noise or [(sample,) * len(self) for sample in settings.samples]
        return Samples(self.seed, first, later, settings.period, self.wind_seed)

    @property
    def seed(self) -> Seeds:
        """Seed of all samples, or (N,) seeds of the samples."""
        return self.scenario.seed if self.seeds is None else self.seeds

    @property
    def fleet_scenario(self) -> Any:
        """Scenario in which each field that differs between vehicles is an (N,) array.

        Only the assembly of diagrams uses this form of a scenario.
        """
        return map_leaves(self.scenario, self.varying.get)

    def __len__(self) -> int:
        """Return the number of vehicles, N."""
        return len(self.samples)

    def with_varying(self, varying: Mapping[str, np.ndarray]) -> "Batch":
        """Return the batch with new values of some fields, without validation.

        Args:
            varying: (N,) new values of each field, by path.
        """
        return replace(self, varying={**self.varying, **varying})

    def padded(self, num_vehicles: int) -> "Batch":
        """Return the batch with a larger number of vehicles. Each additional vehicle flies the last sample."""
        missing = num_vehicles - len(self)
        varying = {path: np.append(numbers, [numbers[-1]] * missing) for path, numbers in self.varying.items()}

        def padded(indices: tuple[int, ...]) -> tuple[int, ...]:
            return (*indices, *indices[-1:] * missing)

        seeds, noise = self.seeds and padded(self.seeds), self.noise and tuple(map(padded, self.noise))
        return Batch(self.scenario, padded(self.samples), varying, seeds, noise, self.wind_seed)

    def vehicle_scenario(self, vehicle: int) -> Scenario:
        """Return the scenario of one vehicle, counted from 0, with its drawn values and its sample index."""

        def number(path: str, value: Any) -> Any:
            return float(self.varying[path][vehicle]) if path in self.varying else value

        scenario: Scenario = map_leaves(self.scenario, number)
        seed = self.scenario.seed if self.seeds is None else self.seeds[vehicle]
        noise = self.scenario.noise
        if noise is not None and self.noise is not None:
            noise = noise.model_copy(update={"samples": tuple(each[vehicle] for each in self.noise)})
        return scenario.model_copy(
            update={"seed": seed, "sample": self.samples[vehicle], "noise": noise, "draws": None}
        )


def coordinates(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the independent random numbers from which the fields of a sample are drawn.

    The names are the paths of all fields with a distribution, and `shared NAME` for each shared variable NAME.
    """
    distributions = distributions_in(scenario)
    return (*distributions, *map(shared_stream, shared_names(distributions.values())))


def check_pairs(scenarios: Mapping[str, Scenario]) -> None:
    """Check that samples with equal index draw equal numbers in all scenarios, so flights can be compared in pairs.

    Args:
        scenarios: scenarios by the name that messages use. The first is the baseline.

    Raises:
        InputError: if the scenarios have different draws, or Sobol draws of different random parameters.
    """
    (first, baseline), *others = scenarios.items()
    for name, scenario in others:
        if scenario.draws != baseline.draws:
            raise InputError(f"{name} and {first} have different draws, so their samples cannot be compared in pairs")
        names, known = ({*coordinates(each)} for each in (scenario, baseline))
        if scenario.draws is not None and scenario.draws.kind == SOBOL and names != known:
            raise InputError(
                f"{name} and {first} have different random parameters ({join_names(sorted(names ^ known))}), so their"
                f" Sobol draws cannot be compared in pairs; use {LATIN_HYPERCUBE} draws, in which parameters with the"
                " same name have the same numbers"
            )


def draw_sample(scenario: Scenario, sample: int, *, seed: int | None = None) -> Scenario:
    """Draw one sample of a study: the scenario with a number in place of each of its distributions.

    Args:
        scenario: scenario, which may contain distributions.
        sample: index of the sample, counted from 0.
        seed: seed of the study. By default, the seed of the scenario.

    Raises:
        InputError: if the seed or the index is negative or too large.
    """
    return Batch.draw(scenario, [sample], seed=seed).vehicle_scenario(0)


def scenario_at_quantile(scenario: Scenario, probability: float) -> Scenario:
    """Return the scenario with the quantile of each distribution at a given probability.

    Moments of inertia that no rigid body can have are replaced by the nearest possible moments.

    Args:
        scenario: scenario with distributions.
        probability: probability, between 0 and 1.
    """
    varying = {path: np.array([each.quantile(probability)]) for path, each in distributions_in(scenario).items()}
    return Batch(scenario, (0,), _with_rigid_bodies(scenario, varying)).vehicle_scenario(0)


def median_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario with the median of each of its distributions."""
    return scenario_at_quantile(scenario, 0.5)


def _with_rigid_bodies(scenario: Scenario, varying: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Replace moments of inertia that no rigid body can have by the nearest possible moments.

    Args:
        scenario: scenario with distributions.
        varying: (N,) drawn numbers, by the path of their field.
    """
    result = dict(varying)
    effects = {f"vehicle.{name}": effect for name, effect in scenario.vehicle.effects().items()}
    bodies: dict[str, Any] = {"vehicle": scenario.vehicle, **effects}
    for path, body in bodies.items():
        fields = [join_path(path, "inertia", axis) for axis in range(3)]
        if not any(field in varying for field in fields):
            continue
        drawn = [varying.get(field, moment) for field, moment in zip(fields, body.inertia, strict=True)]
        rigid = zip(fields, rigid_inertias(body.inertia, drawn), strict=True)
        result |= {field: moments for field, moments in rigid if field in varying}
    return result


def _stream_name(path: str) -> str:
    """Return the name of a field's random stream: its path with indices in brackets, as in `vehicle.inertia[0]`.

    Earlier versions wrote paths in this form. The names of streams still use it, so that the samples of existing
    studies do not change.
    """
    first, *steps = split_path(path)
    return first + "".join(f"[{step}]" if step.isdecimal() else f".{step}" for step in steps)
