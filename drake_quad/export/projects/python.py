"""Shared library with a Python module that calls it through `ctypes`, without drake_quad."""

from collections.abc import Sequence

from drake_quad.export.projects.project import ExportedCode, Project
from drake_quad.export.structs import Struct, StructMember

# ctypes type of each C type.
_CTYPES = {
    "char": "ctypes.c_char",
    "uint32_t": "ctypes.c_uint32",
    "float": "ctypes.c_float",
    "double": "ctypes.c_double",
}

# Text of the method that the controller class has if the reference is exported.
_SET_REFERENCE_METHOD = '''
    def set_reference(self, time: float, inputs: Inputs) -> None:
        """Set the inputs that describe the planned reference at a time (s) since the start of the route."""
        _LIBRARY.@NAME@_reference(_NUMBER(time), ctypes.byref(inputs))
'''


def _placeholders(code: ExportedCode) -> dict[str, str]:
    """Return the values of the placeholders in the project's template."""
    return {
        "PERIOD": repr(code.description.period),
        "STRUCTS": "\n\n\n".join(_class_text(struct, code.description.name) for struct in code.structs),
        "SET_REFERENCE": _SET_REFERENCE_METHOD if code.has_reference else "",
        "NUMBER": _CTYPES[code.number_type],
    }


def _class_name(type_name: str, prefix: str) -> str:
    """Return the name of the class for a C struct; the struct `NAME_t` itself is the state of the controller."""
    words = type_name.removeprefix(prefix).removesuffix("_t").strip("_") or "controller_state"
    return "".join(word.capitalize() for word in words.split("_"))


def _class_text(struct: Struct, prefix: str) -> str:
    """Return the definition of the class for a C struct."""
    lines = [f"class {_class_name(struct.type_name, prefix)}(ctypes.Structure):"]
    lines += [f'    """{struct.comment.rstrip(".")}."""', "", "    _fields_ = ["]
    lines += _member_lines(struct.members, prefix)
    return "\n".join([*lines, "    ]"])


def _member_lines(members: Sequence[StructMember], prefix: str) -> list[str]:
    lines = []
    for member in members:
        kind = _CTYPES.get(member.type_name) or _class_name(member.type_name, prefix)
        for size in reversed(member.sizes):
            kind = f"{kind} * {size}"
        comment = f"  # {member.comment}" if member.comment else ""
        lines.append(f'        ("{member.name}", {kind}),{comment}')
    return lines


PYTHON = Project(_placeholders)
