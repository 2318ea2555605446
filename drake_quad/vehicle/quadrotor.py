"""Drake system of a quadrotor."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from pydrake.systems.framework import Context

from drake_quad.framework.fleet_system import TIME, AutoDiffXd, Expression, FleetSystem, fleet_system
from drake_quad.signals import (
    Angle,
    BatteryLoad,
    BodyRateB,
    Charge,
    Number,
    PositionW,
    RotorSpeed,
    State,
    VelocityW,
    Wind,
)
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS, SMALL_ANGLE_KINEMATICS
from drake_quad.vehicle.battery import FULL_BATTERY_CHARGE, rotor_battery_load
from drake_quad.vehicle.dynamics import hover_rotor_speeds
from drake_quad.vehicle.effects import NO_EFFECTS, Effects, hover_equivalent
from drake_quad.vehicle.external_load import WithExternalLoad
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.slung_load import HANGING_AT_REST
from drake_quad.vehicle.stepping import (
    VehicleState,
    quadrotor_derivatives,
    quadrotor_step,
    stepping_acceleration,
    vehicle_acceleration,
)

Kinematics = Literal["exact", "small_angle"]
KINEMATICS = {"exact": RIGID_KINEMATICS, "small_angle": SMALL_ANGLE_KINEMATICS}
"""Attitude kinematics by name."""


class HoverPose(NamedTuple):
    """Position and yaw in hover."""

    x: PositionW = 0.0
    y: PositionW = 0.0
    z: PositionW = 0.0
    yaw: Angle = 0.0


class InitialMotion(NamedTuple):
    """Motion of a vehicle at time 0, and its rotor speeds as multiples of the rotor speeds in hover."""

    roll: Angle = 0.0
    pitch: Angle = 0.0
    v_x: VelocityW = 0.0
    v_y: VelocityW = 0.0
    v_z: VelocityW = 0.0
    p: BodyRateB = 0.0
    q: BodyRateB = 0.0
    r: BodyRateB = 0.0
    rotor_1: Number = 1.0
    rotor_2: Number = 1.0
    rotor_3: Number = 1.0
    rotor_4: Number = 1.0


HOVER_MOTION = InitialMotion()
"""Motion in hover."""


class QuadrotorConfig(NamedTuple):
    """Parameters that can differ between the vehicles of a fleet.

    Attributes:
        parameters: parameters of the vehicle.
        faults: faults of the rotors.
        start: position and yaw at time 0.
        effects: parameters of the effects on the vehicle.
        motion: motion at time 0; by default, the vehicle hovers.
    """

    parameters: QuadrotorParameters = QuadrotorParameters()
    faults: RotorFaults = RotorFaults()
    start: HoverPose = HoverPose()
    effects: Effects = NO_EFFECTS
    motion: InitialMotion = HOVER_MOTION


def initial_body_state(pose: HoverPose, motion: InitialMotion = HOVER_MOTION) -> State:
    """Return the state of the rigid body at time 0."""
    roll, pitch, v_x, v_y, v_z, p, q, r, *_ = motion
    return State(pose.x, pose.y, pose.z, roll, pitch, pose.yaw, v_x, v_y, v_z, p, q, r)


def initial_state(
    parameters: QuadrotorParameters,
    pose: HoverPose,
    effects: Effects = NO_EFFECTS,
    motion: InitialMotion = HOVER_MOTION,
) -> VehicleState:
    """Return the state of a vehicle at time 0, with a full battery and with a slung load that hangs at rest.

    By default, the vehicle hovers in still air.
    """
    *_, first, second, third, fourth = motion
    speeds = hover_rotor_speeds(hover_equivalent(parameters, effects, pose.z))
    rotors = RotorSpeed._make(
        speed * factor for speed, factor in zip(speeds, (first, second, third, fourth), strict=True)
    )
    swing = None if effects.slung_load is None else HANGING_AT_REST
    return VehicleState(
        initial_body_state(pose, motion), rotors, swing, None if effects.battery is None else FULL_BATTERY_CHARGE
    )


def vehicle_battery_load(
    charge: Charge, speed: RotorSpeed, parameters: QuadrotorParameters, effects: Effects
) -> BatteryLoad:
    """Return the voltage and the current of a vehicle's battery."""
    assert effects.battery is not None
    return rotor_battery_load(charge, speed, parameters, effects.battery)


def state_battery_load(state: VehicleState, parameters: QuadrotorParameters, effects: Effects) -> BatteryLoad:
    """Return the battery's voltage and current for a vehicle with a continuous state."""
    assert state.charge is not None
    return vehicle_battery_load(state.charge, state.rotors, parameters, effects)


# Field of `VehicleState` for each output port.
_FIELD_OF_OUTPUT = {"state": "body", "rotor_speed": "rotors", "swing": "swing", "charge": "charge"}


@fleet_system(float, AutoDiffXd, Expression)
class Quadrotor(FleetSystem):
    """Rigid body and rotors of a quadrotor, or of a fleet of quadrotors.

    .. pydrake_system::

        name: Quadrotor
        input_ports:
        - rotor_speed_command
        - wind
        - crashed
        - external_load
        output_ports:
        - state
        - rotor_speed
        - swing
        - charge
        - acceleration
        - battery

    The system implements eqs (1) to (5) of the paper (`drake_quad.vehicle.dynamics`). Commands beyond the rotors'
    limits are clipped. If `wind` is not connected, the air is still. The state of a vehicle is frozen while `crashed`
    is not zero; if the port is not connected, all vehicles fly.

    With a time step the state is discrete, in the groups `state` and `rotor_speed`. A periodic unrestricted update
    integrates the elapsed interval with the inputs held over it. Systems that sample at the same instant therefore use
    the new state:

        t = 0        h        2h
        inputs ●━━━━━○
               ●━━━━━→ state at h, used by the discrete updates at h

    The update at time zero has no effect. The faults at the middle of a step apply to the whole step. A step integrates
    the attitude as a quaternion, so that the vehicle can turn over. After a step the pitch is between -π/2 and π/2, and
    the roll between -π and π. The yaw is not wrapped.

    With `time_step=0` the state is continuous, a `VehicleState`, for `Linearize` and for integrators with error
    control. The state is singular where the pitch is ±π/2 (infinite rates of roll and yaw), and where the rod of a
    slung load is horizontal along X (infinite roll rate of the rod). An integrator with error control takes shorter
    steps near these singularities; a fixed-step integrator is inaccurate there. The forces jump when a rotor fails or a
    payload is picked up or dropped. Error control cannot step across such a jump, so a simulation must be advanced to
    the instant just before the jump, and then to the instant of the jump.

    `acceleration` is the time derivative of the motion for the current state and inputs. A sensor that samples it at
    the end of a step uses the inputs that were held over the step.

    Effects (`drake_quad.vehicle.effects`) extend the paper's equations. A `slung_load` adds the state and output
    `swing`. A `battery` adds the state and output `charge`, and the output `battery`. With a `thrust_curve` the
    commands are throttles, and the input `throttle_command` replaces `rotor_speed_command`.

    With `has_external_load`, the input `external_load` is a force and a torque on the body that other systems compute.

    The parameters of the context are `parameters`, for vehicles with faults also `faults`, and for vehicles with
    effects also `effects`. The scalar type Expression supports neither faults nor the effects `spin_down` and
    `payload`, whose equations contain conditions.

    Args:
        num_vehicles: number N of vehicles.
        time_step: time step h, s, 10 ms by default; 0 for a continuous state.
        kinematics: "exact", or "small_angle" for the small-angle kinematics of eq (3) in the paper.
        faulty: True if rotors may have faults.
        effects: names of the effects that are switched on.
        has_external_load: True to add the input port `external_load`.
        parameters: parameters of the vehicles.

    Raises:
        ValueError: if an effect has no parameters, or a slung load is combined with a payload, which would move the
            attachment point of the load away from the centre of mass.
    """

    def declare(
        self,
        *,
        time_step: float = 0.01,
        kinematics: Kinematics = "exact",
        faulty: bool = False,
        effects: tuple[str, ...] = (),
        has_external_load: bool = False,
        parameters: QuadrotorConfig = QuadrotorConfig(),
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        if {"slung_load", "payload"} <= set(effects):
            raise ValueError("the effects payload and slung_load cannot be combined")
        self.time_step = time_step

        def active_effects(parameters: QuadrotorConfig) -> Effects:
            return parameters.effects.only(effects)

        def start(parameters: QuadrotorConfig) -> VehicleState:
            return initial_state(parameters.parameters, parameters.start, active_effects(parameters), parameters.motion)

        vehicle = self.parameter("parameters", lambda parameters: parameters.parameters)
        faults = self.parameter("faults", lambda parameters: parameters.faults) if faulty else None
        effect_parameters = self.parameter("effects", active_effects) if effects else NO_EFFECTS
        command = self.input("throttle_command" if "thrust_curve" in effects else "rotor_speed_command")
        inputs = command, self.input("wind", absent=Wind(0.0, 0.0, 0.0)), self.input("crashed", absent=None)
        # Only faults and a payload depend on time. The equations of a vehicle without both must not contain the time,
        # so that they support Expression.
        time = TIME if faulty or "payload" in effects else 0.0
        arguments = *inputs, vehicle, faults, effect_parameters, time
        loads = (self.input("external_load"),) if has_external_load else ()

        def loaded(formula: Callable[..., Any], num_states: int) -> Callable[..., Any]:
            """Return a formula whose first argument is the external load, if there is one."""
            return WithExternalLoad(formula, num_states + arguments.index(effect_parameters)) if loads else formula

        motion = KINEMATICS[kinematics]
        if time_step > 0.0:
            body = self.state("state", lambda parameters: start(parameters).body)
            rotors = self.state("rotor_speed", lambda parameters: start(parameters).rotors)
            swing = self.state("swing", lambda parameters: start(parameters).swing) if "slung_load" in effects else None
            charge = self.state("charge", lambda parameters: start(parameters).charge) if "battery" in effects else None
            groups = body, rotors, swing, charge
            step_arguments = *groups, *arguments, time_step, motion
            step = loaded(quadrotor_step, len(groups))
            self.update(time_step, step, *loads, *step_arguments, writes=groups, unrestricted=True, at_start=False)
            for group in self.states.values():
                self.state_output(group)
            acceleration = loaded(stepping_acceleration, len(groups))
            self.output("acceleration", acceleration, *loads, *groups, *arguments, motion)
            if charge is not None:
                self.output("battery", vehicle_battery_load, charge, rotors, vehicle, effect_parameters)
        else:
            state = self.continuous_state(start)
            self.derivative(loaded(quadrotor_derivatives, 1), *loads, state, *arguments, motion)
            for (name, part), value in zip(_FIELD_OF_OUTPUT.items(), start(self._parameter_record), strict=True):
                if value is not None:
                    self.output(name, getattr, state, part)
            self.output("acceleration", loaded(vehicle_acceleration, 1), *loads, state, *arguments, motion)
            if "battery" in effects:
                self.output("battery", state_battery_load, state, vehicle, effect_parameters)

    def set_hover(self, context: Context, pose: HoverPose) -> None:
        """Set the state of a context to hover at a position and yaw, for the parameters of the context."""
        effects = self.get_parameter(context, "effects") if "effects" in self.parameters else NO_EFFECTS
        state = initial_state(self.get_parameter(context, "parameters"), pose, effects)
        if self.time_step == 0.0:
            self.set_state(context, "continuous", state)
            return
        for name, part in zip(_FIELD_OF_OUTPUT, state, strict=True):
            if part is not None:
                self.set_state(context, name, part)
