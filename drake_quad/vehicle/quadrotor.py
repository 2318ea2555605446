"""The quadrotor as a Drake system."""

from typing import Any, Literal

import numpy as np
from pydrake.systems.framework import BasicVector_

from drake_quad.elementary import Row, Rows
from drake_quad.fleet import AutoDiffXd, Expression, FleetSystem, fleet_system
from drake_quad.vehicle.dynamics import (
    hover_rotor_speeds,
    rigid_kinematics,
    small_angle_kinematics,
)
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters, parameters_from_rows
from drake_quad.vehicle.stepping import rigid_slope, rigid_step, small_angle_slope, small_angle_step

Kinematics = Literal["exact", "small_angle"]
KINEMATICS = {"exact": rigid_kinematics, "small_angle": small_angle_kinematics}
_MOTION = {"exact": (rigid_step, rigid_slope), "small_angle": (small_angle_step, small_angle_slope)}


@fleet_system(float, AutoDiffXd, Expression)
class Quadrotor(FleetSystem):
    """Rigid body and rotors of a quadrotor, or of a fleet of them.

    .. pydrake_system::

        name: Quadrotor
        input_ports:
        - rotor_speed_command
        - wind
        - crashed
        output_ports:
        - state
        - rotor_speed

    Eqs (1) to (5) of the paper (`drake_quad.vehicle.dynamics`). `state` has 12 rows: position in W (m); roll, pitch,
    yaw (rad); velocity in W (m/s); body rates p, q, r (rad/s). `rotor_speed` and `rotor_speed_command` have 4
    (rad/s); commands beyond the rotors' limits are clipped. `wind` has 3: velocity of the air in W (m/s); not
    connected it is still air. `crashed` has 1: a vehicle for which it is not zero stays as it is; not connected all
    fly.

    With a time step the state is discrete, in the groups 0 (`state`) and 1 (`rotor_speed`), and a periodic
    unrestricted update integrates the interval just elapsed with the inputs held over it, so that whatever samples
    at the same instant sees the new state:

        t = 0        h        2h
        inputs ●━━━━━○
               ●━━━━━→ state at h, seen by the discrete updates at h

    The update at time zero does nothing. With `time_step=0` the state is continuous, 16 rows: those of `state`, then
    those of `rotor_speed`.

    The parameters are one numeric parameter of the context, the 19 rows of `QuadrotorParameters.to_rows`; the faults,
    if there are any, a second one of 6 rows. A step takes the faults at its middle.

    Args:
        num_vehicles: N.
        time_step: h in seconds, 10 ms by default; 0 for a continuous state.
        kinematics: "exact", or "small_angle" for the last three lines of eq (3) as the paper has them.
        parameters: each entry a number or an (N,) array.
        faults: of the rotors; likewise. Not for Expression.
        initial_position: in W, m. The default state is hover here, each rotor at the speed that this takes.
        initial_yaw: rad.
    """

    def declare(
        self,
        *,
        num_vehicles: int = 1,
        time_step: float = 0.01,
        kinematics: Kinematics = "exact",
        parameters: QuadrotorParameters = QuadrotorParameters(),
        faults: RotorFaults | None = None,
        initial_position: Rows = (0.0, 0.0, 0.0),
        initial_yaw: Row = 0.0,
    ) -> None:
        """Declares the system; see the class for the arguments."""
        self.time_step = time_step
        step, slope = _MOTION[kinematics]
        sizes = [4, 3, 1, 19, 6]
        if time_step > 0.0:
            self._map = self.mapped(step, inputs=[12, 4, *sizes], outputs=(12, 4))
        else:
            self._map = self.mapped(slope, inputs=[16, *sizes], outputs=(16,))
        self._no_faults = BasicVector_[float](RotorFaults().to_rows()).value()
        self._parameters = self.numeric_parameter(parameters.to_rows())
        self._faults = None if faults is None else self.numeric_parameter(faults.to_rows())
        self._command = self.input("rotor_speed_command", 4)
        self._wind = self.input("wind", 3)
        self._crashed = self.input("crashed", 1)

        rigid_body, rotor_speed = _hover(parameters, initial_position, initial_yaw)
        if time_step > 0.0:
            state = self.discrete_state("state", rigid_body)
            rotors = self.discrete_state("rotor_speed", rotor_speed)
            self.DeclarePeriodicUnrestrictedUpdateEvent(time_step, 0.0, self._step)
            self.state_output(12, state)
            self.state_output(4, rotors)
        else:
            self.DeclareContinuousState(self.vector([*rigid_body, *rotor_speed]))
            uses = {self.xc_ticket()}
            self.output("state", 12, self._calc_state, uses=uses)
            self.output("rotor_speed", 4, self._calc_rotor_speed, uses=uses)

    def get_parameters(self, context: Any) -> QuadrotorParameters:
        """A copy of the parameters in the context."""
        rows = self.parameter_rows(context, self._parameters)
        return parameters_from_rows(rows.copy())

    def set_parameters(self, context: Any, parameters: QuadrotorParameters) -> None:
        """Puts parameters into the context: numbers, and also (N,) arrays if one was an array at construction."""
        self.write_parameter(context, self._parameters, parameters.to_rows())

    def set_hover(self, context: Any, position: Rows, yaw: Row) -> None:
        """Puts the vehicles into hover with the context's parameters.

        Args:
            context: of this system.
            position: 3 rows, in W, m.
            yaw: rad.
        """
        rigid_body, rotor_speed = _hover(self.get_parameters(context), position, yaw)
        if self.time_step > 0.0:
            context.SetDiscreteState(0, self.packed(rigid_body))
            context.SetDiscreteState(1, self.packed(rotor_speed))
        else:
            context.SetContinuousState(self.packed([*rigid_body, *rotor_speed]))

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Drake's hook for a continuous state."""
        if self.time_step > 0.0:
            return
        state = context.get_continuous_state_vector().CopyToVector()
        slope = np.empty_like(state)
        # Without faults nothing depends on the time; an Expression of it could not be compared.
        time = 0.0 if self._faults is None else context.get_time()
        # The floating-point flags that arithmetic on objects leaves behind mean nothing.
        with np.errstate(all=None if self.scalar is float else "ignore"):
            self._map([slope], [state, *self._sources(context)], time)
        derivatives.get_mutable_vector().SetFromVector(slope)

    def _step(self, context: Any, state: Any) -> None:
        time = context.get_time()
        if time == 0.0:
            return
        groups = state.get_mutable_discrete_state()
        vectors = groups.get_mutable_vector(0), groups.get_mutable_vector(1)
        self._map(vectors, [*vectors, *self._sources(context)], time, self.time_step)

    def _sources(self, context: Any) -> list[Any]:
        """What a step or a slope depends on beside the state."""
        faults = self._no_faults if self._faults is None else self.parameter(context, self._faults)
        inputs = self.inputs(context, self._command, self._wind, self._crashed)
        return [*inputs, self.parameter(context, self._parameters), faults]

    def _continuous_rows(self, context: Any) -> Any:
        values = context.get_continuous_state_vector().CopyToVector()
        return values.tolist() if self.num_vehicles == 1 else values.reshape(-1, self.num_vehicles)

    def _calc_state(self, context: Any, output: Any) -> None:
        self.write(output, self._continuous_rows(context)[:12])

    def _calc_rotor_speed(self, context: Any, output: Any) -> None:
        self.write(output, self._continuous_rows(context)[12:])


def _hover(parameters: QuadrotorParameters, position: Rows, yaw: Row) -> tuple[list[Row], list[Row]]:
    """Rows of the rigid body and of the rotors of a vehicle at rest."""
    rigid_body = [*position, 0.0, 0.0, yaw, *[0.0] * 6]
    return rigid_body, hover_rotor_speeds(parameters)
