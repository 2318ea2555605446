"""Block diagrams of Drake systems, drawn by Graphviz: one for a diagram and one for each diagram inside it."""

import hashlib
import re
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

from pydrake.systems.framework import Diagram, InputPortIndex, OutputPortIndex
from pydrake.systems.primitives import Demultiplexer

from drake_quad.errors import InputError, shorten_text
from drake_quad.visualization.style import BLUE

_GRAPH_STYLE = """    rankdir=LR; nodesep=0.35; ranksep=0.55; fontname="Helvetica";
    node [shape=box, style="rounded,filled", fillcolor="#EEF4FA", fontname="Helvetica", fontsize=13];
    edge [fontname="Helvetica", fontsize=10, color="#555555", fontcolor="#333333", arrowsize=0.7];"""


def drawings(diagram: Diagram) -> dict[str, str]:
    """Describe a diagram, and each diagram inside it, in Graphviz's language. Equal diagrams have equal texts.

    Returns:
        The text of each drawing, by the path of the diagram; the path of the whole diagram is "".
    """
    drawing_by_path = {"": _drawing(diagram, diagram.get_name())}
    for path, inner in _inner_diagrams(diagram, ""):
        drawing_by_path[path] = _drawing(inner, path.replace("/", " / "))
    return drawing_by_path


def digest(drawing: str) -> str:
    """Return the hash of a drawing's text. The SVG contains it, so that a test can check whether the SVG is current."""
    return hashlib.sha256(drawing.encode()).hexdigest()


def svg(drawing: str) -> str:
    """Render a drawing as SVG with Graphviz, and append the drawing's digest as a comment.

    Raises:
        InputError: if Graphviz is not installed.
        RuntimeError: if Graphviz fails to render the drawing.
    """
    if shutil.which("dot") is None:
        raise InputError(
            "Graphviz draws the diagrams, but its command dot is not on PATH; install Graphviz (Debian's package is"
            " called graphviz)"
        )
    process = subprocess.run(["dot", "-Tsvg"], input=drawing, capture_output=True, encoding="utf-8")
    if process.returncode:
        raise RuntimeError(
            f"Graphviz's dot ended with status {process.returncode}: {shorten_text(process.stderr.strip(), 200)}"
        )
    output = process.stdout
    return output[output.index("<svg") :].rstrip() + f"\n<!-- {digest(drawing)} -->\n"


def _inner_diagrams(diagram: Diagram, path: str) -> Iterator[tuple[str, Diagram]]:
    """Yield each diagram inside a diagram, with its path. Diagrams that contain a single system are left out."""
    for system in diagram.GetSystems():
        if isinstance(system, Diagram) and not _is_trivial(system):
            inner = f"{path}/{system.get_name()}".lstrip("/")
            yield inner, system
            yield from _inner_diagrams(system, inner)


def _is_trivial(diagram: Diagram) -> bool:
    return len(diagram.GetSystems()) < 2


def _drawing(diagram: Diagram, title: str) -> str:
    systems = list(diagram.GetSystems())
    numbers = {system: i for i, system in enumerate(systems)}
    lines = [f"digraph {{\n{_GRAPH_STYLE}", f'    label="{title}"; labelloc=t; fontsize=15;']
    for system, i in numbers.items():
        lines.append(f"    s{i} [{_node(system)}];")
    edges: dict[tuple[str, str], list[str]] = {}
    for (target, port), (source, output) in diagram.connection_map().items():
        name = _signal(source.get_output_port(output), target.get_input_port(port))
        edges.setdefault((f"s{numbers[source]}", f"s{numbers[target]}"), []).append(name)
    for index in range(diagram.num_input_ports()):
        port = diagram.get_input_port(index)
        lines.append(f'    i{index} [label="{port.get_name()}", {_PORT_STYLE}];')
        for system, port_of_system in diagram.GetInputPortLocators(InputPortIndex(index)):
            size = system.get_input_port(port_of_system).size()
            edges.setdefault((f"i{index}", f"s{numbers[system]}"), []).append(f"({size})")
    exported: dict[int, list[str]] = {}
    for index in range(diagram.num_output_ports()):
        system, _ = diagram.get_output_port_locator(OutputPortIndex(index))
        exported.setdefault(numbers[system], []).append(diagram.get_output_port(index).get_name())
    for i, names in exported.items():
        lines.append(f'    o{i} [label="{_column(names)}", {_PORT_STYLE}];')
        edges[f"s{i}", f"o{i}"] = [""]
    for (start, end), names in sorted(edges.items(), key=lambda edge: (_sort_key(edge[0][0]), _sort_key(edge[0][1]))):
        lines.append(f'    {start} -> {end} [label="{_column(sorted(names))}"];')
    return "\n".join([*lines, "}"]) + "\n"


# Graphviz expects a line break in a label as these two characters.
_NEW_LINE = "\\n"
_PORT_STYLE = f'shape=plaintext, style="", fontcolor="{BLUE}", fontsize=11'


def _node(system: Any) -> str:
    if isinstance(system, Demultiplexer):
        return 'label="", shape=box, style=filled, fillcolor="#444444", width=0.06, fixedsize=true, height=0.7'
    name, kind = system.get_name(), type(system).__name__.rstrip("_").partition("[")[0]
    outline = ', peripheries=2, fillcolor="#DCE9F5"' if isinstance(system, Diagram) and not _is_trivial(system) else ""
    has_own_kind = kind != "Diagram" and kind.lower() != name.replace("_", "")
    return f'label="{name}{f"{_NEW_LINE}{kind}" if has_own_kind else ""}"{outline}'


def _signal(output: Any, port: Any) -> str:
    """Return the label of a connection: the name of either port, if it has one, and the size of the signal."""
    names = [each.get_name() for each in (output, port)]
    given_names = [name for name in names if not re.fullmatch(r"[uy]\d+", name)]
    return f"{given_names[0]} ({port.size()})" if given_names else f"({port.size()})"


def _column(names: list[str]) -> str:
    return _NEW_LINE.join(names)


def _sort_key(name: str) -> tuple[str, int]:
    return name[0], int(name[1:])
