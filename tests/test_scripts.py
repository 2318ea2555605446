"""The scripts: shells over commands, and what only a checkout has."""

import re
import sys
from pathlib import Path

import pytest

from drake_quad.command_line.main import COMMANDS

ROOT = Path(__file__).parent.parent
# What a person runs: not what the others begin.
SCRIPTS = sorted(path for path in (ROOT / "scripts").glob("*.py") if path.name != "contestants.py")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_help_ends_in_an_example_of_itself(run, script):
    result = run(script.name, "--help")
    assert (result.returncode, result.stderr) == (0, "")
    example = re.search(r"example: (python scripts/\S+|drake-quad \S+)", result.stdout.strip().splitlines()[-1])
    shell = re.search(r'main\("([\w-]+)"\)', script.read_text(encoding="utf-8"))
    assert example[1] == (f"drake-quad {shell[1]}" if shell else f"python scripts/{script.name}")


def test_shells_are_over_commands_of_their_own():
    texts = [script.read_text(encoding="utf-8") for script in SCRIPTS]
    called = [call[1] for text in texts if (call := re.search(r'main\("([\w-]+)"\)', text))]
    assert {*called} < {*COMMANDS}
    assert len({*called}) == len(called) > 10


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_imports_nothing_that_takes_long_before_it_can_be_interrupted(script):
    """Python's own modules come first, then what tells of an interruption, or what imports that first."""
    imports = re.findall(r"^(?:import|from) ([\w.]+)", script.read_text(encoding="utf-8"), re.MULTILINE)
    others = [name for name in imports if name.partition(".")[0] not in sys.stdlib_module_names]
    assert others[0] in ("drake_quad.command_line.running", "drake_quad.command_line.main", "benchmark")


def test_what_runs_a_command_imports_first_what_tells_of_an_interruption():
    text = (ROOT / "drake_quad" / "command_line" / "running.py").read_text(encoding="utf-8")
    imports = re.findall(r"^(?:import|from) ([\w.]+)", text, re.MULTILINE)
    others = [name for name in imports if name.partition(".")[0] not in sys.stdlib_module_names]
    assert others[0] == "drake_quad.command_line.interruption"
