"""Block drawings of Drake diagrams: one for the diagram and one for each diagram inside it."""

import hashlib
import re
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

from pydrake.systems.framework import Diagram

from drake_quad.errors import InputError, shortened


def drawings(diagram: Diagram) -> dict[str, str]:
    """Draw a diagram, and each diagram of several systems inside it, in Graphviz's language.

    The same diagram always gives the same text.

    Returns:
        The drawings by the path of what they show; that of the whole diagram is "".
    """
    return {path: _drawing(inner) for path, inner in _diagrams_in(diagram, "")}


def digest(drawing: str) -> str:
    """The hash of a drawing, which its SVG names, so that one can see whether they belong together."""
    return hashlib.sha256(drawing.encode()).hexdigest()


def svg(drawing: str) -> str:
    """Render a drawing as SVG, with the drawing's digest in a comment.

    Raises:
        InputError: Graphviz is not installed.
        RuntimeError: Graphviz fails to render the drawing.
    """
    if shutil.which("dot") is None:
        raise InputError(
            "drawings are made by Graphviz, whose command dot is not on PATH; Debian's package is graphviz"
        )
    run = subprocess.run(["dot", "-Tsvg"], input=drawing, capture_output=True, encoding="utf-8")
    if run.returncode:
        raise RuntimeError(f"Graphviz's dot ended with status {run.returncode}: {shortened(run.stderr.strip(), 200)}")
    made = run.stdout
    return made[made.index("<svg") :].rstrip() + f"\n<!-- {digest(drawing)} -->\n"


def _diagrams_in(system: Any, path: str) -> Iterator[tuple[str, Diagram]]:
    """Yield a diagram and the diagrams of several systems inside it, each after its path."""
    yield path, system
    for inner in system.GetSystems():
        if isinstance(inner, Diagram) and len(inner.GetSystems()) > 1:
            yield from _diagrams_in(inner, f"{path}/{inner.get_name()}".lstrip("/"))


def _drawing(diagram: Diagram) -> str:
    """Return Drake's drawing with connections in order and numbers of systems that do not depend on the process."""
    numbers: dict[str, int] = {}
    text = re.sub(
        r"\b(_|clusters?|s)(\d+)(?=\b|diagram|subsystems|in|out)",
        lambda found: f"{found[1]}{numbers.setdefault(found[2], len(numbers))}",
        diagram.GetGraphvizString(max_depth=1),
    )
    lines = text.rstrip().removesuffix("}").splitlines()
    return "\n".join(sorted(lines, key=lambda line: (0, "") if " -> " not in line else (1, line))) + "\n}\n"
