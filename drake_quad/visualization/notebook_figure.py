"""Figures that notebooks show."""

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure that a notebook shows where it is the last value of a cell, whether pyplot was imported or not."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """The picture, by the protocol of IPython."""
        written = io.BytesIO()
        self.savefig(written, format="png")
        return written.getvalue()
