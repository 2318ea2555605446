"""Flies short pieces again and again in a process of its own, for `benchmark.py`: `python contestants.py WHO`.

WHO is `compiled` or `wired`, for this project's two ways to fly; `before`, for the checkout of commit d4354ba whose
folder `scripts` is the second argument and whose environment runs this; or `crazyflow`. For each name of a piece that
comes in on standard input a line goes out: the processor's seconds for a second of a vehicle's flight.
"""

import os
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, LeafSystem

# A piece is flown until it has taken so much of the processor's time, s.
_ENOUGH = 0.08
_FLEET_SECONDS = 1.0
_STUDY_FLIGHTS = 10_000

# Flies a piece and returns the seconds that it took, and the seconds of flight of all vehicles.
Piece = Callable[[], tuple[float, float]]


def main() -> None:
    who = sys.argv[1]
    if who == "before":
        sys.path[0] = sys.argv[2]
    os.environ["SCIPY_ARRAY_API"] = "1"  # crazyflow needs it from the first import of SciPy on
    answers, sys.stdout = sys.stdout, sys.stderr
    pieces: dict[str, Piece | None] = {}
    for line in sys.stdin:
        name = line.strip()
        if name not in pieces:
            pieces[name] = piece_of(who, name)
            cost(pieces[name])
        answers.write(f"{cost(pieces[name])}\n")
        answers.flush()


def cost(piece: Piece | None) -> float:
    """Seconds for a second of a vehicle's flight; not a number for a piece that nobody has."""
    seconds, flown = 0.0, 0.0
    while piece is not None and seconds < _ENOUGH:
        more, further = piece()
        seconds, flown = seconds + more, flown + further
    return seconds / flown if flown else float("nan")


def piece_of(who: str, name: str) -> Piece | None:
    """The piece of a name, with the number of vehicles at its end."""
    import benchmark

    import compare_simulators

    from drake_quad import load_scenario

    kind, _, size = name.partition("_")
    num_vehicles = int(size)
    if who == "crazyflow":
        return crazyflow_circle(compare_simulators, num_vehicles) if kind == "circle" else None
    diagrams = Path(benchmark.__file__).parent.parent / "diagrams"
    if kind == "study":
        options: dict[str, Any] = {} if who == "before" else {"compiled": who == "compiled"}
        robustness = load_scenario(diagrams / "robustness.yaml")

        def fly() -> tuple[float, float]:
            found = benchmark.study(robustness, num_vehicles, 2, **options)
            return found.seconds, found.flown

        return fly
    if kind == "circle":
        scenario, plan = compare_simulators.circle() if who != "before" else circle_before(compare_simulators)
        return flights(who, scenario, num_vehicles, plan=plan)
    if kind == "ideal":
        return flights(who, load_scenario(diagrams / "figure_eight.yaml"), num_vehicles)
    nominal = diagrams / "laboratory.yaml:nominal"
    if kind == "python":
        soft = load_scenario(nominal, layers=[diagrams / "gains" / "laboratory.yaml"])
        return flights(who, soft, num_vehicles, position_controller=PlainPython(num_vehicles))
    everything = load_scenario(nominal, benchmark.EVERYTHING, layers=[benchmark._NETWORK])
    return flights(who, everything, num_vehicles)


def flights(who: str, scenario: Any, num_vehicles: int, **given: Any) -> Piece:
    """A whole flight of one vehicle, recorded, or the first second of a fleet's, without what is done before it."""
    start, duration = (start_before if who == "before" else start_now)(who, scenario, num_vehicles, given)

    def fly() -> tuple[float, float]:
        go = start()
        began = time.process_time()
        go()
        return time.process_time() - began, num_vehicles * duration

    return fly


def start_now(
    who: str, scenario: Any, num_vehicles: int, given: dict[str, Any]
) -> tuple[Callable[[], Callable[[], None]], float]:
    """A function that prepares a flight and returns another that flies it; and its duration, s."""
    from drake_quad.assembly.user_systems import UserSystems
    from drake_quad.fleets.fleet_simulation import simulate_fleet
    from drake_quad.flight.mission import plan_route
    from drake_quad.planning.duration import flight_duration
    from drake_quad.scenario.batch import Batch

    plan = given.pop("plan", None) or plan_route(scenario)
    batch, own = Batch.draw(scenario, range(num_vehicles)), UserSystems(**given)
    alone = num_vehicles == 1
    simulation = simulate_fleet(batch, plan, own=own, record=alone, compiled=who == "compiled")
    duration = flight_duration(scenario, plan) if alone else _FLEET_SECONDS

    def start() -> Callable[[], None]:
        simulation.reset(batch)
        return lambda: simulation.fly(duration)

    return start, duration


def start_before(
    who: str, scenario: Any, num_vehicles: int, given: dict[str, Any]
) -> tuple[Callable[[], Callable[[], None]], float]:
    """The same with the functions of before."""
    flight, planning, tracking = (import_module(f"drake_quad.{name}") for name in ("flight", "planning", "tracking"))
    alone, samples = num_vehicles == 1, range(num_vehicles)
    diagram = tracking.build_tracking_diagram(scenario, num_vehicles, samples=samples, record=alone, **given)
    plan = given.get("plan") or planning.plan_route(scenario)
    duration = planning.flight_duration(scenario, plan) if alone else _FLEET_SECONDS

    def start() -> Callable[[], None]:
        simulator = Simulator(diagram)
        simulator.Initialize()
        return lambda: flight.fly(simulator, duration)

    return start, duration


def circle_before(others: Any) -> tuple[Any, Any]:
    """The circle of the comparison with other simulators, made by its functions of before."""
    made: dict[str, Any] = {}

    def keep(scenario: Any, num_vehicles: int, *, plan: Any, record: bool) -> None:
        made.update(scenario=scenario, plan=plan)

    others.build_tracking_diagram = keep
    others.drake_quad_flight(1)
    return made["scenario"], made["plan"]


def crazyflow_circle(others: Any, num_vehicles: int) -> Piece:
    """Once around the same circle in crazyflow, with steps like ours."""
    flight = others.crazyflow_flight(num_vehicles, **others._LIKE_OURS)

    def fly() -> tuple[float, float]:
        began = time.process_time()
        flight()
        return time.process_time() - began, num_vehicles * others._DURATION

    return fly


class PlainPython(LeafSystem):
    """A position controller as a user would write it: PD and feed-forward, without a word on machine code."""

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


if __name__ == "__main__":
    main()
