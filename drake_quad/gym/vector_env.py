"""Gymnasium vector environment with a fleet of vehicles."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.compilation.clocked_fleet import ClockedFleet
from drake_quad.errors import InputError, InputWarning, check_integer, join_names, lookup, short_repr, shorten_text
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.flight.remarks import braking_remarks
from drake_quad.gym.episodes import Episode, Episodes
from drake_quad.gym.real_numbers import MAX_ACTION, real_numbers, single_precision
from drake_quad.gym.rewards import Reward, Termination, TrackingReward, Transition, has_crashed
from drake_quad.gym.rollout import ActionLog, replay_episode
from drake_quad.gym.task import environment_scenario
from drake_quad.laboratory.metrics import Metrics, metric_definitions, metric_values, recorded_metrics
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.loading import Overrides
from drake_quad.scenario.models import Scenario
from drake_quad.signals import SIGNALS
from drake_quad.user_code import describe_callable, takes_one_argument

# Output ports that are read at every step. Users can request further ports.
_REQUIRED_OUTPUTS = ("observation", "state", "reference")
_MONITOR_NAME = "monitor"  # name of the flight monitor in the diagram
StepResult = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""Observations, rewards, terminations, truncations and infos of a step."""


class QuadrotorVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Gymnasium vector environment: a fleet in machine code whose vehicles start new episodes independently.

    The scenario defines the task by its route, vehicle and laboratory. Its distributions are sampled for every episode
    of every vehicle. A step is a control tick. A crash terminates an episode, and the end of the flight truncates it.
    In the last step of an episode, `infos["flight"]` contains the metrics of the flight
    (`drake_quad.laboratory.metrics`) and `obstacle`, the number of the obstacle that the vehicle hit (0 for none).
    Metrics of signals that the environment lacks are left out, such as control efforts if no acceleration is commanded.
    If vehicles are reset in the same step, `infos["final_info"]` contains these values, too. A metric that is a
    function of a recorded flight requires `record=True`. Drake's simulator then repeats each completed episode.

    If the environment is reset with the seed s, the seed of vehicle i is s + i, and episode j of this vehicle is sample
    j of the study with that seed. With the same actions, `drake_quad.simulate(env.scenario, seed=s + i, sample=j)`
    simulates the same flight.

    Args:
        scenario: scenario, or the file or name of one. The policy replaces the position controller of the scenario, or
            the controller that replaces the whole cascade. The attitude control and the limits of the thrust vectoring
            remain. If the scenario has neither an attitude control nor an autopilot, an attitude control is designed.
        overrides: overrides for `load_scenario`.
        num_envs: number N of vehicles.
        action: type of action, `"acceleration"`, `"attitude"`, `"rates"` or `"rotor_speeds"`, or the fields of
            `control.action` in the scenario language. By default the action of the scenario's policy; if there is no
            policy, an acceleration.
        observation: fields of `control.observation` in the scenario language. By default the observation of the
            scenario's policy; if there is no policy, the default values of the language.
        reward: function of a `Transition` that returns (N,) rewards.
        terminates: function of a `Transition` that returns (N,) Booleans, True if an episode ends; by default an
            episode ends after a crash.
        signals: names of further signals to include in `Transition.signals`, such as `wind`.
        metrics: names of metrics and requirements of the scenario to include in `Transition.metrics`, in addition to
            those of a `TrackingReward`.
        plan: plan to fly; by default the plan for the scenario's route.
        autoreset_mode: Gymnasium's mode of resets: in the step after the last step of an episode (the default), in the
            last step, or never. Without automatic resets, `reset(options={"reset_mask": ...})` starts new episodes.
        render_mode: "rgb_array" to render images; None for no rendering.
        record: True to record actions, so that `flight` can return an episode.

    Attributes:
        scenario: scenario that defines the task.
        plan: plan with the reference of the flights.
        has_begun: True after the first reset.

    Raises:
        InputError: if an argument is invalid, the scenario cannot be compiled, or the fleet does not fit into memory.
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
        metrics: Sequence[str] = (),
        plan: Plan | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        record: bool = False,
    ) -> None:
        num_envs = check_integer(num_envs, "num_envs", minimum=1)
        check_fleet_fits(num_envs, "num_envs")
        if plan is not None and not isinstance(plan, Plan):
            raise InputError(f"plan is {short_repr(plan)}, but must be a Plan")
        for name, function in (("reward", reward), ("terminates", terminates)):
            if not takes_one_argument(function):
                what = describe_callable(function) if callable(function) else short_repr(function)
                raise InputError(f"{name} is {what}, but must be a function of a Transition")
        modes = [str(mode.value) for mode in AutoresetMode]
        if autoreset_mode not in [*AutoresetMode, *modes]:
            raise InputError(f"autoreset_mode is {short_repr(autoreset_mode)}, but must be one of {join_names(modes)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(
                f"render_mode is {render_mode!r}, but must be None or one of {self.metadata['render_modes']}"
            )
        for name, names in (("signals", signals), ("metrics", metrics)):
            if isinstance(names, str) or not isinstance(names, Iterable):
                raise InputError(f"{name} is {short_repr(names)}, but must be a list of names")
        self.scenario = environment_scenario(scenario, overrides, action=action, observation=observation)
        self.plan = plan or plan_route(self.scenario)
        for remark in braking_remarks(self.scenario, self.plan):
            warnings.warn(remark, InputWarning, stacklevel=2)
        self._tick = self.scenario.laboratory.command_link.period
        self._num_ticks = round(flight_duration(self.scenario, self.plan) / self._tick)
        diagram = build_fleet_diagram(Batch.draw(self.scenario, range(num_envs)), self.plan, open_action=True)
        self._signals = _checked_signals(signals, diagram)
        self._metrics_type = self.scenario.metrics_type
        self._available_metrics = _available_metrics(self._metrics_type, diagram)
        rewarded = reward.metrics if isinstance(reward, TrackingReward) else ()
        self._metrics = _checked_metrics(dict.fromkeys((*metrics, *rewarded)), self._metrics_type, diagram)
        self._recorded_metrics = tuple(recorded_metrics(self._metrics_type))
        if self._recorded_metrics and not record:
            raise InputError(
                f"{join_names([*self._recorded_metrics])} in metrics.additional is computed from a recorded flight;"
                " create the environment with record=True, which repeats each completed episode in Drake's simulator,"
                " or omit the metric"
            )
        outputs = tuple(dict.fromkeys((*_REQUIRED_OUTPUTS, *self._signals)))
        self._fleet = ClockedFleet(
            diagram, tick=self._tick, num_ticks=self._num_ticks, outputs=outputs, monitor=_MONITOR_NAME
        )
        self._episodes = Episodes(self.scenario, self.plan, num_envs, outputs=outputs)
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
        self._hovering = np.array(control.action.hover_action(nominal_parameters(self.scenario)))
        self._last_action = np.tile(self._hovering, (num_envs, 1))
        self._last_metrics = {name: np.zeros(num_envs) for name in self._metrics}
        self._all = np.arange(num_envs)
        self._is_over, self.has_begun = np.zeros(num_envs, dtype=bool), False
        self._action_log = ActionLog(num_envs, self._num_ticks, rows["action"]) if record else None
        self._camera: Any = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start new episodes of all vehicles, or of some of them.

        Args:
            seed: seed s, or a list with the seed of each vehicle or None. A vehicle without a seed starts its next
                episode; at the first reset, its seed is random.
            options: dictionary that may contain `reset_mask`, (N,) Booleans, True for vehicles that start a new
                episode.

        Returns:
            The observations (N, components) and an empty dictionary.

        Raises:
            InputError: if a seed is negative or too large, or the options or the mask has the wrong shape or type.
        """
        seeds = self._seeds_of(seed)
        super().reset(seed=None if seed is None or isinstance(seed, Sequence | np.ndarray) else int(seed))
        vehicles = self._all
        if options is not None and not isinstance(options, Mapping):
            raise InputError(f"options is {short_repr(options)}, but must be a dictionary")
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
                raise InputError(f"reset_mask must contain {self.num_envs} Booleans, at least one of them True")
            vehicles = np.flatnonzero(mask)
        if not self.has_begun:
            if len(vehicles) < self.num_envs:
                raise InputError("reset_mask must be True for all vehicles at the first reset")
            random_seed = int(self.np_random.integers(2**31))
            seeds = [random_seed + i if each is None else each for i, each in enumerate(seeds)]
        elif self._action_log is not None:
            self._end(vehicles[(self._fleet.clocks[vehicles] > 0) & ~self._is_over[vehicles]])
        seeded = [i for i in vehicles.tolist() if seeds[i] is not None]
        self._episodes.seed(np.array(seeded, dtype=int), np.array([seeds[i] for i in seeded], dtype=np.int64))
        self.has_begun = True
        self._begin(vehicles)
        return self._observation(), {}

    def step(self, actions: np.ndarray | Sequence[Any]) -> StepResult:
        """Simulate one tick for actions (N, components) of all vehicles, and return the results that Gymnasium defines.

        The flight uses the actions clipped to the action space, since samples of a normal distribution may lie outside
        it. Rewards and observations use the original actions.

        Raises:
            InputError: if the actions have the wrong shape, are not finite real numbers, or exceed 1,000,000 in
                absolute value; or if the environment was not reset before.
        """
        actions = self._checked_actions(actions)
        if not self.has_begun:
            raise InputError("the environment must be reset before its first step")
        fleet = self._fleet
        infos: dict[str, Any] = {}
        if self._action_log is not None:
            self._action_log.write(fleet.clocks, actions)
        fleet.advance(actions)
        step = self._transition(actions)
        self._last_action = actions
        observations = step.observation
        rewards = self._checked_result(self._reward(step), "reward", float)
        terminations = self._checked_result(self._terminates(step), "terminates", bool)
        truncations = ~terminations & (fleet.clocks >= self._num_ticks)
        if self._mode is AutoresetMode.NEXT_STEP and self._is_over.any():
            restarted = np.flatnonzero(self._is_over)
            rewards[restarted], terminations[restarted], truncations[restarted] = 0.0, False, False
            observations = observations.copy()
            observations[restarted] = self._begin(restarted)
        over = terminations | truncations
        if over.any():
            ended = np.flatnonzero(over)
            infos |= self._flights(ended, over)
            self._end(ended)
            if self._mode is AutoresetMode.SAME_STEP:
                infos |= _final_infos(observations, infos, over)
                observations = observations.copy()
                observations[ended] = self._begin(ended)
        self._is_over = over
        return observations, rewards, terminations, truncations, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return an image of each vehicle, (height, width, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        if not self.has_begun:
            raise InputError("the environment must be reset before it is rendered")
        if self._camera is None:
            from drake_quad.visualization.frames import Camera

            self._camera = Camera(self.scenario, self.plan)
        return self._camera.frames(self._fleet.output_record("state"), self._fleet.output_record("reference"))

    def episode(self, vehicle: int = 0) -> Episode:
        """Return the seed and sample of the current episode of a vehicle, given its index.

        Raises:
            InputError: if there is no such vehicle.
        """
        return self._episodes.episode(check_integer(vehicle, "vehicle", minimum=0, maximum=self.num_envs - 1))

    def flight(self, vehicle: int = 0) -> Flight:
        """Return an episode of a vehicle, given the index of the vehicle, with all signals.

        With automatic resets, this is the last completed episode, or the current episode if none is completed. Without
        automatic resets, it is the current episode up to the current tick, or directly after a reset the previous
        episode. Drake's simulator repeats the flight with the recorded actions.

        Raises:
            InputError: if there is no such vehicle, the vehicle has not flown yet, or actions were not recorded.
        """
        episode = self.episode(vehicle)
        if self._action_log is None:
            raise InputError("actions are not recorded; create the environment with record=True")
        ended_first = self._mode is not AutoresetMode.DISABLED
        return replay_episode(
            self.scenario,
            self.plan,
            *self._action_log.actions(vehicle, self._fleet.clocks[vehicle], episode, ended_first=ended_first),
        )

    def _seeds_of(self, seed: Any) -> list[int | None]:
        """Return the seed of each vehicle; None for a vehicle without a seed."""
        max_seed = 2**63 - 1 - self.num_envs
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, Sequence | np.ndarray) or isinstance(seed, str):
            first = check_integer(seed, "seed", minimum=0, maximum=max_seed)
            return [first + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"{len(seed)} seeds are given, but there are {self.num_envs} vehicles")
        return [None if each is None else check_integer(each, "seed", minimum=0, maximum=max_seed) for each in seed]

    def _end(self, vehicles: np.ndarray) -> None:
        """Store the actions of episodes that have ended in the action log, if actions are recorded."""
        if self._action_log is not None:
            episodes = [self._episodes.episode(i) for i in vehicles.tolist()]
            self._action_log.end(vehicles, self._fleet.clocks, episodes)

    def _begin(self, vehicles: np.ndarray) -> np.ndarray:
        """Start the next episodes of some vehicles, and return their observations (k, components)."""
        initial = self._episodes.begin(vehicles)
        self._fleet.restart(vehicles, initial)
        self._is_over[vehicles] = False
        # Earlier transitions contain the existing array, so it must not change.
        self._last_action = self._last_action.copy()
        self._last_action[vehicles] = self._hovering
        for values in self._last_metrics.values():
            values[vehicles] = 0.0
        return single_precision(initial.outputs[:, self._fleet.columns("observation")])

    def _observation(self) -> np.ndarray:
        """Return the observations (N, components) in single precision, as policies receive them."""
        return single_precision(self._fleet.outputs("observation"))

    def _checked_actions(self, values: Any) -> np.ndarray:
        """Return actions as an array (N, components).

        Raises:
            InputError: if the actions have the wrong shape, are not real numbers, are not finite, or are too large.
        """
        actions = real_numbers(values)
        if actions is None:
            raise InputError(f"actions are {short_repr(values)}, but must be an array of real numbers")
        if actions.shape != self._last_action.shape:
            raise InputError(f"actions have the shape {actions.shape}, but must have {self._last_action.shape}")
        wrong = ~(np.abs(actions) <= MAX_ACTION).all(axis=1)
        if wrong.any():
            vehicle, *_ = np.flatnonzero(wrong).tolist()
            raise InputError(
                f"actions must be finite, with absolute values of at most {MAX_ACTION:,.0f}, but the action of vehicle"
                f" {vehicle} is {short_repr(actions[vehicle].tolist())}"
            )
        return actions

    def _checked_result(self, result: Any, name: str, kind: type) -> np.ndarray:
        """Check the values that a user's reward or termination function returned, and return a copy."""
        values = real_numbers(result)
        if values is None or values.shape != (self.num_envs,):
            raise InputError(
                f"{name} must return {self.num_envs} numbers, but returned {shorten_text(repr(result), 80)}"
            )
        if not np.isfinite(values).all():
            vehicle, *_ = np.flatnonzero(~np.isfinite(values)).tolist()
            raise InputError(f"{name} must return finite numbers, but returned {values[vehicle]} for vehicle {vehicle}")
        return values.astype(kind)

    def _metric_changes(self, metrics: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the changes of the metrics since the previous step, given their current values. NaN counts as 0."""
        values = {name: np.where(np.isnan(each), 0.0, each) for name, each in metrics.items()}
        with np.errstate(invalid="ignore"):  # the change of a metric that stays infinite is NaN
            changes = {name: each - self._last_metrics[name] for name, each in values.items()}
        self._last_metrics = values
        return changes

    def _transition(self, actions: np.ndarray) -> Transition:
        fleet = self._fleet
        metrics: dict[str, np.ndarray] = {}
        if self._metrics:
            metrics = metric_values(self._metrics, fleet.next_state("sums"), self._tick, self._metrics_type)
        return Transition(
            self._observation(),
            actions,
            self._last_action,
            fleet.output_record("state"),
            fleet.output_record("reference"),
            fleet.clocks * self._tick,
            fleet.next_state("crashed").crashed != 0.0,
            fleet.next_state("obstacle_hit").number.astype(int),
            {name: fleet.output_record(name) for name in self._signals},
            metrics,
            self._metric_changes(metrics),
        )

    def _flights(self, ended: np.ndarray, over: np.ndarray) -> dict[str, Any]:
        """Return the metrics of completed flights, in Gymnasium's format for the infos of vector environments.

        Args:
            ended: (k,) indices of the vehicles whose episodes have ended.
            over: (N,) Booleans, True for the same vehicles.
        """
        sums = self._fleet.next_state("sums")
        crash_time = self._fleet.next_state("crash_time").crash_time
        metrics = metric_values(self._available_metrics, sums, self._tick, self._metrics_type)
        obstacle = self._fleet.next_state("obstacle_hit").number.astype(int)
        flight: dict[str, Any] = {}
        recorded = self._metrics_of_recorded_flights(ended)
        for name, values in {**metrics, **recorded, "crash_time": crash_time, "obstacle": obstacle}.items():
            flight[name] = np.where(over, values, 0)
            flight[f"_{name}"] = over.copy()
        return {"flight": flight, "_flight": over.copy()}

    def _metrics_of_recorded_flights(self, ended: np.ndarray) -> dict[str, np.ndarray]:
        """Return the (N,) metrics that are computed from a recorded flight, for vehicles with completed flights."""
        values = {name: np.full(self.num_envs, np.nan) for name in self._recorded_metrics}
        if values and self._action_log is not None:
            for i in ended.tolist():
                clock, episode = self._fleet.clocks[i], self._episodes.episode(i)
                actions = self._action_log.actions(i, clock, episode, ended_first=False)
                metrics = replay_episode(self.scenario, self.plan, *actions).metrics
                for name, column in values.items():
                    column[i] = getattr(metrics, name)
        return values


def _final_infos(last_observations: np.ndarray, infos: dict[str, Any], over: np.ndarray) -> dict[str, Any]:
    """Return the infos `final_obs` and `final_info` of vehicles that are reset in the last step of an episode.

    Args:
        last_observations: (N, components) observations before the reset.
        infos: infos of the step.
        over: (N,) Booleans, True for vehicles whose episodes have ended.
    """
    observations = np.full(len(over), None, dtype=object)
    for i in np.flatnonzero(over).tolist():
        observations[i] = last_observations[i].copy()
    return {
        "final_obs": observations,
        "_final_obs": over.copy(),
        "final_info": dict(infos),
        "_final_info": over.copy(),
    }


def _available_metrics(kind: type[Metrics], diagram: Any) -> tuple[str, ...]:
    """Return the names of the metrics that are computed from signals of the diagram."""
    return tuple(
        name
        for name, metric in metric_definitions(kind).items()
        if metric.accumulator is not None and all(map(diagram.HasOutputPort, metric.signals))
    )


def _checked_metrics(names: Iterable[str], kind: type[Metrics], diagram: Any) -> tuple[str, ...]:
    """Check that an environment can compute metrics at every step, and return their names.

    Raises:
        InputError: if there is no metric of this name, or the environment cannot compute it at every step.
    """
    for name in names:
        metric = lookup(metric_definitions(kind), name, "metric")
        if metric.accumulator is None:
            raise InputError(
                f"the metric {name} is computed from a recorded flight, so it is not available during the flight and"
                " cannot be a term of the reward"
            )
        missing = [signal for signal in metric.signals if not diagram.HasOutputPort(signal)]
        if missing:
            raise InputError(
                f"the metric {name} is not available in this environment, which has no {join_names(missing)}"
            )
    return tuple(names)


def _checked_signals(signals: Sequence[str], diagram: Any) -> tuple[str, ...]:
    ports = [diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())]
    available = [name for name in ports if name in SIGNALS]
    for name in signals:
        if name not in available:
            raise InputError(
                f"{short_repr(name)} is not a signal of this scenario; its signals are {join_names(available)}"
            )
        if [*signals].count(name) > 1:
            raise InputError(f"signals contains {name} twice")
    return tuple(signals)
