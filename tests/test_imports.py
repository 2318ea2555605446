"""Tests that importing the package loads no library before it is used."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import drake_quad

ROOT = Path(__file__).parent.parent
DEFERRED_LIBRARIES = [
    *("control", "markdown", "matplotlib", "tqdm"),
    *(f"scipy.{part}" for part in ("integrate", "interpolate", "linalg", "optimize", "signal", "spatial", "stats")),
]
SLOW_LIBRARIES = [*DEFERRED_LIBRARIES, "llvmlite", "numpy", "pydantic", "pydrake", "ruamel.yaml", "scipy"]
# Statement that computes every type of confidence interval that studies use.
INTERVALS_STATEMENT = (
    "import numpy as np; from drake_quad.statistics.estimates import *; x = np.arange(9.0); mean_interval(x);"
    "quantile_interval(x, 0.5); rank_correlation(x, -x); running_mean(x); two_sided_sign_test(2, 3)"
)
# Statement that simulates a flight. Planning the route needs the banded matrices of scipy.linalg.
FLIGHT_STATEMENT = (
    "from drake_quad import load_scenario, simulate; simulate(load_scenario('diagrams/figure_eight.yaml'))"
)


# Statements that one process runs in order. Each one is followed by the modules that must be loaded after it, and by
# those that must not.
STATEMENTS = [
    ("import drake_quad", [], SLOW_LIBRARIES),
    ("from drake_quad import InputError", [], SLOW_LIBRARIES),
    ("from drake_quad import load_scenario", ["pydantic"], DEFERRED_LIBRARIES),
    ("from drake_quad import *", ["drake_quad.studies.study"], DEFERRED_LIBRARIES),
    ("from drake_quad.command_line import fly, study", ["drake_quad.command_line.options"], DEFERRED_LIBRARIES),
    (FLIGHT_STATEMENT, ["scipy.linalg"], [name for name in DEFERRED_LIBRARIES if name != "scipy.linalg"]),
    (INTERVALS_STATEMENT, ["scipy.special"], ["scipy.stats"]),
    ("from drake_quad.visualization import plots, study_plots", ["matplotlib"], ["scipy.spatial", "scipy.stats"]),
]


@pytest.fixture(scope="module")
def loaded():
    """Run the statements in a new process, and return the set of loaded modules after each of them."""
    command = "import sys\n" + "\n".join(f"{statement}\nprint(*sys.modules)" for statement, _, _ in STATEMENTS)
    printed = subprocess.run([sys.executable, "-c", command], cwd=ROOT, check=True, capture_output=True, text=True)
    return [{*line.split()} for line in printed.stdout.splitlines()]


@pytest.mark.long
@pytest.mark.parametrize("index", range(len(STATEMENTS)))
def test_a_statement_loads_only_the_libraries_that_it_uses(loaded, index):
    _, required, forbidden = STATEMENTS[index]
    assert {*required} <= loaded[index]
    assert not {*forbidden} & loaded[index]


def test_the_type_stub_of_the_package_lists_the_public_names_with_their_modules():
    stub = ast.parse((ROOT / "drake_quad" / "__init__.pyi").read_text())
    public = {
        node.names[0].asname: f"drake_quad.{node.module}" for node in stub.body if isinstance(node, ast.ImportFrom)
    }
    assert sorted(public) == sorted(drake_quad.__all__)
    assert {*drake_quad.__all__} <= {*dir(drake_quad)}
    for name, module in public.items():
        assert getattr(drake_quad, name) is getattr(importlib.import_module(module), name)


def test_an_unknown_name_of_the_package_raises_an_attribute_error():
    with pytest.raises(AttributeError, match="drake_quad attribute simulat"):
        drake_quad.simulat  # noqa: B018


def test_public_functions_accept_paths_as_text():
    """A user writes `save_scenario(scenario, "mine.yaml")`."""
    for name in drake_quad.__all__:
        function = getattr(drake_quad, name)
        for parameter in inspect.signature(function).parameters.values() if inspect.isfunction(function) else ():
            if "Path" in str(parameter.annotation):
                assert "str" in str(parameter.annotation), f"{name}({parameter})"


def test_scenarios_and_exported_code_are_written_to_paths_given_as_text(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = drake_quad.load_scenario("hover")
    drake_quad.save_scenario(scenario, "mine.yaml")
    assert drake_quad.load_scenario("mine.yaml").route == scenario.route
    drake_quad.export_controller(scenario, "code")
    assert (tmp_path / "code" / "controller.c").is_file()
