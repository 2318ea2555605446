"""The cascade as one diagram: position control, perhaps a network, thrust vectoring and, unless on board, attitude."""

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from drake_quad.control.position import FeedForward
from drake_quad.framework.wiring import append, build, connect_inputs, split_output

# What a position controller, and then a network around it, may show beside what they command.
POSITION_SIGNALS = (
    *("error", "error_rate", "pd", "correction", "disturbance"),
    *("weights", "covariance_trace", "antecedents"),
)

# The derivatives of the reference that are fed forward beside its acceleration.
_DERIVATIVES = {"jerk": ("reference_jerk",), "snap": ("reference_jerk", "reference_snap")}
# The signals that make an attitude target, in its order.
_TARGET = ("thrust", "attitude_command", "body_rate_command")


def build_cascade(
    *, position: Any, network: Any | None = None, thrust_vectoring: Any, attitude: Any | None, feed_forward: FeedForward
) -> Diagram:
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

    The last four are there if the position controller or the network has them, and so are the `disturbance` of an
    estimator, and `weights` and `covariance_trace` of a network; `reference_jerk` and `reference_snap` if they are fed
    forward. Without an attitude controller there is an `attitude_target` for the autopilot in place of the `wrench`.

    Args:
        position: from `measurement` and `reference` to `acceleration_command`.
        network: that stands around the position controller, which takes its correction, if any.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an `AttitudeController`; None if an autopilot on board does its work.
        feed_forward: with "jerk" the body rates follow the reference's jerk; with "snap" the torques of an
            attitude controller its snap, too.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("position", position)
    commanded = split_output(builder, "thrust_vectoring", thrust_vectoring)
    systems = [position, thrust_vectoring]
    if attitude is not None:
        systems.append(builder.AddNamedSystem("attitude", attitude))
    acceleration_command = position.GetOutputPort("acceleration_command")
    exported = ("measurement", "reference", *_DERIVATIVES.get(feed_forward, ()))
    connect_inputs(builder, systems, {"acceleration_command": acceleration_command}, exported)
    builder.ExportOutput(*command_of(builder, commanded, attitude))
    builder.ExportOutput(acceleration_command, "acceleration_command")
    builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    if network is not None:
        put_around(builder, position, network)
    for name in POSITION_SIGNALS:
        source = next((each for each in (position, network) if each is not None and each.HasOutputPort(name)), None)
        if source is not None:
            builder.ExportOutput(source.GetOutputPort(name), name)
    return build(builder, "control")


def command_of(builder: DiagramBuilder, commanded: Mapping[str, Any], attitude: Any | None) -> tuple[Any, str]:
    """What goes over the link for a commanded thrust and attitude: a port of the builder, and its name.

    Args:
        builder: with the attitude controller, if there is one.
        commanded: the ports of `Vectored`, by name.
        attitude: an attitude controller; None if an autopilot on board does its work, which gets an `attitude_target`.
    """
    if attitude is None:
        name, parts = "attitude_target", [commanded[part] for part in _TARGET]
    else:
        connect_inputs(builder, [attitude], commanded)
        name, parts = "wrench", [commanded["thrust"], attitude.GetOutputPort("torque")]
    return append(builder, name, Multiplexer([part.size() for part in parts]), *parts), name


def put_around(builder: DiagramBuilder, controller: Any, network: Any) -> None:
    """Adds a network around a controller: it sees what the controller shows and measures, and corrects its command.

    Args:
        builder: with the controller, and with the input `measurement`.
        controller: with the input `correction`, perhaps `learned_disturbance`, and outputs for all of the network's
            inputs but the measurement and perhaps the `disturbance`.
        network: to add.
    """
    builder.AddNamedSystem("network", network)
    for port in map(network.get_input_port, range(network.num_input_ports())):
        if port.get_name() == "measurement":
            builder.ConnectInput("measurement", port)
        elif port.get_name() != "disturbance" or controller.HasOutputPort("disturbance"):
            builder.Connect(controller.GetOutputPort(port.get_name()), port)
    correction = network.GetOutputPort("correction")
    builder.Connect(correction, controller.GetInputPort("correction"))
    if controller.HasInputPort("learned_disturbance"):
        leads = network.HasOutputPort("learned_disturbance")
        learned = network.GetOutputPort("learned_disturbance") if leads else correction
        builder.Connect(learned, controller.GetInputPort("learned_disturbance"))
