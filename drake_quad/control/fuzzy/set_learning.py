"""Membership functions that learn, as a Drake system."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

from drake_quad.control.fuzzy.adaptation import AdaptationRates, Part, adapted, output_gradient
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.control.fuzzy.inputs import InputName, input_values, signals_of
from drake_quad.control.fuzzy.systems import (
    UNCONNECTED,
    LearningNumbers,
    PerNetworkAxis,
    counted,
    layout_of_antecedents,
    layout_on_axes,
    signal_and_ports,
)
from drake_quad.framework.fleet_system import TIME, AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.per_axis import Axis
from drake_quad.signals import Row


class AdaptationNumbers(NamedTuple):
    """What membership functions learn by.

    Attributes:
        antecedents: at the beginning, on each axis.
        rates: γ.
        learning: of the weights; slope, dead zone and signal are the same here.
    """

    antecedents: tuple[Antecedents, ...] = (Antecedents(), Antecedents())
    rates: AdaptationRates = AdaptationRates()
    learning: LearningNumbers = LearningNumbers()


def adapted_on_axes(
    antecedents: tuple[Antecedents, ...],
    weights: PerNetworkAxis,
    numbers: AdaptationNumbers,
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
    """The antecedents on each axis of a network a tick later.

    Args:
        antecedents: before.
        weights: F.
        numbers: to learn by.
        axes: of the network.
        inputs: of the rules.
        parts: that learn.
        time: of the tick, s.
        lap_times: when the laps of the route begin and the last one ends, s.
        period: h, s.
        signal_of: `surface` or `feedback`, from which the network learns.
        ports: names of the signals that this is made of.
        signals: these, and then those from which the inputs follow.
    """
    known = dict(zip(dict.fromkeys([*ports, *signals_of(inputs)]), signals, strict=True))
    after = []
    for axis, sets, f, initial in zip(axes, antecedents, weights, numbers.antecedents, strict=True):
        signal = signal_of(axis, numbers.learning, *[known[port] for port in ports])
        gradient = output_gradient(input_values(axis, inputs, known, time, lap_times), sets, f)
        step = period * counted(signal, numbers.learning.limits.deadzone)
        after.append(adapted(sets, gradient, step, numbers.rates, initial=initial, parts=parts))
    return tuple(after)


@fleet_system(float, AutoDiffXd)
class SetLearning(FleetSystem):
    """The antecedents of the network's rules where they learn.

    .. pydrake_system::

        name: SetLearning
        input_ports:
        - weights
        - error
        - error_rate
        output_ports:
        - antecedents

    The sets of each axis learn at every tick, by `drake_quad.control.fuzzy.adaptation`, from the signal from which the
    `weights` learn; further inputs are those from which the inputs of the rules follow. `antecedents` shows the numbers
    of all sets, on one axis after another: a₁, a₂, q, and of each input its scale, its centres and its widths.

    The only state is `antecedents`; the only parameter of the context is `adaptation`.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        axes: of the network, in the order of X, Y, Z.
        inputs: of the rules, see `drake_quad.control.fuzzy.inputs`.
        lap_times: when the laps of the route begin and the last one ends, s; needed for the phase only.
        learns_from: "surface" or "feedback".
        parts: that learn: "centres", "widths", "exponents".
        numbers: to learn by.
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
        numbers: AdaptationNumbers = AdaptationNumbers(),
    ) -> None:
        """Declares the system."""
        axes, inputs = tuple(axes), tuple(inputs)
        first, *_ = numbers.antecedents
        weights = self.input("weights", layout=layout_on_axes(len(axes), first.num_rules))
        signal_of, ports = signal_and_ports(learns_from)
        names = dict.fromkeys([*ports, *signals_of(inputs)])
        signals = [self.input(name, absent=UNCONNECTED.get(name)) for name in names]
        antecedents = self.state(
            "antecedents", lambda numbers: numbers.antecedents, layout=layout_of_antecedents(numbers.antecedents)
        )
        adaptation = self.parameter("adaptation", lambda numbers: numbers)
        time = TIME if "phase" in inputs else 0.0
        constants = axes, inputs, tuple(parts), time, tuple(lap_times), period, signal_of, ports
        reads = antecedents, weights, adaptation, *constants, *signals
        self.update(period, adapted_on_axes, *reads, writes=[antecedents])
        self.state_output(antecedents)
