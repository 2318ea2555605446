"""Tests that Lissajous figures are sines of time along each axis."""

import math

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.flight.mission import plan_route
from drake_quad.reference.lissajous import lissajous
from drake_quad.reference.polynomial_path import evaluate

FIGURES = [
    {"centre": (0.3, -1.0, 1.5), "amplitude": (1.25, 0.0, 0.75), "turns": (1, 0, 2), "phase": (0.0, 0.0, 0.0)},
    {"centre": (0.0, 2.0, 3.0), "amplitude": (-0.4, 2.0, 0.9), "turns": (3, 1, 5), "phase": (0.2, -1.3, 4.0)},
    {"centre": (0.0, 0.0, 1.0), "amplitude": (0.0, 0.0, 0.0), "turns": (0, 0, 0), "phase": (0.0, 0.0, 0.0)},
]


@pytest.mark.parametrize("figure", FIGURES)
def test_the_path_and_its_derivatives_agree_with_sines(figure):
    period, laps = 7.3, 2
    path = lissajous(**figure, period=period, laps=laps)
    assert (path.times[0], path.times[-1]) == (0.0, pytest.approx(period * laps))
    times = np.random.default_rng(0).uniform(0.0, period * laps, 300)
    for order, fraction in enumerate((1e-9, 1e-8, 1e-6, 1e-5, 1e-3)):
        for axis in range(3):
            w = math.tau * figure["turns"][axis] / period
            a = figure["amplitude"][axis]
            expected = a * w**order * np.sin(w * times + figure["phase"][axis] + order * math.pi / 2.0)
            if order == 0:
                expected = expected + figure["centre"][axis]
            np.testing.assert_allclose(
                evaluate(path, times, order)[axis], expected, rtol=0, atol=fraction * max(1e-3, abs(a) * w**order)
            )


def test_a_scenario_can_fly_a_lissajous_figure(diagrams):
    route = (
        "route={kind: lissajous, centre: [1, 2, 1.5], amplitude: [0.5, 0, 0.2], turns: [1, 0, 2], period: 9, laps: 3}"
    )
    plan = plan_route(load_scenario(diagrams / "hover.yaml", [route, "route.yaw=0.4"]))
    assert (plan.duration, plan.initial_yaw) == (pytest.approx(27.0), 0.4)
    np.testing.assert_allclose(plan.derivative(0).value(9.0 / 8.0)[:, 0], [1.0 + math.sqrt(0.125), 2.0, 1.7], atol=1e-9)
