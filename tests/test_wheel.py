"""What is installed from the wheel works in an empty environment, far from the checkout."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import drake_quad

ROOT = Path(__file__).parent.parent
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
COMMANDS = [
    ["fly", "laboratory:high_wind", "--set", "duration=2"],
    ["study", "robustness", "--samples", "4", "--set", "duration=1"],
    ["design", "vehicles/hummingbird"],
]
# Without what leads back to the checkout, or to the environment of the tests.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def called(*command, cwd):
    result = subprocess.run([*map(str, command)], cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    called(*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT, cwd=folder)
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The programs of an environment that has nothing but the wheel and what it asks for."""
    folder = tmp_path_factory.mktemp("environment")
    called(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    pip = [folder / "venv" / "bin" / "python", "-m", "pip", "--disable-pip-version-check"]
    called(*pip, "install", "--no-compile", "--constraint", ROOT / "constraints.txt", wheel, cwd=folder)
    return folder / "venv" / "bin"


@pytest.mark.slow
def test_the_wheel_has_what_is_shipped_and_nothing_else(wheel):
    assert wheel.name.startswith(f"drake_quad-{drake_quad.__version__}-")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
    files = [path for kind in ("yaml", "npz") for path in (ROOT / "diagrams").rglob(f"*.{kind}")]
    shipped = {f"drake_quad/{path.relative_to(ROOT)}" for path in files}
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "drake_quad").rglob("*") if path.is_file()}
    assert names == shipped | {name for name in sources if "__pycache__" not in name}


@pytest.mark.slow
@pytest.mark.parametrize("block", BLOCKS, ids=["ten_lines", "own_controller"])
def test_what_the_readme_shows_runs_elsewhere(installed, tmp_path, block):
    assert re.search(r"\d cm", called(installed / "python", "-c", block, cwd=tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: arguments[0])
def test_commands_run_elsewhere(installed, tmp_path, arguments):
    printed = called(installed / "drake-quad", *arguments, cwd=tmp_path)
    written = [Path(line.strip()) for line in printed.partition("wrote\n")[2].splitlines() if line.startswith("  ")]
    assert written
    assert all((tmp_path / path).exists() for path in written)


@pytest.mark.slow
def test_the_version_is_that_of_the_wheel(installed, tmp_path):
    printed = called(installed / "drake-quad", "--version", cwd=tmp_path)
    assert printed.startswith(f"drake_quad {drake_quad.__version__} ")
    assert called(installed / "python", "-m", "drake_quad", "scenarios", cwd=tmp_path).startswith("bad_day:")
