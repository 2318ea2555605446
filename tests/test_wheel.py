"""Tests of the wheel in a new virtual environment, without the files of the repository."""

import itertools
import os
import re
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import drake_quad

ROOT = Path(__file__).parent.parent
README_BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
TESTED_COMMANDS = [
    ["fly", "laboratory:high_wind", "--set", "duration=1"],
    ["study", "robustness", "--samples", "4", "--set", "duration=1"],
    ["design", "vehicles/hummingbird"],
]
# Environment variables without PYTHONPATH and VIRTUAL_ENV, which refer to the environment of the tests.
CLEAN_ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def run_checked(*command, cwd):
    result = subprocess.run(
        [*map(str, command)], cwd=cwd, env=CLEAN_ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    run_checked(*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT, cwd=folder)
    (path,) = folder.glob("*.whl")
    return path


def link_required(distribution, extras, site):
    """Link the dependencies of a distribution and of its extras into a site-packages folder, recursively."""
    for text in distribution.requires or ():
        required = Requirement(text)
        if required.marker and not any(required.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            continue
        dependency = metadata.distribution(required.name)
        assert required.specifier.contains(dependency.version), text
        # Each name is a module, a package, or a folder with metadata or shared libraries.
        names = {path.parts[0] for path in dependency.files} - {"..", "__pycache__"}
        missing = [name for name in names if not (site / name).exists()]
        for name in missing:
            (site / name).symlink_to(dependency.locate_file(name))
        if missing:
            link_required(dependency, required.extras, site)


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Install the wheel and its dependencies in a new environment, and return the environment's `bin` folder.

    The dependencies are linked, which is faster than installing them again.
    """
    folder = tmp_path_factory.mktemp("environment")
    run_checked(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", folder / "venv" / "bin" / "python"]
    run_checked(*pip, "install", "--no-compile", "--no-deps", "--no-index", wheel, cwd=folder)
    (site,) = (folder / "venv").glob("lib/python*/site-packages")
    (distribution,) = metadata.distributions(name="drake_quad", path=[str(site)])
    link_required(distribution, (), site)
    return folder / "venv" / "bin"


@pytest.mark.long
def test_the_wheel_contains_exactly_the_shipped_files(wheel):
    assert wheel.name.startswith(f"drake_quad-{drake_quad.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    files = [path for kind in ("yaml", "npz", "param", "env") for path in (ROOT / "diagrams").rglob(f"*.{kind}")]
    shipped = {f"drake_quad/{path.relative_to(ROOT)}" for path in files}
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "drake_quad").rglob("*") if path.is_file()}
    assert names == shipped | {name for name in sources if "__pycache__" not in name}


# Program that runs all commands and code blocks in one process, because importing and compiling take most of the time.
# It does not render figures, because this takes most of the remaining time.
RUN_ALL = """
import sys
from matplotlib.figure import Figure
from drake_quad.command_line.main import main
Figure.savefig = lambda figure, file, **_: file.touch()
for block in {blocks!r}:
    exec(block, {{"__name__": "__main__"}})
for command in {commands!r}:
    sys.argv[1:] = command
    main()
"""


@pytest.fixture(scope="module")
def printed(installed, tmp_path_factory):
    """Run the README's code blocks and the commands in an empty folder; return their output and the folder."""
    folder = tmp_path_factory.mktemp("elsewhere")
    return run_checked(
        installed / "python", "-c", RUN_ALL.format(blocks=README_BLOCKS, commands=TESTED_COMMANDS), cwd=folder
    ), folder


@pytest.mark.long
def test_code_blocks_of_the_readme_run_without_the_repository(printed):
    errors = re.findall(r"\d cm", printed[0].partition("wrote\n")[0])
    assert len(errors) >= len(README_BLOCKS)


@pytest.mark.long
def test_commands_run_without_the_repository(printed):
    text, folder = printed
    lists = text.split("wrote\n")[1:]
    assert len(lists) == len(TESTED_COMMANDS)
    for each in lists:
        written_files = [
            line.strip() for line in itertools.takewhile(lambda line: line.startswith("  "), each.splitlines())
        ]
        assert written_files
        assert all((folder / path).exists() for path in written_files)


@pytest.mark.long
def test_the_installed_program_prints_the_version_of_the_wheel(installed, tmp_path):
    printed = run_checked(installed / "drake-quad", "--version", cwd=tmp_path)
    assert printed.startswith(f"drake_quad {drake_quad.__version__} ")
    assert run_checked(installed / "python", "-m", "drake_quad", "scenarios", cwd=tmp_path).startswith("bad_day:")
