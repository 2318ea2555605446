"""Simulation of worlds with Drake's simulator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_quad.assembly.recorder import read_recorder
from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part
from drake_quad.errors import InputError
from drake_quad.firmware.system import firmware_session
from drake_quad.fleets.fleet_simulation import fly
from drake_quad.flight.flight import Flight
from drake_quad.flight.simulation import collect_flights
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.worlds.world import World
from drake_quad.worlds.world_diagram import build_world_diagram, draw_batches, reset_world

# Ticks that one event of a compiled diagram simulates between two checks whether all vehicles have crashed.
_CHECK_TICKS = 100


class WorldSimulation:
    """Simulation of N worlds side by side, which can be reset and repeated.

    Args:
        world: world that is simulated.
        batches: samples to fly, by the name of the vehicle.
        record: True to record signals.
        compiled: True to compile the diagram.

    Attributes:
        plans: plan of each vehicle, by its name.
        duration: duration of a flight, s.
        simulator: Drake's simulator.
        compiled: True if the diagram is compiled.
    """

    def __init__(self, world: World, batches: Mapping[str, Batch], *, record: bool, compiled: bool) -> None:
        self.world, self.compiled = world, compiled
        self.plans: dict[str, Plan] = world.plans()
        scenarios = world.vehicles.items()
        self.duration = max(flight_duration(scenario, self.plans[name]) for name, scenario in scenarios)
        self._wired = build_world_diagram(world, batches, self.plans, record=record and not compiled)
        tick = next(iter(world.vehicles.values())).laboratory.command_link.period
        if compiled:
            self._wired_context = self._wired.CreateDefaultContext()
            self._diagram = compile_diagram(self._wired, ticks=_CHECK_TICKS, tick=tick, record=record)
            self._part: Any = compiled_part(self._diagram)
        else:
            self._diagram = self._wired
        self.simulator = Simulator(self._diagram)
        self._check_interval = _CHECK_TICKS * tick

    def reset(self, batches: Mapping[str, Batch]) -> None:
        """Reset the worlds to the start of other batches of the same scenarios and size."""
        context = self.simulator.get_mutable_context()
        if self.compiled:
            self._diagram.SetDefaultContext(context)
            context.SetTime(0.0)
            reset_world(self._wired, self._wired_context, batches, self.plans)
            self._part.read(self._part.GetMyMutableContextFromRoot(context), self._wired_context)
        else:
            reset_world(self._wired, context, batches, self.plans)
        self.simulator.Initialize()

    def fly(self, duration: float | None = None) -> None:
        """Simulate from time zero to a duration (s), or until every vehicle has crashed."""
        duration = self.duration if duration is None else duration
        if self.compiled:
            context = self.simulator.get_mutable_context()
            self._part.set_end(self._part.GetMyMutableContextFromRoot(context), duration)
        with firmware_session(self.simulator.get_system()):
            fly(self.simulator, duration, check_interval=self._check_interval)

    def wired_context(self) -> tuple[Diagram, Context]:
        """Return the uncompiled diagram, and its context with the current state."""
        if not self.compiled:
            return self._wired, self.simulator.get_context()
        part = self._part.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        self._part.write(part, self._wired_context)
        return self._wired, self._wired_context

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (ticks,) times, s, and the (ticks, components · N) signals by name; requires `record=True`."""
        if not self.compiled:
            return read_recorder(self._wired.GetSubsystemByName("recorder"), self.simulator.get_context())
        signals = self._part.log(self._part.GetMyMutableContextFromRoot(self.simulator.get_mutable_context()))
        return self._part.tick * np.arange(len(next(iter(signals.values())))), signals

    def smallest_clearances(self) -> np.ndarray:
        """Return the (N, k) smallest clearances of the k vehicles of each world up to the current time, m.

        They are negative for vehicles that have collided, and 1e9 for a single vehicle.
        """
        diagram, context = self.wired_context()
        proximity = diagram.GetSubsystemByName("proximity")
        clearances: np.ndarray = proximity.smallest_clearances(proximity.GetMyContextFromRoot(context)).T
        return clearances

    def metrics(self, name: str) -> Metrics:
        """Return the metrics of a vehicle in the N worlds, (N,) arrays."""
        return _VehicleSimulation(self, name).metrics()


@dataclass(frozen=True)
class _VehicleSimulation:
    """Part of a simulation that belongs to one vehicle; a `RecordedSimulation`."""

    simulation: WorldSimulation
    name: str

    @property
    def compiled(self) -> bool:
        return self.simulation.compiled

    def _monitor(self) -> tuple[Any, Context]:
        diagram, context = self.simulation.wired_context()
        monitor = diagram.GetSubsystemByName(self.name).GetSubsystemByName("monitor")
        return monitor, monitor.GetMyContextFromRoot(context)

    def metrics(self) -> Metrics:
        monitor, context = self._monitor()
        metrics: Metrics = monitor.metrics(context)
        return metrics

    def obstacle_hit(self) -> np.ndarray:
        monitor, context = self._monitor()
        hit: np.ndarray = monitor.obstacle_hit(context)
        return hit

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        time, signals = self.simulation.recording()
        prefix = f"{self.name}."
        return time, {name.removeprefix(prefix): values for name, values in signals.items() if name.startswith(prefix)}


@dataclass(frozen=True)
class Collision:
    """Collision of a vehicle with another one.

    Attributes:
        vehicle: name of the vehicle.
        other: name of the other vehicle.
        time: time of the collision, s.
    """

    vehicle: str
    other: str
    time: float


@dataclass(frozen=True)
class WorldFlight:
    """Flight of all vehicles of a world.

    Attributes:
        world: world that was flown.
        flights: flight of each vehicle, by its name.
        collisions: collisions, in the order of their time.
    """

    world: World
    flights: dict[str, Flight]
    collisions: tuple[Collision, ...]

    @property
    def smallest_distance(self) -> float:
        """Smallest distance between the centres of two flying vehicles at a tick, m; infinite for one vehicle."""
        distances = [np.inf]
        names = [*self.flights]
        for k, name in enumerate(names):
            for other in names[k + 1 :]:
                distances.append(distance_between(self.flights[name], self.flights[other]).min(initial=np.inf))
        return float(min(distances))


def distance_between(first: Flight, second: Flight) -> np.ndarray:
    """Return the (ticks,) distances between two vehicles, m, at the ticks at which both fly."""
    count = min(len(first.time), len(second.time))
    states = first.record("state"), second.record("state")
    here, there = (np.stack([each.x[:count], each.y[:count], each.z[:count]]) for each in states)
    return np.linalg.norm(here - there, axis=0)


def simulate_world(world: World, *, sample: int = 0, seed: int | None = None, compiled: bool = True) -> WorldFlight:
    """Simulate a world, and record all signals of all vehicles.

    Args:
        world: world to simulate.
        sample: index of the sample, which determines the random parameters, the wind and the noise.
        seed: seed of the samples; by default the seed of each scenario.
        compiled: True to compile the diagram to machine code.

    Raises:
        InputError: if the rotors of a vehicle cannot fly its route.
    """
    return simulate_worlds(world, [sample], seed=seed, compiled=compiled)[0]


def simulate_worlds(
    world: World, samples: Sequence[int], *, seed: int | None = None, compiled: bool = True
) -> list[WorldFlight]:
    """Simulate samples of a world side by side, as `simulate_world` does for one sample."""
    if not len(samples):
        raise InputError("samples is empty, but must contain at least one sample")
    batches = draw_batches(world, samples, seed=seed)
    simulation = WorldSimulation(world, batches, record=True, compiled=compiled)
    simulation.fly()
    flights = {
        name: collect_flights(batch, simulation.plans[name], _VehicleSimulation(simulation, name))
        for name, batch in batches.items()
    }
    by_world = [{name: each[k] for name, each in flights.items()} for k in range(len(samples))]
    return [WorldFlight(world, each, _collisions(world, each)) for each in by_world]


def _collisions(world: World, flights: Mapping[str, Flight]) -> tuple[Collision, ...]:
    found = []
    for name, flight in flights.items():
        time = flight.metrics.crash_time
        if not flight.metrics.crashed or flight.record("clearance").distance[-1] >= 0.0:
            continue
        others = {
            other: distance_between(flight, each)[-1]
            for other, each in flights.items()
            if other != name and each.metrics.crash_time >= time
        }
        found.append(Collision(name, min(others, key=others.__getitem__), time))
    return tuple(sorted(found, key=lambda each: each.time))
