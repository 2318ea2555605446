"""Functions that extract curves and legends from figures, for tests of their content."""


def curve(axes, label):
    """Return the data (2, N) of the curve that has a given label."""
    (result,) = [line for line in axes.lines if line.get_label() == label]
    return result.get_xydata().T


def legends(figure):
    """Return the texts of all legends of a figure, in order."""
    all_legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    return [text.get_text() for legend in all_legends if legend is not None for text in legend.get_texts()]
