"""Forces in addition to the paper's equations, with their points of application, and bodies of several parts."""

import numpy as np

from oracle.vehicle import Z, cross, rotation


def cross_matrix(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


class Forces:
    """Forces on a vehicle except its weight, and free torques, in B. Points are relative to the centre of mass.

    Args:
        vehicle: `QuadrotorParameters` of the vehicle.
        effects: `Effects` on the vehicle.
    """

    def __init__(self, vehicle, effects):
        self.vehicle, self.effects = vehicle, effects
        rotors = vehicle.rotors
        self.rotor_positions = np.array([rotor[:3] for rotor in rotors]) - np.array([*vehicle.centre_of_mass, 0.0])
        # A rotor that turns clockwise turns the body anticlockwise.
        self.reaction = -np.array([rotor.direction for rotor in rotors])
        self.drag_factors = np.array([rotor.drag_factor for rotor in rotors])

    def at(self, state, speeds, wind, rotor_rates):
        """Return pairs of a point and a force, and the free torque.

        Args:
            state: state (12,) of the vehicle.
            speeds: rotor speeds (4,), rad/s.
            wind: wind (3,) in W, m/s.
            rotor_rates: angular accelerations (4,) of the rotors, rad/s².
        """
        vehicle, effects = self.vehicle, self.effects
        R = rotation(*state[3:6])
        air = R.T @ (wind - state[6:9])
        thrusts = np.array(vehicle.rotors.thrust_factors) * speeds**2
        if effects.ground_effect is not None:
            radius, ground = effects.ground_effect
            height = max(state[2] - ground, radius / 2.0)
            thrusts = thrusts / (1.0 - (radius / (4.0 * height)) ** 2)
        pairs = [(position, thrust * Z) for position, thrust in zip(self.rotor_positions, thrusts, strict=True)]
        size = np.linalg.norm(air)
        pairs.append((np.zeros(3), (vehicle.linear_drag + vehicle.quadratic_drag * size) * air))
        if effects.body_drag is not None:
            linear, quadratic, point = map(np.array, effects.body_drag)
            pairs.append((point, (linear + quadratic * size) * air))
        if effects.rotor_aerodynamics is not None:
            lift, climb, drag, inflow = effects.rotor_aerodynamics
            # Each rotor produces a quarter of the forces `lift` and `climb`, and drag in proportion to its speed. All
            # these forces act at the centre of the rotors.
            rotor_centre = self.rotor_positions.mean(axis=0)
            for speed in speeds:
                across = np.array([air[0], air[1], 0.0])
                up = (lift * across @ across + climb * air[2]) / 4.0 + inflow * speed * air[2]
                pairs.append((rotor_centre, drag * speed * across + up * Z))
        torque = (self.reaction * self.drag_factors) @ speeds**2 * Z
        if effects.reaction_torque is not None:
            # A rotor that turns clockwise has clockwise momentum, and its drag turns the body anticlockwise.
            torque = torque + effects.reaction_torque.rotor_inertia * (self.reaction @ rotor_rates) * Z
        return pairs, torque


def accelerations(vehicle, state, speeds, pairs, torque, parts):
    """Return the linear acceleration in W of the vehicle's centre of mass, and the angular acceleration in B, (6,).

    The accelerations solve the six Newton-Euler equations about the vehicle's centre of mass. This point differs from
    the common centre of mass of the vehicle and its parts.

    Args:
        vehicle: `QuadrotorParameters` of the vehicle.
        state: state (12,) of the vehicle.
        speeds: rotor speeds (4,), rad/s.
        pairs: pairs of a point and a force, without weight.
        torque: free torque (3,), N m.
        parts: for each carried part, its mass, its position, and its inertia (3, 3) about its own centre of mass.
    """
    R, rates = rotation(*state[3:6]), state[9:12]
    bodies = [(vehicle.mass, np.zeros(3), np.diag(vehicle.inertia)), *parts]
    gravity = -vehicle.gravity * R.T @ Z
    matrix, right = np.zeros((6, 6)), np.zeros(6)
    for mass, position, inertia in bodies:
        S = cross_matrix(position)
        shifted_inertia = inertia - mass * S @ S
        centripetal = mass * cross(rates, cross(rates, position))
        matrix[:3, :3] += mass * np.eye(3)
        matrix[:3, 3:] -= mass * S
        matrix[3:, :3] += mass * S
        matrix[3:, 3:] += shifted_inertia
        right[:3] += mass * gravity - centripetal
        right[3:] += mass * cross(position, gravity) - cross(rates, shifted_inertia @ rates)
    spin = vehicle.rotor_inertia * np.dot([rotor.direction for rotor in vehicle.rotors], speeds) * Z
    right[3:] -= cross(rates, spin)
    for position, force in pairs:
        right[:3] += force
        right[3:] += cross(position, force)
    right[3:] += torque
    solution = np.linalg.solve(matrix, right)
    return np.concatenate([R @ solution[:3], solution[3:]])
