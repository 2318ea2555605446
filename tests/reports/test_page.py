"""Tests that a page is filled in from a template, and that its HTML version needs no other file."""

import base64
import re

from drake_quad.reports import page
from drake_quad.reports.page import filled_template, image, table, write_figures, write_page
from drake_quad.statistics.interval import Interval


def test_a_table_has_a_line_below_its_header():
    assert table(("a", "b"), [("1", "2"), ("3", "4")]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n| 3 | 4 |"


def test_a_template_can_use_attributes_of_its_arguments(tmp_path, monkeypatch):
    (tmp_path / "invented_report").mkdir()
    template = tmp_path / "invented_report" / "report_template.md"
    template.write_text("{number:.2f} {interval.low:g} {figures[one]}", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    text = filled_template("invented_report", number=1.0, interval=Interval(2.0, 1.5, 3.0), figures={"one": "x"})
    assert text == "1.00 1.5 x"


def test_an_html_page_contains_its_figures(tmp_path):
    (tmp_path / "figures").mkdir()
    content = b"no picture, but bytes"
    (tmp_path / "figures" / "errors.png").write_bytes(content)
    text = f"# Title\n\n{image('errors', 'A caption.', width=50)}\n\n{table(('a', 'b'), [('1', '2')])}\n"
    files = write_page(tmp_path, text)
    assert files == [tmp_path / name for name in ("report.md", "report.html", "figures")]
    assert files[0].read_text(encoding="utf-8") == text
    html = files[1].read_text(encoding="utf-8")
    assert f'src="data:image/png;base64,{base64.b64encode(content).decode()}" width="50"' in html
    assert not re.search(r'(src|href)="(?!data:)', html)
    assert html.count("<table>") == 1
    assert "<title>Title</title>" in html
    assert "<em>A caption.</em>" in html


def test_figures_are_drawn_one_at_a_time_and_as_vector_graphics_on_request(tmp_path, monkeypatch):
    calls = []

    def named_figures():
        for number, name in enumerate("ab"):
            assert calls.count("progress") == number
            yield name, f"figure {name}"

    monkeypatch.setattr(page, "save_small", lambda *each: calls.append(each))
    monkeypatch.setattr(page, "save_vector", lambda *each: calls.append(each))
    assert write_figures(named_figures(), tmp_path, progress=lambda: calls.append("progress")) == ["a", "b"]
    folder = tmp_path / "figures"
    assert calls == [
        ("figure a", folder / "a.png"), "progress", ("figure b", folder / "b.png"), "progress"
    ]  # fmt: skip
    calls.clear()
    write_figures([("c", "figure c")], tmp_path, vector="svg")
    assert calls == [("figure c", folder / "c.png"), ("figure c", folder / "c.svg", "svg")]
