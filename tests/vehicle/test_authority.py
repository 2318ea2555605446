"""Tests that layouts that cannot produce every wrench, or cannot hover, are rejected with the reason."""

import numpy as np
import pytest

from drake_quad.vehicle.authority import explain_infeasible_hover, explain_missing_wrench
from drake_quad.vehicle.rotors import Rotor, Rotors

ALTERNATING_DIRECTIONS = (-1.0, 1.0, -1.0, 1.0)  # of rotors 1 to 4, seen from above; 1 is anticlockwise


def layout_of(positions, turns=ALTERNATING_DIRECTIONS, drag_factors=(8.5e-7,) * 4):
    return Rotors(
        *(Rotor(x, y, 0.0, turn, 4.13e-5, d) for (x, y), turn, d in zip(positions, turns, drag_factors, strict=True))
    )


SQUARE_POSITIONS = ((0.2, -0.2), (-0.2, -0.2), (-0.2, 0.2), (0.2, 0.2))  # m


@pytest.mark.parametrize("rotors", [Rotors.plus(), Rotors.x(length=0.1, width=0.3), Rotors.plus(length=1.0, width=0.1)])
def test_plus_and_x_layouts_produce_every_wrench(rotors):
    assert explain_missing_wrench(rotors) is None
    assert explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0) is None


@pytest.mark.parametrize(
    ("rotors", "missing"),
    [
        (layout_of(SQUARE_POSITIONS, (1.0,) * 4), "yaw torque without thrust, since its rotors all turn the same way"),
        (layout_of(SQUARE_POSITIONS, (1.0, 1.0, -1.0, -1.0)), "yaw torque without roll torque"),
        (layout_of(SQUARE_POSITIONS, (1.0, -1.0, -1.0, 1.0)), "yaw torque without pitch torque"),
        (layout_of([(0.2, 0.0), (0.1, 0.0), (-0.1, 0.0), (-0.2, 0.0)]), "roll torque, since its rotors are in a line"),
        (layout_of([(0.0, 0.2), (0.0, 0.1), (0.0, -0.1), (0.0, -0.2)]), "pitch torque, since its rotors are in a line"),
        (layout_of([(0.2, 0.1), (0.1, 0.1), (-0.1, 0.1), (-0.2, 0.1)]), "roll torque without thrust"),
        (
            layout_of([(0.2, 0.2), (0.1, 0.1), (-0.1, -0.1), (-0.2, -0.2)]),
            r"torque about the axis (0.71, 0.71, 0), since its rotors are in a line",
        ),
        (layout_of([(0.0, 0.0)] * 4), "roll and pitch torque, since all its rotors are at the centre"),
    ],
)
def test_the_message_names_the_part_of_a_wrench_that_rotors_cannot_produce(rotors, missing):
    """The map from squared speeds to the wrench of these layouts is singular."""
    assert explain_missing_wrench(rotors) == missing
    x, y, _, turns, b, d = np.array(rotors).T
    assert np.linalg.matrix_rank([b, y * b, -x * b, -turns * d * 10.0]) < 4


def test_a_vehicle_of_a_fleet_that_cannot_produce_every_wrench_is_reported():
    arm = np.array([0.2, 0.2])
    positions = ((arm, -arm), (-arm, -arm), (-arm, arm), (arm, arm))
    assert explain_missing_wrench(layout_of(positions)) is None
    directions = (1.0, np.array([-1.0, 1.0]), 1.0, np.array([-1.0, 1.0]))
    assert explain_missing_wrench(layout_of(positions, directions)).startswith("yaw torque without thrust")


def test_a_fleet_in_which_one_vehicle_has_all_rotors_at_the_centre_is_reported():
    arm = np.array([0.2, 0.0])
    positions = ((arm, -arm), (-arm, -arm), (-arm, arm), (arm, arm))
    expected = "roll and pitch torque, since all its rotors are at the centre"
    assert explain_missing_wrench(layout_of(positions)) == expected


def test_yaw_authority_depends_on_the_ratio_of_drag_to_thrust_factor():
    """Rotors 2 and 4 have twice the d / b of rotors 1 and 3; 1 and 2 turn one way, 3 and 4 the other."""
    turns, thrust_factors, ratios = (1.0, 1.0, -1.0, -1.0), (4e-5, 4e-5, 8e-5, 4e-5), (0.02, 0.04, 0.02, 0.04)
    rotors = Rotors(
        *(
            Rotor(x, y, 0.0, turn, b, b * r)
            for (x, y), turn, b, r in zip(SQUARE_POSITIONS, turns, thrust_factors, ratios, strict=True)
        )
    )
    assert explain_missing_wrench(rotors).startswith("yaw torque without")


@pytest.mark.parametrize(("fraction", "stands_still"), [(1e-10, True), (-1e-10, True), (1e-8, False), (-1e-8, False)])
def test_a_rotor_with_almost_no_thrust_in_hover_would_have_to_stand_still(fraction, stands_still):
    """The layout is a plus with arms of 0.2 m, in which rotors 2 and 4 are shifted forward by e.

    In hover, rotor 1 then produces the fraction (0.2 - e) / 0.8 of the thrust.
    """
    e = 0.2 - 0.8 * (0.5 * fraction)
    flaw = explain_infeasible_hover(
        layout_of([(0.2, 0.0), (e, -0.2), (-0.2, 0.0), (e, 0.2)]), min_speed=0.0, max_speed=300.0
    )
    if stands_still:
        assert flaw == "rotor 1 would have to stand still"
    else:
        assert flaw == (None if fraction > 0.0 else "rotor 1 would have to push down")


def test_a_vehicle_with_three_rotors_that_turn_the_same_way_cannot_hover():
    """Without yaw torque, rotor 4 carries half of the weight. Without tilting torque, so does the opposite rotor 2.

    Nothing remains for rotors 1 and 3.
    """
    rotors = layout_of(SQUARE_POSITIONS, (1.0, 1.0, 1.0, -1.0))
    assert explain_missing_wrench(rotors) is None
    assert explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0) == "rotor 1 would have to stand still"


def test_a_vehicle_with_all_rotors_in_front_of_the_centre_of_mass_cannot_hover():
    rotors = layout_of([(x + 0.25, y) for x, y in SQUARE_POSITIONS])
    assert explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0) == "rotor 1 would have to push down"


def test_a_vehicle_whose_rotors_would_hover_at_too_different_speeds_is_reported():
    """Rotors 0.35 m in front produce a seventh of the thrust of rotors 0.05 m behind, at 0.38 times their speed."""
    rotors = layout_of([(x + 0.15, y) for x, y in SQUARE_POSITIONS])
    assert explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0) is None
    flaw = explain_infeasible_hover(rotors, min_speed=60.0, max_speed=150.0)
    assert flaw.startswith("rotor 1 would have to turn at 0.38 times the speed of the fastest rotor")


def test_the_message_names_the_rotor_whose_hover_speed_would_be_too_small():
    """The right rotor of a plus is eight times as far from the centre as the left one."""
    rotors = layout_of([(0.2, 0.0), (0.0, -0.8), (-0.2, 0.0), (0.0, 0.1)])
    assert explain_infeasible_hover(rotors, min_speed=60.0, max_speed=300.0) is None
    assert explain_infeasible_hover(rotors, min_speed=150.0, max_speed=300.0).startswith(
        "rotor 2 would have to turn at 0.35 times the speed"
    )
