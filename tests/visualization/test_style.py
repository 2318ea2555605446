"""Figures as files."""

from typing import get_args

import matplotlib
import pytest

from drake_quad.visualization.style import Vector, new_figure, save_figures, styled


def drawn():
    with styled():
        figure = new_figure(3.0, 2.0)
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 2.0], label="2 x")
        axes.set(xlabel="x (m)", ylabel="y (m)")
        axes.legend()
        return figure


@pytest.mark.slow
@pytest.mark.parametrize("vector", get_args(Vector))
def test_a_vector_drawing_is_there_if_asked_for_and_the_same_each_time(vector, tmp_path):
    files = save_figures({"line": drawn()}, tmp_path, vector=vector)
    assert [file.name for file in files] == ["line.png", f"line.{vector}"]
    first = files[1].read_bytes()
    assert first.startswith({"pdf": b"%PDF", "svg": b"<?xml"}[vector])
    assert save_figures({"line": drawn()}, tmp_path, vector=vector)[1].read_bytes() == first


@pytest.mark.slow
def test_a_pdf_has_the_fonts_that_publishers_take(tmp_path):
    text = save_figures({"line": drawn()}, tmp_path, vector="pdf")[1].read_bytes()
    assert b"/FontFile2" in text
    assert b"/Type3" not in text


def test_the_style_is_left_as_it_was():
    before = dict(matplotlib.rcParams)
    drawn()
    assert dict(matplotlib.rcParams) == before
