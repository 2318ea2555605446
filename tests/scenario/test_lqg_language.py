"""Tests that a control is a cascade by default, and that an LQG control replaces the whole cascade."""

import re
from pathlib import Path

import pytest

from drake_quad import InputError, build_tracking_diagram, load_scenario
from drake_quad.design.cascade import with_gains
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario

DIAGRAMS = Path(__file__).parents[2] / "diagrams"
LQG, PD = (f"{DIAGRAMS}/controllers/{name}" for name in ("lqg.yaml:lqg", "paper.yaml:pd"))
HIGH_WIND_LABORATORY = DIAGRAMS / "laboratory.yaml:high_wind"


def load(*overrides, layers=(LQG,), spec=HIGH_WIND_LABORATORY):
    return load_scenario(spec, overrides, layers=layers)


def test_an_lqg_layer_replaces_a_cascade_without_a_kind(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        f"mine: {{extends: [{HIGH_WIND_LABORATORY}, {LQG}], control: {{max_tilt: 0.5, lateral: {{lag: 0.04}}}}}}\n"
        f"back: {{extends: [mine, {PD}], control: {{position: {{k_p: [2, 2, 2]}}}}}}\n"
    )
    lqg_scenario, pd_scenario = (load_scenario(f"{path}:{name}") for name in ("mine", "back"))
    # A layer whose control has no kind modifies the control of the lower layers.
    assert (lqg_scenario.control.kind, lqg_scenario.control.max_tilt, lqg_scenario.control.lateral.lag) == (
        "lqg",
        0.5,
        0.04,
    )
    assert lqg_scenario.control.lateral.command_weight == load().control.lateral.command_weight
    assert (pd_scenario.control.kind, pd_scenario.control.position.k_p[0]) == ("cascade", 2.0)


def test_a_saved_control_contains_its_kind_and_can_be_flown_again(tmp_path):
    for scenario in (load(), load(layers=())):
        save_scenario(scenario, tmp_path / "saved.yaml")
        assert load_scenario(tmp_path / "saved.yaml") == scenario
    saved_fields = load(layers=()).model_dump(mode="json")
    del saved_fields["control"]["kind"]
    assert Scenario.model_validate(saved_fields).control.kind == "cascade"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["control.kind=mpcc"], "control.kind is 'mpcc', but must be one of 'cascade', 'lqg', 'mpc'"),
        (["control.lateral.lag=null"], "control.lateral.lag is missing"),
        (["control.yaw=null"], "control.yaw is missing"),
        (
            ["control.lateral.damping=0.7"],
            "control.lateral.damping is 0.7, but must be left out, or null, with laboratory.autopilot of kind none",
        ),
        (["control.lateral.lag=0"], "control.lateral.lag is 0, but must be greater than or equal to 0.0001"),
        (["control.delay_ticks=1.5"], "control.delay_ticks is 1.5, but must be a valid integer"),
        (["control.position={kind: pd}"], "control.position is unknown; allowed are kind, delay_ticks, lateral"),
        (["control.vertical.weight=1"], "control.vertical.weight is unknown"),
        (
            ["laboratory.motion_capture.period=0.02", "laboratory.command_link.period=0.01"],
            "motion_capture.period is 0.02, but must not be longer than the period of the command link, 0.01 s",
        ),
    ],
)
def test_errors_name_the_invalid_field(overrides, words):
    with pytest.raises(InputError, match=re.escape(words)):
        load(*overrides)


def test_the_design_model_is_the_attitude_response_if_there_is_an_autopilot():
    onboard = DIAGRAMS / "onboard.yaml"
    with pytest.raises(InputError, match=r"control\.lateral\.natural_frequency is missing"):
        load(spec=onboard)
    with pytest.raises(InputError, match=r"control\.yaw is .*, but must be left out"):
        load("control.lateral={natural_frequency: 8.8, damping: 0.7}", spec=onboard)
    # An identified response already includes the rotor lag, which is otherwise a separate part of the model.
    for lag in (0.05, None):
        response = f"control.lateral={{natural_frequency: 8.8, damping: 0.7, lag: {'null' if lag is None else lag}}}"
        assert load(response, "control.yaw=null", spec=onboard).control.lateral.lag == lag


def test_errors_of_a_cascade_name_its_fields():
    with pytest.raises(InputError, match=r"control\.thrust_vectoring\.max_tilt is 2, but must be"):
        load("control.thrust_vectoring.max_tilt=2", layers=())
    with pytest.raises(InputError, match=r"mass is unknown; .*did you mean nominal\.mass or vehicle\.mass"):
        load("mass=2", layers=())
    with pytest.raises(InputError, match=r"max_tilt is unknown; .*did you mean control\.max_tilt\?"):
        load("max_tilt=2", layers=())


def test_gain_design_for_a_cascade_refuses_other_controls():
    with pytest.raises(
        InputError, match=r"control of high_wind is of kind lqg; select a scenario with control of kind cascade"
    ):
        with_gains(load(), {"position": {"k_p": [1.0, 1.0, 1.0]}})


def test_weights_with_very_different_magnitudes_are_refused_on_assembly():
    slow = "control.lateral={lag: 80000, position_noise: 1.0e+9, attitude_noise: 1.5, command_weight: 1.0e+9}"
    with pytest.raises(InputError, match=r"control\.lateral: no Kalman filter or regulator can be computed"):
        build_tracking_diagram(load(slow))
