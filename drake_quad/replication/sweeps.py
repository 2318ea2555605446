"""One scenario with other numbers, many times, on the same samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from drake_quad.files import read_table, write_table
from drake_quad.replication.measures import LegErrors, leg_errors
from drake_quad.flight import simulate_samples
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario import Scenario
from drake_quad.scenario.numbers import with_rows
from drake_quad.flight.fleet import StudyFleet

Rows = TypeVar("Rows", Metrics, LegErrors)


@dataclass(frozen=True)
class Sweep(Generic[Rows]):
    """Flights of some settings, all on the same samples.

    Attributes:
        settings: (settings,) value of each number that differs.
        samples: (samples,) their numbers.
        metrics: (settings, samples).
    """

    settings: Mapping[str, np.ndarray]
    samples: np.ndarray
    metrics: Rows

    def save(self, path: Path) -> Path:
        """Writes a row for each setting and sample."""
        count = len(self.samples)
        table = {name: np.repeat(values, count) for name, values in self.settings.items()}
        table |= {"sample": np.tile(self.samples, len(self.metrics[0]))}
        return write_table(path, table | {name: np.ravel(values) for name, values in self.metrics._asdict().items()})


def load_sweep(path: Path, kind: type[Rows]) -> Sweep[Rows]:
    """Reads a sweep whose metrics are of a kind.

    Raises:
        InputError: the file cannot be read.
    """
    table = read_table(path)
    samples = np.unique(table["sample"]).astype(int)
    metrics = kind(*(table.pop(name).reshape(-1, len(samples)) for name in kind._fields))
    table.pop("sample")
    return Sweep({name: values[:: len(samples)] for name, values in table.items()}, samples, metrics)


# The exponents of Table II, and the triangles of type 1.
EXPONENTS = {"pd_t1fnn": (1.0, 1.0), "pd_t2fnn": (1.2, 0.8), "pd_t2fnn_wide": (1.4, 0.6)}
NOISE = (0.0, 0.001, 0.005, 0.01, 0.02)
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# λ, 1/s, around the calibrated 1.975.
SLOPES = (1.0, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)
_POSITION = "control.position"
# Around the calibrated gains, 1.447 and 1.684, so far that the best lie in the middle.
_ALL_GAINS = (0.3, 20.0), (0.3, 12.0)
# Where they lie, to tell those for straight lines from those for curves.
_BEST_GAINS = (2.5, 9.0), (1.0, 4.5)


def noise_settings() -> dict[str, np.ndarray]:
    """Every noise of the cameras, "noise" in m, with every pair of exponents."""
    levels, exponents = np.meshgrid(NOISE, range(len(EXPONENTS)), indexing="ij")
    return {"noise": levels.ravel(), **_exponents(exponents.ravel())}


def share_settings() -> dict[str, np.ndarray]:
    """Every "q" with every pair of exponents."""
    shares, exponents = np.meshgrid(SHARES, range(len(EXPONENTS)), indexing="ij")
    return {"q": shares.ravel(), **_exponents(exponents.ravel())}


def _exponents(which: np.ndarray) -> dict[str, np.ndarray]:
    pairs = np.array(list(EXPONENTS.values()))[which]
    return {"a1": pairs[:, 0], "a2": pairs[:, 1]}


def slope_settings() -> dict[str, np.ndarray]:
    """Every "slope" λ (1/s)."""
    return {"slope": np.array(SLOPES)}


def gain_settings(count: int) -> dict[str, np.ndarray]:
    """A grid of so many "k_p" (1/s²) and "k_d" (1/s) on X and Y."""
    return _gains(count, *_ALL_GAINS)


def best_gain_settings(count: int) -> dict[str, np.ndarray]:
    """The same, of gains around the best."""
    return _gains(count, *_BEST_GAINS)


def _gains(count: int, k_p_range: tuple[float, float], k_d_range: tuple[float, float]) -> dict[str, np.ndarray]:
    k_p, k_d = np.meshgrid(np.geomspace(*k_p_range, count), np.geomspace(*k_d_range, count), indexing="ij")
    return {"k_p": k_p.ravel(), "k_d": k_d.ravel()}


_PATHS = {
    "noise": ["laboratory.motion_capture.position_noise"],
    "q": [f"{_POSITION}.network.q"],
    "a1": [f"{_POSITION}.network.a1"],
    "a2": [f"{_POSITION}.network.a2"],
    "k_p": [f"{_POSITION}.k_p.{axis}" for axis in (0, 1)],
    "k_d": [f"{_POSITION}.k_d.{axis}" for axis in (0, 1)],
    "slope": [f"{_POSITION}.learning.slope"],
}


def fly_settings(scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int]) -> Metrics:
    """The (settings, samples) metrics of a scenario with other numbers, in one fleet."""
    count = len(next(iter(settings.values())))
    varied = with_settings(scenario, settings, len(samples))
    metrics = StudyFleet(varied, count * len(samples)).fly([*samples] * count)
    return Metrics(*(values.reshape(count, -1) for values in metrics))


def fly_legs(scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int]) -> LegErrors:
    """The (settings, samples) errors leg by leg of a scenario with other numbers, in one recorded fleet."""
    count = len(next(iter(settings.values())))
    flights = simulate_samples(with_settings(scenario, settings, len(samples)), [*samples] * count)
    return LegErrors(*(values.reshape(count, -1) for values in leg_errors(flights)))


def with_settings(scenario: Scenario, settings: Mapping[str, np.ndarray], repetitions: int) -> Scenario:
    """The scenario of a fleet that flies settings one after the other, each so many times."""
    for name, values in settings.items():
        for path in _PATHS[name]:
            scenario = with_rows(scenario, path, np.repeat(values, repetitions))
    return scenario
