"""Tests that concurrent threads compute a cached value only once, and can share process-wide settings."""

import os
import subprocess
import sys
import threading

import pytest

from drake_quad.caching import ThreadSafeCache
from drake_quad.process_settings import ProcessSetting


def in_threads(*functions):
    """Run functions at the same time, each in its own thread."""
    threads = [threading.Thread(target=function) for function in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def test_a_value_that_threads_request_at_once_is_computed_once():
    cache = ThreadSafeCache()
    values = []
    gate = threading.Barrier(4)
    makers = []

    def make():
        makers.append(threading.get_ident())
        threading.Event().wait(0.02)  # gives the other threads time to request the value
        return object()

    def request():
        gate.wait()
        values.append(cache.get("key", make))

    in_threads(*[request] * 4)
    assert len(makers) == 1
    assert values == [values[0]] * 4


def test_a_cached_value_is_returned_while_another_one_is_computed():
    cache = ThreadSafeCache()
    has_begun = threading.Event()
    done = threading.Event()
    cache.get("cached", lambda: 1)

    def slow():
        has_begun.set()
        assert done.wait(10.0)
        return 2

    thread = threading.Thread(target=lambda: cache.get("slow", slow))
    thread.start()
    assert has_begun.wait(10.0)
    assert cache.get("cached", lambda: 3) == 1
    done.set()
    thread.join()
    assert cache.get("slow", lambda: 4) == 2


def test_a_value_can_depend_on_other_values_of_the_same_cache():
    cache = ThreadSafeCache()
    assert cache.get(3, lambda: 1 + cache.get(2, lambda: 1 + cache.get(1, lambda: 1))) == 3


def test_an_error_is_not_cached():
    cache = ThreadSafeCache()
    with pytest.raises(ZeroDivisionError):
        cache.get("key", lambda: 1 // 0)
    assert cache.get("key", lambda: 5) == 5


def test_a_full_cache_drops_its_oldest_value():
    cache = ThreadSafeCache(2)
    for key in (1, 2, 3):
        assert cache.get(key, lambda key=key: key) == key
    assert len(cache) == 2
    assert [cache.get(key, lambda: "new") for key in (2, 3, 1)] == [2, 3, "new"]


class Setting:
    """Context manager that changes a process-wide setting and restores its previous value."""

    value = "usual"

    def __enter__(self):
        self.previous_value, Setting.value = Setting.value, "changed"

    def __exit__(self, *_):
        Setting.value = self.previous_value


def test_a_setting_is_restored_after_the_last_of_several_threads_leaves_its_context():
    """The thread that enters first also leaves first, while the other thread is still inside."""
    changed = ProcessSetting(Setting)
    first_is_in, second_is_in, first_is_out = (threading.Event() for _ in range(3))
    values = []

    def enter_first():
        with changed():
            first_is_in.set()
            assert second_is_in.wait(10.0)
        first_is_out.set()

    def enter_second():
        assert first_is_in.wait(10.0)
        with changed():
            second_is_in.set()
            assert first_is_out.wait(10.0)
            values.append(Setting.value)

    in_threads(enter_first, enter_second)
    assert values == ["changed"]
    assert Setting.value == "usual"


def test_a_setting_is_restored_after_an_error():
    changed = ProcessSetting(Setting)
    with pytest.raises(ValueError, match="changed"), changed():
        raise ValueError(Setting.value)
    assert Setting.value == "usual"


# Program that prints the number of wrong results, and the number of compilations minus the number of formulas.
KERNELS_PROGRAM = """
import sys, threading
import numpy as np
from drake_quad.framework import machine_code
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import ROW

sys.setswitchinterval(1e-6)
compile_text, compiled = machine_code._compile, []
machine_code._compile = lambda text: (compiled.append(text), compile_text(text))[1]
formulas = [lambda x, factor=float(factor): factor * x for factor in range(2, 10)]
wrong, gate = [], threading.Barrier(4)

def run():
    gate.wait()
    for formula in formulas:
        result = np.empty(1)
        kernel(formula, (ROW,), (ROW,), single_vehicle=True)(1, 0.0, result, np.array([3.0]))
        if result[0] != formula(3.0):
            wrong.append(formula(3.0))

threads = [threading.Thread(target=run) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(wrong), len(compiled) - len(formulas))
"""

# Program that prints "alike" if flights in concurrent threads equal flights that are simulated one after another.
FLIGHTS_PROGRAM = """
import threading
import numpy as np
from drake_quad import load_scenario, simulate

scenario = load_scenario("laboratory:nominal", ["duration=0.1"])
found, gate = {}, threading.Barrier(4)

def fly(number):
    gate.wait()
    found[number] = simulate(scenario, sample=number, compiled=number % 2 == 0)

threads = [threading.Thread(target=fly, args=(number,)) for number in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
for number in range(4):
    alone = simulate(scenario, sample=number, compiled=number % 2 == 0)
    for name, values in alone.signals.items():
        np.testing.assert_array_equal(found[number].signals[name], values)
print("alike")
"""


def fresh_process(program, cache):
    environment = {**os.environ, "DRAKE_QUAD_CACHE": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)


@pytest.mark.long
@pytest.mark.parametrize(
    ("program", "printed"), [(KERNELS_PROGRAM, "0 0\n"), (FLIGHTS_PROGRAM, "alike\n")], ids=["kernels", "flights"]
)
def test_threads_of_a_new_process_compile_each_formula_once_and_simulate_the_same_flights(program, printed, tmp_path):
    """The cache on disk is empty, so all threads start compiling at the same time."""
    result = fresh_process(program, tmp_path / "cache")
    assert (result.returncode, result.stdout, result.stderr) == (0, printed, "")
