"""Tests of the changes that mutants make."""

import ast
import re
from pathlib import Path

import pytest
from mutation import COUNTERPARTS, mutants_of
from ruamel.yaml import YAML


def changes(line, before=""):
    """Return the changed lines of all mutants of one line."""
    text = f"{before}{line}\n"
    mutants = [mutant for mutant in mutants_of(text) if mutant.line == text.count("\n")]
    assert all(mutant.before == line.strip() for mutant in mutants)
    return {mutant.after for mutant in mutants}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("r = a - b", {"r = a + b", "r = a", "r = b"}),
        ("r = (a + b) * c", {"r = (a - b) * c", "r = (a) * c", "r = (b) * c", "r = (a + b) / c", "r = a + b", "r = c"}),
        ("r = minimum(a, 2.0)", {"r = maximum(a, 2.0)", "r = a", "r = 2.0", "r = minimum(a, 3.0)"}),
        ("s, c = sin_cos(x)", {"(c, s) = sin_cos(x)"}),
        ("a, b = next(x), next(x)", {"(b, a) = next(x), next(x)"}),
        ("c = cos(x)", {"c = sin(x)"}),
        ("x[1] += y", {"x[1] -= y", "x[2] += y", "pass"}),
        ("x = -y", {"x = y"}),
        ("x = table[:, first:last]", {"x = table[first:last, :]"}),
        ("a = x < limit", {"a = x >= limit"}),
        ("a = len(x) < limit", {"a = len(x) >= limit", "a = len(x) <= limit"}),
        ("a = x if flag else y", {"a = x if (not flag) else y", "a = x", "a = y"}),
        ("f(a, b, k=c, l=d)", {"f(b, a, k=c, l=d)", "f(a, b, k=d, l=c)", "pass"}),
        ("raise InputError(f'{1 + x} is too much', 3)", {"pass"}),
        ("SIZE = 10", {"SIZE = 11"}),
        ("x = zip(a, b, strict=True)", {"x = zip(b, a, strict=True)"}),
        (
            "x = solve(a, b, lower=True, check_finite=False)",
            {
                "x = solve(b, a, lower=True, check_finite=False)",
                "x = solve(a, b, lower=False, check_finite=False)",
            },
        ),
        (
            "x = np.linspace(0.0, 1.0, 49)",
            {
                "x = np.linspace(1.0, 0.0, 49)",
                "x = np.linspace(0.0, 49, 1.0)",
                "x = np.linspace(1.0, 1.0, 49)",
                "x = np.linspace(0.0, 2.0, 49)",
            },
        ),
        ("x = y.reshape(3, -1)", {"x = y.reshape(4, -1)", "x = y.reshape(3, 1)"}),
        ("x = y[-1]", {"x = y[1]", "x = y[-2]"}),
        ("flag: bool = True", {"flag: bool = False"}),
        ("axes.plot(x, y, linewidth=2.0 * size, color=a)", {"axes.plot(y, x, linewidth=2.0 * size, color=a)", "pass"}),
        ("style = {'linewidth': 2.0, 'count': 3}", {"style = {'linewidth': 2.0, 'count': 4}"}),
        ("a = axes.annotate(text, place, (-6, 4))", {"a = axes.annotate(place, text, (-6, 4))"}),
    ],
)
def test_mutants_of_a_line_are_the_expected_ones(line, expected):
    assert changes(line) == expected


@pytest.mark.parametrize(
    "line",
    [
        "from x import y",
        "__all__ = ['a', 'b']",
        "Step = Callable[[Row, Rows], tuple[Row, Row]]",
        "'a text'",
        "_ROUNDS = 10",
        "names, rows = [], []",
        "names, rows = {}, {}",
        "total = plus(force, drag)",
        "x = y.swapaxes(a, b)",
        "same = np.array_equal(x, y)",
        "a, b = np.empty_like(x), np.empty_like(x)",
        "axes.grid(visible=False)",
        "figure = new_figure(9.0, 2.6 + size)",
    ],
)
def test_lines_whose_changes_no_test_can_detect_have_no_mutants(line):
    assert changes(line) == set()


def test_a_mutant_of_a_default_value_concerns_all_lines_of_its_function():
    text = "LIMIT = 3\n\n\ndef f(x, y=2):\n    if x:\n        return y\n    return x\n"
    mutants = {mutant.after: (mutant.lines, mutant.declared) for mutant in mutants_of(text)}
    assert mutants["LIMIT = 4"] == (range(1, 2), True)
    assert mutants["def f(x, y=3):"] == (range(4, 8), False)
    assert mutants["if not x:"] == (range(5, 6), False)


def test_a_mutant_changes_one_line_and_is_valid_python():
    text = (
        "@cached(1)\ndef f(x: Annotated[int, 2], y=3):\n    'Doc.'  # ω\n    while x:\n        x = (x - 'ä'.find(y))\n"
    )
    mutants = mutants_of(text)
    assert {(mutant.line, mutant.declared) for mutant in mutants} == {(2, False), (4, False), (5, False)}
    for mutant in mutants:
        ast.parse(mutant.applied(text))
        changed = [line for line, old in zip(mutant.applied(text).splitlines(), text.splitlines()) if line != old]
        assert [" ".join(line.split()) for line in changed] == [mutant.after]
        assert mutant.line in mutant.lines


def test_listed_mutants_are_changes_of_lines_that_exist(root):
    listed = YAML(typ="safe").load(Path(__file__).with_name("survivors.yaml"))
    texts = {file: (root / file).read_text() for file in {entry["file"] for entry in listed}}
    lines = {file: " ".join(text.split()) for file, text in texts.items()}
    words = {file: {*re.findall(r"\w+", text)} for file, text in texts.items()}
    new_words = {"pass", "not", "True", "False", *COUNTERPARTS}
    for entry in listed:
        file, before = entry["file"], entry["before"]
        assert before in lines[file], f"{file}: {before}"
        for after in entry["after"]:
            unknown = {*re.findall(r"\b[A-Za-z_]\w*", after)} - words[file] - new_words
            assert not unknown, f"{file}: {after}: {unknown}"
