"""The cascade: position control, thrust vectoring and attitude control as one diagram."""

from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from drake_quad.control.position import FeedForward
from drake_quad.framework.wiring import split_output

# What a position controller may show of its inside, beside its `acceleration_command`.
POSITION_SIGNALS = ("error", "error_rate", "pd", "correction", "weights", "covariance_trace")


def build_cascade(*, position: Any, thrust_vectoring: Any, attitude: Any, feed_forward: FeedForward) -> Diagram:
    """Builds the diagram `control`.

    .. pydrake_system::

        name: control
        input_ports:
        - measurement
        - reference
        - reference_jerk
        - reference_snap
        output_ports:
        - wrench
        - acceleration_command
        - attitude_command
        - error
        - error_rate
        - pd
        - correction

    The last four are there if the position controller has them, and so are `weights` and `covariance_trace` of a
    network; `reference_jerk` and `reference_snap` if they are fed forward.

    Args:
        position: from `measurement` and `reference` to `acceleration_command`.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an `AttitudeController`.
        feed_forward: with "jerk" the body rates follow the reference's jerk; with "snap" the torques its snap, too.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("position", position)
    commanded = split_output(builder, "thrust_vectoring", thrust_vectoring)
    builder.AddNamedSystem("attitude", attitude)
    parts = commanded["thrust"], attitude.GetOutputPort("torque")
    wrench = builder.AddNamedSystem("wrench", Multiplexer([part.size() for part in parts]))

    builder.ExportInput(position.GetInputPort("measurement"), "measurement")
    builder.ExportInput(position.GetInputPort("reference"), "reference")
    for system in (thrust_vectoring, attitude):
        builder.ConnectInput("measurement", system.GetInputPort("measurement"))
    builder.ConnectInput("reference", thrust_vectoring.GetInputPort("reference"))
    if feed_forward in ("jerk", "snap"):
        builder.ExportInput(thrust_vectoring.GetInputPort("reference_jerk"), "reference_jerk")
    if feed_forward == "snap":
        builder.ExportInput(thrust_vectoring.GetInputPort("reference_snap"), "reference_snap")

    acceleration_command = position.GetOutputPort("acceleration_command")
    builder.Connect(acceleration_command, thrust_vectoring.GetInputPort("acceleration_command"))
    for name in ("attitude_command", "body_rate_command", "angular_acceleration_command"):
        builder.Connect(commanded[name], attitude.GetInputPort(name))
    for i, part in enumerate(parts):
        builder.Connect(part, wrench.get_input_port(i))

    builder.ExportOutput(wrench.get_output_port(), "wrench")
    builder.ExportOutput(acceleration_command, "acceleration_command")
    builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    for name in POSITION_SIGNALS:
        if position.HasOutputPort(name):
            builder.ExportOutput(position.GetOutputPort(name), name)
    control = builder.Build()
    control.set_name("control")
    return control
