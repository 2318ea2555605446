"""Matplotlib figure that notebooks display."""

import io
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """Figure that a notebook displays as the value of a cell, even without importing pyplot."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        """Return the figure as a PNG image, for IPython."""
        written = io.BytesIO()
        self.savefig(written, format="png")
        return written.getvalue()
