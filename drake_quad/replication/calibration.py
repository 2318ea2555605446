"""Calibration of parameters that the paper does not give. They are fitted to two cells of the paper's Table II.

The paper's PD has errors of about 1 m. Each hypothesis about the cause has two free parameters. The first is fitted to
the mean error of PD without wind, and then the second to the mean error of PD+T2FNN without wind. The errors of all
other cells are predictions.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.replication.published import Cell, published_table
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import Interval, values_with_crashes

PD_CELL, NETWORK_CELL = Cell("no_wind", "pd"), Cell("no_wind", "pd_t2fnn")
_DAMPING_RATIO = 0.7  # of the position loop with the PD
_FIT_TOLERANCE = 1e-3  # relative tolerance of the fitted parameters; the errors then agree to within 1 mm


class FreeParameter(NamedTuple):
    """Parameter of a scenario that is fitted.

    Attributes:
        label: name of the parameter, with its unit.
        low: smallest value that is tried.
        high: largest value that is tried.
        overrides: function from a value to the overrides that set it in a scenario.
    """

    label: str
    low: float
    high: float
    overrides: Callable[[float], list[str]]


class Hypothesis(NamedTuple):
    """Hypothesis about the cause of the PD's error of 1 m.

    Attributes:
        label: the cause in a few words.
        overrides: overrides of the paper's scenarios, for all controllers.
        pd: parameter that is fitted to the error of the PD.
        network: parameter that is fitted to the error of PD+T2FNN.
    """

    label: str
    overrides: list[str]
    pd: FreeParameter
    network: FreeParameter


class Calibration(NamedTuple):
    """Parameters that were fitted under a hypothesis, and the resulting errors.

    Attributes:
        hypothesis: hypothesis that was fitted.
        pd: fitted value of the PD's parameter.
        network: fitted value of the network's parameter.
        errors: mean RMSE of each cell of Table II, m; two of them are fitted, and the others are predicted.
    """

    hypothesis: Hypothesis
    pd: float
    network: float
    errors: Mapping[Cell, Interval]


def pd_gains(bandwidth: float) -> list[str]:
    """Return overrides for the gains of the PD on X and Y: k_P = ω² and k_D = 2 ζ ω, with ζ = 0.7.

    Args:
        bandwidth: bandwidth ω, rad/s.
    """
    k_p, k_d = bandwidth * bandwidth, 2.0 * _DAMPING_RATIO * bandwidth
    return [
        f"control.position.{name}.{axis}={gain!r}" for name, gain in (("k_p", k_p), ("k_d", k_d)) for axis in (0, 1)
    ]


def _bandwidth_parameter(low: float, high: float) -> FreeParameter:
    return FreeParameter("bandwidth of the PD (rad/s)", low, high, pd_gains)


def _offset_overrides(offset: float) -> list[str]:
    return [f"vehicle.centre_of_mass=[{offset!r}, {offset!r}]"]


def _slope_overrides(slope: float) -> list[str]:
    return [f"control.network.learning.slope={slope!r}"]


def _covariance_overrides(initial_covariance: float) -> list[str]:
    return [*_slope_overrides(1.0), f"control.network.learning.initial_covariance={initial_covariance!r}"]


_TRACKING_ERROR_DERIVATIVE = "control.position.derivative=tracking_error"
# Rounded gains that the first hypothesis yields. The third hypothesis assumes the same gains.
_BIAS_GAINS = pd_gains(1.2)

HYPOTHESES = {
    "measurement": Hypothesis(
        "derivative on the measurement",
        [],
        _bandwidth_parameter(0.9, 1.6),
        FreeParameter("slope λ (1/s)", 0.5, 2.5, _slope_overrides),
    ),
    "low_gain": Hypothesis(
        "derivative of the error, low gains",
        [_TRACKING_ERROR_DERIVATIVE],
        _bandwidth_parameter(0.35, 1.2),
        FreeParameter("initial covariance p₀ for λ = 1 1/s (1/s)", 0.03, 30.0, _covariance_overrides),
    ),
    "bias": Hypothesis(
        "derivative of the error, constant bias",
        [_TRACKING_ERROR_DERIVATIVE, *_BIAS_GAINS],
        FreeParameter("centre of mass, x and y (m)", 0.0, 0.005, _offset_overrides),
        FreeParameter("initial covariance p₀ for λ = 1 1/s (1/s)", 0.03, 30.0, _covariance_overrides),
    ),
}


def calibrate(
    hypothesis: Hypothesis, load: Callable[[Cell, list[str]], Scenario], num_samples: int, *, compiled: bool = True
) -> Calibration:
    """Fit the parameters of a hypothesis, and predict the errors of the other cells.

    Args:
        hypothesis: hypothesis that is fitted.
        load: function that loads the scenario of a cell with overrides.
        num_samples: number of samples over which errors are averaged; all flights use the same samples.
        compiled: True to compile the diagrams to machine code; False to simulate the uncompiled diagrams.

    Raises:
        InputError: if no value of a parameter reproduces the printed error.
    """
    printed = published_table()
    errors = partial(_errors, num_samples=num_samples, compiled=compiled)
    fixed = list(hypothesis.overrides)
    target = printed[PD_CELL].rmse.mean
    pd_value = _fit(hypothesis.pd, lambda more: errors(load(PD_CELL, [*fixed, *more])), target)
    fixed += hypothesis.pd.overrides(pd_value)
    target = printed[NETWORK_CELL].rmse.mean
    network_value = _fit(hypothesis.network, lambda more: errors(load(NETWORK_CELL, [*fixed, *more])), target)
    learning = hypothesis.network.overrides(network_value)
    predicted = {
        cell: mean_interval(errors(load(cell, fixed if cell.controller == "pd" else [*fixed, *learning])))
        for cell in printed
    }
    return Calibration(hypothesis, pd_value, network_value, predicted)


def _fit(parameter: FreeParameter, errors: Callable[[list[str]], np.ndarray], target: float) -> float:
    """Return the value of a parameter for which the mean error is equal to a target.

    Args:
        parameter: parameter that is fitted.
        errors: function from overrides to errors (n,), m.
        target: mean error to be reproduced, m.

    Raises:
        InputError: if no value in the range of the parameter reproduces the target.
    """

    def excess(value: float) -> float:
        return float(np.mean(errors(parameter.overrides(value)))) - target

    low, high = parameter.low, parameter.high
    ends = excess(low), excess(high)
    if not ends[0] * ends[1] < 0.0:
        raise InputError(
            f"no {parameter.label} between {low:g} and {high:g} reproduces the mean error of {target:g} m: the error"
            f" differs from the target by {ends[0]:+.3g} and {ends[1]:+.3g} m at the ends of the range"
        )
    return float(scipy.optimize.brentq(excess, low, high, rtol=_FIT_TOLERANCE, xtol=1e-9))


def _errors(scenario: Scenario, num_samples: int, *, compiled: bool = True) -> np.ndarray:
    """Return the RMSE (n,) of the first n samples, m; infinite for samples that crashed."""
    return values_with_crashes(fly_samples(scenario, range(num_samples), compiled=compiled), "rmse")
