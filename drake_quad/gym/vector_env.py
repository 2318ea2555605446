"""Many vehicles at once as a vector environment of Gymnasium."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.compilation.clocked_fleet import ClockedFleet
from drake_quad.errors import InputError, listed, shortened, shown, whole_number
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.gym.episodes import Episode, Episodes
from drake_quad.gym.real_numbers import MAX_ACTION, real_numbers, single_precision
from drake_quad.gym.rewards import Reward, Termination, TrackingReward, Transition, has_crashed
from drake_quad.gym.rollout import Tape, fly_again
from drake_quad.gym.task import task_of
from drake_quad.laboratory.metrics import Metrics, summarized
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.believed import nominal_parameters
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.loading import Overrides
from drake_quad.scenario.models import Scenario
from drake_quad.signals import SIGNALS

# What every step looks at beside what is asked for.
_SHOWN = ("observation", "state", "reference")
_JUDGE = "monitor"
# Observation, rewards, terminations, truncations and infos of a step.
Stepped = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class QuadrotorVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """A fleet in machine code, whose vehicles begin their flights anew each for itself.

    A scenario is the task: its route, vehicle, laboratory and distributions, which are drawn anew for each episode of
    each vehicle. A step is a tick of the control. An episode ends by a crash, and is cut off at the flight's end. When
    it has ended, `infos["flight"]` has the flight's metrics, as `drake_quad.laboratory.metrics` has them (efforts where
    accelerations are commanded), and `obstacle`, the number of the obstacle that it crashed into (0 for none); where
    vehicles begin anew in the same step, `infos["final_info"]` has them as well.

    With seed s, vehicle i has seed s + i, and its episode j is sample j of the study of that seed: it flies as
    `drake_quad.simulate(env.scenario, seed=s + i, sample=j)` does under the same actions.

    Args:
        scenario: what flies where; or the file or name of one. Its position controller, or whatever stands in place of
            the cascade, is left out. Its attitude control stays, and the limits of its thrust vectoring; without an
            autopilot, an attitude control is designed where it has none.
        overrides: as for `load_scenario`.
        num_envs: N.
        action: what actions mean, as `control.action` of the scenario language: `"acceleration"`, `"attitude"`,
            `"rates"`, `"rotor_speeds"`, or the fields. That of the scenario's policy if not given; an acceleration if
            it has none.
        observation: what is seen, as `control.observation` of the scenario language. As the scenario's policy has it
            if not given; the language's defaults if it has none.
        reward: a function of a `Transition` that returns (N,) rewards.
        terminates: a function of a `Transition` that returns (N,) whether a flight ends; by default, a crash.
        signals: names of signals that functions of a `Transition` look at in its `signals`, such as `wind`.
        plan: flown instead of that of the scenario's route.
        autoreset_mode: of Gymnasium: in the step after an episode's last (the default), in its last, or not at all;
            then `reset(options={"reset_mask": ...})` lets vehicles begin anew.
        render_mode: "rgb_array" for frames.
        record: whether actions are kept, so that `flight` can show an episode.

    Attributes:
        scenario: the task.
        plan: that is flown.
        has_begun: whether there was a reset.

    Raises:
        InputError: something of it is wrong, cannot be compiled, or does not fit into memory.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: Scenario | str | Path = "figure_eight",
        overrides: Overrides = (),
        *,
        num_envs: int = 1,
        action: str | Mapping[str, Any] | Model | None = None,
        observation: Mapping[str, Any] | Model | None = None,
        reward: Reward = TrackingReward(),
        terminates: Termination = has_crashed,
        signals: Sequence[str] = (),
        plan: Plan | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        record: bool = False,
    ) -> None:
        num_envs = whole_number(num_envs, "num_envs", minimum=1)
        check_fleet_fits(num_envs, "num_envs")
        if plan is not None and not isinstance(plan, Plan):
            raise InputError(f"plan is {shown(plan)}, but must be a Plan")
        for name, function in (("reward", reward), ("terminates", terminates)):
            if not callable(function):
                raise InputError(f"{name} is {shown(function)}, but must be a function of a Transition")
        modes = [str(mode.value) for mode in AutoresetMode]
        if autoreset_mode not in [*AutoresetMode, *modes]:
            raise InputError(f"autoreset_mode is {shown(autoreset_mode)}, but must be one of {listed(modes)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(
                f"render_mode is {render_mode!r}, but must be None or one of {self.metadata['render_modes']}"
            )
        if isinstance(signals, str) or not isinstance(signals, Iterable):
            raise InputError(f"signals is {shown(signals)}, but must be a list of names")
        self.scenario = task_of(scenario, overrides, action=action, observation=observation)
        self.plan = plan or plan_route(self.scenario)
        self._tick = self.scenario.laboratory.command_link.period
        self._num_ticks = round(flight_duration(self.scenario, self.plan) / self._tick)
        diagram = build_fleet_diagram(Batch.draw(self.scenario, range(num_envs)), self.plan, open_action=True)
        self._signals = _checked(signals, diagram)
        seen = tuple(dict.fromkeys((*_SHOWN, *self._signals)))
        self._fleet = ClockedFleet(diagram, tick=self._tick, num_ticks=self._num_ticks, shown=seen, judge=_JUDGE)
        self._commands_acceleration = diagram.HasOutputPort("acceleration_command")
        self._episodes = Episodes(self.scenario, self.plan, num_envs, shown=seen)
        self._reward, self._terminates = reward, terminates
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = {
            **self.metadata,
            "autoreset_mode": AutoresetMode(autoreset_mode),
            "render_fps": round(1.0 / self._tick),
        }
        self._mode = self.metadata["autoreset_mode"]
        control: Any = self.scenario.control
        rows = control.policy_rows()
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (rows["observation"],), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (rows["action"],), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._hovering = np.array(control.action.hovering(nominal_parameters(self.scenario)))
        self._last_action = np.tile(self._hovering, (num_envs, 1))
        self._all = np.arange(num_envs)
        self._is_over, self.has_begun = np.zeros(num_envs, dtype=bool), False
        self._tape = Tape(num_envs, self._num_ticks, rows["action"]) if record else None
        self._camera: Any = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Lets all vehicles begin anew, or some.

        Args:
            seed: s, or one for each vehicle. Those without a seed go on with their next episodes; at the first reset
                they get one by chance.
            options: may have a `reset_mask`, (N,) which vehicles begin anew.

        Returns:
            The (N, rows) observation and no infos.

        Raises:
            InputError: a seed is negative or too large, or the mask is of another size.
        """
        seeds = self._seeds_of(seed)
        super().reset(seed=None if seed is None or isinstance(seed, Sequence | np.ndarray) else int(seed))
        vehicles = self._all
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
                raise InputError(f"reset_mask must be {self.num_envs} truth values, some of them true")
            vehicles = np.flatnonzero(mask)
        if not self.has_begun:
            if len(vehicles) < self.num_envs:
                raise InputError("reset_mask is of vehicles that have not begun; all must begin once")
            chance = int(self.np_random.integers(2**31))
            seeds = [chance + i if each is None else each for i, each in enumerate(seeds)]
        elif self._tape is not None:
            self._end(vehicles[(self._fleet.clocks[vehicles] > 0) & ~self._is_over[vehicles]])
        given = [i for i in vehicles.tolist() if seeds[i] is not None]
        self._episodes.seed(np.array(given, dtype=int), np.array([seeds[i] for i in given], dtype=np.int64))
        self.has_begun = True
        self._begin(vehicles)
        return self._observation(), {}

    def step(self, actions: np.ndarray | Sequence[Any]) -> Stepped:
        """Simulate all vehicles for one tick; the actions (N, rows) and the results are those of Gymnasium.

        An action outside the action space, such as a sample of a normal distribution, is clipped for the flight.
        Rewards and observations contain the original action.

        Raises:
            InputError: if the actions have the wrong shape, are not real numbers, are not finite, or exceed 1,000,000
                in size; or the environment was not reset before.
        """
        actions = self._checked_actions(actions)
        if not self.has_begun:
            raise InputError("the environment must be reset before its first step")
        fleet = self._fleet
        infos: dict[str, Any] = {}
        if self._tape is not None:
            self._tape.write(fleet.clocks, actions)
        fleet.advance(actions)
        step = self._transition(actions)
        self._last_action = actions
        seen = step.observation
        rewards = self._judged(self._reward(step), "reward", float)
        terminations = self._judged(self._terminates(step), "terminates", bool)
        truncations = ~terminations & (fleet.clocks >= self._num_ticks)
        if self._mode is AutoresetMode.NEXT_STEP and self._is_over.any():
            again = np.flatnonzero(self._is_over)
            rewards[again], terminations[again], truncations[again] = 0.0, False, False
            seen = seen.copy()
            seen[again] = self._begin(again)
        over = terminations | truncations
        if over.any():
            ended = np.flatnonzero(over)
            infos |= self._flights(ended, over)
            self._end(ended)
            if self._mode is AutoresetMode.SAME_STEP:
                infos |= _final(seen, infos, over)
                seen = seen.copy()
                seen[ended] = self._begin(ended)
        self._is_over = over
        return seen, rewards, terminations, truncations, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A frame for each vehicle, (height, width, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        if not self.has_begun:
            raise InputError("the environment must be reset before its first frame")
        if self._camera is None:
            from drake_quad.visualization.frames import Camera

            self._camera = Camera(self.scenario, self.plan)
        return self._camera.frames(self._fleet.record("state"), self._fleet.record("reference"))

    def episode(self, vehicle: int = 0) -> Episode:
        """Seed and sample of what a vehicle flies, given its number.

        Raises:
            InputError: there is no such vehicle.
        """
        return self._episodes.episode(whole_number(vehicle, "vehicle", minimum=0, maximum=self.num_envs - 1))

    def flight(self, vehicle: int = 0) -> Flight:
        """An episode of a vehicle, given its number, with all of its signals.

        It is the last one that has ended; if none has, or if vehicles do not begin anew by themselves, the one that is
        flown, as far as it is. It is flown again under Drake's simulator, with the actions that were recorded.

        Raises:
            InputError: there is no such vehicle, it has not flown yet, or nothing was recorded.
        """
        episode = self.episode(vehicle)
        if self._tape is None:
            raise InputError("actions are not recorded: make the environment with record=True")
        ended_first = self._mode is not AutoresetMode.DISABLED
        return fly_again(
            self.scenario,
            self.plan,
            *self._tape.actions(vehicle, self._fleet.clocks[vehicle], episode, ended_first=ended_first),
        )

    def _seeds_of(self, seed: Any) -> list[int | None]:
        """The seed of each vehicle, or None."""
        most = 2**63 - 1 - self.num_envs
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, Sequence | np.ndarray) or isinstance(seed, str):
            first = whole_number(seed, "seed", minimum=0, maximum=most)
            return [first + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"{len(seed)} seeds are given, but there are {self.num_envs} vehicles")
        return [None if each is None else whole_number(each, "seed", minimum=0, maximum=most) for each in seed]

    def _end(self, vehicles: np.ndarray) -> None:
        """Keeps the episodes of vehicles that have ended, if actions are recorded."""
        if self._tape is not None:
            episodes = [self._episodes.episode(i) for i in vehicles.tolist()]
            self._tape.end(vehicles, self._fleet.clocks, episodes)

    def _begin(self, vehicles: np.ndarray) -> np.ndarray:
        """Start the next episodes of some vehicles, and return their observations (k, rows)."""
        begun = self._episodes.begin(vehicles)
        self._fleet.place(vehicles, begun)
        self._is_over[vehicles] = False
        # Whoever was shown these keeps what was shown.
        self._last_action = self._last_action.copy()
        self._last_action[vehicles] = self._hovering
        return single_precision(begun.shown[:, self._fleet.columns("observation")])

    def _observation(self) -> np.ndarray:
        """Return the observations (N, rows) as policies see them."""
        return single_precision(self._fleet.shown("observation"))

    def _checked_actions(self, given: Any) -> np.ndarray:
        """Return the given actions as an array (N, rows).

        Raises:
            InputError: if the actions have the wrong shape, are not real numbers, are not finite, or are too large.
        """
        actions = real_numbers(given)
        if actions is None:
            raise InputError(f"actions are {shown(given)}, but must be real numbers of one shape")
        if actions.shape != self._last_action.shape:
            raise InputError(f"actions have the shape {actions.shape}, but must have {self._last_action.shape}")
        wrong = ~(np.abs(actions) <= MAX_ACTION).all(axis=1)
        if wrong.any():
            vehicle, *_ = np.flatnonzero(wrong).tolist()
            raise InputError(
                f"actions must be finite and at most {MAX_ACTION:,.0f} in size, but that of vehicle {vehicle} is"
                f" {shown(actions[vehicle].tolist())}"
            )
        return actions

    def _judged(self, found: Any, name: str, kind: type) -> np.ndarray:
        """Return a copy of the result of a user's function of a transition, with its shape and type checked."""
        values = real_numbers(found)
        if values is None or values.shape != (self.num_envs,):
            raise InputError(f"{name} must return {self.num_envs} numbers, but returned {shortened(repr(found), 80)}")
        if not np.isfinite(values).all():
            vehicle, *_ = np.flatnonzero(~np.isfinite(values)).tolist()
            raise InputError(f"{name} must return finite numbers, but returned {values[vehicle]} of vehicle {vehicle}")
        return values.astype(kind)

    def _transition(self, actions: np.ndarray) -> Transition:
        fleet = self._fleet
        return Transition(
            self._observation(),
            actions,
            self._last_action,
            fleet.record("state"),
            fleet.record("reference"),
            fleet.clocks * self._tick,
            fleet.judged("crashed").crashed != 0.0,
            fleet.judged("touched").number.astype(int),
            {name: fleet.record(name) for name in self._signals},
        )

    def _flights(self, ended: np.ndarray, over: np.ndarray) -> dict[str, Any]:
        """Infos of flights that have ended: their metrics, as Gymnasium wants infos of vectors."""
        sums = self._fleet.judged("sums")
        crash_time = self._fleet.judged("crash_time").crash_time
        metrics: Metrics = summarized(sums, crash_time, self._tick)
        obstacle = self._fleet.judged("touched").number.astype(int)
        flight: dict[str, Any] = {}
        unknown = () if self._commands_acceleration else ("effort", "variation")
        for name, values in {**metrics._asdict(), "obstacle": obstacle}.items():
            if name.startswith(unknown):
                continue
            flight[name] = np.where(over, values, 0)
            flight[f"_{name}"] = over.copy()
        return {"flight": flight, "_flight": over.copy()}


def _final(seen: np.ndarray, infos: dict[str, Any], over: np.ndarray) -> dict[str, Any]:
    """Infos with the last observations of episodes that begin anew in the same step."""
    observations = np.full(len(over), None, dtype=object)
    for i in np.flatnonzero(over).tolist():
        observations[i] = seen[i].copy()
    return {
        "final_obs": observations,
        "_final_obs": over.copy(),
        "final_info": dict(infos),
        "_final_info": over.copy(),
    }


def _checked(signals: Sequence[str], diagram: Any) -> tuple[str, ...]:
    ports = [diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())]
    there = [name for name in ports if name in SIGNALS]
    for name in signals:
        if name not in there:
            raise InputError(f"{shown(name)} is no signal of this scenario, which has {listed(there)}")
        if [*signals].count(name) > 1:
            raise InputError(f"signals has {name} twice")
    return tuple(signals)
