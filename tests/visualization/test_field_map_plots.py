"""Tests that maps show which flights crash, violate a requirement or satisfy all requirements."""

import math

import numpy as np

from drake_quad import load_scenario
from drake_quad.design.field_map import FieldMap
from drake_quad.visualization.field_map_plots import plot_field_maps

# Metrics of four flights, one for each cell of a map. The first flight crashes, the second violates the requirement,
# the third does not settle, and the fourth settles.
CRASH_TIME = np.array([[1.0, math.inf], [math.inf, math.inf]])
RECOVERY_ROBUSTNESS = np.array([[0.5, -0.1], [0.2, 0.3]])  # m, for each cell of the map
SETTLING_TIME = np.array([[2.0, 3.0], [math.inf, 4.0]])  # s, for each cell of the map; infinite without settling


def field_map():
    kind = load_scenario("upset").metrics_type
    values = dict.fromkeys(kind._fields, np.ones((2, 2)))
    values |= {"crash_time": CRASH_TIME, "recovers": RECOVERY_ROBUSTNESS, "settling_time": SETTLING_TIME}
    return FieldMap(np.array([-1.5, 1.5]), np.array([-5.0, 5.0]), kind(**values), ("recovers",))


def draw_maps(count=1):
    maps = {f"controller {i}": field_map() for i in range(count)}
    labels = ("initial.attitude.0", "initial.body_rates.0")
    return plot_field_maps(maps, "settling_time", labels=labels, units=("rad", "rad/s"))


def test_cells_are_dark_grey_light_grey_or_coloured():
    background, metric = draw_maps().axes[0].images
    np.testing.assert_array_equal(background.get_array(), [[1.0, 0.0], [0.0, 0.0]])
    crashed, not_crashed = (background.cmap(value)[0] for value in (1.0, 0.0))
    assert crashed < 0.5 < not_crashed
    np.testing.assert_array_equal(metric.get_array().mask, [[True, True], [True, False]])
    assert metric.get_array()[1, 1] == 4.0


def test_titles_state_the_fraction_of_satisfactory_flights_and_angles_are_in_degrees():
    figure = draw_maps(5)
    panels = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in panels] == [f"controller {i}: 50 %" for i in range(5)]
    np.testing.assert_allclose(panels[0].get_xlim(), np.degrees([-3.0, 3.0]))
    np.testing.assert_allclose(panels[0].get_ylim(), [-10.0, 10.0])
    assert figure.get_supxlabel() == "initial.attitude.0 (°)"
    assert figure.get_supylabel() == "initial.body_rates.0 (rad/s)"


def test_a_map_in_which_all_flights_crash_is_drawn():
    worst = field_map()
    worst = worst._replace(metrics=worst.metrics._replace(crash_time=np.ones((2, 2))))
    figure = plot_field_maps({"a": worst}, "settling_time", labels=("x", "y"), units=("m", "m"))
    assert figure.axes[0].get_title() == "a: 0 %"
