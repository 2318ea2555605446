"""Check of confidence intervals by holding out one tenth of the flight at a time.

The flight is divided into ten stretches. Nine of them give an estimate, the variance P of its error, and the variance
d² between stretches. The tenth stretch gives an independent estimate, whose error has the variance v. The two estimates
should differ by no more than

    t √(P + d² + v),

where t is the 97.5 % quantile of Student's t-distribution with eight degrees of freedom. If the intervals are correct
95 % intervals, 9.5 of ten differences are inside on average, and at least nine are inside with a probability of 0.91.

Three approximations limit this check. The estimate of a stretch is one Gauss-Newton step from the estimate of all
windows. The variances d² and v contain the scatter of the windows within all stretches. If a stretch hardly determines
a parameter, the estimate from this stretch is the value from the fit to all windows.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.evidence import Evidence, quantile
from drake_quad.identification.random_effects import NUM_SEGMENTS, FlightSegments


class HeldOutErrors(NamedTuple):
    """Differences between the estimates of a parameter from held-out stretches and from the other stretches.

    Attributes:
        errors: (B,) estimate from each stretch minus the estimate from the other stretches.
        half_widths: (B,) half-width of each interval.
    """

    errors: np.ndarray
    half_widths: np.ndarray

    @property
    def num_covered(self) -> int:
        """Number of stretches whose absolute error is at most the half-width of their interval."""
        return int(np.sum(np.abs(self.errors) <= self.half_widths))


def hold_out_check(evidence: Evidence) -> dict[str, HeldOutErrors]:
    """Return the result of the check for each parameter, by name; empty if there are too few windows."""
    if len(evidence.scores) < NUM_SEGMENTS:
        return {}
    stretches = FlightSegments.of(evidence)
    errors, half_widths = [], []
    for held_out in range(NUM_SEGMENTS):
        others = stretches.without(held_out)
        mean_variance = np.diag(others.uncertainty().covariance)
        errors.append(stretches.estimates[held_out] - (evidence.values + others.step()))
        half_widths.append(
            quantile(NUM_SEGMENTS - 2)
            * np.sqrt(mean_variance + others.variance_between() + stretches.variances[held_out])
        )
    pairs = zip(evidence.names, np.transpose(errors), np.transpose(half_widths), strict=True)
    return {name: HeldOutErrors(*pair) for name, *pair in pairs}
