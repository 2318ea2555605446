"""The cascade as one diagram: position control, thrust vectoring and, unless it is done on board, attitude control."""

from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from drake_quad.control.position import FeedForward
from drake_quad.framework.wiring import split_output

# What a position controller may show of its inside, beside its `acceleration_command`.
POSITION_SIGNALS = ("error", "error_rate", "pd", "correction", "disturbance", "weights", "covariance_trace")

# The signals that make an attitude target, in its order.
_TARGET = ("thrust", "attitude_command", "body_rate_command")


def build_cascade(*, position: Any, thrust_vectoring: Any, attitude: Any | None, feed_forward: FeedForward) -> Diagram:
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
    network; `reference_jerk` and `reference_snap` if they are fed forward. Without an attitude controller there is an
    `attitude_target` for the autopilot in place of the `wrench`.

    Args:
        position: from `measurement` and `reference` to `acceleration_command`.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an `AttitudeController`; None if an autopilot on board does its work.
        feed_forward: with "jerk" the body rates follow the reference's jerk; with "snap" the torques of an
            attitude controller its snap, too.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("position", position)
    commanded = split_output(builder, "thrust_vectoring", thrust_vectoring)
    if attitude is None:
        command, parts = "attitude_target", [commanded[name] for name in _TARGET]
    else:
        builder.AddNamedSystem("attitude", attitude)
        command, parts = "wrench", [commanded["thrust"], attitude.GetOutputPort("torque")]
    together = builder.AddNamedSystem(command, Multiplexer([part.size() for part in parts]))

    builder.ExportInput(position.GetInputPort("measurement"), "measurement")
    builder.ExportInput(position.GetInputPort("reference"), "reference")
    builder.ConnectInput("measurement", thrust_vectoring.GetInputPort("measurement"))
    if attitude is not None:
        builder.ConnectInput("measurement", attitude.GetInputPort("measurement"))
    builder.ConnectInput("reference", thrust_vectoring.GetInputPort("reference"))
    if feed_forward in ("jerk", "snap"):
        builder.ExportInput(thrust_vectoring.GetInputPort("reference_jerk"), "reference_jerk")
    if feed_forward == "snap":
        builder.ExportInput(thrust_vectoring.GetInputPort("reference_snap"), "reference_snap")

    acceleration_command = position.GetOutputPort("acceleration_command")
    builder.Connect(acceleration_command, thrust_vectoring.GetInputPort("acceleration_command"))
    if attitude is not None:
        for name in ("attitude_command", "body_rate_command", "angular_acceleration_command"):
            builder.Connect(commanded[name], attitude.GetInputPort(name))
    for i, part in enumerate(parts):
        builder.Connect(part, together.get_input_port(i))

    builder.ExportOutput(together.get_output_port(), command)
    builder.ExportOutput(acceleration_command, "acceleration_command")
    builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    for name in POSITION_SIGNALS:
        if position.HasOutputPort(name):
            builder.ExportOutput(position.GetOutputPort(name), name)
    control = builder.Build()
    control.set_name("control")
    return control
