"""Tests that libraries are imported only when they are used."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import drake_quad

ROOT = Path(__file__).parent.parent
OPTIONAL = [
    *("control", "markdown", "matplotlib", "tqdm"),
    *(f"scipy.{part}" for part in ("integrate", "interpolate", "linalg", "optimize", "signal", "spatial", "stats")),
]
HEAVY = [*OPTIONAL, "llvmlite", "numpy", "pydantic", "pydrake", "ruamel.yaml", "scipy"]
# Statement that computes all kinds of intervals of a study.
INTERVALS = (
    "import numpy as np; from drake_quad.statistics.estimates import *; x = np.arange(9.0); mean_interval(x);"
    "quantile_interval(x, 0.5); rank_correlation(x, -x); running_mean(x); two_sided_sign_test(2, 3)"
)
# Statement that simulates a flight, whose plan needs the banded matrices of scipy.linalg.
FLIGHT = "from drake_quad import load_scenario, simulate; simulate(load_scenario('diagrams/figure_eight.yaml'))"


# One process runs these statements in order. After each statement, the first list of modules must be loaded, and the
# second list must not.
STATEMENTS = [
    ("import drake_quad", [], HEAVY),
    ("from drake_quad import InputError", [], HEAVY),
    ("from drake_quad import load_scenario", ["pydantic"], OPTIONAL),
    ("from drake_quad import *", ["drake_quad.studies.study"], OPTIONAL),
    ("from drake_quad.command_line import fly, study", ["drake_quad.command_line.options"], OPTIONAL),
    (FLIGHT, ["scipy.linalg"], [name for name in OPTIONAL if name != "scipy.linalg"]),
    (INTERVALS, ["scipy.special"], ["scipy.stats"]),
    ("from drake_quad.visualization import plots, study_plots", ["matplotlib"], ["scipy.spatial", "scipy.stats"]),
]


@pytest.fixture(scope="module")
def loaded():
    """Return the modules that are loaded after each statement in a new process."""
    command = "import sys\n" + "\n".join(f"{statement}\nprint(*sys.modules)" for statement, _, _ in STATEMENTS)
    printed = subprocess.run([sys.executable, "-c", command], cwd=ROOT, check=True, capture_output=True, text=True)
    return [{*line.split()} for line in printed.stdout.splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(STATEMENTS)))
def test_only_libraries_that_are_used_are_loaded(loaded, index):
    _, required, forbidden = STATEMENTS[index]
    assert {*required} <= loaded[index]
    assert not {*forbidden} & loaded[index]


def test_the_package_has_the_names_that_type_checkers_see():
    stub = ast.parse((ROOT / "drake_quad" / "__init__.pyi").read_text())
    public = {
        node.names[0].asname: f"drake_quad.{node.module}" for node in stub.body if isinstance(node, ast.ImportFrom)
    }
    assert sorted(public) == sorted(drake_quad.__all__)
    assert {*drake_quad.__all__} <= {*dir(drake_quad)}
    for name, module in public.items():
        assert getattr(drake_quad, name) is getattr(importlib.import_module(module), name)


def test_an_unknown_name_of_the_package_is_an_attribute_error():
    with pytest.raises(AttributeError, match="drake_quad attribute simulat"):
        drake_quad.simulat  # noqa: B018
