"""Jacobian of a tick of a diagram by finite differences of simulations."""

import numpy as np
from pydrake.systems.analysis import InitializeParams, Simulator


def jacobian_of_tick(diagram, context, layout, *, until, step=1e-5):
    """Return the (n, n) derivatives of the state at a time with respect to that of a context, by differences.

    Args:
        diagram: diagram of the context.
        context: context at the beginning of the tick.
        layout: `ContextVector` of the state.
        until: end of the tick, s.
        step: half of the difference of each element.
    """
    start = layout.read(diagram, context)

    def after(state):
        root = context.Clone()
        layout.write(diagram, root, state)
        simulator = Simulator(diagram, root)
        keep = InitializeParams()
        keep.suppress_initialization_events = True
        simulator.Initialize(keep)
        simulator.AdvanceTo(until)
        return layout.read(diagram, root)

    columns = [(after(start + step * unit) - after(start - step * unit)) / (2.0 * step) for unit in np.eye(len(start))]
    return np.array(columns).T
