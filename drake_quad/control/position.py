"""Position control (outer loop): from the position error to a commanded acceleration.

Equation numbers refer to Kayacan and Maslim (2016).
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.wiring import append, build, connect_inputs, split_output
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, PositionError, PositionErrorRate, Reference, State

Derivative = Literal["tracking_error", "measurement"]
# Highest derivative of the reference that is fed forward.
FeedForward = Literal["none", "acceleration", "jerk", "snap"]


class PdGains(NamedTuple):
    """Gains of the PD law.

    Attributes:
        k_p: gains on the position error, 1/s².
        k_d: gains on the rate of the position error, 1/s.
    """

    k_p: PerAxis
    k_d: PerAxis


class PdOutput(NamedTuple):
    """Signals of the PD law.

    Attributes:
        error: position error e.
        error_rate: rate ė of the position error, or minus the velocity.
        pd: command τ_c.
        feed_forward: reference acceleration if it is fed forward, else zero.
    """

    error: PositionError
    error_rate: PositionErrorRate
    pd: Acceleration
    feed_forward: Acceleration


def pd_law(
    measurement: State, reference: Reference, gains: PdGains, derivative: Derivative, feeds_forward: bool
) -> PdOutput:
    """Return the signals of the PD law τ_c = k_P e + k_D ė, eq (8) of the paper.

    Args:
        measurement: measured state of the vehicle.
        reference: reference.
        gains: gains on each axis.
        derivative: "tracking_error" or "measurement".
        feeds_forward: True if the acceleration of the reference is fed forward.
    """
    k_p, k_d = gains
    e_x, e_y, e_z = reference.x - measurement.x, reference.y - measurement.y, reference.z - measurement.z
    reference_fraction, acceleration_fraction = float(derivative == "tracking_error"), float(feeds_forward)
    v_x = reference_fraction * reference.v_x - measurement.v_x
    v_y = reference_fraction * reference.v_y - measurement.v_y
    v_z = reference_fraction * reference.v_z - measurement.v_z
    return PdOutput(
        error=PositionError(e_x, e_y, e_z),
        error_rate=PositionErrorRate(v_x, v_y, v_z),
        pd=Acceleration(k_p.x * e_x + k_d.x * v_x, k_p.y * e_y + k_d.y * v_y, k_p.z * e_z + k_d.z * v_z),
        feed_forward=Acceleration(
            acceleration_fraction * reference.a_x,
            acceleration_fraction * reference.a_y,
            acceleration_fraction * reference.a_z,
        ),
    )


@fleet_system(float, AutoDiffXd)
class ProportionalDerivative(FleetSystem):
    """The PD law, eq (8) of the paper.

    .. pydrake_system::

        name: ProportionalDerivative
        input_ports:
        - measurement
        - reference
        output_ports:
        - error_and_command

    The output contains all signals of `PdOutput`. The only parameter of the context is `gains`.

    Args:
        num_vehicles: number of vehicles N.
        derivative: "tracking_error" or "measurement".
        feeds_forward: True if the acceleration of the reference is fed forward.
        parameters: gains on each axis.
    """

    def declare(
        self, *, derivative: Derivative = "tracking_error", feeds_forward: bool = False, parameters: PdGains
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, reference = self.input("measurement"), self.input("reference")
        gains = self.parameter("gains", lambda gains: gains)
        reads = measurement, reference, gains, derivative, feeds_forward
        self.packed_output("error_and_command", PdOutput, pd_law, *reads)


def build_position_controller(
    pd: Any, *, integral: Any = None, disturbance: Any = None, takes_correction: bool = False
) -> Diagram:
    """Build the diagram `position`: command = `pd` - `correction` + feed-forward - `disturbance`.

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

    `error` is e = p_r - p in W. `error_rate` is ė = v_r - v with the derivative of the tracking error, and ė = -v with
    the derivative of the measurement. The input `correction`, for a network, exists if `takes_correction` is True. The
    output `correction` is the sum of the integral and the input `correction`. With this input and without an integral,
    there is no output `correction`. If there is an estimator, its `disturbance` is also subtracted, and is an output.

    Any system with the first two inputs and the first output can replace this diagram.

    Args:
        pd: a `ProportionalDerivative`.
        integral: system from `error` to `correction`, such as an `IntegralCorrection`.
        disturbance: a `DisturbanceEstimator` or a `TiltDisturbanceEstimator`.
        takes_correction: True if the diagram has the input `correction`.
    """
    builder = DiagramBuilder()
    parts = split_output(builder, "pd", pd)
    size = parts["pd"].size()
    summands = [parts["pd"], parts["feed_forward"]]
    outputs = {name: parts[name] for name in ("error", "error_rate", "pd")}
    connect_inputs(builder, [pd], exported=("measurement", "reference"))
    if integral is not None:
        outputs["correction"] = append(builder, "integral", integral, parts["error"])
    elif not takes_correction:
        outputs["correction"] = append(builder, "correction", ConstantVectorSource(np.zeros(size)))
    if integral is not None or takes_correction:
        negated = builder.AddNamedSystem("minus", Gain(-1.0, size))
        summands.append(negated.get_output_port())
        if takes_correction and integral is not None:
            total = Adder(2, size)
            outputs["correction"] = append(builder, "correction", total, outputs["correction"])
            builder.ExportInput(total.get_input_port(1), "correction")
        elif takes_correction:
            builder.ExportInput(negated.get_input_port(), "correction")
        if "correction" in outputs:
            builder.Connect(outputs["correction"], negated.get_input_port())
    if disturbance is not None:
        builder.AddNamedSystem("estimator", disturbance)
        outputs["disturbance"] = disturbance.GetOutputPort("disturbance")
        summands.append(append(builder, "minus_disturbance", Gain(-1.0, size), outputs["disturbance"]))
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
    for name, port in outputs.items():
        builder.ExportOutput(port, name)
    return build(builder, "position")
