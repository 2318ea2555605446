"""What an identification hands back: estimates, the vehicle they make, and how well it predicts what was held out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from drake_quad.identification.forecast import Forecast
from drake_quad.identification.prediction_errors import PredictionNoise
from drake_quad.identification.results.estimates import Estimates, quantile
from drake_quad.identification.results.held_out import HeldOut
from drake_quad.scenario.models import Scenario


class Fitted(NamedTuple):
    """An output of the model beside what was measured, in windows one after another.

    Attributes:
        name: of the output, as in "position x".
        unit: of it.
        log: (W,) name of the log of each window.
        time: (W, T) of the samples, s.
        measured: (W, T).
        predicted: (W, T) from an initial state that is fitted in each window.
        held_out: (W,) True for windows that the parameters have not seen.
        share: of the variance explained in windows that were held out: beyond what a straight line explains that is
            fitted in each window, as the initial state is; NaN if none was held out.
        share_fitted: the same in windows that were fitted.
        deviation: of the white part of the residuals, unit.
    """

    name: str
    unit: str
    log: np.ndarray
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    held_out: np.ndarray
    share: float
    share_fitted: float
    deviation: float

    @property
    def residual(self) -> np.ndarray:
        """(W, T) measured minus predicted."""
        return self.measured - self.predicted


class Spread(NamedTuple):
    """A number that is not of the vehicle's language, with its standard deviation.

    Attributes:
        value: of it.
        deviation: of its error.
        unit: of both.
        degrees_of_freedom: of Student's distribution of the error.
    """

    value: float
    deviation: float
    unit: str
    degrees_of_freedom: float = np.inf

    @property
    def reach(self) -> float:
        """Of the 95 % interval to each side."""
        return float(quantile(self.degrees_of_freedom)) * self.deviation


@dataclass(frozen=True, eq=False)
class Identification:
    """Vehicle identified from logs.

    Attributes:
        estimates: estimates of the parameters with their covariance, and the reason for each parameter that is not
            identified.
        vehicle: initial scenario with the estimates in place of its values.
        outputs: forecasts of the held-out flight, beside the measurements; empty if nothing was held out.
        delay: delay from a logged command to the logged measurement of its effect; None if it is not identified.
        noise: noise of the measurements and of the disturbance.
        forecast: forecast of the held-out flight by a fit to the rest; None if nothing was held out.
        remarks: sentences on the fit.
        held_out: coverage of the intervals when a tenth of the flight at a time is left out, by the name of the
            parameter; empty if there is too little flight.
    """

    estimates: Estimates
    vehicle: Scenario
    outputs: tuple[Fitted, ...]
    delay: Spread | None
    noise: PredictionNoise
    forecast: Forecast | None
    remarks: tuple[str, ...] = ()
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
