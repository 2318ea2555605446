"""Tests of the cache of results on disk."""

import hashlib
import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.framework import code_cache, result_cache
from drake_quad.framework.result_cache import _environment, _identity, cached_on_disk
from drake_quad.scenario.distributions import Model

COMPUTED_CALLS = []


def square(values, *, shift=0.0):
    COMPUTED_CALLS.append(values)
    if np.any(values < 0.0):
        raise ValueError("negative")
    return values**2 + shift


def gain_of(models):
    COMPUTED_CALLS.append(models)
    return models[0].gain


def cube(values):
    COMPUTED_CALLS.append(values)
    return values**3


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Return a cache folder that does not exist yet."""
    monkeypatch.setenv("DRAKE_QUAD_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(result_cache, "_environment", lambda: "an environment")
    COMPUTED_CALLS.clear()
    return tmp_path / "cache"


def test_a_result_is_computed_once():
    for _ in range(2):
        np.testing.assert_array_equal(cached_on_disk(square, np.arange(3.0), shift=1.0), [1.0, 2.0, 5.0])
    assert len(COMPUTED_CALLS) == 1


def test_results_are_cached_separately_for_each_environment_function_and_arguments(monkeypatch):
    values = np.arange(3.0)
    assert cached_on_disk(square, values)[2] == 4.0
    assert cached_on_disk(square, values + 1.0)[2] == 9.0
    assert cached_on_disk(square, values, shift=1.0)[2] == 5.0
    assert cached_on_disk(cube, values)[2] == 8.0
    monkeypatch.setattr(result_cache, "_environment", lambda: "another environment")
    assert cached_on_disk(square, values)[2] == 4.0
    assert len(COMPUTED_CALLS) == 5


@pytest.mark.long
def test_equal_scenarios_have_the_same_key_in_every_process():
    """Pydantic pickles a scenario with a set of names, whose order differs between processes."""
    statement = (
        "import hashlib; from drake_quad import load_scenario; from drake_quad.framework.result_cache import _identity;"
        "print(hashlib.sha256(_identity([load_scenario('robustness'), load_scenario('forest')])).hexdigest())"
    )
    seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    other = subprocess.run(
        [sys.executable, "-c", statement], env={**os.environ, "PYTHONHASHSEED": seed}, check=True, capture_output=True
    )
    key = hashlib.sha256(_identity([load_scenario("robustness"), load_scenario("forest")])).hexdigest()
    assert other.stdout.decode().strip() == key
    assert _identity(load_scenario("robustness")) != _identity(load_scenario("robustness", {"vehicle.mass": 0.7}))


def test_equal_arguments_have_the_same_key_although_they_are_not_the_same_object():
    shared = (1.0, "a")
    assert _identity([shared, shared]) == _identity([(1.0, "a"), (float("1"), "a")])


def test_a_result_that_depends_on_a_user_defined_model_class_is_not_cached(folder):
    class Settings(Model):
        gain: float = 1.0

    for _ in range(2):
        assert cached_on_disk(gain_of, (Settings(),)) == 1.0
    assert len(COMPUTED_CALLS) == 2
    assert not folder.exists()


def test_errors_are_not_cached():
    for _ in range(2):
        with pytest.raises(ValueError, match="negative"):
            cached_on_disk(square, np.array([-1.0]))
    assert len(COMPUTED_CALLS) == 2


def test_a_result_in_a_file_that_others_can_write_is_computed_again(folder):
    cached_on_disk(square, np.arange(3.0))
    (file,) = folder.iterdir()
    assert oct(file.stat().st_mode & 0o777) == "0o600"
    file.chmod(0o666)
    cached_on_disk(square, np.arange(3.0))
    assert len(COMPUTED_CALLS) == 2


def test_a_damaged_result_is_never_unpickled(folder):
    cached_on_disk(square, np.arange(3.0))
    (file,) = folder.iterdir()
    content = bytearray(file.read_bytes())
    content[10] ^= 1
    file.write_bytes(content)
    np.testing.assert_array_equal(cached_on_disk(square, np.arange(3.0)), [0.0, 1.0, 4.0])
    assert len(COMPUTED_CALLS) == 2


def test_old_results_are_pruned_like_machine_code(folder):
    cached_on_disk(square, np.arange(3.0))
    code_cache.prune(folder, 0)
    assert [*folder.iterdir()] == []


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return a folder with copies of some files, which represents the package."""
    copy = tmp_path / "package"
    shutil.copytree(result_cache._PACKAGE_FOLDER / "framework", copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(result_cache, "_PACKAGE_FOLDER", copy)
    return copy


def computed_environment():
    return _environment.__wrapped__()


def test_the_environment_depends_on_the_sources_of_the_package(package):
    before = computed_environment()
    assert before == computed_environment()
    source = package / "symbols.py"
    status = source.stat()
    source.write_text(source.read_text() + "# more\n")
    os.utime(source, (status.st_atime, status.st_mtime))
    assert computed_environment() not in (before, None)


def test_a_process_whose_sources_were_edited_after_its_start_caches_nothing(package):
    later = time.time() + 10.0
    os.utime(package / "symbols.py", (later, later))
    assert computed_environment() is None


def test_the_environment_of_a_package_without_source_files_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(result_cache, "_PACKAGE_FOLDER", tmp_path / "archive.zip" / "drake_quad")
    assert computed_environment() is None


def test_nothing_is_cached_if_the_environment_is_unknown(monkeypatch, folder):
    monkeypatch.setattr(result_cache, "_environment", lambda: None)
    for _ in range(2):
        cached_on_disk(square, np.arange(3.0))
    assert len(COMPUTED_CALLS) == 2
    assert not folder.exists()
