"""Steps of the closed loop: its linear model beside the diagram itself."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator

from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import WATCHERS, ClosedLoop
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import resumed, tick_after


class StepResponse(NamedTuple):
    """Response of the vehicle to a step; its rows are those of the vehicle's `state`.

    Attributes:
        time: (ticks,) s.
        linear: (ticks, 12) deviations from the equilibrium by the linear model.
        nonlinear: (ticks, 12) by the diagram.
    """

    time: np.ndarray
    linear: np.ndarray
    nonlinear: np.ndarray


def release(loop: ClosedLoop, displacement: Mapping[str, float], *, duration: float) -> StepResponse:
    """Let a loop go from beside its equilibrium: a step of the reference, seen from the reference.

    Args:
        loop: of `closed_loop`.
        displacement: of rows of the vehicle's `state`, as in `x` or `yaw`, in SI units; the cameras see it at once.
        duration: s.

    Raises:
        InputError: there is no such row, or the vehicle has no step in which it could be displaced.
    """
    layout = ContextVector(loop.diagram, without=WATCHERS)
    equilibrium = layout.read(loop.diagram, loop.context)
    state = np.zeros_like(equilibrium)
    vehicle = [i for i, name in enumerate(layout.names) if ".vehicle.state." in name]
    seen = [i for i, name in enumerate(layout.names) if ".motion_capture." in name]
    for row, size in displacement.items():
        if not any(layout.names[i].endswith(f".{row}") for i in vehicle):
            raise InputError(f"there is no row {row} in the state of a vehicle that steps")
        for i in (*vehicle, *seen):
            if layout.names[i].endswith(f".{row}"):
                state[i] = size

    root = loop.context.Clone()
    layout.write(loop.diagram, root, equilibrium + state)
    simulator = resumed(Simulator(loop.diagram, root))
    start, period = root.get_time(), loop.system.period
    port = loop.diagram.GetOutputPort("state")
    ticks = round(duration / period) + 1
    linear, nonlinear = np.empty((ticks, len(vehicle))), np.empty((ticks, len(vehicle)))
    for tick in range(ticks):
        linear[tick] = state[vehicle]
        nonlinear[tick] = port.Eval(root) - equilibrium[vehicle]
        state = loop.system.A @ state
        simulator.AdvanceTo(tick_after(start, period, tick + 1))
    return StepResponse(period * np.arange(ticks), linear, nonlinear)
