"""The network as Drake systems."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.fuzzy.inference import Antecedents, firing_strengths
from drake_quad.control.fuzzy.inputs import InputName, input_values, moved_on, signals_of
from drake_quad.control.fuzzy.laws import CovarianceLaw, LearningLimits, Rows, trace
from drake_quad.framework.elementary import dot, exp, maximum, minimum, nearest, where
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import Layout, layout_of
from drake_quad.framework.wiring import build, connect_inputs
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import SIGNALS, Acceleration, PositionError, PositionErrorRate, Row, Time

# What is known of a network on each of its axes.
PerNetworkAxis = tuple[Rows, ...]


def layout_on_axes(num_axes: int, num_rows: int) -> Layout:
    """The layout of so many rows on each axis of a network."""
    return layout_of(PerNetworkAxis, ((0.0,) * num_rows,) * num_axes)


def layout_of_antecedents(antecedents: tuple[Antecedents, ...]) -> Layout:
    """The layout of the antecedents of a network on each of its axes."""
    return layout_of(tuple[Antecedents, ...], antecedents)


class Lead(NamedTuple):
    """Time by which a correction acts before the vehicle is at the place that it was learned for."""

    time: Time


def firing_on_axes(
    antecedents: tuple[Antecedents, ...],
    axes: Sequence[Axis],
    inputs: Sequence[InputName],
    time: Row,
    lap_times: Sequence[float],
    lead: Lead | None,
    *signals: Any,
) -> PerNetworkAxis:
    """Return the firing strengths on each axis of a network.

    Args:
        antecedents: of all axes, or of each.
        axes: of the network.
        inputs: of the rules.
        time: s.
        lap_times: when the laps of the route begin and the last one ends, s.
        lead: time by which the place and the phase are ahead of those of now, if any.
        signals: from which the inputs follow, in the order of `signals_of`.
    """
    known = dict(zip(signals_of(inputs), signals, strict=True))
    if lead is not None:
        time = time + lead.time
        if "measurement" in known:
            known["measurement"] = moved_on(known["measurement"], lead.time)
    return tuple(
        [
            firing_strengths(input_values(axis, inputs, known, time, lap_times), sets)
            for axis, sets in zip(axes, _for_each(axes, antecedents), strict=True)
        ]
    )


def _for_each(axes: Sequence[Axis], antecedents: tuple[Antecedents, ...]) -> tuple[Antecedents, ...]:
    """The antecedents on each axis; one for all of them stands for as many."""
    return antecedents * len(axes) if len(antecedents) == 1 else antecedents


class RulesNumbers(NamedTuple):
    """Of a `FuzzyRules`.

    Attributes:
        antecedents: for all axes, or for each.
        lead: of no meaning if the network does not lead.
    """

    antecedents: tuple[Antecedents, ...] = (Antecedents(),)
    lead: Lead = Lead(0.0)


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
        - firing_ahead

    The input ports are the signals from which the inputs of the rules follow: `error`, `error_rate`, `measurement`,
    `disturbance`. `firing` has the normalised firing strengths, R rows for each axis of the network, one axis after
    another. `firing_ahead` is there if the network leads: those of where the vehicle will be, by its measured velocity,
    and of the phase that there will be, after a time.

    The parameters of the context are `antecedents` and, if the network leads, `lead`; where antecedents learn, they are
    an input, from a `SetLearning`.

    Args:
        num_vehicles: N.
        axes: of the network, in the order of X, Y, Z.
        inputs: of the rules, see `drake_quad.control.fuzzy.inputs`.
        lap_times: when the laps of the route begin and the last one ends, s; needed for the phase only.
        adaptive: whether the antecedents learn.
        leads: whether there is a lead.
        numbers: of the rules.
    """

    def declare(
        self,
        *,
        axes: Sequence[Axis] = ("x", "y"),
        inputs: Sequence[InputName] = ("error", "error_rate"),
        lap_times: Sequence[float] = (),
        adaptive: bool = False,
        leads: bool = False,
        numbers: RulesNumbers = RulesNumbers(),
    ) -> None:
        """Declares the system."""
        axes, inputs = tuple(axes), tuple(inputs)
        signals = [self.input(name) for name in signals_of(inputs)]
        antecedents: Any
        if adaptive:
            antecedents = self.input("antecedents", layout=layout_of_antecedents(_for_each(axes, numbers.antecedents)))
        else:
            antecedents = self.parameter("antecedents", lambda numbers: numbers.antecedents)
        first, *_ = numbers.antecedents
        time, layout = TIME if "phase" in inputs else 0.0, layout_on_axes(len(axes), first.num_rules)
        reads = antecedents, axes, inputs, time, tuple(lap_times)
        self.output("firing", firing_on_axes, *reads, None, *signals, layout=layout)
        if leads:
            lead = self.parameter("lead", lambda numbers: numbers.lead)
            self.output("firing_ahead", firing_on_axes, *reads, lead, *signals, layout=layout)


class LearningNumbers(NamedTuple):
    """What a network learns by.

    Attributes:
        slope: λ of eq (15), 1/s; of no meaning where the feedback is learned from.
        law: a record of `drake_quad.control.fuzzy.laws`.
        limits: of learning.
        initial_weight: F₀ of all rules, m/s².
    """

    slope: Row = 1.0
    law: Any = CovarianceLaw()
    limits: LearningLimits = LearningLimits()
    initial_weight: Row = 0.0


def surface(axis: Axis, numbers: LearningNumbers, error: PositionError, rate: PositionErrorRate) -> Row:
    """Eq (15): s_p = ė + λ e on an axis, m/s."""
    sliding: Row = getattr(rate, axis) + numbers.slope * getattr(error, axis)
    return sliding


def feedback(axis: Axis, numbers: LearningNumbers, pd: Acceleration, disturbance: Acceleration) -> Row:
    """All that the controller's own feedback commands on an axis, τ_c - d, m/s².

    Like s_p it asks for more while the correction takes away too much: by τ = τ_c - τ_f - d the network has learned all
    there is when the rest is zero (feedback-error learning: M. Kawato, K. Furukawa and R. Suzuki, "A hierarchical
    neural-network model for control and learning of voluntary movement", Biological Cybernetics 57, 1987). An estimate
    d is feedback, too: it is of what the network has not learned yet, and there before the error is.
    """
    commanded: Row = getattr(pd, axis) - getattr(disturbance, axis)
    return commanded


def signal_and_ports(learns_from: Literal["surface", "feedback"]) -> tuple[Callable[..., Row], tuple[str, ...]]:
    """The formula of what a network learns from, and the names of the signals that it is made of."""
    return (surface, ("error", "error_rate")) if learns_from == "surface" else (feedback, ("pd", "disturbance"))


# What a system that learns takes for a signal that is not connected: most controllers estimate no disturbance.
UNCONNECTED = {"disturbance": Acceleration(0.0, 0.0, 0.0)}


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
        signal_of: `surface` or `feedback`, from which the law learns.
        signals: that it is made of.
    """
    law, (limit, deadzone, leakage) = numbers.law, numbers.limits
    kept, begins_anew = exp(-leakage * period), _is_one_of(time, reset_ticks, period)
    after = []
    for axis, f, remembered, w in zip(axes, weights, memory, firing, strict=True):
        signal = signal_of(axis, numbers, *signals)
        known = where(begins_anew, law.memory(len(f)), remembered)
        counts = counted(signal, deadzone)
        f_after, memory_after = law.learned(tuple([kept * f_i for f_i in f]), known, w, counts, period)
        after.append((tuple([minimum(maximum(f_i, -limit), limit) for f_i in f_after]), memory_after))
    return tuple([f for f, _ in after]), tuple([remembered for _, remembered in after])


def counted(signal: Row, deadzone: Row) -> Row:
    """What counts of a signal, of which too little counts as zero."""
    return where(abs(signal) < deadzone, 0.0 * signal, signal)


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
        - firing_ahead
        - error
        - error_rate
        output_ports:
        - correction
        - learned_disturbance
        - weights
        - covariance_trace

    `correction` is τ_f = Fᵀ W of the `firing` strengths from `FuzzyRules`, zero on axes that the network does not have.
    The weights F learn at every tick from s_p = ė + λ e, eq (15), of `error` and `error_rate`; or from the feedback,
    with the inputs `pd` and `disturbance` in their place, of which the latter is zero if not connected. `weights` shows
    F in the order of `firing`; `covariance_trace`, with the law that has one, a row for each axis.

    If the network leads, `correction` is that of `firing_ahead`: what a controller commands now acts only later. The
    weights learn by `firing`, and `learned_disturbance` is Fᵀ W of it: what disturbs the vehicle now, as far as it has
    been learned.

    The states are `weights` and the memory of the law, under its name, if it has one. The only parameter of the context
    is `learning`.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        axes: of the network, in the order of X, Y, Z.
        num_rules: R.
        learns_from: "surface" or "feedback".
        reset_times: at which the memory of the law begins anew, s: at the first tick from then on.
        initial_weights: F of the rules on each axis at the beginning, m/s², if they are not all the same.
        leads: whether the network leads.
        numbers: to learn by.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        axes: Sequence[Axis] = ("x", "y"),
        num_rules: int = 9,
        learns_from: Literal["surface", "feedback"] = "surface",
        reset_times: Sequence[float] = (),
        initial_weights: PerNetworkAxis = (),
        leads: bool = False,
        numbers: LearningNumbers = LearningNumbers(),
    ) -> None:
        """Declares the system."""
        law, axes = numbers.law, tuple(axes)
        ticks = tuple([math.ceil(time / period - 1e-9) for time in reset_times])
        per_axis = layout_on_axes(len(axes), num_rules)
        firing = self.input("firing", layout=per_axis)
        ahead = self.input("firing_ahead", layout=per_axis) if leads else firing
        learning = self.parameter("learning", lambda numbers: numbers)
        weights = self.state(
            "weights",
            lambda numbers: initial_weights or ((numbers.initial_weight,) * num_rules,) * len(axes),
            layout=per_axis,
        )
        memory: Any = ((),) * len(axes)
        if law.memory(num_rules):
            memory = self.state(law.memory_name, lambda numbers: (numbers.law.memory(num_rules),) * len(axes))
        signal_of, ports = signal_and_ports(learns_from)
        signals = signal_of, *(self.input(name, absent=UNCONNECTED.get(name)) for name in ports)
        reads = weights, memory, firing, learning, TIME if ticks else 0.0, axes, period, ticks, *signals
        self.update(period, learned, *reads, writes=[weights, memory])
        self.output("correction", network_output, weights, ahead, axes)
        if leads:
            self.output("learned_disturbance", network_output, weights, firing, axes)
        self.state_output(weights)
        if law.memory_name == "covariance":
            trace_layout = layout_of(SIGNALS["covariance_trace"], (0.0,) * len(axes))
            self.output("covariance_trace", covariance_traces, memory, layout=trace_layout)


def build_fuzzy_network(*, rules: Any, learning: Any, sets: Any = None) -> Diagram:
    """Builds the diagram `network`.

    .. pydrake_system::

        name: network
        input_ports:
        - error
        - error_rate
        output_ports:
        - correction
        - learned_disturbance
        - weights
        - covariance_trace

    It is several systems so that Drake keeps the firing strengths between the output and the learning of a tick. Ports
    are those of its parts; there are others with other inputs of the rules, or where the feedback is learned from, and
    `antecedents` where they learn. There is a `learned_disturbance` if the network leads.

    Args:
        rules: a `FuzzyRules`.
        learning: a `WeightLearning` on the same axes, for as many rules.
        sets: a `SetLearning` likewise, if the rules are adaptive.
    """
    builder = DiagramBuilder()
    parts = {"rules": rules, "learning": learning} | ({} if sets is None else {"sets": sets})
    for name, system in parts.items():
        builder.AddNamedSystem(name, system)
    inside = (rules, "firing"), (rules, "firing_ahead"), (learning, "weights"), (sets, "antecedents")
    sources = {name: system.GetOutputPort(name) for system, name in inside if system and system.HasOutputPort(name)}
    connect_inputs(builder, parts.values(), sources, exported=SIGNALS)
    of_learning = ("correction", "learned_disturbance", "weights", "covariance_trace")
    shown = [(learning, name) for name in of_learning] + [(sets, "antecedents")]
    for system, name in shown:
        if system is not None and system.HasOutputPort(name):
            builder.ExportOutput(system.GetOutputPort(name), name)
    return build(builder, "network")
