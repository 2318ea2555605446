"""Tests of the system that advances firmware, with flight controllers in Python."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad.firmware.controller import FirmwareError
from drake_quad.firmware.system import FirmwareInTheLoop


class Hover:
    """Flight controller whose motors have a constant command."""

    def __init__(self):
        self.initial_commands = (0.3,) * 4
        self.is_closed = False

    def send(self, inputs):
        pass

    def receive(self):
        return (0.5,) * 4

    def close(self):
        self.is_closed = True


def test_the_firmware_of_all_vehicles_is_stopped_if_that_of_one_does_not_start():
    started = []

    def start(vehicle, inputs):
        if vehicle == 2:
            raise FirmwareError("it does not arm")
        started.append(Hover())
        return started[-1]

    system = FirmwareInTheLoop(
        3, period=0.01, input_name="readings", num_inputs=2, command="throttle_command", start=start
    )
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, np.zeros(6))
    with pytest.raises(FirmwareError, match="it does not arm"):
        Simulator(system, context).Initialize()
    assert [each.is_closed for each in started] == [True, True]
    assert system.processor is None
