"""Statements of the C function that advances a diagram by one period.

The statements call the functions of formulas in the order in which Drake would evaluate the diagram: first all outputs
that are required at this instant, then all updates of the state, which read only values from before the updates.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    Multiplexer,
    PassThrough,
    ZeroOrderHold,
)

from drake_quad.compilation.blocks import block_of, reason_not_compilable
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.compilation.trace import ROUNDING
from drake_quad.errors import InputError
from drake_quad.export.formula_functions import FormulaFunction, FormulaFunctions
from drake_quad.export.structs import Structs, accessors, initializer, summary
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.c_code import Functions, constant_text, identifier
from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import Computation, Input, Parameter, StateGroup
from drake_quad.framework.records import ROW, Layout, layout_of, rows_layout
from drake_quad.signals import SIGNALS

# Prefix of paths that names in C omit.
_CONTROL = "control."


class Member(NamedTuple):
    """Member of the struct of all states or parameters.

    Attributes:
        path: path of the system.
        layout: layout of the state group or parameter.
        value: initial value of each row.
    """

    path: str
    layout: Layout
    value: np.ndarray


class _Update(NamedTuple):
    """Periodic update of a system.

    Attributes:
        path: path of the system.
        computation: computation of the update; None for a hold.
        divisor: number of steps in the period.
    """

    path: str
    computation: Computation | None
    divisor: int


class Step:
    """Statements of the C function that advances a diagram by one period.

    Args:
        diagram: diagram of systems that declare formulas, with exported ports.
        outputs: names of exported output ports to compute.
        output_period: time between two computations of the outputs, s.
        structs: structs of the header.
        functions: static functions of the C file.

    Attributes:
        formulas: C functions of all formulas.
        period: time between two steps, s.
        output_divisor: number of steps between two steps that write outputs.
        inputs: layout of each input, by name.
        outputs: layout of each output, by name.
        states: all state groups, by the name of the struct member.
        parameters: all parameters, by the name of the struct member.
        num_operations: largest number of operations of a step.

    Raises:
        InputError: if a system of the diagram is no formula, or if the periods do not match.
    """

    def __init__(
        self, diagram: Diagram, outputs: Sequence[str], output_period: float, structs: Structs, functions: Functions
    ) -> None:
        self._diagram, self._precision = diagram, functions.precision
        self._topology = Topology(diagram)
        self._leaves = self._topology.leaves
        for path, system in self._leaves.items():
            _check(path, system)
        self._context = diagram.CreateDefaultContext()
        self._structs, self.formulas = structs, FormulaFunctions(structs, functions)
        # C type of each expression that is a struct, by the expression.
        self._types: dict[str, Layout] = {}
        self._rows_of: dict[Port, list[str]] = {}
        self._input_layouts = {port: self._input_layout(port) for port in self._exported_inputs()}
        self.inputs = {port.name: layout for port, layout in self._input_layouts.items()}
        output_ports = {output: self._topology.outputs[output] for output in outputs}
        periods = {update.period for path in self._leaves for update in self._declared_updates(path)}
        self.period = min(periods | {output_period})
        self.output_divisor = self._divisor("outputs", output_period)
        self._updates = [
            _Update(path, getattr(update, "computation", None), self._divisor(path, update.period))
            for path in self._leaves
            for update in self._declared_updates(path)
        ]
        self._divisors: dict[Port, int] = {}
        self._reads_time = False
        self._statements: dict[int, list[str]] = defaultdict(list)
        self.num_operations = 0
        for port in output_ports.values():
            self._require(port, self.output_divisor)
        for update in self._updates:
            for source in self._update_sources(update):
                self._require(source, update.divisor)
        for port in [*self._divisors]:
            self._rows(port)
        self.outputs = {name: signal_layout(name, len(self._rows(port))) for name, port in output_ports.items()}
        for name, port in output_ports.items():
            target = f"outputs->{identifier(name)}"
            self._statements[self.output_divisor] += self._assignments(target, self.outputs[name], self._rows(port))
        self.states, self.parameters = self._states(), self._parameters()
        self._changed = self._write_updates()

    def lines(self) -> list[str]:
        """Return the statements of the function. Its arguments are controller, parameters, inputs and outputs."""
        body = [line for statements in self._statements.values() for line in statements]
        lines = [
            f"(void){argument};"
            for argument in ("parameters", "inputs")
            if not any(f"{argument}->" in line for line in body)
        ]
        if self._reads_time:
            real, period = self._precision.real, constant_text(self.period, self._precision)
            lines.append(f"const {real} time = ({real})controller->step * {period};")
        for member in self._changed:
            lines.append(f"{self._structs.type_of(self.states[member].layout)} next_{member} = controller->{member};")
        lines += self._block(1)
        lines += [f"controller->{member} = next_{member};" for member in self._changed]
        return [*lines, "controller->step += 1;"]

    def _block(self, divisor: int) -> list[str]:
        """Return the statements for each multiple of `divisor` steps; those for larger multiples are nested in them."""
        used = [1, *(each for each in sorted(self._statements) if each > 1 and self._statements[each])]
        lines = [*self._statements[divisor]]
        for inner in used[1:]:
            if max(each for each in used if each < inner and inner % each == 0) == divisor:
                nested = [f"    {line}" for line in self._block(inner)]
                lines += [f"if (controller->step % {inner} == 0) {{", *nested, "}"]
        return lines

    # Structure of the diagram

    def _exported_inputs(self) -> list[ExportedPort]:
        sources = [source for path in self._leaves for source in self._topology.sources(path)]
        used = {source for source in sources if isinstance(source, ExportedPort)}
        names = [self._diagram.get_input_port(i).get_name() for i in range(self._diagram.num_input_ports())]
        return sorted(used, key=lambda port: names.index(port.name))

    def _input_layout(self, port: ExportedPort) -> Layout:
        """Return the layout of an exported input port: that of the first system that reads it."""
        for path, system in self._leaves.items():
            for read in _reads_of(system):
                if isinstance(read, Input) and self._topology.source(Port(path, int(read.index))) == port:
                    return read.layout
        return signal_layout(port.name, port.size)

    def _declared_updates(self, path: str) -> Sequence[Any]:
        system = self._leaves[path]
        if isinstance(system, ZeroOrderHold):
            return [_HoldUpdate(system.GetUniquePeriodicDiscreteUpdateAttribute().period_sec())]
        return getattr(system, "updates", ())

    def _divisor(self, label: str, period: float) -> int:
        """Return the number of steps in a period (s).

        Raises:
            InputError: if the period is not a multiple of a step.
        """
        steps = round(period / self.period)
        if abs(period / self.period - steps) > ROUNDING:
            raise InputError(f"{label} cannot be exported: {period:g} s is not a multiple of {self.period:g} s")
        return steps

    def _computation(self, port: Port) -> Computation | None:
        """Return the computation of an output port; None for a system of Drake."""
        system = self._leaves[port.path]
        outputs = getattr(system, "outputs", None)
        return None if outputs is None else outputs[system.get_output_port(port.number).get_name()]

    def _sources(self, port: Port) -> list[Port]:
        """Return the output ports that an output port reads directly."""
        computation, system = self._computation(port), self._leaves[port.path]
        if computation is not None:
            indices = [int(read.index) for read in computation.reads if isinstance(read, Input)]
        else:
            indices = [] if isinstance(system, ZeroOrderHold) else [*range(system.num_input_ports())]
        return self._source_ports(port.path, indices)

    def _source_ports(self, path: str, indices: Sequence[int]) -> list[Port]:
        sources = [self._topology.source(Port(path, index)) for index in indices]
        return [source for source in sources if isinstance(source, Port)]

    def _update_sources(self, update: _Update) -> list[Port]:
        if update.computation is None:
            return self._source_ports(update.path, [0])
        reads = update.computation.reads
        return self._source_ports(update.path, [int(read.index) for read in reads if isinstance(read, Input)])

    def _require(self, port: Port, divisor: int) -> None:
        """Require the value of an output port at every multiple of `divisor` steps."""
        common = math.gcd(self._divisors.get(port, divisor), divisor)
        if self._divisors.get(port) != common:
            self._divisors[port] = common
            for source in self._sources(port):
                self._require(source, common)

    # Values of ports

    def _rows(self, port: Port | ExportedPort) -> list[str]:
        """Return the C expression of each row of a port, and append the statements that compute it."""
        if isinstance(port, ExportedPort):
            return self._struct_rows(f"inputs->{identifier(port.name)}", self._input_layouts[port])
        if port not in self._rows_of:
            computation = self._computation(port)
            if computation is None:
                self._rows_of[port] = self._primitive_rows(port)
            elif computation.formula is identity and isinstance(computation.reads[0], StateGroup):
                self._rows_of[port] = self._state_rows(port.path, computation.reads[0])
            else:
                self._rows_of[port] = self._call(port, computation)
        return self._rows_of[port]

    def _input_rows(self, path: str, index: int) -> list[str]:
        source = self._topology.source(Port(path, index))
        if source is None:
            raise InputError(f"{path} cannot be exported: its input port {index} is not connected")
        return self._rows(source)

    def _struct_rows(self, expression: str, layout: Layout) -> list[str]:
        """Return the expressions of the rows of a struct, and remember the types of all structs in it."""
        self._remember(expression, layout)
        return [expression + accessor for accessor in accessors(layout)]

    def _remember(self, expression: str, layout: Layout) -> None:
        self._types[expression] = layout
        if layout.num_rows and layout.kind is not tuple and layout is not ROW:
            for field, part in zip(layout.kind._fields, layout.parts, strict=True):  # type: ignore[attr-defined]
                self._remember(f"{expression}.{identifier(field)}", part)

    def _state_rows(self, path: str, group: StateGroup) -> list[str]:
        return self._struct_rows(f"controller->{_member(path, group.name)}", group.layout)

    def _primitive_rows(self, port: Port) -> list[str]:
        """Return the rows of an output port of a system of Drake."""
        path, system = port.path, self._leaves[port.path]
        match system:
            case ConstantVectorSource():
                value = system.get_source_value(system.GetMyContextFromRoot(self._context)).value()
                return [constant_text(each, self._precision) for each in value]
            case Demultiplexer():
                sizes = [system.get_output_port(index).size() for index in range(port.number + 1)]
                return self._input_rows(path, 0)[sum(sizes[:-1]) : sum(sizes)]
            case Multiplexer():
                return [row for index in range(system.num_input_ports()) for row in self._input_rows(path, index)]
            case PassThrough() | Broadcast():
                return self._input_rows(path, 0)
            case ZeroOrderHold():
                layout = rows_layout(system.get_output_port().size())
                return self._struct_rows(f"controller->{_member(path, 'value')}", layout)
            case Adder():
                inputs = [self._input_rows(path, index) for index in range(system.num_input_ports())]
                return self._variable(port, [" + ".join(terms) for terms in zip(*inputs, strict=True)], len(inputs) - 1)
            case Gain():
                context = system.CreateDefaultContext()
                system.get_input_port().FixValue(context, np.ones(system.get_input_port().size()))
                factors = [constant_text(factor, self._precision) for factor in system.get_output_port().Eval(context)]
                rows = self._input_rows(path, 0)
                return self._variable(port, [f"{factor} * {row}" for factor, row in zip(factors, rows, strict=True)], 1)
        raise AssertionError(f"{path} should have been refused")

    def _variable(self, port: Port, texts: list[str], operations_per_row: int) -> list[str]:
        """Append a variable with a value for each row, and return its rows."""
        name, divisor = _system(port.path), self._divisors[port]
        layout = signal_layout(port.path.split(".")[-1], len(texts))
        self.num_operations += operations_per_row * len(texts)
        kind = self._structs.type_of(layout)
        self._statements[divisor].append(f"const {kind} {name} = {initializer(layout, texts)};")
        return self._struct_rows(name, layout)

    def _call(self, port: Port, computation: Computation) -> list[str]:
        """Append the call that computes an output port, and return its rows."""
        system = self._leaves[port.path]
        label = _member(port.path, system.get_output_port(port.number).get_name()) if len(system.outputs) > 1 else ""
        name = label or _system(port.path)
        (layout,) = computation.results
        function = self._function(port.path, name, computation)
        arguments = self._arguments(port, function)
        lines = self._statements[self._divisors[port]]
        lines.append(f"/* {port.path}: {summary(type(system))} */")
        kind = self._structs.type_of(layout)
        if layout is ROW:
            lines.append(f"const {kind} {name} = {function.name}({', '.join(arguments)});")
        else:
            lines += [f"{kind} {name};", f"{function.name}({', '.join([*arguments, f'&{name}'])});"]
        self.num_operations += function.num_operations
        return self._struct_rows(name, layout)

    def _function(self, path: str, label: str, computation: Computation) -> FormulaFunction:
        """Return the C function of a computation of a system."""
        indices = [int(read.index) for read in computation.reads if isinstance(read, Input)]
        absent = {index for index in indices if self._topology.source(Port(path, index)) is None}
        return self.formulas.function(path, label, computation, absent)

    def _arguments(self, port: Port, function: FormulaFunction) -> list[str]:
        """Return the C expressions of the arguments of a call."""
        texts = []
        for read, _, layout in function.arguments:
            match read:
                case Input():
                    rows = self._input_rows(port.path, int(read.index))
                case Parameter():
                    expression = f"parameters->{self._parameter_member(port.path, read)}"
                    rows = self._struct_rows(expression, layout)
                case StateGroup():
                    rows = self._state_rows(port.path, read)
                case _:
                    self._reads_time = True
                    texts.append("time")
                    continue
            texts.append(self._argument(port, rows, layout))
        return texts

    def _argument(self, port: Port, rows: list[str], layout: Layout) -> str:
        """Return the argument for the rows of a record: a pointer to a struct that contains exactly these rows."""
        if layout is ROW:
            return rows[0]
        suffix = accessors(layout)[0]
        base = rows[0].removesuffix(suffix) if suffix else rows[0]
        if self._types.get(base) == layout and rows == [base + accessor for accessor in accessors(layout)]:
            return f"&{base}"
        name = f"{_system(port.path)}_input_{len(self._types)}"
        kind = self._structs.type_of(layout)
        lines = self._statements[self._divisors.get(port, port.number)]
        lines.append(f"const {kind} {name} = {initializer(layout, rows)};")
        self._remember(name, layout)
        return f"&{name}"

    # State, parameters and updates

    def _states(self) -> dict[str, Member]:
        """Return all state groups, by the name of the struct member."""
        states: dict[str, Member] = {}
        for path, system in self._leaves.items():
            context = system.GetMyContextFromRoot(self._context)
            if isinstance(system, ZeroOrderHold):
                value = context.get_discrete_state(0).value()
                states[_member(path, "value")] = Member(path, rows_layout(len(value)), value)
            for group in getattr(system, "states", {}).values():
                value = context.get_discrete_state(group.index).value()
                states[_member(path, group.name)] = Member(path, group.layout, value)
        return states

    def _parameters(self) -> dict[str, Member]:
        """Return all parameters, by the name of the struct member."""
        return {
            self._parameter_member(path, parameter): Member(
                path,
                parameter.layout,
                system.GetMyContextFromRoot(self._context).get_numeric_parameter(parameter.index).value(),
            )
            for path, system in self._leaves.items()
            for parameter in getattr(system, "parameters", {}).values()
        }

    def _parameter_member(self, path: str, parameter: Parameter) -> str:
        return _system(path) if parameter.name == "parameters" else _member(path, parameter.name)

    def _write_updates(self) -> list[str]:
        """Append the statements of all updates, and return the names of the state members that they change."""
        changed: list[str] = []
        for update in self._updates:
            path, statements = update.path, self._statements[update.divisor]
            # The port number stands for the divisor of the statements that gather arguments.
            place = Port(path, update.divisor)
            if update.computation is None:
                members = [_member(path, "value")]
                layout = rows_layout(self._leaves[path].get_output_port().size())
                statements += self._assignments(f"next_{members[0]}", layout, self._input_rows(path, 0))
            else:
                members = [_member(path, group.name) for group in update.computation.writes]
                function = self._function(path, f"{_system(path)}_update", update.computation)
                arguments = [*self._arguments(place, function), *(f"&next_{member}" for member in members)]
                statements.append(f"{function.name}({', '.join(arguments)});")
                self.num_operations += function.num_operations
            changed += members
        return changed

    def _assignments(self, target: str, layout: Layout, rows: Sequence[str]) -> list[str]:
        """Return the statements that assign rows to a struct; a whole struct is copied at once."""
        suffix = accessors(layout)[0]
        base = rows[0].removesuffix(suffix) if suffix else rows[0]
        if self._types.get(base) == layout and [*rows] == [base + accessor for accessor in accessors(layout)]:
            return [f"{target} = {base};"]
        return [f"{target}{accessor} = {row};" for accessor, row in zip(accessors(layout), rows, strict=True)]


class _HoldUpdate(NamedTuple):
    """Update of a hold, given its period, s."""

    period: float


def _check(path: str, system: Any) -> None:
    """Raise InputError if a leaf system cannot be exported."""
    if block_of(system) is None:
        label = f"{path} ({summary(type(system)).rstrip('.')})"
        raise InputError(f"{label} cannot be exported: {reason_not_compilable(system)}")
    if getattr(system, "initializations", ()):
        raise InputError(f"{path} cannot be exported: it computes its initial state from inputs")
    if any(update.unrestricted or not update.at_start for update in getattr(system, "updates", ())):
        raise InputError(f"{path} cannot be exported: it has updates that precede the other updates of an instant")


def _reads_of(system: Any) -> list[Any]:
    computations = [*getattr(system, "outputs", {}).values(), *(u.computation for u in getattr(system, "updates", ()))]
    return [read for computation in computations for read in computation.reads]


def signal_layout(name: str, num_rows: int) -> Layout:
    """Return the layout of a signal; an array if no signal has this name and number of rows."""
    if name in SIGNALS and hasattr(SIGNALS[name], "_fields"):
        layout = layout_of(SIGNALS[name])
        if layout.num_rows == num_rows:
            return layout
    return rows_layout(num_rows)


def _system(path: str) -> str:
    """Return the name of a struct member or variable for a system."""
    return identifier(path.removeprefix(_CONTROL))


def _member(path: str, name: str) -> str:
    """Return the name of a struct member or variable for a part of a system."""
    return identifier(f"{path.removeprefix(_CONTROL)}_{name}")
