"""Result of an identification: estimates, the vehicle with these estimates, and its forecast of held-out flight."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from drake_quad.identification.evidence import quantile
from drake_quad.identification.prediction_errors import PredictionNoise
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.held_out import HeldOutErrors
from drake_quad.scenario.models import Scenario


class ForecastOutput(NamedTuple):
    """Forecast and measurements of one output, in windows of held-out flight.

    Attributes:
        name: name of the output, such as "position x".
        unit: unit of the output.
        time: (W, T) time, s, as if each window started at the end of the preceding window.
        measured: (W, T) measurements.
        predicted: (W, T) forecasts, without the measurements of the same window.
        explained_variance: fraction of the variance that the forecast explains, see
            `drake_quad.identification.forecast`; NaN if the output does not vary.
        deviation: estimated standard deviation of the white measurement noise.
    """

    name: str
    unit: str
    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray
    explained_variance: float
    deviation: float

    @property
    def residual(self) -> np.ndarray:
        """Errors of the forecasts, (W, T): measurements minus forecasts."""
        return self.measured - self.predicted


class EstimatedValue(NamedTuple):
    """Estimate with its uncertainty.

    Attributes:
        value: estimated value.
        deviation: standard deviation of the estimation error.
        unit: unit of the value and the standard deviation.
        degrees_of_freedom: degrees of freedom of the error, which follows Student's t-distribution.
    """

    value: float
    deviation: float
    unit: str
    degrees_of_freedom: float = np.inf

    @property
    def half_width(self) -> float:
        """Half-width of the 95 % interval."""
        return float(quantile(self.degrees_of_freedom)) * self.deviation


class FlightDifference(NamedTuple):
    """Difference of a flight from the mean of all flights, see `drake_quad.identification.flight_differences`.

    Attributes:
        name: name of the log.
        thrust: difference of the thrust at the same command, relative to the mean of all flights; None if there is only
            one flight.
        forces: mean trim force along x and y of B, N, by name. If the heading changes enough, `forces` also contains
            the mean force of a wind that is not logged, along x and y of W. It is empty if the logs lack positions or
            attitudes.
    """

    name: str
    thrust: EstimatedValue | None
    forces: Mapping[str, EstimatedValue]


@dataclass(frozen=True, eq=False)
class Identification:
    """Vehicle identified from logs.

    Attributes:
        estimates: estimates of the parameters with their covariance, and the reason for each parameter that is not
            identified.
        vehicle: initial scenario with the fit of the identified parameters, given the initial values of all others.
        outputs: forecasts and measurements of the held-out flight; empty if nothing was held out.
        delay: delay from a logged command to the logged measurement of its effect; None if it is not identified.
        noise: noise of the measurements and of the disturbance.
        remarks: remarks on the logs and the fit.
        held_out: coverage of the intervals in cross-validation, which holds out one tenth of the flight at a time, by
            the name of the parameter; empty if the flights are too short.
        training_vehicle: scenario with the estimates from the training data; None if nothing was held out.
        flights: difference of each flight from the mean of all flights.
        fitted: estimates of all fitted parameters in SI units, by name, also of those that are not identified. Their
            mean over many flights may be useful although no single flight identifies them.
    """

    estimates: Estimates
    vehicle: Scenario
    outputs: tuple[ForecastOutput, ...]
    delay: EstimatedValue | None = None
    noise: PredictionNoise | None = None
    remarks: tuple[str, ...] = ()
    held_out: Mapping[str, HeldOutErrors] = field(default_factory=dict)
    training_vehicle: Scenario | None = None
    flights: tuple[FlightDifference, ...] = ()
    fitted: Mapping[str, float] = field(default_factory=dict)
