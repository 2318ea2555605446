"""Tests of the units of PX4's normalised torques."""

import math

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.vehicle.px4_units import torque_units


def test_torque_units_match_the_mixer_of_px4_for_an_x_layout():
    """A unit of roll or pitch changes each rotor command by 1/√2, a unit of yaw by 1. Hover needs a thrust of 0.4."""
    nominal = nominal_parameters(load_scenario("laboratory:nominal", layers=["vehicles/racer"]))
    lever, ratio = abs(nominal.rotors[0].y), nominal.rotors[0].drag_factor / nominal.rotors[0].thrust_factor
    unit = nominal.mass * nominal.gravity / (4.0 * 0.4)
    roll, _, yaw = torque_units(nominal, 0.4)
    levers = {abs(rotor.y) for rotor in nominal.rotors} | {abs(rotor.x) for rotor in nominal.rotors}
    # The shorter of the two lever arms determines the scale of both roll and pitch.
    assert roll == pytest.approx(4.0 * math.sqrt(0.5) * unit * min(levers), rel=1e-9)
    assert yaw == pytest.approx(4.0 * unit * ratio, rel=1e-9)
    assert lever in levers


def test_normalised_torques_through_the_allocation_of_px4_give_the_commanded_wrench():
    """The allocation is the pseudo-inverse with columns scaled as in ControlAllocationPseudoInverse."""
    nominal = nominal_parameters(load_scenario("laboratory:nominal", layers=["vehicles/racer"]))
    hover = 0.4
    effectiveness = np.array(
        [
            [rotor.y, -rotor.x, -rotor.direction * rotor.drag_factor / rotor.thrust_factor, 1.0]
            for rotor in nominal.rotors
        ]
    ).T
    mixer = np.linalg.pinv(effectiveness)
    tilt = max(np.sqrt(np.sum(mixer[:, axis] ** 2) / (4 / 2)) for axis in (0, 1))
    scales = np.array([tilt, tilt, mixer[:, 2].max(), mixer[:, 3].sum() / 4])
    units = np.array([*torque_units(nominal, hover), nominal.mass * nominal.gravity / hover])
    wrench = np.array([0.02, -0.03, 0.004, 5.0])
    throttles = mixer / scales @ (wrench / units)
    forces = throttles * nominal.mass * nominal.gravity / (4.0 * hover)
    np.testing.assert_allclose(effectiveness @ forces, wrench)
