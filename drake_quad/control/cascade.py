"""The cascade as a diagram: position control, an optional network, thrust vectoring and attitude control.

An autopilot on board replaces attitude control.
"""

from collections.abc import Mapping
from typing import Any

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Multiplexer

from drake_quad.control.position import FeedForward
from drake_quad.framework.wiring import append, build, connect_inputs, split_output

# Optional outputs of a position controller, and of a network around it.
POSITION_SIGNALS = (
    *("error", "error_rate", "pd", "correction", "disturbance"),
    *("weights", "covariance_trace", "antecedents"),
)

# Optional inputs of the cascade for each kind of feed-forward, in addition to the reference.
_FEED_FORWARD_PORTS = {"jerk": ("reference_jerk",), "snap": ("reference_jerk", "reference_snap")}
# Parts of the signal `attitude_target`, in its order.
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

    The last four outputs exist if the position controller or the network has them. The same holds for the `disturbance`
    of an estimator, and for `weights` and `covariance_trace` of a network. `reference_jerk` and `reference_snap` exist
    if they are fed forward. Without an attitude controller the diagram has the output `attitude_target`, for the
    autopilot, instead of `wrench`.

    Args:
        position: system from `measurement` and `reference` to `acceleration_command`.
        network: network around the position controller, which subtracts the network's correction; None without one.
        thrust_vectoring: a `ThrustVectoring`.
        attitude: an `AttitudeController`; None if an autopilot on board controls the attitude.
        feed_forward: with "jerk" the body rates follow the jerk of the reference; with "snap" the torques of an
            attitude controller also follow its snap.
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
    """Connect the attitude controller, if any, and return the port of the command to the vehicle, and its name.

    The command is a `wrench`, or an `attitude_target` for an autopilot on board.

    Args:
        builder: builder that already contains the attitude controller, if there is one.
        commanded: ports of the signals of `Vectored`, by name.
        attitude: attitude controller; None if an autopilot on board controls the attitude.
    """
    if attitude is None:
        name, parts = "attitude_target", [commanded[part] for part in _ATTITUDE_TARGET_PARTS]
    else:
        connect_inputs(builder, [attitude], commanded)
        name, parts = "wrench", [commanded["thrust"], attitude.GetOutputPort("torque")]
    return append(builder, name, Multiplexer([part.size() for part in parts]), *parts), name


def add_network(builder: DiagramBuilder, controller: Any, network: Any) -> None:
    """Add a network that reads the outputs of a controller, and connect its correction to the controller.

    Args:
        builder: builder that contains the controller and has the input `measurement`.
        controller: system with the input `correction` and, optionally, `learned_disturbance`. It must have an output
            for each of the network's inputs except `measurement` and, optionally, `disturbance`.
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
