"""The fuzzy network as Drake systems. Equation numbers refer to Kayacan and Maslim (2016)."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.fuzzy.inference import Antecedents, firing_strengths
from drake_quad.control.fuzzy.inputs import InputName, extrapolate_position, input_signals, input_values
from drake_quad.control.fuzzy.laws import CovarianceLaw, LearningLimits, Rows, trace
from drake_quad.framework.elementary import dot, exp, maximum, minimum, nearest, where
from drake_quad.framework.fleet_system import REQUIRED, TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import Layout, layout_of
from drake_quad.framework.wiring import build, connect_inputs
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import SIGNALS, Acceleration, PositionError, PositionErrorRate, Row, Time

# Values for each rule on each axis of a network, such as weights or firing strengths.
PerNetworkAxis = tuple[Rows, ...]


def layout_on_axes(num_axes: int, num_rows: int) -> Layout:
    """Return the layout of a signal that has the same number of components for each axis of a network."""
    return layout_of(PerNetworkAxis, ((0.0,) * num_rows,) * num_axes)


def layout_of_antecedents(antecedents: tuple[Antecedents, ...]) -> Layout:
    """Return the layout of a network's antecedents, one axis after another."""
    return layout_of(tuple[Antecedents, ...], antecedents)


class Lead(NamedTuple):
    """Time by which a correction is applied before the vehicle reaches the position for which it was learned."""

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
        antecedents: one `Antecedents` for all axes, or one for each axis.
        axes: axes of the network.
        inputs: names of the inputs of the rules.
        time: time, s.
        lap_times: start of each lap of the route and end of the last one, s.
        lead: lead time of position and phase; None if the network has no lead time.
        signals: signals that determine the inputs, in the order of `input_signals`.
    """
    signals_by_name = dict(zip(input_signals(inputs), signals, strict=True))
    if lead is not None:
        time = time + lead.time
        if "measurement" in signals_by_name:
            signals_by_name["measurement"] = extrapolate_position(signals_by_name["measurement"], lead.time)
    return tuple(
        [
            firing_strengths(input_values(axis, inputs, signals_by_name, time, lap_times), sets)
            for axis, sets in zip(axes, _antecedents_on_axes(axes, antecedents), strict=True)
        ]
    )


def _antecedents_on_axes(axes: Sequence[Axis], antecedents: tuple[Antecedents, ...]) -> tuple[Antecedents, ...]:
    """Return the antecedents on each axis; a single `Antecedents` applies to all axes."""
    return antecedents * len(axes) if len(antecedents) == 1 else antecedents


class FuzzyRulesParameters(NamedTuple):
    """Parameters of a `FuzzyRules`.

    Attributes:
        antecedents: one `Antecedents` for all axes, or one for each axis.
        lead: lead time; not used if the network has no lead time.
    """

    antecedents: tuple[Antecedents, ...] = (Antecedents(),)
    lead: Lead = Lead(0.0)


@fleet_system(float, AutoDiffXd)
class FuzzyRules(FleetSystem):
    """Firing strengths of a network's rules.

    .. pydrake_system::

        name: FuzzyRules
        input_ports:
        - error
        - error_rate
        output_ports:
        - firing
        - firing_ahead

    The input ports are the signals that determine the inputs of the rules: `error`, `error_rate`, `measurement`,
    `disturbance`. `firing` contains the normalised firing strengths of the R rules on each axis of the network, one
    axis after another. The output `firing_ahead` exists if the network has a lead time. It contains the firing
    strengths after the lead time: for the position extrapolated by the measured velocity, and for the later phase.

    The parameters of the context are `antecedents` and, if there is a lead time, `lead`. If the antecedents are
    adaptive, they are an input from a `SetLearning` instead of a parameter.

    Args:
        num_vehicles: number of vehicles N.
        axes: axes of the network, in the order of X, Y, Z.
        inputs: inputs of the rules; see `drake_quad.control.fuzzy.inputs`.
        lap_times: start of each lap of the route and end of the last one, s; needed only for the input `phase`.
        adaptive: True if the antecedents learn.
        leads: True if the network has a lead time.
        parameters: parameters of the rules.
    """

    def declare(
        self,
        *,
        axes: Sequence[Axis] = ("x", "y"),
        inputs: Sequence[InputName] = ("error", "error_rate"),
        lap_times: Sequence[float] = (),
        adaptive: bool = False,
        leads: bool = False,
        parameters: FuzzyRulesParameters = FuzzyRulesParameters(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        axes, inputs = tuple(axes), tuple(inputs)
        signals = [self.input(name) for name in input_signals(inputs)]
        antecedents: Any
        if adaptive:
            antecedents = self.input(
                "antecedents", layout=layout_of_antecedents(_antecedents_on_axes(axes, parameters.antecedents))
            )
        else:
            antecedents = self.parameter("antecedents", lambda parameters: parameters.antecedents)
        first, *_ = parameters.antecedents
        time, layout = TIME if "phase" in inputs else 0.0, layout_on_axes(len(axes), first.num_rules)
        reads = antecedents, axes, inputs, time, tuple(lap_times)
        self.output("firing", firing_on_axes, *reads, None, *signals, layout=layout)
        if leads:
            lead = self.parameter("lead", lambda parameters: parameters.lead)
            self.output("firing_ahead", firing_on_axes, *reads, lead, *signals, layout=layout)


class LearningParameters(NamedTuple):
    """Parameters of a network's learning.

    Attributes:
        slope: λ of eq (15) of the paper, 1/s; not used if the network learns from the feedback.
        law: learning law from `drake_quad.control.fuzzy.laws`.
        limits: limits of learning.
        initial_weight: initial weight F₀ of all rules, m/s².
    """

    slope: Row = 1.0
    law: Any = CovarianceLaw()
    limits: LearningLimits = LearningLimits()
    initial_weight: Row = 0.0


def surface(axis: Axis, parameters: LearningParameters, error: PositionError, rate: PositionErrorRate) -> Row:
    """Return the learning signal s_p = ė + λ e of an axis in m/s, eq (15) of the paper."""
    sliding: Row = getattr(rate, axis) + parameters.slope * getattr(error, axis)
    return sliding


def feedback(axis: Axis, parameters: LearningParameters, pd: Acceleration, disturbance: Acceleration) -> Row:
    """Return the acceleration τ_c - d that the controller's feedback commands on an axis, m/s².

    The acceleration τ_c is the output of the PD, and d is the estimated disturbance. The controller commands
    τ = τ_c - τ_f - d, where τ_f is the correction by the network. When τ_c - d is zero, the network has learned the
    whole disturbance (feedback-error learning: M. Kawato, K. Furukawa and R. Suzuki, "A hierarchical neural-network
    model for control and learning of voluntary movement", Biological Cybernetics 57, 1987). Like s_p, this signal
    increases if the correction is too large.

    The estimate d is part of the feedback, since it is the part of the disturbance that the network has not learned
    yet. It responds earlier than the error.
    """
    commanded: Row = getattr(pd, axis) - getattr(disturbance, axis)
    return commanded


def signal_and_ports(learns_from: Literal["surface", "feedback"]) -> tuple[Callable[..., Row], tuple[str, ...]]:
    """Return the formula of the learning signal, and the names of its arguments."""
    return (surface, ("error", "error_rate")) if learns_from == "surface" else (feedback, ("pd", "disturbance"))


# Values of unconnected inputs of a learning system. Most controllers do not estimate a disturbance.
UNCONNECTED = {"disturbance": Acceleration(0.0, 0.0, 0.0)}


def learning_step(
    weights: PerNetworkAxis,
    memory: PerNetworkAxis,
    firing: PerNetworkAxis,
    parameters: LearningParameters,
    time: Row,
    axes: Sequence[Axis],
    period: float,
    reset_ticks: Sequence[int],
    signal_of: Callable[..., Row],
    *signals: Any,
) -> Any:
    """Return weights and memory of each axis at the next tick; the memory is empty for a law without memory.

    Args:
        weights: weights F of the rules.
        memory: memory of the law.
        firing: firing strengths W.
        parameters: parameters of learning.
        time: time of the tick, s.
        axes: axes of the network.
        period: tick period h, s.
        reset_ticks: ticks at which the law resets its memory.
        signal_of: formula of the learning signal, `surface` or `feedback`.
        signals: arguments of this formula.
    """
    law, (limit, deadzone, leakage) = parameters.law, parameters.limits
    decay, is_reset = exp(-leakage * period), _is_at_tick(time, reset_ticks, period)
    after = []
    for axis, f, axis_memory, w in zip(axes, weights, memory, firing, strict=True):
        signal = signal_of(axis, parameters, *signals)
        memory_before = where(is_reset, law.memory(len(f)), axis_memory)
        learning_signal = with_deadzone(signal, deadzone)
        f_after, memory_after = law.step(tuple([decay * f_i for f_i in f]), memory_before, w, learning_signal, period)
        after.append((tuple([minimum(maximum(f_i, -limit), limit) for f_i in f_after]), memory_after))
    return tuple([f for f, _ in after]), tuple([axis_memory for _, axis_memory in after])


def with_deadzone(signal: Row, deadzone: Row) -> Row:
    """Return a signal in which absolute values below the dead zone are replaced with zero."""
    return where(abs(signal) < deadzone, 0.0 * signal, signal)


def _is_at_tick(time: Row, ticks: Sequence[int], period: float) -> bool:
    """Return whether a time (s) belongs to one of the given ticks."""
    if not ticks:
        return False
    tick, matches = nearest(time / period), False
    for other in ticks:
        matches = matches | (tick == float(other))
    return matches


def network_output(weights: PerNetworkAxis, firing: PerNetworkAxis, axes: Sequence[Axis]) -> Acceleration:
    """Return the output τ_f = Fᵀ W of a network on each of its axes; zero on all other axes."""
    on_axes = {axis: dot(f, w) for axis, f, w in zip(axes, weights, firing, strict=True)}
    return Acceleration(on_axes.get("x", 0.0), on_axes.get("y", 0.0), on_axes.get("z", 0.0))


def covariance_traces(memory: PerNetworkAxis) -> tuple[Row, ...]:
    """Return the trace of the covariance P on each axis of a network."""
    return tuple([trace(covariance) for covariance in memory])


@fleet_system(float, AutoDiffXd)
class WeightLearning(FleetSystem):
    """Adaptive weights (consequents) of the network's rules.

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

    `correction` is τ_f = Fᵀ W with the `firing` strengths from `FuzzyRules`; it is zero on all axes that the
    network does not contain. The weights F are adapted at every tick, by the learning signal s_p = ė + λ e of eq (15)
    with the inputs `error` and `error_rate`, or by the feedback with the inputs `pd` and `disturbance`; `disturbance`
    is zero if not connected. `weights` contains F in the order of `firing`. `covariance_trace` exists for a law with a
    covariance, and has a row for each axis.

    If the network has a lead time, `correction` is computed from `firing_ahead`, because a command acts on the vehicle
    with a delay. The weights are still adapted with `firing`, and `learned_disturbance` is Fᵀ W with `firing`: the
    learned part of the disturbance at the current time.

    The states are `weights` and the memory of the law, if any, whose name is the `memory_name` of the law. The only
    parameter of the context is `learning`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period h, s.
        axes: axes of the network, in the order of X, Y, Z.
        num_rules: number of rules R.
        learns_from: learning signal, "surface" or "feedback".
        reset_times: times at which the memory of the law is reset, s. The reset takes place at the first tick at or
            after this time.
        initial_weights: initial F of the rules on each axis, m/s²; if empty, all are `parameters.initial_weight`.
        leads: True if the network has a lead time.
        parameters: parameters of learning.
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
        parameters: LearningParameters = LearningParameters(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        law, axes = parameters.law, tuple(axes)
        ticks = tuple([math.ceil(time / period - 1e-9) for time in reset_times])
        per_axis = layout_on_axes(len(axes), num_rules)
        firing = self.input("firing", layout=per_axis)
        ahead = self.input("firing_ahead", layout=per_axis) if leads else firing
        learning = self.parameter("learning", lambda parameters: parameters)
        weights = self.state(
            "weights",
            lambda parameters: initial_weights or ((parameters.initial_weight,) * num_rules,) * len(axes),
            layout=per_axis,
        )
        memory: Any = ((),) * len(axes)
        if law.memory(num_rules):
            memory = self.state(law.memory_name, lambda parameters: (parameters.law.memory(num_rules),) * len(axes))
        signal_of, ports = signal_and_ports(learns_from)
        signals = signal_of, *(self.input(name, absent=UNCONNECTED.get(name, REQUIRED)) for name in ports)
        reads = weights, memory, firing, learning, TIME if ticks else 0.0, axes, period, ticks, *signals
        self.update(period, learning_step, *reads, writes=[weights, memory])
        self.output("correction", network_output, weights, ahead, axes)
        if leads:
            self.output("learned_disturbance", network_output, weights, firing, axes)
        self.state_output(weights)
        if law.memory_name == "covariance":
            trace_layout = layout_of(SIGNALS["covariance_trace"], (0.0,) * len(axes))
            self.output("covariance_trace", covariance_traces, memory, layout=trace_layout)


def build_fuzzy_network(*, rules: Any, learning: Any, sets: Any = None) -> Diagram:
    """Build the diagram `network`.

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

    The network consists of several systems, so that Drake caches the firing strengths, which are used twice per tick:
    by the output and by the learning. The diagram exports the unconnected ports of these systems. Other inputs of the
    rules, and learning from the feedback, add input ports. The output `antecedents` exists if the antecedents are
    adaptive, and `learned_disturbance` if the network has a lead time.

    Args:
        rules: a `FuzzyRules`.
        learning: a `WeightLearning` on the same axes, for as many rules.
        sets: a `SetLearning` on the same axes if the antecedents are adaptive, else None.
    """
    builder = DiagramBuilder()
    parts = {"rules": rules, "learning": learning} | ({} if sets is None else {"sets": sets})
    for name, system in parts.items():
        builder.AddNamedSystem(name, system)
    internal = (rules, "firing"), (rules, "firing_ahead"), (learning, "weights"), (sets, "antecedents")
    sources = {name: system.GetOutputPort(name) for system, name in internal if system and system.HasOutputPort(name)}
    connect_inputs(builder, parts.values(), sources, exported=SIGNALS)
    of_learning = ("correction", "learned_disturbance", "weights", "covariance_trace")
    outputs = [(learning, name) for name in of_learning] + [(sets, "antecedents")]
    for system, name in outputs:
        if system is not None and system.HasOutputPort(name):
            builder.ExportOutput(system.GetOutputPort(name), name)
    return build(builder, "network")
