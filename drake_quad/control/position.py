"""The outer loop: from the position error to a commanded acceleration."""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from drake_quad.control.axes import PerAxis
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.wiring import split_output
from drake_quad.signals import Acceleration, PositionError, PositionErrorRate, Reference, State

Derivative = Literal["tracking_error", "measurement"]
# Up to which derivative of the reference is fed forward.
FeedForward = Literal["none", "acceleration", "jerk", "snap"]


class PdGains(NamedTuple):
    """Gains of the PD law.

    Attributes:
        k_p: on the position error, 1/s².
        k_d: on its rate, 1/s.
    """

    k_p: PerAxis
    k_d: PerAxis


class PdOutput(NamedTuple):
    """What the PD law makes of measurement and reference.

    Attributes:
        error: e.
        error_rate: ė, or minus the velocity.
        pd: the command τ_c.
        feed_forward: of the reference's acceleration.
    """

    error: PositionError
    error_rate: PositionErrorRate
    pd: Acceleration
    feed_forward: Acceleration


def pd_law(
    measurement: State, reference: Reference, gains: PdGains, derivative: Derivative, feeds_forward: bool
) -> PdOutput:
    """Eq (8): τ_c = k_P e + k_D ė.

    Args:
        measurement: of the vehicle's state.
        reference: to follow.
        gains: on each axis.
        derivative: "tracking_error" or "measurement".
        feeds_forward: whether the reference's acceleration is fed forward.
    """
    k_p, k_d = gains
    e_x, e_y, e_z = reference.x - measurement.x, reference.y - measurement.y, reference.z - measurement.z
    of_reference, share = float(derivative == "tracking_error"), float(feeds_forward)
    v_x = of_reference * reference.v_x - measurement.v_x
    v_y = of_reference * reference.v_y - measurement.v_y
    v_z = of_reference * reference.v_z - measurement.v_z
    return PdOutput(
        error=PositionError(e_x, e_y, e_z),
        error_rate=PositionErrorRate(v_x, v_y, v_z),
        pd=Acceleration(k_p.x * e_x + k_d.x * v_x, k_p.y * e_y + k_d.y * v_y, k_p.z * e_z + k_d.z * v_z),
        feed_forward=Acceleration(share * reference.a_x, share * reference.a_y, share * reference.a_z),
    )


@fleet_system(float, AutoDiffXd)
class ProportionalDerivative(FleetSystem):
    """The PD law, eq (8).

    .. pydrake_system::

        name: ProportionalDerivative
        input_ports:
        - measurement
        - reference
        output_ports:
        - error_and_command

    The output packs the signals of `PdOutput`. The only parameter of the context is `gains`.

    Args:
        num_vehicles: N.
        derivative: "tracking_error" or "measurement".
        feeds_forward: whether the reference's acceleration is fed forward.
        numbers: the gains.
    """

    def declare(
        self, *, derivative: Derivative = "tracking_error", feeds_forward: bool = False, numbers: PdGains
    ) -> None:
        """Declares the system."""
        measurement, reference = self.input("measurement"), self.input("reference")
        gains = self.parameter("gains", lambda gains: gains)
        reads = measurement, reference, gains, derivative, feeds_forward
        self.packed_output("error_and_command", PdOutput, pd_law, *reads)


def build_position_controller(pd: Any, *, correction: Any = None, disturbance: Any = None) -> Diagram:
    """Builds the diagram `position`, eq (14): command = `pd` - `correction` + feed-forward - `disturbance`.

    .. pydrake_system::

        name: position
        input_ports:
        - measurement
        - reference
        output_ports:
        - acceleration_command
        - error
        - error_rate
        - pd
        - correction

    `error` is e = p_r - p in W; `error_rate` is ė = v_r - v with the derivative on the tracking error, and ė = -v with
    the derivative on the measurement, which makes the loop lag by about (k_D / k_P) v; `pd` is τ_c = k_P e + k_D ė.
    `correction`, τ_f, is zero without a system that makes it; what else such a system shows is shown beside it. An
    estimator's `disturbance` is taken away likewise, and shown if there is one.

    Any system with these two inputs and the first output can stand in its place.

    Args:
        pd: a `ProportionalDerivative`.
        correction: a system from any of `error`, `error_rate` and `pd` to `correction`, such as a network that learns.
        disturbance: a `DisturbanceEstimator` or a `TiltDisturbanceEstimator`.
    """
    builder = DiagramBuilder()
    parts = split_output(builder, "pd", pd)
    size = parts["pd"].size()
    summands = [parts["pd"], parts["feed_forward"]]
    if correction is None:
        correction = builder.AddNamedSystem("correction", ConstantVectorSource(np.zeros(size)))
        shown = {"correction": correction.get_output_port()}
    else:
        builder.AddNamedSystem(correction.get_name(), correction)
        for signal in ("error", "error_rate", "pd"):
            if correction.HasInputPort(signal):
                builder.Connect(parts[signal], correction.GetInputPort(signal))
        outputs = [correction.get_output_port(i) for i in range(correction.num_output_ports())]
        shown = {port.get_name(): port for port in outputs}
        summands.append(_minus(builder, "minus", shown["correction"]))
    if disturbance is not None:
        builder.AddNamedSystem("estimator", disturbance)
        shown["disturbance"] = disturbance.GetOutputPort("disturbance")
        summands.append(_minus(builder, "minus_disturbance", shown["disturbance"]))
    command = builder.AddNamedSystem("acceleration_command", Adder(len(summands), size))
    for i, port in enumerate(summands):
        builder.Connect(port, command.get_input_port(i))
    if disturbance is not None:
        known = {"acceleration_command": command.get_output_port(), "feed_forward": parts["feed_forward"]}
        for name, port in (known | {"correction": shown["correction"]}).items():
            if disturbance.HasInputPort(name):
                builder.Connect(port, disturbance.GetInputPort(name))

    builder.ExportInput(pd.GetInputPort("measurement"), "measurement")
    builder.ExportInput(pd.GetInputPort("reference"), "reference")
    if disturbance is not None:
        builder.ConnectInput("measurement", disturbance.GetInputPort("measurement"))
    builder.ExportOutput(command.get_output_port(), "acceleration_command")
    for name, port in ({name: parts[name] for name in ("error", "error_rate", "pd")} | shown).items():
        builder.ExportOutput(port, name)
    position = builder.Build()
    position.set_name("position")
    return position


def _minus(builder: DiagramBuilder, name: str, port: Any) -> Any:
    """A port that shows another with its sign turned."""
    gain = builder.AddNamedSystem(name, Gain(-1.0, port.size()))
    builder.Connect(port, gain.get_input_port())
    return gain.get_output_port()
