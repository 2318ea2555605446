"""Tests that the declared attributes of every registered kind, including users' kinds, agree with the systems."""

import pickle
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pytest
from compiled_comparison import assert_flights_alike, assert_flown_alike

from drake_quad import InputError, closed_loop, load_scenario, simulate
from drake_quad.assembly.control import control_setting
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.design.cascade import with_gains, with_integrals
from drake_quad.flight.mission import plan_route
from drake_quad.gym.rollout import action_source
from drake_quad.scenario.actions.acceleration import AccelerationAction
from drake_quad.scenario.actions.action import ACTIONS
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS
from drake_quad.scenario.attitude_controllers.pd import PdAttitude
from drake_quad.scenario.autopilots.attitude import AttitudeAutopilotSettings
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.controls.control import CONTROLS
from drake_quad.scenario.controls.policy import PolicyControl
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.hovering import at_rest
from drake_quad.scenario.paths import value_at
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.schema import file_schema, language_page
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.quadrotor import HoverPose, QuadrotorConfig

REPOSITORY = Path(__file__).parent.parent.parent
EXAMPLE_SCRIPT = REPOSITORY / "scripts" / "sliding_mode_in_yaml.py"


TESTED_CONTROLS = [
    ("figure_eight", []),
    ("onboard", []),
    ("laboratory:nominal", ["controllers/lqg:lqg"]),
    ("onboard", ["controllers/lqg:lqg_onboard"]),
    ("laboratory:nominal", ["controllers/mpc:mpc"]),
    ("figure_eight", ["controllers/raptor:raptor"]),
    ("laboratory:nominal", ["vehicles/crazyflie", "controllers/crazyflie"]),
]


def example(kind: type[Model]) -> Any:
    """Return an instance of a model in which each required number is 1 and each required part has its default kind."""
    fields = {name: value_for(info) for name, info in kind.model_fields.items() if info.is_required()}
    return kind.model_validate(fields)


def value_for(field: Any) -> Any:
    unions = [union for union in field.metadata if isinstance(union, OpenUnion)]
    models = [*unions[0]] if unions else [field.annotation, *get_args(field.annotation)]
    models = [model for model in models if isinstance(model, type) and issubclass(model, Model)]
    if get_args(field.annotation) and isinstance(get_args(field.annotation)[0], str):
        return get_args(field.annotation)[0]
    if (models and field.discriminator is not None) or unions or models == [field.annotation]:
        return example(models[0])
    return [1.0, 1.0, 1.0] if getattr(field.annotation, "__origin__", None) is tuple else 1.0


@pytest.fixture(scope="module")
def settings():
    """Return control settings without and with an autopilot, by the name of the scenario."""
    return {name: setting_of(load_scenario(name)) for name in ("figure_eight", "onboard")}


def setting_of(scenario):
    return control_setting(scenario, plan_route(scenario))


def port_names(system):
    inputs = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
    return inputs, {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}


def for_each_member(union):
    return pytest.mark.parametrize("kind", union.members.values(), ids=lambda kind: kind.__name__)


def check_position_controller(kind, setting):
    position = example(kind)
    systems = {path: recipe.build(2) for path, recipe in position.recipes(setting).items()}
    assert all(path == "position" or path.startswith("position.") for path in systems)
    built = position.build(systems, takes_correction=kind.takes_correction)
    inputs, outputs = port_names(built)
    assert inputs >= {"measurement", "reference"}
    assert ("correction" in inputs) == kind.takes_correction
    assert "acceleration_command" in outputs
    assert ("disturbance" in outputs) == kind.estimates_disturbance
    assert hasattr(position, "k_i") == kind.has_integral
    assert position.feed_forward in setting.autopilot.feeds_forward


@for_each_member(POSITION_CONTROLLERS)
def test_declarations_of_every_position_controller_agree_with_its_systems(kind, settings):
    check_position_controller(kind, settings["figure_eight"])
    plain = example(kind).without_estimator()
    assert plain.without_estimator() is plain
    assert not plain.estimates_disturbance
    assert (plain.k_p, plain.k_d, plain.feed_forward) == ((1.0,) * 3, (1.0,) * 3, "none")


@for_each_member(ATTITUDE_CONTROLLERS)
def test_declarations_of_every_attitude_controller_agree_with_its_system(kind, settings):
    attitude, nominal = example(kind), settings["figure_eight"].nominal
    inputs, outputs = port_names(attitude.recipe(nominal.inertia, 0.02).build(2))
    assert inputs >= {"measurement", "attitude_command"}
    assert outputs == {"torque"}
    vectoring = load_scenario("figure_eight").control.thrust_vectoring.recipe(nominal, attitude)
    assert port_names(vectoring.build(2))[0] >= {"measurement", "acceleration_command"}
    plain = attitude.without_estimator()
    assert plain.without_estimator() is plain
    assert (plain.k_p, plain.k_d) == (attitude.k_p, attitude.k_d)
    assert not plain.recipe(nominal.inertia, 0.02).build(2).updates, "a plain controller has no memory"


@for_each_member(AUTOPILOTS)
def test_declarations_of_every_autopilot_agree_with_its_system(kind, settings):
    autopilot, nominal = example(kind), settings["onboard"].nominal

    def recipes_of(autopilot):
        return autopilot.recipes(nominal, settings=autopilot, follows_attitude=True, curve=None)

    recipes = recipes_of(autopilot)
    firmware = recipes.pop("firmware", None)
    assert (firmware is not None) == kind.is_firmware
    command = "wrench" if firmware is None else firmware.build(2).get_input_port().get_name()
    assert [*recipes] == (["autopilot"] if autopilot.controls_attitude else [])
    assert (autopilot.attitude_response() is not None) == autopilot.controls_attitude
    assert ("wrench" in kind.accepts) != autopilot.controls_attitude
    for recipe in recipes.values():
        system = recipe.build(2)
        inputs, outputs = port_names(system)
        assert "attitude_target" in inputs
        assert outputs == {command}
        assert firmware or {update.period for update in system.updates} == {autopilot.period} - {None}
    assert all(getattr(autopilot, name) == (1.0,) * 3 for name in kind.loop_gains or ())
    config = QuadrotorConfig(nominal, start=HoverPose(0.0, 0.0, 1.0, 0.0))
    vehicle = autopilot.vehicle_recipe({"time_step": 0.01}, config).build(2)
    assert vehicle.HasInputPort("attitude_target") == kind.models_vehicle
    noises = {name: 0.1 for name in kind.model_fields if "noise" in name}
    biases = {name: (0.1, 0.2, 0.3) for name in kind.model_fields if "bias" in name}
    imperfect = autopilot.model_copy(update=noises | biases)
    assert (recipes_of(imperfect) != recipes_of(autopilot)) == bool(noises | biases)
    assert recipes_of(imperfect.without_noise().without_bias()) == recipes_of(autopilot)
    assert recipes_of(imperfect.without_noise()) == recipes_of(autopilot.model_copy(update=biases))


def test_an_identified_response_decays_with_its_poles():
    for damping in (0.7, 1.0, 1.9):
        fields = {"kind": "response", "natural_frequency": [9.0, 3.0, 2.0], "damping": [damping] * 3}
        response = AUTOPILOTS.get("response").model_validate(fields)
        poles = np.roots([1.0, 2.0 * damping * 9.0, 81.0])
        assert response.fastest_decay() == pytest.approx(-poles.real.min())


def check_action(kind, settings):
    action = example(kind)
    for setting in settings.values():
        if kind.commands not in setting.autopilot.accepts:
            continue
        on_board = setting.autopilot.controls_attitude
        attitude = example(PdAttitude) if action.needs_attitude(setting.autopilot) else None
        assert action.needs_attitude(setting.autopilot) == (not on_board and kind.commands in ("attitude", "rates"))
        system = action.recipe(setting, turn=0.0, attitude=attitude).build(2)
        _, outputs = port_names(system)
        commands = {"attitude": "thrust_and_attitude", "rates": "wrench", "wrench": "wrench"}[kind.commands]
        if kind.vectors_thrust:
            commands = "acceleration_command"
        elif kind.commands == "rates" and on_board:
            commands = "attitude_target"
        assert outputs == {commands}
        assert system.GetInputPort("action").size() == 2 * kind.num_rows
        assert len(action.hover_action(setting.nominal)) == kind.num_rows
        assert max(map(abs, action.hover_action(setting.nominal))) < 1.0


@for_each_member(ACTIONS)
def test_declarations_of_every_action_agree_with_its_system(kind, settings):
    check_action(kind, settings)


@pytest.mark.parametrize(("scenario", "layers"), TESTED_CONTROLS)
def test_declarations_of_every_control_agree_with_its_diagram(scenario, layers):
    scenario = load_scenario(scenario, layers=layers)
    control, setting = scenario.control, setting_of(scenario)
    recipes = control.recipes(setting)
    for prefixes in control.user_system_paths.values():
        assert any(path.startswith(prefixes) for path in recipes)
    diagram = control.build({path: recipe.build(2) for path, recipe in recipes.items()}, UserSystems().specified)
    inputs, outputs = port_names(diagram)
    assert diagram.get_name() == "control"
    assert setting.autopilot.command in outputs
    assert ("reference_ahead" in inputs) == bool(control.preview_times())
    assert ("action" in outputs) == bool(control.policy_rows()) == ("policy" in control.user_system_paths)
    assert not control.lacks_policy()
    assert ("network" in {part.get_name() for part in diagram.GetSystems()}) == (control.network is not None)
    assert (control.cascade() is control) == (control.kind == "cascade")
    assert 0.0 < control.limits().min_thrust < 1.0 < control.limits().max_thrust


def test_every_kind_of_control_is_tested():
    assert {load_scenario(name, layers=layers).control.kind for name, layers in TESTED_CONTROLS} == {*CONTROLS.members}


@pytest.fixture
def sliding_mode(monkeypatch):
    """Register the position controller of the example during a test, and return it."""
    monkeypatch.syspath_prepend(EXAMPLE_SCRIPT.parent)
    return POSITION_CONTROLLERS.register(import_module(EXAMPLE_SCRIPT.stem).SlidingPosition)


SLIDING_MODE = {"kind": "sliding_mode", "slope": [1.5, 1.4, 2.0], "gain": [2.0, 2.1, 4.0], "width": [0.9, 0.8, 1.0]}


def figure_eight_with(position=SLIDING_MODE, **changes):
    return load_scenario("figure_eight", {"control.position": position, "duration": 2.0, **changes})


def test_a_user_s_position_controller_is_checked_like_a_shipped_one(sliding_mode, settings):
    check_position_controller(sliding_mode, settings["figure_eight"])


@pytest.mark.slow
def test_the_sliding_mode_controller_is_a_pd_within_its_boundary_layer(sliding_mode):
    """There its command K (ė + λ e) / φ + λ ė is that of a PD with k_P = K λ / φ and k_D = λ + K / φ."""
    slope, gain, width = (np.array(SLIDING_MODE[name]) for name in ("slope", "gain", "width"))
    pd = {"kind": "pd", "feed_forward": "snap", "k_p": gain * slope / width, "k_d": slope + gain / width}
    sliding_flight, pd_flight = (simulate(figure_eight_with(position)) for position in (SLIDING_MODE, pd))
    np.testing.assert_allclose(sliding_flight["state"], pd_flight["state"], rtol=0.0, atol=1e-12)
    loops = [closed_loop(at_rest(figure_eight_with(position))).system.A for position in (SLIDING_MODE, pd)]
    np.testing.assert_allclose(*loops, rtol=0.0, atol=1e-9)


def test_the_sliding_mode_command_is_limited_outside_its_boundary_layer(sliding_mode):
    position = SLIDING_MODE | {"width": [1e-6] * 3}
    flight = simulate(figure_eight_with(position, **{"vehicle.mass": 0.5, "duration": 0.5}))
    command, reference = flight.record("acceleration_command"), flight.record("reference")
    measurement = flight.record("measurement")
    switching_term = command.z - reference.a_z - SLIDING_MODE["slope"][2] * (reference.v_z - measurement.v_z)
    np.testing.assert_allclose(np.abs(switching_term[2:]), SLIDING_MODE["gain"][2], rtol=1e-9)


@pytest.mark.slow
def test_a_user_s_position_controller_flies_uncompiled_and_in_compiled_fleets(sliding_mode):
    gain = {"uniform": {"min": 1.0, "max": 3.0}}
    assert_flown_alike(Batch.draw(figure_eight_with(**{"control.position.gain.1": gain, "duration": 0.5}), range(3)))


@pytest.mark.long
def test_a_user_s_position_controller_is_part_of_the_language(sliding_mode):
    assert "SlidingPosition" in file_schema()["$defs"]
    assert "| `slope` |" in language_page()
    with pytest.raises(InputError, match=r"control.position.slope.0 is -1.0, but must be larger than 0"):
        figure_eight_with(SLIDING_MODE | {"slope": [-1.0, 1.0, 1.0]})
    network = {"kind": "type_1", "learning": {"kind": "gradient"}}
    with pytest.raises(InputError, match="position controller of kind sliding_mode takes no correction"):
        figure_eight_with(**{"control.network": network})
    assert pickle.loads(pickle.dumps(figure_eight_with())) == figure_eight_with()
    refusal = "the gains of control.position of kind sliding_mode cannot be designed"
    for design in (with_integrals, lambda scenario: with_gains(scenario, {"position": {"k_p": [1.0] * 3}})):
        with pytest.raises(InputError, match=refusal):
            design(figure_eight_with())
    POSITION_CONTROLLERS.remove("sliding_mode")
    with pytest.raises(InputError, match="control.position.kind is 'sliding_mode', but must be one of"):
        figure_eight_with()
    POSITION_CONTROLLERS.register(sliding_mode)


class UserAutopilot(AttitudeAutopilotSettings):
    kind: Literal["own_autopilot"]


class UserAction(AccelerationAction):
    kind: Literal["own_action"]


class UserAttitude(PdAttitude):
    kind: Literal["own_attitude"]


class UserControl(PolicyControl):
    kind: Literal["own_control"]


ATTITUDE_CONTROLLER = {"kind": "pd", "k_p": [9.0, 8.0, 3.0], "k_d": [4.0, 4.0, 2.0]}
POLICY_CONTROL = {"kind": "policy", "action": {"kind": "acceleration"}, "attitude": ATTITUDE_CONTROLLER}


@pytest.mark.parametrize(
    ("union", "kind", "base", "changes", "path"),
    [
        (AUTOPILOTS, UserAutopilot, "onboard", {}, "laboratory.autopilot"),
        (ACTIONS, UserAction, "figure_eight", {"control": POLICY_CONTROL}, "control.action"),
        (ATTITUDE_CONTROLLERS, UserAttitude, "figure_eight", {}, "control.attitude"),
        (ATTITUDE_CONTROLLERS, UserAttitude, "figure_eight", {"control": POLICY_CONTROL}, "control.attitude"),
        (CONTROLS, UserControl, "figure_eight", {"control": POLICY_CONTROL}, "control"),
    ],
)
def test_a_user_s_kind_flies_like_the_kind_that_it_extends(union, kind, base, changes, path):
    union.register(kind)
    changes = changes | {"duration": 0.1}
    scenario = load_scenario(base, changes)
    (name,) = get_args(kind.model_fields["kind"].annotation)
    override = {path: value_at(scenario, path).model_dump(mode="json") | {"kind": name}}
    flights = []
    for each in (scenario, load_scenario(base, [changes, override])):
        policy = action_source(np.full((1, 3), 0.1), 0.02) if each.control.lacks_policy() else None
        flights.append(simulate(each, policy=policy, sample=0))
    assert value_at(flights[1].scenario, path).kind == name
    assert_flights_alike(*flights)


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_a_command_imports_a_user_s_position_controller(run, tmp_path):
    position = (
        f"control.position={{kind: sliding_mode, slope: {SLIDING_MODE['slope']}, gain: [2, 2, 4], width: [1, 1, 1]}}"
    )
    mass = "vehicle.mass={uniform: {min: 0.66, max: 0.7}}"
    study = [
        "study",
        "figure_eight",
        "--samples",
        "2",
        "--workers",
        "2",
        *(part for field in ("duration=0.5", mass, position) for part in ("--set", field)),
    ]
    result = run(*study, "--output", tmp_path, "--import", EXAMPLE_SCRIPT)
    assert (result.returncode, result.stderr) == (0, "")
