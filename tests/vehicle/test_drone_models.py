"""Tests that the model agrees with derivatives of the package drone-models, which `record_drone_models.py` recorded.

docs/reference/effects.md lists the terms in which the equations of the package differ from ours. The test adds these
terms to our derivatives.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from oracle.vehicle import rotation

from drake_quad.vehicle.aerodynamics import BodyDrag, LinearDrag
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import SpinDown
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotor, Rotors

RECORDED_MODELS = json.loads(Path(__file__).with_name("drone_models.json").read_text(encoding="utf-8"))
RAD_S_PER_RPM = 2.0 * np.pi / 60.0  # one revolution per minute in rad/s
# Indices of the derivatives of velocity, body rates and rotor speeds in the derivative of the state.
DERIVATIVE_INDICES = {"acceleration": slice(6, 9), "turning": slice(9, 12), "spinning": slice(12, 16)}


def time_constant(coefficient):
    """Return the time constant of a linear lag with a coefficient of the package, s. It is infinite for 0."""
    return 1.0 / coefficient if coefficient else np.inf


class Drone:
    """Vehicle of the package drone-models, as a `Quadrotor` of this library.

    Methods compute the terms that occur only in the equations of the package.
    """

    def __init__(self, record):
        self.samples, self.numbers = record["samples"], {name: np.array(n) for name, n in record["numbers"].items()}
        self.mass, arm, *_ = self.numbers.values()
        self.roll, self.pitch, self.yaw = self.numbers["mixing_matrix"] * [[arm], [arm], [1.0]]
        _, _, self.gravity = -self.numbers["gravity_vec"]
        self.inertia, self.drag = np.diag(self.numbers["J"]), -np.diag(self.numbers["drag_matrix"])
        # A rotor that turns clockwise seen from above yaws the body to the left. Therefore, the direction of a rotor
        # in this library is the negative yaw coefficient of the package.
        self.thrust_factor, self.drag_factor = (
            self.numbers[name][2] / RAD_S_PER_RPM**2 for name in ("rpm2thrust", "rpm2torque")
        )
        self.vehicle = self._vehicle()
        self.context = self.vehicle.CreateDefaultContext()

    def _vehicle(self):
        rotors = [
            Rotor(-pitch, roll, 0.0, -yaw, self.thrust_factor, self.drag_factor)
            for roll, pitch, yaw in zip(self.roll, self.pitch, self.yaw, strict=True)
        ]
        up, _, down, _ = self.numbers["rotor_dyn_coef"]
        rotor_inertia = float(self.numbers["prop_inertia"])
        parameters = QuadrotorParameters(
            mass=float(self.mass),
            inertia=Inertia(*self.inertia),
            rotor_inertia=rotor_inertia,
            rotors=Rotors(*rotors),
            gravity=self.gravity,
            min_rotor_speed=0.0,
            max_rotor_speed=1e4,
            rotor_time_constant=time_constant(up),
            linear_drag=0.0,
            quadratic_drag=0.0,
        )
        effects = Effects(
            body_drag=BodyDrag(LinearDrag(*self.drag)),
            reaction_torque=ReactionTorque(rotor_inertia),
            spin_down=SpinDown(time_constant(down)),
        )
        return Quadrotor(time_step=0.0, effects=effects.names, parameters=QuadrotorConfig(parameters, effects=effects))

    def rates(self, sample):
        """Return the (16,) derivatives of the state of our vehicle model."""
        zero = [0.0, 0.0, 0.0]
        names = "attitude", "velocity", "rates", "speeds"
        self.context.SetContinuousState(np.concatenate([zero, *(sample[name] for name in names)]))
        self.vehicle.GetInputPort("rotor_speed_command").FixValue(self.context, sample["commands"])
        self.vehicle.GetInputPort("wind").FixValue(self.context, zero)
        return self.vehicle.EvalTimeDerivatives(self.context).CopyToVector()

    def additional_terms(self, sample):
        """Return the terms that the package adds to the accelerations of body and rotors, keyed by descriptions."""
        speeds, commands = np.array(sample["speeds"]), np.array(sample["commands"])
        (k_0, k_1, _), (c_0, c_1, _) = self.numbers["rpm2thrust"], self.numbers["rpm2torque"]
        force, drag = k_0 + k_1 * speeds / RAD_S_PER_RPM, c_0 + c_1 * speeds / RAD_S_PER_RPM
        _, square_coefficient_up, _, square_coefficient_down = self.numbers["rotor_dyn_coef"]
        square_coefficient = np.where(commands > speeds, square_coefficient_up, square_coefficient_down)
        rotor_acceleration = square_coefficient * (commands**2 - speeds**2) / RAD_S_PER_RPM
        p_inertia = self.numbers["prop_inertia"]
        spin = -p_inertia * (self.yaw @ speeds)
        _, q, _ = sample["rates"]
        no_vector, no_rotors = np.zeros(3), np.zeros(4)

        def angular_acceleration(x, y, z):
            return np.array([x, y, z]) / self.inertia

        return {
            "thrust and torque that are linear in the speed": (
                rotation(*sample["attitude"])[:, 2] * force.sum() / self.mass,
                angular_acceleration(self.roll @ force, self.pitch @ force, self.yaw @ drag),
                no_rotors,
            ),
            "a lag with the difference of squares": (
                no_vector,
                angular_acceleration(0, 0, p_inertia * self.yaw @ rotor_acceleration),
                rotor_acceleration,
            ),
            "the sign of the gyroscopic torque about x": (
                no_vector,
                angular_acceleration(2.0 * q * spin, 0, 0),
                no_rotors,
            ),
        }


@pytest.fixture(scope="module", params=RECORDED_MODELS["drones"])
def drone(request):
    return Drone(RECORDED_MODELS["drones"][request.param])


def test_derivatives_of_drone_models_equal_ours_plus_three_additional_terms(drone):
    """Every term is large enough that the derivatives would differ without it."""
    assert RECORDED_MODELS["package"] == "drone-models 0.1.0"
    max_fractions = dict.fromkeys(drone.additional_terms(drone.samples[0]), 0.0)
    for sample in drone.samples:
        our_derivatives, terms = drone.rates(sample), drone.additional_terms(sample)
        for index, (name, rows) in enumerate(DERIVATIVE_INDICES.items()):
            expected = np.array(sample[name])
            parts = {reason: term[index] for reason, term in terms.items()}
            scale = np.abs(expected).max()
            np.testing.assert_allclose(
                our_derivatives[rows] + sum(parts.values()), expected, rtol=0.0, atol=1e-9 * scale
            )
            for reason, part in parts.items():
                max_fractions[reason] = max(max_fractions[reason], np.abs(part).max() / scale)
    assert min(max_fractions.values()) > 1e-3, max_fractions
