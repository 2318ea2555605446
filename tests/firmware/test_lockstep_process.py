"""Tests of processes that advance only on request."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.process import LockstepProcess

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="firmware flies only on Linux")
# Program that replies to each request with the length of the request, until it receives the request `end`.
PROGRAM = """
import os, socket, sys, time
connection = socket.socket(fileno=int(os.environ["LOCKSTEP_SOCKET"]))
connection.send(b"ready")
while request := connection.recv(4096):
    if request == b"end":
        print("first line")
        print("the propeller fell off", flush=True)
        sys.exit(3)
    if request == b"abort":
        os.abort()
    if request == b"sleep":
        time.sleep(60.0)
    if request == b"files":
        connection.send(" ".join(sorted(os.listdir("."))).encode())
        continue
    connection.send(str(len(request)).encode())
"""

# Program that starts a firmware, prints its process number and waits.
PARENT = f"""
import sys, time
from drake_quad.firmware.process import LockstepProcess
firmware = LockstepProcess([sys.executable, "-c", {PROGRAM!r}], "The firmware", environment={{}})
firmware.receive()
print(firmware._process.pid, flush=True)
time.sleep(60.0)
"""


@pytest.fixture
def firmware():
    started = LockstepProcess(
        [sys.executable, "-c", PROGRAM], "The firmware", environment={}, files={"settings.bin": b"1"}
    )
    assert started.receive() == b"ready"
    yield started
    started.close()


def test_each_request_has_one_reply(firmware):
    for size in (1, 300, 4000):
        firmware.send(b"x" * size)
        assert firmware.receive() == str(size).encode()


def test_the_working_folder_contains_the_files_and_is_deleted_at_the_end(firmware):
    firmware.send(b"files")
    assert firmware.receive() == b"log.txt settings.bin"
    assert firmware.folder.is_dir()
    firmware.close()
    assert not firmware.folder.exists()


def test_an_end_is_reported_with_its_status_and_the_last_output(firmware):
    firmware.send(b"end")
    with pytest.raises(
        FirmwareError, match=r"^The firmware ended with status 3; its last output was: the propeller fell off$"
    ):
        firmware.receive()
    assert not firmware.folder.exists()
    with pytest.raises(FirmwareError, match=r"^The firmware was stopped$"):
        firmware.send(b"x")


def test_a_crash_is_reported_with_its_signal(firmware):
    firmware.send(b"abort")
    with pytest.raises(FirmwareError, match=r"^The firmware ended by signal SIGABRT$"):
        firmware.receive()


def test_a_process_that_hangs_is_stopped(firmware):
    firmware._socket.settimeout(0.2)
    firmware.send(b"sleep")
    with pytest.raises(FirmwareError, match=r"^The firmware did not answer within 10 s and was stopped$"):
        firmware.receive()
    assert firmware._process.returncode == -signal.SIGKILL


def test_a_program_that_does_not_exist_is_reported():
    with pytest.raises(FirmwareError, match=r"^The firmware cannot be started: no such file or directory$"):
        LockstepProcess(["./no_such_program"], "The firmware", environment={})


def test_a_fork_does_not_stop_the_firmware_of_its_parent(firmware):
    child = os.fork()
    if not child:
        firmware.close()
        os._exit(0)
    os.waitpid(child, 0)
    firmware.send(b"abc")
    assert firmware.receive() == b"3"


@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_process_survives_its_parent(stop):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    with parent:
        pid = int(parent.stdout.readline())
        assert is_running(pid)
        parent.send_signal(stop)
    assert ends(pid)


def is_running(pid):
    """Return whether a process exists and is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def ends(pid):
    """Return whether a process ends within 10 s."""
    end = time.monotonic() + 10.0
    while is_running(pid) and time.monotonic() < end:
        time.sleep(0.02)
    return not is_running(pid)
