"""The laboratory: everything between a commanded wrench and a measured state."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from drake_quad.fleet import split_output


def build_laboratory(*, vehicle: Any, allocation: Any, motion_capture: Any, command_link: Any) -> Diagram:
    """Builds the diagram `laboratory` around a vehicle.

    The wrench goes through the command link to the allocation on board, whose rotor speeds the vehicle follows in
    still air; motion capture sees its state.

    .. pydrake_system::

        name: laboratory
        input_ports:
        - wrench
        - crashed
        output_ports:
        - measurement
        - state
        - rotor_speed
        - rotor_speed_command
        - shortfall
        - wind

    Args:
        vehicle: with input ports `rotor_speed_command`, `wind`, `crashed` and output ports `state`, `rotor_speed`.
        allocation: from `wrench` to `rotor_speed_command` and `shortfall`, packed.
        motion_capture: from `state` to `measurement`.
        command_link: from `wrench` to `wrench`.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("command_link", command_link)
    allocated = split_output(builder, "allocation", allocation)
    builder.AddNamedSystem("vehicle", vehicle)
    builder.AddNamedSystem("motion_capture", motion_capture)
    wind = builder.AddNamedSystem("wind", ConstantVectorSource(np.zeros(vehicle.GetInputPort("wind").size())))

    builder.Connect(command_link.GetOutputPort("wrench"), allocation.GetInputPort("wrench"))
    builder.Connect(allocated["rotor_speed_command"], vehicle.GetInputPort("rotor_speed_command"))
    builder.Connect(wind.get_output_port(), vehicle.GetInputPort("wind"))
    builder.Connect(vehicle.GetOutputPort("state"), motion_capture.GetInputPort("state"))

    builder.ExportInput(command_link.GetInputPort("wrench"), "wrench")
    builder.ExportInput(vehicle.GetInputPort("crashed"), "crashed")
    builder.ExportOutput(motion_capture.GetOutputPort("measurement"), "measurement")
    builder.ExportOutput(vehicle.GetOutputPort("state"), "state")
    builder.ExportOutput(vehicle.GetOutputPort("rotor_speed"), "rotor_speed")
    builder.ExportOutput(allocated["rotor_speed_command"], "rotor_speed_command")
    builder.ExportOutput(allocated["shortfall"], "shortfall")
    builder.ExportOutput(wind.get_output_port(), "wind")
    laboratory = builder.Build()
    laboratory.set_name("laboratory")
    return laboratory
