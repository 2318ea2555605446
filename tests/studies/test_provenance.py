"""Digests tell one code from another, and from nothing else."""

import functools
import importlib
import sys
import types

import numpy as np
import pytest

from drake_quad.studies.provenance import _digest, code_difference, provenance, source_digest

TEXT = "def make(num_vehicles):\n    return num_vehicles\n"


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes a module of a name with a text, and gives its function."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []

    def write(name, text=TEXT):
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        made.append(name)
        return importlib.import_module(name).make

    yield write
    for name in made:
        sys.modules.pop(name, None)


def test_versions_and_sources_are_told():
    found = provenance()
    assert list(found) == ["python", "drake_quad", "drake", "numpy", "scipy", "llvmlite", "sources"]
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert found["numpy"] == np.__version__
    assert len(found["sources"]) == 16
    assert int(found["sources"], 16) >= 0


def test_a_digest_is_of_the_text_and_of_the_name_of_each_file_once(module):
    one = source_digest([module("ours")])
    two = source_digest([module("theirs", TEXT + "# more\n")])
    same = source_digest([module("another")])
    assert len({one, two, same, source_digest([])}) == 4
    ours, theirs = (importlib.import_module(name).make for name in ("ours", "theirs"))
    assert source_digest([ours, ours]) == one
    assert source_digest([ours, theirs]) == source_digest([theirs, ours])
    assert source_digest([ours, theirs]) not in (one, two)
    assert source_digest([functools.partial(ours, 1), None]) == one


def test_a_digest_tells_where_a_name_ends_and_where_a_text_does(tmp_path):
    digests = set()
    for number, texts in enumerate(({"a": "bc", "d": ""}, {"a": "b", "cd": ""}, {"ab": "c", "d": ""})):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, text in texts.items():
            (folder / name).write_text(text)
        digests.add(_digest([folder / name for name in texts], folder))
    assert len(digests) == 3


def test_a_digest_changes_with_the_text_of_a_file_and_back_with_it(module):
    make = module("ours")
    before = source_digest([make])
    module("ours", TEXT.replace("num_vehicles", "vehicles"))
    assert source_digest([make]) != before
    module("ours")
    assert source_digest([make]) == before


def test_a_function_of_a_module_that_is_not_loaded_is_found(module):
    """As in a worker that has only read where it is to be found."""
    make = module("ours")
    found = source_digest([make])
    del sys.modules["ours"]
    assert source_digest([make]) == found


def test_what_has_no_file_or_is_in_the_main_script_does_not_count(module, monkeypatch):
    make = module("ours")
    assert source_digest([sys.getsizeof, None]) == source_digest([])
    for name in ("__main__", "__mp_main__"):
        script = types.ModuleType(name)
        script.__file__ = importlib.import_module("ours").__file__
        monkeypatch.setitem(sys.modules, name, script)
        monkeypatch.setattr(make, "__module__", name)
        assert source_digest([make]) == source_digest([])


def test_what_differs_is_said_in_words():
    here = {"python": "3.12.1", "numpy": "2.0", "sources": "a", "user_systems": "b"}
    assert code_difference(here, dict(here)) is None
    assert code_difference(here, {**here, "numpy": "1.0"}) == "numpy 1.0, not 2.0"
    assert code_difference(here, {**here, "sources": "c"}) == "a different version of drake_quad's source files"
    assert code_difference(here, {**here, "user_systems": "c"}) == "different source files of the user's systems"
    assert code_difference(here, {"python": "3.12.1"}) == "numpy None, not 2.0"
