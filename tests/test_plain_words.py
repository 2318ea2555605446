"""Tests that docstrings and comments of the package are sentences or noun phrases with a subject."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "drake_quad"
# Patterns that match texts without a grammatical subject: first lines of docstrings, comments, and descriptions of
# arguments in docstrings.
FIRST_LINE_WITHOUT_SUBJECT = re.compile(r"(Of|What|Who|The same|How|Why|Where|Whether|By|As)\b|.*\?$")
COMMENT_WITHOUT_SUBJECT = re.compile(r"# (Of|What|Whether|And|Nor|By which|Over which|To which|From which) ")
ARGUMENT_DESCRIPTION_WITHOUT_SUBJECT = re.compile(r"(of|that|to|by|which|what|how|likewise)\b")


def texts_of(path: Path) -> list[tuple[str, str, int]]:
    """Return type, text and line number of each docstring's first line, each argument description and each comment."""
    source = path.read_text(encoding="utf-8")
    texts = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text, line = ast.get_docstring(node) or "", getattr(node, "lineno", 1)
            texts.append(("first line", text.partition("\n")[0], line))
            texts += [("argument", described, line) for described in re.findall(r"^    \w+: (.*)$", text, re.MULTILINE)]
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            texts.append(("comment", token.string, token.start[0]))
    return texts


def lacks_subject(kind: str, text: str) -> bool:
    patterns = {
        "first line": FIRST_LINE_WITHOUT_SUBJECT,
        "argument": ARGUMENT_DESCRIPTION_WITHOUT_SUBJECT,
        "comment": COMMENT_WITHOUT_SUBJECT,
    }
    return patterns[kind].match(text) is not None


@pytest.mark.long
def test_docstrings_and_comments_of_the_package_have_a_subject():
    texts = [(path, *text) for path in sorted(PACKAGE.rglob("*.py")) for text in texts_of(path)]
    assert len(texts) > 5000
    unclear = [
        f"{path.relative_to(PACKAGE)}:{line}: {text}" for path, kind, text, line in texts if lacks_subject(kind, text)
    ]
    assert unclear == []


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
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
def test_the_check_recognises_texts_without_a_grammatical_subject(kind: str, text: str, expected: bool):
    assert lacks_subject(kind, text) == expected
