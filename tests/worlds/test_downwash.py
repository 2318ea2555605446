"""Tests of the downwash against the published formula."""

import math

import numpy as np
import pytest

from drake_quad.signals import Crashed, State
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH
from drake_quad.worlds.downwash import Downwash, downwash_load

# Coefficients in `cf2x.urdf` of gym-pybullet-drones: dw_coeff_1 to dw_coeff_3, and prop_radius.
C_1, C_2, C_3, RADIUS = 2267.18, 0.16, -0.11, 2.31348e-2


def published_force(positions, index):
    """Return the total force on a vehicle, as gym-pybullet-drones computes it."""
    total = 0.0
    for other, position in enumerate(positions):
        height = position[2] - positions[index][2]
        distance = math.hypot(position[0] - positions[index][0], position[1] - positions[index][1])
        if other != index and height > 0 and distance < 10:
            alpha = C_1 * (RADIUS / (4 * height)) ** 2
            beta = C_2 * height + C_3
            total -= alpha * math.exp(-0.5 * (distance / beta) ** 2)
    return total


def test_side_by_side_vehicles_do_not_push():
    """At a small height, the published force at the smallest height is reduced in proportion to the height."""
    for height in (1e-9, 0.02, 0.1, 0.2):
        states = states_at([[0.0, 0.0, 0.0], [0.1, 0.0, height]])
        load = downwash_load(0, CRAZYFLIE_DOWNWASH, *states, *[Crashed(0.0)] * 2)
        expected = height / 0.2 * published_force([[0.0, 0.0, 0.0], [0.1, 0.0, 0.2]], 0)
        assert load.f_z == pytest.approx(expected, rel=1e-12)


def states_at(positions):
    return [State(*position, *[0.0] * 9) for position in positions]


def test_forces_are_those_of_the_published_formula():
    rng = np.random.default_rng(0)
    for _ in range(200):
        positions = rng.uniform(-1.0, 1.0, (4, 3)) * [0.3, 0.3, 0.05] + np.outer(range(4), [0.0, 0.0, 0.3])
        rng.shuffle(positions)
        for index in range(4):
            load = downwash_load(index, CRAZYFLIE_DOWNWASH, *states_at(positions), *[Crashed(0.0)] * 4)
            assert load.f_z == pytest.approx(published_force(positions, index), rel=1e-12, abs=1e-15)
            assert {*load} == {load.f_z, 0.0}


def test_vehicles_above_far_away_or_crashed_do_not_push():
    below, above, far = [0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [10.1, 0.0, 0.5]
    for positions, crashed in (((above, below), (0, 0)), ((below, far), (0, 0)), ((below, above), (0, 1))):
        load = downwash_load(0, CRAZYFLIE_DOWNWASH, *states_at(positions), *map(Crashed, map(float, crashed)))
        assert load.f_z == 0.0


def test_a_system_has_the_ports_of_all_vehicles():
    system = Downwash(count=3)
    context = system.CreateDefaultContext()
    for k, z in enumerate((0.0, 0.8, 1.6), start=1):
        system.GetInputPort(f"state_{k}").FixValue(context, [0.0, 0.0, z, *[0.0] * 9])
        system.GetInputPort(f"crashed_{k}").FixValue(context, [0.0])
    forces = [system.GetOutputPort(f"external_load_{k}").Eval(context)[2] for k in (1, 2, 3)]
    positions = [[0.0, 0.0, z] for z in (0.0, 0.8, 1.6)]
    assert forces == pytest.approx([published_force(positions, index) for index in range(3)], rel=1e-12)


def test_the_force_is_finite_where_the_radius_is_zero():
    """β is zero at Δz = 0.6875 m: only a vehicle exactly below is pushed."""
    height = -C_3 / C_2
    for distance in (0.0, 1e-3, 0.5):
        states = states_at([[0.0, 0.0, 0.0], [distance, 0.0, height]])
        load = downwash_load(0, CRAZYFLIE_DOWNWASH, *states, *[Crashed(0.0)] * 2)
        expected = C_1 * (RADIUS / (4 * height)) ** 2 if distance == 0.0 else 0.0
        assert load.f_z == pytest.approx(-expected, rel=1e-9)
