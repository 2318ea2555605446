"""Rules that stop a study as soon as an estimate is precise enough.

A rule is evaluated only after fixed numbers of samples, so that the number and the speed of the workers do not affect
when a study ends. The interval of the estimate is that of a confidence sequence, which stays valid although it is
computed repeatedly (`drake_quad.statistics.sequential`).
"""

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names, short_repr
from drake_quad.laboratory.metrics import Metrics, metric_definitions
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.sequential import mean_sequence, probability_sequence
from drake_quad.studies.statistics import values_with_crashes, values_without_crashes

_CRASH = "crash"  # quantity of a rule about the probability of a crash
# Number of samples after which a rule is evaluated for the first time. It is large enough for the normal approximation
# of the mean.
_FIRST_CHECKPOINT = 256
_CHECKPOINT_RATIO = 1.25  # ratio between the numbers of samples at two successive evaluations of a rule
_RULE_PATTERN = re.compile(r"\s*(\w+)\s*(?:±|\+-|\+/-)\s*([^\s%]+)\s*(%?)\s*")


class StoppingRule(NamedTuple):
    """Rule that stops a study when the interval of an estimate is short enough.

    Attributes:
        quantity: name of a metric whose mean is estimated, or `crash` or the name of a requirement, whose probability
            is estimated.
        half_width: largest permitted half-width of the interval: absolute for a probability, and relative to the mean
            for a metric.
        is_probability: True if a probability is estimated.
    """

    quantity: str
    half_width: float
    is_probability: bool

    @classmethod
    def parse(cls, text: str, scenario: Scenario) -> "StoppingRule":
        """Return the rule that a text states, such as `crash ± 0.2 %` or `rmse ± 1 %`.

        Raises:
            InputError: if the text is not a rule, or the scenario has no such metric or requirement.
        """
        match = _RULE_PATTERN.fullmatch(text)
        if match is None or match[3] != "%":
            raise InputError(
                f"{short_repr(text)} is not a stopping rule; write it as in 'crash ± 0.2 %' or 'rmse ± 1 %'"
            )
        quantity, (number, _) = match[1], (match[2], match[3])
        try:
            half_width = 0.01 * parse_float(number)
        except ValueError:
            half_width = math.nan
        if not 0.0 < half_width < 1.0:
            raise InputError(f"{short_repr(text)} is not a stopping rule: the number must be above 0 % and below 100 %")
        requirements, metrics = [*scenario.requirements], [*metric_definitions(scenario.metrics_type)]
        if quantity not in (_CRASH, *metrics):
            raise InputError(
                f"{short_repr(text)}: {quantity} is not {_CRASH}, a requirement or a metric of {scenario.name};"
                f" choose from {join_names([*requirements, *(name for name in metrics if name not in requirements)])}"
            )
        return cls(quantity, half_width, quantity in (_CRASH, *requirements))

    def estimate(self, metrics: Metrics) -> Interval:
        """Return the estimate of the rule's mean or probability, with its interval, from the metrics of n flights."""
        if self.quantity == _CRASH:
            return probability_sequence(int(np.sum(metrics.crashed)), len(metrics.crashed))
        if self.is_probability:
            robustness = values_with_crashes(metrics, self.quantity)
            known = robustness[~np.isnan(robustness)]
            return probability_sequence(int(np.sum(known >= 0.0)), len(known))
        return mean_sequence(values_without_crashes(metrics, self.quantity))

    def text(self, metrics: Metrics) -> str:
        """Return the estimate of the rule's mean or probability as text, with its interval and unit."""
        if self.is_probability:
            return self.estimate(metrics).percent()
        definition = metrics.definitions[self.quantity]
        unit, size = (definition.unit, 1.0) if definition.display is None else definition.display[:2]
        return self.estimate(metrics).text(unit=unit, size=size)

    def is_met(self, metrics: Metrics) -> bool:
        """Return whether the confidence interval of the estimate is short enough to stop the study."""
        estimate = self.estimate(metrics)
        limit = self.half_width if self.is_probability else self.half_width * abs(estimate.value)
        return 0.5 * (estimate.high - estimate.low) <= limit


def checkpoints(num_samples: int) -> Iterator[int]:
    """Yield the numbers of samples after which rules are evaluated, up to the largest number of samples."""
    count = float(_FIRST_CHECKPOINT)
    while count < num_samples:
        yield round(count)
        count *= _CHECKPOINT_RATIO
    yield num_samples
