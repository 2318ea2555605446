"""Statements of the C function that advances a diagram by one period.

The statements call the functions of formulas in the order in which Drake would evaluate the diagram: first all outputs
that are required at this instant, then all updates of the state, which read only values from before the updates.

A row is one component of a port, parameter or state, as everywhere in drake_quad. A block describes the computations of
a system for compilation.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.compilation.blocks import Block, BlockUpdate, find_block, reason_not_compilable
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.compilation.trace import PERIOD_TOLERANCE
from drake_quad.errors import InputError
from drake_quad.export.formula_functions import FormulaFunction, FormulaFunctions
from drake_quad.export.structs import Structs, accessors, initializer, summary
from drake_quad.framework.c_code import Functions, Precision, constant_text, identifier
from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import Computation, FleetSystem, Input, Parameter, StateGroup
from drake_quad.framework.records import ROW, Layout, layout_of, rows_layout
from drake_quad.signals import SIGNALS

# Prefix of system paths that the names in C omit.
_CONTROL_PREFIX = "control."
# Name in C for the state of Drake's own systems, which has no name in Drake.
_UNNAMED_STATE = "value"


class Member(NamedTuple):
    """Member of the struct of all states or parameters.

    Attributes:
        path: path of the system.
        layout: layout of the state group or parameter.
        value: initial value of each component.
    """

    path: str
    layout: Layout
    value: np.ndarray


class _Update(NamedTuple):
    """Periodic update of a system.

    Attributes:
        path: path of the system.
        rule: computation of a `FleetSystem`, or update of one of Drake's own systems.
        divisor: number of steps in the period of the update.
    """

    path: str
    rule: Computation | BlockUpdate
    divisor: int


class _Row(NamedTuple):
    """C expression of one component of a signal.

    Sums and multiples of expressions are expressions, too. Computations of Drake's own systems can therefore be applied
    to expressions instead of numbers.

    Attributes:
        text: text of the expression.
        precision: floating-point format.
        num_operations: number of operations of the expression.
    """

    text: str
    precision: Precision
    num_operations: int = 0

    def __add__(self, other: Any) -> "_Row":
        return _Row(f"{self.text} + {other.text}", self.precision, self.num_operations + other.num_operations + 1)

    def __rmul__(self, factor: Any) -> "_Row":
        return _Row(f"{constant_text(factor, self.precision)} * {self.text}", self.precision, self.num_operations + 1)


class _BlockView(NamedTuple):
    """Inputs, parameters and state of one of Drake's own systems, like `drake_quad.compilation.trace.BlockView`.

    Attributes:
        step: statements of the function.
        path: path of the system.
    """

    step: "StepCode"
    path: str

    def required_input(self, index: int) -> list[_Row]:
        """Return the expressions of all components of an input port."""
        return self.step.as_rows(self.step.input_rows(self.path, index))

    def parameter(self, index: int) -> list[_Row]:
        """Return the values of a parameter as C constants, since exported code cannot change them."""
        values = self.step.default_context(self.path).get_numeric_parameter(index).value()
        return self.step.as_rows([constant_text(value, self.step.precision) for value in values])

    def state(self, group: int) -> list[_Row]:
        """Return the expressions of all components of the system's only state group."""
        return self.step.as_rows(self.step.discrete_state_rows(self.path))

    def source(self, output: int, element: int) -> Any:
        """Raise InputError, since systems whose output is a given trajectory over time cannot be exported."""
        raise InputError(f"{self.path} cannot be exported: its output is a given trajectory over time")


class StepCode:
    """Statements of the C function that advances a diagram by one period.

    Args:
        diagram: diagram of systems that declare formulas, with exported ports.
        outputs: names of exported output ports to compute.
        output_period: time between two computations of the outputs, s.
        structs: structs of the header.
        functions: static functions of the C file.

    Attributes:
        precision: floating-point format.
        formulas: C functions of all formulas.
        period: time between two steps, s.
        output_divisor: number of steps between two steps that write outputs.
        inputs: layout of each input, by name.
        outputs: layout of each output, by name.
        states: all state groups, by the name of the struct member.
        parameters: all parameters, by the name of the struct member.
        num_operations: largest number of operations of a step.

    Raises:
        InputError: if a system of the diagram is not declared by formulas, or if the periods do not match.
    """

    def __init__(
        self, diagram: Diagram, outputs: Sequence[str], output_period: float, structs: Structs, functions: Functions
    ) -> None:
        self._diagram, self.precision = diagram, functions.precision
        self._topology = Topology(diagram)
        self._leaves = self._topology.leaves
        self._blocks = {path: _block(path, system) for path, system in self._leaves.items()}
        self._context = diagram.CreateDefaultContext()
        self.states, self.parameters = self._states(), self._parameters()
        self._structs, self.formulas = structs, FormulaFunctions(structs, functions, self._variable_names())
        # Layout of the value of each C expression that denotes a struct or a number.
        self._layouts: dict[str, Layout] = {}
        self._rows_of: dict[Port, list[str]] = {}
        self._input_layouts = {port: self._input_layout(port) for port in self._exported_inputs()}
        self.inputs = {port.name: layout for port, layout in self._input_layouts.items()}
        output_ports = {output: self._topology.outputs[output] for output in outputs}
        declared = [(path, *each) for path in self._leaves for each in self._declared_updates(path)]
        periods = {period for _, _, period in declared}
        self.period = min(periods | {output_period})
        self.output_divisor = self._divisor("outputs", output_period)
        self._updates = [_Update(path, update, self._divisor(path, period)) for path, update, period in declared]
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
            real, period = self.precision.real, constant_text(self.period, self.precision)
            lines.append(f"const {real} time = ({real})controller->step * {period};")
        for member in self._changed:
            lines.append(f"{self._structs.c_type(self.states[member].layout)} next_{member} = controller->{member};")
        lines += self._block(1)
        lines += [f"controller->{member} = next_{member};" for member in self._changed]
        return [*lines, "controller->step += 1;"]

    def _block(self, divisor: int) -> list[str]:
        """Return the statements that run every `divisor` steps, with nested blocks for those that run less often."""
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
        """Return the layout that the first system reading an exported input port declares for it."""
        for path, system in self._leaves.items():
            for read in _reads_of(system):
                if isinstance(read, Input) and self._topology.source(Port(path, int(read.index))) == port:
                    return read.layout
        return signal_layout(port.name, port.size)

    def _declared_updates(self, path: str) -> list[tuple[Computation | BlockUpdate, float]]:
        """Return the updates of a system with their periods, s."""
        system = self._leaves[path]
        if isinstance(system, FleetSystem):
            return [(update.computation, update.period) for update in system.updates]
        return [(update, update.period) for update in self._blocks[path].updates if update.period is not None]

    def _divisor(self, label: str, period: float) -> int:
        """Return the number of steps in a period (s).

        Raises:
            InputError: if the period is not a multiple of the step.
        """
        steps = round(period / self.period)
        if abs(period / self.period - steps) > PERIOD_TOLERANCE:
            raise InputError(f"{label} cannot be exported: {period:g} s is not a multiple of {self.period:g} s")
        return steps

    def _sources(self, path: str, indices: Iterable[int]) -> list[Port]:
        """Return the output ports that are connected to input ports of a system."""
        sources = [self._topology.source(Port(path, index)) for index in indices]
        return [source for source in sources if isinstance(source, Port)]

    def _update_sources(self, update: _Update) -> list[Port]:
        if isinstance(update.rule, BlockUpdate):
            return self._sources(update.path, range(self._leaves[update.path].num_input_ports()))
        reads = update.rule.reads
        return self._sources(update.path, [int(read.index) for read in reads if isinstance(read, Input)])

    def _require(self, port: Port, divisor: int) -> None:
        """Request the computation of an output port, and of all ports on which it depends, every `divisor` steps."""
        common = math.gcd(self._divisors.get(port, divisor), divisor)
        if self._divisors.get(port) != common:
            self._divisors[port] = common
            for source in self._sources(port.path, self._blocks[port.path].feedthrough(port.number)):
                self._require(source, common)

    # Values of ports

    def _rows(self, port: Port | ExportedPort) -> list[str]:
        """Return the C expression of each component of a port, and append the statements that compute it."""
        if isinstance(port, ExportedPort):
            return self._struct_rows(f"inputs->{identifier(port.name)}", self._input_layouts[port])
        if port not in self._rows_of:
            system = self._leaves[port.path]
            if not isinstance(system, FleetSystem):
                self._rows_of[port] = self._rows_of_block(port)
            else:
                computation = system.outputs[system.get_output_port(port.number).get_name()]
                if computation.formula is identity and isinstance(computation.reads[0], StateGroup):
                    self._rows_of[port] = self._state_rows(port.path, computation.reads[0])
                else:
                    self._rows_of[port] = self._call(port, computation)
        return self._rows_of[port]

    def input_rows(self, path: str, index: int) -> list[str]:
        """Return the C expression of each component of an input port of a system.

        Raises:
            InputError: if the port is not connected.
        """
        source = self._topology.source(Port(path, index))
        if source is None:
            raise InputError(f"{path} cannot be exported: its input port {index} is not connected")
        return self._rows(source)

    def _struct_rows(self, expression: str, layout: Layout) -> list[str]:
        """Return the expressions of all numbers in a struct, and store the layouts of this and all nested structs."""
        self._remember(expression, layout)
        return [expression + accessor for accessor in accessors(layout)]

    def _remember(self, expression: str, layout: Layout) -> None:
        self._layouts[expression] = layout
        if layout.num_rows and layout.kind is not tuple and layout is not ROW:
            for field, part in zip(layout.kind._fields, layout.parts, strict=True):  # type: ignore[attr-defined]
                self._remember(f"{expression}.{identifier(field)}", part)

    def _state_rows(self, path: str, group: StateGroup) -> list[str]:
        return self._struct_rows(f"controller->{_member_name(path, group.name)}", group.layout)

    def as_rows(self, texts: Sequence[str]) -> list[_Row]:
        """Return `_Row` objects for C expressions without operations, such as variables and constants."""
        return [_Row(text, self.precision) for text in texts]

    def default_context(self, path: str) -> Any:
        """Return the default context of a system."""
        return self._leaves[path].GetMyContextFromRoot(self._context)

    def discrete_state_rows(self, path: str) -> list[str]:
        """Return the expressions of the state of one of Drake's own systems, which has a single state group."""
        layout = rows_layout(self.default_context(path).get_discrete_state(0).size())
        return self._struct_rows(f"controller->{_member_name(path, _UNNAMED_STATE)}", layout)

    def _rows_of_block(self, port: Port) -> list[str]:
        """Return the expressions of an output port of one of Drake's own systems.

        If the port is computed by operations, its value is stored in a variable first.
        """
        rows = self._blocks[port.path].output(port.number, _BlockView(self, port.path))  # type: ignore[arg-type]
        texts, num_operations = [row.text for row in rows], sum(row.num_operations for row in rows)
        if not num_operations:
            return texts
        name, layout = _system_name(port.path), signal_layout(port.path.split(".")[-1], len(texts))
        self.num_operations += num_operations
        kind = self._structs.c_type(layout)
        self._statements[self._divisors[port]].append(f"const {kind} {name} = {initializer(layout, texts)};")
        return self._struct_rows(name, layout)

    def _call(self, port: Port, computation: Computation) -> list[str]:
        """Append the call that computes an output port, and return the expressions of its components."""
        system = self._leaves[port.path]
        label = (
            _member_name(port.path, system.get_output_port(port.number).get_name()) if len(system.outputs) > 1 else ""
        )
        name = label or _system_name(port.path)
        (layout,) = computation.results
        function = self._function(port.path, name, computation)
        arguments = self._arguments(port.path, self._divisors[port], function)
        lines = self._statements[self._divisors[port]]
        lines.append(f"/* {port.path}: {summary(type(system))} */")
        kind = self._structs.c_type(layout)
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

    def _arguments(self, path: str, divisor: int, function: FormulaFunction) -> list[str]:
        """Return the C expressions of the arguments of a function that a system calls every `divisor` steps."""
        texts = []
        for read, _, layout in function.arguments:
            match read:
                case Input():
                    rows = self.input_rows(path, int(read.index))
                case Parameter():
                    rows = self._struct_rows(f"parameters->{self._parameter_name(path, read)}", layout)
                case StateGroup():
                    rows = self._state_rows(path, read)
                case _:
                    self._reads_time = True
                    texts.append("time")
                    continue
            texts.append(rows[0] if layout is ROW else f"&{self._struct_of(path, divisor, rows, layout)}")
        return texts

    def _struct_of(self, path: str, divisor: int, rows: Sequence[str], layout: Layout) -> str:
        """Return the expression of a struct with the given components, copied to a new struct if none contains them."""
        if struct := self._whole_struct(rows, layout):
            return struct
        name = f"{_system_name(path)}_input_{len(self._layouts)}"
        kind = self._structs.c_type(layout)
        self._statements[divisor].append(f"const {kind} {name} = {initializer(layout, rows)};")
        self._remember(name, layout)
        return name

    def _whole_struct(self, rows: Sequence[str], layout: Layout) -> str:
        """Return the expression of an existing struct that consists of the given components; empty if none does."""
        suffixes = accessors(layout)
        base = rows[0].removesuffix(suffixes[0])
        return base if self._layouts.get(base) == layout and [*rows] == [base + each for each in suffixes] else ""

    # State, parameters and updates

    def _states(self) -> dict[str, Member]:
        """Return all state groups, keyed by the name of their member in the C struct."""
        states: dict[str, Member] = {}
        for path, system in self._leaves.items():
            context = self.default_context(path)
            if isinstance(system, FleetSystem):
                for group in system.states.values():
                    value = context.get_discrete_state(group.index).value()
                    states[_member_name(path, group.name)] = Member(path, group.layout, value)
            elif context.num_discrete_state_groups():
                value = context.get_discrete_state(0).value()
                states[_member_name(path, _UNNAMED_STATE)] = Member(path, rows_layout(len(value)), value)
        return states

    def _parameters(self) -> dict[str, Member]:
        """Return all parameters, keyed by the name of their member in the C struct."""
        return {
            self._parameter_name(path, parameter): Member(
                path,
                parameter.layout,
                self.default_context(path).get_numeric_parameter(parameter.index).value(),
            )
            for path, system in self._leaves.items()
            if isinstance(system, FleetSystem)
            for parameter in system.parameters.values()
        }

    def _variable_names(self) -> set[str]:
        """Return the names of all arguments and variables, so that called functions get other names."""
        outputs = {
            _member_name(path, system.get_output_port(i).get_name())
            for path, system in self._leaves.items()
            for i in range(system.num_output_ports())
        }
        systems, states = {_system_name(path) for path in self._leaves}, {f"next_{member}" for member in self.states}
        return {"controller", "parameters", "inputs", "outputs", "time"} | outputs | systems | states

    def _parameter_name(self, path: str, parameter: Parameter) -> str:
        return _system_name(path) if parameter.name == "parameters" else _member_name(path, parameter.name)

    def _write_updates(self) -> list[str]:
        """Append the statements of all updates, and return the names of the state members that they change."""
        changed: list[str] = []
        for path, rule, divisor in self._updates:
            statements = self._statements[divisor]
            if isinstance(rule, BlockUpdate):
                member = _member_name(path, _UNNAMED_STATE)
                (rows,) = rule.compute(_BlockView(self, path)).values()  # type: ignore[arg-type]
                statements += self._assignments(f"next_{member}", rows_layout(len(rows)), [row.text for row in rows])
                changed.append(member)
            else:
                members = [_member_name(path, group.name) for group in rule.writes]
                function = self._function(path, f"{_system_name(path)}_update", rule)
                arguments = self._arguments(path, divisor, function)
                arguments += [f"&next_{member}" for member in members]
                statements.append(f"{function.name}({', '.join(arguments)});")
                self.num_operations += function.num_operations
                changed += members
        return changed

    def _assignments(self, target: str, layout: Layout, rows: Sequence[str]) -> list[str]:
        """Return the statements that assign components to a struct.

        There is a single statement if the components are all members of one other struct of the same type.
        """
        if struct := self._whole_struct(rows, layout):
            return [f"{target} = {struct};"]
        return [f"{target}{accessor} = {row};" for accessor, row in zip(accessors(layout), rows, strict=True)]


def _block(path: str, system: Any) -> Block:
    """Return the description of a leaf system's computations.

    Raises:
        InputError: if the system cannot be exported.
    """
    block = find_block(system)
    if block is None:
        label = f"{path} ({summary(type(system)).rstrip('.')})"
        raise InputError(f"{label} cannot be exported: {reason_not_compilable(system)}")
    for update in block.updates:
        if update.period is None:
            raise InputError(f"{path} cannot be exported: it computes its initial state from inputs")
        if update.unrestricted or not update.at_start:
            raise InputError(f"{path} cannot be exported: it has unrestricted updates or updates that skip time zero")
    return block


def _reads_of(system: Any) -> list[Any]:
    computations = [*getattr(system, "outputs", {}).values(), *(u.computation for u in getattr(system, "updates", ()))]
    return [read for computation in computations for read in computation.reads]


def signal_layout(name: str, num_rows: int) -> Layout:
    """Return the layout of a signal; it is an array if no known signal has this name and number of components."""
    if name in SIGNALS and hasattr(SIGNALS[name], "_fields"):
        layout = layout_of(SIGNALS[name])
        if layout.num_rows == num_rows:
            return layout
    return rows_layout(num_rows)


def _system_name(path: str) -> str:
    """Return the name of the struct member or variable for a system."""
    return identifier(path.removeprefix(_CONTROL_PREFIX))


def _member_name(path: str, name: str) -> str:
    """Return the name of the struct member or variable for a port, state group or parameter of a system."""
    return identifier(f"{path.removeprefix(_CONTROL_PREFIX)}_{name}")
