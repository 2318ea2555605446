"""What is loaded when: nobody waits for a library that nobody uses."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import drake_quad

ROOT = Path(__file__).parent.parent
SELDOM = [
    *("control", "markdown", "matplotlib", "tqdm"),
    *(f"scipy.{part}" for part in ("integrate", "interpolate", "linalg", "optimize", "signal", "spatial", "stats")),
]
HEAVY = [*SELDOM, "llvmlite", "numpy", "pydantic", "pydrake", "ruamel.yaml", "scipy"]
# Intervals of all kinds, as a study prints and draws them.
INTERVALS = (
    "import numpy as np; from drake_quad.statistics.estimates import *; x = np.arange(9.0); mean_interval(x);"
    "quantile_interval(x, 0.5); rank_correlation(x, -x); running_mean(x); two_sided_sign_test(2, 3)"
)
# What a flight needs besides: the banded matrices of its plan.
FLIGHT = "from drake_quad import load_scenario, simulate; simulate(load_scenario('diagrams/figure_eight.yaml'))"


def loaded_by(statement):
    """The modules that a new process has loaded after a statement."""
    command = f"import sys; {statement}; print(*sys.modules)"
    return subprocess.run(
        [sys.executable, "-c", command], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()


def test_the_package_alone_loads_no_library():
    assert not {*HEAVY} & {*loaded_by("import drake_quad")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statement", "wanted", "absent"),
    [
        ("from drake_quad import InputError", [], HEAVY),
        ("from drake_quad import load_scenario", ["pydantic"], SELDOM),
        ("from drake_quad import *", ["drake_quad.studies.study"], SELDOM),
        ("from drake_quad.command_line import fly, study", ["drake_quad.command_line.options"], SELDOM),
        (INTERVALS, ["scipy.special"], ["scipy.stats"]),
        ("from drake_quad.visualization import plots, study_plots", ["matplotlib"], ["scipy.spatial", "scipy.stats"]),
        (FLIGHT, ["scipy.linalg"], [name for name in SELDOM if name != "scipy.linalg"]),
    ],
)
def test_nothing_loads_a_library_that_it_does_not_use(statement, wanted, absent):
    loaded = {*loaded_by(statement)}
    assert {*wanted} <= loaded
    assert not {*absent} & loaded


def test_the_package_has_the_names_that_type_checkers_see():
    stub = ast.parse((ROOT / "drake_quad" / "__init__.pyi").read_text())
    seen = {node.names[0].asname: f"drake_quad.{node.module}" for node in stub.body if isinstance(node, ast.ImportFrom)}
    assert sorted(seen) == sorted(drake_quad.__all__)
    assert {*drake_quad.__all__} <= {*dir(drake_quad)}
    for name, module in seen.items():
        assert getattr(drake_quad, name) is getattr(importlib.import_module(module), name)


def test_a_name_that_the_package_has_not_is_an_attribute_error():
    with pytest.raises(AttributeError, match="drake_quad attribute simulat"):
        drake_quad.simulat  # noqa: B018
