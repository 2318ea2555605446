"""MAVLink messages between PX4 and an external simulator."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drake_quad.extras import import_extra
from drake_quad.firmware.remote_control import Motion

# Place of the origin of W: PX4's usual place for simulations, near Zurich. The heights are above mean sea level.
_LATITUDE, _LONGITUDE, _HEIGHT = 47.397742, 8.545594, 488.0  # °, °, m
_EARTH_RADIUS = 6_371_000.0  # m; mean radius
# Magnetic field of the earth at this place, north, east and down: about 0.48 G, with an inclination of
# 63.5° and a declination of 3°.
_MAGNETIC_FIELD = (0.2139, 0.0112, 0.4296)  # G
_TEMPERATURE = 25.0  # °C
# Standard deviations of noise, much smaller than that of real sensors. PX4 considers a sensor as defective if its
# readings do not change, as on a vehicle that rests.
_NOISE = np.repeat([0.01, 0.0005, 0.0005, 0.005], [3, 3, 3, 1])  # m/s², rad/s, G, hPa
_ALL_FIELDS = 0b1_1011_1111_1111  # of HIL_SENSOR, except for the differential pressure
_FIX_3D = 3
_NUM_SATELLITES = 12
_POSITION_ACCURACY = 30  # cm; an assumption, since the position is exact
_UNKNOWN = 65_535
NUM_MOTORS = 4
"""Number of actuator controls that are motors."""


class Px4Messages:
    """Encoder and decoder of the messages between PX4 and an external simulator.

    Args:
        seed: seed of the noise.

    Raises:
        ImportError: if the library pymavlink is not installed.
    """

    def __init__(self, seed: int) -> None:
        self._mavlink = import_extra("pymavlink.dialects.v20.common", "px4")
        self._encoder = self._mavlink.MAVLink(
            None, srcSystem=1, srcComponent=self._mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        )
        self._decoder = self._mavlink.MAVLink(None)
        self._decoder.robust_parsing = True
        self._noise = np.random.default_rng(seed)

    def sensors(self, microseconds: int, motion: Motion) -> bytes:
        """Return the message HIL_SENSOR with the readings of inertial sensors, magnetometer and barometer."""
        exact = (*motion.accel_body, *motion.gyro, *magnetic_field(motion.quaternion), 0.01 * motion.pressure)
        *readings, pressure = (exact + _NOISE * self._noise.standard_normal(len(_NOISE))).tolist()
        return self._packed(
            self._mavlink.MAVLink_hil_sensor_message(
                microseconds, *readings, pressure, 0.0, -motion.position[2], _TEMPERATURE, _ALL_FIELDS
            )
        )

    def satellites(self, microseconds: int, motion: Motion) -> bytes:
        """Return the message HIL_GPS with the exact position and velocity of the vehicle."""
        north, east, down = motion.position
        latitude = _LATITUDE + math.degrees(north / _EARTH_RADIUS)
        longitude = _LONGITUDE + math.degrees(east / (_EARTH_RADIUS * math.cos(math.radians(_LATITUDE))))
        return self._packed(
            self._mavlink.MAVLink_hil_gps_message(
                microseconds,
                _FIX_3D,
                round(1e7 * latitude),
                round(1e7 * longitude),
                round(1e3 * (_HEIGHT - down)),
                _POSITION_ACCURACY,
                _POSITION_ACCURACY,
                round(100.0 * math.hypot(*motion.velocity[:2])),
                *[round(100.0 * each) for each in motion.velocity],
                _UNKNOWN,
                _NUM_SATELLITES,
            )
        )

    def channels(self, microseconds: int, channels: Sequence[int]) -> bytes:
        """Return the message RC_CHANNELS with the pulse widths of the channels from 1 on, µs."""
        unused = [_UNKNOWN] * (18 - len(channels))
        return self._packed(
            self._mavlink.MAVLink_rc_channels_message(microseconds // 1000, len(channels), *channels, *unused, 255)
        )

    def motors(self, data: bytes) -> list[tuple[int, tuple[float, ...]]]:
        """Return time (µs) and commands of motors 1 to 4 of all complete messages HIL_ACTUATOR_CONTROLS.

        Bytes of an incomplete message are kept for the next call; other messages are ignored.
        """
        return [
            (message.time_usec, tuple(message.controls[:NUM_MOTORS]))
            for message in self._decoder.parse_buffer(data) or []
            if message.get_type() == "HIL_ACTUATOR_CONTROLS"
        ]

    def _packed(self, message: Any) -> bytes:
        packed: bytes = message.pack(self._encoder)
        return packed


def magnetic_field(quaternion: tuple[float, float, float, float]) -> tuple[float, ...]:
    """Return the magnetic field of the earth in the axes of the body, G.

    Args:
        quaternion: rotation from the axes of the body to north, east and down.
    """
    w, x, y, z = quaternion
    north, east, down = _MAGNETIC_FIELD
    # v' = v + 2 q × (q × v + w v), with the vector part of the inverse rotation.
    x, y, z = -x, -y, -z
    a, b, c = y * down - z * east + w * north, z * north - x * down + w * east, x * east - y * north + w * down
    return north + 2.0 * (y * c - z * b), east + 2.0 * (z * a - x * c), down + 2.0 * (x * b - y * a)
