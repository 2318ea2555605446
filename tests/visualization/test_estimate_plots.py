"""Tests of plots of the estimates of a filter for a logged flight."""

import numpy as np
import pytest
from figure_content import curve, legends

from drake_quad.identification.logged_estimate import EstimateErrors, LoggedEstimate
from drake_quad.visualization.estimate_plots import plot_estimate

TIME = 2.0 + 0.01 * np.arange(50)


def random_errors(num_samples, seed):
    rng = np.random.default_rng(seed)
    return EstimateErrors(
        *rng.normal(size=(2, num_samples, 3)), rng.uniform(size=num_samples), rng.normal(size=num_samples)
    )


def test_errors_of_two_estimates_are_drawn_over_two_standard_deviations_of_the_filter():
    """The on-board estimate has one sample before the first sample of the filter. The vehicle lands before the end."""
    errors, on_board = random_errors(50, seed=1), random_errors(51, seed=2)
    errors.position[-1] = 99.0
    deviations = np.random.default_rng(3).uniform(0.5, 1.0, size=(50, 15))
    nothing = np.zeros(3)
    is_flying = np.arange(50) < 49
    estimate = LoggedEstimate(TIME, is_flying, errors, deviations, np.zeros((50, 6)), nothing, nothing, 0.0, 0.01)
    figure = plot_estimate(estimate, on_board)
    assert legends(figure) == ["2 standard deviations", "on board", "this filter"]
    position, velocity, tilt, yaw = figure.axes
    for axes, factor, name, columns in (
        (position, 1e2, "position", [0, 1, 2]),
        (velocity, 1e2, "velocity", [3, 4, 5]),
        (tilt, 1e3, "tilt", [6, 7]),
        (yaw, 1e3, "yaw", [8]),
    ):
        sizes = [
            np.linalg.norm(getattr(each, name).reshape(len(each.yaw), -1), axis=1)[-50:] for each in (errors, on_board)
        ]
        for label, size in zip(("this filter", "on board"), sizes, strict=True):
            np.testing.assert_allclose(curve(axes, label), [TIME, factor * size])
        (band,) = axes.collections
        expected = 2.0 * factor * np.linalg.norm(deviations[:, columns], axis=1)
        np.testing.assert_allclose(band.get_paths()[0].vertices[:, 1].max(), expected.max())
        # The axis fits the errors in flight.
        largest = factor * max(size[is_flying].max() for size in sizes)
        assert axes.get_ylim() == pytest.approx((0.0, 1.1 * largest))
        assert axes.get_xlim() == (TIME[0], TIME[-1])
    labels = ["position error (cm)", "velocity error (cm/s)", "tilt error (mrad)", "yaw error (mrad)"]
    assert [axes.get_ylabel() for axes in figure.axes] == labels
    assert yaw.get_xlabel() == "time (s)"
    assert legends(plot_estimate(estimate)) == ["2 standard deviations", "this filter"]
