"""Tests that derivatives of metrics, computed by AutoDiffXd, agree with differences between whole flights."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from drake_quad import InputError, load_scenario, simulate
from drake_quad.design.sensitivity import (
    _BACKWARD_WEIGHTS,
    _CENTRAL_WEIGHTS,
    _FORWARD_WEIGHTS,
    differentiable_metrics,
    flight_sensitivities,
)
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.numbers import number_at, with_number
from drake_quad.scenario.position_controllers.controller import AnyPositionController

ROOT = Path(__file__).parent.parent.parent
DIFFERENTIATED_FIELDS = (
    "vehicle.mass",
    "vehicle.rotor_time_constant",
    "nominal.inertia.0",
    "control.position.k_p.1",
    "control.attitude.k_d.0",
    "laboratory.motion_capture.derivative_bandwidth",
    "laboratory.wind.0.flow",
)
SMOOTH_METRICS = ("rmse", "rmse_y", "peak_error", "effort_x", "effort_z")


@pytest.fixture(scope="module")
def windy():
    return load_scenario(ROOT / "diagrams" / "laboratory.yaml:low_wind", ["duration=3"])


@pytest.mark.long
def test_derivatives_match_differences_of_whole_flights(windy):
    sensitivities = flight_sensitivities(windy, DIFFERENTIATED_FIELDS, sample=2)
    nominal = simulate(windy, sample=2)
    for name in differentiable_metrics(windy):
        assert sensitivities.metrics[name] == pytest.approx(getattr(nominal.metrics, name), rel=1e-9)
    for i, field in enumerate(DIFFERENTIATED_FIELDS):
        step = 1e-4 * sensitivities.values[i]
        ends = [
            simulate(with_number(windy, field, sensitivities.values[i] + side * step), sample=2).metrics
            for side in (-1.0, 1.0)
        ]
        for name in SMOOTH_METRICS:
            low, high = (getattr(metrics, name) for metrics in ends)
            scale = sensitivities.metrics[name] / sensitivities.values[i]
            assert sensitivities.gradients[name][i] == pytest.approx(
                (high - low) / (2.0 * step), rel=1e-3, abs=1e-6 * scale
            )


@pytest.mark.long
def test_the_derivative_for_a_nominal_value_includes_the_vehicle_value_unless_the_scenario_sets_it():
    """`--set nominal.mass` also changes `vehicle.mass`, unless the scenario sets `vehicle.mass`."""
    path = ROOT / "diagrams" / "figure_eight.yaml"
    for overrides in ([], ["vehicle.mass=0.68"]):
        scenario = load_scenario(path, ["duration=2", *overrides])
        derivative = flight_sensitivities(scenario, ["nominal.mass"]).gradients["effort_z"][0]
        ends = [
            simulate(load_scenario(path, ["duration=2", f"nominal.mass={mass}", *overrides]))
            for mass in (0.6799, 0.6801)
        ]
        low, high = (flight.metrics.effort_z for flight in ends)
        assert derivative == pytest.approx((high - low) / 0.0002, rel=1e-3, abs=1e-6)


def test_a_metric_that_is_zero_has_no_derivative():
    sensitivities = flight_sensitivities(
        load_scenario(ROOT / "diagrams" / "hover.yaml", ["duration=1"]), ["vehicle.mass"]
    )
    assert sensitivities.metrics["rmse"] == 0.0
    assert np.isnan(sensitivities.gradients["rmse"]).all()


def test_a_crash_before_the_first_tick_of_the_metrics_is_reported():
    unstable_gains = ["duration=3", "metrics={start: 2.5}", "control.attitude.k_p=[900, 900, 9]"]
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", unstable_gains)
    with pytest.raises(InputError, match=r"crashed at \d\.\d\d s, before the first tick that the metrics include"):
        flight_sensitivities(scenario, ["vehicle.mass"])


@pytest.mark.long
def test_derivatives_include_the_learning_of_a_network(windy):
    """The network resets its covariance at the end of the route's first leg, at 2.3 s."""
    learning = {
        "kind": "type_2",
        "learning": {"kind": "covariance", "slope": 2.0, "initial_covariance": 6.0, "reset": "at_segments"},
    }
    gains = {"kind": "pd", "k_p": (1.4, 1.4, 6.0), "k_d": (1.4, 1.4, 3.5), "derivative": "measurement"}
    parts = {
        "position": TypeAdapter(AnyPositionController).validate_python(gains),
        "network": TypeAdapter(Network).validate_python(learning),
    }
    scenario = windy.model_copy(update={"control": windy.control.model_copy(update=parts)})
    fields = [f"control.network.{name}" for name in ("learning.slope", "learning.initial_covariance", "a1", "q")]
    sensitivities = flight_sensitivities(scenario, fields, sample=1)
    for i, field in enumerate(fields):
        step = 1e-4 * sensitivities.values[i]
        low, high = (
            simulate(with_number(scenario, field, sensitivities.values[i] + side * step), sample=1).metrics.rmse
            for side in (-1.0, 1.0)
        )
        assert sensitivities.gradients["rmse"][i] == pytest.approx((high - low) / (2.0 * step), rel=1e-4)


@pytest.mark.long
@pytest.mark.parametrize(
    ("field", "bound", "step"), [("vehicle.linear_drag", 0.0, 1e-6), ("control.network.q", 1.0, -1e-4)]
)
def test_a_parameter_at_its_bound_is_varied_to_one_side(asymmetric, field, bound, step):
    """The differences increase a parameter at its minimum, and decrease a parameter at its maximum."""
    scenario = asymmetric("pd_t2fnn", "duration=1", f"{field}={bound}", "metrics.start=0")
    sensitivities = flight_sensitivities(scenario, [field])
    with pytest.raises(InputError, match=f"{field} cannot be"):
        with_number(scenario, field, bound - step)
    ends = [simulate(with_number(scenario, field, value)).metrics.rmse for value in (bound, bound + step)]
    assert sensitivities.gradients["rmse"][0] == pytest.approx((ends[1] - ends[0]) / step, rel=1e-3)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("vehicle.wings", "the scenario has no field vehicle.wings"),
        ("control.position.k_p.3", "the scenario has no field control.position.k_p.3"),
        ("control.position.k_p.-1", "the scenario has no field control.position.k_p.-1"),
        ("control.position.kind", "control.position.kind is 'pd', but must be a real number"),
        ("seed", "seed is 0, but must be a real number"),
        ("route.radius", "with respect to route.radius: it changes the plan"),
        ("laboratory.command_link.loss_rate", "the flight depends on it discontinuously"),
        ("crash.tilt", "with respect to crash.tilt: the flight does not depend on it smoothly"),
        ("laboratory.motion_capture.position_noise", "the structure of the diagram changes at 0"),
        ("laboratory.motion_capture.attitude_noise", "the structure of the diagram changes at 0"),
        ("laboratory.motion_capture.misalignment.1", "the structure of the diagram changes at 0"),
        ("laboratory.wind.0.velocity.1", "the structure of the diagram changes at 0"),
        ("vehicle.battery_sag", "the structure of the diagram changes at 0"),
    ],
)
def test_fields_without_a_derivative_are_refused(field, message):
    """Some of the fields are zero, so that the diagram does not contain the system that reads them."""
    no_wind = [
        "laboratory.wind=[{kind: steady, velocity: [0, 0, 0]}]",
        "laboratory.motion_capture.derivative_bandwidth=80",
    ]
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", ["duration=1", *no_wind])
    with pytest.raises(InputError, match=message):
        flight_sensitivities(scenario, [field])


def test_numeric_fields_are_read_and_replaced_by_path(windy):
    assert number_at(windy, "control.position.k_p.2") == windy.control.position.k_p[2]
    changed = with_number(windy, "laboratory.wind.1.position.0", 2.5)
    assert changed.laboratory.wind[1].position == (2.5, -5.5, 1.5)
    assert windy.laboratory.wind[1].position[0] == 1.2
    assert changed.model_copy(update={"laboratory": windy.laboratory}) == windy
    with pytest.raises(InputError, match="vehicle.mass cannot be -1"):
        with_number(windy, "vehicle.mass", -1.0)


def test_an_empty_list_of_fields_is_refused():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", ["duration=1"])
    with pytest.raises(InputError, match="cannot compute sensitivities: no field is given"):
        flight_sensitivities(scenario, [])


@pytest.mark.long
def test_the_default_sample_is_the_field_sample_of_the_scenario(windy):
    named = windy.model_copy(update={"sample": 2, "duration": 0.3})
    sensitivities = flight_sensitivities(named, ["vehicle.mass"])
    assert sensitivities.fields == ("vehicle.mass",)
    for sample in (2, 1):
        other = flight_sensitivities(named.model_copy(update={"sample": None}), ["vehicle.mass"], sample=sample)
        assert (other.metrics["rmse"] == sensitivities.metrics["rmse"]) == (sample == 2)
    assert sensitivities.crash_time == np.inf
    first = flight_sensitivities(named, ["vehicle.mass"], sample=0)
    alone = flight_sensitivities(named.model_copy(update={"sample": None}), ["vehicle.mass"])
    assert first.metrics["rmse"] == alone.metrics["rmse"] != sensitivities.metrics["rmse"]


def test_sensitivities_of_a_scenario_with_a_distribution_need_a_sample():
    scenario = load_scenario(
        ROOT / "diagrams" / "figure_eight.yaml", ["duration=1", "vehicle.mass={uniform: {min: 0.6, max: 0.7}}"]
    )
    with pytest.raises(InputError, match=r"vehicle\.mass"):
        flight_sensitivities(scenario, ["vehicle.linear_drag"])
    sensitivities = flight_sensitivities(scenario, ["vehicle.mass"], sample=3)
    assert sensitivities.values[0] == simulate(scenario, sample=3).scenario.vehicle.mass
    assert 0.6 < sensitivities.values[0] < 0.7


def test_a_flight_that_crashes_is_differentiated_until_its_crash():
    unstable_gains = ["duration=3", "control.attitude.k_p=[900, 900, 9]"]
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", unstable_gains)
    assert flight_sensitivities(scenario, ["vehicle.mass"]).crash_time == simulate(scenario).metrics.crash_time < 3.0


def test_a_field_that_can_neither_increase_nor_decrease_is_refused_with_the_reason():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", ["duration=1"])
    words = r"^laboratory\.command_link\.period cannot be 0\.01996: must be the shortest period"
    with pytest.raises(InputError, match=words):
        flight_sensitivities(scenario, ["laboratory.command_link.period"])


def test_requirements_and_metrics_without_derivatives_do_not_affect_other_derivatives():
    """The requirement `late` begins after the end of the flight, so it has no robustness."""
    condition = {"signal": "position_error", "below": 0.1}
    plain = {"duration": 0.2, "initial.position": [0.02, 0.0, 0.0]}
    extended = {
        "metrics.additional": {
            "mean_tilt": {"kind": "mean", "of": "tilt"},
            "last_fall": {"kind": "last", "of": "state.v_z"},
            "settling_time": {"radius": 1e-3},
            "overshoot": {},
            "command_jerk": {},
        },
        "requirements": {
            "near": {"always": condition},
            "late": {"eventually": condition, "after": 5.0},
            "until": {"always": condition, "until": condition},
        },
    }
    scenario = load_scenario("hover", plain | extended | {"vehicle.mass": 0.7})
    actual = flight_sensitivities(scenario, ["vehicle.mass"])
    expected = flight_sensitivities(load_scenario("hover", plain | {"vehicle.mass": 0.7}), ["vehicle.mass"])
    assert actual.gradients["rmse"] == expected.gradients["rmse"]
    assert actual.metrics["last_fall"] < 0.0
    assert actual.gradients["last_fall"] < 0.0
    assert np.isfinite(actual.gradients["mean_tilt"]).all()
    assert not {"settling_time", "near", "late", "until"} & {*actual.gradients}


@pytest.mark.parametrize("field", ["laboratory.motion_capture.dropout_rate", "vehicle.rotor_failure.time"])
def test_fields_that_determine_the_time_of_an_event_have_no_derivative(field):
    failing = ["duration=1", "vehicle.rotor_failure={rotor: 1, time: 0.5}"]
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", failing)
    with pytest.raises(InputError, match="the flight depends on it discontinuously"):
        flight_sensitivities(scenario, [field])


@pytest.mark.parametrize("weights", [_CENTRAL_WEIGHTS, _FORWARD_WEIGHTS, _BACKWARD_WEIGHTS])
def test_differences_are_exact_for_polynomials_of_the_fourth_degree(weights):
    """Differences are central or one-sided.

    `weights` omits the weight of the undisturbed value, which follows from the sum of all weights, zero.
    """
    for power in range(1, 5):
        assert sum(weight * steps**power for steps, weight in weights.items()) == pytest.approx(float(power == 1))


def test_the_layout_of_the_vehicle_can_be_varied_even_if_only_nominal_has_one():
    scenario = load_scenario(
        ROOT / "diagrams" / "figure_eight.yaml", ["nominal.layout={kind: h, length: 0.2, width: 0.3}"]
    )
    changed = with_number(scenario, "vehicle.layout.width", 0.31)
    assert (changed.vehicle.layout.length, changed.vehicle.layout.width) == (0.2, 0.31)
    assert changed.nominal.layout == scenario.nominal.layout
