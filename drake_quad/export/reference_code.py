"""C code that evaluates the reference of a plan."""

from collections.abc import Sequence

import numpy as np

from drake_quad.framework.c_code import Precision, constant_text, function_text, identifier, wrapped
from drake_quad.reference.plan import REFERENCE_PORTS, Plan
from drake_quad.reference.polynomial_path import subdivide

# Component names of each reference port. For each order of the derivative, a tuple contains the names of the X, Y, Z
# and yaw components. An empty name means that the port does not have the component.
_COMPONENT_NAMES: dict[str, list[tuple[str, ...]]] = {
    "reference": [("x", "y", "z", "yaw"), ("v_x", "v_y", "v_z", "yaw_rate"), ("a_x", "a_y", "a_z", "")],
    "reference_jerk": [(), (), (), ("x", "y", "z", "")],
    "reference_snap": [(), (), ("", "", "", "yaw"), (), ("x", "y", "z", "")],
}


def reference_code(plan: Plan, *, name: str, inputs: Sequence[str], precision: Precision) -> tuple[str, str]:
    """Return the declaration and the definition of a C function that evaluates a reference by Horner's rule.

    The results agree with Drake's PiecewisePolynomial to within rounding errors.

    Args:
        plan: plan that the vehicle follows.
        name: prefix of the names in C.
        inputs: names of the inputs of the controller. The C function sets those that describe the reference.
        precision: floating-point format.
    """
    path, yaw = plan.extended_path, plan.extended_yaw
    end = max(path.times[-1], yaw.times[-1])
    path, yaw = (part._replace(times=np.append(part.times[:-1], end)) for part in (path, yaw))
    path, yaw = subdivide(path, yaw.times), subdivide(yaw, path.times)
    powers = max(path.coefficients.shape[1], yaw.coefficients.shape[1])
    coefficients = np.zeros((len(path.times) - 1, 4, powers))
    coefficients[:, :3, : path.coefficients.shape[1]] = path.coefficients.transpose(0, 2, 1)
    coefficients[:, 3:, : yaw.coefficients.shape[1]] = yaw.coefficients.transpose(0, 2, 1)
    durations = np.diff(path.times)
    coefficients *= durations[:, np.newaxis, np.newaxis] ** -np.arange(powers)
    real = precision.real
    times = ", ".join(constant_text(time, precision) for time in path.times[:-1])
    rows = [
        line
        for segment in coefficients
        for line in (
            "    {",
            *(
                each
                for axis in segment
                for each in wrapped(f"        {{{', '.join(constant_text(value, precision) for value in axis)}}},")
            ),
            "    },",
        )
    ]
    head = f"void {name}_reference({real} time, {name}_inputs_t *inputs)"
    orders = max(len(groups) for port, groups in _COMPONENT_NAMES.items() if port in inputs)
    assignments = [
        f"inputs->{identifier(port)}.{row} = derivatives[{axis}][{order}];"
        for port, groups in _COMPONENT_NAMES.items()
        if port in inputs and port in REFERENCE_PORTS
        for order, group in enumerate(groups)
        for axis, row in enumerate(group)
        if row
    ]
    body = [
        "int segment = 0;",
        f"while (segment < {len(durations) - 1} && time >= reference_times[segment + 1])",
        "    segment += 1;",
        f"const {real} t = time - reference_times[segment];",
        f"{real} derivatives[4][{orders}];",
        "for (int axis = 0; axis < 4; ++axis)",
        f"    for (int order = 0; order < {orders}; ++order) {{",
        f"        {real} sum = {constant_text(0.0, precision)};",
        f"        for (int power = {powers - 1}; power >= order; --power) {{",
        f"            {real} factor = reference_coefficients[segment][axis][power];",
        "            for (int i = 0; i < order; ++i)",
        f"                factor *= ({real})(power - i);",
        "            sum = sum * t + factor;",
        "        }",
        "        derivatives[axis][order] = sum;",
        "    }",
        *assignments,
    ]
    definition = "\n".join(
        [
            "/* Times at which the segments of the reference begin, s. */",
            *wrapped(f"static const {real} reference_times[{len(durations)}] = {{{times}}};"),
            "",
            "/* Coefficients of X, Y, Z (m) and yaw (rad) in each segment, by power of the time in it (s). */",
            f"static const {real} reference_coefficients[{len(durations)}][4][{powers}] = {{",
            *rows,
            "};",
            "",
            function_text(head, body),
        ]
    )
    declaration = (
        "/* Set the inputs that describe the reference at a time, s. The route begins at time 0; after its end the"
        f" reference\n   rests. */\n{head};\n"
    )
    return declaration, definition
