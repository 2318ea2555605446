"""Tests of the command `drake-quad` itself: help, versions, completion, shipped scenarios and interruptions."""

import os
import shutil
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import drake_quad
from drake_quad import load_scenario
from drake_quad.command_line.documentation import command_page, formula_page
from drake_quad.command_line.main import COMMANDS, command_module, main
from drake_quad.scenario.files.shipped import shipped_scenarios

ROOT = Path(__file__).parent.parent.parent


def test_help_names_all_commands_and_loads_none(root):
    statement = "import sys; from drake_quad.command_line.main import main; sys.argv = ['', '--help']\ntry: main()\n"
    statement += "except SystemExit: print(*sys.modules)"
    command = [sys.executable, "-c", statement]
    lines = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ") and line.split()[0] in COMMANDS] == [*COMMANDS]
    assert not {"numpy", "pydrake", "pydantic", "drake_quad.command_line.fly"} & {*lines[-1].split()}


def test_all_commands_are_listed_by_purpose_if_none_is_given(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["drake-quad"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code in (0, None)
    text = capsys.readouterr().out
    assert all(f"\n  {name} " in text for name in COMMANDS)
    assert text.index("\nfly:") < text.index("\ndesign:") < text.index("\nuse flight logs:")


@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_commands_use_one_blas_thread_unless_the_environment_sets_the_number(root, given, threads):
    """Commands also raise the threshold of the garbage collector."""
    statement = "import gc, os, sys; from drake_quad.command_line.main import main; sys.argv = ['', '--help']\n"
    statement += "try: main()\nexcept SystemExit: print(os.environ['OPENBLAS_NUM_THREADS'], gc.get_threshold()[0])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"} | given
    command = [sys.executable, "-c", statement]
    lines = subprocess.run(command, cwd=root, env=environment, check=True, capture_output=True, text=True).stdout
    assert lines.splitlines()[-1].split() == [threads, "50000"]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_each_command_ends_with_an_example(run, command):
    result = run(command, "--help")
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.startswith(f"usage: drake-quad {command} ")
    assert result.stdout.strip().splitlines()[-1].startswith(f"example: drake-quad {command} ")


def test_every_module_with_options_is_a_command():
    modules = {
        path.stem
        for path in (ROOT / "drake_quad" / "command_line").glob("*.py")
        if "\ndef options(" in path.read_text()
    }
    assert modules == {command.replace("-", "_") for command in COMMANDS}
    assert all(callable(command_module(command).main) for command in COMMANDS)


@pytest.mark.long
def test_a_command_runs_in_a_new_process_from_any_folder(tmp_path):
    command = [sys.executable, "-m", "drake_quad", "fly", "hover", "--set", "duration=1"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert (tmp_path / "out" / "hover" / "replay.html").exists()


def test_versions_are_printed(run):
    result = run("--version")
    assert result.returncode == 0
    assert result.stdout.startswith(f"drake_quad {drake_quad.__version__} (Drake {version('drake')}, ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["flyy"], "error: there is no command called 'flyy'; did you mean fly?"),
        (["fly", "--no-such-option"], "error: drake-quad fly has no option --no-such-option; `drake-quad fly --help`"),
    ],
)
def test_an_unknown_command_is_reported_in_one_sentence_with_status_2(monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(sys, "argv", ["drake-quad", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    printed = capsys.readouterr()
    assert (stop.value.code, printed.out) == (2, "")
    assert message in printed.err


def test_a_printed_scenario_is_a_complete_file(run, tmp_path):
    result = run("scenarios", "laboratory:high_wind", "--set", "vehicle.mass=0.7")
    assert result.returncode == 0
    (tmp_path / "mine.yaml").write_text(result.stdout, encoding="utf-8")
    assert load_scenario(tmp_path / "mine.yaml") == load_scenario("laboratory:high_wind", ["vehicle.mass=0.7"])


def test_all_shipped_scenarios_are_listed(run):
    result = run("scenarios")
    assert result.returncode == 0
    words = {word.strip(",:") for word in result.stdout.split()}
    assert {part for name in shipped_scenarios() for part in name.split(":")} == words


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on PATH")
@pytest.mark.parametrize(
    ("message", "completed"),
    [
        (["drake-quad", "rep"], {"replay", "replicate"}),
        (["drake-quad", "fly", "laboratory:h"], {"laboratory:high_wind"}),
        (["drake-quad", "fly", "vehicles/r"], {"vehicles/racer"}),
        (["drake-quad", "fly", "hover", "--save-n"], {"--save-network"}),
        (["drake-quad", "compare", "--controller", "controllers/l"], None),
    ],
)
def test_bash_completes_commands_options_and_names(run, tmp_path, message, completed):
    (tmp_path / "script").write_text(run("completion", "bash").stdout, encoding="utf-8")
    line = " ".join(message)
    program = f"""
source {tmp_path / "script"}
COMP_WORDS=({line}); COMP_CWORD={len(message) - 1}; COMP_LINE="{line}"; COMP_POINT={len(line)}
_shtab_drake_quad drake-quad "{message[-1]}" "{message[-2]}"
printf "%s\\n" "${{COMPREPLY[@]}}"
"""
    result = subprocess.run(
        ["bash", "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout.split()
    if completed is None:
        completed = {name for name in shipped_scenarios() if name.startswith(message[-1])}
        assert completed
    assert {*result} == completed


# Python program that runs a command of drake-quad and interrupts it (SIGINT) as soon as the command imports the module
# that is the first argument of the program.
INTERRUPTED_COMMAND_PROGRAM = """
import os, signal, sys

class Interruption:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)

module = sys.argv.pop(1)
sys.meta_path.insert(0, Interruption())
from drake_quad.command_line.main import main
main()
"""


@pytest.mark.long
@pytest.mark.parametrize(
    "module",
    [
        *("numpy", "drake_quad.scenario.models", "pydrake.geometry", "drake_quad.flight.simulation"),
        # Modules for the progress bar and for plots, which are loaded only when they are first used.
        *("tqdm", "matplotlib"),
    ],
)
def test_an_interruption_during_an_import_is_reported_in_a_sentence(module, tmp_path):
    flight = ["fly", "figure_eight", "--set", "duration=1", "--output", str(tmp_path)]
    command = [sys.executable, "-c", INTERRUPTED_COMMAND_PROGRAM, module, *flight]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (1, "", "interrupted: no file was written\n")


PROGRAM_WITH_WARNINGS = """
import warnings
from drake_quad.command_line.running import run
from drake_quad.errors import InputWarning
run(lambda: (warnings.warn("rock.obj: is large", InputWarning), warnings.warn("of another kind", RuntimeWarning)))
"""


@pytest.mark.slow
def test_an_input_warning_is_printed_as_a_remark():
    result = subprocess.run(
        [sys.executable, "-c", PROGRAM_WITH_WARNINGS], capture_output=True, text=True, timeout=120, check=True
    )
    first, *others = result.stderr.splitlines()
    assert first == "remark: rock.obj: is large"
    assert "RuntimeWarning: of another kind" in others[0]


def test_an_interruption_after_the_imports_raises_keyboard_interrupt(run):
    """A computation can then clean up before the process ends."""
    run("scenarios")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.slow
@pytest.mark.parametrize(("name", "update"), [("command_line", command_page), ("formulas", formula_page)])
def test_a_generated_documentation_page_is_current(root, name, update):
    page = (root / "docs" / "reference" / f"{name}.md").read_text(encoding="utf-8")
    again = "python scripts/development/document_scenarios.py --output docs/reference writes it again"
    assert update(page) == page, again


def test_the_page_of_the_commands_has_a_section_for_each(root):
    page = (root / "docs" / "reference" / "command_line.md").read_text(encoding="utf-8")
    assert all(f"\n### {command}\n" in page for command in COMMANDS)


def test_the_page_of_formulas_lists_all_functions_and_replacements(root):
    page = (root / "docs" / "reference" / "formulas.md").read_text(encoding="utf-8")
    for function in ("cos(x)", "where(mask, x, y)", "dot(first, second)", "arctan2(y, x)"):
        assert f"| `{function}` | Return " in page
    assert "| `clip` | `minimum(maximum(x, low), high)` |" in page
    assert r"| `any`, `logical_or` | `(x > 0.0) \| (y > 0.0)` |" in page
