"""Tests of worlds in YAML, and of the command that flies them."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, load_world, read_flight
from drake_quad.vehicle.downwash import CRAZYFLIE_DOWNWASH
from drake_quad.worlds.language import is_world

PAIR = """
pair:
  extends: [laboratory:nominal, vehicles/crazyflie, controllers/crazyflie]
  route: {kind: hover, position: [0.0, 0.0, 1.0], duration: 1.0}
  world: {radius: 0.1}
  vehicles:
    upper: {offset: [0.0, 0.0, 0.5]}
    lower:
"""


@pytest.fixture
def write(tmp_path):
    def writer(text):
        path = tmp_path / "worlds.yaml"
        path.write_text(PAIR + text)
        return str(path)

    return writer


def test_the_fields_of_a_vehicle_are_layered_over_those_of_all(write):
    other = """
other:
  extends: pair
  world: {downwash: {force: 1000.0}}
  vehicles:
    lower: {extends: vehicles/hummingbird, vehicle: {mass: 0.5}}
"""
    world = load_world(write(other) + ":other", ["duration=0.5"])
    assert [*world.vehicles] == ["upper", "lower"]
    assert (world.name, [each.name for each in world.vehicles.values()]) == ("other", ["upper", "lower"])
    assert (world.radius, world.offsets) == (0.1, {"upper": (0.0, 0.0, 0.5)})
    assert world.downwash == CRAZYFLIE_DOWNWASH._replace(force=1000.0)
    upper, lower = world.vehicles.values()
    assert (upper.duration, lower.duration) == (0.5, 0.5)
    assert upper.vehicle.mass != lower.vehicle.mass == 0.5
    assert (upper.nominal.mass, lower.nominal.mass) == pytest.approx((0.0319, 0.716), abs=0.02)
    assert [plan.waypoints[0][2] for plan in world.plans().values()] == [1.5, 1.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "bad: {extends: pair, vehicles: {third: {wings: 3}}}",
            "worlds.yaml:9: wings is unknown; allowed are name, route",
        ),
        ("bad: {extends: pair, vehicles: {third: 3}}", "9: vehicles.third must be a mapping of fields"),
        ("bad: {extends: pair, vehicles: 3}", "9: vehicles must be a mapping from the names of the vehicles"),
        ("bad: {extends: pair, world: {radius: -1.0}}", "radius is -1.0, but must be"),
        ("bad: {extends: pair, world: {size: 1.0}}", "9: size is unknown; allowed are radius, downwash"),
        ("bad: {extends: pair, vehicles: {upper: {offset: [1]}}}", "offset.1 is missing|offset"),
        ("bad: {extends: pair, vehicles: {upper: {extends: nowhere}}}", "nowhere"),
        ("bad: {extends: pair, vehicles: {recorder: {}}}", "9: a vehicle cannot be called recorder"),
        ("bad: {extends: pair, world: null}", "9: world must be a mapping of fields"),
        ("bad: {extends: hover}", "has no field vehicles; `load_scenario` loads a scenario of a single vehicle"),
    ],
)
def test_errors_name_the_file_the_line_and_the_field(write, text, words):
    with pytest.raises(InputError, match=words):
        load_world(f"{write(text)}:bad")


def test_only_a_scenario_with_vehicles_is_a_world(write):
    assert is_world(write("") + ":pair")
    assert not is_world("hover")


@pytest.mark.slow
def test_the_command_flies_a_world(run, write, tmp_path):
    result = run("fly", f"{write('')}:pair", "--output", tmp_path / "out")
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    assert lines[0].split() == ["vehicle", "RMSE", "(cm)", "peak", "error", "(cm)", "flight", "time", "(s)"]
    assert [line.split()[0] for line in lines[1:3]] == ["upper", "lower"]
    assert lines[3].startswith("smallest distance between two vehicles: 0.")
    for name in ("upper", "lower"):
        assert (tmp_path / "out" / name / "flight.csv").exists()
    assert (tmp_path / "out" / "replay.html").exists()
    result = run("fly", f"{write('')}:pair", "--controller", "controllers/lee")
    assert (result.returncode, result.stdout) == (2, "")
    assert "--controller needs a scenario with one vehicle, but " in result.stderr


def test_layers_of_a_vehicle_are_found_as_in_a_scenario(write, tmp_path):
    """A file is relative to the file of the world, and a name is a scenario in it."""
    (tmp_path / "layer.yaml").write_text("light: {vehicle: {mass: 0.03}}")
    others = """
heavy: {vehicle: {mass: 0.035}}
mixed:
  extends: pair
  vehicles: {upper: {extends: heavy}, lower: {extends: [layer.yaml]}}
"""
    masses = [each.vehicle.mass for each in load_world(write(others) + ":mixed").vehicles.values()]
    assert masses == [0.035, 0.03]


def test_other_commands_and_overrides_of_a_world_are_refused(run, write):
    spec = write("") + ":pair"
    with pytest.raises(InputError, match="has several vehicles; only `drake-quad fly` and `load_world` accept"):
        load_scenario(spec)
    assert "has several vehicles" in run("study", spec).stderr
    for override in ("world.radius=0.2", "vehicles.upper.offset=[0, 0, 1]"):
        with pytest.raises(InputError, match="cannot be overridden; change the file"):
            load_world(spec, [override])


@pytest.mark.slow
def test_a_saved_world_has_the_same_flight(run, write, tmp_path):
    assert run("fly", f"{write('')}:pair", "--sample", "3", "--output", tmp_path / "first").returncode == 0
    again = run("fly", tmp_path / "first" / "world.yaml", "--output", tmp_path / "second")
    assert again.stdout.splitlines()[0] == "sample 3 (seed 0)"
    for name in ("upper", "lower"):
        first, second = (read_flight(tmp_path / folder / name) for folder in ("first", "second"))
        np.testing.assert_array_equal(first["state"], second["state"])


def test_a_world_cannot_have_the_name_of_another_folder(write):
    with pytest.raises(InputError, match="the name of the world is '../up', but must match"):
        load_world(write('"../up": {extends: pair}') + ":../up")
