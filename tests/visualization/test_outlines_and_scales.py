"""Tests of waypoint numbers, camera scales, and the parts and colours of drawn vehicles."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.flight.mission import plan_route
from drake_quad.visualization import plan_plots
from drake_quad.visualization.frames import Camera
from drake_quad.visualization.replay import page, shapes
from drake_quad.visualization.style import BLACK, VERMILION, new_figure


@pytest.mark.parametrize(("count", "numbered"), [(30, True), (31, False)])
def test_more_than_thirty_waypoints_have_no_numbers(count, numbered):
    waypoints = np.stack([np.arange(count), np.zeros(count), np.ones(count)])
    for view in ((0, 1), (0, 2)):
        axes = new_figure(2.0, 2.0).subplots()
        plan_plots._draw_view(axes, view, waypoints.T, waypoints, (), ())
        # Only the view from above shows the numbers of the waypoints.
        shown_numbers = range(count) if numbered and view == (0, 1) else ()
        assert [label.get_text() for label in axes.texts] == [str(i) for i in shown_numbers]


@pytest.mark.slow
def test_a_camera_has_one_scale_along_all_axes():
    scenario = load_scenario("figure_eight")
    axes = Camera(scenario, plan_route(scenario))._axes
    lengths = np.ptp([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()], axis=1)
    np.testing.assert_allclose(lengths / lengths[0], axes._box_aspect / axes._box_aspect[0])


def test_arms_are_thicker_than_blades_and_both_are_flat():
    (arm_width, arm_height), (blade_width, blade_height) = shapes._ARM_SECTION, shapes._BLADE_SECTION
    assert shapes._MAX_PROPELLER_RADIUS / 4.0 > arm_width > arm_height > blade_height
    assert arm_width > blade_width > blade_height


def test_no_vehicle_of_a_swarm_has_a_colour_similar_to_a_crash():
    assert set(page._BODY_COLORS[:2]) == {BLACK, VERMILION}
    assert len(set(page._BODY_COLORS)) == 7
