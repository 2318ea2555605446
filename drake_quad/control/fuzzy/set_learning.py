"""Adaptive membership functions, as a Drake system."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from drake_quad.control.fuzzy.adaptation import AdaptationRates, Part, adapt_antecedents, output_gradient
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.control.fuzzy.inputs import InputName, input_signals, input_values
from drake_quad.control.fuzzy.systems import (
    UNCONNECTED,
    LearningParameters,
    PerNetworkAxis,
    layout_of_antecedents,
    layout_on_axes,
    signal_and_ports,
    with_deadzone,
)
from drake_quad.framework.fleet_system import REQUIRED, TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import Row


class AdaptationParameters(NamedTuple):
    """Parameters of adaptive membership functions.

    Attributes:
        antecedents: initial antecedents on each axis.
        rates: learning rates γ.
        learning: learning parameters of the weights. Their λ and dead zone also apply to the membership functions.
    """

    antecedents: tuple[Antecedents, ...] = (Antecedents(), Antecedents())
    rates: AdaptationRates = AdaptationRates()
    learning: LearningParameters = LearningParameters()


def adapt_antecedents_on_axes(
    antecedents: tuple[Antecedents, ...],
    weights: PerNetworkAxis,
    parameters: AdaptationParameters,
    axes: Sequence[Axis],
    inputs: Sequence[InputName],
    parts: Sequence[Part],
    time: Row,
    lap_times: Sequence[float],
    period: float,
    signal_of: Callable[..., Row],
    ports: Sequence[str],
    *signals: Any,
) -> tuple[Antecedents, ...]:
    """Return the antecedents on each axis of a network at the next tick.

    Args:
        antecedents: antecedents at this tick.
        weights: weights F of the rules.
        parameters: parameters of the adaptation.
        axes: axes of the network.
        inputs: names of the inputs of the rules.
        parts: parts of the antecedents that learn.
        time: time of the tick, s.
        lap_times: start of each lap of the route and end of the last one, s.
        period: tick period h, s.
        signal_of: formula of the learning signal, `surface` or `feedback`.
        ports: names of the arguments of this formula.
        signals: values of these arguments, followed by the signals of `input_signals`, without duplicates.
    """
    signals_by_name = dict(zip(dict.fromkeys([*ports, *input_signals(inputs)]), signals, strict=True))
    after = []
    for axis, sets, f, initial in zip(axes, antecedents, weights, parameters.antecedents, strict=True):
        signal = signal_of(axis, parameters.learning, *[signals_by_name[port] for port in ports])
        gradient = output_gradient(input_values(axis, inputs, signals_by_name, time, lap_times), sets, f)
        step = period * with_deadzone(signal, parameters.learning.limits.deadzone)
        after.append(adapt_antecedents(sets, gradient, step, parameters.rates, initial=initial, parts=parts))
    return tuple(after)


@fleet_system(float, AutoDiffXd)
class SetLearning(FleetSystem):
    """Adaptive antecedents of the network's rules.

    .. pydrake_system::

        name: SetLearning
        input_ports:
        - weights
        - error
        - error_rate
        output_ports:
        - antecedents

    The sets of each axis are adapted at every tick (`drake_quad.control.fuzzy.adaptation`), from the same learning
    signal as the `weights`. Further input ports are the signals that determine the inputs of the rules. `antecedents`
    contains the parameters of all sets, one axis after another: a₁, a₂, q, and for each input of the rules the scale,
    the centres and the widths.

    The only state is `antecedents`; the only parameter of the context is `adaptation`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period h, s.
        axes: axes of the network, in the order of X, Y, Z.
        inputs: inputs of the rules; see `drake_quad.control.fuzzy.inputs`.
        lap_times: start of each lap of the route and end of the last one, s; needed only for the input `phase`.
        learns_from: learning signal, "surface" or "feedback".
        parts: parts of the antecedents that learn: "centres", "widths", "exponents".
        parameters: parameters of the adaptation.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        axes: Sequence[Axis] = ("x", "y"),
        inputs: Sequence[InputName] = ("error", "error_rate"),
        lap_times: Sequence[float] = (),
        learns_from: Literal["surface", "feedback"] = "surface",
        parts: Sequence[Part] = ("centres", "widths", "exponents"),
        parameters: AdaptationParameters = AdaptationParameters(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        axes, inputs = tuple(axes), tuple(inputs)
        first, *_ = parameters.antecedents
        weights = self.input("weights", layout=layout_on_axes(len(axes), first.num_rules))
        signal_of, ports = signal_and_ports(learns_from)
        names = dict.fromkeys([*ports, *input_signals(inputs)])
        signals = [self.input(name, absent=UNCONNECTED.get(name, REQUIRED)) for name in names]
        antecedents = self.state(
            "antecedents",
            lambda parameters: parameters.antecedents,
            layout=layout_of_antecedents(parameters.antecedents),
        )
        adaptation = self.parameter("adaptation", lambda parameters: parameters)
        time = TIME if "phase" in inputs else 0.0
        constants = axes, inputs, tuple(parts), time, tuple(lap_times), period, signal_of, ports
        reads = antecedents, weights, adaptation, *constants, *signals
        self.update(period, adapt_antecedents_on_axes, *reads, writes=[antecedents])
        self.state_output(antecedents)
