"""Figures that notebooks show."""

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """Figure that a notebook shows as the last value of a cell, whether pyplot was imported or not."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """Return the figure as a PNG image, for IPython."""
        written = io.BytesIO()
        self.savefig(written, format="png")
        return written.getvalue()
