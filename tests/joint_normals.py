"""Means and covariance of the normal distributions in a scenario."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drake_quad.scenario.correlation import correlation_matrix
from drake_quad.scenario.distributions import Distribution, Normal


class JointNormal(NamedTuple):
    """Means and covariance of normal distributions before truncation.

    Attributes:
        paths: paths of the n fields.
        mean: (n,) means.
        covariance: (n, n) covariance matrix.
    """

    paths: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray


def joint_normal(distributions: Mapping[str, Distribution]) -> JointNormal:
    """Return the means and the covariance of all fields with a normal distribution.

    Args:
        distributions: distributions by the path of their field, as from `distributions_in`.
    """
    normal = {path: each for path, each in distributions.items() if isinstance(each, Normal)}
    mean = np.array([each.normal.mean for each in normal.values()])
    deviation = np.array([each.normal.standard_deviation for each in normal.values()])
    correlation = correlation_matrix(list(normal.values()))
    return JointNormal(tuple(normal), mean, correlation * np.outer(deviation, deviation))
