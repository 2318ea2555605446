"""Tests that a failing command prints one sentence and exits with a nonzero status, whatever its output stream."""

import io
import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from drake_quad.command_line.running import orderly_exit

import pytest

from drake_quad import InputError


def status_of(words, error):
    """Return the exit status of a process that prints a text and then raises the given error, if any."""

    def command():
        print(words)
        if error is not None:
            raise error

    with pytest.raises(SystemExit) as stop, orderly_exit():
        command()
    return stop.value.code


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (InputError("the route is empty"), 2, "error: the route is empty\n"),
        (RuntimeError("it diverged"), 1, "failed: it diverged\n"),
        (ConnectionError("the scheduler is gone"), 1, "failed: the scheduler is gone\n"),
        (MemoryError(), 1, "failed: not enough memory\n"),
        (MemoryError("nothing was written"), 1, "failed: nothing was written\n"),
        (KeyboardInterrupt(), 1, "interrupted: no file was written\n"),
        (BrokenPipeError(), 1, ""),
        (SystemExit(3), 3, ""),
        (SystemExit(), None, ""),
    ],
)
def test_a_failing_command_prints_a_sentence_and_returns_a_status(error, status, sentence, capsys):
    assert status_of("before", error) == status
    assert capsys.readouterr() == ("before\n", sentence)


def test_a_command_that_succeeds_does_not_exit(capsys):
    with orderly_exit():
        print("done")
    assert capsys.readouterr() == ("done\n", "")


def test_an_unexpected_error_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError), orderly_exit():
        1 // 0  # noqa: B018


@pytest.mark.parametrize("encoding", ["latin-1", "ascii", "cp1252"])
def test_characters_that_the_encoding_lacks_are_escaped(encoding, monkeypatch):
    written = {name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")}
    for name, stream in written.items():
        monkeypatch.setattr(sys, name, stream)
    assert status_of("∫ω dt ≤ 5", InputError("∆ is no name")) == 2
    printed = [stream.buffer.getvalue().decode(encoding) for stream in written.values() if not stream.flush()]
    assert printed == ["\\u222b\\u03c9 dt \\u2264 5\n", "error: \\u2206 is no name\n"]


def test_a_command_without_a_standard_output_prints_nothing_and_succeeds(monkeypatch):
    """A process started with `>&-` has no standard output; printed text is discarded."""
    monkeypatch.setattr(sys, "stdout", None)
    with orderly_exit():
        print("lost")
        sys.stdout.write("lost")
    sys.stdout.close()


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (None, 1, "failed: cannot write to the standard output: no space left on device\n"),
        (SystemExit(0), 1, "failed: cannot write to the standard output: no space left on device\n"),
        (InputError("the route is empty"), 2, "error: the route is empty\n"),
    ],
)
def test_output_to_a_full_device_fails(error, status, message, monkeypatch, capsys):
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert (status_of("a table", error), capsys.readouterr().err) == (status, message)


def test_a_message_that_cannot_be_written_does_not_change_the_status(monkeypatch):
    statuses = []
    # Closing the file fails, too.
    with suppress(OSError), Path("/dev/full").open("w", buffering=1, encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stderr", full)
        statuses.append(status_of("before", InputError("the route is empty")))
    assert statuses == [2]


@pytest.mark.parametrize(("argument", "unbuffered"), [("--version", ""), ("--help", ""), ("--version", "1")])
def test_a_command_on_a_full_device_has_no_traceback(argument, unbuffered, root):
    """Python reports the error when the process ends, or when it prints if its output is not buffered."""
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONUNBUFFERED": unbuffered}
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [sys.executable, "-m", "drake_quad", argument]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=root, env=environment)
    assert done.returncode == 1
    assert re.fullmatch(r"failed: .*no space left on device\n", done.stderr, re.IGNORECASE)
