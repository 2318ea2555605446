"""Tests of digests of source files."""

import functools
import importlib
import sys
import types

import numpy as np
import pytest

from drake_quad.studies.provenance import _digest, code_difference, provenance, source_digest

MODULE_SOURCE = "def make(num_vehicles):\n    return num_vehicles\n"


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Create a module with a name and a text, and return its function."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []

    def write(name, text=MODULE_SOURCE):
        (tmp_path / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        made.append(name)
        return importlib.import_module(name).make

    yield write
    for name in made:
        sys.modules.pop(name, None)


def test_provenance_has_versions_and_a_digest():
    result = provenance()
    assert list(result) == ["python", "drake_quad", "drake", "numpy", "scipy", "llvmlite", "sources"]
    assert result["python"] == ".".join(map(str, sys.version_info[:3]))
    assert result["numpy"] == np.__version__
    assert len(result["sources"]) == 16
    assert int(result["sources"], 16) >= 0


def test_a_digest_depends_on_names_and_contents_of_files(module):
    digest_of_ours = source_digest([module("ours")])
    digest_of_theirs = source_digest([module("theirs", MODULE_SOURCE + "# more\n")])
    same = source_digest([module("another")])
    assert len({digest_of_ours, digest_of_theirs, same, source_digest([])}) == 4
    ours, theirs = (importlib.import_module(name).make for name in ("ours", "theirs"))
    assert source_digest([ours, ours]) == digest_of_ours
    assert source_digest([ours, theirs]) == source_digest([theirs, ours])
    assert source_digest([ours, theirs]) not in (digest_of_ours, digest_of_theirs)
    assert source_digest([functools.partial(ours, 1), None]) == digest_of_ours


def test_a_digest_separates_names_from_contents(tmp_path):
    digests = set()
    for number, texts in enumerate(({"a": "bc", "d": ""}, {"a": "b", "cd": ""}, {"ab": "c", "d": ""})):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, text in texts.items():
            (folder / name).write_text(text)
        digests.add(_digest([folder / name for name in texts], folder))
    assert len(digests) == 3


def test_a_digest_follows_the_contents_of_a_file(module):
    make = module("ours")
    before = source_digest([make])
    module("ours", MODULE_SOURCE.replace("num_vehicles", "vehicles"))
    assert source_digest([make]) != before
    module("ours")
    assert source_digest([make]) == before


def test_a_module_that_is_not_loaded_is_imported_for_its_digest(module):
    """This is the situation in a worker that knows only the name of the module."""
    make = module("ours")
    result = source_digest([make])
    del sys.modules["ours"]
    assert source_digest([make]) == result


def test_functions_without_a_file_or_of_the_main_script_are_ignored(module, monkeypatch):
    make = module("ours")
    assert source_digest([sys.getsizeof, None]) == source_digest([])
    for name in ("__main__", "__mp_main__"):
        script = types.ModuleType(name)
        script.__file__ = importlib.import_module("ours").__file__
        monkeypatch.setitem(sys.modules, name, script)
        monkeypatch.setattr(make, "__module__", name)
        assert source_digest([make]) == source_digest([])


def test_the_first_code_difference_is_described():
    local_code = {"python": "3.12.1", "numpy": "2.0", "sources": "a", "user_systems": "b"}
    assert code_difference(local_code, dict(local_code)) is None
    assert code_difference(local_code, {**local_code, "numpy": "1.0"}) == "numpy 1.0, not 2.0"
    assert (
        code_difference(local_code, {**local_code, "sources": "c"})
        == "a different version of drake_quad's source files"
    )
    assert (
        code_difference(local_code, {**local_code, "user_systems": "c"})
        == "different source files of the user's systems"
    )
    assert code_difference(local_code, {"python": "3.12.1"}) == "numpy None, not 2.0"
