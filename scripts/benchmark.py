"""Measures the speed of one flight, of fleets and of planning, as a table in Markdown."""

import argparse
import gc
import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from command_line import run
from pydrake.systems.analysis import Simulator

from drake_quad import Scenario, build_tracking_diagram, load_scenario
from drake_quad.flight import flight_duration, fly
from drake_quad.planning import plan_route
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import to_piecewise_polynomial

_FIGURE_EIGHT = Path(__file__).parent.parent / "diagrams" / "figure_eight.yaml"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, epilog="example: python scripts/benchmark.py --quick")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and sizes")
    quick = parser.parse_args().quick
    repetitions = 5 if quick else 15
    sizes = (64, 1024) if quick else (64, 256, 1024, 2048, 3072, 4096)
    scenario = load_scenario(_FIGURE_EIGHT)

    flight = Stepper(scenario, 1, record=True, duration=flight_duration(scenario, plan_route(scenario)))
    fleets = [Stepper(scenario, size, record=False, duration=1.0) for size in sizes]
    # In turn, so that all of them see the same drift of the machine.
    alone, *costs = interleaved([flight, *fleets], repetitions)

    print(f"{machine()}; one core, medians (and best) of {repetitions} runs.\n")
    print("| | speed | cost of a vehicle against one alone |")
    print("|---|---|---|")
    print(f"| one flight, every signal recorded | {spread(alone, 1)} × real time | |")
    for size, cost in zip(sizes, costs, strict=True):
        cheaper = statistics.median(alone) * size / statistics.median(cost)
        print(f"| fleet of {size:,} | {spread(cost, size)} vehicle-seconds per second | 1/{cheaper:.0f} |")
    for count in (10, 50, 200):
        times = planning_times(count, 9 * repetitions)
        print(f"| minimum snap through {count} waypoints | {1e3 * statistics.median(times):.2f} ms | |")


def spread(costs: list[float], size: int) -> str:
    """Vehicle-seconds per second: the median, and the best in parentheses."""
    return f"{size / statistics.median(costs):,.0f} ({size / min(costs):,.0f})"


class Stepper:
    """A tracking diagram that is flown from the start for some time, again and again."""

    def __init__(self, scenario: Scenario, num_vehicles: int, *, record: bool, duration: float) -> None:
        self._diagram = build_tracking_diagram(scenario, num_vehicles, record=record)
        self._duration = duration

    def cost(self) -> float:
        """Seconds of computing for a second of flight."""
        simulator = Simulator(self._diagram)
        simulator.Initialize()
        return timed(lambda: fly(simulator, self._duration)) / self._duration


def interleaved(steppers: list[Stepper], repetitions: int) -> list[list[float]]:
    """The costs of each stepper over rounds in which each has its turn."""
    gc.collect()
    rounds = [[stepper.cost() for stepper in steppers] for _ in range(repetitions)]
    return [list(costs) for costs in zip(*rounds, strict=True)]


def planning_times(count: int, repetitions: int) -> list[float]:
    """Seconds from waypoints in space to Drake's trajectory."""
    rng = np.random.default_rng(0)
    waypoints = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    times = np.cumsum(rng.uniform(0.5, 2.0, count))
    return [timed(lambda: to_piecewise_polynomial(minimum_snap(waypoints, times))) for _ in range(repetitions)]


def timed(work: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def machine() -> str:
    """What this was measured on."""
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
