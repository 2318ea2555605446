"""The equations of motion with all effects that are switched on."""

from functools import reduce
from typing import NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, plus, times
from drake_quad.signals import PositionW, RotorSpeed, Row, Wind, Wrench
from drake_quad.vehicle.aerodynamics import Flow, ground_effect
from drake_quad.vehicle.dynamics import (
    Motion,
    RotorAction,
    drag,
    equations_of_motion,
    residual_speed,
    rotor_action,
)
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.motors import decay_factors, lagged_speeds, rotor_accelerations
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.payload import LoadedBody, loaded_body, loaded_body_accelerations
from drake_quad.vehicle.slung_load import Rod, rod_force, rod_rates


class Accelerations(NamedTuple):
    """Time derivatives of the motion of a vehicle and of its slung load.

    Attributes:
        motion: linear and angular accelerations of the vehicle.
        rod: time derivatives of the rod's direction and of its rate; None if there is no slung load.
    """

    motion: Motion
    rod: Rod | None = None


class RotorState(NamedTuple):
    """State of the rotors at an instant.

    Attributes:
        speed: rotor speeds.
        action: action of the rotors on the body in still air and far from the ground.
    """

    speed: RotorSpeed
    action: RotorAction


def rotor_state(speed: RotorSpeed, target: RotorSpeed, parameters: QuadrotorParameters, effects: Effects) -> RotorState:
    """Return the state of the rotors at an instant, given their speeds and the target speeds that they approach."""
    action = rotor_action(speed, parameters)
    if effects.reaction_torque is not None:
        rate = residual_speed(rotor_accelerations(speed, target, parameters, effects.spin_down), parameters.rotors)
        wrench = action.wrench
        tau_z = wrench.tau_z - effects.reaction_torque.rotor_inertia * rate
        action = action._replace(wrench=wrench._replace(tau_z=tau_z))
    return RotorState(speed, action)


def rotor_states_over_step(
    rotors: RotorSpeed, target: RotorSpeed, half: float, parameters: QuadrotorParameters, effects: Effects
) -> list[RotorState]:
    """Return the rotor states at the start, in the middle and at the end of a step; `half` is half its duration, s."""
    decay = decay_factors(rotors, target, half, parameters, effects.spin_down)
    middle = lagged_speeds(rotors, target, decay)
    speeds = rotors, middle, lagged_speeds(middle, target, decay)
    return [rotor_state(speed, target, parameters, effects) for speed in speeds]


def accelerations(
    axes: BodyAxes,
    motion: Motion,
    rod: Rod | None,
    height: PositionW,
    rotors: RotorState,
    wind: Wind,
    parameters: QuadrotorParameters,
    effects: Effects,
    time: Row = 0.0,
) -> Accelerations:
    """Return the accelerations of the vehicle and of a slung load.

    Args:
        axes: axes of B in W.
        motion: velocity and body rates of the vehicle.
        rod: rod of a slung load; None if there is none.
        height: height of the vehicle in W, m; used by the ground effect and by loads that depend on height.
        rotors: speeds of the rotors and their action on the body at this instant.
        wind: velocity of the air in W.
        parameters: parameters of the vehicle.
        effects: effects on the vehicle.
        time: time, s; used only for a payload.
    """
    action = rotors.action
    force: Vector | None = None
    if effects.ground_effect is not None:
        action = _near_ground(action, ground_effect(height, effects.ground_effect))
    if not effects.add_body_forces:
        return Accelerations(equations_of_motion(axes, motion, action, wind, parameters))
    air = Vector(wind.x - motion.v_x, wind.y - motion.v_y, wind.z - motion.v_z)
    if effects.air_loads:
        flow = Flow(axes.in_body(air), air, rotors.speed, action.wrench, height, parameters)
        forces, torques = zip(*(each.load(flow) for each in effects.air_loads), strict=True)
        load, torque = reduce(plus, forces), reduce(plus, torques)
        # The force along z_B acts like thrust, so it is added to the wrench.
        thrust, tau_x, tau_y, tau_z = action.wrench
        action = action._replace(wrench=Wrench(thrust + load.z, tau_x + torque.x, tau_y + torque.y, tau_z + torque.z))
        force = plus(times(load.x, axes.x), times(load.y, axes.y))

    def total_force() -> Vector:
        """Return the total force on the vehicle in W, excluding its weight, N."""
        dragging = drag(Wind(*air), parameters.linear_drag, parameters.quadratic_drag)
        total = plus(axes.in_world(Vector(0.0, 0.0, action.wrench.thrust)), Vector(*dragging))
        return total if force is None else plus(total, force)

    if effects.slung_load is not None and rod is not None:
        free = total_force()
        tension = rod_force(free, rod, parameters.mass, effects.slung_load)
        force = tension if force is None else plus(force, tension)
        rod = rod_rates(free, rod, parameters.mass, effects.slung_load)
    if effects.payload is None:
        return Accelerations(equations_of_motion(axes, motion, action, wind, parameters, force), rod)
    body = loaded_body(parameters.mass, parameters.inertia, effects.payload, time)
    return Accelerations(_with_payload(motion, axes, total_force(), action, body, parameters), rod)


def _near_ground(action: RotorAction, ratio: Row) -> RotorAction:
    """Return the action of the rotors with thrust, roll torque and pitch torque multiplied by a ratio."""
    thrust, tau_x, tau_y, tau_z = action.wrench
    return action._replace(wrench=Wrench(ratio * thrust, ratio * tau_x, ratio * tau_y, tau_z))


def _with_payload(
    motion: Motion,
    axes: BodyAxes,
    force: Vector,
    action: RotorAction,
    body: LoadedBody,
    parameters: QuadrotorParameters,
) -> Motion:
    """Return the accelerations of a vehicle with a payload; `force` is the total force in W without the weight, N."""
    _, *torque = action.wrench
    spin = parameters.rotor_inertia * action.residual
    linear, angular = loaded_body_accelerations(
        axes.in_body(force), Vector(*torque), Vector(motion.p, motion.q, motion.r), spin, body
    )
    in_world = axes.in_world(linear)
    return Motion(in_world.x, in_world.y, in_world.z - parameters.gravity, *angular)
