"""The scenarios that come with the package, by names that mean the same wherever Python runs.

`laboratory:high_wind` is the scenario `high_wind` of `diagrams/laboratory.yaml`, and `vehicles/racer` the only one of
`diagrams/vehicles/racer.yaml`.
"""

import difflib
import re
from pathlib import Path

from drake_quad.errors import shown
from drake_quad.scenario.files.documents import parse_document

_PACKAGE = Path(__file__).parents[2]


def shipped_folder() -> Path:
    """Return the folder of the files: in an installed package a part of it, in a checkout beside it."""
    installed = _PACKAGE / "diagrams"
    return installed if installed.is_dir() else _PACKAGE.parent / "diagrams"


def shipped_file(name: str) -> Path | None:
    """The file of that name, such as `vehicles/racer`, or None; relative where it is below the working directory."""
    if not re.fullmatch(r"[\w-]+(/[\w-]+)*", name):
        return None
    path = shipped_folder() / f"{name}.yaml"
    if not path.is_file():
        return None
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def shipped_names() -> list[str]:
    """Return the names of the files, in the order of the alphabet, those at the top first."""
    folder = shipped_folder()
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.yaml")]
    return [path.as_posix() for path in sorted(files, key=lambda path: (len(path.parts), path))]


def shipped_scenarios() -> list[str]:
    """Return the names of all scenarios, and of what can be laid over one: `figure_eight`, `laboratory:nominal`."""
    found = []
    for file in shipped_names():
        path = shipped_folder() / f"{file}.yaml"
        names = [*parse_document(path.read_text(encoding="utf-8"), str(path)).value]
        found += [file] if len(names) == 1 else [f"{file}:{name}" for name in names]
    return found


def unknown(name: str) -> str:
    """Return a sentence on a name that is neither a file nor shipped."""
    names = shipped_names()
    close = difflib.get_close_matches(name.partition(":")[0], names, 1)
    hint = f"did you mean {close[0]}?" if close else "`drake-quad scenarios` lists these"
    return f"{shown(name)} is neither a file nor a scenario that is shipped; {hint}"
