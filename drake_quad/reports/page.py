"""Pages of reports: Markdown from a template, a self-contained HTML page, and the figures of both."""

import base64
import re
from collections.abc import Callable, Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markdown import markdown

from drake_quad.files import output_folder, write_text
from drake_quad.reports.figures import save_small
from drake_quad.visualization.style import Vector, save_vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Name of the folder with the figures, in the folder of the pages.
_FIGURES_FOLDER = "figures"


def row(cells: Iterable[str]) -> str:
    """Return a row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def table(header: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(map(row, [header, ["---"] * len(header), *rows]))


def image(name: str, caption: str, *, width: int = 420) -> str:
    """Return the Markdown of a figure above its caption.

    Args:
        name: name of the figure.
        caption: text that says what the figure shows.
        width: width on the page, pixels.
    """
    return f'<img src="{_FIGURES_FOLDER}/{name}.png" width="{width}" alt="{caption}">\n\n*{caption}*'


def filled_template(package: str, **fields: Any) -> str:
    """Return the text of `report_template.md` in a package, with its fields replaced by the given values."""
    return files(package).joinpath("report_template.md").read_text(encoding="utf-8").format_map(fields)


def write_figures(
    figures: Iterable[tuple[str, "Figure"]],
    folder: Path,
    *,
    vector: Vector | None = None,
    progress: Callable[[], object] = lambda: None,
) -> list[str]:
    """Write the figures of a report and return their names.

    Args:
        figures: figures by name, which are drawn one after another.
        folder: folder of the report.
        vector: format of additional vector graphics; None for no vector graphics.
        progress: function that is called after each figure.
    """
    target, names = output_folder(folder / _FIGURES_FOLDER), []
    for name, figure in figures:
        save_small(figure, target / f"{name}.png")
        if vector is not None:
            save_vector(figure, target / f"{name}.{vector}", vector)
        names.append(name)
        progress()
    return names


def write_page(folder: Path, text: str) -> list[Path]:
    """Write a report as Markdown and as HTML, and return both files and the folder of their figures.

    Args:
        folder: folder of the report, in which `write_figures` has written the figures.
        text: report in Markdown.
    """
    return [
        write_text(folder / "report.md", text),
        write_text(folder / "report.html", as_html(text, folder)),
        folder / _FIGURES_FOLDER,
    ]


def as_html(text: str, folder: Path) -> str:
    """Return a report as an HTML page that contains its figures."""

    def embedded(match: re.Match[str]) -> str:
        content = base64.b64encode((folder / match[1]).read_bytes()).decode()
        return f'src="data:image/png;base64,{content}"'

    body = re.sub(r'src="([^":]+\.png)"', embedded, markdown(text, extensions=["tables"]))
    page = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    return page.replace("{title}", text.partition("\n")[0].removeprefix("# ")).replace("{body}", body)
