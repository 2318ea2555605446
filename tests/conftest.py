"""Fixtures and settings of all tests."""

import gc
import os
import runpy
import signal
import sys
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest
from PIL import Image
from repository_guard import RepositoryGuard

# The worker processes of pytest use all cores, so BLAS threads would only slow them down. NumPy reads this variable
# when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


from drake_quad import load_scenario
from drake_quad.command_line.main import main
from drake_quad.framework import result_cache
from drake_quad.scenario.models import REGISTRIES
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.rotors import Rotor, Rotors

# A busy machine must not fail a test.
hypothesis.settings.register_profile("without time limit", deadline=None)
hypothesis.settings.load_profile("without time limit")

_ROOT = Path(__file__).parent.parent
# The slowest test files. They start first, so that no worker process is still busy with one when all others are done.
_LONG_FILES = (
    "test_docs",
    "test_identified_vehicles",
    "test_commands",
    "test_cluster",
    "test_scripts",
    "test_around_obstacles",
    "test_consistency",
    "test_monte_carlo",
    "test_flight_oracle",
    "test_prediction",
    "test_vector_env",
    "test_compare_with_log",
    "test_position_law",
    "test_rooms",
    "test_wheel",
)


@pytest.hookimpl(optionalhook=True)  # xdist is optional
def pytest_xdist_auto_num_workers() -> int:
    """Return the number of worker processes: one more than there are cores, but at most 4.

    The additional process uses the cores while other tests wait. Each process needs a few hundred MB of memory.
    """
    return min(4, (os.cpu_count() or 1) + 1)


@pytest.hookimpl(tryfirst=True)  # before pytest selects the tests with the markers that `-m` names
def pytest_collection_modifyitems(items) -> None:
    """Mark long tests as slow, and let the slowest files come first."""
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.slow)
    order = {name: i for i, name in enumerate(_LONG_FILES)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


def pytest_configure(config) -> None:
    """Disable garbage collection while tests are collected, and register the guard of the repository's files.

    The modules of the tests stay in memory until the end, so there is no garbage to collect. Only the main process
    registers the guard, not the worker processes.
    """
    gc.disable()
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(RepositoryGuard(_ROOT))


def pytest_collection_finish() -> None:
    """Exempt imported objects from garbage collection, which would otherwise take a quarter of the tests' run time."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 100)
    gc.enable()


@pytest.fixture(autouse=True)
def _no_result_cache(request, monkeypatch):
    """Disable the cache of results on disk, because tests and mutants change the code that computes the results.

    The fixture `cached_results` enables the cache for tests of pages, scripts and commands, which share results.
    """
    if "cached_results" not in request.fixturenames:
        monkeypatch.setattr(result_cache, "_environment", lambda: None)


@pytest.fixture
def cached_results():
    """Enable the cache of results on disk."""


@pytest.fixture(autouse=True)
def _restored_process_settings():
    """Let Ctrl-C raise KeyboardInterrupt in every test, and restore process-wide settings that commands change."""
    handler, thresholds = signal.signal(signal.SIGINT, signal.default_int_handler), gc.get_threshold()
    yield
    signal.signal(signal.SIGINT, handler)
    gc.set_threshold(*thresholds)


@pytest.fixture(autouse=True)
def _restored_registries():
    """Remove the classes that a test has registered, such as its own kinds of controllers or effects."""
    before = {registry: {*registry.members} for registry in REGISTRIES}
    yield
    for registry, names in before.items():
        for name in {*registry.members} - names:
            registry.remove(name)


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the root folder of the repository, so that tests do not depend on the working directory."""
    return Path(__file__).parent.parent


@pytest.fixture(scope="session")
def diagrams(root) -> Path:
    """Return the folder of the shipped scenarios."""
    return root / "diagrams"


@pytest.fixture(scope="session")
def asymmetric(root):
    """Return a function that loads a scenario of tests/asymmetric.yaml, given its name and overrides."""
    return lambda name, *overrides: load_scenario(root / "tests" / f"asymmetric.yaml:{name}", overrides)


@pytest.fixture(scope="session")
def asymmetric_vehicle() -> QuadrotorParameters:
    """Return the parameters of an asymmetric vehicle, in which no two parameters are equal."""
    return QuadrotorParameters(
        mass=0.74,
        inertia=Inertia(0.0071, 0.0079, 0.0131),
        rotor_inertia=9.0e-5,
        rotors=Rotors(
            Rotor(0.161, 0.012, 0.021, -1.0, 4.15e-5, 1.0e-6),
            Rotor(-0.014, -0.168, 0.017, 1.0, 4.02e-5, 1.1e-6),
            Rotor(-0.172, 0.009, 0.025, -1.0, 4.17e-5, 0.9e-6),
            Rotor(0.011, 0.158, 0.019, 1.0, 4.12e-5, 1.05e-6),
        ),
        gravity=9.8,
        linear_drag=0.12,
        quadratic_drag=0.02,
        rotor_time_constant=0.04,
        min_rotor_speed=70.0,
        max_rotor_speed=290.0,
        centre_of_mass=CentreOfMass(-0.003, 0.008),
    )


class Result(NamedTuple):
    """Exit status and output of a command."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(capsys, monkeypatch):
    """Return a function that runs a command or script in this process, which saves the time to import Drake again."""
    monkeypatch.chdir(_ROOT)
    monkeypatch.syspath_prepend(_ROOT / "scripts")

    def call(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        status = 0
        try:
            if name.endswith(".py"):
                (script,) = (_ROOT / "scripts").rglob(name)
                runpy.run_path(str(script), run_name="__main__")
            else:
                main(name)
        except SystemExit as stop:
            status = stop.code or 0
        return Result(status, *capsys.readouterr())

    return call


@pytest.fixture
def blank_figures(monkeypatch):
    """Replace `Figure.savefig` by a function that saves a blank picture, without drawing the figure."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda figure, file, **_: _write_blank(file))


@pytest.fixture
def unrendered_figures(monkeypatch):
    """Replace `Figure.savefig` by a function that draws the figure without rendering it, and saves a blank picture.

    This takes a quarter of the time, and still finds errors in the drawing code.
    """

    def drawn_only(figure, file, **_):
        figure.set_layout_engine("none")
        figure.draw_without_rendering()
        _write_blank(file)

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", drawn_only)


def _write_blank(file) -> None:
    """Write a blank picture in place of a figure."""
    Image.new("RGB", (8, 8)).save(file, format="png")
