"""What reports are made of: tables, figures, verdicts, and one page of HTML that holds all."""

import base64
import re
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Literal

from markdown import markdown

Verdict = Literal["holds", "holds in part", "does not hold", "cannot be decided"]


def judge(needed: Sequence[bool | None], *enough: bool | None) -> Verdict:
    """The verdict that follows from conditions, each true, false, or None where an interval leaves it open.

    Args:
        needed: conditions that all must be true for a claim to hold; if only some are, it holds in part.
        enough: further conditions, each of which makes the claim hold in part.
    """
    if all(needed):
        return "holds"
    conditions = {*needed, *enough}
    if any(conditions):
        return "holds in part"
    return "cannot be decided" if None in conditions else "does not hold"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def image(name: str, words: str, *, width: int = 420) -> str:
    """A figure of the folder `figures` beside the report, above what it shows.

    Args:
        name: of the figure.
        words: that say what it shows.
        width: in a page, pixels.
    """
    return f'<img src="figures/{name}.png" width="{width}" alt="{words}">\n\n*{words}*'


def report_html(text: str, folder: Path) -> str:
    """A report as a single page of HTML that holds its figures.

    Args:
        text: the report in Markdown.
        folder: of the report, which holds the figures.
    """
    body = markdown(text, extensions=["tables"])

    def embedded(match: re.Match[str]) -> str:
        content = base64.b64encode((folder / match[1]).read_bytes()).decode()
        return f'src="data:image/png;base64,{content}"'

    body = re.sub(r'src="([^":]+\.png)"', embedded, body)
    page = files(__package__).joinpath("report_page.html").read_text(encoding="utf-8")
    return page.replace("{title}", text.partition("\n")[0].removeprefix("# ")).replace("{body}", body)
