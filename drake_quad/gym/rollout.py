"""Recording of the actions of episodes, and replay of an episode with Drake's simulator."""

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


class ActionLog:
    """Actions of the current episode of each vehicle, and of the last completed episode of each vehicle.

    Args:
        num_vehicles: number N of vehicles.
        num_ticks: length of the longest episode in ticks.
        num_actions: number of components of an action.
    """

    def __init__(self, num_vehicles: int, num_ticks: int, num_actions: int) -> None:
        self._actions = np.zeros((num_ticks, num_vehicles, num_actions))
        self._ended: list[tuple[Episode, np.ndarray] | None] = [None] * num_vehicles

    def write(self, clocks: np.ndarray, actions: np.ndarray) -> None:
        """Record the actions of one tick.

        Args:
            clocks: (N,) numbers of ticks since the start of the current episode of each vehicle.
            actions: (N, components) actions.
        """
        vehicles = np.flatnonzero(clocks < len(self._actions))
        self._actions[clocks[vehicles], vehicles] = actions[vehicles]

    def end(self, vehicles: np.ndarray, clocks: np.ndarray, episodes: list[Episode]) -> None:
        """Store the actions of episodes that have ended.

        Args:
            vehicles: (k,) indices of the vehicles whose episodes have ended.
            clocks: (N,) numbers of ticks since the start of the current episode of each vehicle.
            episodes: the k episodes that have ended.
        """
        for vehicle, episode in zip(vehicles.tolist(), episodes, strict=True):
            self._ended[vehicle] = episode, self._actions[: clocks[vehicle], vehicle].copy()

    def actions(self, vehicle: int, clock: int, episode: Episode, *, ended_first: bool) -> tuple[Episode, np.ndarray]:
        """Return an episode of a vehicle, and its (ticks, components) actions.

        Args:
            vehicle: index of the vehicle.
            clock: number of ticks since the start of the current episode.
            episode: current episode.
            ended_first: True to return the last completed episode, if there is one, instead of the current episode.

        Raises:
            InputError: if the vehicle has not flown yet.
        """
        ended, current = self._ended[vehicle], (episode, self._actions[:clock, vehicle].copy())
        if ended is not None and (ended_first or not clock):
            return ended
        if not clock:
            raise InputError(f"vehicle {vehicle} has not flown yet")
        return current


def replay_episode(scenario: Scenario, plan: Plan, episode: Episode, actions: np.ndarray) -> Flight:
    """Simulate an episode with Drake's simulator, up to the last recorded action.

    Args:
        scenario: scenario of the environment.
        plan: plan of the environment.
        episode: episode to simulate.
        actions: (ticks, components) actions.
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
    """Return a `TrajectorySource` whose output is the action of each tick.

    Args:
        actions: (ticks, components) actions; the last action is held after its tick.
        tick: control period, s.
    """
    # Actions change halfway between two ticks, so that rounding errors of the time have no effect.
    breaks = (np.arange(len(actions) + 1) - 0.5) * tick
    values = np.vstack([actions, actions[-1:]]).T
    return TrajectorySource(PiecewisePolynomial.ZeroOrderHold(breaks, values))
