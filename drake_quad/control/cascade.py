"""Diagram of the cascade: position control, an optional fuzzy network, thrust vectoring and attitude control.

With an autopilot on board, the cascade contains no attitude control.
"""

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from drake_quad.control.position import FeedForward
from drake_quad.framework.wiring import append, build, connect_inputs, split_output

# Optional outputs of a position controller or of a network.
POSITION_SIGNALS = (
    "error",
    "error_rate",
    "pd",
    "correction",
    "disturbance",
    "weights",
    "covariance_trace",
    "antecedents",
)

# Inputs of the cascade in addition to the reference, for each type of feed-forward.
_FEED_FORWARD_PORTS = {"jerk": ("reference_jerk",), "snap": ("reference_jerk", "reference_snap")}
# Signals that form `attitude_target`, in the order of its components.
_ATTITUDE_TARGET_PARTS = ("thrust", "attitude_command", "body_rate_command")


def build_cascade(
    *, position: Any, network: Any | None = None, thrust_vectoring: Any, attitude: Any | None, feed_forward: FeedForward
) -> Diagram:
    """Build the diagram `control`.

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

    The last four outputs exist if they are outputs of the position controller or the network. The same holds for the
    output `disturbance` of an estimator, and for the outputs `weights`, `covariance_trace` and `antecedents` of a
    network. The inputs `reference_jerk` and `reference_snap` exist if these signals are fed forward. Without an
    attitude controller, the output `attitude_target`, for the autopilot, replaces `wrench`.

    Args:
        position: system from `measurement` and `reference` to `acceleration_command`.
        network: network whose correction the position controller subtracts; None without a network.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an attitude controller; None if an autopilot on board controls the attitude.
        feed_forward: with "jerk", the jerk of the reference is fed forward to the body rates; with "snap", the snap of
            the reference is also fed forward to the angular accelerations.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("position", position)
    commanded = split_output(builder, "thrust_vectoring", thrust_vectoring)
    systems = [position, thrust_vectoring]
    if attitude is not None:
        systems.append(builder.AddNamedSystem("attitude", attitude))
    acceleration_command = position.GetOutputPort("acceleration_command")
    exported = ("measurement", "reference", *_FEED_FORWARD_PORTS.get(feed_forward, ()))
    connect_inputs(builder, systems, {"acceleration_command": acceleration_command}, exported)
    builder.ExportOutput(*connect_inner_loop(builder, commanded, attitude))
    builder.ExportOutput(acceleration_command, "acceleration_command")
    builder.ExportOutput(commanded["attitude_command"], "attitude_command")
    if network is not None:
        add_network(builder, position, network)
    for name in POSITION_SIGNALS:
        source = next((each for each in (position, network) if each is not None and each.HasOutputPort(name)), None)
        if source is not None:
            builder.ExportOutput(source.GetOutputPort(name), name)
    return build(builder, "control")


def connect_inner_loop(builder: DiagramBuilder, commanded: Mapping[str, Any], attitude: Any | None) -> tuple[Any, str]:
    """Connect the attitude controller, if any, and return the port and the name of the command to the vehicle.

    The command is a `wrench`, or an `attitude_target` for an autopilot on board.

    Args:
        builder: builder that already contains the attitude controller, if there is one.
        commanded: ports of the signals of `VectoringOutput`, by name.
        attitude: attitude controller; None if an autopilot on board controls the attitude.
    """
    if attitude is None:
        name, parts = "attitude_target", [commanded[part] for part in _ATTITUDE_TARGET_PARTS]
    else:
        connect_inputs(builder, [attitude], commanded)
        name, parts = "wrench", [commanded["thrust"], attitude.GetOutputPort("torque")]
    return append(builder, name, Multiplexer([part.size() for part in parts]), *parts), name


def add_network(builder: DiagramBuilder, controller: Any, network: Any) -> None:
    """Add a network and connect it to a controller, whose outputs it observes and whose command it corrects.

    Args:
        builder: builder that contains the controller and has the input `measurement`.
        controller: system with the input `correction` and, optionally, `learned_disturbance`. For each input of the
            network except `measurement`, it must have an output of the same name; `disturbance` is optional.
        network: network to add.
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
        has_separate_output = network.HasOutputPort("learned_disturbance")
        learned = network.GetOutputPort("learned_disturbance") if has_separate_output else correction
        builder.Connect(learned, controller.GetInputPort("learned_disturbance"))
