"""Reward and termination functions of environments."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.signals import Reference, State


class Transition(NamedTuple):
    """Step of all N vehicles; the fields of its records are (N,) arrays.

    Attributes:
        observation: (N, components) observations after the step.
        action: (N, components) actions of the step.
        last_action: (N, components) actions of the previous step; in the first step, the action with which the nominal
            vehicle hovers.
        state: true states after the step.
        reference: references after the step.
        time: (N,) times since the start of each episode, s.
        crashed: (N,) Booleans, True if the vehicle has crashed, whether or not into an obstacle.
        obstacle_hit: (N,) numbers of the obstacles that the vehicles hit, counted from 1; 0 if the vehicle hit none.
        signals: further requested signals, as records, keyed by name.
        metrics: (N,) values of the requested metrics up to this step, keyed by name. A metric is NaN before the first
            tick in its time window.
        metric_changes: (N,) changes of these values in this step, keyed by name. A metric starts at 0, and NaN counts
            as 0, so the changes of an episode add up to the metric of its flight.
    """

    observation: np.ndarray
    action: np.ndarray
    last_action: np.ndarray
    state: State
    reference: Reference
    time: np.ndarray
    crashed: np.ndarray
    obstacle_hit: np.ndarray
    signals: Mapping[str, Any]
    metrics: Mapping[str, np.ndarray]
    metric_changes: Mapping[str, np.ndarray]

    @property
    def position_error(self) -> np.ndarray:
        """(N,) distances of the vehicles from their references, m."""
        state, reference = self.state, self.reference
        x, y, z = reference.x - state.x, reference.y - state.y, reference.z - state.z
        with np.errstate(over="ignore", invalid="ignore"):  # the position of a crashed vehicle may be huge or NaN
            error: np.ndarray = np.sqrt(x * x + y * y + z * z)
        return error


Reward = Callable[[Transition], np.ndarray]
"""Function of a transition that returns (N,) rewards."""

Termination = Callable[[Transition], np.ndarray]
"""Function of a transition that returns (N,) Booleans, True if the episode of the vehicle ends."""


@dataclass(frozen=True)
class TrackingReward:
    """Reward for following the reference.

        tracking exp(-|e| / length) - effort |a|² - variation |a - a'|² - crash - obstacle + Σ w ΔM

    Here e is the position error, a is the action and a' is the previous action, both saturated at -1 and 1. The cost
    `crash` is subtracted in each step after which the vehicle has crashed. This is a single step if a crash ends the
    episode. If the vehicle crashed into an obstacle, the cost `obstacle` is subtracted, too. ΔM is the change in the
    step of a metric, or of the robustness of a requirement, and w is its weight. Over an episode, the reward therefore
    contains w times the metric of the flight.

    Attributes:
        tracking: reward of a step without position error.
        length: position error at which this reward has decreased to 1 / e = 37 %, m.
        effort: cost of an action whose norm is 1.
        variation: cost of a change of the action whose norm is 1.
        crash: cost of a crash.
        obstacle: additional cost of a crash into an obstacle.
        metrics: weights of metrics and requirements of the scenario, keyed by name. The weight of a metric that should
            be small is negative.

    With the default values, `scripts/train_policy.py` trains a policy that tracks within centimetres.

    Raises:
        InputError: if an attribute or a weight is not a finite number, or the length is not positive.
    """

    tracking: float = 1.0
    length: float = 0.3
    effort: float = 0.01
    variation: float = 0.05
    crash: float = 10.0
    obstacle: float = 0.0
    metrics: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        """Check the attributes."""
        if not isinstance(self.metrics, Mapping):
            raise InputError(f"metrics is {short_repr(self.metrics)}, but must be a mapping from names to weights")
        numbers = {name: value for name, value in vars(self).items() if name != "metrics"}
        for name, value in {**numbers, **{f"metrics.{name}": each for name, each in self.metrics.items()}}.items():
            if not isinstance(value, int | float | np.number) or not np.isfinite(value):
                raise InputError(f"{name} is {short_repr(value)}, but must be a finite number")
        if self.length <= 0.0:
            raise InputError(f"length is {self.length}, but must be larger than 0")

    def __call__(self, step: Transition) -> np.ndarray:
        """Return the (N,) rewards of a step.

        Raises:
            InputError: if a metric is infinite, such as the settling time of a vehicle that has not settled.
        """
        action = np.clip(step.action, -1.0, 1.0)
        change = action - np.clip(step.last_action, -1.0, 1.0)
        reward: np.ndarray = (
            self.tracking * np.exp(step.position_error / -self.length)
            - self.effort * np.einsum("ij,ij->i", action, action)
            - self.variation * np.einsum("ij,ij->i", change, change)
            - self.crash * step.crashed
            - self.obstacle * (step.obstacle_hit > 0)
        )
        for name, weight in self.metrics.items():
            change = step.metric_changes[name]
            if not np.isfinite(change).all():
                raise InputError(
                    f"the metric {name} can be infinite during a flight, so it cannot be a term of the reward"
                )
            reward = reward + weight * change
        return reward


def has_crashed(step: Transition) -> np.ndarray:
    """Return which vehicles have crashed at a step, a Boolean array (N,)."""
    return step.crashed
