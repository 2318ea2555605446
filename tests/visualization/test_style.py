"""Tests that figures have the style of the project and are written reproducibly."""

from typing import get_args

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from drake_quad.visualization import style
from drake_quad.visualization.style import Vector, new_figure, save_figures, shading, use_style


def example_figure():
    with use_style():
        figure = new_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 2.0], label="2 x")
        axes.set(xlabel="x (m)", ylabel="y (m)")
        axes.legend()
        return figure


@pytest.mark.long
@pytest.mark.parametrize("vector", get_args(Vector))
def test_a_requested_vector_drawing_is_written_reproducibly(vector, tmp_path):
    files = save_figures({"line": example_figure()}, tmp_path, vector=vector)
    assert [file.name for file in files] == ["line.png", f"line.{vector}"]
    first = files[1].read_bytes()
    assert first.startswith({"pdf": b"%PDF", "svg": b"<?xml"}[vector])
    assert save_figures({"line": example_figure()}, tmp_path, vector=vector)[1].read_bytes() == first


@pytest.mark.slow
def test_a_pdf_has_truetype_fonts(tmp_path):
    text = save_figures({"line": example_figure()}, tmp_path, vector="pdf")[1].read_bytes()
    assert b"/FontFile2" in text
    assert b"/Type3" not in text


def test_drawing_leaves_the_matplotlib_settings_unchanged():
    settings = dict(matplotlib.rcParams)
    example_figure()
    assert dict(matplotlib.rcParams) == settings


def test_colours_agree_with_okabe_and_ito():
    """M. Okabe and K. Ito, "Color universal design", 2008: red, green and blue from 0 to 255."""
    published = {
        "BLACK": (0, 0, 0),
        "ORANGE": (230, 159, 0),
        "SKY": (86, 180, 233),
        "GREEN": (0, 158, 115),
        "YELLOW": (240, 228, 66),
        "BLUE": (0, 114, 178),
        "VERMILION": (213, 94, 0),
        "PURPLE": (204, 121, 167),
    }
    for name, color in published.items():
        np.testing.assert_allclose(np.array(to_rgb(getattr(style, name))) * 255.0, color)


def test_areas_are_shaded_from_white_to_a_blue_on_which_lines_are_visible():
    """The lightness (CIE 1931, here linear in sRGB) decreases monotonically."""
    colors = shading()(np.linspace(0.0, 1.0, 11))[:, :3]
    lightness = colors @ [0.2126, 0.7152, 0.0722]
    assert lightness[0] > 0.95
    assert (np.diff(lightness) < 0.0).all()
    assert 0.5 < lightness[-1] < 0.7
    assert colors[-1].argmax() == 2


def test_axes_have_a_grid_and_no_frame():
    with use_style():
        axes = new_figure(2.0, 1.0).subplots()
        legend = axes.legend(handles=axes.plot([0.0, 1.0], label="a"))
    assert axes.xaxis.get_gridlines()[0].get_visible()
    assert not axes.spines["top"].get_visible()
    assert not axes.spines["right"].get_visible()
    assert axes.spines["left"].get_visible()
    assert not legend.get_frame_on()
