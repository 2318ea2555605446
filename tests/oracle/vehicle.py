"""Vehicle: eqs (1) to (5), lag and failure of rotors, and the allocation on board."""

import math
from itertools import combinations

import numpy as np

X, Y, Z = np.eye(3)
# Directions from the centre to the rotors, for the layouts plus and X.
PLUS = np.array([X, -Y, -X, Y])
CORNERS = np.array([X - Y, -X - Y, -X + Y, X + Y])


class Rotors:
    """Positions, signs of the reaction torques, and thrust and drag factors of the rotors.

    Clockwise rotors have the sign +1.

    Args:
        parameters: true or nominal vehicle of the scenario.
    """

    def __init__(self, parameters):
        layout = parameters.layout
        if layout.kind == "rotors":
            self.positions = np.array([rotor.position for rotor in layout.rotors])
            self.reaction = np.array([1.0 if rotor.turns == "clockwise" else -1.0 for rotor in layout.rotors])
            self.b = np.array([rotor.thrust_factor or parameters.thrust_factor for rotor in layout.rotors])
            self.d = np.array([rotor.drag_factor or parameters.drag_factor for rotor in layout.rotors])
            return
        sides = PLUS if layout.kind == "plus" else CORNERS
        if layout.length is None:
            arms = sides / np.linalg.norm(sides, axis=1, keepdims=True)
            self.positions = parameters.arm_length * arms
        else:
            self.positions = 0.5 * sides * [layout.length, layout.width, 0.0]
        self.reaction = np.array([1.0, -1.0, 1.0, -1.0]) * (1.0 if layout.rotor_1_turns == "clockwise" else -1.0)
        self.b, self.d = np.full(4, parameters.thrust_factor), np.full(4, parameters.drag_factor)


def cross(a, b):
    """Return the cross product (3,) of two vectors. NumPy's function takes ten times as long for a single product."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a, b
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x])


def axis_rotation(axis, angle):
    """Return the matrix (3, 3) of a rotation about a coordinate axis."""
    s, c = math.sin(angle), math.cos(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def rotation(roll, pitch, yaw):
    """Return the rotation matrix R_WB from B to W, eq (1) of the paper."""
    return axis_rotation(2, yaw) @ axis_rotation(1, pitch) @ axis_rotation(0, roll)


def euler_to_body(roll, pitch):
    """Return the matrix of eq (2) of the paper, from the rates of roll, pitch and yaw to the body rates p, q, r."""
    s, c = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [1.0, 0.0, -math.sin(pitch)],
            [0.0, c, s * math.cos(pitch)],
            [0.0, -s, c * math.cos(pitch)],
        ]
    )


def quaternion_matrix(quaternion):
    """Return the rotation matrix (3, 3) of a unit quaternion by the Euler-Rodrigues formula."""
    w, (x, y, z) = quaternion[0], quaternion[1:]
    S = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * S + 2.0 * S @ S


class Vehicle:
    """True vehicle, with battery sag and faults.

    Args:
        parameters: vehicle of the scenario.
        duration: duration of the flight, over which the battery sags, s.
    """

    def __init__(self, parameters, duration):
        self.parameters, self.sag = parameters, parameters.battery_sag / duration
        self.rotors = Rotors(parameters)
        self.thrust_factor = self.rotors.b * (1.0 + np.array(parameters.thrust_factor_error))
        centre = np.array([*parameters.centre_of_mass, 0.0])
        self.levers = self.rotors.positions - centre
        self.inertia = np.diag(parameters.inertia)
        self.inverse_inertia = np.linalg.inv(self.inertia)

    def wrench(self, speeds):
        """Return thrust and torques about the centre of mass, eq (5), from the forces and lever arms of the rotors."""
        squares = speeds**2
        forces = self.thrust_factor * squares
        # A unit force along z at (x, y) has the torque (y, -x).
        torque = np.array([self.levers[:, 1] @ forces, -self.levers[:, 0] @ forces, 0.0])
        torque[2] = self.rotors.d * self.rotors.reaction @ squares
        return forces.sum(), torque

    def hover_speeds(self):
        """Return the rotor speeds whose wrench balances the weight without torque."""
        columns = []
        for unit in np.eye(4):
            thrust, torque = self.wrench(unit)
            columns.append([thrust, *torque])
        weight = self.parameters.mass * self.parameters.gravity
        return np.sqrt(np.linalg.solve(np.array(columns).T, [weight, 0.0, 0.0, 0.0]))

    def accelerations(self, R, velocity, rates, speeds, wind):
        """Return the time derivatives (6,) of velocity and body rates."""
        parameters = self.parameters
        thrust, torque = self.wrench(speeds)
        airspeed = wind - velocity
        size = math.sqrt(airspeed @ airspeed)
        drag = (parameters.linear_drag + parameters.quadratic_drag * size) * airspeed
        acceleration = (R @ (thrust * Z) + drag) / parameters.mass - parameters.gravity * Z
        # Eq (4) with the angular momentum of the rotors.
        spin = -parameters.rotor_inertia * self.rotors.reaction @ speeds
        momentum = self.inertia @ rates + spin * Z
        return np.concatenate([acceleration, self.inverse_inertia @ (torque - cross(rates, momentum))])

    def slope(self, turn, velocity, rates, speeds, wind):
        """Return the time derivatives of attitude, velocity and body rates.

        The attitude is a unit quaternion relative to the attitude at the beginning of the step.
        """
        w, v = turn[0], turn[1:]
        attitude_rate = 0.5 * np.append(-v @ rates, w * rates + cross(v, rates))
        accelerations = self.accelerations(
            self.initial_rotation @ quaternion_matrix(turn), velocity, rates, speeds, wind
        )
        return np.concatenate([attitude_rate, accelerations])

    def begin_attitude(self, angles):
        """Begin a step at an attitude, and return the initial values of the attitude variables that are integrated."""
        self.initial_rotation = rotation(*angles)
        return np.array([1.0, 0.0, 0.0, 0.0])

    def angles(self, turn, yaw):
        """Return roll, pitch and yaw, with a yaw near the previous yaw."""
        R = self.initial_rotation @ quaternion_matrix(turn)
        change = math.remainder(math.atan2(R[1, 0], R[0, 0]) - yaw, math.tau)
        return np.array([math.atan2(R[2, 1], R[2, 2]), -math.asin(R[2, 0]), yaw + change])

    # Output of the link during a step; only `RespondingVehicle` uses it.
    target = None

    def output_state(self, state):
        """Return the state, which already contains body rates."""
        return state

    def targets(self, command, time):
        """Return the speeds that the rotors approach for a command, given the limits and the faults at a time (s)."""
        parameters = self.parameters
        fraction = np.full(4, 1.0 - self.sag * time)
        failure = parameters.rotor_failure
        if failure is not None and time >= failure.time:
            fraction[int(failure.rotor) - 1] *= failure.speed_factor
        return fraction * np.clip(command, parameters.min_rotor_speed, parameters.max_rotor_speed)

    def step(self, state, speeds, command, wind, time, h):
        """Return state and rotor speeds after a step h that ends at a time, by the classical Runge-Kutta method.

        The rotors approach the commanded speeds exponentially, independently of the body.
        """
        target = self.targets(command, time - 0.5 * h)

        def rotors(later):
            return target + (speeds - target) * math.exp(-later / self.parameters.rotor_time_constant)

        def slope(x, later):
            _, velocity, rates, attitude = np.split(x, [3, 6, 9])
            attitude_rate, accelerations = np.split(self.slope(attitude, velocity, rates, rotors(later), wind), [-6])
            return np.concatenate([velocity, accelerations, attitude_rate])

        initial = np.concatenate([state[0:3], state[6:12], self.begin_attitude(state[3:6])])
        k_1 = slope(initial, 0.0)
        k_2 = slope(initial + 0.5 * h * k_1, 0.5 * h)
        k_3 = slope(initial + 0.5 * h * k_2, 0.5 * h)
        k_4 = slope(initial + h * k_3, h)
        done = initial + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        return np.concatenate([done[0:3], self.angles(done[9:], state[5]), done[3:9]]), rotors(h)


class SmallAngleVehicle(Vehicle):
    """Vehicle whose body rates equal its angle rates, as in eq (3) of the paper."""

    def slope(self, angles, velocity, rates, speeds, wind):
        """Return the time derivatives of angles, velocity and body rates."""
        return np.concatenate([rates, self.accelerations(rotation(*angles), velocity, rates, speeds, wind)])

    def begin_attitude(self, angles):
        """Return the initial values of the attitude variables that are integrated: the angles themselves."""
        return angles

    def angles(self, angles, yaw):
        """Return the angles themselves, since roll, pitch and yaw are integrated."""
        return angles


def allocate(wrench, nominal, priority):
    """Return the rotor speeds for a wrench, and the part of the wrench that the limits of the rotors do not allow.

    The unknowns are thrust, fraction of roll and pitch torque, and yaw torque. The solution for both priorities is at a
    corner where planes of the limits intersect, so all corners are tried.

    Args:
        wrench: thrust (N) and three torques (N m).
        nominal: nominal vehicle of the scenario, with the centre of mass in the centre of the layout.
        priority: "roll_pitch" or "thrust", the part of the wrench that has priority.
    """
    wrench = np.array(wrench)
    low, high = nominal.min_rotor_speed**2, nominal.max_rotor_speed**2
    rotors = Rotors(nominal)
    # `forward` is the matrix of eq (5), and `parts` its inverse, from thrust and torques to squared rotor speeds.
    forward = np.array(
        [rotors.b, rotors.positions[:, 1] * rotors.b, -rotors.positions[:, 0] * rotors.b, rotors.reaction * rotors.d]
    )
    parts = np.linalg.inv(forward)
    squares = parts @ wrench
    if np.all((low <= squares) & (squares <= high)):
        return np.sqrt(squares), np.zeros(4)

    thrust = wrench[0]
    if priority == "thrust":
        thrust = min(max(thrust, np.max(low / parts[:, 0])), np.min(high / parts[:, 0]))
    # All quantities are scaled to about one: thrust by the weight, squared speeds by the width of their range.
    weight = nominal.mass * nominal.gravity
    scale = np.array([weight, 1.0, np.max((high - low) / np.abs(parts[:, 3]))])
    rows = np.column_stack([parts[:, 0], parts[:, 1:3] @ wrench[1:3], parts[:, 3]]) * scale / (high - low)
    yaw = wrench[3] / scale[2]
    normals = np.concatenate([rows, rows, np.eye(3)[[0, 1, 1, 2, 2]]])
    offsets = np.concatenate(
        [np.full(4, low / (high - low)), np.full(4, high / (high - low)), [thrust / weight, 0.0, 1.0, 0.0, yaw]]
    )
    corners = _corners(normals, offsets)
    squares = corners @ rows.T
    inside = np.all((squares >= offsets[:4] - 1e-12) & (squares <= offsets[4:8] + 1e-12), axis=1)
    inside &= (corners[:, 1] >= 0.0) & (corners[:, 1] <= 1.0)
    inside &= (corners[:, 2] >= min(yaw, 0.0)) & (corners[:, 2] <= max(yaw, 0.0))
    missing = np.abs(corners[inside] - [thrust / weight, 1.0, yaw])
    first = [0, 1, 2] if priority == "thrust" else [1, 0, 2]
    produced_thrust, fraction, produced_yaw = corners[inside][_lexicographic_argmin(missing[:, first])] * scale
    produced = np.array([produced_thrust, fraction * wrench[1], fraction * wrench[2], produced_yaw])
    return np.sqrt(np.clip(parts @ produced, low, high)), wrench - produced


def _corners(normals, offsets):
    """Return the intersection points of all triples of the planes normal · x = offset."""
    triples = np.array(list(combinations(range(len(offsets)), 3)))
    matrices = normals[triples]
    meet = np.abs(np.linalg.det(matrices)) > 1e-12
    return np.linalg.solve(matrices[meet], offsets[triples[meet]][..., None])[..., 0]


def _lexicographic_argmin(rows):
    """Return the index of the lexicographically smallest row; entries within 1e-12 count as equal."""
    candidates = np.arange(len(rows))
    for column in rows.T:
        candidates = candidates[column[candidates] <= column[candidates].min() + 1e-12]
    return candidates[0]
