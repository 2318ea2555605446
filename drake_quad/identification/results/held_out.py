"""Check of confidence intervals on flight that was held out, one tenth at a time.

Nine stretches give the estimates, the variance P of their errors, and the variance d² between stretches. The tenth
stretch alone gives an estimate with an error of variance v. It should differ from that of the nine by no more than

    ± t √(P + d² + v),

where t is the quantile of Student's distribution with eight degrees of freedom. For 95 % intervals, 9.5 of ten
stretches are inside on average, and at least nine with a probability of 0.91.

Three approximations limit this check. Estimates of stretches are one Gauss-Newton step from the fit to all windows. The
variances d² and v contain the scatter of the windows within all stretches. A stretch that hardly determines a parameter
keeps the value of the fit to all windows.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.evidence import Evidence
from drake_quad.identification.random_effects import NUM_STRETCHES, Stretches
from drake_quad.identification.results.estimates import quantile


class HeldOut(NamedTuple):
    """Estimates of a parameter from stretches that were held out one after another.

    Attributes:
        errors: (B,) estimate from each stretch minus that from the other stretches.
        reach: (B,) half of the length of each interval.
    """

    errors: np.ndarray
    reach: np.ndarray

    @property
    def covered(self) -> int:
        """Number of stretches whose estimate is inside the interval."""
        return int(np.sum(np.abs(self.errors) <= self.reach))


def hold_out(evidence: Evidence) -> dict[str, HeldOut]:
    """Return the check for each parameter, by its name; empty if there are too few windows."""
    if len(evidence.scores) < NUM_STRETCHES:
        return {}
    stretches = Stretches.of(evidence)
    errors, reach = [], []
    for b in range(NUM_STRETCHES):
        others = stretches.without(b)
        mean = np.diag(others.uncertainty().covariance)
        errors.append(stretches.estimates[b] - (evidence.values + others.step()))
        reach.append(quantile(NUM_STRETCHES - 2) * np.sqrt(mean + others.variance_between() + stretches.variances[b]))
    pairs = zip(evidence.names, np.transpose(errors), np.transpose(reach), strict=True)
    return {name: HeldOut(*pair) for name, *pair in pairs}
