"""Tests that overview figures show the signals of their flights and the statistics of their studies."""

import io

import numpy as np
import pytest
from PIL import Image

from drake_quad import load_scenario, run_monte_carlo, simulate
from drake_quad.visualization.overview import plot_flight, plot_study
from drake_quad.visualization.style import new_figure, use_style


@pytest.mark.slow
def test_the_overview_of_a_flight_shows_its_signals():
    flight = simulate(load_scenario("diagrams/figure_eight.yaml", ["duration=5"]))
    figure, axes = plot_flight(flight)
    assert set(axes) == {"path", "error", "command", "rotors"}
    time, error = axes["error"].lines[0].get_data()
    assert time == pytest.approx(flight.time)
    assert 0.01 * np.sqrt(np.mean(error**2)) == pytest.approx(flight.metrics.rmse)
    assert len(axes["rotors"].lines) == 4
    assert all(axes[name].get_ylabel().endswith(")") for name in axes)
    figure.canvas.draw()


@pytest.mark.slow
def test_the_overview_of_studies_shows_their_statistics():
    scenario = load_scenario("diagrams/laboratory.yaml:nominal", ["duration=1"])
    studies = {name: run_monte_carlo(scenario, 5, seed, num_workers=1) for name, seed in (("a", 0), ("b", 1))}
    figure, axes = plot_study(studies)
    drawn_means = [container.lines[0].get_data() for container in axes["mean"].containers]
    assert [label.get_text() for label in axes["mean"].get_yticklabels()] == ["a", "b"]
    assert drawn_means[0][0] == pytest.approx([study.metrics.rmse.mean() for study in studies.values()])
    figure.canvas.draw()
    assert set(plot_study(studies["a"])[1]) == {"distribution", "mean", "crashes"}


def test_a_notebook_shows_a_figure():
    with use_style():
        figure = new_figure(2.0, 1.0)
    # IPython calls this method to display a value as a picture.
    assert Image.open(io.BytesIO(figure._repr_png_())).size == (220, 110)
