"""Measures how many steps a second environments of this and of another open simulator take, on one machine.

Ours is the figure eight at 100 Hz, in the ideal laboratory, and with everything: wind, noise, losses, and a vehicle
that is not as it is believed; and robustness.yaml under actions at random, with which vehicles crash and begin anew all
the time. crazyflow's is its figure eight, at 100 Hz, five steps of its simulator each, and at 500 Hz, one each. It is
measured if it is there: pip install crazyflow==0.4.0
"""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path

sys.path += [str(folder) for folder in Path(__file__).parents[:2]]  # contenders.py and benchmark.py are there
from benchmark import EVERYTHING, machine
from contenders import Contender, apart, installed, is_quick
from drake_quad.command_line.running import run

import numpy as np
from tqdm import tqdm

SIZES = (1, 64, 1024)
# Of a measurement, s, after as much that is not counted; and how often each takes its turn.
_SECONDS, _ROUNDS = 2.0, 5
_AT_100_HZ = {"laboratory.command_link.period": 0.01}
# Steps of all vehicles in which the memory of a process is watched.
_MEMORY_STEPS = 10_000_000

# Takes a step of all vehicles.
Stepping = Callable[[], object]


def main() -> None:
    example = "python scripts/development/compare_environments.py --quick"
    quick, there = is_quick(__doc__, example, "64 vehicles, one round of a tenth of a second"), installed(CONTENDERS)
    rounds, seconds, sizes = (1, 0.1, SIZES[1:2]) if quick else (_ROUNDS, _SECONDS, SIZES)
    found: dict[str, list[list[float]]] = {each.how: [[] for _ in sizes] for each in there}
    for _ in tqdm(range(rounds), desc="rounds", leave=False, disable=None):
        for contender in there:
            for place, size in enumerate(sizes):
                found[contender.how][place].append(apart(partial(rate, contender, size, seconds)))
    print(f"{machine()}; medians of {rounds} launches by turns.\n")
    print("| steps a second | " + " | ".join(f"{size:,} vehicle{'s' if size > 1 else ''}" for size in sizes) + " |")
    print("|---|" + "---|" * len(sizes))
    for how, rates in found.items():
        print(f"| {how} | " + " | ".join(f"{statistics.median(each):,.0f}" for each in rates) + " |")
    print(f"\n{grown(1024, _MEMORY_STEPS // (100 if quick else 1))}")


def rate(contender: Contender, num_vehicles: int, seconds: float) -> float:
    """Return the number of steps a second."""
    step = contender.build(num_vehicles)
    # Twice, of which the first warms up; what the beginnings of episodes take is in it.
    for _ in range(2):
        count, began = 0, time.perf_counter()
        while time.perf_counter() - began < seconds:
            step()
            count += 1
        taken = time.perf_counter() - began
    return num_vehicles * count / taken


def grown(num_vehicles: int, steps: int) -> str:
    """By how much a process has grown after many steps of an environment in which vehicles crash all the time."""
    first, last = apart(partial(_sizes, num_vehicles, steps))
    return (
        f"{steps:,} steps of {num_vehicles:,} vehicles that begin anew all the time: {first:.1f} MB at most in the"
        f" first tenth, {last:.1f} MB in all"
    )


def _sizes(num_vehicles: int, steps: int) -> Sequence[float]:
    step, sizes = crashing(num_vehicles), []
    for k in range(rounds := max(10, steps // num_vehicles)):
        step()
        if k + 1 in (rounds // 10, rounds):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    return sizes


def ours(num_vehicles: int, *, everything: bool) -> Stepping:
    """Our environment, flown by an action that hovers."""
    from drake_quad.gym import QuadrotorVectorEnv

    scenario, more = ("laboratory:nominal", EVERYTHING) if everything else ("figure_eight", [])
    envs = QuadrotorVectorEnv(scenario, [*more, _AT_100_HZ], num_envs=num_vehicles, action="attitude")
    envs.reset(seed=0)
    actions = np.zeros((num_vehicles, 4))
    return lambda: envs.step(actions)


def crashing(num_vehicles: int) -> Stepping:
    """Our environment with 31 distributions, in which vehicles crash all the time."""
    from drake_quad.gym import QuadrotorVectorEnv

    envs = QuadrotorVectorEnv("robustness", _AT_100_HZ, num_envs=num_vehicles, action="rates")
    envs.reset(seed=0)
    random = np.random.default_rng(0)
    return lambda: envs.step(random.uniform(-1.0, 1.0, (num_vehicles, 4)))


def crazyflow(num_vehicles: int, *, frequency: int) -> Stepping:
    """The figure eight of crazyflow, flown by an action that hovers; what comes out is NumPy's, as ours."""
    tree = import_module("jax").tree
    envs = import_module("crazyflow.envs").FigureEightEnv(num_envs=num_vehicles, freq=frequency)
    envs.reset(seed=0)
    actions = 0.5 * (envs.action_space.low + envs.action_space.high)
    return lambda: tree.map(np.asarray, envs.step(actions))


CONTENDERS = [
    Contender("drake_quad", "drake_quad, ideal", partial(ours, everything=False)),
    Contender("drake_quad", "drake_quad, everything", partial(ours, everything=True)),
    Contender("drake_quad", "drake_quad, robustness, crashing", crashing),
    Contender("crazyflow", "crazyflow 0.4, 100 Hz", partial(crazyflow, frequency=100)),
    Contender("crazyflow", "crazyflow 0.4, 500 Hz", partial(crazyflow, frequency=500)),
]


if __name__ == "__main__":
    run(main)
