"""Tests of layered scenarios: a vehicle, control or route replaces another one completely."""

import itertools

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.flight.remarks import flight_remarks, unequal_conditions
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.shipped import shipped_scenarios
from drake_quad.scenario.paths import distributions_in

VEHICLE_FILES = [name for name in shipped_scenarios() if name.startswith("vehicles/") and ":" not in name]
VEHICLE_FILES += ["vehicles/neural_fly:neural_fly"]
LABORATORY_SCENARIOS = ["laboratory:nominal", "laboratory:high_wind", "robustness", "outdoor", "onboard"]
X500_SCENARIO = """
x500:
  nominal:
    layout: {kind: x, length: 0.348, width: 0.348}
    mass: 2.0
    inertia: [0.0217, 0.0217, 0.040]
    thrust_factor: 8.54858e-6
    drag_factor: 1.368e-7
    rotor_inertia: 4.0e-5
    min_rotor_speed: 150.0
    max_rotor_speed: 1000.0
  vehicle:
    rotor_time_constant: 0.0125
    rotor_time_constant_down: 0.025
    body_drag: {linear: [0.35, 0.35, 0.2]}
"""


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a scenario with a list of layers, from a file with further scenarios."""

    def loader(*layers, own_fields="", other_scenarios="", overrides=(), undesigned=False):
        path = tmp_path / "mixed.yaml"
        path.write_text(f"{other_scenarios}\nmixed:\n  extends: [{', '.join(layers)}]\n{own_fields}")
        return (load_undesigned if undesigned else load_scenario)(f"{path}:mixed", overrides)

    return loader


def airframe(scenario):
    """Return the vehicle fields that describe the airframe, without those that describe the flight."""
    vehicle = scenario.vehicle.model_dump(exclude={"time_step", "attitude_kinematics"})
    return scenario.nominal.model_dump(), vehicle


@pytest.mark.parametrize(("first", "second"), [*itertools.permutations(VEHICLE_FILES, 2)])
def test_a_vehicle_layer_replaces_the_vehicle_of_lower_layers_completely(load, first, second):
    assert airframe(load(first, second, undesigned=True)) == airframe(load(second, undesigned=True))


@pytest.mark.parametrize("laboratory", LABORATORY_SCENARIOS)
@pytest.mark.parametrize("vehicle", VEHICLE_FILES)
def test_a_laboratory_describes_no_airframe(load, laboratory, vehicle):
    vehicle_only = load(vehicle, undesigned=True)
    for layers in ((laboratory, vehicle), (vehicle, laboratory)):
        mixed = load(*layers, undesigned=True)
        assert mixed.nominal == vehicle_only.nominal
        random_paths = {path for path in distributions_in(mixed) if path.startswith("vehicle.")}
        assert bool(random_paths) == (laboratory == "robustness")
        assert all(" no effect, since " in remark for remark in flight_remarks(mixed))


@pytest.mark.parametrize("vehicle", VEHICLE_FILES)
def test_the_order_of_the_layers_robustness_and_vehicle_does_not_matter(load, vehicle):
    vehicle_first, robustness_first = (
        load(vehicle, "robustness", undesigned=True),
        load("robustness", vehicle, undesigned=True),
    )
    assert vehicle_first.vehicle.model_dump() == robustness_first.vehicle.model_dump()
    assert vehicle_first.nominal == robustness_first.nominal


def test_relative_distributions_scale_with_the_vehicle(load):
    paper, scaled = load_scenario("robustness"), load("x500", "robustness", other_scenarios=X500_SCENARIO)
    fractions = np.linspace(0.01, 0.99, 9)
    arm = 0.5 * 0.348 * np.sqrt(2.0)
    for field_of, ratio in (
        (lambda vehicle: vehicle.mass, 2.0 / 0.68),
        (lambda vehicle: vehicle.inertia[0], 0.0217 / 0.007),
        (lambda vehicle: vehicle.inertia[2], 0.040 / 0.012),
        (lambda vehicle: vehicle.rotor_time_constant, 0.0125 / 0.05),
        (lambda vehicle: vehicle.centre_of_mass[1], arm / 0.17),
        (lambda vehicle: vehicle.thrust_factor_error[3], 1.0),
        (lambda vehicle: vehicle.battery_sag, 1.0),
    ):
        expected = ratio * field_of(paper.vehicle).quantile(fractions)
        np.testing.assert_allclose(field_of(scaled.vehicle).quantile(fractions), expected, rtol=1e-12, atol=1e-18)
    assert tuple(scaled.vehicle.rotor_time_constant_down.extremes()) == pytest.approx((0.015, 0.04))
    assert tuple(scaled.vehicle.body_drag.linear[2].extremes()) == pytest.approx((0.16, 0.24))


def test_relative_distributions_in_robustness_yaml_apply_unchanged_to_the_paper_s_vehicle():
    vehicle = load_scenario("robustness").vehicle
    assert (vehicle.mass.normal.mean, vehicle.mass.normal.standard_deviation) == (0.68, 0.01)
    assert (vehicle.mass.normal.min, vehicle.mass.normal.max) == (0.64, 0.72)
    assert vehicle.inertia[2].normal.standard_deviation == 0.0006
    assert vehicle.centre_of_mass[0].normal.standard_deviation == 0.001
    assert tuple(vehicle.linear_drag.extremes()) == (0.1, 0.3)
    assert tuple(vehicle.rotor_time_constant.extremes()) == (0.03, 0.08)


def test_effects_that_a_vehicle_lacks_have_no_distribution(load):
    racer = load("vehicles/racer", "robustness", undesigned=True).vehicle
    assert racer.rotor_aerodynamics is None
    assert racer.rotor_time_constant_down is None
    assert load("vehicles/paper_with_drag", "robustness", undesigned=True).vehicle.body_drag is None
    assert (racer.linear_drag, racer.quadratic_drag) == (0.0, 0.0)


def test_a_relative_choice_scales_each_of_its_values(load):
    field = "vehicle.mass={relative: {choice: [0.5, 1.0, 4.0], to: 2.0}}"
    assert load_scenario("figure_eight", field).vehicle.mass.choice == pytest.approx((0.17, 0.34, 1.36), rel=1e-12)


def test_a_relative_distribution_over_another_distribution_is_relative_to_its_median(load):
    own_fields = "  vehicle: {mass: {relative: {normal: {mean: 1.0, standard_deviation: 0.1, min: 0.5}}}}\n"
    measured = "{normal: {mean: 0.8, standard_deviation: 0.01, min: 0.7}}"
    other_scenarios = f"measured: {{extends: figure_eight, vehicle: {{mass: {measured}}}}}\n"
    mass = load("measured", own_fields=own_fields, other_scenarios=other_scenarios).vehicle.mass.normal
    assert (mass.mean, mass.standard_deviation) == pytest.approx((0.8, 0.08), rel=1e-9)


RELATIVE_UNIFORM = "{relative: {uniform: {min: 0.9, max: 1.1}}}"


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        (f"inertia=[0.0075, 0.007, {RELATIVE_UNIFORM}]", ((0.0075,) * 2, (0.007,) * 2, (0.0108, 0.0132))),
        (f"inertia.2={RELATIVE_UNIFORM}", ((0.007,) * 2, (0.007,) * 2, (0.0108, 0.0132))),
        (f"centre_of_mass=[{RELATIVE_UNIFORM}, 0.01]", ((0.153, 0.187), (0.01,) * 2)),
        (f"centre_of_mass.1={RELATIVE_UNIFORM}", ((0.0, 0.0), (0.153, 0.187))),
        (f"thrust_factor_error=[0, {RELATIVE_UNIFORM.replace('0.9', '0.1').replace('1.1', '0.2')}, 0, 0.05]", None),
        (f"thrust_factor_error.rotor_2={RELATIVE_UNIFORM.replace('0.9', '0.1').replace('1.1', '0.2')}", None),
    ],
)
def test_a_single_item_of_a_list_can_be_a_relative_distribution(field, expected):
    vehicle = load_scenario("figure_eight", [f"vehicle.{field}"]).vehicle
    items = getattr(vehicle, field.partition("=")[0].partition(".")[0])
    if expected is None:
        expected = (0.0, 0.0), (0.1, 0.2), (0.0, 0.0), (items[3],) * 2
    for item, limits in zip(items, expected, strict=True):
        extremes = (item, item) if isinstance(item, float) else tuple(item.extremes())
        assert extremes == pytest.approx(limits)


def test_only_list_items_with_relative_distributions_apply_to_another_vehicle(load):
    spread = f"spread: {{extends: figure_eight, vehicle: {{inertia: [0.007, 0.007, {RELATIVE_UNIFORM}]}}}}\n"
    i_xx, i_yy, i_zz = load("spread", "x500", other_scenarios=X500_SCENARIO + spread).vehicle.inertia
    assert (i_xx, i_yy) == (0.0217, 0.0217)
    assert tuple(i_zz.extremes()) == pytest.approx((0.036, 0.044))


@pytest.mark.parametrize(("field", "count"), [("thrust_factor_error", 4), ("centre_of_mass", 2)])
def test_a_vehicle_layer_keeps_only_the_relative_distributions_of_lower_layers(load, field, count):
    """The items without a relative distribution become 0. Neither field has a nominal value."""
    items = [RELATIVE_UNIFORM, *["0.01"] * (count - 1)]
    spread = f"spread: {{extends: figure_eight, vehicle: {{{field}: [{', '.join(items)}]}}}}\n"
    _, *other_items = getattr(load("spread", "x500", other_scenarios=X500_SCENARIO + spread).vehicle, field)
    assert other_items == [0.0] * (count - 1)


@pytest.mark.parametrize(
    ("field", "path"),
    [
        (f"slung_load={{mass: {RELATIVE_UNIFORM}, length: 1}}", "slung_load.mass"),
        (f"rotor_failure={{rotor: {RELATIVE_UNIFORM}, time: 5}}", "rotor_failure.rotor"),
        (f"layout={{kind: x, length: {RELATIVE_UNIFORM}, width: 0.3}}", "layout.length"),
        (f"payload={{mass: 0.1, position: [0, 0, {RELATIVE_UNIFORM}], time: 1, event: dropped}}", "payload.position.2"),
        (f"body_drag={{linear: [0.1, {RELATIVE_UNIFORM}, 0.1]}}", "body_drag.linear.1"),
    ],
)
def test_a_relative_distribution_of_a_required_field_needs_a_base_value(field, path):
    with pytest.raises(InputError, match=rf"vehicle\.{path} is relative, but the vehicle has no value to which"):
        load_scenario("figure_eight", [f"vehicle.{field}"])


def test_a_number_replaces_a_relative_distribution_of_a_lower_layer(load):
    assert load("robustness", own_fields="  vehicle: {mass: 0.7}\n").vehicle.mass == 0.7
    assert load_scenario("robustness", ["vehicle.mass=0.7"]).vehicle.mass == 0.7


def test_gravity_and_integration_settings_remain_when_the_vehicle_is_replaced(load):
    other_scenarios = X500_SCENARIO + (
        "flight: {extends: onboard, vehicle: {payload: {mass: 0.1, position: [0, 0, -0.1], time: 2.0, event: dropped}},"
        " nominal: {gravity: 3.7}}\n"
    )
    mixed = load("flight", "x500", other_scenarios=other_scenarios)
    assert mixed.vehicle.time_step == 0.0025
    assert mixed.vehicle.payload.mass == 0.1
    assert mixed.nominal.gravity == 3.7
    assert mixed.vehicle.linear_drag == 0.0


def test_the_kind_of_an_autopilot_in_a_lower_layer_must_be_a_name(load):
    other_scenarios = f"{X500_SCENARIO}\nlisted:\n  laboratory: {{autopilot: {{kind: [attitude]}}}}\n"
    with pytest.raises(InputError, match=r"laboratory.autopilot.kind is .*, but must be one of"):
        load("hover", "listed", "x500", other_scenarios=other_scenarios)


def test_an_identified_response_is_replaced_together_with_its_vehicle(load):
    assert (
        load(
            "vehicles/crazyflie_onboard", "x500", other_scenarios=X500_SCENARIO, undesigned=True
        ).laboratory.autopilot.kind
        == "none"
    )
    assert load("onboard", "x500", other_scenarios=X500_SCENARIO).laboratory.autopilot.kind == "attitude"


def test_a_layer_with_few_vehicle_fields_modifies_the_vehicle_of_lower_layers(load):
    mixed = load("vehicles/racer", "laboratory:low_wind", own_fields="  vehicle: {mass: 0.8}\n", undesigned=True)
    assert (mixed.nominal.mass, mixed.vehicle.mass, mixed.vehicle.rotor_time_constant) == (0.75, 0.8, 0.033)


def test_the_default_vehicle_is_used_if_no_layer_describes_a_vehicle(load):
    assert load("laboratory:nominal").vehicle.linear_drag == 0.1
    assert load("laboratory:nominal", own_fields="  nominal: {mass: 0.7}\n").nominal.mass == 0.7
    assert load("figure_eight").vehicle.linear_drag == 0.0


@pytest.mark.parametrize(
    "missing",
    [
        *(
            ["thrust_factor"],
            ["drag_factor"],
            ["rotor_inertia"],
            ["min_rotor_speed"],
            ["layout"],
            ["inertia"],
            ["mass"],
        ),
        ["mass", "inertia"],
        ["thrust_factor", "drag_factor", "rotor_inertia", "min_rotor_speed", "max_rotor_speed"],
    ],
)
def test_an_incomplete_vehicle_is_refused(load, missing):
    """A `nominal` with mass and inertia, or with most fields, describes another vehicle, which requires all fields."""
    lines = [line for line in X500_SCENARIO.splitlines() if line.split(":")[0].strip() not in missing]
    with pytest.raises(InputError, match=rf"nominal describes a vehicle, but without .*{missing[0]}"):
        load("x500", "robustness", other_scenarios="\n".join(lines) + "\n")


CONTROLLER_LAYERS = [
    "gains/laboratory",
    "controllers/paper:pd",
    "controllers/designed/laboratory:indi_fast",
    "controllers/lqg:lqg",
]


@pytest.mark.parametrize("controller", CONTROLLER_LAYERS)
def test_a_control_with_a_kind_replaces_the_control_of_lower_layers_completely(load, controller):
    controller_only = load("figure_eight", controller).control
    for base in ("robustness", "controllers/paper:pd_t2fnn", "controllers/mpc:mpc"):
        assert load("figure_eight", base, controller).control == controller_only


def test_a_control_without_a_kind_modifies_the_control_of_lower_layers(load):
    mixed = load("robustness", own_fields="  control: {position: {k_p: [1.0, 1.0, 6.0]}}\n")
    assert mixed.control.position.k_p == (1.0, 1.0, 6.0)
    assert mixed.control.network is not None


def test_duration_and_metrics_window_are_replaced_together_with_the_route(load):
    assert load_scenario("vehicles/neural_fly:still").metrics.start > 0.0
    other_scenarios = "longer: {extends: vehicles/neural_fly:still, duration: 70}\n"
    mixed = load("longer", own_fields="  route: {kind: hover}\n", other_scenarios=other_scenarios)
    assert (mixed.metrics.start, mixed.duration) == (0.0, None)
    same_route = load("longer", own_fields="  route: {laps: 9}\n", other_scenarios=other_scenarios)
    assert (same_route.metrics.start, same_route.duration) == (
        load_scenario("vehicles/neural_fly:still").metrics.start,
        70.0,
    )


def test_initial_state_and_requirements_are_replaced_together_with_the_route(load):
    mixed, upset, other = load("upset", "figure_eight"), load_scenario("upset"), load_scenario("figure_eight")
    assert upset.initial != other.initial
    assert upset.requirements
    assert mixed.initial == other.initial
    assert mixed.requirements == {}
    assert load("upset").requirements == upset.requirements


def test_a_new_vehicle_has_no_drag_that_was_identified_with_another_one(load):
    """The rest of the autopilot belongs to the laboratory."""
    assert load_scenario("nanobench").laboratory.autopilot.neglected_drag is not None
    autopilot = load("nanobench", "vehicles/racer", undesigned=True).laboratory.autopilot
    expected = load_scenario("nanobench").laboratory.autopilot
    assert autopilot.neglected_drag is None
    assert autopilot.model_dump(exclude={"neglected_drag"}) == expected.model_dump(exclude={"neglected_drag"})


def test_crash_limits_of_one_laboratory_do_not_apply_in_another(load):
    assert load_scenario("outdoor").crash.position_error == 20.0
    indoor = load("outdoor", "laboratory:nominal")
    assert indoor.crash.position_error == 5.0
    assert indoor.laboratory.wind == ()


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (
            "laboratory.motion_capture.position_noise={relative: {uniform: {min: 0, max: 2}}}",
            "only fields of `vehicle`",
        ),
        ("nominal.mass={relative: {uniform: {min: 0, max: 2}}}", "only fields of `vehicle`"),
        ("vehicle.mass={relative: 3}", "must be one of the distributions uniform, log_uniform, normal"),
        ("vehicle.mass={relative: {uniform: {min: 1, max: 2}, of: 3}}", "must be one of the distributions"),
        ("vehicle.mass={relative: {to: 0, uniform: {min: 1, max: 2}}}", "relative.to is 0, but must be positive"),
        ("vehicle.mass={relative: {to: x, uniform: {min: 1, max: 2}}}", "but must be positive"),
        ("vehicle.mass={relative: {uniform: {min: 2, max: 1}}}", "must be larger than min"),
        ("vehicle.mass={relative: {uniform: {min: x, max: 1}}}", "vehicle.mass"),
        ("vehicle.rotor_aerodynamics={climb: -0.2}", ""),
    ],
)
def test_invalid_relative_distributions_are_refused(field, message):
    if not message:
        climbing = [field, "vehicle.rotor_aerodynamics.climb={relative: {uniform: {min: 0.8, max: 1.2}}}"]
        with pytest.raises(InputError, match="a negative number has no relative distribution"):
            load_scenario("figure_eight", climbing)
        return
    with pytest.raises(InputError, match=message):
        load_scenario("figure_eight", [field])


ROTOR_DIRECTIONS = ("clockwise", "anticlockwise", "clockwise", "anticlockwise")


def test_a_flight_reports_that_nominal_differs_from_its_vehicle():
    (remark,) = flight_remarks(load_scenario("figure_eight", {"nominal.mass": 2.0, "vehicle.mass": 0.68}))
    assert "mass 0.68 kg (nominal 2)" in remark
    assert "inertia" not in remark
    assert flight_remarks(load_scenario("figure_eight", {"vehicle.mass": 0.71})) == ()
    uncertain = {"vehicle.mass": {"normal": {"mean": 0.9, "standard_deviation": 0.1, "min": 0.2}}}
    assert flight_remarks(load_scenario("figure_eight", uncertain)) == ()
    uncertain["vehicle.mass"]["normal"]["standard_deviation"] = 0.03
    assert "mass 0.9 kg (nominal 0.68)" in flight_remarks(load_scenario("figure_eight", uncertain))[0]


def test_a_layout_with_rotor_distances_replaces_the_arm_length_of_lower_layers(load):
    layout = "{kind: x, length: 0.3, width: 0.2}"
    assert load("laboratory:nominal", own_fields=f"  nominal: {{layout: {layout}}}\n").nominal.layout.length == 0.3
    assert load_scenario("laboratory:nominal", [f"nominal.layout={layout}"]).vehicle.layout.width == 0.2
    with pytest.raises(InputError, match=r"arm_length is 0\.17, but must be 0\.1803"):
        load("laboratory:nominal", own_fields=f"  nominal: {{layout: {layout}, arm_length: 0.17}}\n")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vehicle.layout": {"kind": "plus", "rotor_1_turns": "anticlockwise"}}, "direction of rotor 1, 2, 3, 4;"),
        ({"vehicle.layout": {"kind": "x"}}, "rotor 1 at (0.12, -0.12) m (nominal (0.17, 0) m);"),
        ({"vehicle.gravity": 3.71}, "gravity 3.71 m/s² (nominal 9.81);"),
        ({"vehicle.drag_factor": 8.5e-6}, "drag_factor 8.5e-06 N m s² (nominal 8.5e-07);"),
        ({"vehicle.centre_of_mass": [0.0, 0.03]}, "centre_of_mass.1 0.03 m (nominal 0);"),
    ],
)
def test_every_strong_difference_between_vehicle_and_nominal_is_reported(change, words):
    (remark,) = flight_remarks(load_scenario("figure_eight", change))
    assert f"use: {words}" in remark


def test_random_sizes_and_rotor_positions_are_not_compared_with_nominal():
    """All other vehicle fields, such as the centre of mass, are compared with `nominal`."""
    corners = [(0.3, 0.0), (0.0, -0.3), (-0.3, 0.0), (0.0, 0.3)]
    rotors = [
        {"position": [x, y, 0.0], "turns": turns} for (x, y), turns in zip(corners, ROTOR_DIRECTIONS, strict=True)
    ]
    rotors[0]["position"][0] = {"uniform": {"min": 0.29, "max": 0.31}}
    random_layout = {"vehicle.layout": {"kind": "rotors", "rotors": rotors}}
    assert flight_remarks(load_scenario("figure_eight", random_layout)) == ()
    (remark,) = flight_remarks(load_scenario("figure_eight", {**random_layout, "vehicle.centre_of_mass": [-0.02, 0.0]}))
    assert "use: centre_of_mass.0 -0.02 m (nominal 0);" in remark
    uncertain = {"vehicle.arm_length": {"uniform": {"min": 0.3, "max": 0.4}}}
    assert flight_remarks(load_scenario("figure_eight", uncertain)) == ()
    (remark,) = flight_remarks(load_scenario("figure_eight", {**uncertain, "vehicle.layout": {"kind": "x"}}))
    assert "use: rotor 1 at (0.247, -0.247) m (nominal (0.17, 0) m);" in remark


@pytest.mark.parametrize(
    ("first", "third", "is_reported"),
    [
        ((0.17, 0.033), (-0.17, 0.0), False),
        ((0.17, 0.036), (-0.17, 0.0), True),
        ((0.203, 0.0), (-0.137, 0.0), False),
        ((0.205, 0.0), (-0.135, 0.0), True),
    ],
)
def test_a_rotor_displaced_by_a_fifth_of_the_arm_length_is_reported(first, third, is_reported):
    """The arm length, the mean of the smallest and the largest rotor distance, remains 0.17 m."""
    corners = [first, (0.0, -0.17), third, (0.0, 0.17)]
    rotors = [
        {"position": [x, y, 0.0], "turns": turns} for (x, y), turns in zip(corners, ROTOR_DIRECTIONS, strict=True)
    ]
    remarks = flight_remarks(load_scenario("figure_eight", {"vehicle.layout": {"kind": "rotors", "rotors": rotors}}))
    assert bool(remarks) == is_reported
    assert not is_reported or "use: rotor 1 at" in remarks[0]


def test_a_random_centre_of_mass_is_reported_if_its_mean_is_five_standard_deviations_from_zero():
    """The offset is reported if it exceeds a tenth of the arm length and five standard deviations."""
    for standard_deviation, is_reported in ((0.003, True), (0.0039, True), (0.0041, False), (0.01, False)):
        normal = {"normal": {"mean": 0.02, "standard_deviation": standard_deviation}}
        remarks = flight_remarks(load_scenario("figure_eight", {"vehicle.centre_of_mass": [normal, 0.0]}))
        assert bool(remarks) == is_reported
    assert flight_remarks(load_scenario("figure_eight", {"vehicle.centre_of_mass": [0.016, 0.0]})) == ()
    assert flight_remarks(load_scenario("figure_eight", {"vehicle.centre_of_mass": [0.018, 0.0]}))


def test_a_random_mass_is_reported_if_nominal_is_five_standard_deviations_away():
    """A mass is reported if it also differs from the nominal mass, 0.68 kg, by 5 %."""
    for mean, standard_deviation, is_reported in (
        (0.98, 0.059, True),
        (0.98, 0.061, False),
        (0.75, 0.013, True),
        (0.75, 0.015, False),
        (0.71, 0.001, False),
    ):
        normal = {"normal": {"mean": mean, "standard_deviation": standard_deviation, "min": 0.2}}
        assert bool(flight_remarks(load_scenario("figure_eight", {"vehicle.mass": normal}))) == is_reported
    for mass, is_reported in ((0.71, False), (0.72, True), (0.65, False), (0.64, True)):
        assert bool(flight_remarks(load_scenario("figure_eight", {"vehicle.mass": mass}))) == is_reported


def test_a_remark_on_the_arm_length_replaces_remarks_on_rotor_positions():
    """Rotor positions are compared relative to the arm length, which has its own remark."""
    (remark,) = flight_remarks(load_scenario("figure_eight", {"vehicle.arm_length": 0.25}))
    assert "use: arm length 0.25 m (nominal 0.17);" in remark


def test_a_comparison_reports_controllers_that_change_the_laboratory():
    """A controller may change the laboratory, which makes a comparison with other controllers unfair."""

    def low_wind(*layers, changes=()):
        return load_scenario("laboratory:low_wind", changes, layers=layers)

    pd, raptor = "controllers/designed/laboratory:pd", "controllers/raptor:raptor_plus"
    (remark,) = unequal_conditions(
        {"pd": low_wind(pd), "lqg": low_wind("controllers/designed/laboratory:lqg"), "raptor": low_wind(raptor)}
    )
    assert remark.startswith(
        "raptor and pd do not fly under the same conditions: laboratory.command_link.period 0.01 ("
    )
    assert "laboratory.command_link.delay_ticks 0 (not 1)" in remark
    assert unequal_conditions({"raptor": low_wind(raptor), "pd over it": low_wind(raptor, pd)}) == []
    heavier = {"vehicle.mass": 0.7, "laboratory.wind": []}
    (remark,) = unequal_conditions({"a": low_wind(pd), "b": low_wind(pd, changes=heavier)})
    assert "vehicle.mass 0.7 (not 0.68)" in remark
    assert "laboratory.wind.0.kind none (not " in remark
    assert (
        unequal_conditions({"a": low_wind(pd), "b": low_wind(pd, changes={"nominal.mass": 0.7, "vehicle.mass": 0.68})})
        == []
    )
