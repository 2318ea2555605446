"""The outer loop: from the position error to a commanded acceleration."""

from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from drake_quad.compiled import formula
from drake_quad.elementary import Rows
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system, split_output

Derivative = Literal["tracking_error", "measurement"]
# Up to which derivative of the reference is fed forward.
FeedForward = Literal["none", "acceleration", "jerk", "snap"]


@formula
def pd_law(
    measurement: Rows, reference: Rows, gains: Rows, on_error: float, feed_forward: float
) -> tuple[Rows, Rows, Rows, Rows]:
    """Eq (8): the position error (m), its rate (m/s), the command τ_c and the feed-forward (m/s²), 3 rows each.

    Args:
        measurement: 12 rows, as the vehicle's state.
        reference: 11 rows.
        gains: k_P on X, Y, Z, then k_D.
        on_error: 1 for the derivative of the error, 0 for that of the measurement.
        feed_forward: share of the reference's acceleration.
    """
    p_x, p_y, p_z, d_x, d_y, d_z = gains
    e_x, e_y, e_z = reference[0] - measurement[0], reference[1] - measurement[1], reference[2] - measurement[2]
    v_x = on_error * reference[3] - measurement[6]
    v_y = on_error * reference[4] - measurement[7]
    v_z = on_error * reference[5] - measurement[8]
    return (
        (e_x, e_y, e_z),
        (v_x, v_y, v_z),
        (p_x * e_x + d_x * v_x, p_y * e_y + d_y * v_y, p_z * e_z + d_z * v_z),
        (feed_forward * reference[6], feed_forward * reference[7], feed_forward * reference[8]),
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

    The output packs `error`, `error_rate`, `pd` and `feed_forward`, 3 rows each. The gains are one numeric parameter of
    the context: k_P on X, Y, Z, then k_D on X, Y, Z.

    Args:
        num_vehicles: N.
        k_p: 3 rows, 1/s².
        k_d: 3 rows, 1/s.
        derivative: "tracking_error" or "measurement".
        feed_forward: whether the reference's acceleration is fed forward.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        k_p: Rows,
        k_d: Rows,
        derivative: Derivative = "tracking_error",
        feed_forward: bool = False,
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._on_error, self._feed_forward = float(derivative == "tracking_error"), float(feed_forward)
        self._law = self.mapped(pd_law, inputs=(12, 11, 6), outputs=(3, 3, 3, 3))
        self._gains = self.numeric_parameter([*k_p, *k_d])
        self._measurement = self.input("measurement", 12)
        self._reference = self.input("reference", 11)
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        parts = {"error": 3, "error_rate": 3, "pd": 3, "feed_forward": 3}
        self.packed_output("error_and_command", parts, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        inputs = self.inputs(context, self._measurement, self._reference)
        self._law([output], [*inputs, self.parameter(context, self._gains)], self._on_error, self._feed_forward)


def build_position_controller(pd: Any, *, correction: Any = None) -> Diagram:
    """Builds the diagram `position`, eq (14): command = `pd` - `correction` + feed-forward.

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

    `error` (3 rows, m) is e = p_r - p in W; `error_rate` (3 rows, m/s) is ė = v_r - v with the derivative on the
    tracking error, and ė = -v with the derivative on the measurement, which makes the loop lag by about (k_D / k_P)
    v; `pd` (3 rows, m/s²) is τ_c = k_P e + k_D ė. `measurement` has the 12 rows of the vehicle's state, `reference`
    11: position, velocity, acceleration, yaw, yaw rate. `correction` (3 rows, m/s²), τ_f, is zero without a system that
    makes it; what else such a system shows is shown beside it.

    Any system with these two inputs and the first output can stand in its place.

    Args:
        pd: a `ProportionalDerivative`.
        correction: a system from any of `error`, `error_rate` and `pd` to `correction`, such as a network that learns.
    """
    builder = DiagramBuilder()
    parts = split_output(builder, "pd", pd)
    size = 3 * pd.num_vehicles
    summands = [parts["pd"], parts["feed_forward"]]
    if correction is None:
        correction = builder.AddNamedSystem("correction", ConstantVectorSource(np.zeros(size)))
        shown = {"correction": correction.get_output_port()}
    else:
        builder.AddNamedSystem(correction.get_name(), correction)
        for i in range(correction.num_input_ports()):
            builder.Connect(parts[correction.get_input_port(i).get_name()], correction.get_input_port(i))
        outputs = [correction.get_output_port(i) for i in range(correction.num_output_ports())]
        shown = {port.get_name(): port for port in outputs}
        minus = builder.AddNamedSystem("minus", Gain(-1.0, size))
        builder.Connect(shown["correction"], minus.get_input_port())
        summands.append(minus.get_output_port())
    command = builder.AddNamedSystem("acceleration_command", Adder(len(summands), size))
    for i, port in enumerate(summands):
        builder.Connect(port, command.get_input_port(i))

    builder.ExportInput(pd.GetInputPort("measurement"), "measurement")
    builder.ExportInput(pd.GetInputPort("reference"), "reference")
    builder.ExportOutput(command.get_output_port(), "acceleration_command")
    for name, port in ({name: parts[name] for name in ("error", "error_rate", "pd")} | shown).items():
        builder.ExportOutput(port, name)
    position = builder.Build()
    position.set_name("position")
    return position
