"""Datagrams of ArduPilot's JSON interface."""

import json
import struct
from collections.abc import Sequence
from typing import NamedTuple

from drake_quad.firmware.remote_control import Motion

# Beginning of a datagram with servo outputs: a constant that depends on the number of servos, the rate at which
# ArduPilot wishes to be called (Hz), and the number of the datagram. The pulse widths follow.
_HEADER = struct.Struct("<HHI")
_NUM_SERVOS = {18458: 16, 29569: 32}
NUM_MOTORS = 4
"""Number of servo outputs that are motors."""


class Servos(NamedTuple):
    """Servo outputs of ArduPilot.

    Attributes:
        frame: number of the datagram, which counts the answers that ArduPilot has received.
        pulses: pulse widths of motors 1 to 4, µs.
    """

    frame: int
    pulses: tuple[int, ...]

    @classmethod
    def of(cls, datagram: bytes) -> "Servos | None":
        """Return the servo outputs in a datagram; None if the datagram contains none."""
        if len(datagram) < _HEADER.size:
            return None
        magic, _, frame = _HEADER.unpack_from(datagram)
        if len(datagram) != _HEADER.size + 2 * _NUM_SERVOS.get(magic, 0):
            return None
        return cls(frame, struct.unpack_from(f"<{NUM_MOTORS}H", datagram, _HEADER.size))


def motion_message(time: float, motion: Motion, channels: Sequence[int]) -> bytes:
    """Return the datagram with the motion of the vehicle and the channels of the remote control.

    Args:
        time: time of the simulation, s.
        motion: motion of the vehicle.
        channels: pulse widths of the channels from 1 on, µs.
    """
    fields = {
        "timestamp": time,
        "imu": {"gyro": motion.gyro, "accel_body": motion.accel_body},
        "position": motion.position,
        "quaternion": motion.quaternion,
        "velocity": motion.velocity,
        "rc": {f"rc_{number}": pulse for number, pulse in enumerate(channels, 1)},
    }
    # ArduPilot finds a message between two line ends.
    return f"\n{json.dumps(fields)}\n".encode()
