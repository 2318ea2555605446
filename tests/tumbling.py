"""Simulation of tumbling vehicles that is independent of the library: SciPy integrates the Newton-Euler equations.

The attitude is a quaternion.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation


class Tumbles(NamedTuple):
    """Initial states and constant inputs of N tumbling vehicles.

    Attributes:
        states: (N, 12) initial states in the order of `State`.
        speeds: (N, 4) initial rotor speeds, rad/s.
        commands: (N, 4) commanded rotor speeds, rad/s.
        winds: (N, 3) wind, m/s.
    """

    states: np.ndarray
    speeds: np.ndarray
    commands: np.ndarray
    winds: np.ndarray

    @property
    def count(self):
        """Number of vehicles, N."""
        return len(self.states)


def random_tumbles(count, seed, *, rates=(2.0, 10.0)):
    """Return initial states and inputs of vehicles that start at random attitudes.

    A fifth of the vehicles start at a pitch of exactly ±90°. Another fifth start at ±90° with a relative error of 1e-9.
    """
    rng = np.random.default_rng(seed)
    roll, pitch, yaw = rng.uniform(-3.0, 3.0, count), rng.uniform(-1.5, 1.5, count), rng.uniform(-9.0, 9.0, count)
    vertical = 0.5 * np.pi * rng.choice([-1.0, 1.0], count)
    pitch[::5] = vertical[::5]
    pitch[1::5] = vertical[1::5] * (1.0 - 1e-9 * rng.uniform(size=len(pitch[1::5])))
    body_rates = rng.normal(size=(count, 3))
    body_rates *= rng.uniform(*rates, (count, 1)) / np.linalg.norm(body_rates, axis=1, keepdims=True)
    linear = rng.normal(size=(count, 6))
    states = np.column_stack([linear[:, :3], roll, pitch, yaw, linear[:, 3:], body_rates])
    return Tumbles(
        states,
        rng.uniform(120.0, 260.0, (count, 4)),
        rng.uniform(195.0, 205.0, (count, 4)),
        rng.normal(size=(count, 3)),
    )


def rotations(angles):
    """Return the rotations Rz Ry Rx from B to W for angles (..., 3) of roll, pitch and yaw."""
    return Rotation.from_euler("ZYX", np.asarray(angles)[..., ::-1])


def degrees_apart(angles, rotation):
    """Return the angles (N,) in degrees between attitudes (roll, pitch, yaw) (N, 3) and rotations."""
    return np.degrees((rotations(angles).inv() * rotation).magnitude())


def integrate_tumbles(parameters, tumbles, duration, load=None, swings=None):
    """Integrate the motion of N vehicles from their initial states.

    Args:
        parameters: `QuadrotorParameters` of all vehicles.
        tumbles: initial states and inputs of N vehicles.
        duration: duration of the flight, s.
        load: `SlungLoad` on a rigid rod from the centre of mass, or None.
        swings: initial unit vectors along the rods (N, 3), and their time derivatives (N, 3), 1/s; None without a load.

    Returns:
        Final position, rotation, velocity and body rates of each vehicle, and final position and velocity of its load.
    """
    N, inertia = tumbles.count, np.array(parameters.inertia)
    rotor_positions = np.array([rotor[:3] for rotor in parameters.rotors]) - [*parameters.centre_of_mass, 0.0]
    directions, thrust_factors, drag_factors = (np.array([rotor[i] for rotor in parameters.rotors]) for i in (3, 4, 5))
    weight = np.array([0.0, 0.0, -parameters.gravity])

    def slope(time, y):
        position, velocity, rates, load_position, load_velocity = y[: 15 * N].reshape(5, N, 3)
        quaternion = y[15 * N :].reshape(N, 4)
        decay = np.exp(-time / parameters.rotor_time_constant)
        speeds = tumbles.commands + (tumbles.speeds - tumbles.commands) * decay
        thrusts = thrust_factors * speeds**2
        torque = np.column_stack(
            [
                thrusts @ rotor_positions[:, 1],
                -thrusts @ rotor_positions[:, 0],
                -(drag_factors * directions * speeds**2).sum(axis=1),
            ]
        )
        air = tumbles.winds - velocity
        airspeed = np.linalg.norm(air, axis=1, keepdims=True)
        thrust_axis = Rotation.from_quat(quaternion).apply([[0.0, 0.0, 1.0]] * N)
        force = (
            thrusts.sum(axis=1, keepdims=True) * thrust_axis
            + (parameters.linear_drag + parameters.quadratic_drag * airspeed) * air
        )
        load_acceleration = np.zeros((N, 3))
        if load is not None:
            rod, rod_rate = load_position - position, load_velocity - velocity
            # The length of the rod is constant: rod · (acceleration of the load - that of the vehicle) = -|rod_rate|².
            inverse_masses = 1.0 / parameters.mass + 1.0 / load.mass
            per_length = ((rod_rate**2).sum(axis=1) - (force * rod).sum(axis=1) / parameters.mass) / (
                inverse_masses * (rod**2).sum(axis=1)
            )
            tension = per_length[:, None] * rod
            force = force + tension
            load_acceleration = weight - tension / load.mass
        spin = parameters.rotor_inertia * (directions * speeds).sum(axis=1)
        momentum = inertia * rates + spin[:, None] * np.array([0.0, 0.0, 1.0])
        angular_acceleration = (torque - np.cross(rates, momentum)) / inertia
        v, w = quaternion[:, :3], quaternion[:, 3:]
        quaternion_rate = 0.5 * np.column_stack(
            [w * rates + np.cross(v, rates), -(v * rates).sum(axis=1, keepdims=True)]
        )
        accelerations = force / parameters.mass + weight, angular_acceleration
        derivatives = velocity, *accelerations, load_velocity, load_acceleration, quaternion_rate
        return np.concatenate([part.ravel() for part in derivatives])

    states = tumbles.states
    rod, rod_rate = (np.zeros((N, 3)), np.zeros((N, 3))) if swings is None else swings
    length = 0.0 if load is None else load.length
    begin = [states[:, :3], states[:, 6:9], states[:, 9:12]]
    begin += [states[:, :3] + length * rod, states[:, 6:9] + length * rod_rate, rotations(states[:, 3:6]).as_quat()]
    start = np.concatenate([part.ravel() for part in begin])
    end = solve_ivp(slope, (0.0, duration), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    position, velocity, rates, load_position, load_velocity = end[: 15 * N].reshape(5, N, 3)
    rotation = Rotation.from_quat(end[15 * N :].reshape(N, 4))
    return position, rotation, velocity, rates, load_position, load_velocity
