"""Moments of inertia in the scenario language: those of a rigid body, also where they are drawn."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from drake_quad.scenario.distributions import NumberOrDistribution
from drake_quad.scenario.quantities import extremes
from drake_quad.vehicle import rigid_body

INERTIA_RULE = (
    "; no moment may exceed the sum of the other two, and draws that do are replaced by the nearest that do not"
)
INERTIA_DEMAND: Literal["must be that of a rigid body: {flaw}"] = "must be that of a rigid body: {flaw}"


def inertia_flaw(moments: Sequence[NumberOrDistribution]) -> str:
    """Return why no rigid body has moments of inertia, whatever is drawn, in words; empty if one has."""
    lowest, _ = bounds = _bounds(moments)
    flaw = rigid_body.inertia_flaw(rigid_body.nearest_rigid(lowest, *bounds).tolist())
    drawn = not all(isinstance(moment, float) for moment in moments)
    return f"whatever is drawn, {flaw}" if flaw and drawn else flaw


def rigid_draws(moments: Sequence[NumberOrDistribution], drawn: Sequence[Any]) -> np.ndarray:
    """Return the (3, N) nearest moments of inertia that a rigid body can have to those that were drawn.

    Args:
        moments: I_xx, I_yy, I_zz as the scenario has them; numbers stay as they are.
        drawn: a number or an (N,) array for each, kg m².
    """
    return rigid_body.nearest_rigid(drawn, *_bounds(moments))


def _bounds(moments: Sequence[NumberOrDistribution]) -> tuple[list[float], list[float]]:
    """Return the least and the largest that each moment can be."""
    ends = [extremes(moment) for moment in moments]
    return [low or 0.0 for low, _ in ends], [math.inf if high is None else high for _, high in ends]
