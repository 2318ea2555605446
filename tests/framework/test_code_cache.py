"""Tests that the cache loads only complete files that belong to this user and have the right name."""

import ctypes
import os
import re
import threading
from contextlib import nullcontext
from pathlib import Path

import pytest

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework import code_cache, machine_code

KERNEL_NAME = f"kernel_{'1' * 32}"
OTHER_KERNEL_NAME = f"kernel_{'2' * 32}"
OBJECT_CODE = bytes(range(200))  # arbitrary content of a cached kernel


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a cache folder that does not exist yet, and reset the warnings that are logged once."""
    code_cache._warn_once.cache_clear()
    monkeypatch.setenv("DRAKE_QUAD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def file(folder):
    """Write `OBJECT_CODE` to the cache, and return the file of the cached kernel."""
    code_cache.write(KERNEL_NAME, OBJECT_CODE)
    assert code_cache.read(KERNEL_NAME) == OBJECT_CODE
    return folder / f"{KERNEL_NAME}.o"


def test_only_the_user_can_write_to_the_cache(folder):
    before = os.umask(0)
    try:
        code_cache.write(KERNEL_NAME, OBJECT_CODE)
    finally:
        os.umask(before)
    (file,) = folder.iterdir()
    assert (file.name, oct(file.stat().st_mode & 0o777)) == (f"{KERNEL_NAME}.o", "0o600")
    assert oct(folder.stat().st_mode & 0o777) == "0o700"


def test_a_file_that_was_renamed_to_another_module_is_not_read(file):
    code_cache.write(OTHER_KERNEL_NAME, OBJECT_CODE[::-1])
    file.write_bytes((file.parent / f"{OTHER_KERNEL_NAME}.o").read_bytes())
    assert code_cache.read(KERNEL_NAME) is None
    assert code_cache.read(OTHER_KERNEL_NAME) == OBJECT_CODE[::-1]


def test_a_file_that_contains_only_a_digest_is_not_read(file):
    file.write_bytes(code_cache._digest(KERNEL_NAME, b""))
    assert code_cache.read(KERNEL_NAME) is None


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666], ids=oct)
def test_a_file_that_others_can_write_is_not_read(file, mode):
    file.chmod(mode)
    assert code_cache.read(KERNEL_NAME) is None


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o1777], ids=oct)
def test_a_folder_that_others_can_write_is_not_used_and_is_reported_once(file, mode, caplog):
    file.parent.chmod(mode)
    assert code_cache.read(KERNEL_NAME) is None
    code_cache.write(OTHER_KERNEL_NAME, OBJECT_CODE)
    assert [*file.parent.iterdir()] == [file]
    (record,) = caplog.records
    assert record.getMessage().startswith(f"{file.parent} belongs to another user or is writable by others")
    file.parent.chmod(0o755)
    assert code_cache.read(KERNEL_NAME) == OBJECT_CODE


def test_files_and_folders_of_another_user_are_not_used(file, monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    assert code_cache.read(KERNEL_NAME) is None
    code_cache.write(OTHER_KERNEL_NAME, OBJECT_CODE)
    assert [*file.parent.iterdir()] == [file]
    # A file in this user's folder may belong to another user.
    monkeypatch.setattr(code_cache, "_is_trusted", lambda folder: True)
    assert code_cache.read(KERNEL_NAME) is None


def replace_with_link(file, elsewhere):
    elsewhere.write_bytes(file.read_bytes())
    file.unlink()
    file.symlink_to(elsewhere)


def replace_with_folder(file, _):
    file.unlink()
    file.mkdir()


def replace_with_fifo(file, _):
    file.unlink()
    os.mkfifo(file, 0o600)


def replace_with_open_fifo(file, _):
    """Replace a file with a FIFO that a writer keeps open without writing."""
    replace_with_fifo(file, _)
    return os.fdopen(os.open(file, os.O_RDWR), "rb")


@pytest.mark.parametrize("replace", [replace_with_link, replace_with_folder, replace_with_fifo, replace_with_open_fifo])
def test_only_regular_files_are_read_and_other_files_do_not_block(file, replace, tmp_path):
    actual = []
    with replace(file, tmp_path / "elsewhere") or nullcontext():
        thread = threading.Thread(target=lambda: actual.append(code_cache.read(KERNEL_NAME)), daemon=True)
        thread.start()
        thread.join(10.0)
        assert actual == [None]


def test_a_folder_that_is_a_file_is_not_used(folder):
    folder.write_text("")
    assert code_cache.read(KERNEL_NAME) is None
    code_cache.write(KERNEL_NAME, OBJECT_CODE)
    assert folder.read_text() == ""


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"XDG_CACHE_HOME": "/caches"}, "/caches/drake_quad"),
        ({"XDG_CACHE_HOME": "caches"}, "/home/me/.cache/drake_quad"),
        ({"XDG_CACHE_HOME": ""}, "/home/me/.cache/drake_quad"),
        ({}, "/home/me/.cache/drake_quad"),
        ({"HOME": "me"}, None),
        ({"DRAKE_QUAD_CACHE": "/here", "XDG_CACHE_HOME": "/caches"}, "/here"),
        ({"DRAKE_QUAD_CACHE": "here", "XDG_CACHE_HOME": "/caches"}, None),
        ({"DRAKE_QUAD_CACHE": "", "XDG_CACHE_HOME": "/caches"}, None),
    ],
)
def test_a_relative_path_is_not_used_as_folder(variables, expected, monkeypatch, caplog):
    """A warning is logged only if DRAKE_QUAD_CACHE contains the relative path."""
    code_cache._warn_once.cache_clear()
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DRAKE_QUAD_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/me", **variables}.items():
        monkeypatch.setenv(name, value)
    assert code_cache.cache_folder() == (None if expected is None else Path(expected))
    remarks = [record.message for record in caplog.records]
    assert len(remarks) == (variables.get("DRAKE_QUAD_CACHE") == "here")
    assert not remarks or remarks[0].startswith(
        "DRAKE_QUAD_CACHE is 'here', so machine code and results are not cached"
    )


def test_the_least_recently_used_file_is_deleted_first(folder):
    names = [f"kernel_{number:032x}" for number in range(5)]
    for age, name in zip((500, 400, 300, 200, 100), names, strict=True):
        code_cache.write(name, OBJECT_CODE)
        path = folder / f"{name}.o"
        written = path.stat().st_mtime - age
        os.utime(path, (written, written))
    mine = folder / "mine.o"
    mine.write_bytes(bytes(10_000))
    # The size of a symbolic link is that of the link itself.
    link = folder / f"kernel_{5:032x}.o"
    link.symlink_to("mine.o")
    code_cache.read(names[0])
    size = len(OBJECT_CODE) + 32
    code_cache.prune(folder, 3 * size + link.lstat().st_size)
    assert {*folder.iterdir()} == {mine, link, *(folder / f"{names[k]}.o" for k in (0, 3, 4))}


def test_a_temporary_file_of_a_killed_process_is_deleted(folder):
    folder.mkdir(mode=0o700)
    leftover = folder / f".{KERNEL_NAME}.1234.5678.o"
    leftover.write_bytes(bytes(10))
    os.utime(leftover, (0.0, 0.0))
    code_cache.prune(folder, 9)
    assert not leftover.exists()


def test_writing_keeps_the_cache_below_its_limit(folder, monkeypatch):
    monkeypatch.setattr(code_cache, "MAX_BYTES", 1_000)
    for number in range(100):
        code_cache.write(f"kernel_{number:032x}", OBJECT_CODE)
    assert 1 <= len([*folder.iterdir()]) <= 1_000 // (len(OBJECT_CODE) + 32) + 15


def test_one_write_in_sixteen_deletes_old_files(folder, monkeypatch):
    pruned = []
    monkeypatch.setattr(code_cache, "prune", lambda *given: pruned.append(given))
    for number in range(32):
        code_cache.write(f"kernel_{number:032x}", OBJECT_CODE)
    assert pruned == 2 * [(folder, code_cache.MAX_BYTES)]


def module(number):
    return f"define i64 @kernel() {{\n  ret i64 {number}\n}}"


def run_module(text):
    return ctypes.CFUNCTYPE(ctypes.c_int64)(machine_code.kernel_address(text))()


def test_an_object_file_without_the_function_is_not_called(folder, monkeypatch):
    """The digest is valid, and LLVM returns address 0 for the function."""
    text = module(4_711)
    code_cache.write(machine_code._name(text), machine_code._compile(module(1).replace("@kernel(", "@another(")))
    assert run_module(text) == 4_711
    # The recompiled module replaces the faulty file in the cache.
    monkeypatch.setattr(machine_code, "_addresses", ThreadSafeCache())
    monkeypatch.setattr(machine_code, "_compile", None)
    assert run_module(text) == 4_711


def test_a_module_is_cached_under_its_digest(folder):
    assert run_module(module(815)) == 815
    (file,) = folder.iterdir()
    assert re.fullmatch(code_cache._CACHE_FILE_NAME, file.name)
    assert file.stem == machine_code._name(module(815))


def run_generated(identity, number):
    """Run a module that is generated only if necessary; return its result and the number of generated modules."""
    generated = []

    def generate():
        generated.append(number)
        return module(number)

    address = machine_code.generated_kernel_address(identity, generate)
    return ctypes.CFUNCTYPE(ctypes.c_int64)(address)(), len(generated)


def test_a_module_is_generated_only_if_its_machine_code_is_not_cached(folder, monkeypatch):
    assert run_generated("one", 1_001) == (1_001, 1)
    assert run_generated("one", 1_001) == (1_001, 0)
    monkeypatch.setattr(machine_code, "_addresses", ThreadSafeCache())
    assert run_generated("one", 1_001) == (1_001, 0)
    assert run_generated("two", 1_002) == (1_002, 1)


@pytest.mark.parametrize("generator", ["another", None])
def test_a_module_is_generated_again_if_the_generator_has_changed_or_is_unknown(folder, monkeypatch, generator):
    monkeypatch.setattr(machine_code, "_addresses", ThreadSafeCache())
    assert run_generated("same", 2_001) == (2_001, 1)
    monkeypatch.setattr(machine_code, "_GENERATOR_DIGEST", generator)
    assert run_generated("same", 2_002) == (2_002, 1)


def test_the_digest_of_the_generator_depends_on_the_sources_of_the_compiler(tmp_path, monkeypatch):
    for name in ("framework", "compilation", "vehicle"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "module.py").write_text("x = 1\n")
    monkeypatch.setattr(machine_code, "__file__", str(tmp_path / "framework" / "machine_code.py"))
    digests = [machine_code._generator_digest()]
    for name in ("framework", "compilation", "vehicle"):
        (tmp_path / name / "module.py").write_text("x = 2\n")
        digests.append(machine_code._generator_digest())
    assert len(set(digests)) == 3
    assert digests[2] == digests[3]
    monkeypatch.setattr(machine_code, "__file__", str(tmp_path / "archive.zip" / "framework" / "machine_code.py"))
    assert machine_code._generator_digest() is None
