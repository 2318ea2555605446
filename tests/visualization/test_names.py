"""Tests that short names of fields and parameters use the usual symbols."""

import pytest

from drake_quad.visualization.names import short_name


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("inertia.0", "I_xx"),
        ("inertia[2]", "I_zz"),
        ("initial.attitude.1", "initial pitch"),
        ("initial.body_rates.2", "initial yaw rate"),
        ("centre_of_mass.1", "c_y"),
        ("cameras: misalignment.0", "cameras: roll misalignment"),
        ("laboratory.motion_capture.misalignment[1]", "pitch misalignment"),
        ("steady 3: velocity.0", "steady 3: velocity x"),
        ("control.position.k_p.2", "control position k_p z"),
        ("body_drag.linear[0]", "drag linear x"),
        ("autopilot.damping[1]", "damping of pitch"),
        ("motors.curve[2]", "thrust curve k_2"),
        ("thrust_factor_error.rotor_3", "thrust factor error rotor 3"),
        ("rotor_time_constant", "rotor time constant"),
        ("weights.4", "weights 5"),
    ],
)
def test_short_names_consist_of_words_and_symbols(name: str, expected: str) -> None:
    assert short_name(name) == expected
