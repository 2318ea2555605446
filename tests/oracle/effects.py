"""What acts on a vehicle beside the paper's equations: forces at their points, and bodies put together of parts."""

import numpy as np

from oracle.vehicle import Z, cross, rotation


def cross_matrix(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


class Forces:
    """Forces on a vehicle in B, each at a point seen from its centre of mass, and free torques; no weight.

    Args:
        vehicle: its `QuadrotorParameters`.
        effects: its `Effects`.
    """

    def __init__(self, vehicle, effects):
        self.vehicle, self.effects = vehicle, effects
        rotors = vehicle.rotors
        self.places = np.array([rotor[:3] for rotor in rotors]) - np.array([*vehicle.centre_of_mass, 0.0])
        # A rotor that turns clockwise turns the body anticlockwise.
        self.reaction = -np.array([rotor.direction for rotor in rotors])
        self.drag_factors = np.array([rotor.drag_factor for rotor in rotors])

    def at(self, state, speeds, wind, rotor_rates):
        """Pairs of point and force, and the free torque.

        Args:
            state: (12,).
            speeds: (4,) of the rotors.
            wind: (3,) in W.
            rotor_rates: (4,) of the rotors' speeds, whose reaction is felt if it is switched on.
        """
        vehicle, effects = self.vehicle, self.effects
        R = rotation(*state[3:6])
        air = R.T @ (wind - state[6:9])
        thrusts = np.array(vehicle.rotors.thrust_factors) * speeds**2
        if effects.ground_effect is not None:
            radius, ground = effects.ground_effect
            height = max(state[2] - ground, radius / 2.0)
            thrusts = thrusts / (1.0 - (radius / (4.0 * height)) ** 2)
        pairs = [(place, thrust * Z) for place, thrust in zip(self.places, thrusts, strict=True)]
        size = np.linalg.norm(air)
        pairs.append((np.zeros(3), (vehicle.linear_drag + vehicle.quadratic_drag * size) * air))
        if effects.body_drag is not None:
            linear, quadratic, point = map(np.array, effects.body_drag)
            pairs.append((point, (linear + quadratic * size) * air))
        if effects.rotor_aerodynamics is not None:
            lift, climb, drag, inflow = effects.rotor_aerodynamics
            # A quarter of lift and climb is each rotor's, and its drag by its speed; the middle of all feels the sum.
            middle = self.places.mean(axis=0)
            for speed in speeds:
                across = np.array([air[0], air[1], 0.0])
                up = (lift * across @ across + climb * air[2]) / 4.0 + inflow * speed * air[2]
                pairs.append((middle, drag * speed * across + up * Z))
        torque = (self.reaction * self.drag_factors) @ speeds**2 * Z
        if effects.reaction_torque is not None:
            # A rotor whose drag turns the body anticlockwise turns clockwise, and so does its momentum.
            torque = torque + effects.reaction_torque.rotor_inertia * (self.reaction @ rotor_rates) * Z
        return pairs, torque


def accelerations(vehicle, state, speeds, pairs, torque, parts):
    """Linear acceleration in W of the vehicle's centre of mass, and angular acceleration in B (6,).

    Newton's and Euler's equations about that point, which need not be the centre of mass of the whole, as a linear
    system of six equations.

    Args:
        vehicle: its parameters.
        state: (12,).
        speeds: (4,) of the rotors.
        pairs: of points and forces without weight.
        torque: without a point.
        parts: mass, place and 3 x 3 inertia about its own centre of mass of everything that is carried.
    """
    R, rates = rotation(*state[3:6]), state[9:12]
    bodies = [(vehicle.mass, np.zeros(3), np.diag(vehicle.inertia)), *parts]
    gravity = -vehicle.gravity * R.T @ Z
    matrix, right = np.zeros((6, 6)), np.zeros(6)
    for mass, place, inertia in bodies:
        S = cross_matrix(place)
        about = inertia - mass * S @ S
        turned = mass * cross(rates, cross(rates, place))
        matrix[:3, :3] += mass * np.eye(3)
        matrix[:3, 3:] -= mass * S
        matrix[3:, :3] += mass * S
        matrix[3:, 3:] += about
        right[:3] += mass * gravity - turned
        right[3:] += mass * cross(place, gravity) - cross(rates, about @ rates)
    spin = vehicle.rotor_inertia * np.dot([rotor.direction for rotor in vehicle.rotors], speeds) * Z
    right[3:] -= cross(rates, spin)
    for place, force in pairs:
        right[:3] += force
        right[3:] += cross(place, force)
    right[3:] += torque
    found = np.linalg.solve(matrix, right)
    return np.concatenate([R @ found[:3], found[3:]])
