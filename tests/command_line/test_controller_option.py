"""Tests that the option `--controller` accepts controllers in YAML and Drake systems in Python."""

import argparse
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.command_line.main import COMMANDS
from drake_quad.command_line.options import (
    controlled_scenarios,
    import_file,
    named_controllers,
    parse_controller,
    scenario_from_arguments,
)
from drake_quad.command_line.sensitivities import default_fields
from drake_quad.evaluation.claims import CONTROLLER_NAMES
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import NAME, REGISTRIES
from drake_quad.scenario.paths import distributions_in

CONTROLLERS_SOURCE = """
from typing import NamedTuple
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import Acceleration, Reference, State, Wrench

class Gains(NamedTuple):
    k_p: float = 0.2

def law(m: State, r: Reference, g: Gains) -> Acceleration:
    return Acceleration(
        *(g.k_p * e for e in (r.x - m.x, r.y - m.y, r.z - m.z))
    )

def level(m: State, r: Reference) -> Wrench:
    return Wrench(6.67, 0.0 * m.roll, 0.0 * m.pitch, 0.0 * r.yaw)

@fleet_system(float, AutoDiffXd)
class Mine(FleetSystem):
    def declare(self, *, parameters=Gains()):
        gains = self.parameter("gains", lambda parameters: parameters)
        self.output("acceleration_command", law, self.input("measurement"), self.input("reference"), gains)

@fleet_system(float, AutoDiffXd)
class Whole(FleetSystem):
    def declare(self):
        self.output("wrench", level, self.input("measurement"), self.input("reference"))
"""


@pytest.fixture
def controller_file(tmp_path, request):
    """Return the path of a Python file with controllers. Each test has its own file, since modules stay imported."""
    path = tmp_path / f"controllers_{abs(hash(request.node.name))}.py"
    path.write_text(CONTROLLERS_SOURCE, encoding="utf-8")
    return path


@pytest.fixture
def folder_of_controller_file(controller_file, run, monkeypatch):
    """Change to the folder of `controller_file`. (The fixture `run` changes to the root folder.)"""
    monkeypatch.chdir(controller_file.parent)


def arguments(**given):
    return argparse.Namespace(**({"scenario": "hover", "set": [], "seed": None, "controller": None} | given))


def test_a_controller_in_yaml_overrides_that_of_the_scenario() -> None:
    scenario = scenario_from_arguments(arguments(scenario="laboratory:nominal", controller="controllers/paper:pd"))
    assert scenario == load_scenario("laboratory:nominal", layers=["controllers/paper:pd"])


def test_a_position_controller_in_python_keeps_the_feedforward_of_the_scenario(controller_file) -> None:
    scenario = scenario_from_arguments(arguments(scenario="laboratory:nominal", controller=f"{controller_file}:Mine"))
    shipped = load_scenario("laboratory:nominal")
    assert scenario.control.position.kind == f"{controller_file.stem}.Mine"
    assert scenario.control.position.feed_forward == shipped.control.position.feed_forward
    assert scenario.control.network is None
    assert scenario.control.attitude == shipped.control.attitude


def test_parameters_of_a_controller_in_python_can_be_set(controller_file) -> None:
    scenario = scenario_from_arguments(
        arguments(controller=f"{controller_file}:Mine", set=["control.position.k_p=0.75"])
    )
    assert scenario.control.position.k_p == 0.75


def test_sensitivities_include_the_gains_of_a_controller_in_python_by_default(controller_file) -> None:
    """Each gain of this controller is one number. Gains of shipped controllers have one number per axis."""
    fields = default_fields(scenario_from_arguments(arguments(controller=f"{controller_file}:Mine")))
    assert "control.position.k_p" in fields
    assert "control.position.k_p.0" in default_fields(load_scenario("hover"))


def test_a_scenario_with_the_controller_keeps_its_parameters(controller_file, tmp_path) -> None:
    chosen = scenario_from_arguments(arguments(controller=f"{controller_file}:Mine", set=["control.position.k_p=0.75"]))
    save_scenario(chosen, tmp_path / "saved.yaml")
    again = scenario_from_arguments(
        arguments(scenario=str(tmp_path / "saved.yaml"), controller=f"{controller_file}:Mine")
    )
    assert again == chosen


def test_a_whole_control_in_python_replaces_the_cascade(controller_file) -> None:
    scenario = scenario_from_arguments(arguments(controller=f"{controller_file}:Whole"))
    assert scenario.control.kind == f"{controller_file.stem}.Whole"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("{mine}:Other", "has no class Other"),
        ("{mine}", "give the class of the controller as well"),
        ("{mine}:Gains", "Gains has no output port `acceleration_command`"),
        ("absent.py:Mine", "absent.py is not an existing Python file"),
    ],
)
def test_an_invalid_controller_is_refused_with_the_name_of_the_option(controller_file, spec: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_controller(spec.format(mine=controller_file), "hover")
    assert str(caught.value).startswith(f"--controller {spec.format(mine=controller_file)}: ")
    assert message in str(caught.value)


def test_a_file_that_raises_an_error_is_refused(tmp_path) -> None:
    (tmp_path / "broken_controller.py").write_text("1 / 0", encoding="utf-8")
    with pytest.raises(InputError, match="ZeroDivisionError: division by zero"):
        parse_controller(f"{tmp_path / 'broken_controller.py'}:Mine", "hover")


FAILING_CONTROLLERS_SOURCE = """
from pydrake.systems.framework import BasicVector, LeafSystem
from drake_quad.framework.elementary import sqrt
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.signals import Acceleration
import numpy as np

class InFlight(LeafSystem):
    def __init__(self, num_vehicles=1):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3 * num_vehicles), self.command)

    def command(self, context, output):
        self.gains["k_p"]

class InConstructor(LeafSystem):
    def __init__(self, num_vehicles=1):
        1 / 0

@fleet_system(float)
class InFormula(FleetSystem):
    def declare(self):
        self.output("acceleration_command", law, self.input("measurement"), self.input("reference"))

def law(m, r):
    return Acceleration(np.clip(m.x, 0.0, 1.0), 0.0, 0.0)

@fleet_system(float)
class InDeclaration(FleetSystem):
    def declare(self):
        self.input("measurment")
"""


@pytest.mark.parametrize(
    ("name", "message", "source_line"),
    [
        ("InFlight", "{file}:16: AttributeError: 'InFlight' object has no attribute 'gains'", 'self.gains["k_p"]'),
        ("InConstructor", "{file}:20: ZeroDivisionError: division by zero", "1 / 0"),
        ("InFormula", "{file}:28: TypeError: formula law: numpy.clip does not accept a row", "np.clip(m.x, 0.0, 1.0)"),
        ("InDeclaration", "--controller {file}:InDeclaration: there is no signal called", 'self.input("measurment")'),
    ],
)
@pytest.mark.parametrize("command", [["fly"], ["compare", "--scenario"], ["study"], ["replay"]], ids=lambda c: c[0])
def test_an_error_in_a_controller_is_reported_with_its_file_and_line(
    run, tmp_path, monkeypatch, request, command, name, message, source_line
) -> None:
    monkeypatch.chdir(tmp_path)
    file = f"failing_{abs(hash(request.node.name))}.py"
    (tmp_path / file).write_text(FAILING_CONTROLLERS_SOURCE, encoding="utf-8")
    samples = [] if command == ["fly"] else ["--samples", 2]
    options = [*samples, "--set", "duration=1", "--controller", f"{file}:{name}", "--output", tmp_path / "out"]
    result = run(*command, "hover", *options)
    assert result.returncode == 2
    first, *traceback = [each for each in result.stderr.splitlines() if not each.startswith("remark: ")]
    assert first.startswith(f"error: {message.format(file=file)}")
    # A study prints no traceback, because its worker processes return only the message of an error.
    assert source_line in "".join(traceback) or command == ["study"]
    assert "drake_quad" not in "".join(traceback)


def load_error_without_registered_kinds(scenario, path):
    """Save a scenario, unregister the kinds of its Python files, load it, and return the error message."""
    save_scenario(scenario, path)
    for registry in REGISTRIES:
        for name, member in [*registry.members.items()]:
            if member.registration_option():
                registry.remove(name)
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    return str(caught.value)


@pytest.mark.long
@pytest.mark.usefixtures("folder_of_controller_file")
def test_a_saved_scenario_with_kinds_in_python_is_refused_with_the_command_that_flies_it(
    run, controller_file, root
) -> None:
    """The command in the message is complete: it flies the saved scenario."""
    for name in ("wind_shear", "ceiling_effect"):
        import_file(root / "scripts" / f"{name}.py")
    scenario = scenario_from_arguments(
        arguments(
            scenario="hover",
            controller=f"{controller_file}:Mine",
            set=[
                "duration=0.1",
                "laboratory.wind=[{kind: shear, velocity: [3, 0, 0]}]",
                "vehicle.ceiling={rotor_radius: 0.1, height: 3.0}",
            ],
        )
    )
    message = load_error_without_registered_kinds(scenario, Path("saved.yaml"))
    assert message.startswith("saved.yaml:")
    options = Path("saved.yaml").read_text(encoding="utf-8").splitlines()[0].partition("options ")[2]
    assert f"--controller {controller_file.name}:Mine" in options
    assert " a Python file registers; name the file in the command, as in drake-quad fly" in message
    assert message.endswith(f" drake-quad fly saved.yaml {options}")
    command = shlex.split(message.partition("drake-quad ")[2])
    result = run(*command, "--output", "flown")
    assert result.returncode == 0, result.stderr


def test_a_handwritten_scenario_with_a_kind_from_python_is_refused_with_the_option_that_imports_it(
    controller_file, tmp_path
) -> None:
    parse_controller(f"{controller_file}:Mine", "hover")
    (tmp_path / "written.yaml").write_text("written: {extends: hover, control: {position: {kind: own.Mine}}}", "utf-8")
    with pytest.raises(InputError, match=r"fly \S+written.yaml --controller own.py:Mine$"):
        load_scenario(tmp_path / "written.yaml")


@pytest.mark.usefixtures("folder_of_controller_file")
def test_a_misspelt_kind_in_a_saved_scenario_is_refused_with_the_known_kinds(controller_file) -> None:
    save_scenario(
        scenario_from_arguments(arguments(controller=f"{controller_file}:Mine", set=["vehicle.battery_sag=0.1"])),
        Path("saved.yaml"),
    )
    text = Path("saved.yaml").read_text(encoding="utf-8")
    for right, wrong, message in (("kind: hover", "kind: hovr", "must be one of"), ("_sag", "_sagg", "did you mean")):
        Path("saved.yaml").write_text(text.replace(right, wrong), "utf-8")
        with pytest.raises(InputError, match=message):
            load_scenario("saved.yaml")


def test_a_scenario_whose_kinds_are_all_shipped_is_saved_without_a_comment_on_options(tmp_path) -> None:
    save_scenario(load_scenario("robustness"), tmp_path / "saved.yaml")
    assert (tmp_path / "saved.yaml").read_text(encoding="utf-8").startswith("robustness:\n")


def test_controllers_with_equal_names_are_distinguished_by_their_files_or_their_parameters(controller_file) -> None:
    specs = [
        "controllers/paper:pd", "controllers/designed/laboratory:pd", f"{controller_file}:Mine",
        f"{controller_file}:Mine control.position.k_p=0.4",
        f"{controller_file}:Mine control.position.k_p=[1, 2] vehicle.mass=0.7",
    ]  # fmt: skip
    names = [each.name for each in named_controllers(specs, "hover").values()]
    assert names == ["pd", "laboratory_pd", "Mine", "Mine_k_p_0.4", "Mine_k_p_1_2_mass_0.7"]
    assert all(re.fullmatch(NAME, name) for name in names)
    with pytest.raises(InputError, match="--controller controllers/paper:pd is given twice"):
        named_controllers(["controllers/paper:pd"] * 2, "hover")


def test_assignments_after_a_controller_apply_only_to_this_controller(controller_file) -> None:
    """The assignments also take precedence over `--set`, which applies to all controllers."""
    specs = [
        f"{controller_file}:Mine",
        f"{controller_file}:Mine control.position.k_p=0.4",
        "controllers/paper:pd control.position.k_p.0=3",
    ]
    first, second, third = controlled_scenarios(arguments(controller=specs)).values()
    assert (first.control.position.k_p, second.control.position.k_p) == (0.2, 0.4)
    assert third.control.position.k_p[0] == 3.0
    both = arguments(controller=specs[:2], set=["control.position.k_p=0.3"])
    assert [each.control.position.k_p for each in controlled_scenarios(both).values()] == [0.3, 0.4]
    assert scenario_from_arguments(arguments(controller=specs[1])).control.position.k_p == 0.4
    with pytest.raises(
        InputError, match="--controller controllers/paper:pd control.position.k_x=3: control.position.k_x"
    ):
        scenario_from_arguments(arguments(controller="controllers/paper:pd control.position.k_x=3"))


RANDOM_SCENARIO = """
drawn:
  extends: laboratory:low_wind
  vehicle:
    mass: {normal: {mean: 0.68, standard_deviation: 0.01, min: 0.5}}
    rotor_time_constant: {relative: {uniform: {min: 0.8, max: 1.2}}}
  laboratory: {command_link: {loss_rate: {uniform: {min: 0.0, max: 0.05}}}}
  control: {thrust_vectoring: {max_tilt: {uniform: {min: 0.5, max: 0.6}}}}
heavier: {nominal: {mass: 0.7}, control: {thrust_vectoring: {max_thrust: 2.0}}}
lossless: {laboratory: {command_link: {loss_rate: 0.0}}}
replacing: {control: {thrust_vectoring: {max_tilt: 0.55}}, vehicle: {mass: 0.7}}
"""


@pytest.mark.parametrize(
    ("controller", "overrides", "replaced"),
    [
        ("drawn.yaml:heavier", [], []),
        ("drawn.yaml:lossless", [], ["laboratory.command_link.loss_rate 0 (not uniform(0, 0.05))"]),
        ("drawn.yaml:replacing", [], ["vehicle.mass 0.7 (not normal(", "control.thrust_vectoring.max_tilt 0.55 ("]),
        ("drawn.yaml:replacing", ["vehicle.mass=0.69", "control.thrust_vectoring.max_tilt=0.5"], []),
        ("drawn.yaml:lossless", ["laboratory.command_link.loss_rate={choice: [0, 0.1]}"], []),
        ("vehicles/hummingbird", [], ["vehicle.mass 0.716 (not normal(0.68, 0.01, min=0.5))"]),
        ("controllers/paper:pd", [], ["control.thrust_vectoring.max_tilt 0.6 (not uniform(0.5, 0.6))"]),
        ("{mine}:Mine", ["control.position.k_p=0.75"], []),
    ],
)  # fmt: skip
@pytest.mark.parametrize("several_controllers", [False, True])
def test_a_controller_keeps_each_distribution_or_a_remark_names_it(
    controller, overrides, replaced, several_controllers, controller_file, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drawn.yaml").write_text(RANDOM_SCENARIO, encoding="utf-8")
    spec, drawn = controller.format(mine=controller_file), "drawn.yaml:drawn"
    if several_controllers:
        (scenario,) = controlled_scenarios(arguments(controller=[spec], set=overrides), drawn).values()
    else:
        scenario = scenario_from_arguments(arguments(scenario=drawn, controller=spec, set=overrides))
    printed = capsys.readouterr().err
    remark = f"remark: --controller {spec} replaces random parameters of {drawn} by fixed values: "
    assert printed.startswith(remark if replaced else "")
    assert bool(printed) == bool(replaced)
    assert all(replacement in printed for replacement in replaced)
    overridden_paths = [override.partition("=")[0] for override in overrides]
    for path in distributions_in(load_scenario(drawn)):
        assert path in distributions_in(scenario) or f" {path} " in printed or path in overridden_paths


COMMANDS_WITH_CONTROLLER = (
    "fly", "study", "compare", "replay", "draw", "design", "design-lqg", "tune", "map", "sensitivities", "judge",
)  # fmt: skip


@pytest.mark.parametrize("command", COMMANDS_WITH_CONTROLLER)
def test_each_command_that_flies_designs_or_judges_has_the_controller_option(command: str) -> None:
    assert command in COMMANDS
    module = import_module(f"drake_quad.command_line.{command.replace('-', '_')}")
    assert "--controller" in module.options().format_help()


def test_judge_refuses_a_controller_that_is_given_twice(controller_file) -> None:
    from drake_quad.command_line.judge import user_controllers

    result = user_controllers([f"{controller_file}:Mine", "controllers/lqg:lqg"])
    assert [each.name for each in result] == ["Mine", "controllers/lqg:lqg"]
    assert "lqg" in CONTROLLER_NAMES
    assert CONTROLLER_NAMES["Mine"] == "Mine"
    with pytest.raises(InputError, match=f"--controller {controller_file}:Mine is given twice"):
        user_controllers([f"{controller_file}:Mine", f"{controller_file}:Mine"])


@pytest.mark.long
def test_a_controller_in_python_is_judged_together_with_designed_ones(run, controller_file, tmp_path) -> None:
    command_line = [
        "judge",
        "--quick",
        "--family",
        "outdoor",
        "--only",
        "pd",
        "--controller",
        f"{controller_file}:Mine",
    ]
    result = run(*command_line, "--output", tmp_path)
    assert result.returncode == 0, result.stderr
    assert "\nMine " in result.stdout
    assert "| Mine |" in (tmp_path / "report.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_fly_command_that_a_study_prints_for_its_worst_sample_works(run, controller_file, tmp_path) -> None:
    result = run("study", "hover", "--controller", f"{controller_file}:Mine", "--samples", 2, "--workers", 1,
                 "--set", "duration=0.5", "--set", "vehicle.mass={uniform: {min: 0.6, max: 0.7}}",
                 "--output", tmp_path)  # fmt: skip
    assert result.returncode == 0, result.stderr
    command = next(line for line in result.stdout.splitlines() if "drake-quad fly" in line)
    command_line = command.split("drake-quad ")[1].split()
    assert run(*command_line, "--output", tmp_path / "flown").returncode == 0
