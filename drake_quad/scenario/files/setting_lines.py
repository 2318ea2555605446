"""Reading of a text file with settings of a firmware, such as the output of Betaflight's command `diff`."""

from pathlib import Path

from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.reading import read_text

_MAX_BYTES = 1_000_000  # the complete settings of Betaflight have 25 kB


def setting_lines(path: Path) -> Tree:
    """Read the lines of a text file, without empty lines and comments, as the list `settings` of an autopilot.

    Raises:
        InputError: if the file cannot be read or is not text.
    """
    lines = enumerate(map(str.strip, read_text(path, max_bytes=_MAX_BYTES).splitlines()), 1)
    return Tree(
        [Tree(line, Mark(str(path), number)) for number, line in lines if line and not line.startswith("#")],
        Mark(str(path), 1),
    )
