"""The network as Drake systems."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets, firing_strengths
from drake_quad.control.fuzzy.laws import CovarianceLaw, Limits, learn, trace
from drake_quad.elementary import Row
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

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
    firing strengths, R rows for each axis of the network: those of the first rule on all axes, then those of the next.

    One numeric parameter of the context: a1, a2, q; then scale, centres and widths of the error's sets; then of the
    rate's.

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
        *numbers, error, rate = antecedents
        self._sizes = len(error.centres), len(rate.centres)
        sets = [row for scale, centres, widths in (error, rate) for row in (scale, *centres, *widths)]
        self._parameters = self.numeric_parameter([*numbers, *sets])
        self._error, self._error_rate = self.input("error", 3), self.input("error_rate", 3)
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.output("firing", antecedents.num_rules * len(self._axes), self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        antecedents = self._antecedents(context)
        error, rate = self.input_rows(context, self._error), self.input_rows(context, self._error_rate)
        firing = [firing_strengths(error[i], rate[i], antecedents) for i in self._axes]
        self.write(output, [row for rule in zip(*firing) for row in rule])

    def _antecedents(self, context: Any) -> Antecedents:
        rows = self.parameter_rows(context, self._parameters)
        first, second = self._sizes
        middle = 4 + 2 * first
        error = FuzzySets(rows[3], rows[4 : 4 + first], rows[4 + first : middle])
        rate = FuzzySets(rows[middle], rows[middle + 1 : middle + 1 + second], rows[middle + 1 + second :])
        return Antecedents(rows[0], rows[1], rows[2], error, rate)


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
    place. `weights` shows F, R rows for each axis of the network, in the order of `firing`; `covariance_trace`, with
    the law that has one, a row for each axis.

    Discrete-state groups: 0 `weights`; 1 the memory of the law, if it has one. One numeric parameter of the context:
    λ, the rows of the law, the rows of `Limits`.

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
        self._axes = places(axes)
        self._period, self._law, self._rules = period, law.__class__, num_rules
        self._resets = {math.ceil(time / period - 1e-9) for time in reset_times}
        self._parameters = self.numeric_parameter([slope, *law, *limits])
        rows = len(self._axes)
        self._firing = self.input("firing", num_rules * rows)
        if law.learns_from == "surface":
            self._error, self._error_rate = self.input("error", 3), self.input("error_rate", 3)
        else:
            self._pd = self.input("pd", 3)
        self._weights = self.discrete_state("weights", [initial_weight] * (num_rules * rows))
        memory = [row for row in law.memory(num_rules) for _ in range(rows)]
        self._memory = self.discrete_state(law.memory_name, memory) if memory else None
        self._groups = range(len(self.group_names))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._learn)
        self.output("correction", 3, self._calc, uses={self.all_input_ports_ticket(), self.xd_ticket()})
        self.state_output(num_rules * rows, self._weights)
        if law.memory_name == "covariance":
            self.output("covariance_trace", rows, self._calc_trace, uses={self.xd_ticket()})

    def _learn(self, context: Any, discrete_state: Any) -> None:
        rows = self.parameter_rows(context, self._parameters)
        if self.num_vehicles > 1:
            rows = [np.tile(row, len(self._axes)) if isinstance(row, np.ndarray) else row for row in rows]
        last = 1 + len(self._law._fields)
        slope, law, limits = rows[0], self._law(*rows[1:last]), Limits(*rows[last:])
        firing = self._table(self.EvalVectorInput(context, self._firing))
        if law.learns_from == "surface":
            error, rate = (self._signal(context, port) for port in (self._error, self._error_rate))
            signal = rate + slope * error
        else:
            signal = self._signal(context, self._pd)
        vectors = [discrete_state.get_mutable_vector(i) for i in self._groups]
        weights, *memories = tables = [self._own_table(vector) for vector in vectors]
        memory = memories[0] if memories else weights[0:0]
        if self._resets and round(context.get_time() / self._period) in self._resets:
            for row, start in zip(memory, law.memory(self._rules)):
                row[:] = start
        learn(law, limits, weights, memory, firing, signal, self._period)
        if self.scalar is not float:
            for vector, table in zip(vectors, tables):
                vector.SetFromVector(table.ravel())

    def _calc(self, context: Any, output: Any) -> None:
        weights = self._table(context.get_discrete_state(self._weights))
        firing = self._table(self.EvalVectorInput(context, self._firing))
        rows = [0.0, 0.0, 0.0]
        for i, row in zip(self._axes, self._rows_of(np.einsum("rn,rn->n", weights, firing))):
            rows[i] = row
        self.write(output, rows)

    def _calc_trace(self, context: Any, output: Any) -> None:
        covariance = self._table(context.get_discrete_state(self._memory))
        self.write(output, self._rows_of(trace(covariance, self._rules)))

    def _signal(self, context: Any, port: int) -> np.ndarray:
        """The (n,) channels of an input of 3 rows."""
        values = self.values(self.EvalVectorInput(context, port))
        if self._axes[-1] - self._axes[0] < len(self._axes):  # side by side
            return values[self._axes[0] * self.num_vehicles : (self._axes[-1] + 1) * self.num_vehicles]
        return values.reshape(3, -1)[self._axes].ravel()

    def _rows_of(self, channels: np.ndarray) -> Any:
        """(n,) channels as a row for each axis."""
        return channels.tolist() if self.num_vehicles == 1 else channels.reshape(len(self._axes), -1)

    def _table(self, vector: Any) -> np.ndarray:
        """The elements of a BasicVector as rows of channels."""
        return self.values(vector).reshape(-1, len(self._axes) * self.num_vehicles)

    def _own_table(self, vector: Any) -> np.ndarray:
        """The same, to be changed in place for float; for other scalar types a copy."""
        values = vector.get_mutable_value() if self.scalar is float else vector.CopyToVector()
        return values.reshape(-1, len(self._axes) * self.num_vehicles)


def build_fuzzy_network(
    *,
    num_vehicles: int = 1,
    period: float = 0.02,
    axes: Sequence[Axis] = ("x", "y"),
    antecedents: Antecedents = Antecedents(),
    **learning: Any,
) -> Diagram:
    """Builds the diagram `network`, a `FuzzyRules` with its `WeightLearning`.

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
        num_vehicles: N.
        period: of the ticks, s.
        axes: of the network.
        antecedents: of the rules.
        learning: other arguments of `WeightLearning`.
    """
    builder = DiagramBuilder()
    rules = builder.AddNamedSystem("rules", FuzzyRules(num_vehicles=num_vehicles, axes=axes, antecedents=antecedents))
    learner = builder.AddNamedSystem(
        "learning",
        WeightLearning(
            num_vehicles=num_vehicles, period=period, axes=axes, num_rules=antecedents.num_rules, **learning
        ),
    )
    builder.Connect(rules.get_output_port(), learner.GetInputPort("firing"))
    for name in ("error", "error_rate"):
        builder.ExportInput(rules.GetInputPort(name), name)
        if learner.HasInputPort(name):
            builder.ConnectInput(name, learner.GetInputPort(name))
    if learner.HasInputPort("pd"):
        builder.ExportInput(learner.GetInputPort("pd"), "pd")
    for i in range(learner.num_output_ports()):
        port = learner.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    network = builder.Build()
    network.set_name("network")
    return network
