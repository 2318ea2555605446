"""Parameter sweeps: simulations of the same Monte Carlo samples with several settings of a scenario's parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from drake_quad.files import write_table
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_batch
from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication.measures import LegMetrics, leg_metrics
from drake_quad.reports.results import read_columns
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario

MetricsType = TypeVar("MetricsType", Metrics, LegMetrics)


@dataclass(frozen=True)
class Sweep(Generic[MetricsType]):
    """Metrics of the same samples of a scenario, for several settings of its parameters.

    Attributes:
        settings: (settings,) values of each varied parameter, keyed by name.
        samples: (samples,) indices of the samples, which are the same for each setting.
        metrics: (settings, samples) values of each metric.
    """

    settings: Mapping[str, np.ndarray]
    samples: np.ndarray
    metrics: MetricsType

    def save(self, path: Path) -> Path:
        """Write a row for each setting and sample, and return the path."""
        values = {name: np.ravel(values) for name, values in self.metrics._asdict().items()}
        return write_table(path, all_combinations(self.settings, {"sample": self.samples}) | values)


def num_rows(columns: Mapping[str, np.ndarray]) -> int:
    """Return the number of rows of a table, given its columns."""
    return len(next(iter(columns.values())))


def all_combinations(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Combine each row of one table with each row of another table, and return the columns of the result.

    The rows of the result are sorted by the row of the first table, and then by the row of the second table.
    """
    num_first, num_second = num_rows(first), num_rows(second)
    repeated = {name: np.repeat(values, num_second) for name, values in first.items()}
    return repeated | {name: np.tile(values, num_first) for name, values in second.items()}


def load_sweep(path: Path, kind: type[MetricsType]) -> Sweep[MetricsType]:
    """Read a sweep from a file that `Sweep.save` wrote.

    Args:
        path: path of the CSV file.
        kind: class of the metrics in the file, `Metrics` or `LegMetrics`.

    Raises:
        InputError: if the file cannot be read.
    """
    fields: tuple[str, ...] = kind._fields
    table = read_columns(path, ("sample", *fields))
    samples = np.unique(table.pop("sample")).astype(int)
    metrics = kind(*(table.pop(name).reshape(-1, len(samples)) for name in fields))
    return Sweep({name: values[:: len(samples)] for name, values in table.items()}, samples, metrics)


# Exponents (a1, a2) of the networks in Table II. Exponents of 1 give the triangular sets of type 1.
EXPONENTS = {"pd_t1fnn": (1.0, 1.0), "pd_t2fnn": (1.2, 0.8), "pd_t2fnn_wide": (1.4, 0.6)}
NOISE_LEVELS = (0.0, 0.001, 0.005, 0.01, 0.02)  # m, standard deviations of the position noise
Q_VALUES = (0.0, 0.25, 0.5, 0.75, 1.0)  # values of the weight q of the lower memberships
SLOPES = (1.0, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)  # 1/s, values of λ around the calibrated 1.975 1/s
_POSITION = "control.position"
_NETWORK = "control.network"
# Ranges of k_P (1/s²) and k_D (1/s) around the calibrated gains of 1.447 and 1.684. They are wide enough to contain the
# gains with the smallest error.
_GAIN_RANGES = (0.3, 20.0), (0.3, 12.0)
# Narrower ranges of k_P and k_D around the best gains. Their finer grid can distinguish the best gains on straight
# lines from the best gains on curves.
BEST_GAIN_RANGES = (2.5, 9.0), (1.0, 4.5)
_EXPONENTS = dict(zip(("a1", "a2"), np.transpose([*EXPONENTS.values()]), strict=True))
# Settings of the sweeps: all noise levels and all values of q are combined with all pairs of exponents.
NOISE_SETTINGS = all_combinations({"noise": np.array(NOISE_LEVELS)}, _EXPONENTS)
Q_SETTINGS = all_combinations({"q": np.array(Q_VALUES)}, _EXPONENTS)
SLOPE_SETTINGS = {"slope": np.array(SLOPES)}


def gain_settings(count: int, ranges: tuple[tuple[float, float], ...] = _GAIN_RANGES) -> dict[str, np.ndarray]:
    """Return a square grid of "k_p" (1/s²) and "k_d" (1/s), which apply to both X and Y.

    Args:
        count: number of gains along each side.
        ranges: smallest and largest k_p, and smallest and largest k_d.
    """
    k_p, k_d = (np.geomspace(*ends, count) for ends in ranges)
    return all_combinations({"k_p": k_p}, {"k_d": k_d})


# For each parameter of a sweep, the paths of the fields that are set to its value.
_FIELD_PATHS = {
    "noise": ["laboratory.motion_capture.position_noise"],
    "q": [f"{_NETWORK}.q"],
    "a1": [f"{_NETWORK}.a1"],
    "a2": [f"{_NETWORK}.a2"],
    "k_p": [f"{_POSITION}.k_p.{axis}" for axis in (0, 1)],
    "k_d": [f"{_POSITION}.k_d.{axis}" for axis in (0, 1)],
    "slope": [f"{_NETWORK}.learning.slope"],
}


def fly_settings(
    scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int], *, compiled: bool = True
) -> Metrics:
    """Simulate the same samples with each setting, in one fleet, and return metrics of shape (settings, samples)."""
    batch = settings_batch(scenario, settings, samples)
    metrics = StudyFleet(scenario, plan_route(scenario), len(batch), compiled=compiled).fly_batch(batch)
    return metrics.with_values(np.reshape(metrics, (-1, num_rows(settings), len(samples))))


def fly_legs(
    scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int], *, compiled: bool = True
) -> LegMetrics:
    """Simulate the same samples with each setting, record them, and return leg metrics (settings, samples)."""
    flights = simulate_batch(settings_batch(scenario, settings, samples), compiled=compiled)
    return LegMetrics(*np.reshape(leg_metrics(flights), (-1, num_rows(settings), len(samples))))


def settings_batch(scenario: Scenario, settings: Mapping[str, np.ndarray], samples: Sequence[int]) -> Batch:
    """Return a batch that contains all samples with the first setting, then all samples with the second, and so on."""
    columns = all_combinations(settings, {"sample": np.asarray(samples)})
    varying = {path: columns[name] for name in settings for path in _FIELD_PATHS[name]}
    return Batch.draw(scenario, columns["sample"].tolist()).with_varying(varying)
