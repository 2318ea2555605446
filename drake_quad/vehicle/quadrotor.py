"""The quadrotor as a Drake system."""

from typing import Literal, NamedTuple

from pydrake.systems.framework import Context

from drake_quad.framework.fleet_system import TIME, AutoDiffXd, Expression, FleetSystem, fleet_system
from drake_quad.signals import Angle, PositionW, RotorSpeed, State, Wind
from drake_quad.vehicle.dynamics import (
    hover_rotor_speeds,
    paired_rotor_action,
    rigid_kinematics,
    rotor_action,
    small_angle_kinematics,
)
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.stepping import VehicleState, quadrotor_slope, quadrotor_step

Kinematics = Literal["exact", "small_angle"]
KINEMATICS = {"exact": rigid_kinematics, "small_angle": small_angle_kinematics}


class Place(NamedTuple):
    """Where a vehicle hovers, and where it looks."""

    x: PositionW = 0.0
    y: PositionW = 0.0
    z: PositionW = 0.0
    yaw: Angle = 0.0


class QuadrotorNumbers(NamedTuple):
    """What may differ from vehicle to vehicle.

    Attributes:
        parameters: of the vehicle.
        faults: of its rotors.
        start: where it hovers at the beginning, each rotor at the speed that this takes.
    """

    parameters: QuadrotorParameters = QuadrotorParameters()
    faults: RotorFaults = RotorFaults()
    start: Place = Place()


def hover(parameters: QuadrotorParameters, place: Place) -> VehicleState:
    """The state of a vehicle that hovers in still air."""
    return VehicleState(body_at_rest(place), hover_rotor_speeds(parameters))


def body_at_rest(place: Place) -> State:
    """The state of a rigid body that does not move."""
    return State(place.x, place.y, place.z, 0.0, 0.0, place.yaw, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _body(state: VehicleState) -> State:
    return state.body


def _rotors(state: VehicleState) -> RotorSpeed:
    return state.rotors


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

    Eqs (1) to (5) of the paper (`drake_quad.vehicle.dynamics`). Commands beyond the rotors' limits are clipped. A
    `wind` that is not connected is still air. A vehicle for which `crashed` is not zero stays as it is; not connected,
    all fly.

    With a time step the state is discrete, in the groups `state` and `rotor_speed`, and a periodic unrestricted update
    integrates the interval just elapsed with the inputs held over it, so that whatever samples at the same instant
    sees the new state:

        t = 0        h        2h
        inputs ●━━━━━○
               ●━━━━━→ state at h, seen by the discrete updates at h

    The update at time zero does nothing. With `time_step=0` the state is continuous, a `VehicleState`. A step takes the
    faults at its middle.

    The parameters of the context are `parameters` and, for a vehicle that is faulty, `faults`, which Expression does
    not know.

    Args:
        num_vehicles: N.
        time_step: h in seconds, 10 ms by default; 0 for a continuous state.
        kinematics: "exact", or "small_angle" for the last three lines of eq (3) as the paper has them.
        faulty: whether rotors may have faults.
        paired: whether the rotors are known to be in pairs, see `paired_rotor_action`, which spares a few operations.
        numbers: of the vehicles.
    """

    def declare(
        self,
        *,
        time_step: float = 0.01,
        kinematics: Kinematics = "exact",
        faulty: bool = False,
        paired: bool = False,
        numbers: QuadrotorNumbers = QuadrotorNumbers(),
    ) -> None:
        """Declares the system."""
        self.time_step = time_step
        parameters = self.parameter("parameters", lambda numbers: numbers.parameters)
        faults = self.parameter("faults", lambda numbers: numbers.faults) if faulty else None
        command = self.input("rotor_speed_command")
        inputs = command, self.input("wind", absent=Wind(0.0, 0.0, 0.0)), self.input("crashed")
        # Without faults nothing depends on the time; an Expression of it could not be compared.
        time = TIME if faulty else 0.0
        motion, action = KINEMATICS[kinematics], paired_rotor_action if paired else rotor_action
        if time_step > 0.0:
            body = self.state("state", lambda numbers: body_at_rest(numbers.start))
            rotors = self.state("rotor_speed", lambda numbers: hover_rotor_speeds(numbers.parameters))
            reads = body, rotors, *inputs, parameters, faults, time, time_step, motion, action
            self.update(time_step, quadrotor_step, *reads, writes=[body, rotors], unrestricted=True, at_start=False)
            self.state_output(body)
            self.state_output(rotors)
        else:
            state = self.continuous_state(lambda numbers: hover(numbers.parameters, numbers.start))
            self.derivative(quadrotor_slope, state, *inputs, parameters, faults, time, motion, action)
            self.output("state", _body, state)
            self.output("rotor_speed", _rotors, state)

    def set_hover(self, context: Context, place: Place) -> None:
        """Puts the vehicles into hover with the context's parameters."""
        state = hover(self.get_parameter(context, "parameters"), place)
        if self.time_step > 0.0:
            self.set_state(context, "state", state.body)
            self.set_state(context, "rotor_speed", state.rotors)
        else:
            self.set_state(context, "continuous", state)
