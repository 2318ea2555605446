"""The outer loop: from the position error to a commanded acceleration."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Demultiplexer, Gain

from drake_quad.elementary import Row
from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system

Derivative = Literal["tracking_error", "measurement"]
FeedForward = Literal["none", "acceleration", "jerk"]


@fleet_system(float, AutoDiffXd)
class TrackingError(FleetSystem):
    """The error of the measured position and its rate, in W.

    .. pydrake_system::

        name: TrackingError
        input_ports:
        - measurement
        - reference
        output_ports:
        - error
        - error_rate

    `error` (3 rows, m) is e = p_r - p; `error_rate` (3 rows, m/s) is ė = v_r - v with the derivative on the tracking
    error, and ė = -v with the derivative on the measurement, which makes the loop lag by about (k_D / k_P) v.
    `measurement` has the 12 rows of the vehicle's state, `reference` 11: position, velocity, acceleration, yaw,
    yaw rate.

    Args:
        num_vehicles: N.
        derivative: "tracking_error" or "measurement".
    """

    def declare(self, *, num_vehicles: int = 1, derivative: Derivative = "tracking_error") -> None:
        """Declares the system; see the class for the arguments."""
        self._measurement = self.input("measurement", 12)
        self._reference = self.input("reference", 11)
        uses = {self.all_input_ports_ticket()}
        self.output("error", 3, self._calc_error, uses=uses)
        on_error = derivative == "tracking_error"
        self.output("error_rate", 3, self._calc_rate if on_error else self._calc_damping, uses=uses)

    def _calc_error(self, context: Any, output: Any) -> None:
        measurement, reference = self._rows(context)
        self.write(output, [wanted - actual for wanted, actual in zip(reference[0:3], measurement[0:3], strict=True)])

    def _calc_rate(self, context: Any, output: Any) -> None:
        measurement, reference = self._rows(context)
        self.write(output, [wanted - actual for wanted, actual in zip(reference[3:6], measurement[6:9], strict=True)])

    def _calc_damping(self, context: Any, output: Any) -> None:
        self.write(output, [-velocity for velocity in self._rows(context)[0][6:9]])

    def _rows(self, context: Any) -> tuple[Any, Any]:
        return self.input_rows(context, self._measurement), self.input_rows(context, self._reference)


@fleet_system(float, AutoDiffXd)
class ProportionalDerivative(FleetSystem):
    """The PD law, eq (8): τ_c = k_P e + k_D ė on each of X, Y, Z.

    .. pydrake_system::

        name: ProportionalDerivative
        input_ports:
        - error
        - error_rate
        output_ports:
        - pd

    `error` (m), `error_rate` (m/s) and `pd` (m/s²) have 3 rows. The gains are one numeric parameter of the context:
    k_P on X, Y, Z, then k_D on X, Y, Z.

    Args:
        num_vehicles: N.
        k_p: 3 rows, 1/s².
        k_d: 3 rows, 1/s.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        k_p: Sequence[Row] = (1.0, 1.0, 1.0),
        k_d: Sequence[Row] = (1.0, 1.0, 1.0),
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self._gains = self.numeric_parameter([*k_p, *k_d])
        self._error = self.input("error", 3)
        self._error_rate = self.input("error_rate", 3)
        uses = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.output("pd", 3, self._calc, uses=uses)

    def _calc(self, context: Any, output: Any) -> None:
        gains = self.parameter_rows(context, self._gains)
        error = self.input_rows(context, self._error)
        error_rate = self.input_rows(context, self._error_rate)
        terms = zip(gains[:3], error, gains[3:], error_rate, strict=True)
        self.write(output, [k_p * e + k_d * e_dot for k_p, e, k_d, e_dot in terms])


def build_position_controller(
    *,
    num_vehicles: int = 1,
    k_p: Sequence[Row],
    k_d: Sequence[Row],
    derivative: Derivative = "tracking_error",
    feed_forward: FeedForward = "none",
) -> Diagram:
    """Builds the diagram `position`, a PD position controller: command = `pd` - `correction` (+ reference).

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

    `correction` is zero here. Any system with these two inputs and the first output can stand in its place.

    Args:
        num_vehicles: N.
        k_p: 3 rows, 1/s².
        k_d: 3 rows, 1/s.
        derivative: "tracking_error" or "measurement".
        feed_forward: "none", or else the reference's acceleration is added to the command. "jerk" is no more than
            that here; it is thrust vectoring that makes something of the jerk.
    """
    builder = DiagramBuilder()
    error = builder.AddNamedSystem("tracking_error", TrackingError(num_vehicles=num_vehicles, derivative=derivative))
    pd = builder.AddNamedSystem("pd", ProportionalDerivative(num_vehicles=num_vehicles, k_p=k_p, k_d=k_d))
    correction = builder.AddNamedSystem("correction", ConstantVectorSource(np.zeros(3 * num_vehicles)))
    minus = builder.AddNamedSystem("minus", Gain(-1.0, 3 * num_vehicles))
    parts = 2 if feed_forward == "none" else 3
    command = builder.AddNamedSystem("acceleration_command", Adder(parts, 3 * num_vehicles))

    builder.Connect(error.GetOutputPort("error"), pd.GetInputPort("error"))
    builder.Connect(error.GetOutputPort("error_rate"), pd.GetInputPort("error_rate"))
    builder.Connect(pd.GetOutputPort("pd"), command.get_input_port(0))
    builder.Connect(correction.get_output_port(), minus.get_input_port())
    builder.Connect(minus.get_output_port(), command.get_input_port(1))

    builder.ExportInput(error.GetInputPort("measurement"), "measurement")
    builder.ExportInput(error.GetInputPort("reference"), "reference")
    if feed_forward != "none":
        rows = np.array([3, 3, 3, 1, 1]) * num_vehicles
        parts_of_reference = builder.AddNamedSystem("reference", Demultiplexer(rows))
        builder.ConnectInput("reference", parts_of_reference.get_input_port())
        builder.Connect(parts_of_reference.get_output_port(2), command.get_input_port(2))

    builder.ExportOutput(command.get_output_port(), "acceleration_command")
    builder.ExportOutput(error.GetOutputPort("error"), "error")
    builder.ExportOutput(error.GetOutputPort("error_rate"), "error_rate")
    builder.ExportOutput(pd.GetOutputPort("pd"), "pd")
    builder.ExportOutput(correction.get_output_port(), "correction")
    position = builder.Build()
    position.set_name("position")
    return position
