"""Tests that each setting without effect is reported, and that a flight without the setting is the same."""

from typing import Annotated, Literal

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.flight.remarks import flight_remarks
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.shipped import shipped_scenarios
from drake_quad.scenario.inactive import can_have_effect, needs
from drake_quad.scenario.models import UNIONS
from drake_quad.scenario.quantities import Number

ZERO_K_I_PID = {"kind": "pid", "k_p": [3.0, 2.9, 9.0], "k_d": [2.5, 2.4, 4.0], "k_i": [0.0, 0.0, 0.0]}
GEOMETRIC = {"kind": "geometric", "k_p": [90.0, 80.0, 20.0], "k_d": [14.0, 15.0, 7.0]}
INDI_POSITION = {
    "kind": "indi", "k_p": [3.0, 2.9, 9.0], "k_d": [2.5, 2.4, 4.0], "bandwidth": [3.0, 4.0, 5.0],
    "response": {"kind": "commanded", "lag": [0.2, 0.3, 0.1]},
}  # fmt: skip
FEEDBACK_NETWORK = {"kind": "type_1", "learning": {"kind": "covariance", "signal": "feedback"}}
FIXED_NETWORK = {"kind": "type_1", "learning": {"kind": "gradient", "rate": 0.0}}
ZERO_K_I = {"k_i": [0.0, 0.0, 0.0]}
GUST = {"kind": "gust", "velocity": [2.0, 1.0, 0.0], "start": 0.1, "rise_time": 0.1}  # m/s and s
ZERO_GUST = GUST | {"velocity": [0.0, 0.0, 0.0]}
WITH_DRAG = {"vehicle.linear_drag": 0.2, "vehicle.body_drag.linear": [0.1, 0.2, 0.3]}


def with_sensor(kind, **settings):
    """Return an override that adds a sensor."""
    return {"laboratory.sensors": [{"kind": kind, **settings}]}


# Each case: scenario, its overrides, path and value of a setting that has no effect, and the reason in the remark.
INACTIVE_CASES = [
    ("hover", with_sensor("gnss"), "laboratory.sensors.0.drift_time", 3.0, "position_drift is [0, 0, 0]"),
    ("hover", with_sensor("gyroscope"), "laboratory.sensors.0.vibration", {"unbalance": [0.0] * 4}, "are zero"),
    ("hover", with_sensor("barometer"), "laboratory.sensors.0.ground_effect_length", 0.7, "ground_effect is 0"),
    ("hover", with_sensor("uwb_range"), "laboratory.sensors.0.outlier_size", 0.7, "outlier_rate is 0"),
    (
        "hover",
        with_sensor("gyroscope", fault={"kind": "failed"}),
        "laboratory.sensors.0.fault.time",
        300.0,
        "before 300 s",
    ),
    ("hover", {}, "laboratory.wind", [GUST], "the vehicle has no drag: vehicle.linear_drag, vehicle.quadratic_drag"),
    ("hover", WITH_DRAG, "laboratory.wind", [ZERO_GUST], "laboratory.wind.0.velocity is [0, 0, 0]"),
    ("hover", WITH_DRAG, "laboratory.wind", [GUST | {"start": 1.5}], "the flight ends at 0.50 s, before 1.5 s"),
    ("hover", WITH_DRAG, "laboratory.wind", [{"kind": "dryden", "intensity": 0.0}],
     "laboratory.wind.0.intensity is 0"),
    ("hover", {}, "vehicle.body_drag", {"centre_of_pressure": [0.1, 0.0, 0.0]}, "vehicle.body_drag.linear and"),
    ("hover", {}, "vehicle.trim_force", {"x": 0.0, "y": 0.0, "z": 0.0}, "vehicle.trim_force.x and"),
    ("hover", {}, "vehicle.rotor_failure", {"rotor": 2, "time": 3.0}, "the flight ends at 0.50 s, before 3 s"),
    ("hover", {"vehicle.rotor_inertia": 0.0}, "vehicle.reaction_torque", True, "vehicle.rotor_inertia is 0"),
    ("hover", {}, "laboratory.motion_capture.drift_time", 3.0, "laboratory.motion_capture.velocity_drift is [0, 0, 0]"),
    ("hover", {"control.position": ZERO_K_I_PID}, "control.position.integral_limit", 0.1,
     "control.position.k_i is [0, 0, 0]"),
    ("hover", {"control.attitude": GEOMETRIC}, "control.attitude.integral_limit", 0.1, "control.attitude.k_i is not"),
    ("hover", {"control.position": INDI_POSITION}, "control.position.response.feed_forward_lag", [0.3, 0.1, 0.2],
     "control.position.feed_forward is none"),
    ("hover", {}, "control.network", FIXED_NETWORK,
     "control.network.learning.rate and control.network.learning.initial_weight"),
    ("hover", {"control.network": FEEDBACK_NETWORK}, "control.network.learning.slope", 2.0,
     "control.network.learning.signal is feedback"),
    ("hover", {"control.network": FEEDBACK_NETWORK}, "control.network.lead", 0.1,
     "control.network.inputs has none of x, y, z"),
    ("figure_eight", {"route.heading": "along_path"}, "route.yaw", 0.5, "route.heading is along_path"),
    ("figure_eight", {}, "metrics.end", 100.0, "the flight ends at 0.50 s, before 100 s"),
    ("hover", {}, "requirements", {"near": {"always": {"signal": "position_error", "below": 0.1}, "after": 2.0}},
     "the flight ends at 0.50 s, before 2 s"),
    ("hover", {"crash.position_error": 0.2}, "crash.height", 0.3, "crash.position_error ends a flight 0.2 m"),
    ("figure_eight", {"space": {}}, "space.margin", 0.3, "space.obstacles is empty"),
    ("onboard", {"laboratory.autopilot.rate_terms": ZERO_K_I}, "laboratory.autopilot.rate_terms.integral_limit",
     [0.1, 0.2, 0.3], "laboratory.autopilot.rate_terms.k_i is [0, 0, 0]"),
    ("onboard", {"laboratory.autopilot.rate_terms": ZERO_K_I}, "laboratory.autopilot.rate_terms.derivative_bandwidth",
     [9.0, 9.0, 9.0], "laboratory.autopilot.rate_terms.k_d is not given"),
    ("onboard", {}, "laboratory.autopilot.neglected_drag", {"tilt_per_speed": 0.0, "time": 1.0},
     "laboratory.autopilot.neglected_drag.tilt_per_speed is 0"),
    (("onboard", "controllers/lqg:lqg_onboard"), {}, "control.max_snap", 30.0, "laboratory.autopilot.kind is attitude"),
    ("neural_fly:wind_8", {"metrics.start": 0.0}, "laboratory.allocation.priority", "thrust",
     "laboratory.autopilot.kind is response"),
    ("neural_fly:wind_8", {"metrics.start": 0.0}, "vehicle.inertia", [0.04, 0.05, 0.06],
     "laboratory.autopilot.kind is response"),
    (("figure_eight", "controllers/raptor:raptor_plus"), {}, "control.thrust_vectoring", {"max_tilt": 0.3},
     "control.action.kind is rotor_speeds"),
]  # fmt: skip


def loaded(base, overrides):
    spec, *layers = (base,) if isinstance(base, str) else base
    return load_scenario(spec, {"duration": 0.5, **overrides}, layers=layers)


def remarks_on_inactive(scenario):
    return [remark for remark in flight_remarks(scenario) if "no effect" in remark]


@pytest.mark.parametrize(
    ("base", "overrides", "path", "value", "reason"), INACTIVE_CASES, ids=lambda each: str(each)[:40]
)
def test_the_remark_on_an_inactive_setting_gives_the_reason(base, overrides, path, value, reason):
    earlier_remarks = remarks_on_inactive(loaded(base, overrides))
    (remark,) = [
        each for each in remarks_on_inactive(loaded(base, {**overrides, path: value})) if each not in earlier_remarks
    ]
    assert remark.startswith(path)
    assert " no effect, since " in remark
    assert reason in remark


@pytest.mark.long
@pytest.mark.parametrize(
    ("base", "overrides", "path", "value", "reason"), INACTIVE_CASES, ids=lambda each: str(each)[:40]
)
def test_removing_an_inactive_setting_does_not_change_the_flight(base, overrides, path, value, reason):
    without, flown = (simulate(loaded(base, each)) for each in (overrides, {**overrides, path: value}))
    for name in ("state", "measurement", "rotor_speed"):
        np.testing.assert_allclose(flown[name], without[name], rtol=0.0, atol=1e-12)


def test_there_is_no_remark_on_settings_with_an_effect():
    acting = {
        "laboratory.wind": [GUST, {"kind": "dryden", "intensity": {"uniform": {"min": 0.0, "max": 1.0}}}],
        "control.position": ZERO_K_I_PID | {"k_i": [0.0, 0.0, 0.1], "integral_limit": 1.0},
        "laboratory.motion_capture": {"velocity_drift": [0.0, 0.1, 0.0], "drift_time": 3.0},
        "crash.height": 0.3,
    }
    assert remarks_on_inactive(loaded("hover", {**acting, **WITH_DRAG})) == []


def test_an_inactive_wind_causes_no_remarks_on_its_fields():
    (remark,) = remarks_on_inactive(loaded("hover", {"laboratory.wind": [GUST | {"speed": None, "start": 9.0}] * 2}))
    assert remark.startswith("laboratory.wind has no effect")


def test_settings_with_the_same_reason_share_a_remark():
    terms = {**ZERO_K_I_PID, "integral_limit": 1.0, "integration": "backward_euler"}
    assert remarks_on_inactive(loaded("hover", {"control.position": terms})) == [
        "control.position.integral_limit, control.position.integration have no effect, since control.position.k_i is"
        " [0, 0, 0]"
    ]


def test_remarks_on_a_scenario_with_a_random_route_do_not_require_a_plan():
    overrides = {"route.position.0": {"uniform": {"min": 0.0, "max": 1.0}}, "laboratory.wind": [GUST], **WITH_DRAG}
    assert flight_remarks(loaded("hover", overrides)) == ()


def test_a_user_s_kind_can_declare_which_fields_another_field_needs():
    class UserKind(Model):
        rate: Number = 0.0
        limit: Annotated[Number, needs("rate")] = 1.0
        law: Literal["sign", "slope"] = "sign"
        slope: Annotated[Number, needs("law", value="slope")] = 1.0

    def reasons(**fields):
        return [tuple(each) for each in UserKind(**fields).inactive_settings(None, "control")]

    assert reasons() == reasons(rate=1.0, limit=2.0, law="slope", slope=3.0) == []
    assert reasons(limit=2.0) == [("control.limit", "control.rate is 0")]
    assert reasons(slope=2.0) == [("control.slope", "control.law is sign")]


def test_the_strength_fields_of_every_kind_are_existing_fields():
    members = [member for union in UNIONS for member in union.members.values()]
    declared = [(member, name) for member in members for name in member.strength_fields]
    assert declared
    assert all(name in member.model_fields for member, name in declared)
    assert not can_have_effect(load_scenario("hover", {"laboratory.wind": [ZERO_GUST]}).laboratory.wind)


# Planning the whole route through the forest takes several seconds, so the tests fly a part of it.
SHORT_ROUTES = {"forest": ["route.waypoints=[[-1, -2.7, 1.2], [1, -1.9, 1.4]]"]}
SCENARIOS_WITH_REMARKS = {"bad_day:crazyflie_onboard", "bad_day:neural_fly"}


@pytest.mark.long
@pytest.mark.parametrize("spec", [each for each in shipped_scenarios() if "/" not in each])
def test_only_two_shipped_scenarios_cause_remarks_on_inactive_settings(spec):
    assert bool(remarks_on_inactive(load_scenario(spec, SHORT_ROUTES.get(spec, [])))) == (
        spec in SCENARIOS_WITH_REMARKS
    )
