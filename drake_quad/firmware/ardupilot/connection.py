"""Connection to an ArduPilot that waits for an external simulator."""

import socket
import weakref
from collections.abc import Sequence

from drake_quad.firmware.ardupilot.messages import Servos, motion_message
from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.remote_control import ADDRESS, START_TIMEOUT, STEP_TIMEOUT, Motion

_MAX_DATAGRAM = 4096  # bytes


class ArduPilotConnection:
    """Connection to an ArduPilot that waits for an external simulator.

    Args:
        port: port at which the simulation receives datagrams.

    Raises:
        FirmwareError: if the port is in use, no ArduPilot connects within 60 s, or it has already flown.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._finalizer = weakref.finalize(self, self._socket.close)
        try:
            self._socket.bind((ADDRESS, port))
        except OSError as error:
            self.close()
            raise FirmwareError(f"port {port} of {ADDRESS} cannot be used: {str(error.strerror).lower()}") from None
        self._socket.settimeout(START_TIMEOUT)
        self._name = f"ArduPilot at port {port} of {ADDRESS}"
        try:
            self._frame = self._next_servos(-1).frame
        except FirmwareError:
            raise FirmwareError(
                f"no {self._name} appeared within {START_TIMEOUT:g} s; start it by: sim_vehicle.py -v ArduCopter"
                f" --model JSON:{ADDRESS} --add-param-file diagrams/firmware/ardupilot.param"
            ) from None
        if self._frame > 0:
            self.close()
            raise FirmwareError(f"{self._name} has already flown; start it again, so that the flight is repeatable")
        self._socket.settimeout(STEP_TIMEOUT)

    def send(self, time: float, motion: Motion, channels: Sequence[int]) -> None:
        """Send the motion of the vehicle and the channels of the remote control at a time of the simulation, s.

        Raises:
            FirmwareError: if ArduPilot cannot be reached.
        """
        try:
            self._socket.sendto(motion_message(time, motion, channels), self._peer)
        except OSError as error:
            self.close()
            raise FirmwareError(f"{self._name} cannot be reached: {str(error.strerror).lower()}") from None

    def receive(self) -> tuple[float, ...]:
        """Return the (4,) motor commands that ArduPilot computes from the last message, from 0 to 1.

        Raises:
            FirmwareError: if ArduPilot does not answer within 20 s.
        """
        servos = self._next_servos(self._frame)
        self._frame = servos.frame
        return tuple([(pulse - 1000) / 1000 for pulse in servos.pulses])

    def close(self) -> None:
        """Close the connection. ArduPilot then waits, until the user ends it."""
        self._finalizer()

    def _next_servos(self, frame: int) -> Servos:
        """Return the next servo outputs after a frame; repeated outputs and other datagrams are ignored."""
        while True:
            try:
                datagram, self._peer = self._socket.recvfrom(_MAX_DATAGRAM)
            except OSError:
                self.close()
                raise FirmwareError(f"{self._name} did not answer within {STEP_TIMEOUT:g} s") from None
            servos = Servos.of(datagram)
            if servos is not None and servos.frame > frame:
                return servos
