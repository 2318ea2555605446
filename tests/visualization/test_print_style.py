"""Colours are those of their source, and figures of reports have the width of a column."""

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from drake_quad.visualization import style
from drake_quad.visualization.in_print import COLUMN, in_print, save_small
from drake_quad.visualization.style import new_figure, shading, styled


def test_colours_are_those_that_okabe_and_ito_publish():
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


def test_areas_are_shaded_from_white_to_a_blue_on_which_lines_are_seen():
    """The lightness (CIE 1931, linear in sRGB here) falls steadily."""
    colors = shading()(np.linspace(0.0, 1.0, 11))[:, :3]
    lightness = colors @ [0.2126, 0.7152, 0.0722]
    assert lightness[0] > 0.95
    assert (np.diff(lightness) < 0.0).all()
    assert 0.5 < lightness[-1] < 0.7
    assert colors[-1].argmax() == 2


def test_a_figure_in_print_is_as_wide_as_a_column_and_has_a_palette(tmp_path):
    with in_print():
        figure = new_figure(COLUMN, 1.0)
        figure.subplots().imshow(np.arange(400.0).reshape(20, 20))
        save_small(figure, tmp_path / "small.png")
    with Image.open(tmp_path / "small.png") as image:
        # 3.5 inches of 220 dots each.
        assert image.size == (770, 220)
        assert image.mode == "P"
        assert 100 < len(image.getcolors()) <= 128


def test_letters_in_print_are_smaller_than_elsewhere():
    sizes = []
    for context in (in_print, styled):
        with context():
            axes = new_figure(COLUMN, 1.0).subplots()
            axes.set(xlabel="x", title="y")
            axes.plot([0.0, 1.0], label="z")
            texts = [axes.xaxis.label, axes.title, axes.get_xticklabels()[0], axes.get_yticklabels()[0]]
            sizes.append([text.get_fontsize() for text in (*texts, *axes.legend().texts)])
    small, large = np.array(sizes)
    assert (small < large).all()
    assert (small >= 7.0).all()


def test_axes_have_a_grid_and_no_frame():
    with styled():
        axes = new_figure(2.0, 1.0).subplots()
        legend = axes.legend(handles=axes.plot([0.0, 1.0], label="a"))
    assert axes.xaxis.get_gridlines()[0].get_visible()
    assert not axes.spines["top"].get_visible()
    assert not axes.spines["right"].get_visible()
    assert axes.spines["left"].get_visible()
    assert not legend.get_frame_on()
