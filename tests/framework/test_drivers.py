"""Tests of the LLVM code of loops, conditions and copies."""

import ctypes

import numpy as np
import pytest

from drake_quad.framework.drivers import Driver, copy_functions
from drake_quad.framework.machine_code import LANES, kernel_address


def run_function(text, *arguments):
    types = [ctypes.py_object if isinstance(each, np.ndarray) else ctypes.c_int64 for each in arguments]
    ctypes.PYFUNCTYPE(None, *types)(kernel_address(text))(*arguments)


@pytest.mark.parametrize(("begin", "end", "step"), [(0, 5, 1), (0, 5, 2), (2, 9, 3), (3, 3, 1), (4, 3, 1), (0, 0, 8)])
def test_nested_loops_and_conditions_execute_the_same_iterations_as_in_python(begin, end, step):
    """The inner loop ends at the counter of the outer loop, and a condition skips some iterations."""
    driver = Driver.of_arrays("i64 %begin, i64 %end", ["count", "sum"])
    with driver.loop("i", "%begin", "%end", step):
        with driver.loop("j", 0, "%i"):
            driver.let("twice", "mul i64 %j, 2")
            with driver.when("off", "icmp ne i64 %twice, %i"):
                driver.let("product", "mul i64 %i, %j")
                driver.let("before", "load i64, ptr %sum")
                driver.let("after", "add i64 %before, %product")
                driver.do("store i64 %after, ptr %sum")
        driver.let("seen", "load i64, ptr %count")
        driver.let("more", "add i64 %seen, 1")
        driver.do("store i64 %more, ptr %count")
    count, total = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    run_function(driver.text(), begin, end, count, total)
    assert count[0] == len(range(begin, end, step))
    assert total[0] == sum(i * j for i in range(begin, end, step) for j in range(i) if 2 * j != i)


@pytest.mark.parametrize("vehicles", [1, LANES - 1, LANES, LANES + 1, 2 * LANES + 3])
@pytest.mark.parametrize("rows", [0, 1, 3])
def test_gather_and_scatter_copy_the_rows_of_a_fleet(vehicles, rows):
    """Unused lanes of the copy contain the last vehicle again, and are not copied back."""
    driver = Driver.of_arrays("i64 %n, i64 %first", ["fleet", "copy", "other"])
    driver.let("left", "sub i64 %n, %first")
    driver.at("there", "fleet", "%first")
    driver.at("back", "other", "%first")
    driver.do(f"call void @gather(ptr %copy, ptr %there, i64 {rows}, i64 %n, i64 %left)")
    driver.do(f"call void @scatter(ptr %copy, ptr %back, i64 {rows}, i64 %n, i64 %left)")
    text = "\n".join([copy_functions(LANES), driver.text()])
    fleet = np.arange(1.0, rows * vehicles + 1.0).reshape(rows, vehicles)
    other = np.zeros_like(fleet)
    for first in range(0, vehicles, LANES):
        copy = np.full((rows, LANES), np.nan)
        run_function(text, vehicles, first, fleet, copy, other)
        np.testing.assert_array_equal(copy, fleet[:, np.minimum(first + np.arange(LANES), vehicles - 1)])
        np.testing.assert_array_equal(other[:, : first + LANES], fleet[:, : first + LANES])
        assert not other[:, first + LANES :].any()
