"""Flight recorder: a diagram of Drake's standard systems that logs signals."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer, VectorLogSink, ZeroOrderHold


def build_recorder(signals: Mapping[str, int], *, period: float) -> Diagram:
    """Build the diagram `recorder`, which has an input port for each signal and records all signals at every tick.

    Drake's log samples its input before the discrete updates of the same instant. Without further measures, the log
    would record the state of a discrete vehicle one period late. Therefore, a zero-order hold samples all signals
    during the discrete updates of each tick, and the log reads the output of the hold at the next tick.

    Args:
        signals: size of each input port, keyed by the name of the port.
        period: period of the ticks, s.
    """
    builder = DiagramBuilder()
    multiplexer = builder.AddNamedSystem("together", Multiplexer(list(signals.values())))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, sum(signals.values())))
    log = builder.AddNamedSystem("log", VectorLogSink(sum(signals.values()), period))
    builder.Connect(multiplexer.get_output_port(), hold.get_input_port())
    builder.Connect(hold.get_output_port(), log.get_input_port())
    for i, name in enumerate(signals):
        builder.ExportInput(multiplexer.get_input_port(i), name)
    recorder = builder.Build()
    recorder.set_name("recorder")
    return recorder


def clear_recorder(recorder: Diagram, context: Context) -> None:
    """Delete all recorded ticks, which the log keeps even if the context is reset to its defaults.

    Args:
        recorder: recorder from `build_recorder`.
        context: context of the diagram that contains the recorder.
    """
    recorder.GetSubsystemByName("log").FindMutableLog(context).Clear()


def read_recorder(recorder: Diagram, context: Context) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the signals that a recorder has recorded since time zero.

    Args:
        recorder: recorder from `build_recorder`.
        context: context of the diagram that contains the recorder, after the pending events of the last tick.

    Returns:
        (ticks,) times, s, and a dictionary of the (ticks, size) signals.
    """
    log = recorder.GetSubsystemByName("log").FindLog(context)
    hold = recorder.GetSubsystemByName("hold")
    newest = hold.GetMyContextFromRoot(context).get_discrete_state(0).CopyToVector()
    samples = np.vstack([log.data().T[1:], newest])
    signals, first = {}, 0  # `first` is the first column of the next signal
    for i in range(recorder.num_input_ports()):
        port = recorder.get_input_port(i)
        signals[port.get_name()] = samples[:, first : first + port.size()]
        first += port.size()
    return log.sample_times(), signals
