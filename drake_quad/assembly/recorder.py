"""The flight recorder, of native blocks."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer, VectorLogSink, ZeroOrderHold


def build_recorder(signals: Mapping[str, int], *, period: float) -> Diagram:
    """Build a diagram `recorder` with one input port for each signal, which keeps them all at every tick.

    A log publishes before the updates of its instant and would see a stepping vehicle one period late. So a hold
    samples all signals at the tick, as every discrete update does, and the log reads the hold at the next tick.

    Args:
        signals: name of each input port and its size.
        period: of the ticks, s.
    """
    builder = DiagramBuilder()
    together = builder.AddNamedSystem("together", Multiplexer(list(signals.values())))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, sum(signals.values())))
    log = builder.AddNamedSystem("log", VectorLogSink(sum(signals.values()), period))
    builder.Connect(together.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), log.get_input_port())
    for i, name in enumerate(signals):
        builder.ExportInput(together.get_input_port(i), name)
    recorder = builder.Build()
    recorder.set_name("recorder")
    return recorder


def clear_recorder(recorder: Diagram, context: Context) -> None:
    """Forget all ticks that were recorded. A context that is set to its defaults keeps the log of a sink.

    Args:
        recorder: recorder from `build_recorder`.
        context: context of the diagram that contains the recorder.
    """
    recorder.GetSubsystemByName("log").FindMutableLog(context).Clear()


def read_recorder(recorder: Diagram, context: Context) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return what a recorder has kept since time zero.

    Args:
        recorder: from `build_recorder`.
        context: of the diagram that holds the recorder, once the pending events of the last tick are done.

    Returns:
        (ticks,) times in s, and the (ticks, size) signals by name.
    """
    log = recorder.GetSubsystemByName("log").FindLog(context)
    hold = recorder.GetSubsystemByName("hold")
    newest = hold.GetMyContextFromRoot(context).get_discrete_state(0).CopyToVector()
    samples = np.vstack([log.data().T[1:], newest])
    signals, first = {}, 0
    for i in range(recorder.num_input_ports()):
        port = recorder.get_input_port(i)
        signals[port.get_name()] = samples[:, first : first + port.size()]
        first += port.size()
    return log.sample_times(), signals
