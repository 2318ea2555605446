"""The cascade: position control, thrust vectoring and attitude control as one diagram."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Demultiplexer, Multiplexer

# What a position controller may show of its inside, beside its `acceleration_command`.
POSITION_SIGNALS = ("error", "error_rate", "pd", "correction")


def build_cascade(*, position: Any, thrust_vectoring: Any, attitude: Any, follow_jerk: bool) -> Diagram:
    """Builds the diagram `control`.

    .. pydrake_system::

        name: control
        input_ports:
        - measurement
        - reference
        - reference_jerk
        output_ports:
        - wrench
        - acceleration_command
        - attitude_command
        - error
        - error_rate
        - pd
        - correction

    The last four are there if the position controller has them, `reference_jerk` if it is followed.

    Args:
        position: from `measurement` and `reference` to `acceleration_command`.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an `AttitudeController`.
        follow_jerk: whether the attitude's rates follow the reference's jerk.
    """
    num_vehicles = thrust_vectoring.num_vehicles
    builder = DiagramBuilder()
    builder.AddNamedSystem("position", position)
    builder.AddNamedSystem("thrust_vectoring", thrust_vectoring)
    builder.AddNamedSystem("attitude", attitude)
    split = builder.AddNamedSystem("thrust_and_attitude", Demultiplexer(np.array([1, 3, 3]) * num_vehicles))
    wrench = builder.AddNamedSystem("wrench", Multiplexer([num_vehicles, 3 * num_vehicles]))
    thrust, attitude_command, attitude_rate_command = (split.get_output_port(i) for i in range(3))

    builder.ExportInput(position.GetInputPort("measurement"), "measurement")
    builder.ExportInput(position.GetInputPort("reference"), "reference")
    for system in (thrust_vectoring, attitude):
        builder.ConnectInput("measurement", system.GetInputPort("measurement"))
    builder.ConnectInput("reference", thrust_vectoring.GetInputPort("reference"))
    if follow_jerk:
        builder.ExportInput(thrust_vectoring.GetInputPort("reference_jerk"), "reference_jerk")

    acceleration_command = position.GetOutputPort("acceleration_command")
    builder.Connect(acceleration_command, thrust_vectoring.GetInputPort("acceleration_command"))
    builder.Connect(thrust_vectoring.GetOutputPort("thrust_and_attitude"), split.get_input_port())
    builder.Connect(attitude_command, attitude.GetInputPort("attitude_command"))
    builder.Connect(attitude_rate_command, attitude.GetInputPort("attitude_rate_command"))
    builder.Connect(thrust, wrench.get_input_port(0))
    builder.Connect(attitude.GetOutputPort("torque"), wrench.get_input_port(1))

    builder.ExportOutput(wrench.get_output_port(), "wrench")
    builder.ExportOutput(acceleration_command, "acceleration_command")
    builder.ExportOutput(attitude_command, "attitude_command")
    for name in POSITION_SIGNALS:
        if position.HasOutputPort(name):
            builder.ExportOutput(position.GetOutputPort(name), name)
    control = builder.Build()
    control.set_name("control")
    return control
