"""Tests that code accesses the components of signals and records by name, not by number."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from drake_quad.signals import SIGNALS

# Folders and files of drake_quad with formulas and metrics, in which integer indices are not allowed.
FORMULA_PATHS = ("geometry", "vehicle", "control", "laboratory", "signals.py")


def files(root: Path, *paths: str) -> list[Path]:
    folders = [root / "drake_quad" / path for path in paths]
    return [file for folder in folders for file in ([folder] if folder.is_file() else sorted(folder.rglob("*.py")))]


def integer_indices(tree: ast.AST) -> Iterator[ast.Subscript]:
    """Yield the subscript expressions that contain an integer, as an index or in a slice."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript):
            numbers = (part.value for part in ast.walk(node.slice) if isinstance(part, ast.Constant))
            if any(isinstance(number, int) and not isinstance(number, bool) for number in numbers):
                yield node


def is_signal(node: ast.AST) -> bool:
    """Return whether an expression reads a signal of a flight, its record or metrics, as in `flight["state"]`."""
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant):
        return node.slice.value in SIGNALS
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr in ("record", "get_state", "get_parameter")
    return isinstance(node, ast.Attribute) and node.attr in ("metrics", *SIGNALS)


def test_formulas_and_metrics_access_components_by_name(root):
    violations = [
        f"{file}:{node.lineno}: {ast.unparse(node)}"
        for file in files(root, *FORMULA_PATHS)
        for node in integer_indices(ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert violations == []


def numbered_states(tree: ast.AST) -> Iterator[ast.Subscript]:
    """Yield the subscript expressions that access components of a state by number, such as `state[3]`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
            first = node.slice.elts[0] if isinstance(node.slice, ast.Tuple) else node.slice
            ends = (first.lower, first.upper) if isinstance(first, ast.Slice) else (first,)
            numbered = any(isinstance(end, ast.Constant) and isinstance(end.value, int) for end in ends)
            if numbered and node.value.id in ("state", "states", "seen", "measured", "body"):
                yield node


def test_identification_accesses_components_of_states_by_name(root):
    violations = [
        f"{file}:{node.lineno}: {ast.unparse(node)}"
        for file in files(root, "identification")
        for tree in [ast.parse(file.read_text(encoding="utf-8"))]
        for node in [*numbered_states(tree), *(each for each in integer_indices(tree) if is_signal(each.value))]
        if not ast.unparse(node).endswith(("[:, ::-1]", "[::-1]", "attitude[:, 2]", "attitude[:, 1]"))
    ]
    assert violations == []


@pytest.mark.parametrize(
    ("text", "counts"), [("state[5:2:-1]", 1), ("state[3, w]", 1), ("state[:, 1:]", 0), ("state[row : row + 3]", 0)]
)
def test_the_check_finds_access_by_number_to_components_of_states(text, counts):
    assert len([*numbered_states(ast.parse(text))]) == counts


@pytest.mark.long
def test_code_that_reads_flights_accesses_components_by_name(root):
    violations = [
        f"{file}:{node.lineno}: {ast.unparse(node)}"
        for file in [*files(root, "."), *sorted((root / "scripts").rglob("*.py"))]
        for node in integer_indices(ast.parse(file.read_text(encoding="utf-8")))
        if is_signal(node.value)
    ]
    assert violations == []


@pytest.mark.parametrize(
    ("text", "counts"),
    [
        ("reference[10]", 1),
        ("state[3:6]", 1),
        ("law[2, c]", 1),
        ("rows[-1]", 1),
        ("rows[i]", 0),
        ("flight['state']", 0),
        ("tuple[Row, ...]", 0),
    ],
)
def test_the_check_finds_integer_indices(text, counts):
    assert len([*integer_indices(ast.parse(text))]) == counts


@pytest.mark.parametrize("text", ["flight['state'][:, 0:3]", "flight.record('state')[2]", "study.metrics[0]"])
def test_the_check_finds_access_by_number_to_components_of_signals_and_metrics(text):
    (node,) = integer_indices(ast.parse(text))
    assert is_signal(node.value)
