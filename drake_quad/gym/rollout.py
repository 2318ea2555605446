"""Episodes that are flown again under Drake's simulator, from the actions that were taken."""

from typing import Any

import numpy as np
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.errors import InputError
from drake_quad.flight.flight import Flight
from drake_quad.flight.simulation import simulate
from drake_quad.gym.episodes import Episode
from drake_quad.reference.plan import Plan
from drake_quad.scenario.models import Scenario


class Tape:
    """The actions of the episodes that vehicles fly, and of the last one of each that has ended.

    Args:
        num_vehicles: N.
        num_ticks: of the longest episode.
        num_actions: rows of an action.
    """

    def __init__(self, num_vehicles: int, num_ticks: int, num_actions: int) -> None:
        self._actions = np.zeros((num_ticks, num_vehicles, num_actions))
        self._ended: list[tuple[Episode, np.ndarray] | None] = [None] * num_vehicles

    def write(self, clocks: np.ndarray, actions: np.ndarray) -> None:
        """Keeps actions (N, rows) at the ticks of (N,) clocks."""
        vehicles = np.flatnonzero(clocks < len(self._actions))
        self._actions[clocks[vehicles], vehicles] = actions[vehicles]

    def end(self, vehicles: np.ndarray, clocks: np.ndarray, episodes: list[Episode]) -> None:
        """Ends the episodes of k vehicles."""
        for vehicle, episode in zip(vehicles.tolist(), episodes, strict=True):
            self._ended[vehicle] = episode, self._actions[: clocks[vehicle], vehicle].copy()

    def actions(self, vehicle: int, clock: int, episode: Episode, *, ended_first: bool) -> tuple[Episode, np.ndarray]:
        """An episode of a vehicle, and its (ticks, rows) actions.

        Args:
            vehicle: its number.
            clock: ticks that it has flown.
            episode: that it flies.
            ended_first: whether the last one that has ended is preferred to the one that it flies.

        Raises:
            InputError: it has not flown yet.
        """
        ended, flown = self._ended[vehicle], (episode, self._actions[:clock, vehicle].copy())
        if ended is not None and (ended_first or not clock):
            return ended
        if not clock:
            raise InputError(f"vehicle {vehicle} has not flown yet")
        return flown


def fly_again(scenario: Scenario, plan: Plan, episode: Episode, actions: np.ndarray) -> Flight:
    """Flies an episode under Drake's simulator.

    Args:
        scenario: of the environment.
        plan: of the environment.
        episode: to fly.
        actions: (ticks, rows) of its ticks; the last one is held.

    Returns:
        The flight, as long as there are actions.
    """
    tick = scenario.laboratory.command_link.period
    return simulate(
        scenario,
        seed=episode.seed,
        sample=episode.sample,
        policy=action_source(actions, tick),
        plan=plan,
        until=len(actions) * tick,
    )


def action_source(actions: np.ndarray, tick: float) -> Any:
    """A system that takes the actions of a flight.

    Args:
        actions: (ticks, rows) of one tick after another; the last one is held.
        tick: of the control, s.

    Returns:
        A `TrajectorySource`, whose output are the rows.
    """
    # In the middle between two ticks they change, so that each tick sees its own.
    breaks = (np.arange(len(actions) + 1) - 0.5) * tick
    values = np.vstack([actions, actions[-1:]]).T
    return TrajectorySource(PiecewisePolynomial.ZeroOrderHold(breaks, values))
