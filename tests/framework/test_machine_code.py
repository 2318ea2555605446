"""Machine code against Python."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numba.core.caching import CacheImpl

from drake_quad import elementary
from drake_quad.framework.formulas import TILE, compiled, fleet_map, formula, loop, source_files, telling_of_compilation
from drake_quad.vehicle.stepping import rigid_step

angles = st.floats(-1e5, 1e5)


@njit
def sin_cos(x):
    return elementary.sin_cos(x)


@njit
def of_one(x):
    return (
        elementary.cos(x),
        elementary.arctan(x),
        elementary.exp(x),
        elementary.log(abs(x)),
        elementary.log_of_1_plus(abs(x)),
        elementary.sqrt(abs(x)),
        elementary.wrapped(x),
    )


@njit
def of_two(x, y):
    return (
        elementary.arctan2(x, y),
        elementary.maximum(x, y),
        elementary.minimum(x, y),
        elementary.where(x > y, x, y),
    )


@njit
def arcsin(x):
    return elementary.arcsin(x)


@settings(max_examples=500, deadline=None)
@given(angles)
def test_sine_and_cosine_agree_with_the_library(x):
    np.testing.assert_allclose(sin_cos(x), (math.sin(x), math.cos(x)), rtol=0.0, atol=2.3e-16)


@settings(max_examples=500, deadline=None)
@given(st.one_of(st.floats(-700.0, 700.0), st.floats(-4.0, 4.0), st.floats(-1e-8, 1e-8)))
def test_functions_agree_with_the_library(x):
    with np.errstate(divide="ignore"):
        log = np.log(abs(x)) if abs(x) > 1e-300 else -math.inf
    expected = (
        math.cos(x),
        math.atan(x),
        math.exp(x),
        log,
        math.log1p(abs(x)),
        math.sqrt(abs(x)),
        math.remainder(x, math.tau),
    )
    found = of_one(x) if abs(x) > 1e-300 else (*of_one(x)[:3], log, *of_one(x)[4:])
    np.testing.assert_allclose(found[:6], expected[:6], rtol=5e-16, atol=3e-16)
    # Half a turn is as good as half a turn back.
    assert math.remainder(found[6] - expected[6], math.tau) == pytest.approx(0.0, abs=2e-13)


@settings(max_examples=500, deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_functions_of_two_agree_with_the_library(x, y):
    expected = math.atan2(x, y), max(x, y), min(x, y), max(x, y)
    np.testing.assert_allclose(of_two(x, y), expected, rtol=5e-16, atol=0.0)


@settings(max_examples=500, deadline=None)
@given(st.floats(-1.0, 1.0))
def test_arcsine_agrees_with_the_library(x):
    assert arcsin(x) == pytest.approx(math.asin(x), rel=5e-16, abs=0.0)


def test_what_is_no_number_and_what_is_none_any_more():
    nan, inf = math.nan, math.inf
    np.testing.assert_array_equal(np.array([sin_cos(x) for x in (inf, nan, 2e6)]), nan)
    np.testing.assert_array_equal([arcsin(x) for x in (1.1, -2.0, nan)], nan)
    np.testing.assert_array_equal([of_one(x)[1:3] for x in (inf, -inf)], [(math.pi / 2, inf), (-math.pi / 2, 0.0)])
    np.testing.assert_array_equal(of_one(nan), nan)
    assert of_one(0.0)[3] == -inf
    assert of_one(inf)[3] == inf
    # As for Python's numbers: the other one replaces what is none, and zeros have signs.
    assert of_two(nan, 1.0)[1:3] == (1.0, 1.0)
    for y in (0.0, -0.0):
        for x in (0.0, -0.0, 1.0, -1.0):
            assert math.copysign(1.0, of_two(y, x)[0]) == math.copysign(1.0, y)
            assert of_two(y, x)[0] == math.atan2(y, x)
    assert math.isnan(of_two(nan, 1.0)[0])


@formula
def turned(place, angle, scale, offset):
    s, c = elementary.sin_cos(angle[0])
    x, y = place
    return (scale[0] * (c * x - s * y) + offset, scale[0] * (s * x + c * y)), (angle[0] + offset,)


@pytest.mark.parametrize("n", [1, 2, TILE - 1, TILE, TILE + 1, 3 * TILE + 5])
def test_a_formula_is_applied_to_every_vehicle(n):
    rng = np.random.default_rng(n)
    place, angle, scale = rng.normal(size=(2, n)), rng.normal(size=(1, n)), rng.uniform(1.0, 2.0, size=(1, n))
    apply = fleet_map(turned, (2, 1, 1), (2, 1))
    expected = np.vstack([np.array(group) for group in turned(place, angle, scale, 0.5)])
    together, first, second = np.empty(3 * n), np.empty(2 * n), np.empty(n)
    apply(n, (together,), (place.ravel(), angle.ravel(), scale.ravel()), (0.5,))
    np.testing.assert_allclose(together.reshape(3, n), expected, rtol=1e-14, atol=1e-15)
    # The rows go on from one array to the next; a single scale stands for all; sources may be written.
    apply(n, (first, second), (place.ravel(), angle.ravel(), scale[0, :1]), (0.5,))
    alike = turned(place, angle, scale[:, :1], 0.5)
    np.testing.assert_allclose(first.reshape(2, n), alike[0], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(second, alike[1][0], rtol=1e-14)
    own = place.ravel().copy()
    apply(n, (own, second), (own, angle.ravel(), scale[0, :1]), (0.5,))
    np.testing.assert_array_equal(own, first)


def test_arrays_of_wrong_sizes_are_refused():
    apply = fleet_map(turned, (2, 1, 1), (2, 1))
    place, angle, scale = np.zeros(8), np.zeros(4), np.ones(1)
    for targets, sources in (
        ((np.empty(12),), (np.zeros(7), angle, scale)),
        ((np.empty(12),), (place, np.zeros(3), scale)),
        ((np.empty(11),), (place, angle, scale)),
        ((np.empty(8), np.empty(8)), (place, angle, scale)),
    ):
        with pytest.raises(ValueError, match="wrong size"):
            apply(4, targets, sources, (0.5,))


@loop
def total(values):
    result = 0.0 * values[0]
    for value in values:
        result += value
    return result


@compiled
def totals(table):
    result = np.zeros_like(table[0])
    for i in range(table.shape[1]):
        result[i] = total(table[:, i])
    return result


def test_loops_over_other_elements_are_python():
    table = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(totals(table), table.sum(axis=0))
    assert totals(table.astype(object)).dtype == object
    np.testing.assert_array_equal(totals(table.astype(object)).astype(float), table.sum(axis=0))


def test_machine_code_is_made_anew_when_a_file_that_it_comes_from_changes():
    files = {Path(file).name for file in source_files(rigid_step)}
    expected = {"stepping.py", "dynamics.py", "faults.py", "parameters.py", "elementary.py"}
    assert files == expected | {"compiled.py", "compiled_elementary.py"}


def test_compiling_is_told_once():
    told = []
    with telling_of_compilation(lambda: told.append("compiling")):
        assert [njit(lambda x: x + 1.0)(1.0), njit(lambda x: 2.0 * x)(1.0)] == [2.0, 2.0]
    assert told == ["compiling"]
    assert njit(lambda x: 3.0 * x)(1.0) == 3.0
    assert told == ["compiling"]


def test_machine_code_needs_no_place_to_be_kept(monkeypatch):
    """As where neither the package's folder nor the user's can be written."""
    monkeypatch.setattr(CacheImpl, "_locator_classes", [])
    assert compiled(totals.__wrapped__)(np.ones((2, 3))).tolist() == [2.0, 2.0, 2.0]


def test_machine_code_of_other_processes_is_not_mistaken(tmp_path):
    """Two that compile a function each, which Numba numbers alike, and a third that reads both from the disk."""
    (tmp_path / "own.py").write_text(
        "from drake_quad.framework.formulas import compiled\n"
        "@compiled\ndef halved(a):\n    return 0.5 * a\n"
        "@compiled\ndef total(a):\n    result = 0.0\n    for x in a:\n        result += x\n    return result\n"
    )
    code = "import sys, numpy as np, own; [print(getattr(own, name)(np.arange(4.0))) for name in sys.argv[1:]]"
    expected = {"halved": "[0.  0.5 1.  1.5]", "total": "6.0"}
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    for names in (["halved"], ["total"], ["total", "halved"]):
        command = [sys.executable, "-c", code, *names]
        result = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert result.stdout.splitlines() == [expected[name] for name in names], result.stderr
