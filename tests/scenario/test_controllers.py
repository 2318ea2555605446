"""Tests of messages about mistakes in learning controllers and disturbance estimators."""

import math
from pathlib import Path

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.laboratory import build_monitor
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.files.saving import save_scenario

REPOSITORY = Path(__file__).parent.parent.parent
PAPER_CONTROLLERS = REPOSITORY / "diagrams" / "controllers" / "paper.yaml"
NETWORK_FIELD = "control.network"
NINE_SETS = "{centres: [-4, -3, -2, -1, 0, 1, 2, 3, 4], widths: [1, 1, 1, 1, 1, 1, 1, 1, 1]}"


def load(controller, *overrides):
    return load_scenario(
        REPOSITORY / "diagrams" / "laboratory.yaml:nominal", overrides, layers=[f"{PAPER_CONTROLLERS}:{controller}"]
    )


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("a1", "1.0", "is 1, but must be larger than 1|is 1.0, but must be larger than 1"),
        ("a2", "1.0", "must be larger than 0 and smaller than 1"),
        ("a2", "0", "must be larger than 0 and smaller than 1"),
        ("q", "1.5", "must be at least 0 and at most 1"),
        ("a1", "{uniform: {min: 0.9, max: 2.0}}", "must be larger than 1"),
        ("inputs.error.centres", "[0, -1, 1]", r"centres is \[0, -1, 1\], but must be ascending"),
        ("inputs.error.centres", "[0]", "must have at least 2 items|at least 2"),
        ("inputs.error.centres", "[-1, 0, 1, 2]", "widths .*must have 4 numbers, one for each centre"),
        (
            "inputs.error_rate.widths",
            "[0.4, 0.4, 1]",
            r"be larger, so that the sets at -1(\.0)? and 0(\.0)? overlap",
        ),
        ("inputs.error_rate.widths", "[0.5, 0.5, 1]", "must be larger, so that the sets"),
        ("inputs.error_rate.widths", "[1, 0, 1]", "must be larger than 0"),
        ("inputs.error.scale", "0", "must be larger than 0"),
        (
            "inputs",
            "{error: null, error_rate: null}",
            "inputs is .*, but must have one to four of the inputs error, .*, disturbance$",
        ),
        ("inputs", "{x: {}, y: {}, z: {}}", "inputs is .*, but must have one to four of the inputs"),
        ("inputs.phase", "{centres: [0, 0.5, 1]}", "widths .*must have 3 numbers, one for each centre"),
        ("inputs.phase", "{centres: [0, 0.5, 1], widths: [1, 1, 1]}", "must span less than one period"),
        ("inputs.phase", "{centres: [0, 0.4], widths: [0.3, 0.25]}", "sets at 0.4 and 1.0 overlap"),
        (
            "inputs.phase",
            "{scale: {uniform: {min: 1.7, max: 2}}, centres: [0, 0.8], widths: [0.5, 0.6]}",
            "sets at 0.8 and 2.0 overlap",
        ),
        ("lead", "-0.1", "must be at least 0"),
        (
            "inputs",
            f"{{x: {NINE_SETS}, y: {NINE_SETS}, error: {NINE_SETS}}}",
            "must result in at most 256 rules, not 2187",
        ),
        (
            "inputs.disturbance",
            "{}",
            "disturbance .*must be left out, since a position controller of kind pd estimates no disturbance",
        ),
        ("learning.signal", "error", "must be 'surface' or 'feedback'"),
        ("learning.slope", "0", "must be larger than 0"),
        ("learning.gain", "-1", "must be larger than 0"),
        ("learning.initial_covariance", "0", "must be larger than 0"),
        ("learning.forgetting", "0", "must be larger than 0 and at most 1"),
        ("learning.forgetting", "1.01", "must be larger than 0 and at most 1"),
        ("learning.kind", "newton", "must be one of 'covariance', 'gradient', 'sign'"),
        ("learning.rate", "1.0", "rate is unknown"),
        ("learning.deadzone", "-0.1", "must be at least 0"),
        ("adaptive", "{}", "must contain at least one learning rate, centres or widths or exponents, or be null"),
        ("adaptive.widths", "0", "must be larger than 0"),
        ("axes", "[]", "axes"),
        ("axes", "[x, w]", "must be 'x', 'y' or 'z'"),
    ],
)
def test_the_error_for_an_invalid_network_parameter_names_its_field(field, value, words):
    with pytest.raises(InputError, match=words) as caught:
        load("pd_t2fnn", f"{NETWORK_FIELD}.{field}={value}")
    assert "\n" not in str(caught.value)
    assert field.split(".")[0] in str(caught.value)


def test_a_type_1_network_rejects_the_exponents_of_type_2_networks():
    for field in ("a1", "adaptive.exponents"):
        with pytest.raises(InputError, match="(a1|exponents) is unknown"):
            load("pd_t1fnn", f"{NETWORK_FIELD}.{field}=1.2")


def test_network_parameters_may_be_distributions():
    overrides = ["a1={uniform: {min: 1.1, max: 2.0}}", "learning.gain={choice: [0.5, 1.0]}"]
    load("pd_t2fnn", *(f"{NETWORK_FIELD}.{override}" for override in overrides))


def test_shipped_controllers_can_be_combined_with_every_laboratory():
    for laboratory in ("nominal", "low_wind", "high_wind"):
        for name in ("pd", "pd_t1fnn", "pd_t2fnn", "pid", "pd_feed_forward"):
            spec = REPOSITORY / "diagrams" / f"laboratory.yaml:{laboratory}"
            scenario = load_scenario(spec, layers=[f"{PAPER_CONTROLLERS}:{name}"])
            assert scenario.name == laboratory
            assert scenario.control.attitude.k_p[0] == 20.0
        for name in ("pd", "pid", "disturbance_observer", "l1", "indi"):
            scenario = load_scenario(
                spec, layers=[f"{PAPER_CONTROLLERS.parent / 'designed' / 'laboratory.yaml'}:{name}"]
            )
            assert (scenario.name, scenario.control.position.kind) == (laboratory, name)


ESTIMATOR_GAINS = "k_p: [1, 1, 1], k_d: [1, 1, 1], bandwidth: [1, 1, 1]"


@pytest.mark.parametrize(
    ("override", "complaint"),
    [
        ("control.attitude=7", "control.attitude is 7, but must be a mapping of fields"),
        ("control.attitude.k_q=1", "control.attitude.k_q is unknown; allowed are kind, k_p, k_d; did you mean k_p?"),
        ("control.attitude.kind=lqr", "control.attitude.kind is 'lqr', but must be one of '"),
        ("control.attitude={kind: indi, lag: 0.1}", "control.attitude.k_p is missing, and so are k_d, bandwidth"),
        (f"control.position={{kind: l1, {ESTIMATOR_GAINS}}}", "control.position.response is missing"),
        (
            f"control.position={{kind: indi, {ESTIMATOR_GAINS}, response: {{kind: commanded, lag: [0.1, 0, 0.1]}}}}",
            "control.position.response.lag.1 is 0, but must be larger than 0",
        ),
        ("crash.tilt=2", "crash.tilt is 2, but must be in radians, at most 1.571 in magnitude; 2 degrees are 0.03491"),
    ],
)
def test_errors_for_invalid_estimators_and_attitude_controllers_give_the_reason(override, complaint):
    with pytest.raises(InputError) as error:
        load_scenario(REPOSITORY / "diagrams" / "figure_eight.yaml", [override])
    assert complaint in str(error.value)


def test_an_attitude_controller_without_a_kind_is_a_pd_also_after_saving(tmp_path):
    scenario = load_scenario(REPOSITORY / "diagrams" / "figure_eight.yaml")
    assert scenario.control.attitude.kind == "pd"
    save_scenario(scenario, tmp_path / "saved.yaml")
    assert load_scenario(tmp_path / "saved.yaml") == scenario


def test_the_vehicle_may_turn_over_if_the_tilt_limit_is_disabled():
    scenario = load_scenario(REPOSITORY / "diagrams" / "figure_eight.yaml", ["crash.tilt=null"])
    monitor = build_monitor(scenario, plan_route(scenario), 1)
    assert monitor.structure["limits"].tilt == math.inf


def test_geometric_control_is_the_published_law_by_default():
    """The default law has the transport term of Lee et al. (2010) and the angles of eq (1)."""
    field = "control.attitude={kind: geometric, k_p: [17, 14, 5], k_d: [7, 7, 3]}"
    attitude = load("pd", field).control.attitude
    assert (attitude.transport_term, attitude.euler_sequence, attitude.k_i) == (True, "zyx", None)
    other_scenario = load("pd", field, "control.attitude.transport_term=false", "control.attitude.euler_sequence=zxy")
    assert (other_scenario.control.attitude.transport_term, other_scenario.control.attitude.euler_sequence) == (
        False,
        "zxy",
    )
