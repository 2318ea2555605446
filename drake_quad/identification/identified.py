"""What an identification hands back: estimates, the vehicle they make, and how well it predicts what was held out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

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
    """What logs tell of a vehicle.

    Attributes:
        estimates: numbers with their covariance, and why others are not seen.
        vehicle: the scenario that was begun with, with the estimates in the place of its numbers.
        outputs: of the model, beside what was measured.
        delay: from a command to what is measured of it; None if the log does not tell.
        further: numbers for the report, by what they are.
        remarks: sentences.
        held_out: how intervals hold for a tenth of the flights at a time, by the name of the number; empty if there is
            too little flight.
    """

    estimates: Estimates
    vehicle: Scenario
    outputs: tuple[Fitted, ...]
    delay: Spread | None = None
    further: dict[str, Spread] | None = None
    remarks: tuple[str, ...] = ()
    held_out: Mapping[str, HeldOut] = field(default_factory=dict)
