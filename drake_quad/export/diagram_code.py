"""C code of a diagram, such as a controller: a struct with its state, and a function that advances it by one period.

Each formula of the diagram becomes a static function of structs. The function `step` calls these functions in the order
in which Drake would evaluate the diagram: first all outputs that are required at this instant, then all updates of the
state, which read only values from before the updates.
"""

import functools
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
from drake_quad.export.structs import Structs, accessors, initializer, struct_text, summary
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.c_code import (
    MULTIPLY_ADD_FUNCTION,
    WORD_FUNCTIONS,
    Body,
    Functions,
    Precision,
    constant_text,
    function_text,
    identifier,
    wrapped,
)
from drake_quad.framework.elementary import identity
from drake_quad.framework.fleet_system import Computation, Input, Parameter, StateGroup
from drake_quad.framework.formulas import TIME, TickOf, hashable_key, trace_formula
from drake_quad.framework.records import ABSENT, ROW, Layout, layout_of, rows_layout
from drake_quad.framework.symbols import LEAVES, Listing, Symbol
from drake_quad.framework.variable_names import collect_names
from drake_quad.signals import SIGNALS


# Prefix of paths that names in C omit.
_CONTROL = "control."


class DiagramCode(NamedTuple):
    """C code of a diagram.

    Attributes:
        header: text of the header, without its opening comment.
        source: text of the source file, without its opening comment.
        period: time between two steps, s.
        output_divisor: number of steps between two steps that write outputs.
        inputs: numbers of rows of the inputs, by name.
        outputs: numbers of rows of the outputs, by name.
        num_states: number of rows of the state.
        num_parameters: number of rows of the parameters.
        num_operations: largest number of operations of a step.
    """

    header: str
    source: str
    period: float
    output_divisor: int
    inputs: dict[str, int]
    outputs: dict[str, int]
    num_states: int
    num_parameters: int
    num_operations: int


def diagram_code(
    diagram: Diagram, *, name: str, outputs: Sequence[str], output_period: float, precision: Precision
) -> DiagramCode:
    """Return the C code of a diagram for a single vehicle.

    Args:
        diagram: diagram of systems that declare formulas, with exported ports.
        name: prefix of all names, and name of the header.
        outputs: names of exported output ports to compute.
        output_period: time between two computations of the outputs, s.
        precision: floating-point format.

    Raises:
        InputError: if a system of the diagram is no formula, or if the periods do not match.
    """
    writer = _Writer(diagram, name, outputs, output_period, precision)
    return writer.code()


class _Argument(NamedTuple):
    """Argument of a C function.

    Attributes:
        read: port, parameter or state group that is read; None for the time.
        name: name of the argument.
        layout: layout of the argument.
    """

    read: Any
    name: str
    layout: Layout


class _Function(NamedTuple):
    """C function of a computation.

    Attributes:
        name: name of the function.
        arguments: arguments that the function uses.
        num_operations: number of operations of a call.
    """

    name: str
    arguments: tuple[_Argument, ...]
    num_operations: int


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


class _Writer:
    """Writer of the C code of a diagram; the arguments are as in `diagram_code`."""

    def __init__(
        self, diagram: Diagram, name: str, outputs: Sequence[str], output_period: float, precision: Precision
    ) -> None:
        self._diagram, self._name, self._precision = diagram, name, precision
        self._topology = Topology(diagram)
        self._leaves = self._topology.leaves
        for path, system in self._leaves.items():
            _check(path, system)
        self._context = diagram.CreateDefaultContext()
        self._structs, self._functions = Structs(name, precision.real), Functions(precision)
        self._formula_texts: list[str] = []
        self._by_signature: dict[Any, _Function] = {}
        # C type of each expression that is a struct, by the expression.
        self._types: dict[str, Layout] = {}
        self._rows_of: dict[Port, list[str]] = {}
        self._inputs = {port.name: port for port in self._exported_inputs()}
        self._input_layouts = {port: self._input_layout(port) for port in self._inputs.values()}
        self._outputs = {output: self._topology.outputs[output] for output in outputs}
        periods = {update.period for path in self._leaves for update in self._declared_updates(path)}
        self._period = min(periods | {output_period})
        self._output_divisor = self._divisor("outputs", output_period)
        self._updates = [
            _Update(path, getattr(update, "computation", None), self._divisor(path, update.period))
            for path in self._leaves
            for update in self._declared_updates(path)
        ]
        self._divisors: dict[Port, int] = {}
        self._statements: dict[int, list[str]] = defaultdict(list)
        self._num_operations = 0

    def code(self) -> DiagramCode:
        """Return the C code."""
        for port in self._outputs.values():
            self._require(port, self._output_divisor)
        for update in self._updates:
            for source in self._update_sources(update):
                self._require(source, update.divisor)
        for port in [*self._divisors]:
            self._rows(port)
        for name, port in self._outputs.items():
            layout = _signal_layout(name, len(self._rows(port)))
            target = f"outputs->{identifier(name)}"
            self._statements[self._output_divisor] += self._assignments(target, layout, self._rows(port))
        states = self._states()
        next_states = self._write_updates()
        header = self._header(states)
        return DiagramCode(
            header,
            self._source(states, next_states),
            self._period,
            self._output_divisor,
            {name: port.size for name, port in self._inputs.items()},
            {name: len(self._rows(port)) for name, port in self._outputs.items()},
            sum(layout.num_rows for _, layout, _ in states.values()),
            sum(layout.num_rows for _, layout, _ in self._parameters().values()),
            self._num_operations,
        )

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
        return _signal_layout(port.name, port.size)

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
        steps = round(period / self._period)
        if abs(period / self._period - steps) > ROUNDING:
            raise InputError(f"{label} cannot be exported: {period:g} s is not a multiple of {self._period:g} s")
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
        layout = _signal_layout(port.path.split(".")[-1], len(texts))
        self._num_operations += operations_per_row * len(texts)
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
        self._num_operations += function.num_operations
        return self._struct_rows(name, layout)

    def _arguments(self, port: Port, function: _Function) -> list[str]:
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

    # Functions of formulas

    def _function(self, path: str, label: str, computation: Computation) -> _Function:
        """Return the C function of a computation, which is shared with equal computations."""
        connected = {
            int(read.index): self._topology.source(Port(path, int(read.index))) is not None
            for read in computation.reads
            if isinstance(read, Input)
        }
        keys = []
        for read in computation.reads:
            if isinstance(read, Input | Parameter | StateGroup):
                absent = isinstance(read, Input) and not connected[int(read.index)]
                keys.append((type(read), read.name, None if absent else read.layout))
            else:
                keys.append((None, *hashable_key(read)))
        signature = computation.formula, *keys, *computation.results
        if signature not in self._by_signature:
            arguments, values, listing = [], [], Listing(calls_functions=True)
            for read, key in zip(computation.reads, keys, strict=True):
                if isinstance(read, Input) and key[-1] is None:
                    values.append(read.value_if_absent(self._leaves[path]))
                elif isinstance(read, Input | Parameter | StateGroup):
                    group = len(arguments)
                    arguments.append(_Argument(read, identifier(read.name), read.layout))
                    values.append(read.layout.build([listing.row(group, i) for i in range(read.layout.num_rows)]))
                elif read is TIME:
                    values.append(listing.shared(0))
                elif isinstance(read, TickOf):
                    raise InputError(f"{path} cannot be exported: it reads random numbers")
                else:
                    values.append(read)
            self._by_signature[signature] = self._write_function(label, computation, listing, values, arguments)
        found = self._by_signature[signature]
        # Equal computations of several systems read the ports, parameters and states of their own system.
        own = {(type(read), read.name): read for read in computation.reads if isinstance(read, Input | Parameter | StateGroup)}
        arguments = [
            argument if argument.read is None else argument._replace(read=own[type(argument.read), argument.read.name])
            for argument in found.arguments
        ]
        return found._replace(arguments=tuple(arguments))

    def _write_function(
        self,
        label: str,
        computation: Computation,
        listing: Listing,
        values: Sequence[Any],
        arguments: list[_Argument],
    ) -> _Function:
        """Append the C function of a computation to the source."""
        with collect_names(listing) as names:
            returned = trace_formula(computation.formula, values, computation.results)
        formula = computation.formula
        while isinstance(formula, functools.partial):
            formula = formula.func
        name = identifier(getattr(formula, "__name__", label).strip("_<>"))
        taken = {function.name for function in self._by_signature.values()}
        if name in ("lambda", "identity") or name in taken:
            name = f"compute_{label}"
        used = _used_groups(listing, returned)
        texts = {
            (group, row): (f"{argument.name}->{accessor[1:]}" if accessor else argument.name)
            for group, argument in enumerate(arguments)
            for row, accessor in enumerate(accessors(argument.layout))
        }
        present = [layout for layout in computation.results if layout is not ABSENT]
        targets = [f"next_{identifier(group.name)}" for group in computation.writes] or ["result"]
        body = Body(
            listing,
            returned,
            row=lambda group, row: texts[group, row],
            functions=self._functions,
            names=names,
            reserved=[*(argument.name for argument in arguments), *targets, "time"],
        )
        heads = [
            f"{self._precision.real} {argument.name}"
            if argument.layout is ROW
            else f"const {self._structs.type_of(argument.layout)} *{argument.name}"
            for group, argument in enumerate(arguments)
            if group in used
        ]
        kept = [argument for group, argument in enumerate(arguments) if group in used]
        if "time" in used:
            heads.append(f"{self._precision.real} time")
            kept.append(_Argument(None, "time", ROW))
        expressions = [result.text for result in body.results]
        if present == [ROW] and not computation.writes:
            lines = [*body.lines, f"return {expressions[0]};"]
            head = f"static {self._precision.real} {name}({', '.join(heads) or 'void'})"
        else:
            lines, first = [*body.lines], 0
            for target, layout in zip(targets, present, strict=True):
                heads.append(f"{self._structs.type_of(layout)} *{target}")
                stores = expressions[first : first + layout.num_rows]
                if layout is ROW:
                    lines.append(f"*{target} = {stores[0]};")
                else:
                    lines += [
                        f"{target}->{accessor[1:]} = {text};"
                        for accessor, text in zip(accessors(layout), stores, strict=True)
                    ]
                first += layout.num_rows
            head = f"static void {name}({', '.join(heads)})"
        comment = [f"/* {summary(formula)} */"] if summary(formula) else []
        self._formula_texts.append("\n".join([*(w for c in comment for w in wrapped(c)), function_text(head, lines)]))
        return _Function(name, tuple(kept), body.num_operations)

    # State, parameters and updates

    def _states(self) -> dict[str, tuple[str, Layout, np.ndarray]]:
        """Return path, layout and initial value of each state group, by the name of the struct member."""
        states: dict[str, tuple[str, Layout, np.ndarray]] = {}
        for path, system in self._leaves.items():
            context = system.GetMyContextFromRoot(self._context)
            if isinstance(system, ZeroOrderHold):
                value = context.get_discrete_state(0).value()
                states[_member(path, "value")] = path, rows_layout(len(value)), value
            for group in getattr(system, "states", {}).values():
                value = context.get_discrete_state(group.index).value()
                states[_member(path, group.name)] = path, group.layout, value
        return states

    def _parameters(self) -> dict[str, tuple[str, Layout, np.ndarray]]:
        """Return path, layout and value of each parameter, by the name of the struct member."""
        return {
            self._parameter_member(path, parameter): (
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
                statements += self._assignments(f"next_{members[0]}", layout, self._input_rows(path, 0), arrow=False)
            else:
                members = [_member(path, group.name) for group in update.computation.writes]
                function = self._function(path, f"{_system(path)}_update", update.computation)
                arguments = [*self._arguments(place, function), *(f"&next_{member}" for member in members)]
                statements.append(f"{function.name}({', '.join(arguments)});")
                self._num_operations += function.num_operations
            changed += members
        return changed

    def _assignments(self, target: str, layout: Layout, rows: Sequence[str], *, arrow: bool = False) -> list[str]:
        """Return the statements that assign rows to a struct; a whole struct is copied at once."""
        suffix = accessors(layout)[0]
        base = rows[0].removesuffix(suffix) if suffix else rows[0]
        if self._types.get(base) == layout and [*rows] == [base + accessor for accessor in accessors(layout)]:
            return [f"{target} = {base};"]
        return [f"{target}{accessor} = {row};" for accessor, row in zip(accessors(layout), rows, strict=True)]

    # Files

    def _header(self, states: dict[str, tuple[str, Layout, np.ndarray]]) -> str:
        """Return the text of the header without its opening comment."""
        name, structs = self._name, self._structs
        inputs = [structs.member(key, self._input_layouts[port]) for key, port in self._inputs.items()]
        outputs = [
            structs.member(key, _signal_layout(key, len(self._rows(port)))) for key, port in self._outputs.items()
        ]
        parameters = [
            structs.member(member, layout, f"{path}: {summary(type(self._leaves[path]))}")
            for member, (path, layout, _) in self._parameters().items()
        ]
        memory = [structs.member(member, layout, f"state of {path}") for member, (path, layout, _) in states.items()]
        memory.append("    uint32_t step;                         /* number of steps since the start */")
        guard = f"{name.upper()}_H"
        rate = f"every {self._period:g} s"
        sometimes = f", at every {self._output_divisor} steps" if self._output_divisor > 1 else ""
        blocks = [
            f"#ifndef {guard}\n#define {guard}\n",
            "#include <stdint.h>\n",
            f"/* Time between two steps, s. */\n#define {name.upper()}_PERIOD {self._period!r}\n",
            *structs.texts,
            struct_text(f"{name}_inputs_t", "Inputs of a step", inputs or ["    char unused;"]),
            struct_text(f"{name}_outputs_t", f"Outputs, which are written{sometimes or ' at every step'}", outputs),
            struct_text(
                f"{name}_parameters_t", "Parameters, which may change between steps", parameters or ["    char unused;"]
            ),
            struct_text(f"{name}_t", "State of the controller", memory),
            f"/* Parameters of the exported scenario. */\nextern const {name}_parameters_t {name}_default_parameters;\n",
            f"/* Set the initial state. */\nvoid {name}_init({name}_t *controller);\n",
            f"/* Compute the outputs and advance the state by one period. Call this function {rate}. */",
            "\n".join(
                wrapped(
                    f"void {name}_step({name}_t *controller, const {name}_parameters_t *parameters,"
                    f" const {name}_inputs_t *inputs, {name}_outputs_t *outputs);"
                )
            ),
            "\n#endif\n",
        ]
        return "\n".join(blocks)

    def _source(self, states: dict[str, tuple[str, Layout, np.ndarray]], changed: Sequence[str]) -> str:
        """Return the text of the source file without its opening comment."""
        name = self._name
        functions = "\n".join(self._functions.texts)
        multiplies_and_adds = "multiply_add(" in functions
        needs_words = multiplies_and_adds or "bits_of" in functions or "number_of" in functions
        needs_bool = any("bool " in text for text in [functions, *self._formula_texts])
        includes = [
            f'#include "{name}.h"\n',
            "#include <math.h>",
            *(["#include <stdbool.h>"] if needs_bool else []),
            *(["#include <string.h>"] if needs_words else []),
            "",
        ]
        blocks = [
            "\n".join(includes),
            *([WORD_FUNCTIONS] if needs_words else []),
            *([MULTIPLY_ADD_FUNCTION] if multiplies_and_adds else []),
            *self._functions.texts,
            *self._formula_texts,
            self._constant(f"const {name}_parameters_t {name}_default_parameters", self._parameters()),
            self._constant(f"static const {name}_t initial_state", states, last="0"),
            function_text(f"void {name}_init({name}_t *controller)", ["*controller = initial_state;"]),
            self._step_function(states, changed),
        ]
        return "\n".join(blocks)

    def _constant(self, head: str, members: dict[str, tuple[str, Layout, np.ndarray]], last: str = "") -> str:
        """Return the definition of a constant struct."""
        lines = [f"{head} = {{"]
        for member, (_, layout, values) in members.items():
            texts = [constant_text(value, self._precision) for value in values]
            lines += wrapped(f"    .{member} = {initializer(layout, texts)},")
        if last or not members:
            lines.append(f"    {last or '0'},")
        return "\n".join([*lines, "};", ""])

    def _step_function(self, states: dict[str, tuple[str, Layout, np.ndarray]], changed: Sequence[str]) -> str:
        name = self._name
        body = [line for statements in self._statements.values() for line in statements]
        lines: list[str] = []
        uses = {word for word in ("parameters", "inputs") if any(f"{word}->" in line for line in body)}
        lines += [f"(void){word};" for word in ("parameters", "inputs") if word not in uses]
        if any(line.rstrip(");").endswith("time") or "time," in line for line in body):
            real = self._precision.real
            period = constant_text(self._period, self._precision)
            lines.append(f"const {real} time = ({real})controller->step * {period};")
        for member in changed:
            lines.append(f"{self._structs.type_of(states[member][1])} next_{member} = controller->{member};")
        for divisor in sorted(self._statements):
            statements = self._statements[divisor]
            if divisor == 1:
                lines += statements
            elif statements:
                lines += [f"if (controller->step % {divisor} == 0) {{", *(f"    {each}" for each in statements), "}"]
        lines += [f"controller->{member} = next_{member};" for member in changed]
        lines.append("controller->step += 1;")
        head = (
            f"void {name}_step({name}_t *controller, const {name}_parameters_t *parameters,"
            f" const {name}_inputs_t *inputs, {name}_outputs_t *outputs)"
        )
        return function_text(head, lines)


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


def _signal_layout(name: str, num_rows: int) -> Layout:
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


def _used_groups(listing: Listing, results: Sequence[Any]) -> set[Any]:
    """Return the groups of rows on which results depend; "time" stands for the time."""
    operations = listing.operations
    required, stack, used = set[int](), [r.line for r in results if isinstance(r, Symbol)], set[Any]()
    while stack:
        line = stack.pop()
        if line in required:
            continue
        required.add(line)
        name, operands, *_ = operations[line]
        if name == "row":
            used.add(operands[0])
        elif name == "shared":
            used.add("time")
        elif name not in LEAVES:
            stack += operands
    return used
