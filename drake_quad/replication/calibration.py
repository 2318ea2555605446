"""Fitting what the paper does not give to two cells of its table.

Each hypothesis of what makes a PD 1 m off has two free numbers: one for the PD, one for the network. They are fitted,
one after the other, to the mean error of PD and of PD+T2FNN without wind. What it then says of all other cells is a
prediction.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from drake_quad.studies.statistics import Interval, mean_interval
from drake_quad.replication.printed import Cell, table_ii
from drake_quad.errors import InputError
from drake_quad.scenario import Scenario
from drake_quad.flight.fleet import StudyFleet

PD_CELL, NETWORK_CELL = Cell("no_wind", "pd"), Cell("no_wind", "pd_t2fnn")
_DAMPING = 0.7
# Relative; the errors that follow are within a millimetre.
_TOLERANCE = 1e-3


class FreeNumber(NamedTuple):
    """A number to fit.

    Attributes:
        words: what it is, with its unit.
        low: the least to try.
        high: the largest.
        overrides: of a scenario, for a value.
    """

    words: str
    low: float
    high: float
    overrides: Callable[[float], list[str]]


class Hypothesis(NamedTuple):
    """Why the PD is 1 m off.

    Attributes:
        words: in a few.
        overrides: what it changes in the scenarios of the paper, for all controllers.
        pd: the number that is fitted to the error of the PD.
        network: the one that is fitted to that of PD+T2FNN.
    """

    words: str
    overrides: list[str]
    pd: FreeNumber
    network: FreeNumber


class Calibration(NamedTuple):
    """A fitted hypothesis.

    Attributes:
        hypothesis: that was fitted.
        pd: its first number.
        network: its second.
        errors: mean RMSE of each cell of the table, m; those of the two cells are fitted, the others predicted.
    """

    hypothesis: Hypothesis
    pd: float
    network: float
    errors: Mapping[Cell, Interval]


def pd_gains(bandwidth: float) -> list[str]:
    """Overrides for the gains of a horizontal PD: k_P = ω², k_D = 2 ζ ω, with ζ = 0.7.

    Args:
        bandwidth: ω, rad/s.
    """
    k_p, k_d = bandwidth * bandwidth, 2.0 * _DAMPING * bandwidth
    return [
        f"control.position.{name}.{axis}={gain!r}" for name, gain in (("k_p", k_p), ("k_d", k_d)) for axis in (0, 1)
    ]


def _bandwidth(low: float, high: float) -> FreeNumber:
    return FreeNumber("bandwidth of the PD (rad/s)", low, high, pd_gains)


def _offset(offset: float) -> list[str]:
    return [f"vehicle.centre_of_mass=[{offset!r}, {offset!r}]"]


def _slope(slope: float) -> list[str]:
    return [f"control.position.learning.slope={slope!r}"]


def _speed(initial_covariance: float) -> list[str]:
    return [*_slope(1.0), f"control.position.learning.initial_covariance={initial_covariance!r}"]


_TRACKING = "control.position.derivative=tracking_error"
# Of the first hypothesis, rounded; the bias is all that is new in the third.
_SAME_GAINS = pd_gains(1.2)

HYPOTHESES = {
    "measurement": Hypothesis(
        "derivative on the measurement", [], _bandwidth(0.9, 1.6), FreeNumber("slope λ (1/s)", 0.5, 2.5, _slope)
    ),
    "low_gain": Hypothesis(
        "derivative of the error, low gains",
        [_TRACKING],
        _bandwidth(0.35, 1.2),
        FreeNumber("initial covariance p₀ (1/s), λ = 1/s", 0.03, 30.0, _speed),
    ),
    "bias": Hypothesis(
        "derivative of the error, constant bias",
        [_TRACKING, *_SAME_GAINS],
        FreeNumber("centre of mass, x and y (m)", 0.0, 0.005, _offset),
        FreeNumber("initial covariance p₀ (1/s), λ = 1/s", 0.03, 30.0, _speed),
    ),
}


def calibrate(hypothesis: Hypothesis, load: Callable[[Cell, list[str]], Scenario], num_samples: int) -> Calibration:
    """Fits a hypothesis and predicts the other cells.

    Args:
        hypothesis: to fit.
        load: gives the scenario of a cell with overrides.
        num_samples: over which errors are averaged, the same ones each time.

    Raises:
        InputError: no number within its limits gives the printed error.
    """
    printed = table_ii()
    fixed = list(hypothesis.overrides)
    x = _fitted(hypothesis.pd, lambda more: load(PD_CELL, [*fixed, *more]), printed[PD_CELL].rmse.mean, num_samples)
    fixed += hypothesis.pd.overrides(x)
    target = printed[NETWORK_CELL].rmse.mean
    y = _fitted(hypothesis.network, lambda more: load(NETWORK_CELL, [*fixed, *more]), target, num_samples)
    learning = hypothesis.network.overrides(y)
    errors = {
        cell: mean_interval(_errors(load(cell, fixed if cell.controller == "pd" else [*fixed, *learning]), num_samples))
        for cell in printed
    }
    return Calibration(hypothesis, x, y, errors)


def _fitted(number: FreeNumber, make: Callable[[list[str]], Scenario], target: float, num_samples: int) -> float:
    """The value with which the mean error is the target (m)."""

    def excess(value: float) -> float:
        return float(np.mean(_errors(make(number.overrides(value)), num_samples))) - target

    ends = excess(number.low), excess(number.high)
    if not ends[0] * ends[1] < 0.0:
        raise InputError(
            f"{number.words} from {number.low:g} to {number.high:g} leaves the error {ends[0]:+.3g} to {ends[1]:+.3g} m"
            f" from {target:g} m; there is nothing to fit"
        )
    return float(brentq(excess, number.low, number.high, rtol=_TOLERANCE, xtol=1e-9))


def _errors(scenario: Scenario, num_samples: int) -> np.ndarray:
    """(n,) RMSE of samples, m; a crashed one counts as infinite."""
    metrics = StudyFleet(scenario, num_samples).fly(range(num_samples))
    return np.where(metrics.crashed, math.inf, metrics.rmse)
