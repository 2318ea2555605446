"""Calibration of numbers that the paper does not give, by a fit to two cells of its table.

The errors of the paper's PD are about 1 m. Each hypothesis on the reason has two free numbers, one of the PD and one of
the network. They are fitted, one after the other, to the mean errors of PD and of PD+T2FNN without wind. The errors of
all other cells are then predictions.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.replication.printed import Cell, printed_table
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import Interval, values_with_crashes

PD_CELL, NETWORK_CELL = Cell("no_wind", "pd"), Cell("no_wind", "pd_t2fnn")
_DAMPING = 0.7
# Relative tolerance of the fitted numbers; the errors are then within a millimetre.
_TOLERANCE = 1e-3


class FreeNumber(NamedTuple):
    """Number that is fitted.

    Attributes:
        words: name of the number, with its unit.
        low: smallest value that is tried.
        high: largest value that is tried.
        overrides: function from a value to the overrides that set it in a scenario.
    """

    words: str
    low: float
    high: float
    overrides: Callable[[float], list[str]]


class Hypothesis(NamedTuple):
    """Possible reason for the PD's error of 1 m.

    Attributes:
        words: reason in a few words.
        overrides: overrides of the paper's scenarios with all controllers.
        pd: number that is fitted to the error of the PD.
        network: number that is fitted to the error of PD+T2FNN.
    """

    words: str
    overrides: list[str]
    pd: FreeNumber
    network: FreeNumber


class Calibration(NamedTuple):
    """Fitted hypothesis.

    Attributes:
        hypothesis: hypothesis that was fitted.
        pd: fitted number of the PD.
        network: fitted number of the network.
        errors: mean RMSE of each cell of the table, m; two of them are fitted, and the others are predicted.
    """

    hypothesis: Hypothesis
    pd: float
    network: float
    errors: Mapping[Cell, Interval]


def pd_gains(bandwidth: float) -> list[str]:
    """Return overrides for the gains of the horizontal PD: k_P = ω² and k_D = 2 ζ ω, with ζ = 0.7.

    Args:
        bandwidth: bandwidth ω, rad/s.
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
    return [f"control.network.learning.slope={slope!r}"]


def _speed(initial_covariance: float) -> list[str]:
    return [*_slope(1.0), f"control.network.learning.initial_covariance={initial_covariance!r}"]


_TRACKING = "control.position.derivative=tracking_error"
# These are the rounded gains of the first hypothesis. The third one has the same gains, and in addition a bias.
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


def calibrate(
    hypothesis: Hypothesis, load: Callable[[Cell, list[str]], Scenario], num_samples: int, *, compiled: bool = True
) -> Calibration:
    """Fit the numbers of a hypothesis, and predict the errors of the other cells.

    Args:
        hypothesis: hypothesis that is fitted.
        load: function that loads the scenario of a cell with overrides.
        num_samples: number of samples over which errors are averaged; the same samples are used for all flights.
        compiled: True to compile the diagrams to machine code. Otherwise the original diagrams are simulated.

    Raises:
        InputError: no value of a number reproduces the printed error.
    """
    printed = printed_table()
    errors = partial(_errors, num_samples=num_samples, compiled=compiled)
    fixed = list(hypothesis.overrides)
    x = _fitted(hypothesis.pd, lambda more: errors(load(PD_CELL, [*fixed, *more])), printed[PD_CELL].rmse.mean)
    fixed += hypothesis.pd.overrides(x)
    target = printed[NETWORK_CELL].rmse.mean
    y = _fitted(hypothesis.network, lambda more: errors(load(NETWORK_CELL, [*fixed, *more])), target)
    learning = hypothesis.network.overrides(y)
    predicted = {
        cell: mean_interval(errors(load(cell, fixed if cell.controller == "pd" else [*fixed, *learning])))
        for cell in printed
    }
    return Calibration(hypothesis, x, y, predicted)


def _fitted(number: FreeNumber, errors: Callable[[list[str]], np.ndarray], target: float) -> float:
    """Return the value of a number for which the mean error is equal to a target.

    Args:
        number: number that is fitted.
        errors: function from overrides to errors (n,), m.
        target: mean error that is to be reproduced, m.

    Raises:
        InputError: no value in the range of the number reproduces the target.
    """

    def excess(value: float) -> float:
        return float(np.mean(errors(number.overrides(value)))) - target

    ends = excess(number.low), excess(number.high)
    if not ends[0] * ends[1] < 0.0:
        raise InputError(
            f"{number.words} from {number.low:g} to {number.high:g} leaves the error {ends[0]:+.3g} to {ends[1]:+.3g} m"
            f" from {target:g} m; there is nothing to fit"
        )
    return float(scipy.optimize.brentq(excess, number.low, number.high, rtol=_TOLERANCE, xtol=1e-9))


def _errors(scenario: Scenario, num_samples: int, *, compiled: bool = True) -> np.ndarray:
    """Return the RMSE (n,) of the first n samples, m; infinite for those that crashed."""
    return values_with_crashes(fly_samples(scenario, range(num_samples), compiled=compiled), "rmse")
