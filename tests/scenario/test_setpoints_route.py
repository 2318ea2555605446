"""Tests of routes of setpoints, each of which is held until the next one."""

import numpy as np
import pytest

from drake_quad import InputError, load_mission, plan_route
from drake_quad.reference.polynomial_path import evaluate

ROUTE_OVERRIDE = "route={kind: setpoints, setpoints: %s, last_hold: 0.5}"
# Time, position (x, y, z) and yaw of each setpoint.
SETPOINTS = [[0.0, 0.1, 0.2, 1.0, 0.3], [1.0, 0.7, -0.2, 1.1, -0.4], [1.5, 0.0, 0.0, 0.9, 0.2]]


def plan_of(setpoints):
    return plan_route(load_mission("vehicles/paper", [ROUTE_OVERRIDE % setpoints]))


def test_each_setpoint_is_held_until_the_next_one():
    plan = plan_of(SETPOINTS)
    assert plan.duration == 2.0
    times = np.array([-1.0, 0.0, 0.999, 1.0, 1.499, 1.5, 1.999, 9.0])
    expected = np.array([SETPOINTS[k][1:] for k in (0, 0, 0, 1, 1, 2, 2, 2)])
    np.testing.assert_array_equal(evaluate(plan.extended_path, times).T, expected[:, :3])
    np.testing.assert_array_equal(evaluate(plan.extended_yaw, times)[0], expected[:, 3])


def test_setpoints_have_no_feedforward():
    """All derivatives of position and yaw are zero, although the setpoints jump."""
    rows = plan_of(SETPOINTS).reference().vector_values(np.linspace(-0.5, 3.0, 50))
    fed_forward = [row for row in range(len(rows)) if row not in (0, 1, 2, 9)]
    assert not rows[fed_forward].any()
    assert np.ptp(rows[[0, 1, 2, 9]], axis=1).min() > 0.1


@pytest.mark.parametrize(
    ("setpoints", "message"),
    [
        ([[0.1, 0, 0, 1, 0]], r"setpoints.0.0 is 0.1, but must be 0"),
        ([[0, 0, 0, 1, 0], [0, 1, 0, 1, 0]], r"setpoints.1.0 is 0.*must be at least 0.0001 s later than 0.0"),
        ([[0, 0, 0, 1]], r"setpoints.0"),
        ([[0, 0, 0, 1, 90]], r"setpoints.0.4 is 90.*must be in radians"),
        ([], r"setpoints is .*at least 1 item"),
    ],
)
def test_invalid_setpoints_are_refused(setpoints, message):
    with pytest.raises(InputError, match=message):
        load_mission("vehicles/paper", [ROUTE_OVERRIDE % setpoints])
