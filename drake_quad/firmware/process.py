"""Process that advances only on request, so that it runs in lockstep with a simulation."""

import contextlib
import os
import signal
import socket
import subprocess
import tempfile
import weakref
from pathlib import Path
from typing import Any

from drake_quad.errors import shorten_text
from drake_quad.firmware.controller import FirmwareError

SOCKET_VARIABLE = "LOCKSTEP_SOCKET"
"""Environment variable with the number of the socket over which a process receives requests and sends replies."""
_LOG = "log.txt"  # file in the working folder with the output of the process
_MAX_LOG_LENGTH = 200  # characters of the last line of the log that an error shows
_TIMEOUT = 10.0  # s of real time; a step takes less than a millisecond
_MAX_REPLY = 4096  # bytes


class LockstepProcess:
    """Process that advances only on request.

    The process receives requests and sends replies over a socket, whose number is in the environment variable
    `LOCKSTEP_SOCKET`. It sends a first reply when it is ready. It ends when the socket is closed or this process ends.

    Args:
        command: command that starts the process.
        name: name of the firmware, for error messages.
        environment: environment variables of the process.
        files: contents of files in its working folder, which is a new temporary folder, by name.

    Attributes:
        folder: working folder of the process.

    Raises:
        FirmwareError: if the process cannot be started.
    """

    def __init__(
        self, command: list[str], name: str, *, environment: dict[str, str], files: dict[str, bytes] | None = None
    ) -> None:
        directory = tempfile.TemporaryDirectory(prefix="drake_quad_")
        self.folder, self._name = Path(directory.name), name
        for file, content in (files or {}).items():
            (self.folder / file).write_bytes(content)
        # The boundaries of messages are preserved, so one call sends or receives a whole message.
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_TIMEOUT)
        try:
            with other, (self.folder / _LOG).open("wb") as log:
                self._process = subprocess.Popen(
                    command,
                    cwd=self.folder,
                    env={**environment, SOCKET_VARIABLE: str(other.fileno())},
                    pass_fds=[other.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                )
        except OSError as error:
            self._socket.close()
            directory.cleanup()
            raise FirmwareError(f"{name} cannot be started: {str(error.strerror).lower()}") from None
        self._finalizer = weakref.finalize(self, _stop, os.getpid(), self._process, self._socket, directory)

    def send(self, request: bytes) -> None:
        """Send a request.

        Raises:
            FirmwareError: if the process has ended.
        """
        try:
            self._socket.send(request)
        except OSError:
            raise self._explain_end() from None

    def receive(self) -> bytes:
        """Return the next reply.

        Raises:
            FirmwareError: if the process has ended, or does not reply within 10 s.
        """
        try:
            reply = self._socket.recv(_MAX_REPLY)
        except TimeoutError:
            self.close()
            raise FirmwareError(f"{self._name} did not answer within {_TIMEOUT:g} s and was stopped") from None
        except OSError:
            reply = b""
        if not reply:
            raise self._explain_end()
        return reply

    def close(self) -> None:
        """Stop the process and delete its working folder."""
        self._finalizer()

    def _explain_end(self) -> FirmwareError:
        """Stop the process, and return an error that says how it ended."""
        if not self._finalizer.alive:
            return FirmwareError(f"{self._name} was stopped")
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)  # the socket is closed shortly before the process ends
        status, last_line = self._process.poll(), ""
        with contextlib.suppress(OSError):
            lines = (self.folder / _LOG).read_text(errors="replace").strip().splitlines()
            last_line = shorten_text(lines[-1], _MAX_LOG_LENGTH) if lines else ""
        self.close()
        how = "without a status" if status is None else f"with status {status}"
        if status is not None and status < 0:
            with contextlib.suppress(ValueError):
                how = f"by signal {signal.Signals(-status).name}"
        wrote = f"; its last output was: {last_line}" if last_line else ""
        return FirmwareError(f"{self._name} ended {how}{wrote}")


def _stop(owner: int, process: subprocess.Popen[Any], connection: socket.socket, directory: Any) -> None:
    if os.getpid() != owner:  # in a fork of the process that started the firmware
        return
    process.kill()
    process.wait()
    connection.close()
    directory.cleanup()
