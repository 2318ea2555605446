"""Tests of errors in the user's own Python code."""

import importlib.util
import json
import traceback
import warnings
from pathlib import Path

from drake_quad.command_line.running import run

import pytest

from drake_quad.errors import InputError, lookup
from drake_quad.framework.formulas import trace_formula
from drake_quad.framework.records import layout_of
from drake_quad.framework.symbols import Listing
from drake_quad.scenario.files.reading import open_source
from drake_quad.signals import Row
from drake_quad.user_code import located, user_frames, user_traceback

MINE = """
import json

import numpy as np

from drake_quad import load_scenario

def law(x):
    return inner(x)

def inner(x):
    return np.clip(x, 0.0, 1.0)

def parsed(text):
    return json.loads(text)

def loaded():
    return load_scenario("no_such_scenario")
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Return the module of a user's file in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.py"
    path.write_text(MINE, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("mine_with_errors", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def error_of(function, *arguments):
    with pytest.raises(Exception) as caught:  # noqa: PT011 - any error
        function(*arguments)
    return caught.value


def test_an_error_that_this_package_raises_from_another_is_located_in_the_user_s_code(mine):
    row = layout_of(Row)
    error = error_of(trace_formula, mine.law, [Listing().row(0, 0)], [row])
    assert [(frame.name, frame.line) for frame in user_frames(error)] == [
        ("law", "return inner(x)"),
        ("inner", "return np.clip(x, 0.0, 1.0)"),
    ]
    assert located(error).startswith("mine.py:12: TypeError: formula law: numpy.clip does not accept a row")
    first, second, *_ = user_traceback(error).splitlines()
    assert first.endswith('mine.py", line 9, in law')
    assert second == "    return inner(x)"


def test_an_error_inside_a_library_is_located_where_the_user_calls_the_library(mine):
    error = error_of(entry_of, mine.parsed)
    assert isinstance(error, json.JSONDecodeError)
    assert located(error) == "mine.py:15: JSONDecodeError: Expecting value: line 1 column 1 (char 0)"


def test_wrong_input_in_the_user_s_code_is_located_without_a_type(mine):
    error = error_of(entry_of, lambda _: mine.loaded())
    assert isinstance(error, InputError)
    assert located(error).startswith("mine.py:18: 'no_such_scenario' is neither a file nor a shipped scenario")


def test_a_program_that_calls_this_package_is_not_user_code(mine):
    """Only code that this package calls is user code. The program calls the package, so its frames come first in the
    traceback."""
    error = error_of(lookup, {}, "a", "name")
    assert user_frames(error) == []
    assert user_traceback(error) == ""
    assert located(error) == "there is no name called 'a'; there are none"
    assert located(error_of(json.loads, "")).startswith("JSONDecodeError: ")


def test_the_body_of_a_with_statement_of_a_program_is_not_user_code():
    def body():
        with open_source(Path(__file__)):
            raise KeyError("a")

    assert located(error_of(body)) == "KeyError: 'a'"


def test_the_main_function_of_a_program_is_not_user_code(capsys, monkeypatch):
    def program():
        raise InputError("--samples is 0")

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with pytest.raises(SystemExit):
        run(program)
    assert capsys.readouterr().err == "error: --samples is 0\n"


def test_a_syntax_error_is_located_in_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    error = error_of(compile, "def f(:\n  pass", str(tmp_path / "wrong.py"), "exec")
    assert located(error) == "wrong.py:1: SyntaxError: invalid syntax"


def test_errors_that_refer_to_each_other_in_a_circle_have_no_user_frames():
    first, second = ValueError("a"), ValueError("b")
    first.__context__, second.__context__ = second, first
    assert user_frames(first) == []


class Table(dict):
    """Table whose look-up runs the user's code, called by `lookup` of this package."""

    def __init__(self, function):
        super().__init__()
        self.function = function

    def __contains__(self, name):
        return self.function("")


def entry_of(function):
    """Let this package call a function."""
    try:
        lookup(Table(function), "name", "name")
    except Exception as error:
        # The look-up itself is a part of the program.
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.name == "__contains__"]
        assert len(frames) == 1
        raise
