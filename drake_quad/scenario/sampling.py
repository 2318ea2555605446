"""From a scenario with distributions to the numbers of one sample of a study, or of many."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.randomness import parameter_numbers
from drake_quad.scenario.distributions import DISTRIBUTIONS, Distribution, Model
from drake_quad.scenario.loading import distributions_in
from drake_quad.scenario.models import Scenario


def draw_sample(scenario: Scenario, sample: int, *, seed: int | None = None) -> Scenario:
    """Draws one sample of a study: the scenario with a number in place of each of its distributions.

    Args:
        scenario: of the study.
        sample: its number in the study, from 0 on.
        seed: of the study, in place of the scenario's.

    Raises:
        InputError: the seed or the sample's number is negative or too large.
    """
    seed = _checked(scenario, seed, [sample])

    def draw(distribution: Distribution, path: str) -> float:
        return float(distribution.quantile(parameter_numbers(seed, [sample], path)[0]))

    drawn: Scenario = _replaced(scenario, "", draw)
    return drawn.model_copy(update={"seed": seed, "sample": sample})


def draw_samples(scenario: Scenario, samples: Sequence[int], *, seed: int | None = None) -> Scenario:
    """Draws many samples for a fleet: the scenario with an array, an entry a vehicle, in place of each distribution.

    Args:
        scenario: of the study.
        samples: their numbers in the study, one for each vehicle.
        seed: of the study, in place of the scenario's.

    Raises:
        InputError: as `draw_sample`, or the route holds a distribution: the vehicles of a fleet fly one plan.
    """
    seed = _checked(scenario, seed, samples)
    random = [path for path in distributions_in(scenario) if path.startswith("route.")]
    if random:
        raise InputError(f"{random[0]} is a distribution; the vehicles of a fleet fly one route")

    def draw(distribution: Distribution, path: str) -> np.ndarray:
        return np.asarray(distribution.quantile(parameter_numbers(seed, samples, path)))

    drawn: Scenario = _replaced(scenario, "", draw)
    return drawn.model_copy(update={"seed": seed})


def drawn_numbers(scenario: Scenario, samples: Sequence[int]) -> dict[str, np.ndarray]:
    """The (n,) numbers drawn for each field that holds a distribution, by its path.

    Args:
        scenario: of the study.
        samples: n numbers of samples.
    """
    found: dict[str, np.ndarray] = {}

    def draw(distribution: Distribution, path: str) -> np.ndarray:
        found[path] = np.asarray(distribution.quantile(parameter_numbers(scenario.seed, samples, path)))
        return found[path]

    _replaced(scenario, "", draw)
    return found


def _checked(scenario: Scenario, seed: int | None, samples: Sequence[int]) -> int:
    seed = scenario.seed if seed is None else seed
    for name, number, limit in [("seed", seed, 2**63), *(("sample", sample, 2**31) for sample in samples)]:
        if not 0 <= number < limit:
            raise InputError(f"{name} is {number}, but must be at least 0 and below {limit}")
    return seed


def _replaced(value: Any, path: str, draw: Callable[[Any, str], Any]) -> Any:
    """A copy of a part of a scenario in which distributions are replaced by what is drawn for their paths."""
    if isinstance(value, tuple(DISTRIBUTIONS.values())):
        return draw(value, path)
    if isinstance(value, Model):
        parts = {name: getattr(value, name) for name in type(value).model_fields}
        drawn = {name: _replaced(part, f"{path}.{name}".lstrip("."), draw) for name, part in parts.items()}
        changed = {name: part for name, part in drawn.items() if part is not parts[name]}
        return value.model_copy(update=changed) if changed else value
    if isinstance(value, tuple):
        items = tuple(_replaced(item, f"{path}[{i}]", draw) for i, item in enumerate(value))
        return value if all(a is b for a, b in zip(items, value, strict=True)) else items
    return value
