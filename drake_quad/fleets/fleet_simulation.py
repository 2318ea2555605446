"""A fleet under Drake's simulator, in the diagram as it is wired or in a compiled one."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from drake_quad.assembly.laboratory import jump_times
from drake_quad.assembly.recorder import clear_recorder, read_recorder
from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part, or_stand_in
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch

# Time of flight between two checks for crashes, which are also the reports of progress, s.
_STRIDE = 1.0
# The same interval in ticks of compiled diagrams. With many ticks in an event, Drake's overhead is negligible.
_TICKS, _TICKS_ALONE = 100, 500


class FleetSimulation(ABC):
    """Simulation of a fleet, which can be reset and repeated.

    Args:
        diagram: diagram that is simulated.
        stride: interval between checks for crashes, s.
        jumps: times at which the forces on the vehicles are discontinuous, s, see `jump_times`.

    Attributes:
        simulator: Drake's simulator.
        compiled: True if the diagram is compiled.
    """

    compiled: bool

    def __init__(self, diagram: Diagram, stride: float, jumps: Sequence[float] = ()) -> None:
        self.simulator, self._stride, self._jumps = Simulator(diagram), stride, jumps

    def fly(self, duration: float, *, progress: Callable[[float, float], None] | None = None) -> None:
        """Simulate from time zero to a duration, or until every vehicle has crashed.

        Args:
            duration: duration of the flight, s.
            progress: function that is called from time to time with the simulated time and the duration, s.
        """
        fly(self.simulator, duration, stride=self._stride, jumps=self._jumps, progress=progress)

    @abstractmethod
    def reset(self, batch: Batch) -> None:
        """Reset the fleet to the start of another batch of the same scenario and size."""

    def metrics(self) -> Metrics:
        """Return the (N,) metrics so far."""
        return read_metrics(*self._wired_now())

    def touched(self) -> np.ndarray:
        """(N,) number of the obstacle that each vehicle crashed into, from 1 on; 0 if it touched none."""
        diagram, context = self._wired_now()
        monitor = diagram.GetSubsystemByName("monitor")
        return monitor.touched(monitor.GetMyContextFromRoot(context))

    @abstractmethod
    def _wired_now(self) -> tuple[Diagram, Context]:
        """Return the diagram as it is wired, and a context of it with the state so far."""

    @abstractmethod
    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(ticks,) times in s, and the (ticks, rows · N) signals by name, if they were to be recorded."""


class WiredSimulation(FleetSimulation):
    """A fleet in the diagram as it is wired.

    Args:
        batch: that is flown.
        plan: that is flown.
        own: systems of the user's.
        record: whether signals are recorded.
    """

    compiled = False

    def __init__(self, batch: Batch, plan: Plan, *, own: UserSystems, record: bool) -> None:
        self._plan, self._own = plan, own
        self._diagram = build_fleet_diagram(batch, plan, own=own, record=record)
        super().__init__(self._diagram, _STRIDE, jump_times(batch))

    def reset(self, batch: Batch) -> None:
        """As for every `FleetSimulation`."""
        self._jumps = jump_times(batch)
        context = self.simulator.get_mutable_context()
        reset_fleet(self._diagram, context, batch, self._plan, own=self._own)
        if self._diagram.HasSubsystemNamed("recorder"):
            clear_recorder(self._diagram.GetSubsystemByName("recorder"), context)
        self.simulator.Initialize()

    def _wired_now(self) -> tuple[Diagram, Context]:
        return self._diagram, self.simulator.get_context()

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """As for every `FleetSimulation`."""
        return read_recorder(self._diagram.GetSubsystemByName("recorder"), self.simulator.get_context())


class CompiledSimulation(FleetSimulation):
    """A fleet in a compiled diagram; arguments as for a `WiredSimulation`.

    Raises:
        InputError: something of it cannot be compiled.
    """

    compiled = True

    def __init__(self, batch: Batch, plan: Plan, *, own: UserSystems, record: bool) -> None:
        self._plan = plan
        self._own = UserSystems(**{name: or_stand_in(system) for name, system in own.given.items()})
        # The compiled diagram takes its numbers from here, and gives its state back to be read.
        self._wired = build_fleet_diagram(batch, plan, own=self._own)
        self._wired_context = self._wired.CreateDefaultContext()
        ticks = _TICKS_ALONE if len(batch) == 1 else _TICKS
        # A flight ends, and is recorded, by the ticks of the control, which are not always the longest.
        tick = batch.scenario.laboratory.command_link.period
        self._diagram = compile_diagram(self._wired, ticks=ticks, tick=tick, record=record)
        self._compiled = compiled_part(self._diagram)
        super().__init__(self._diagram, ticks * self._compiled.tick)

    def fly(self, duration: float, *, progress: Callable[[float, float], None] | None = None) -> None:
        """As for every `FleetSimulation`."""
        self._compiled.set_end(self._part_of(self.simulator.get_mutable_context()), duration)
        super().fly(duration, progress=progress)

    def reset(self, batch: Batch) -> None:
        """As for every `FleetSimulation`."""
        context = self.simulator.get_mutable_context()
        self._diagram.SetDefaultContext(context)
        context.SetTime(0.0)
        reset_fleet(self._wired, self._wired_context, batch, self._plan, own=self._own)
        self._compiled.read(self._part_of(context), self._wired_context)
        self.simulator.Initialize()

    def _wired_now(self) -> tuple[Diagram, Context]:
        self._compiled.write(self._part_of(self.simulator.get_mutable_context()), self._wired_context)
        return self._wired, self._wired_context

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """As for every `FleetSimulation`."""
        signals = self._compiled.log(self._part_of(self.simulator.get_mutable_context()))
        num_ticks = len(next(iter(signals.values())))
        return self._compiled.tick * np.arange(num_ticks), signals

    def _part_of(self, context: Context) -> Context:
        """Return the compiled system's part of a context."""
        return self._compiled.GetMyMutableContextFromRoot(context)


def simulate_fleet(
    batch: Batch, plan: Plan, *, own: UserSystems = UserSystems(), record: bool = False, compiled: bool
) -> FleetSimulation:
    """Return a fleet under Drake's simulator.

    Args:
        batch: that is flown.
        plan: that is flown.
        own: systems of the user's.
        record: whether signals are recorded.
        compiled: whether it is a compiled diagram.

    Raises:
        InputError: something cannot be flown, or not be compiled.
    """
    return (CompiledSimulation if compiled else WiredSimulation)(batch, plan, own=own, record=record)


def fly(
    simulator: Simulator,
    duration: float,
    *,
    stride: float = _STRIDE,
    jumps: Sequence[float] = (),
    progress: Callable[[float, float], None] | None = None,
) -> None:
    """Advance a tracking diagram from time zero to a duration, or until every vehicle has crashed.

    Args:
        simulator: simulator of the diagram.
        duration: duration of the flight, s.
        stride: interval between checks for crashes and between reports of progress, s.
        jumps: times at which the forces on vehicles with a continuous state are discontinuous, s, see `jump_times`.
        progress: function that is called after each stride with the simulated time and the duration, s.
    """
    diagram, context = simulator.get_system(), simulator.get_context()
    crashed = diagram.GetOutputPort("crashed")
    # A step that ends just before a jump evaluates all its stages with the forces before the jump.
    stops = {stop for jump in jumps for stop in (math.nextafter(jump, 0.0), jump)}
    time = 0.0
    while time < duration and not (crashed.Eval(context) != 0.0).all():
        time = min(time + stride, duration, *[stop for stop in stops if stop > time])
        simulator.AdvanceTo(time)
        if progress is not None:
            progress(time, duration)
    simulator.AdvancePendingEvents()


def read_metrics(diagram: Diagram, context: Context) -> Metrics:
    """Return the (N,) metrics of a tracking diagram's vehicles so far."""
    monitor = diagram.GetSubsystemByName("monitor")
    return monitor.metrics(monitor.GetMyContextFromRoot(context))
