"""Checks and corrections that make given or drawn moments of inertia possible for a rigid body."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drake_quad.scenario.distributions import NumberOrDistribution
from drake_quad.scenario.quantities import extremes
from drake_quad.vehicle import rigid_body

INERTIA_RULE = (
    "; no moment may exceed the sum of the other two, and impossible random values are replaced by the nearest possible"
    " ones"
)


def explain_invalid_inertia(moments: Sequence[NumberOrDistribution]) -> str:
    """Return an error message if no draw of the moments of inertia is possible for a rigid body; empty otherwise."""
    lowest, _ = bounds = _bounds(moments)
    flaw = rigid_body.explain_invalid_inertia(rigid_body.nearest_rigid_inertia(lowest, *bounds).tolist())
    drawn = not all(isinstance(moment, float) for moment in moments)
    return f"must belong to a rigid body: {'for every draw, ' * drawn}{flaw}" if flaw else ""


def rigid_inertias(moments: Sequence[NumberOrDistribution], drawn: Sequence[Any]) -> np.ndarray:
    """Move drawn moments of inertia to the nearest values that are possible for a rigid body.

    Args:
        moments: I_xx, I_yy, I_zz of the scenario, as numbers or distributions, kg m². Numbers are never changed.
        drawn: values of the three moments, each a number or an (N,) array, kg m².

    Returns:
        (3, N) moments, kg m².
    """
    return rigid_body.nearest_rigid_inertia(drawn, *_bounds(moments))


def _bounds(moments: Sequence[NumberOrDistribution]) -> tuple[list[float], list[float]]:
    """Return the smallest and the largest possible value of each moment, kg m²."""
    ends = [extremes(moment) for moment in moments]
    return [low or 0.0 for low, _ in ends], [math.inf if high is None else high for _, high in ends]
