"""All projects, and their files."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.export.projects.arduino import ARDUINO
from drake_quad.export.projects.crazyflie import CRAZYFLIE
from drake_quad.export.projects.project import ExportedCode, Project
from drake_quad.export.projects.px4 import PX4
from drake_quad.export.projects.python import PYTHON
from drake_quad.export.projects.ros2 import ROS2

PROJECTS: dict[str, Project] = {
    "arduino": ARDUINO,
    "crazyflie": CRAZYFLIE,
    "px4": PX4,
    "python": PYTHON,
    "ros2": ROS2,
}
"""Projects, by name."""
_TEMPLATES = Path(__file__).parent / "templates"


def project_files(name: str, code: ExportedCode) -> dict[str, str]:
    """Return the text of each file of a project, including the exported code, by path relative to the project folder.

    Args:
        name: name of the project, a key of `PROJECTS`.
        code: exported code.

    Raises:
        InputError: if there is no project with this name, or the exported code does not fit the project.
    """
    if name not in PROJECTS:
        raise InputError(f"project is {name!r}; it must be one of {', '.join(PROJECTS)}")
    project, description = PROJECTS[name], code.description
    values = {
        "NAME": description.name,
        "NAME_UPPER": description.name.upper(),
        "SCENARIO": description.scenario,
        "MEASUREMENT": code.measurement,
        "HAS_REFERENCE": str(int(code.has_reference)),
        **project.placeholders(code),
    }

    def filled(text: str) -> str:
        text = "".join(_selected_lines(text, values))
        # A value may itself contain placeholders, so they are replaced until none is left.
        while (after := re.sub("@([A-Z_0-9]+)@", lambda match: values[match[1]], text)) != text:
            text = after
        return text

    # Python templates end in .py.in, so that tools do not mistake them for modules.
    folder = _TEMPLATES / name
    files = {
        filled(path.relative_to(folder).as_posix().removesuffix(".in")): filled(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
    code_file = filled(f"{project.code_folder}/{description.name}").removeprefix("./")
    return {**files, f"{code_file}.h": code.header, f"{code_file}.c": code.source}


def _selected_lines(text: str, values: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a template that apply: blocks between `#if @KEY@` or `#if !@KEY@` and `#endif` are optional.

    Args:
        text: text of the template.
        values: values of the placeholders, by key. The value of a condition is 0 or 1.
    """
    blocks: list[bool | None] = []  # whether the lines of each open block apply; None for a block of the C preprocessor
    for line in text.splitlines(keepends=True):
        condition = re.fullmatch(r"#if (!?)@(\w+)@\n", line)
        if condition:
            negated, key = condition.groups()
            blocks.append((values[key] == "1") != bool(negated))
            continue
        if line.startswith("#if"):
            blocks.append(None)
        elif line.startswith("#else") and blocks[-1] is not None:
            blocks[-1] = not blocks[-1]
            continue
        elif line.startswith("#endif") and blocks.pop() is not None:
            continue
        if False not in blocks:
            yield line
