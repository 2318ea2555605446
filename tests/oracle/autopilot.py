"""What is on board between the link and the allocation; and a vehicle whose attitude follows as flights show it."""

import math

import numpy as np

from oracle.randomness import NOISE, Stream
from oracle.vehicle import Vehicle, WithSmallAngles, cross, euler_to_body, rotation


class Nothing:
    """The wrench comes over the link."""

    steps = 0

    def __init__(self, scenario, seed, sample):
        pass

    def act(self, k, state, target):
        pass

    def wrench(self, command):
        return command


class Loops:
    """Attitude and rate loop, on a gyroscope: the wrench of an instant is out until the next.

    Args:
        scenario: of numbers, with an autopilot of kind attitude.
        seed: of the study.
        sample: its number in the study.
    """

    def __init__(self, scenario, seed, sample):
        self.numbers, self.inertia = scenario.laboratory.autopilot, np.diag(scenario.nominal.inertia)
        self.steps = round(self.numbers.period / scenario.vehicle.time_step)
        self.noise = Stream(seed, sample, NOISE, "autopilot.sensor_noise", 6)
        self.out = np.array([scenario.nominal.mass * scenario.nominal.gravity, 0.0, 0.0, 0.0])

    def act(self, k, state, target):
        """At instant k of its own, on what it hears then."""
        numbers, noise = self.numbers, self.noise.normal(k)
        rates = state[9:12] + np.array(numbers.gyroscope_bias) + numbers.gyroscope_noise * noise[0:3]
        error = target[1:4] - (state[3:6] + numbers.attitude_noise * noise[3:6])
        error[2] = math.remainder(error[2], math.tau)
        wanted = target[4:7] + np.array(numbers.k_attitude) * error
        acceleration = np.array(numbers.k_rate) * (wanted - rates)
        self.out = np.concatenate([target[0:1], self.inertia @ acceleration + cross(rates, self.inertia @ rates)])

    def wrench(self, command):
        return self.out


class ThrustAlone(Nothing):
    """Of the target the rotors give the thrust."""

    def wrench(self, command):
        return np.array([command[0], 0.0, 0.0, 0.0])


ON_BOARD = {"none": Nothing, "attitude": Loops, "response": ThrustAlone}


class Responding(WithSmallAngles):
    """Its attitude follows the target, whatever the rotors' torques are; the state has the rates of the angles.

    Args:
        scenario: of numbers, with an autopilot of kind response.
        duration: of the flight, over which the battery sags, s.
    """

    def __init__(self, scenario, duration):
        super().__init__(scenario.vehicle, duration)
        self.response = scenario.laboratory.autopilot

    def slope(self, attitude, velocity, rates, speeds, wind):
        """How attitude, velocity and the rates of the angles change."""
        acceleration = self.accelerations(rotation(*attitude), velocity, np.zeros(3), speeds, wind)[0:3]
        omega, zeta = np.array(self.response.natural_frequency), np.array(self.response.damping)
        error = self.target[1:4] - attitude
        error[2] = math.remainder(error[2], math.tau)
        return np.concatenate([rates, acceleration, omega**2 * error - 2.0 * zeta * omega * rates])

    def shown(self, state):
        """The state with body rates, (2)."""
        if self.numbers.attitude_kinematics == "small_angle":
            return state
        return np.concatenate([state[0:9], euler_to_body(state[3], state[4]) @ state[9:12]])


def vehicle_of(scenario, duration):
    """The vehicle of a scenario."""
    if scenario.laboratory.autopilot.kind == "response":
        return Responding(scenario, duration)
    kind = WithSmallAngles if scenario.vehicle.attitude_kinematics == "small_angle" else Vehicle
    return kind(scenario.vehicle, duration)
