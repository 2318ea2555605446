"""README and docs: their code runs, their commands are understood, and what they name is there."""

import argparse
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from test_systems import SYSTEMS

from drake_quad import load_scenario

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# Makes the commands of the pages short; a later option stands in for an earlier one.
SHORT = {
    "simulate.py": ["--set", "duration=1"],
    "sensitivities.py": ["--set", "duration=1"],
    "monte_carlo.py": ["--samples", "4", "--set", "duration=1"],
    "replay.py": ["--samples", "3", "--set", "duration=1"],
    "stability_map.py": ["--quick", "--size", "4"],
    "compare_controllers.py": ["--quick", "--samples", "2"],
}


def blocks(language):
    found = []
    for page in PAGES:
        texts = re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        found += [pytest.param(text, id=f"{page.stem}-{i}") for i, text in enumerate(texts)]
    return found


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """An empty folder that has what the pages speak of."""
    for name in ("diagrams", "scripts", "Makefile", "pyproject.toml", "constraints.txt", ".ci", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("block", blocks("python"))
def test_every_block_of_python_runs(block, elsewhere, capsys):
    if "__main__" in block:  # worker processes import it
        (elsewhere / "block.py").write_text(block, encoding="utf-8")
        printed = subprocess.run([sys.executable, "block.py"], check=True, capture_output=True, text=True).stdout
    else:
        exec(compile(block, "page", "exec"), {"__name__": "__main__"})
        printed = capsys.readouterr().out
    assert re.search(r"\w", printed)
    assert "nan" not in printed


@pytest.mark.parametrize("block", blocks("yaml"))
def test_every_scenario_loads(block, elsewhere):
    path = elsewhere / "mine" / "loop.yaml"
    path.parent.mkdir()
    path.write_text(block, encoding="utf-8")
    load_scenario(path)


@pytest.mark.parametrize("block", blocks("sh"))
def test_every_block_of_commands_runs(block, elsewhere, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    for line in block.splitlines():
        program, *arguments = shlex.split(line, comments=True)
        if program == "make":
            subprocess.run(["make", "--dry-run", *arguments], check=True, capture_output=True)
            continue
        assert program == "python"
        monkeypatch.setattr(sys, "argv", [*arguments, *SHORT.get(Path(arguments[0]).name, [])])
        runpy.run_path(arguments[0], run_name="__main__")


class UnderstoodError(Exception):
    pass


def commands():
    """What is called somewhere on a page, the blocks above aside."""
    text = "\n".join(re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL) for page in PAGES)
    return sorted(set(re.findall(r"python (scripts/\w+\.py[^`\n]*)", text)))


@pytest.mark.parametrize("command", commands())
def test_every_command_is_understood(command, elsewhere, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    monkeypatch.setattr(sys, "argv", shlex.split(command))
    parse = argparse.ArgumentParser.parse_args

    def parse_only(parser, *arguments):
        parse(parser, *arguments)
        raise UnderstoodError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_only)
    with pytest.raises(UnderstoodError):
        runpy.run_path(sys.argv[0], run_name="__main__")
    for file in re.findall(r" (diagrams/[\w./]+)", command):
        assert Path(file).exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_path_and_link_leads_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:drake_quad|diagrams|scripts|docs)/[\w./-]*)`", text):
        assert (ROOT / path).exists(), path
    for link in re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", text):
        target = "".join(link)
        if target.startswith(("https://", "#")):
            continue
        assert (page.parent / target.partition("#")[0]).exists(), target


def test_every_page_is_reached_from_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for page in PAGES[1:]:
        assert f"(docs/{page.name})" in readme, page.name


@pytest.mark.parametrize(("documented", "make"), SYSTEMS, ids=lambda value: getattr(value, "__name__", ""))
def test_the_page_of_systems_has_the_ports_of_each(documented, make):
    page = (ROOT / "docs" / "systems.md").read_text(encoding="utf-8")
    inputs, outputs = re.search(rf"^\| `{documented.__name__}` \|(.*)\|(.*)\|.*\|$", page, re.MULTILINE).groups()
    system, widths = make(), set()
    for cell, ports in (
        (inputs, [system.get_input_port(i) for i in range(system.num_input_ports())]),
        (outputs, [system.get_output_port(i) for i in range(system.num_output_ports())]),
    ):
        said = re.findall(r"`([\w.]+)`(?: (\d+))?", cell)
        assert [name for name, _ in said] == [port.get_name() for port in ports]
        widths |= {port.size() / int(rows) for (_, rows), port in zip(said, ports, strict=True) if rows}
    assert widths <= {float(getattr(system, "num_vehicles", max(widths, default=1.0)))}


def test_the_page_of_systems_has_them_all():
    block = ".. pydrake_system::\n"
    found = [path.read_text(encoding="utf-8").count(block) for path in (ROOT / "drake_quad").rglob("*.py")]
    assert sum(found) == len({documented for documented, _ in SYSTEMS})
