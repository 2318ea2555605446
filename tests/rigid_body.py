"""Time derivative of a rigid body's state, for comparison with the vehicle."""

from drake_quad.geometry.axes import BodyAxes
from drake_quad.signals import Attitude, BodyRates, State
from drake_quad.vehicle.dynamics import Motion, equations_of_motion


def rigid_body_derivative(state, rotors, wind, parameters, kinematics):
    """Return the time derivative of the state by eqs (2) and (3) of the paper, with the given `AttitudeKinematics`."""
    attitude = Attitude(state.roll, state.pitch, state.yaw)
    angle_rates = kinematics.angle_rates(BodyRates(state.p, state.q, state.r), attitude)
    accelerations = equations_of_motion(BodyAxes.of(*attitude), Motion.of(state), rotors, wind, parameters)
    return State(state.v_x, state.v_y, state.v_z, *angle_rates, *accelerations)
