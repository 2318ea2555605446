"""Connection to a PX4 that waits for an external simulator."""

import socket
import weakref
from collections.abc import Sequence
from contextlib import suppress

from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.px4.messages import NUM_MOTORS, Px4Messages
from drake_quad.firmware.remote_control import ADDRESS, START_TIMEOUT, STEP_TIMEOUT, Motion

# Until its modules have started, PX4 does not command the motors. For this time of the simulation, a step waits only a
# moment for an answer.
_MAX_STARTING_TIME = 10.0  # s
_STARTING_TIMEOUT = 0.02  # s of real time
_SATELLITE_PERIOD = 0.1  # s
_BUFFER_SIZE = 65_536  # bytes


class Px4Connection:
    """Connection to a PX4 that waits for an external simulator.

    Args:
        port: TCP port at which PX4 finds the simulation.
        seed: seed of the noise in the messages.

    Raises:
        FirmwareError: if the port is in use, or no PX4 connects within 60 s.
        ImportError: if the library pymavlink is not installed.
    """

    def __init__(self, port: int, seed: int) -> None:
        self._messages = Px4Messages(seed)
        self._name = f"PX4 at port {port} of {ADDRESS}"
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((ADDRESS, port))
                listener.listen(1)
            except OSError as error:
                raise FirmwareError(f"port {port} of {ADDRESS} cannot be used: {str(error.strerror).lower()}") from None
            listener.settimeout(START_TIMEOUT)
            try:
                self._socket, _ = listener.accept()
            except TimeoutError:
                raise FirmwareError(
                    f"no {self._name} appeared within {START_TIMEOUT:g} s; start it with PX4_SIM_MODEL=none_iris and"
                    " the parameters in diagrams/firmware/px4.env"
                ) from None
        self._finalizer = weakref.finalize(self, self._socket.close)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._has_answered = False
        self._sent, self._next_satellites = 0, 0.0

    def send(self, time: float, motion: Motion, channels: Sequence[int]) -> None:
        """Send the motion of the vehicle and the channels of the remote control (µs) at a time of the simulation, s.

        Raises:
            FirmwareError: if PX4 cannot be reached.
        """
        self._sent = round(1e6 * time)
        data = self._messages.channels(self._sent, channels)
        if time >= self._next_satellites:
            self._next_satellites = time + _SATELLITE_PERIOD
            data += self._messages.satellites(self._sent, motion)
        try:
            # The clock of PX4 advances with HIL_SENSOR, so this message is the last.
            self._socket.sendall(data + self._messages.sensors(self._sent, motion))
        except OSError as error:
            self.close()
            raise FirmwareError(f"{self._name} cannot be reached: {str(error.strerror).lower()}") from None

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) motor commands that PX4 computes from the last message, from 0 to 1; zeros while PX4 starts.

        Raises:
            FirmwareError: if PX4 does not answer within 20 s, has closed the connection, or does not start.
        """
        while True:
            with suppress(TimeoutError):
                self._socket.settimeout(STEP_TIMEOUT if self._has_answered else _STARTING_TIMEOUT)
                for time, motors in self._answers():
                    if time >= self._sent:
                        self._has_answered = True
                        return motors
                continue
            if self._has_answered:
                self._fail(f"did not answer within {STEP_TIMEOUT:g} s")
            if self._sent > 1e6 * _MAX_STARTING_TIME:
                self._fail(
                    f"did not command its motors within {_MAX_STARTING_TIME:g} s; start it with the parameters in"
                    " diagrams/firmware/px4.env"
                )
            return (0.0,) * NUM_MOTORS

    def close(self) -> None:
        """Close the connection. PX4 then waits, until the user ends it."""
        self._finalizer()

    def _answers(self) -> list[tuple[int, tuple[float, ...]]]:
        try:
            data = self._socket.recv(_BUFFER_SIZE)
        except TimeoutError:
            raise
        except OSError as error:
            self._fail(f"cannot be reached: {str(error.strerror).lower()}")
        if not data:
            self._fail("has closed the connection")
        return self._messages.motors(data)

    def _fail(self, words: str) -> None:
        self.close()
        raise FirmwareError(f"{self._name} {words}") from None
