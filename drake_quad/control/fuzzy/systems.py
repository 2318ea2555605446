"""The network as Drake systems."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.axes import Axis
from drake_quad.control.fuzzy.inference import Antecedents, firing_strengths
from drake_quad.control.fuzzy.laws import CovarianceLaw, Limits, Rows, dot, trace
from drake_quad.framework.elementary import exp, maximum, minimum, nearest, where
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import Layout, layout_of
from drake_quad.signals import SIGNALS, Acceleration, PositionError, PositionErrorRate, Row

# What is known of a network on each of its axes.
PerNetworkAxis = tuple[Rows, ...]


def _layout(num_axes: int, num_rows: int) -> Layout:
    """The layout of so many rows on each axis of a network."""
    return layout_of(PerNetworkAxis, ((0.0,) * num_rows,) * num_axes)


def firing_on_axes(
    error: PositionError, rate: PositionErrorRate, antecedents: Antecedents, axes: Sequence[Axis]
) -> PerNetworkAxis:
    """The firing strengths on each axis of a network."""
    return tuple([firing_strengths((getattr(error, axis), getattr(rate, axis)), antecedents) for axis in axes])


@fleet_system(float, AutoDiffXd)
class FuzzyRules(FleetSystem):
    """The antecedents of the network's rules.

    .. pydrake_system::

        name: FuzzyRules
        input_ports:
        - error
        - error_rate
        output_ports:
        - firing

    `error` and `error_rate` are those of the position controller. `firing` has the normalised firing strengths, R rows
    for each axis of the network, one axis after another.

    The only parameter of the context is `antecedents`.

    Args:
        num_vehicles: N.
        axes: of the network, in the order of X, Y, Z.
        numbers: antecedents of the rules.
    """

    def declare(self, *, axes: Sequence[Axis] = ("x", "y"), numbers: Antecedents = Antecedents()) -> None:
        """Declares the system."""
        error, rate = self.input("error"), self.input("error_rate")
        antecedents = self.parameter("antecedents", lambda antecedents: antecedents)
        layout = _layout(len(axes), numbers.num_rules)
        self.output("firing", firing_on_axes, error, rate, antecedents, tuple(axes), layout=layout)


class LearningNumbers(NamedTuple):
    """What a network learns by.

    Attributes:
        slope: λ of eq (15), 1/s; of no meaning for a law that learns from the PD's command.
        law: a record of `drake_quad.control.fuzzy.laws`.
        limits: of learning.
        initial_weight: F₀ of all rules, m/s².
    """

    slope: Row = 1.0
    law: Any = CovarianceLaw()
    limits: Limits = Limits()
    initial_weight: Row = 0.0


def surface(axis: Axis, numbers: LearningNumbers, error: PositionError, rate: PositionErrorRate) -> Row:
    """Eq (15): s_p = ė + λ e on an axis, m/s."""
    sliding: Row = getattr(rate, axis) + numbers.slope * getattr(error, axis)
    return sliding


def command(axis: Axis, numbers: LearningNumbers, pd: Acceleration) -> Row:
    """The PD's command on an axis, m/s²."""
    commanded: Row = getattr(pd, axis)
    return commanded


def learned(
    weights: PerNetworkAxis,
    memory: PerNetworkAxis,
    firing: PerNetworkAxis,
    numbers: LearningNumbers,
    time: Row,
    axes: Sequence[Axis],
    period: float,
    reset_ticks: Sequence[int],
    signal_of: Callable[..., Row],
    *signals: Any,
) -> Any:
    """Weights and memory a tick later, on each axis of a network; only the weights by a law without memory.

    Args:
        weights: F.
        memory: of the law.
        firing: W.
        numbers: to learn by.
        time: of the tick, s.
        axes: of the network.
        period: h, s.
        reset_ticks: at which the law forgets all that it remembers.
        signal_of: `surface` or `command`, from which the law learns.
        signals: that it is made of.
    """
    law, (limit, deadzone, leakage) = numbers.law, numbers.limits
    kept, begins_anew = exp(-leakage * period), _is_one_of(time, reset_ticks, period)
    after = []
    for axis, f, remembered, w in zip(axes, weights, memory, firing, strict=True):
        signal = signal_of(axis, numbers, *signals)
        known = where(begins_anew, law.memory(len(f)), remembered)
        counts = where(abs(signal) < deadzone, 0.0 * signal, signal)
        f_after, memory_after = law.learned(tuple([kept * f_i for f_i in f]), known, w, counts, period)
        after.append((tuple([minimum(maximum(f_i, -limit), limit) for f_i in f_after]), memory_after))
    all_weights, all_memory = tuple([f for f, _ in after]), tuple([remembered for _, remembered in after])
    return (all_weights, all_memory) if any(all_memory) else all_weights


def _is_one_of(time: Row, ticks: Sequence[int], period: float) -> bool:
    """Is a time (s) that of one of some ticks?"""
    if not ticks:
        return False
    tick, found = nearest(time / period), False
    for other in ticks:
        found = found | (tick == float(other))
    return found


def network_output(weights: PerNetworkAxis, firing: PerNetworkAxis, axes: Sequence[Axis]) -> Acceleration:
    """τ_f = Fᵀ W on each axis of a network, zero on the others."""
    on_axes = {axis: dot(f, w) for axis, f, w in zip(axes, weights, firing, strict=True)}
    return Acceleration(on_axes.get("x", 0.0), on_axes.get("y", 0.0), on_axes.get("z", 0.0))


def covariance_traces(memory: PerNetworkAxis) -> tuple[Row, ...]:
    """Tr P on each axis of a network."""
    return tuple([trace(covariance) for covariance in memory])


@fleet_system(float, AutoDiffXd)
class WeightLearning(FleetSystem):
    """The consequents of the network's rules, which learn.

    .. pydrake_system::

        name: WeightLearning
        input_ports:
        - firing
        - error
        - error_rate
        output_ports:
        - correction
        - weights
        - covariance_trace

    `correction` is τ_f = Fᵀ W of the `firing` strengths from `FuzzyRules`, zero on axes that the network does not have.
    The weights F learn at every tick from s_p = ė + λ e, eq (15), of `error` and `error_rate`. A law that learns from
    the PD's command has the input `pd` in their place. `weights` shows F in the order of `firing`; `covariance_trace`,
    with the law that has one, a row for each axis.

    The states are `weights` and the memory of the law, under its name, if it has one. The only parameter of the context
    is `learning`.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        axes: of the network, in the order of X, Y, Z.
        num_rules: R.
        reset_times: at which the memory of the law begins anew, s: at the first tick from then on.
        numbers: to learn by.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        axes: Sequence[Axis] = ("x", "y"),
        num_rules: int = 9,
        reset_times: Sequence[float] = (),
        numbers: LearningNumbers = LearningNumbers(),
    ) -> None:
        """Declares the system."""
        law, axes = numbers.law, tuple(axes)
        ticks = tuple([math.ceil(time / period - 1e-9) for time in reset_times])
        per_axis = _layout(len(axes), num_rules)
        firing = self.input("firing", layout=per_axis)
        learning = self.parameter("learning", lambda numbers: numbers)
        weights = self.state(
            "weights", lambda numbers: ((numbers.initial_weight,) * num_rules,) * len(axes), layout=per_axis
        )
        rows = len(law.memory(num_rules))
        memory: Any = ((),) * len(axes)
        writes = [weights]
        if rows:
            memory = self.state(
                law.memory_name,
                lambda numbers: (numbers.law.memory(num_rules),) * len(axes),
                layout=_layout(len(axes), rows),
            )
            writes = [weights, memory]
        if law.learns_from == "surface":
            signals: tuple[Any, ...] = surface, self.input("error"), self.input("error_rate")
        else:
            signals = command, self.input("pd")
        reads = weights, memory, firing, learning, TIME if ticks else 0.0, axes, period, ticks, *signals
        self.update(period, learned, *reads, writes=writes)
        self.output("correction", network_output, weights, firing, axes)
        self.state_output(weights)
        if law.memory_name == "covariance":
            trace_layout = layout_of(SIGNALS["covariance_trace"], (0.0,) * len(axes))
            self.output("covariance_trace", covariance_traces, memory, layout=trace_layout)


def build_fuzzy_network(*, rules: Any, learning: Any) -> Diagram:
    """Builds the diagram `network`.

    .. pydrake_system::

        name: network
        input_ports:
        - error
        - error_rate
        output_ports:
        - correction
        - weights
        - covariance_trace

    It is two systems so that Drake keeps the firing strengths between the output and the learning of a tick. Ports are
    those of the two; a law that learns from the PD's command makes `pd` a third input.

    Args:
        rules: a `FuzzyRules`.
        learning: a `WeightLearning` on the same axes, for as many rules.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("rules", rules)
    builder.AddNamedSystem("learning", learning)
    builder.Connect(rules.GetOutputPort("firing"), learning.GetInputPort("firing"))
    for name in ("error", "error_rate"):
        builder.ExportInput(rules.GetInputPort(name), name)
        if learning.HasInputPort(name):
            builder.ConnectInput(name, learning.GetInputPort(name))
    if learning.HasInputPort("pd"):
        builder.ExportInput(learning.GetInputPort("pd"), "pd")
    for name in ("correction", "weights", "covariance_trace"):
        if learning.HasOutputPort(name):
            builder.ExportOutput(learning.GetOutputPort(name), name)
    network = builder.Build()
    network.set_name("network")
    return network
