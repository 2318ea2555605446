"""Tests of the layout of messages, which the C structs in `lockstep.c` define."""

import struct

import pytest

from drake_quad.firmware.betaflight.messages import Reply, Sensors, request, request_without_inputs

SENSORS = Sensors((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), (7.0, 8.0, 9.0, 10.0), (11.0, 12.0, 13.0), (14.0, 15.0, 16.0), 17.0)
CHANNELS = list(range(1000, 1016))


def test_a_request_has_the_layout_of_the_struct():
    """A state packet has 18 doubles, and a packet of channels has a double and 16 unsigned shorts."""
    message = request(1_250_000, SENSORS, CHANNELS, runs_serial=True)
    assert len(message) == 8 + 4 * 4 + 18 * 8 + 8 + 16 * 2
    assert struct.unpack_from("<QIII", message) == (1_250_000, 1, 1, 1)
    assert struct.unpack_from("<18d", message, 24) == pytest.approx((0.00125, *range(1, 18)))
    assert struct.unpack_from("<d16H", message, 24 + 18 * 8) == pytest.approx((0.00125, *CHANNELS))


def test_a_request_without_inputs_has_the_same_size():
    message = request_without_inputs(7)
    assert len(message) == len(request(7, SENSORS, CHANNELS, runs_serial=False))
    assert message == struct.pack("<Q", 7) + bytes(len(message) - 8)


def test_the_motors_of_a_reply_are_in_the_order_of_their_numbers():
    """The simulator build sends motors 2, 3, 4 and 1."""
    reply = Reply.of(struct.pack("<QII4f", 2_000_000_000, 1, 1, 0.25, 0.5, 0.75, 1.0))
    assert reply == (2_000_000_000, True, (1.0, 0.25, 0.5, 0.75))
    assert Reply.of(b"x" * 31) is None
