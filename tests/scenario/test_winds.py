"""Tests that attributes and methods of every kind of wind, including a user's kind, agree with the system."""

import pickle
import re
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from pydrake.systems.analysis import Simulator

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.hover_error import nominal_tracking_error
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.hovering import at_rest, in_hover
from drake_quad.scenario.schema import file_schema, language_page
from drake_quad.scenario.winds.gust import GustSource
from drake_quad.scenario.winds.source import WINDS, WindSource, WindSurroundings, steady_wind
from drake_quad.signals import Wind

REPOSITORY = Path(__file__).parent.parent.parent
EXAMPLE_SCRIPT = REPOSITORY / "scripts" / "wind_shear.py"
# Positions X, Y, Z at which winds are evaluated, m.
POSITIONS = np.array([[0.0, 0.0, 1.0], [1.3, 0.2, 1.0], [0.4, -2.0, 1.7], [2.5, 0.1, 3.0]])
SURROUNDINGS = WindSurroundings(Wind(0.3, -0.2, 0.1), period=0.01)  # m/s and s


def example(kind: type[WindSource], **changes: Any) -> WindSource:
    """Return a wind source of a kind, located near `POSITIONS`. All other required fields have the value 1."""
    fields: dict[str, Any] = {"kind": kind.model_fields["kind"].annotation.__args__[0]}
    for name, field in kind.model_fields.items():
        if name in ("velocity", "direction"):
            fields[name] = [1.0, 0.5, -0.25]
        elif name == "position":
            fields[name] = [-0.5, -0.5, 1.0]
        elif field.is_required() and name != "kind":
            fields[name] = 1.0
    return kind.model_validate(fields | changes)


def mean_wind(source: WindSource) -> np.ndarray:
    """Return the wind (3, T, N) of a source without turbulence at `POSITIONS` over 4 s, m/s."""
    winds = []
    for recipe in type(source).recipes([source], SURROUNDINGS._replace(steady_wind=source.steady_wind())).values():
        system = recipe.build(len(POSITIONS))
        context = system.CreateDefaultContext()
        for i in range(system.num_input_ports()):
            port = system.get_input_port(i)
            rows = np.zeros((port.size() // len(POSITIONS), len(POSITIONS)))
            if port.get_name() == "state":
                rows[:3] = POSITIONS.T
            port.FixValue(context, rows.ravel())
        simulator = Simulator(system, context)
        simulator.Initialize()
        samples = []
        for time in np.linspace(0.0, 4.0, 41):
            simulator.AdvanceTo(time)
            samples.append(system.GetOutputPort("wind").Eval(context).reshape(3, -1))
        winds.append(np.stack(samples, axis=1))
    return np.sum(winds, axis=0)


@pytest.fixture
def shear_wind(monkeypatch):
    """Register the kind of wind in the example script during a test, and return it."""
    monkeypatch.syspath_prepend(EXAMPLE_SCRIPT.parent)
    return WINDS.register(import_module(EXAMPLE_SCRIPT.stem).ShearSource)


def check_member(kind):
    source = example(kind)
    calm = source.without_turbulence()
    if calm is None:
        assert (source.max_speed(), source.steady_wind()) == (0.0, Wind(0.0, 0.0, 0.0)), "turbulence has no mean"
        return
    assert calm.without_turbulence() == calm
    wind = mean_wind(calm)
    assert np.abs(wind).max() > 0.01
    assert (np.ptp(wind, axis=1).max() > 1e-3) == kind.depends_on_time
    assert (np.ptp(wind, axis=2).max() > 1e-3) == kind.depends_on_position
    unsteady = np.linalg.norm(wind - np.reshape(source.steady_wind(), (3, 1, 1)), axis=0)
    assert unsteady.max() <= source.max_speed() * (1.0 + 1e-9)


@pytest.mark.parametrize("kind", WINDS.members.values(), ids=lambda kind: kind.__name__)
def test_declarations_of_every_kind_of_wind_agree_with_its_system(kind):
    """The wind depends on position and time as the source declares, and does not exceed the declared largest speed."""
    check_member(kind)


def test_a_user_s_wind_is_checked_like_a_shipped_one(shear_wind):
    check_member(shear_wind)


def hover(height=1.0, quadratic_drag=0.0, **wind):
    return load_scenario(
        "hover",
        {
            "route.position": [0.0, 0.0, height],
            "vehicle.linear_drag": 0.1,
            "vehicle.quadratic_drag": quadratic_drag,
            "duration": 1.0,
            "laboratory.wind": [{"kind": "shear", "velocity": [3.0, 0.0, 0.0], **wind}],
        },
    )


@pytest.mark.slow
def test_a_user_s_wind_follows_the_power_law_uncompiled_and_compiled(shear_wind):
    batch = Batch.draw(hover(height=5.0, exponent={"uniform": {"min": 0.1, "max": 0.3}}), range(3))
    for flight, exponent in zip(assert_flown_alike(batch), batch.varying["laboratory.wind.0.exponent"], strict=True):
        wind = flight.record("wind")
        height = flight.record("state").z
        expected = 3.0 * (height / 10.0) ** exponent
        np.testing.assert_allclose(wind.x[1:], expected[1:], atol=1e-3)


@pytest.mark.long
def test_a_user_s_wind_acts_in_flight_checks_linear_models_and_tracking_errors(shear_wind):
    """A wind that is too strong is refused, linear models include the wind, and hover errors depend on the height."""
    with pytest.raises(InputError, match="too long for drag with a time constant"):
        simulate(hover(velocity=[200.0, 0.0, 0.0], quadratic_drag=0.5))
    assert [source.kind for source in at_rest(hover()).laboratory.wind] == ["shear"]
    low, high = (nominal_tracking_error(hover(height)).rms.value for height in (1.0, 8.0))
    assert high / low == pytest.approx(8.0**0.143, rel=0.02)


@pytest.mark.long
def test_a_user_s_wind_is_part_of_the_language(shear_wind):
    assert "ShearSource" in file_schema()["$defs"]
    assert "| `exponent` |" in language_page()
    with pytest.raises(InputError, match=r"laboratory.wind.0.exponent is -1.0, but must be at least 0"):
        hover(exponent=-1.0)
    assert pickle.loads(pickle.dumps(hover())) == hover()
    WINDS.remove("shear")
    assert "ShearSource" not in file_schema()["$defs"]
    with pytest.raises(InputError, match="laboratory.wind.0.kind is 'shear', but must be one of"):
        hover()
    WINDS.register(shear_wind)


def test_wind_that_depends_on_time_is_removed_in_hover(shear_wind, monkeypatch):
    monkeypatch.setattr(shear_wind, "depends_on_time", True)
    assert in_hover(hover()).laboratory.wind == ()
    with pytest.raises(InputError, match=r"laboratory.wind.0 is a shear, .*steady wind and turbulence"):
        nominal_tracking_error(hover())


def test_a_wind_with_missing_attributes_is_refused():
    class IncompleteWind(WindSource):
        kind: Literal["incomplete"]
        depends_on_position: ClassVar = False

    class WindWithoutKind(WindSource):
        depends_on_position: ClassVar = False
        depends_on_time: ClassVar = False

    class WindNamedGust(GustSource):
        pass

    with pytest.raises(
        TypeError, match="IncompleteWind must define depends_on_time and max_speed and recipe and without_turbulence"
    ):
        WINDS.register(IncompleteWind)
    with pytest.raises(TypeError, match="WindWithoutKind must have a field kind"):
        WINDS.register(WindWithoutKind)
    with pytest.raises(ValueError, match="the name gust of .* is taken by GustSource"):
        WINDS.register(WindNamedGust)
    with pytest.raises(TypeError, match="dict must extend WindSource"):
        WINDS.register(dict)


def test_steady_winds_add_up():
    sources = load_scenario(
        "hover",
        [
            "laboratory.wind=[{kind: steady, velocity: [1, 2, 3]}, {kind: sine, velocity: [9, 9, 9], frequency: 1},"
            " {kind: steady, speed: 2.0, heading: 0.5}]"
        ],
    ).laboratory.wind
    assert steady_wind(sources) == pytest.approx(Wind(1.0 + 2.0 * np.cos(0.5), 2.0 + 2.0 * np.sin(0.5), 3.0))
    assert steady_wind(()) == Wind(0.0, 0.0, 0.0)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_a_command_imports_a_user_s_wind(run, tmp_path):
    wind = "laboratory.wind=[{kind: shear, velocity: [3, 0, 0], exponent: {uniform: {min: 0.1, max: 0.3}}}]"
    changes = (part for field in ("duration=0.5", "vehicle.linear_drag=0.1", wind) for part in ("--set", field))
    study = ["study", "hover", "--samples", "4", "--workers", "2", *changes]
    result = run(*study, "--output", tmp_path, "--import", EXAMPLE_SCRIPT)
    assert (result.returncode, result.stderr) == (0, "")
    commands = re.findall(
        r"drake-quad (\S+) .* --sample 0 --import scripts/wind_shear.py$", result.stdout, re.MULTILINE
    )
    assert commands == ["sensitivities", "fly"]
    assert "laboratory.wind.0.exponent" in (tmp_path / "results.csv").read_text(encoding="utf-8")
    (tmp_path / "broken.py").write_text("1 / 0", encoding="utf-8")
    (tmp_path / "random.py").write_text("", encoding="utf-8")
    for arguments, words in (
        ("none.py", " is not an existing Python file"),
        ("broken.py", ":1: ZeroDivisionError: division by zero"),
        ("random.py", ": another module is also called random; rename the file"),
    ):
        result = run(*study, "--output", tmp_path, "--import", tmp_path / arguments)
        assert result.returncode == 2
        assert f"error: --import {tmp_path / arguments}{words}\n" in result.stderr
