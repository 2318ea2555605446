"""Invented experiment whose results scatter around known levels."""

import functools

import numpy as np

from drake_quad import load_scenario
from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication.measures import EFFORTS, LegMetrics
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell
from drake_quad.replication.results import FAIR_CONTROLLERS, MAPPED_CONTROLLERS, Experiment, select_cells
from drake_quad.replication.sweeps import NOISE_SETTINGS, Q_SETTINGS, SLOPES, Sweep, all_combinations
from drake_quad.studies.study import Study


@functools.cache
def paper_scenario():
    """Return one scenario of the paper, for studies whose metrics are invented."""
    return load_scenario("diagrams/paper.yaml:low_wind_pd_t2fnn")


def metrics_of(rng, shape, level=1.0, crashes=0.0):
    """Return metrics that scatter around a level, with outliers in crashed samples."""
    values = {name: level * rng.uniform(0.9, 1.1, shape) for name in Metrics._fields}
    crashed = rng.uniform(size=shape) < crashes
    values["rmse"] = np.where(crashed, 0.01, values["rmse"])
    return Metrics(**(values | {"crash_time": np.where(crashed, 3.0, np.inf)}))


def invented_experiment(num_samples=6, *, crashes=0.0, seed=4):
    """Return an experiment whose results are random numbers, so that nothing has to be simulated.

    Args:
        num_samples: number of samples of each cell.
        crashes: fraction of samples that crash.
        seed: seed of the scatter.
    """
    rng = np.random.default_rng(seed)
    levels = dict(zip((*CONTROLLERS, *FAIR_CONTROLLERS), (1.0, 0.8, 0.45, 0.55, 0.7, 0.65, 0.3, 0.25), strict=True))
    winds = {"no_wind": 1.0, "low_wind": 1.3, "high_wind": 0.9}
    cells = {}
    for cell in select_cells((*CONTROLLERS, *FAIR_CONTROLLERS)):
        metrics = metrics_of(rng, num_samples, winds[cell.wind] * levels[cell.controller], crashes)
        cells[cell] = Study(paper_scenario(), 27.0, np.arange(num_samples), {}, metrics)
    numbers = [f"{name}_{axis}" for name in EFFORTS for axis in "xy"] + ["pd_fade", "pd_return", "path_error"]
    recorded = {
        cell: {name: levels[cell.controller] * rng.uniform(0.5, 1.5, 4) for name in numbers}
        for cell in select_cells(CONTROLLERS)
    }
    recorded[Cell("no_wind", "pd_t2fnn")]["pd_fade"][1] = np.nan
    noise, fractions = (
        Sweep(settings, np.arange(6), metrics_of(rng, (15, 6), crashes=0.03))
        for settings in (NOISE_SETTINGS, Q_SETTINGS)
    )
    slope = {"slope": np.array(SLOPES)}
    slopes = {wind: Sweep(slope, np.arange(1, 4), metrics_of(rng, (len(SLOPES), 3), 0.5)) for wind in WINDS}
    gains = all_combinations({"k_p": np.array([1.0, 2.0, 4.0])}, {"k_d": np.array([0.5, 1.0])})
    maps = {
        name: Sweep(gains, np.arange(4), metrics_of(rng, (6, 4), crashes=fraction))
        for name, fraction in zip(MAPPED_CONTROLLERS, (0.1, 0.2), strict=True)
    }
    for sweep in maps.values():
        sweep.metrics.rmse[:3] *= 2.0
    legs = Sweep(gains, np.arange(16), LegMetrics(*(rng.uniform(0.5, 1.5, (6, 16)) for _ in range(3))))
    legs.metrics.straight[2, 0] = np.nan
    return Experiment(cells, recorded, noise, fractions, slopes, maps, legs)
