"""Controllers on board between the link and the allocation, and a vehicle with a prescribed attitude response."""

import math

import numpy as np

from oracle.randomness import NOISE, Stream
from oracle.vehicle import SmallAngleVehicle, Vehicle, cross, euler_to_body, rotation


class NoAutopilot:
    """Autopilot that passes on the wrench from the link."""

    steps = 0

    def __init__(self, scenario, seed, sample):
        pass

    def act(self, k, state, target):
        pass

    def wrench(self, command):
        return command


class AttitudeAutopilot:
    """Attitude and rate loops with a gyroscope. The wrench of an update is held until the next update.

    Args:
        scenario: scenario without distributions, with an autopilot of kind attitude.
        seed: seed of the study.
        sample: index of the sample in the study.
    """

    def __init__(self, scenario, seed, sample):
        self.parameters, self.inertia = scenario.laboratory.autopilot, np.diag(scenario.nominal.inertia)
        self.steps = round(self.parameters.period / scenario.vehicle.time_step)
        self.noise = Stream(seed, sample, NOISE, "autopilot.sensor_noise", 6)
        self.held_wrench = np.array([scenario.nominal.mass * scenario.nominal.gravity, 0.0, 0.0, 0.0])

    def act(self, k, state, target):
        """Perform update k, given the state of the vehicle and the link's output at this time."""
        parameters, noise = self.parameters, self.noise.normal(k)
        rates = state[9:12] + np.array(parameters.gyroscope_bias) + parameters.gyroscope_noise * noise[0:3]
        error = target[1:4] - (state[3:6] + parameters.attitude_noise * noise[3:6])
        error[2] = math.remainder(error[2], math.tau)
        rate_command = target[4:7] + np.array(parameters.k_attitude) * error
        acceleration = np.array(parameters.k_rate) * (rate_command - rates)
        self.held_wrench = np.concatenate(
            [target[0:1], self.inertia @ acceleration + cross(rates, self.inertia @ rates)]
        )

    def wrench(self, command):
        return self.held_wrench


class ThrustOnly(NoAutopilot):
    """Autopilot that passes on only the thrust of the target."""

    def wrench(self, command):
        return np.array([command[0], 0.0, 0.0, 0.0])


AUTOPILOTS = {"none": NoAutopilot, "attitude": AttitudeAutopilot, "response": ThrustOnly}


class RespondingVehicle(SmallAngleVehicle):
    """Vehicle whose attitude follows the target independently of the torques. Its state contains angle rates.

    Args:
        scenario: scenario without distributions, with an autopilot of kind response.
        duration: duration of the flight, over which the battery sags, s.
    """

    def __init__(self, scenario, duration):
        super().__init__(scenario.vehicle, duration)
        self.response = scenario.laboratory.autopilot

    def slope(self, attitude, velocity, rates, speeds, wind):
        """Return the time derivatives of attitude, velocity and angle rates."""
        acceleration = self.accelerations(rotation(*attitude), velocity, np.zeros(3), speeds, wind)[0:3]
        omega, zeta = np.array(self.response.natural_frequency), np.array(self.response.damping)
        error = self.target[1:4] - attitude
        error[2] = math.remainder(error[2], math.tau)
        return np.concatenate([rates, acceleration, omega**2 * error - 2.0 * zeta * omega * rates])

    def output_state(self, state):
        """Return the state in which eq (2) of the paper has converted the angle rates to body rates."""
        if self.parameters.attitude_kinematics == "small_angle":
            return state
        return np.concatenate([state[0:9], euler_to_body(state[3], state[4]) @ state[9:12]])


def vehicle_of(scenario, duration):
    """Return the vehicle of a scenario."""
    if scenario.laboratory.autopilot.kind == "response":
        return RespondingVehicle(scenario, duration)
    kind = SmallAngleVehicle if scenario.vehicle.attitude_kinematics == "small_angle" else Vehicle
    return kind(scenario.vehicle, duration)
