"""The model agrees with derivatives of the package drone-models, which `record_drone_models.py` has recorded.

docs/reference/effects.md lists the terms in which the equations of the package differ from ours. The tests add these
terms one by one.
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
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.rotors import Rotor, Rotors

RECORD = json.loads(Path(__file__).with_name("drone_models.json").read_text(encoding="utf-8"))
# rad/s
RPM = 2.0 * np.pi / 60.0
RESULTS = {"acceleration": slice(6, 9), "turning": slice(9, 12), "spinning": slice(12, 16)}


def lag(coefficient):
    """Return the time constant (s) of rotors with a linear lag, for its coefficient; infinite if it is 0."""
    return 1.0 / coefficient if coefficient else np.inf


class Drone:
    """Drone of the package as one of our vehicles, with the additional terms of its equations."""

    def __init__(self, record):
        self.samples, self.numbers = record["samples"], {name: np.array(n) for name, n in record["numbers"].items()}
        self.mass, arm, *_ = self.numbers.values()
        self.roll, self.pitch, self.yaw = self.numbers["mixing_matrix"] * [[arm], [arm], [1.0]]
        _, _, self.gravity = -self.numbers["gravity_vec"]
        self.inertia, self.drag = np.diag(self.numbers["J"]), -np.diag(self.numbers["drag_matrix"])
        # A rotor that turns clockwise seen from above yaws the body to the left, so directions are -yaw.
        self.thrust_factor, self.drag_factor = (self.numbers[name][2] / RPM**2 for name in ("rpm2thrust", "rpm2torque"))
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
            rotor_time_constant=lag(up),
            linear_drag=0.0,
            quadratic_drag=0.0,
        )
        effects = Effects(
            body_drag=BodyDrag(LinearDrag(*self.drag)),
            reaction_torque=ReactionTorque(rotor_inertia),
            spin_down=SpinDown(lag(down)),
        )
        return Quadrotor(time_step=0.0, effects=effects.names, numbers=QuadrotorNumbers(parameters, effects=effects))

    def rates(self, sample):
        """Return the (16,) derivatives of our state."""
        still = [0.0, 0.0, 0.0]
        names = "attitude", "velocity", "rates", "speeds"
        self.context.SetContinuousState(np.concatenate([still, *(sample[name] for name in names)]))
        self.vehicle.GetInputPort("rotor_speed_command").FixValue(self.context, sample["commands"])
        self.vehicle.GetInputPort("wind").FixValue(self.context, still)
        return self.vehicle.EvalTimeDerivatives(self.context).CopyToVector()

    def further_terms(self, sample):
        """Return the terms that the package adds to the accelerations of body and rotors, by their reason."""
        speeds, commands = np.array(sample["speeds"]), np.array(sample["commands"])
        (k_0, k_1, _), (c_0, c_1, _) = self.numbers["rpm2thrust"], self.numbers["rpm2torque"]
        force, drag = k_0 + k_1 * speeds / RPM, c_0 + c_1 * speeds / RPM
        _, of_squares_up, _, of_squares_down = self.numbers["rotor_dyn_coef"]
        of_squares = np.where(commands > speeds, of_squares_up, of_squares_down)
        spinning = of_squares * (commands**2 - speeds**2) / RPM
        p_inertia = self.numbers["prop_inertia"]
        spin = -p_inertia * (self.yaw @ speeds)
        _, q, _ = sample["rates"]
        nothing, none = np.zeros(3), np.zeros(4)

        def turned(x, y, z):
            return np.array([x, y, z]) / self.inertia

        return {
            "thrust and torque that are linear in the speed": (
                rotation(*sample["attitude"])[:, 2] * force.sum() / self.mass,
                turned(self.roll @ force, self.pitch @ force, self.yaw @ drag),
                none,
            ),
            "a lag with the difference of squares": (nothing, turned(0, 0, p_inertia * self.yaw @ spinning), spinning),
            "the sign of the gyroscopic torque about x": (nothing, turned(2.0 * q * spin, 0, 0), none),
        }


@pytest.fixture(scope="module", params=RECORD["drones"])
def drone(request):
    return Drone(RECORD["drones"][request.param])


def test_derivatives_of_drone_models_are_ours_plus_three_terms(drone):
    """Without any one of the terms they differ."""
    assert RECORD["package"] == "drone-models 0.1.0"
    worst = dict.fromkeys(drone.further_terms(drone.samples[0]), 0.0)
    for sample in drone.samples:
        ours, terms = drone.rates(sample), drone.further_terms(sample)
        for place, (name, rows) in enumerate(RESULTS.items()):
            theirs = np.array(sample[name])
            parts = {reason: term[place] for reason, term in terms.items()}
            scale = np.abs(theirs).max()
            np.testing.assert_allclose(ours[rows] + sum(parts.values()), theirs, rtol=0.0, atol=1e-9 * scale)
            for reason, part in parts.items():
                worst[reason] = max(worst[reason], np.abs(part).max() / scale)
    assert min(worst.values()) > 1e-3, worst
