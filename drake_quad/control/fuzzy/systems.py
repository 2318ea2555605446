"""The network as Drake systems."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.fuzzy.inference import Antecedents, firing_on_axes
from drake_quad.control.fuzzy.laws import CovarianceLaw, Limits
from drake_quad.control.fuzzy.learning import LEARNING, traces, weighted_firing
from drake_quad.elementary import Row, plain
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_rows, fleet_system

Axis = Literal["x", "y", "z"]


def places(axes: Sequence[Axis]) -> list[int]:
    """Where axes are among X, Y, Z, rising."""
    return [i for i, axis in enumerate("xyz") if axis in axes]


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

    `error` (3 rows, m) and `error_rate` (3 rows, m/s) are those of the position controller. `firing` has the normalised
    firing strengths, R rows for each axis of the network, one axis after another.

    Numeric parameters of the context, as in `Antecedents.to_rows`: 0 a1, a2, q and the scales of error and rate; 1
    centre and width of each set of the error; 2 those of the rate.

    Args:
        num_vehicles: N.
        axes: of the network.
        antecedents: of its rules; each number may be an (N,) array.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        axes: Sequence[Axis] = ("x", "y"),
        antecedents: Antecedents = Antecedents(),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._axes = places(axes)
        parameters = antecedents.to_rows()
        self._parameters = [self.numeric_parameter(rows) for rows in parameters]
        self._error, self._error_rate = self.input("error", 3), self.input("error_rate", 3)
        num_axes, outputs = len(self._axes), [antecedents.num_rules] * len(self._axes)
        sizes = [len(rows) for rows in parameters]
        self._fire = self.mapped(firing_on_axes, inputs=(num_axes, num_axes, *sizes), outputs=outputs)
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.output("firing", sum(outputs), self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        inputs = self.inputs(context, self._error, self._error_rate)
        parameters = [context.get_numeric_parameter(index) for index in self._parameters]
        self._fire([output], [*(self.some_rows(vector, self._axes) for vector in inputs), *parameters])


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

    `correction` (3 rows, m/s²) is τ_f = Fᵀ W of the `firing` strengths from `FuzzyRules`, zero on axes that the network
    does not have. The weights F learn at every tick from s_p = ė + λ e, eq (15), of `error` (3 rows, m) and
    `error_rate` (3 rows, m/s). A law that learns from the PD's command has the input `pd` (3 rows, m/s²) in their
    place. `weights` shows F in the order of `firing`; `covariance_trace`, with the law that has one, a row for each
    axis.

    Discrete-state groups: 0 `weights`; 1 the memory of the law, if it has one. One numeric parameter of the context:
    λ, zero for a law that learns from the PD's command; the rows of the law; those of `Limits`.

    Args:
        num_vehicles: N.
        period: of the ticks, s.
        axes: of the network.
        num_rules: R.
        slope: λ, 1/s; a number or an (N,) array.
        law: of learning; likewise.
        limits: of learning; likewise.
        initial_weight: F₀ of all rules, m/s²; likewise.
        reset_times: at which the memory of the law begins anew, s: at the first tick from then on.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        period: float = 0.02,
        axes: Sequence[Axis] = ("x", "y"),
        num_rules: int = 9,
        slope: Row = 1.0,
        law: Any = CovarianceLaw(),
        limits: Limits = Limits(),
        initial_weight: Row = 0.0,
        reset_times: Sequence[float] = (),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._axes = np.array(places(axes))
        self._period, self._law, self._rules = period, law.__class__, num_rules
        self._step = LEARNING[self._law]
        self._resets = {math.ceil(time / period - 1e-9) for time in reset_times}
        self._firing = self.input("firing", num_rules * len(self._axes))
        if law.learns_from == "surface":
            self._signals = [self.input("error", 3), self.input("error_rate", 3)]
        else:
            self._signals, slope = [self.input("pd", 3)] * 2, 0.0
        self._parameters = self.numeric_parameter([slope, *law, *limits])
        num_weights = num_rules * len(self._axes)
        self._weights = self.discrete_state("weights", [initial_weight] * num_weights)
        memory = law.memory(num_rules) * len(self._axes)
        self._memory = self.discrete_state(law.memory_name, memory) if memory else None
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._learn)
        self.output("correction", 3, self._calc, uses={self.all_input_ports_ticket(), self.xd_ticket()})
        self.state_output(num_weights, self._weights)
        if law.memory_name == "covariance":
            self.output("covariance_trace", len(self._axes), self._calc_trace, uses={self.xd_ticket()})

    def _learn(self, context: Any, discrete_state: Any) -> None:
        groups = [self._weights] if self._memory is None else [self._weights, self._memory]
        vectors = [discrete_state.get_mutable_vector(group) for group in groups]
        weights, *memories = arrays = [self.values_to_change(vector) for vector in vectors]
        memory = memories[0] if memories else weights[0:0]
        if self._resets and round(plain(context.get_time()) / self._period) in self._resets:
            _, *law = self.parameter_rows(context, self._parameters)[: 1 + len(self._law._fields)]
            memory[:] = fleet_rows(self._law(*law).memory(self._rules) * len(self._axes), self.num_vehicles)
        inputs = self.inputs(context, self._firing, *self._signals)
        firing, error, rate = (self.values(vector) for vector in inputs)
        parameters = self.parameter_table(context, self._parameters)
        self._step(weights, memory, firing, error, rate, parameters, self._axes, self._rules, self._period)
        if self.scalar is not float:
            for vector, array in zip(vectors, arrays, strict=True):
                vector.SetFromVector(array)

    def _calc(self, context: Any, output: Any) -> None:
        weights, firing = context.get_discrete_state(self._weights), self.EvalVectorInput(context, self._firing)
        output.SetFromVector(weighted_firing(self.values(weights), self.values(firing), self._axes, self._rules))

    def _calc_trace(self, context: Any, output: Any) -> None:
        memory = self.values(context.get_discrete_state(self._memory))
        output.SetFromVector(traces(memory, len(self._axes), self._rules))


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
    builder.Connect(rules.get_output_port(), learning.GetInputPort("firing"))
    for name in ("error", "error_rate"):
        builder.ExportInput(rules.GetInputPort(name), name)
        if learning.HasInputPort(name):
            builder.ConnectInput(name, learning.GetInputPort(name))
    if learning.HasInputPort("pd"):
        builder.ExportInput(learning.GetInputPort("pd"), "pd")
    for i in range(learning.num_output_ports()):
        port = learning.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    network = builder.Build()
    network.set_name("network")
    return network
