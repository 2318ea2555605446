"""Docstrings and comments of the package are sentences or noun phrases with a subject."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "drake_quad"
# A first line that begins so has no subject, or is a riddle.
FIRST_LINE = re.compile(r"(Of|What|Who|The same|How|Why|Where|Whether|By|As)\b|.*\?$")
COMMENT = re.compile(r"# (Of|What|Whether|And|Nor|By which|Over which|To which|From which) ")
ARGUMENT = re.compile(r"(of|that|to|by|which|what|how|likewise)\b")


def texts_of(path: Path) -> list[tuple[str, str, int]]:
    """Return kind, text and line of docstrings' first lines, of described arguments, and of comments."""
    source = path.read_text(encoding="utf-8")
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text, line = ast.get_docstring(node) or "", getattr(node, "lineno", 1)
            found.append(("first line", text.partition("\n")[0], line))
            found += [("argument", described, line) for described in re.findall(r"^    \w+: (.*)$", text, re.MULTILINE)]
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            found.append(("comment", token.string, token.start[0]))
    return found


def is_riddle(kind: str, text: str) -> bool:
    pattern = {"first line": FIRST_LINE, "argument": ARGUMENT, "comment": COMMENT}[kind]
    return pattern.match(text) is not None


@pytest.mark.slow
def test_texts_have_a_subject():
    texts = [(path, *text) for path in sorted(PACKAGE.rglob("*.py")) for text in texts_of(path)]
    assert len(texts) > 5000
    riddles = [
        f"{path.relative_to(PACKAGE)}:{line}: {text}" for path, kind, text, line in texts if is_riddle(kind, text)
    ]
    assert riddles == []


@pytest.mark.parametrize(
    ("kind", "text", "riddle"),
    [
        ("first line", "What the thrust of the frame before has acted since.", True),
        ("first line", "Where a path can go no faster.", True),
        ("first line", "Is the error smaller?", True),
        ("first line", "Return the largest roll error in degrees.", False),
        ("comment", "# Of units, for the eye: factor and how it is written.", True),
        ("comment", "# In NumPy's C interface, the pointer follows the header.", False),
        ("argument", "of the groups.", True),
        ("argument", "that is flown.", True),
        ("argument", "sizes of the groups, samples.", False),
    ],
)
def test_the_check_knows_riddles_from_sentences(kind: str, text: str, riddle: bool):
    assert is_riddle(kind, text) == riddle
