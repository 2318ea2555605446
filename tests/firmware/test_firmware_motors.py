"""Tests of the assignment of motors to rotors."""

import math
import re

import pytest

from drake_quad.errors import InputError
from drake_quad.firmware import motors
from drake_quad.firmware.ardupilot.system import _MIXERS
from drake_quad.firmware.betaflight.mixers import mixer_of
from drake_quad.firmware.px4.system import _MIXER
from drake_quad.vehicle.rotors import ANTICLOCKWISE, CLOCKWISE, Rotors


def x(direction, length=0.2, width=0.2):
    return Rotors.x(length=length, width=width, rotor_1_direction=direction)


def motors_of_rotors(rotors, mixer, *, motors_reversed=False):
    return motors.motors_of_rotors(
        rotors, mixer_of(mixer, motors_reversed=motors_reversed), shape_advice="change it", turns_advice="reverse it"
    )


def test_motors_of_an_x_are_found_by_their_place():
    """Betaflight numbers the motors: 1 rear right, 2 front right, 3 rear left, 4 front left."""
    # The rotors are in front right, rear right, rear left and front left.
    assert motors_of_rotors(x(ANTICLOCKWISE), "QUADX") == (1, 0, 2, 3)
    for length, width in ((0.1, 0.2), (0.4, 0.1)):
        assert motors_of_rotors(x(CLOCKWISE, length, width), "QUADX", motors_reversed=True) == (1, 0, 2, 3)


def test_motors_of_a_plus_are_found_by_their_place():
    """Betaflight numbers the motors of its mixer QUADP: 1 rear, 2 right, 3 left, 4 front."""
    rotors = Rotors.plus(rotor_1_direction=CLOCKWISE)  # front, right, back, left
    assert motors_of_rotors(rotors, "QUADP") == (3, 1, 0, 2)


@pytest.mark.parametrize("degrees", [-10.5, 0.0, 10.5])
def test_a_plus_may_be_turned_by_almost_eleven_degrees(degrees):
    """In ArduPilot's frame Quad Plus, motor 1 is on the right, motor 2 on the left, 3 in front and 4 at the back."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    rotors = [
        rotor._replace(x=cosine * rotor.x - sine * rotor.y, y=sine * rotor.x + cosine * rotor.y)
        for rotor in Rotors.plus(rotor_1_direction=CLOCKWISE)  # front, right, back, left
    ]
    actual = motors.motors_of_rotors(rotors, _MIXERS[0], shape_advice="", turns_advice="")
    assert actual == (2, 0, 3, 1)


def test_motors_of_ardupilot_and_px4_in_an_x_are_found_by_their_place():
    """Both number the motors: 1 front right, 2 rear left, 3 front left, 4 rear right."""
    for mixer in (_MIXERS[1], _MIXER):
        # The rotors are in front right, rear right, rear left and front left.
        actual = motors.motors_of_rotors(x(ANTICLOCKWISE), mixer, shape_advice="", turns_advice="")
        assert actual == (0, 3, 1, 2)


def test_the_layout_may_have_any_origin():
    rotors = [rotor._replace(x=rotor.x + 0.3, y=rotor.y - 0.1) for rotor in x(ANTICLOCKWISE)]
    assert motors_of_rotors(rotors, "QUADX") == (1, 0, 2, 3)


@pytest.mark.parametrize(
    ("rotors", "mixer", "message"),
    [
        (Rotors.plus(), "QUADX", "the positions of the motors of the firmware do not fit nominal.layout; change it"),
        (x(CLOCKWISE), "QUADP", "the positions of the motors of the firmware do not fit nominal.layout; change it"),
        (
            x(CLOCKWISE, 0.6, 0.1),
            "QUADX",
            "the positions of the motors of the firmware do not fit nominal.layout; change it",
        ),
        (
            x(CLOCKWISE),
            "HEX6",
            "laboratory.autopilot.settings: the mixer HEX6 is not supported; use QUADX and QUADP",
        ),
        (
            x(CLOCKWISE),
            "QUADX",
            "rotor 1 of nominal.layout turns in the opposite direction to the firmware's motor 2; reverse it",
        ),
    ],
)
def test_a_mixer_that_does_not_fit_is_refused(rotors, mixer, message):
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        motors_of_rotors(rotors, mixer)
