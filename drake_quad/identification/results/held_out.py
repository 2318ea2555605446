"""Do intervals hold for flight that was not seen? A tenth of the flights is held out at a time.

Nine stretches give the numbers, what the numbers' mean is off by, P, and what they vary by from stretch to stretch, d².
The tenth alone gives an estimate whose own error has the variance v. It should be within

    ± t √(P + d² + v)

of that of the nine, t of Student's distribution with eight degrees of freedom: for 95 %, in 9.5 of ten stretches in the
mean, and at least in nine with a probability of 0.91. Estimates of stretches are one step of Gauss and Newton from the
fit to all. What is held out is not in P but for the noise that weighs the errors; d² and v also have by how much
windows within all stretches differ. A stretch that hardly tells a number is drawn to the fit to all, and says little.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.evidence import Evidence
from drake_quad.identification.random_effects import STRETCHES, Stretches
from drake_quad.identification.results.estimates import quantile


class HeldOut(NamedTuple):
    """What stretches say of a number that were held out, one after another.

    Attributes:
        off: (B,) estimate of each minus that of the others.
        reach: (B,) of the interval to each side.
    """

    off: np.ndarray
    reach: np.ndarray

    @property
    def covered(self) -> int:
        """In how many stretches the interval holds."""
        return int(np.sum(np.abs(self.off) <= self.reach))


def hold_out(evidence: Evidence) -> dict[str, HeldOut]:
    """What stretches say that are held out, by the name of each number; empty if windows are too few."""
    if len(evidence.scores) < STRETCHES:
        return {}
    stretches = Stretches.of(evidence)
    off, reach = [], []
    for b in range(STRETCHES):
        others = stretches.without(b)
        mean = np.diag(others.mean().covariance)
        off.append(stretches.estimates[b] - (evidence.values - others.move()))
        reach.append(quantile(STRETCHES - 2) * np.sqrt(mean + others.between() + stretches.variances[b]))
    pairs = zip(evidence.names, np.transpose(off), np.transpose(reach), strict=True)
    return {name: HeldOut(*pair) for name, *pair in pairs}
