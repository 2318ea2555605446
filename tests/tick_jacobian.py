"""Jacobian of a diagram's state over one tick, by finite differences of simulations."""

import numpy as np
from pydrake.systems.analysis import InitializeParams, Simulator


def jacobian_of_tick(diagram, context, layout, *, until, step=1e-5):
    """Return the Jacobian (n, n) of the state at the end of a tick with respect to the state of a context.

    Args:
        diagram: diagram that is simulated.
        context: context at the beginning of the tick.
        layout: `ContextVector` that reads and writes the state.
        until: end of the tick, s.
        step: step of the central differences, in the units of the state.
    """
    start = layout.read(diagram, context)

    def state_after_tick(state):
        root = context.Clone()
        layout.write(diagram, root, state)
        simulator = Simulator(diagram, root)
        options = InitializeParams()
        options.suppress_initialization_events = True
        simulator.Initialize(options)
        simulator.AdvanceTo(until)
        return layout.read(diagram, root)

    columns = [
        (state_after_tick(start + step * unit) - state_after_tick(start - step * unit)) / (2.0 * step)
        for unit in np.eye(len(start))
    ]
    return np.array(columns).T
