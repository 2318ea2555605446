"""Measure the steps per second of environments of this library and of crazyflow on one machine.

The environments of this library are:

- the figure eight at 100 Hz in the ideal laboratory
- the figure eight with wind, noise, packet loss, and a vehicle that differs from its nominal model
- robustness.yaml with random actions, which make vehicles crash and restart frequently

The environment of crazyflow is its figure eight: at 100 Hz with five simulator steps per environment step, and at
500 Hz with one. It is measured if crazyflow is installed: pip install crazyflow==0.4.0
"""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

sys.path += [str(folder) for folder in Path(__file__).parents[:2]]  # folders of contenders.py and benchmark.py
from benchmark import ALL_IMPERFECTIONS, machine
from contenders import Contender, installed, is_quick, run_isolated
from drake_quad.command_line.running import run

import numpy as np
from tqdm import tqdm

SIZES = (1, 64, 1024)  # numbers of vehicles
_MEASURED_SECONDS = 2.0  # duration of a measurement; a warm-up of the same duration precedes it
_NUM_ROUNDS = 5  # measurements of each environment
_AT_100_HZ = {"laboratory.command_link.period": 0.01}
# Number of vehicle steps during which the growth of a process's memory is measured.
_NUM_MEMORY_STEPS = 10_000_000

# Function without arguments that advances all vehicles of an environment by one step.
Step = Callable[[], object]


def main() -> None:
    example = "python scripts/development/compare_environments.py --quick"
    quick, available = (
        is_quick(__doc__, example, "64 vehicles, one round of a tenth of a second"),
        installed(CONTENDERS),
    )
    rounds, seconds, sizes = (1, 0.1, SIZES[1:2]) if quick else (_NUM_ROUNDS, _MEASURED_SECONDS, SIZES)
    rates_by_label: dict[str, list[list[float]]] = {each.label: [[] for _ in sizes] for each in available}
    for _ in tqdm(range(rounds), desc="rounds", leave=False, disable=None):
        for contender in available:
            for column, size in enumerate(sizes):
                rates_by_label[contender.label][column].append(run_isolated(partial(rate, contender, size, seconds)))
    print(f"{machine()}; medians of {rounds} interleaved launches.\n")
    print("| steps per second | " + " | ".join(f"{size:,} vehicle{'s' if size > 1 else ''}" for size in sizes) + " |")
    print("|---|" + "---|" * len(sizes))
    for label, rates in rates_by_label.items():
        print(f"| {label} | " + " | ".join(f"{statistics.median(each):,.0f}" for each in rates) + " |")
    print(f"\n{memory_growth(1024, _NUM_MEMORY_STEPS // (100 if quick else 1))}")


def rate(contender: Contender, num_vehicles: int, seconds: float) -> float:
    """Return the number of vehicle steps per second that an environment computes.

    Args:
        contender: environment and its settings.
        num_vehicles: number of vehicles.
        seconds: duration of the measurement, and of the warm-up before it, s.
    """
    step = contender.build(num_vehicles)
    # The first of two rounds is the warm-up. The measured time includes starts of new episodes.
    for _ in range(2):
        count, began = 0, time.perf_counter()
        while time.perf_counter() - began < seconds:
            step()
            count += 1
        taken = time.perf_counter() - began
    return num_vehicles * count / taken


def memory_growth(num_vehicles: int, steps: int) -> str:
    """Return a sentence about the memory that a process uses during many steps with frequent crashes."""
    first, last = run_isolated(partial(_peak_sizes, num_vehicles, steps))
    return (
        f"memory during {steps:,} steps of {num_vehicles:,} vehicles that frequently restart: peak {first:.1f} MB in"
        f" the first tenth of the steps, {last:.1f} MB in total"
    )


def _peak_sizes(num_vehicles: int, steps: int) -> Sequence[float]:
    step, sizes = crashing_fleet(num_vehicles), []
    for k in range(rounds := max(10, steps // num_vehicles)):
        step()
        if k + 1 in (rounds // 10, rounds):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    return sizes


def figure_eight(num_vehicles: int, *, everything: bool) -> Step:
    """Return a function that steps this library's figure-eight environment with the hover action.

    Args:
        num_vehicles: number of vehicles.
        everything: True to enable wind, noise and all other imperfections.
    """
    from drake_quad.gym import QuadrotorVectorEnv

    scenario, more = ("laboratory:nominal", ALL_IMPERFECTIONS) if everything else ("figure_eight", [])
    envs = QuadrotorVectorEnv(scenario, [*more, _AT_100_HZ], num_envs=num_vehicles, action="attitude")
    envs.reset(seed=0)
    actions = np.zeros((num_vehicles, 4))
    return lambda: envs.step(actions)


def crashing_fleet(num_vehicles: int) -> Step:
    """Return a function that steps robustness.yaml, which has 31 random parameters, with actions that cause crashes."""
    from drake_quad.gym import QuadrotorVectorEnv

    envs = QuadrotorVectorEnv("robustness", _AT_100_HZ, num_envs=num_vehicles, action="rates")
    envs.reset(seed=0)
    random = np.random.default_rng(0)
    return lambda: envs.step(random.uniform(-1.0, 1.0, (num_vehicles, 4)))


def crazyflow_figure_eight(num_vehicles: int, *, frequency: int) -> Step:
    """Return a function that steps crazyflow's figure-eight environment with the hover action.

    The function converts the results to NumPy arrays, as users need them.
    """
    tree = import_module("jax").tree
    envs = import_module("crazyflow.envs").FigureEightEnv(num_envs=num_vehicles, freq=frequency)
    envs.reset(seed=0)
    actions = 0.5 * (envs.action_space.low + envs.action_space.high)
    return lambda: tree.map(np.asarray, envs.step(actions))


CONTENDERS = [
    Contender("drake_quad", "drake_quad, ideal", partial(figure_eight, everything=False)),
    Contender("drake_quad", "drake_quad, everything", partial(figure_eight, everything=True)),
    Contender("drake_quad", "drake_quad, robustness, crashing", crashing_fleet),
    Contender("crazyflow", "crazyflow 0.4, 100 Hz", partial(crazyflow_figure_eight, frequency=100)),
    Contender("crazyflow", "crazyflow 0.4, 500 Hz", partial(crazyflow_figure_eight, frequency=500)),
]


if __name__ == "__main__":
    run(main)
