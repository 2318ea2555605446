"""Step responses of the closed loop, from its linear model and from its nonlinear diagram."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from pydrake.systems.analysis import Simulator

from drake_quad.errors import InputError
from drake_quad.linear.closed_loop import PASSIVE_SYSTEMS, ClosedLoop
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.sampled_system import initialize_without_events, tick_after


class StepResponse(NamedTuple):
    """Response of the vehicle to a step, with one column for each component of the vehicle's `state`.

    Attributes:
        time: (ticks,) time since the step, s.
        linear: (ticks, 12) deviation from the equilibrium in the linear model.
        nonlinear: (ticks, 12) deviation from the equilibrium in the simulated diagram.
    """

    time: np.ndarray
    linear: np.ndarray
    nonlinear: np.ndarray


def initial_response(loop: ClosedLoop, displacement: Mapping[str, float], *, duration: float) -> StepResponse:
    """Return the response of a loop that starts at a displacement from its equilibrium.

    Relative to the new reference, a step of the reference causes the same response.

    Args:
        loop: loop from `closed_loop`.
        displacement: initial displacement by component of the vehicle's `state`, such as `x` or `yaw`, in SI units. The
            cameras measure it in their first frame.
        duration: duration of the response, s.

    Raises:
        InputError: if `state` has no such component, or the vehicle has a continuous state.
    """
    layout = ContextVector(loop.diagram, excluded_systems=PASSIVE_SYSTEMS)
    equilibrium = layout.read(loop.diagram, loop.context)
    state = np.zeros_like(equilibrium)
    vehicle_states = [i for i, name in enumerate(layout.names) if ".vehicle.state." in name]
    camera_states = [i for i, name in enumerate(layout.names) if ".motion_capture." in name]
    for row, size in displacement.items():
        if not any(layout.names[i].endswith(f".{row}") for i in vehicle_states):
            raise InputError(f"cannot displace {row}: it is not a component of the vehicle's discrete state")
        for i in (*vehicle_states, *camera_states):
            if layout.names[i].endswith(f".{row}"):
                state[i] = size

    root = loop.context.Clone()
    layout.write(loop.diagram, root, equilibrium + state)
    simulator = initialize_without_events(Simulator(loop.diagram, root))
    start, period = root.get_time(), loop.system.period
    port = loop.diagram.GetOutputPort("state")
    ticks = round(duration / period) + 1
    linear, nonlinear = np.empty((ticks, len(vehicle_states))), np.empty((ticks, len(vehicle_states)))
    for tick in range(ticks):
        linear[tick] = state[vehicle_states]
        nonlinear[tick] = port.Eval(root) - equilibrium[vehicle_states]
        state = loop.system.A @ state
        simulator.AdvanceTo(tick_after(start, period, tick + 1))
    return StepResponse(period * np.arange(ticks), linear, nonlinear)
