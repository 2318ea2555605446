"""What a step is worth, and when a flight ends: functions of a transition."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.signals import Reference, State


class Transition(NamedTuple):
    """A step of all N vehicles. Rows are (N,) arrays.

    Attributes:
        observation: (N, rows) after the step.
        action: (N, rows).
        last_action: (N, rows) of the step before, or what is believed to hover if there was none.
        state: of the vehicles, as they are.
        reference: to follow.
        time: of the flights, s.
        crashed: whether a vehicle has crashed, into an obstacle or otherwise.
        touched: number of the obstacle that it crashed into, from 1 on; 0 if it touched none.
        signals: the further signals that were asked for, as records, by name.
    """

    observation: np.ndarray
    action: np.ndarray
    last_action: np.ndarray
    state: State
    reference: Reference
    time: np.ndarray
    crashed: np.ndarray
    touched: np.ndarray
    signals: Mapping[str, Any]

    @property
    def position_error(self) -> np.ndarray:
        """(N,) Euclidean distance from the reference, m."""
        state, reference = self.state, self.reference
        x, y, z = reference.x - state.x, reference.y - state.y, reference.z - state.z
        with np.errstate(over="ignore", invalid="ignore"):  # the position of a crashed vehicle may be huge or NaN
            error: np.ndarray = np.sqrt(x * x + y * y + z * z)
        return error


# (N,) of a transition: what it is worth, and whether the flight ends.
Reward = Callable[[Transition], np.ndarray]
Termination = Callable[[Transition], np.ndarray]


@dataclass(frozen=True)
class TrackingReward:
    """A reward for following the reference.

        tracking exp(-|e| / length) - effort |a|² - variation |a - a'|² - crash - obstacle

    with the position error e and the action a after a'. The last two are paid in each step after which a vehicle has
    crashed: once, where a crash ends the flight. A crash into an obstacle costs both.

    Attributes:
        tracking: reward of a step without error.
        length: error at which that has fallen to 37 %, m.
        effort: price of actions of size 1.
        variation: price of their changes.
        crash: price of a crash.
        obstacle: price of touching an obstacle beside that.

    The default prices are our choice; with them `scripts/train_policy.py` learns to fly within centimetres.

    Raises:
        InputError: a number is not finite, or the length not positive.
    """

    tracking: float = 1.0
    length: float = 0.3
    effort: float = 0.01
    variation: float = 0.05
    crash: float = 10.0
    obstacle: float = 0.0

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name, value in vars(self).items():
            if not np.isfinite(value):
                raise InputError(f"{name} is {value}, but must be a finite number")
        if self.length <= 0.0:
            raise InputError(f"length is {self.length}, but must be larger than 0")

    def __call__(self, step: Transition) -> np.ndarray:
        """The (N,) rewards of a step."""
        action = np.clip(step.action, -1.0, 1.0)
        change = action - np.clip(step.last_action, -1.0, 1.0)
        reward: np.ndarray = (
            self.tracking * np.exp(step.position_error / -self.length)
            - self.effort * np.einsum("ij,ij->i", action, action)
            - self.variation * np.einsum("ij,ij->i", change, change)
            - self.crash * step.crashed
            - self.obstacle * (step.touched > 0)
        )
        return reward


def has_crashed(step: Transition) -> np.ndarray:
    """(N,) whether a flight has ended by a crash."""
    return step.crashed
