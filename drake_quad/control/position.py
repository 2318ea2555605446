"""The outer loop: from the position error to a commanded acceleration."""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.wiring import append, build, connect_inputs, split_output
from drake_quad.geometry.per_axis import PerAxis
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


def build_position_controller(
    pd: Any, *, integral: Any = None, disturbance: Any = None, takes_correction: bool = False
) -> Diagram:
    """Builds the diagram `position`, eq (14): command = `pd` - `correction` + feed-forward - `disturbance`.

    .. pydrake_system::

        name: position
        input_ports:
        - measurement
        - reference
        - correction
        output_ports:
        - acceleration_command
        - error
        - error_rate
        - pd
        - correction

    `error` is e = p_r - p in W; `error_rate` is ė = v_r - v with the derivative on the tracking error, and ė = -v with
    it on the measurement. The input `correction` is there if it is taken, as from a network. The output shows all that
    is subtracted; nothing but the input it does not show again. An estimator's `disturbance` is taken away likewise,
    and shown if there is one.

    Any system with the first two inputs and the first output can stand in its place.

    Args:
        pd: a `ProportionalDerivative`.
        integral: a system from `error` to `correction`, such as an `IntegralCorrection`.
        disturbance: a `DisturbanceEstimator` or a `TiltDisturbanceEstimator`.
        takes_correction: whether something is subtracted that comes from outside.
    """
    builder = DiagramBuilder()
    parts = split_output(builder, "pd", pd)
    size = parts["pd"].size()
    summands = [parts["pd"], parts["feed_forward"]]
    shown = {name: parts[name] for name in ("error", "error_rate", "pd")}
    connect_inputs(builder, [pd], exported=("measurement", "reference"))
    if integral is not None:
        shown["correction"] = append(builder, "integral", integral, parts["error"])
    elif not takes_correction:
        shown["correction"] = append(builder, "correction", ConstantVectorSource(np.zeros(size)))
    if integral is not None or takes_correction:
        minus = builder.AddNamedSystem("minus", Gain(-1.0, size))
        summands.append(minus.get_output_port())
        if takes_correction and integral is not None:
            both = Adder(2, size)
            shown["correction"] = append(builder, "correction", both, shown["correction"])
            builder.ExportInput(both.get_input_port(1), "correction")
        elif takes_correction:
            builder.ExportInput(minus.get_input_port(), "correction")
        if "correction" in shown:
            builder.Connect(shown["correction"], minus.get_input_port())
    if disturbance is not None:
        builder.AddNamedSystem("estimator", disturbance)
        shown["disturbance"] = disturbance.GetOutputPort("disturbance")
        summands.append(append(builder, "minus_disturbance", Gain(-1.0, size), shown["disturbance"]))
    command = append(builder, "acceleration_command", Adder(len(summands), size), *summands)
    if disturbance is not None:
        builder.ConnectInput("measurement", disturbance.GetInputPort("measurement"))
        sources = {"acceleration_command": command, "feed_forward": parts["feed_forward"]}
        connect_inputs(builder, [disturbance], sources)
        if takes_correction and disturbance.HasInputPort("learned_disturbance"):
            builder.ExportInput(disturbance.GetInputPort("learned_disturbance"), "learned_disturbance")
        elif takes_correction:
            builder.ConnectInput("correction", disturbance.GetInputPort("correction"))

    builder.ExportOutput(command, "acceleration_command")
    for name, port in shown.items():
        builder.ExportOutput(port, name)
    return build(builder, "position")
