"""The rigid body alone, whose derivatives others are compared with."""

from drake_quad.signals import State
from drake_quad.vehicle.dynamics import Motion, equations_of_motion


def rigid_body_derivative(state, rotors, wind, parameters, kinematics):
    """Eq (3): the time derivative of the state; arguments as for `equations_of_motion`."""
    rates = equations_of_motion(Motion.of(state), rotors, wind, parameters, kinematics)
    return State(state.v_x, state.v_y, state.v_z, *rates)
