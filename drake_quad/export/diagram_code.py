"""C code of a diagram, such as a controller: a header with its structs, and a source file with its functions."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pydrake.systems.framework import Diagram

from drake_quad.export.step import Member, StepCode
from drake_quad.export.structs import Struct, StructMember, Structs, initializer, summary
from drake_quad.exported.description import CodeInterface
from drake_quad.framework.c_code import (
    MULTIPLY_ADD_FUNCTION,
    WORD_FUNCTIONS,
    Functions,
    Precision,
    constant_text,
    function_text,
    wrapped,
)
from drake_quad.framework.wiring import subsystem

HEADER_END = "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
"""Last lines of a header, after all declarations."""
# C does not allow structs without members.
_NO_MEMBERS = (StructMember("char", "unused"),)


class DiagramCode(NamedTuple):
    """C code of a diagram.

    Attributes:
        header: text of the header, without its opening comment.
        source: text of the source file, without its opening comment.
        interface: interface and size of the code.
        structs: definitions of the structs in the header.
    """

    header: str
    source: str
    interface: CodeInterface
    structs: Sequence[Struct]


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
        InputError: if a system of the diagram is not declared by formulas, or if the periods do not match.
    """
    structs, functions = Structs(name, precision.real), Functions(precision)
    step = StepCode(diagram, outputs, output_period, structs, functions)
    interface = CodeInterface(
        period=step.period,
        output_divisor=step.output_divisor,
        inputs={key: layout.num_rows for key, layout in step.inputs.items()},
        outputs={key: layout.num_rows for key, layout in step.outputs.items()},
        num_states=sum(member.layout.num_rows for member in step.states.values()),
        num_parameters=sum(member.layout.num_rows for member in step.parameters.values()),
        num_operations=step.num_operations,
    )
    definitions = _structs(name, step, structs, diagram)
    return DiagramCode(_header(name, step, definitions), _source(name, step, functions), interface, definitions)


def _step_head(name: str) -> str:
    return (
        f"void {name}_step({name}_t *controller, const {name}_parameters_t *parameters,"
        f" const {name}_inputs_t *inputs, {name}_outputs_t *outputs)"
    )


def _structs(name: str, step: StepCode, structs: Structs, diagram: Diagram) -> list[Struct]:
    """Return the C definitions of all structs of the exported code."""
    inputs = [structs.member(key, layout) for key, layout in step.inputs.items()]
    outputs = [structs.member(key, layout) for key, layout in step.outputs.items()]
    parameters = [structs.member(key, each.layout, _origin(each, diagram)) for key, each in step.parameters.items()]
    memory = [structs.member(key, each.layout, f"state of {each.path}") for key, each in step.states.items()]
    memory.append(StructMember("uint32_t", "step", "number of steps since the start"))
    divisor = step.output_divisor
    return [
        *structs.definitions,
        Struct(f"{name}_inputs_t", "Inputs of a step", inputs or _NO_MEMBERS),
        Struct(
            f"{name}_outputs_t",
            f"Outputs, which are written at every {f'{divisor} steps' if divisor > 1 else 'step'}",
            outputs,
        ),
        Struct(f"{name}_parameters_t", "Parameters, which may change between steps", parameters or _NO_MEMBERS),
        Struct(f"{name}_t", "State of the controller", memory),
    ]


def _header(name: str, step: StepCode, structs: Sequence[Struct]) -> str:
    """Return the text of the C header."""
    guard = f"{name.upper()}_H"
    head = "\n".join(wrapped(f"{_step_head(name)};"))
    blocks = [
        f"#ifndef {guard}\n#define {guard}\n",
        "#include <stdint.h>\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        f"/* Time between two steps, s. */\n#define {name.upper()}_PERIOD {step.period!r}\n",
        *map(str, structs),
        f"/* Parameters of the exported scenario. */\nextern const {name}_parameters_t {name}_default_parameters;\n",
        f"/* Set the initial state. */\nvoid {name}_init({name}_t *controller);\n",
        "/* Compute the outputs and advance the state by one period. Call this function every"
        f" {step.period:g} s. */\n{head}\n",
        HEADER_END,
    ]
    return "\n".join(blocks)


def _origin(member: Member, diagram: Diagram) -> str:
    """Return a comment on a parameter: the path and the description of its system."""
    return f"{member.path}: {summary(type(subsystem(diagram, member.path.split('.'))))}"


def _source(name: str, step: StepCode, functions: Functions) -> str:
    """Return the text of the C source file."""
    texts = [*functions.texts, *step.formulas.texts]
    multiplies_and_adds = any("multiply_add(" in text for text in texts)
    needs_words = multiplies_and_adds or any("float_bits(" in text or "number_of(" in text for text in texts)
    needs_bool = any("bool " in text for text in texts)
    includes = [
        f'#include "{name}.h"\n',
        "#include <math.h>",
        *(["#include <stdbool.h>"] if needs_bool else []),
        *(["#include <string.h>"] if needs_words else []),
        "",
    ]
    precision = functions.precision
    blocks = [
        "\n".join(includes),
        *([WORD_FUNCTIONS] if needs_words else []),
        *([MULTIPLY_ADD_FUNCTION] if multiplies_and_adds else []),
        *texts,
        _constant(f"const {name}_parameters_t {name}_default_parameters", step.parameters, precision),
        _constant(f"static const {name}_t initial_state", step.states, precision),
        function_text(f"void {name}_init({name}_t *controller)", ["*controller = initial_state;"]),
        function_text(_step_head(name), step.lines()),
    ]
    return "\n".join(blocks)


def _constant(head: str, members: Mapping[str, Member], precision: Precision) -> str:
    """Return the definition of a constant struct, whose other members are zero."""
    lines = [f"{head} = {{"]
    for name, (_, layout, values) in members.items():
        texts = [constant_text(value, precision) for value in values]
        lines += wrapped(f"    .{name} = {initializer(layout, texts)},")
    return "\n".join([*lines, *([] if members else ["    0,"]), "};", ""])
