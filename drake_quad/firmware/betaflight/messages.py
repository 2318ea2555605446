"""Requests to Betaflight and its replies, with the layout of the structs in `lockstep.c`."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

NUM_CHANNELS = 16
"""Number of channels of the remote control."""
_REQUEST = struct.Struct(f"<Q4I18dd{NUM_CHANNELS}H")
_REPLY = struct.Struct("<Q2I4f")
_NS = 1e-9  # s
# Place of Betaflight's motors 1 to 4 in a reply.
_MOTOR_ORDER = (3, 0, 1, 2)


class Sensors(NamedTuple):
    """State of the vehicle that the firmware receives instead of readings of sensors.

    The axes are those of the simulator build of Betaflight, which differ from quantity to quantity.

    Attributes:
        rates: p, -q and -r, rad/s.
        force: negative specific force in B, m/s².
        quaternion: w, x, -y and -z of the rotation from B to W.
        velocity: velocity in W, m/s.
        position: longitude and latitude in degrees, and altitude in m.
        pressure: pressure of the air, Pa.
    """

    rates: tuple[float, float, float]
    force: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    velocity: tuple[float, float, float]
    position: tuple[float, float, float]
    pressure: float


class Reply(NamedTuple):
    """Reply of the firmware, which then waits for the next request.

    Attributes:
        now: time of the firmware, ns.
        is_running: True if the firmware has finished its initialization.
        motors: commands of Betaflight's motors 1 to 4, from 0 to 1.
    """

    now: int
    is_running: bool
    motors: tuple[float, float, float, float]

    @classmethod
    def of(cls, message: bytes) -> "Reply | None":
        """Return the reply in a message; None if the message has another size."""
        if len(message) != _REPLY.size:
            return None
        now, is_running, _, *motors = _REPLY.unpack(message)
        first, second, third, fourth = (motors[place] for place in _MOTOR_ORDER)
        return cls(now, bool(is_running), (first, second, third, fourth))


def request(until: int, sensors: Sensors, channels: Sequence[int], *, runs_serial: bool) -> bytes:
    """Return the request to run the firmware up to a time.

    Args:
        until: time to which the firmware shall run, ns.
        sensors: state of the vehicle.
        channels: (16,) pulse widths of the channels of the remote control, µs.
        runs_serial: True if the firmware shall serve its serial ports.
    """
    time = until * _NS
    rates, force, quaternion, velocity, position, pressure = sensors
    motion = *rates, *force, *quaternion, *velocity, *position, pressure
    return _REQUEST.pack(until, 1, 1, runs_serial, 0, time, *motion, time, *channels)


def request_without_inputs(until: int) -> bytes:
    """Return the request to run the firmware up to a time (ns) without sensors and remote control."""
    return _REQUEST.pack(until, *[0] * 4, *[0.0] * 19, *[0] * NUM_CHANNELS)
