"""Tests that an error in the user's own Python code is reported with its file and line."""

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
from drake_quad.studies.study_folder import report_saved_results
from drake_quad.user_code import describe_error, user_frames, user_traceback

USER_MODULE = """
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
    """Return the module of the file mine.py, which a user has written into the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.py"
    path.write_text(USER_MODULE, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("mine_with_errors", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def error_of(function, *arguments):
    with pytest.raises(Exception) as caught:  # noqa: PT011 - any error
        function(*arguments)
    return caught.value


def test_an_error_raised_from_a_user_s_error_is_located_in_the_user_s_code(mine):
    row = layout_of(Row)
    error = error_of(trace_formula, mine.law, [Listing().row(0, 0)], [row])
    assert [(frame.name, frame.line) for frame in user_frames(error)] == [
        ("law", "return inner(x)"),
        ("inner", "return np.clip(x, 0.0, 1.0)"),
    ]
    assert describe_error(error).startswith("mine.py:12: TypeError: formula law: numpy.clip does not accept a row")
    first, second, *_ = user_traceback(error).splitlines()
    assert first.endswith('mine.py", line 9, in law')
    assert second == "    return inner(x)"


def test_an_error_inside_a_library_is_located_at_the_user_s_call_of_the_library(mine):
    error = error_of(call_from_package, mine.parsed)
    assert isinstance(error, json.JSONDecodeError)
    assert describe_error(error) == "mine.py:15: JSONDecodeError: Expecting value: line 1 column 1 (char 0)"


def test_an_input_error_in_the_user_s_code_is_printed_with_file_and_line_but_without_its_type(mine):
    error = error_of(call_from_package, lambda _: mine.loaded())
    assert isinstance(error, InputError)
    assert describe_error(error).startswith("mine.py:18: 'no_such_scenario' is neither a file nor a shipped scenario")


def test_a_program_that_calls_this_package_is_not_user_code(mine):
    """Only code that this package calls is user code. A program is above the package in the call stack."""
    error = error_of(lookup, {}, "a", "name")
    assert user_frames(error) == []
    assert user_traceback(error) == ""
    assert describe_error(error) == "there is no name called 'a'; there are none"
    assert describe_error(error_of(json.loads, "")).startswith("JSONDecodeError: ")


def test_the_body_of_a_with_statement_in_a_program_is_not_user_code():
    def body():
        with open_source(Path(__file__)):
            raise KeyError("a")

    assert describe_error(error_of(body)) == "KeyError: 'a'"

    def body_of_converted_error():
        with report_saved_results(lambda: "nothing was written"):
            raise RuntimeError("no progress")

    # The traceback of the original error contains the frame of the context manager, which stopped at `yield`.
    assert describe_error(error_of(body_of_converted_error)) == "RuntimeError: no progress; nothing was written"


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
    assert describe_error(error) == "wrong.py:1: SyntaxError: invalid syntax"


def test_errors_that_are_each_other_s_cause_do_not_cause_an_endless_loop():
    first, second = ValueError("a"), ValueError("b")
    first.__context__, second.__context__ = second, first
    assert user_frames(first) == []


class Table(dict):
    """Table that calls a user's function when `lookup` of this package searches it."""

    def __init__(self, function):
        super().__init__()
        self.function = function

    def __contains__(self, name):
        return self.function("")


def call_from_package(function):
    """Call a function as user code: the function `lookup` of this package calls it."""
    try:
        lookup(Table(function), "name", "name")
    except Exception as error:
        # The method `__contains__` above is called by the package, so it counts as user code as well.
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.name == "__contains__"]
        assert len(frames) == 1
        raise


def test_frames_of_cython_libraries_do_not_count_as_user_code(mine, monkeypatch):
    """Cython reports relative names of files that are not installed."""

    def frames_of(filename):
        frames = [traceback.FrameSummary(name, 1, "f", line="f()") for name in (lookup.__code__.co_filename, filename)]
        monkeypatch.setattr(traceback, "extract_tb", lambda _: frames)
        return user_frames(InputError("wrong"))

    assert frames_of("scipy/spatial/_qhull.pyx") == []
    assert len(frames_of("mine.py")) == 1
