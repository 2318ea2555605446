"""Look-up of the scenarios that are shipped with the package.

Their names do not depend on the working directory. `laboratory:high_wind` is the scenario `high_wind` of
`diagrams/laboratory.yaml`, and `vehicles/racer` is the only scenario of `diagrams/vehicles/racer.yaml`.
"""

import re
from contextlib import suppress
from pathlib import Path

from drake_quad.errors import did_you_mean, short_repr, shortest_path
from drake_quad.scenario.files.documents import parse_document

_PACKAGE_FOLDER = Path(__file__).parents[2]


def shipped_folder() -> Path:
    """Return the folder of the shipped files: inside an installed package, or next to the package in a checkout."""
    installed = _PACKAGE_FOLDER / "diagrams"
    return installed if installed.is_dir() else _PACKAGE_FOLDER.parent / "diagrams"


def shipped_file(name: str) -> Path | None:
    """Return the path of a shipped file such as `vehicles/racer`, or None if it does not exist.

    A path inside the working directory is returned relative to this directory.
    """
    if not re.fullmatch(r"[\w-]+(/[\w-]+)*", name):
        return None
    path = shipped_folder() / f"{name}.yaml"
    return shortest_path(path) if path.is_file() else None


def shipped_names() -> list[str]:
    """Return the names of the shipped files in alphabetical order; files in the top folder come first."""
    folder = shipped_folder()
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.yaml")]
    return [path.as_posix() for path in sorted(files, key=lambda path: (len(path.parts), path))]


def shipped_scenarios() -> list[str]:
    """Return the names of all shipped scenarios and layers, such as `figure_eight` and `laboratory:nominal`."""
    specs = []
    for file in shipped_names():
        path = shipped_folder() / f"{file}.yaml"
        names = [*parse_document(path.read_text(encoding="utf-8"), str(path)).tree.value]
        specs += [file] if len(names) == 1 else [f"{file}:{name}" for name in names]
    return specs


def unknown_name_message(name: str) -> str:
    """Return the error message for a name that is neither a file nor a shipped scenario."""
    file, _, member = name.partition(":")
    question = did_you_mean(file, shipped_names(), 1)
    with suppress(OSError, ValueError):  # the text may be too long for a path or contain a null character
        if member and Path(f"{file}.py").is_file():
            question = f"did you mean {file}.py:{member}?"
    if file.endswith(".py"):
        question = f"a controller in Python is given by --controller {name}"
    hint = question or "`drake-quad scenarios` lists the shipped scenarios"
    return f"{short_repr(name)} is neither a file nor a shipped scenario; {hint}"
