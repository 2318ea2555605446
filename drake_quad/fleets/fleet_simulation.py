"""Simulation of a fleet with Drake's simulator, in an uncompiled ("wired") or compiled diagram."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_quad.assembly.laboratory import jump_times
from drake_quad.assembly.recorder import clear_recorder, read_recorder
from drake_quad.assembly.registered_controllers import registered_leaf_systems
from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.compilation.compile_diagram import as_compilable, compile_diagram, compiled_part
from drake_quad.firmware.system import firmware_session
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch

# Simulated time between two checks for crashes in uncompiled diagrams, s. Progress is reported at the same interval.
_CHECK_INTERVAL = 1.0
# A compiled diagram is checked for crashes only once in this number of ticks. One event simulates all ticks between two
# checks, so that Drake's overhead is negligible.
_FLEET_CHECK_TICKS = 100  # ticks between two checks of a fleet
_SINGLE_VEHICLE_CHECK_TICKS = 500  # ticks between two checks of a single vehicle


class FleetSimulation(ABC):
    """Simulation of a fleet, which can be reset and repeated.

    Args:
        diagram: diagram to simulate.
        check_interval: simulated time between two checks for crashes, s.
        jumps: times at which the forces on the vehicles are discontinuous, s; see `jump_times`.

    Attributes:
        simulator: Drake's simulator.
        compiled: True if the diagram is compiled.
    """

    compiled: bool

    def __init__(self, diagram: Diagram, check_interval: float, jumps: Sequence[float] = ()) -> None:
        self.simulator, self._check_interval, self._jumps = Simulator(diagram), check_interval, jumps

    def fly(self, duration: float, *, progress: Callable[[float, float], None] | None = None) -> None:
        """Simulate from time zero to a duration, or until every vehicle has crashed.

        Args:
            duration: duration of the flight, s.
            progress: function that is called repeatedly with the simulated time and the duration, s.
        """
        with firmware_session(self.simulator.get_system()):
            fly(self.simulator, duration, check_interval=self._check_interval, jumps=self._jumps, progress=progress)

    @abstractmethod
    def reset(self, batch: Batch) -> None:
        """Reset the fleet to the start of another batch of the same scenario and size."""

    def metrics(self) -> Metrics:
        """Return the metrics of the N vehicles up to the current time, as (N,) arrays."""
        return read_metrics(*self._current_wired_context())

    def obstacle_hit(self) -> np.ndarray:
        """Return the (N,) numbers of the obstacles that the vehicles hit, counted from 1; 0 for no collision."""
        diagram, context = self._current_wired_context()
        monitor = diagram.GetSubsystemByName("monitor")
        return monitor.obstacle_hit(monitor.GetMyContextFromRoot(context))

    @abstractmethod
    def _current_wired_context(self) -> tuple[Diagram, Context]:
        """Return the uncompiled diagram, and its context with the current state."""

    @abstractmethod
    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (ticks,) times, s, and the (ticks, components · N) signals by name; requires `record=True`."""


class WiredSimulation(FleetSimulation):
    """Simulation of a fleet in the uncompiled diagram.

    Args:
        batch: samples that the fleet flies.
        plan: plan that the fleet flies.
        user_systems: user's systems that replace parts of the loop.
        record: True to record signals.
    """

    compiled = False

    def __init__(self, batch: Batch, plan: Plan, *, user_systems: UserSystems, record: bool) -> None:
        self._plan, self._user_systems = plan, user_systems
        self._diagram = build_fleet_diagram(batch, plan, user_systems=user_systems, record=record)
        super().__init__(self._diagram, _CHECK_INTERVAL, jump_times(batch))

    def reset(self, batch: Batch) -> None:
        """Reset the fleet to the start of another batch of the same scenario and size."""
        self._jumps = jump_times(batch)
        context = self.simulator.get_mutable_context()
        reset_fleet(self._diagram, context, batch, self._plan, user_systems=self._user_systems)
        if self._diagram.HasSubsystemNamed("recorder"):
            clear_recorder(self._diagram.GetSubsystemByName("recorder"), context)
        self.simulator.Initialize()

    def _current_wired_context(self) -> tuple[Diagram, Context]:
        return self._diagram, self.simulator.get_context()

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (ticks,) times, s, and the (ticks, components · N) signals by name; requires `record=True`."""
        return read_recorder(self._diagram.GetSubsystemByName("recorder"), self.simulator.get_context())


class CompiledSimulation(FleetSimulation):
    """Simulation of a fleet in a compiled diagram; the arguments are as in `WiredSimulation`.

    Raises:
        InputError: if the diagram cannot be compiled.
    """

    compiled = True

    def __init__(self, batch: Batch, plan: Plan, *, user_systems: UserSystems, record: bool) -> None:
        self._plan = plan
        # The state of a system that cannot be compiled exists only in the compiled diagram. In the uncompiled ("wired")
        # diagram, a stand-in replaces such a system.
        registered = {
            name: system
            for name, system in registered_leaf_systems(batch.scenario, len(batch)).items()
            if as_compilable(system) is not system
        }
        systems = {**registered, **user_systems.specified}
        self._user_systems = UserSystems(**{name: as_compilable(system) for name, system in systems.items()})
        # The parameters of a batch are set in this diagram and copied to the compiled diagram. To read the state, it is
        # copied back.
        self._wired = build_fleet_diagram(batch, plan, user_systems=self._user_systems)
        self._wired_context = self._wired.CreateDefaultContext()
        ticks = _SINGLE_VEHICLE_CHECK_TICKS if len(batch) == 1 else _FLEET_CHECK_TICKS
        # Flights end and are recorded at control ticks. The control period is given explicitly, because other parts of
        # the diagram may have longer periods.
        tick = batch.scenario.laboratory.command_link.period
        self._diagram = compile_diagram(self._wired, ticks=ticks, tick=tick, record=record)
        self._compiled = compiled_part(self._diagram)
        super().__init__(self._diagram, ticks * self._compiled.tick)

    def fly(self, duration: float, *, progress: Callable[[float, float], None] | None = None) -> None:
        """Simulate from time zero to a duration, or until every vehicle has crashed; see `FleetSimulation.fly`."""
        self._compiled.set_end(self._part_of(self.simulator.get_mutable_context()), duration)
        super().fly(duration, progress=progress)

    def reset(self, batch: Batch) -> None:
        """Reset the fleet to the start of another batch of the same scenario and size."""
        context = self.simulator.get_mutable_context()
        self._diagram.SetDefaultContext(context)
        context.SetTime(0.0)
        reset_fleet(self._wired, self._wired_context, batch, self._plan, user_systems=self._user_systems)
        self._compiled.read(self._part_of(context), self._wired_context)
        self.simulator.Initialize()

    def _current_wired_context(self) -> tuple[Diagram, Context]:
        self._compiled.write(self._part_of(self.simulator.get_mutable_context()), self._wired_context)
        return self._wired, self._wired_context

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (ticks,) times, s, and the (ticks, components · N) signals by name; requires `record=True`."""
        signals = self._compiled.log(self._part_of(self.simulator.get_mutable_context()))
        num_ticks = len(next(iter(signals.values())))
        return self._compiled.tick * np.arange(num_ticks), signals

    def _part_of(self, context: Context) -> Context:
        """Return the compiled system's context, given a context of the diagram that contains this system."""
        return self._compiled.GetMyMutableContextFromRoot(context)


def simulate_fleet(
    batch: Batch, plan: Plan, *, user_systems: UserSystems = UserSystems(), record: bool, compiled: bool
) -> FleetSimulation:
    """Create the simulation of a fleet.

    Args:
        batch: samples that the fleet flies.
        plan: plan that the fleet flies.
        user_systems: user's systems that replace parts of the loop.
        record: True to record signals.
        compiled: True to compile the diagram.

    Raises:
        InputError: if the ports of a user's system do not match the diagram, or the diagram cannot be compiled.
    """
    return (CompiledSimulation if compiled else WiredSimulation)(batch, plan, user_systems=user_systems, record=record)


def fly(
    simulator: Simulator,
    duration: float,
    *,
    check_interval: float = _CHECK_INTERVAL,
    jumps: Sequence[float] = (),
    progress: Callable[[float, float], None] | None = None,
) -> None:
    """Simulate a fleet diagram from time zero to a duration, or until every vehicle has crashed.

    Args:
        simulator: simulator of the diagram.
        duration: duration of the flight, s.
        check_interval: simulated time between two checks for crashes, after each of which progress is reported, s.
        jumps: times at which the forces on vehicles with a continuous state are discontinuous, s; see `jump_times`.
        progress: function that is called after each check with the simulated time and the duration, s.
    """
    diagram, context = simulator.get_system(), simulator.get_context()
    crashed = diagram.GetOutputPort("crashed")
    # An integration step must not contain a jump of the forces. One step therefore ends just before each jump, and the
    # next step ends at the jump.
    stops = {stop for jump in jumps for stop in (math.nextafter(jump, 0.0), jump)}
    time = 0.0
    while time < duration and not (crashed.Eval(context) != 0.0).all():
        time = min(time + check_interval, duration, *[stop for stop in stops if stop > time])
        simulator.AdvanceTo(time)
        if progress is not None:
            progress(time, duration)
    simulator.AdvancePendingEvents()


def read_metrics(diagram: Diagram, context: Context) -> Metrics:
    """Return the metrics of all vehicles in a fleet diagram up to the current time, (N,) arrays."""
    monitor = diagram.GetSubsystemByName("monitor")
    return monitor.metrics(monitor.GetMyContextFromRoot(context))
