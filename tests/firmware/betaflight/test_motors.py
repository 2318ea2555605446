"""Tests of the assignment of Betaflight's motors to rotors."""

import re

import pytest

from drake_quad.errors import InputError
from drake_quad.firmware.betaflight.motors import motors_of_rotors
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotors


def test_motors_of_an_x_are_found_by_their_place():
    """Betaflight numbers the motors: 1 rear right, 2 front right, 3 rear left, 4 front left."""
    rotors = Rotors.x(
        length=0.2, width=0.2, rotor_1_direction=ANTICLOCKWISE
    )  # front right, rear right, rear left, front left
    assert motors_of_rotors(rotors, "QUADX", motors_reversed=False) == (1, 0, 2, 3)
    wide = Rotors.x(length=0.1, width=0.2, rotor_1_direction=CLOCKWISE)
    assert motors_of_rotors(wide, "QUADX", motors_reversed=True) == (1, 0, 2, 3)
    long = Rotors.x(length=0.4, width=0.1, rotor_1_direction=CLOCKWISE)
    assert motors_of_rotors(long, "QUADX", motors_reversed=True) == (1, 0, 2, 3)


def test_motors_of_a_plus_are_found_by_their_place():
    """Betaflight numbers the motors of its mixer QUADP: 1 rear, 2 right, 3 left, 4 front."""
    rotors = Rotors.plus(rotor_1_direction=CLOCKWISE)  # front, right, back, left
    assert motors_of_rotors(rotors, "QUADP", motors_reversed=False) == (3, 1, 0, 2)


def test_the_layout_may_have_any_origin():
    rotors = [
        rotor._replace(x=rotor.x + 0.3, y=rotor.y - 0.1)
        for rotor in Rotors.x(length=0.2, width=0.2, rotor_1_direction=ANTICLOCKWISE)
    ]
    assert motors_of_rotors(rotors, "QUADX", motors_reversed=False) == (1, 0, 2, 3)


@pytest.mark.parametrize(
    ("rotors", "mixer", "message"),
    [
        (Rotors.plus(), "QUADX", "the mixer QUADX does not fit nominal.layout; add the line `mixer QUADP`"),
        (
            Rotors.x(length=0.2, width=0.2),
            "QUADP",
            "the mixer QUADP does not fit nominal.layout; add the line `mixer QUADX`",
        ),
        (Rotors.x(length=0.2, width=0.2), "HEX6", "the mixer HEX6 is not supported; use QUADX and QUADP"),
        (
            Rotors.x(length=0.2, width=0.2, rotor_1_direction=CLOCKWISE),
            "QUADX",
            "rotor 1 of nominal.layout turns in the opposite direction to motor 2 of Betaflight; add the line"
            " `set yaw_motors_reversed = ON`",
        ),
    ],
)
def test_a_mixer_that_does_not_fit_is_refused(rotors, mixer, message):
    with pytest.raises(InputError, match=f"^{re.escape(f'laboratory.autopilot.settings: {message}')}$"):
        motors_of_rotors(rotors, mixer, motors_reversed=False)
