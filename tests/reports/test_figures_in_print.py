"""Tests of the sizes and labels of figures in reports."""

import numpy as np
from PIL import Image

from drake_quad.reports.figures import COLUMN_WIDTH, print_panels, save_small
from drake_quad.statistics.interval import Interval
from drake_quad.visualization.panels import legend_above, name_rows, new_panels, plot_intervals


def test_a_printed_figure_has_the_width_of_a_column_and_a_colour_palette(tmp_path):
    with print_panels(1.0) as (figure, axes):
        axes.imshow(np.arange(400.0).reshape(20, 20))
        save_small(figure, tmp_path / "small.png")
    with Image.open(tmp_path / "small.png") as image:
        # 3.5 inches with 220 dots per inch.
        assert image.size == (770, 220)
        assert image.mode == "P"
        assert 100 < len(image.getcolors()) <= 128


def test_fonts_of_printed_figures_are_smaller_than_others():
    sizes = []
    for context in (print_panels(1.0), new_panels(COLUMN_WIDTH, 1.0)):
        with context as (_, axes):
            axes.set(xlabel="x", title="y")
            axes.plot([0.0, 1.0], label="z")
            texts = [axes.xaxis.label, axes.title, axes.get_xticklabels()[0], axes.get_yticklabels()[0]]
            sizes.append([text.get_fontsize() for text in (*texts, *axes.legend().texts)])
    small, large = np.array(sizes)
    assert (small < large).all()
    assert (small >= 7.0).all()


def test_rows_of_a_chart_are_labelled_from_top_to_bottom():
    with new_panels(2.0, 1.0, 1, 2, sharex=True) as (figure, ((axes, other),)):
        name_rows(axes, ["a", "b"])
    assert figure.get_size_inches().tolist() == [2.0, 1.0]
    assert axes.get_shared_x_axes().joined(axes, other)
    assert [text.get_text() for text in axes.get_yticklabels()] == ["a", "b"]
    assert axes.get_ylim() == (1.5, -0.5)


def test_intervals_are_drawn_as_error_bars_of_their_estimates():
    intervals = [Interval(1.0, 0.5, 3.0), Interval(2.0, 1.0, 2.5)]
    with new_panels(2.0, 1.0) as (figure, axes):
        plot_intervals(axes, [5.0, 7.0], intervals, label="ours")
        legend_above(figure, axes, 1)
    ((curve, _, (bars,)),) = axes.containers
    assert curve.get_xydata().tolist() == [[5.0, 1.0], [7.0, 2.0]]
    assert [bar.tolist() for bar in bars.get_segments()] == [[[5.0, 0.5], [5.0, 3.0]], [[7.0, 1.0], [7.0, 2.5]]]
    assert [text.get_text() for text in figure.legends[0].texts] == ["ours"]
