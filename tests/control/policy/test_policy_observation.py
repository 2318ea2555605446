"""Tests of the observations of a policy, by comparison with Drake's rotations."""

from typing import get_args

import numpy as np
import pytest
from pydrake.math import RollPitchYaw, RotationMatrix

from drake_quad.control.policy.observation import (
    OBSERVABLE_SIGNALS,
    Frame,
    ObservationParameters,
    ObservationSpec,
    num_observed,
    observation_rows,
)
from drake_quad.signals import Reference, RotorSpeed, State, Wind

STATE = State(x=0.3, y=-0.2, z=1.1, roll=0.4, pitch=-0.3, yaw=0.7, v_x=0.5, v_y=0.6, v_z=-0.4, p=1.1, q=-1.2, r=1.3)
REFERENCE = Reference(
    x=0.5, y=0.1, z=1.4, v_x=0.2, v_y=-0.1, v_z=0.3, a_x=0.11, a_y=0.12, a_z=0.13, yaw=0.9, yaw_rate=0.05
)
REFERENCE_AHEAD = (0.6, 0.2, 1.5, 0.8, 0.1, 1.7)  # m, two future reference positions
ROTOR_SPEEDS = RotorSpeed(100.0, 110.0, 120.0, 130.0)  # rad/s
WIND = Wind(1.0, 2.0, -3.0)  # m/s
ACTION = (0.1, -0.2, 0.3)
BODY_ROTATION = RollPitchYaw(STATE[3:6]).ToRotationMatrix()  # rotation from B to W


def observed_signal(name, frame="world", turn=0.0):
    spec = ObservationSpec((name,), frame, 1, turn)
    parameters = ObservationParameters(200.0, ACTION)
    rows = observation_rows(
        STATE,
        REFERENCE,
        REFERENCE_AHEAD,
        ROTOR_SPEEDS,
        WIND,
        ACTION,
        parameters,
        lambda x, y, z: x + 10.0 * y - z,
        spec,
    )
    assert len(rows) == num_observed(spec, num_actions=3, num_ahead=2)
    return np.array(rows)


def axes_of(frame, turn=0.0):
    """Return the rotation to W from the frame of an observation, whose axes are rotated by `turn` (rad)."""
    return {
        "world": RotationMatrix(),
        "heading": RotationMatrix.MakeZRotation(STATE.yaw + turn),
        "reference_heading": RotationMatrix.MakeZRotation(REFERENCE.yaw + turn),
        "body": BODY_ROTATION @ RotationMatrix.MakeZRotation(turn),
    }[frame]


EXPECTED_VECTORS = {
    "position_error": np.subtract(REFERENCE[:3], STATE[:3]),
    "velocity": STATE[6:9],
    "velocity_error": np.subtract(REFERENCE[3:6], STATE[6:9]),
    "reference_velocity": REFERENCE[3:6],
    "reference_acceleration": REFERENCE[6:9],
    "wind": WIND,
}


@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.parametrize("frame", get_args(Frame))
def test_observed_vectors_are_expressed_in_the_chosen_frame(frame, turn):
    to_frame = axes_of(frame, turn).inverse()
    for name, vector in EXPECTED_VECTORS.items():
        np.testing.assert_allclose(
            observed_signal(name, frame, turn), to_frame @ np.array(vector), atol=1e-14, err_msg=name
        )
    ahead = [to_frame @ np.subtract(REFERENCE_AHEAD[k : k + 3], STATE[:3]) for k in (0, 3)]
    np.testing.assert_allclose(observed_signal("reference_ahead", frame, turn), np.concatenate(ahead), atol=1e-14)


@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_the_observed_rotation_is_the_body_rotation_matrix_row_by_row(turn):
    turn_rotation = RotationMatrix.MakeZRotation(turn)
    body = BODY_ROTATION @ turn_rotation
    for frame in ("world", "body"):
        np.testing.assert_allclose(observed_signal("rotation", frame, turn), body.matrix().ravel(), atol=1e-14)
    for frame in ("heading", "reference_heading"):
        relative = axes_of(frame, turn).inverse() @ body
        np.testing.assert_allclose(observed_signal("rotation", frame, turn), relative.matrix().ravel(), atol=1e-14)
    np.testing.assert_allclose(
        observed_signal("body_rates", turn=turn), turn_rotation.inverse() @ np.array(STATE[9:]), atol=1e-14
    )


@pytest.mark.parametrize("angle", [-1.5, 0.4, np.pi, 40.0])
def test_observations_along_the_reference_heading_are_invariant_under_rotation_about_z(angle):
    """Observations are the same at every heading, so a policy that can fly at one heading can fly at any."""

    def rotated(x, y):
        return np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y

    (x, y), (v_x, v_y) = rotated(STATE.x, STATE.y), rotated(STATE.v_x, STATE.v_y)
    state = STATE._replace(x=x, y=y, v_x=v_x, v_y=v_y, yaw=STATE.yaw + angle)
    (x, y), (v_x, v_y), (a_x, a_y) = (rotated(*pair) for pair in (REFERENCE[:2], REFERENCE[3:5], REFERENCE[6:8]))
    reference = REFERENCE._replace(x=x, y=y, v_x=v_x, v_y=v_y, a_x=a_x, a_y=a_y, yaw=REFERENCE.yaw + angle)
    wind = Wind(*rotated(WIND.x, WIND.y), WIND.z)
    ahead = tuple(
        np.concatenate([(*rotated(*REFERENCE_AHEAD[k : k + 2]), REFERENCE_AHEAD[k + 2]) for k in (0, 3)]).tolist()
    )
    names = tuple([name for name in OBSERVABLE_SIGNALS if name not in ("position", "attitude", "clearance")])
    spec = ObservationSpec(names, "reference_heading", 1, 0.6)
    parameters = ObservationParameters(200.0, ACTION)
    rows = [
        observation_rows(*given, ROTOR_SPEEDS, present_wind, ACTION, parameters, None, spec)
        for given, present_wind in (((STATE, REFERENCE, REFERENCE_AHEAD), WIND), ((state, reference, ahead), wind))
    ]
    np.testing.assert_allclose(*rows, rtol=0.0, atol=1e-13)


def test_signals_without_a_direction_do_not_depend_on_the_frame():
    np.testing.assert_array_equal(observed_signal("position", "body"), STATE[:3])
    np.testing.assert_array_equal(observed_signal("attitude", "body"), STATE[3:6])
    np.testing.assert_allclose(observed_signal("yaw_error"), [np.sin(0.2), np.cos(0.2)], atol=1e-15)
    np.testing.assert_allclose(observed_signal("rotor_speed"), [0.5, 0.55, 0.6, 0.65])
    np.testing.assert_allclose(observed_signal("clearance"), [0.3 - 2.0 - 1.1])
    np.testing.assert_array_equal(observed_signal("action"), ACTION)


def test_observed_signals_have_the_order_of_the_specification():
    names = tuple(OBSERVABLE_SIGNALS)[::-1]
    spec = ObservationSpec(names)
    rows = observation_rows(
        STATE, REFERENCE, REFERENCE_AHEAD, ROTOR_SPEEDS, WIND, ACTION, ObservationParameters(200.0, ACTION), max, spec
    )
    parts = [observed_signal(name) for name in names]
    parts[names.index("clearance")] = [1.1]
    np.testing.assert_array_equal(rows, np.concatenate(parts))
