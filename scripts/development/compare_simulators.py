"""Measure how fast this library and other open-source simulators simulate flights along a circle, on one core.

Each simulator uses its own vehicle and controller. RotorPy and crazyflow are measured if they are installed:
pip install "rotorpy[batched]==3.0.0" crazyflow==0.4.0
"""

import importlib
import importlib.util
import math
import os
import statistics
import sys
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path += [str(folder) for folder in Path(__file__).parents[:2]]  # folders of contenders.py and benchmark.py
from benchmark import machine, timed
from contenders import Contender, installed, is_quick, run_isolated
from drake_quad.command_line.running import run

import numpy as np
from tqdm import tqdm

from drake_quad import Scenario, load_scenario
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import hermite_path
from drake_quad.scenario.batch import Batch

_DIAGRAMS = Path(__file__).parents[2] / "diagrams"
# Duration of a flight, which is one circle with a radius of 1 m at 0.63 m/s, 1 m above the ground.
_DURATION = 10.0  # s
_RATE = 2.0 * math.pi / _DURATION  # rad/s, angular velocity along the circle
_MAX_RMSE = 0.2  # m, over the second half of a flight; a simulator with a larger error does not fly the circle

# Function that flies a fleet around the circle once, and returns the RMSE of the first vehicle (m).
Flight = Callable[[], float]


def main() -> None:
    example = "python scripts/development/compare_simulators.py --quick"
    quick, available = is_quick(__doc__, example, "fleets of 50, each flown once"), installed(CONTENDERS)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    fleet = 50 if quick else 1000
    print(f"{machine()}; medians (and best) on one core, without the first flight, which compiles.\n")
    print(f"| | one vehicle, × real time | {fleet:,} vehicles, vehicle-seconds per second |")
    print("|---|---|---|", flush=True)
    for contender in tqdm(available, desc="flying", leave=False, disable=None):
        name = f"{contender.package} {version(contender.package)}, {contender.label}"
        try:
            count = 1 if quick else contender.repetitions
            single, fleet_speed = (run_isolated(partial(measured, contender, size, count)) for size in (1, fleet))
        except Exception as error:
            raise RuntimeError(f"{name}: cannot fly the circle: {error}") from error
        print(f"| {name} | {single} | {fleet_speed} |", flush=True)


def measured(contender: Contender, num_vehicles: int, repetitions: int) -> str:
    """Return the simulation speed of a contender in vehicle-seconds per second, as text: the median and the best."""
    flight = contender.build(num_vehicles)
    if not (error := flight()) < _MAX_RMSE:
        raise RuntimeError(f"the RMSE is {error:.2f} m, more than {_MAX_RMSE} m")
    seconds = [timed(flight) for _ in range(repetitions)]
    median, best = (num_vehicles * _DURATION / time for time in (statistics.median(seconds), min(seconds)))
    digits = 1 if best < 100.0 else 0
    return f"{median:,.{digits}f} ({best:,.{digits}f})"


def circle() -> tuple[Scenario, Plan]:
    """Return the scenario of the circle (the ideal laboratory, a PD cascade with feed-forward) and its plan."""
    times = np.linspace(0.0, _DURATION, 41)
    turns = [[_RATE**order * f(_RATE * times + 0.5 * math.pi * order) for f in (np.cos, np.sin)] for order in range(4)]
    height = np.outer([1.0, 0.0, 0.0, 0.0], np.ones_like(times))
    knots = np.stack([[*turn, up] for turn, up in zip(turns, height, strict=True)]).transpose(2, 0, 1)
    window = [f"duration={_DURATION}", f"metrics.start={0.5 * _DURATION}"]
    scenario = load_scenario(_DIAGRAMS / "figure_eight.yaml", window)
    return scenario, Plan.with_constant_yaw(hermite_path(times, knots))


def drake_quad_flight(num_vehicles: int, *, compiled: bool) -> Flight:
    """Return a function that flies the circle in this library.

    The flight starts at rest, whereas flights of the other simulators start in motion.
    """
    scenario, plan = circle()
    batch = Batch.draw(scenario, range(num_vehicles))
    simulation = simulate_fleet(batch, plan, record=num_vehicles == 1, compiled=compiled)

    def flight() -> float:
        simulation.reset(batch)
        simulation.fly(_DURATION)
        return float(simulation.metrics().rmse[0])

    return flight


def rotorpy_flight(num_vehicles: int) -> Flight:
    """Return a function that flies the circle with RotorPy's Crazyflie and its geometric controller.

    A fleet uses RotorPy's batched simulation, which is based on PyTorch.
    """
    return _rotorpy_alone() if num_vehicles == 1 else _rotorpy_batch(num_vehicles)


def _rotorpy_alone() -> Flight:
    control, vehicles = _module("rotorpy.controllers.quadrotor_control"), _module("rotorpy.vehicles.multirotor")
    parameters = _module("rotorpy.vehicles.crazyflie_params").quad_params
    trajectory = _module("rotorpy.trajectories.circular_traj").ThreeDCircularTraj(
        center=np.array([0.0, 0.0, 1.0]), radius=np.array([1.0, 1.0, 0.0]), freq=np.full(3, 1.0 / _DURATION)
    )
    state = {name: np.array(rows) for name, rows in _ROTORPY_STATE.items()}

    def flight() -> float:
        vehicle = vehicles.Multirotor(parameters, initial_state=state)
        environment = _module("rotorpy.environments").Environment(
            vehicle, control.SE3Control(parameters), trajectory, sim_rate=100
        )
        results = environment.run(t_final=_DURATION)
        return rmse(results["state"]["x"], results["flat"]["x"])

    return flight


def _rotorpy_batch(num_vehicles: int) -> Flight:
    torch, control = _module("torch"), _module("rotorpy.controllers.quadrotor_control")
    vehicles, worlds = _module("rotorpy.vehicles.multirotor"), _module("rotorpy.world")
    device = torch.device("cpu")
    parameters = vehicles.BatchedMultirotorParams(
        [_module("rotorpy.vehicles.crazyflie_params").quad_params] * num_vehicles, num_vehicles, device
    )
    state = {name: torch.tensor([rows] * num_vehicles).double() for name, rows in _ROTORPY_STATE.items()}
    vehicle = vehicles.BatchedMultirotor(parameters, num_vehicles, state, device, integrator="rk4")
    controller = control.BatchedSE3Control(parameters, num_vehicles, device)
    calm = _module("rotorpy.wind.default_winds").BatchedNoWind(num_vehicles)
    imu = _module("rotorpy.sensors.imu").BatchedImu(num_drones=num_vehicles, device=device)
    world = worlds.World.empty((-3.0, 3.0, -3.0, 3.0, -3.0, 3.0))

    class Circle:
        """Circular trajectory of all vehicles. RotorPy's class cannot handle the array of times in `simulate_batch`."""

        def update(self, times: np.ndarray) -> dict[str, Any]:
            cos, sin = torch.cos(torch.as_tensor(_RATE * times)), torch.sin(torch.as_tensor(_RATE * times))
            zero = torch.zeros_like(cos)
            turns = [(cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos), (cos, sin)]
            names = ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")
            derivatives = {
                name: torch.stack([_RATE**order * x, _RATE**order * y, zero + (order == 0)], dim=1)
                for order, (name, (x, y)) in enumerate(zip(names, turns, strict=True))
            }
            return derivatives | {"yaw": zero, "yaw_dot": zero}

    def flight() -> float:
        until = np.full(num_vehicles, _DURATION)
        options = {"terminate": False, "check_collisions": False}
        simulate = _module("rotorpy.simulate").simulate_batch
        results = simulate(world, state, vehicle, controller, Circle(), calm, imu, until, 0.01, 0.25, **options)
        return rmse(results[1]["x"][:, 0], results[3]["x"][:, 0])

    return flight


_ROTORPY_STATE = {
    "x": [1.0, 0.0, 1.0],
    "v": [0.0, _RATE, 0.0],
    "q": [0.0, 0.0, 0.0, 1.0],
    "w": [0.0, 0.0, 0.0],
    "wind": [0.0, 0.0, 0.0],
    "rotor_speeds": [1788.53] * 4,
}


def crazyflow_flight(num_vehicles: int, **options: Any) -> Flight:
    """Return a function that flies the circle with crazyflow's Crazyflie and Mellinger's controller.

    The whole flight is compiled as one JAX scan, which is the fastest mode of crazyflow.
    """
    jax, functional = _module("jax"), _module("crazyflow.sim.functional")
    jnp = jax.numpy
    options = {"state_freq": 100} | options
    state_rate = options["state_freq"]
    build = _module("crazyflow.sim").Sim
    sim = build(n_worlds=num_vehicles, control="state", dynamics="first_principles", **options)
    position = jnp.tile(jnp.array([1.0, 0.0, 1.0]), (num_vehicles, 1, 1))
    velocity = jnp.tile(jnp.array([0.0, _RATE, 0.0]), (num_vehicles, 1, 1))
    start = sim.data.replace(states=sim.data.states.replace(pos=position, vel=velocity))

    def circle(time: Any) -> Any:
        cos, sin = jnp.cos(_RATE * time), jnp.sin(_RATE * time)
        parts = [cos, sin, 1.0, -_RATE * sin, _RATE * cos, 0.0, -(_RATE**2) * cos, -(_RATE**2) * sin, 0.0]
        return jnp.tile(jnp.array([*parts, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), (num_vehicles, 1, 1))

    advance = sim.build_step_fn()

    def tick(data: Any, count: Any) -> tuple[Any, Any]:
        data = functional.state_control(data, circle(count / state_rate))
        data = advance(data, n_steps=sim.freq // state_rate)
        return data, data.states.pos[:, 0]

    ticks = jnp.arange(round(_DURATION * state_rate))
    scan = jax.jit(lambda data: jax.lax.scan(tick, data, ticks)[1])
    angles = _RATE * (np.asarray(ticks) + 1) / state_rate
    reference = np.stack([np.cos(angles), np.sin(angles), np.ones_like(angles)], axis=1)
    return lambda: rmse(np.asarray(scan(start))[:, 0], reference)


def rmse(positions: np.ndarray, reference: np.ndarray) -> float:
    """Return the RMSE of the position over the second half of a flight, m.

    Args:
        positions: flown positions, (ticks, 3), m.
        reference: reference positions, (ticks, 3), m.
    """
    late = slice(len(positions) // 2, None)
    return float(np.sqrt(np.sum((positions[late] - reference[late]) ** 2, axis=1).mean()))


def _module(name: str) -> Any:
    return importlib.import_module(name)


# Settings with which crazyflow has the same time steps as this library. Its default steps are shorter.
_OUR_TIME_STEPS: dict[str, Any] = {
    "freq": 100,
    "attitude_freq": 100,
    "body_rate_freq": 100,
    "force_torque_freq": 100,
    "state_freq": 50,
    "integrator": "rk4",
}

_OUR_RATES = "100 Hz, Runge-Kutta 4, control at 50 Hz"

CONTENDERS = (
    Contender("drake_quad", f"compiled, {_OUR_RATES}", partial(drake_quad_flight, compiled=True)),
    Contender("drake_quad", f"uncompiled, {_OUR_RATES}", partial(drake_quad_flight, compiled=False)),
    Contender("crazyflow", "100 Hz, Runge-Kutta 4", partial(crazyflow_flight, **_OUR_TIME_STEPS)),
    Contender("crazyflow", "default settings: 500 Hz, Euler", crazyflow_flight),
    Contender("rotorpy", "default settings: 100 Hz; fleet: Runge-Kutta 4", rotorpy_flight, repetitions=2),
)


if __name__ == "__main__":
    run(main)
