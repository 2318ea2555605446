"""Tests of files of identified vehicles: values, distributions, comments, and use in scenarios and studies."""

import itertools
import os
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy
from joint_normals import joint_normal

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.results import vehicle_file
from drake_quad.identification.results.estimates import Estimates, ExplainedVariance, Source, scenario_path
from drake_quad.identification.results.vehicle_file import nominal_estimates, write_vehicle
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.distributions import Normal
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.paths import distributions_in

# Values and standard deviations, similar to those from flights of a Crazyflie.
CRAZYFLIE_ESTIMATES = {
    "mass": (0.03345, 2e-4),
    "inertia[0]": (1.7e-5, 1.5e-6),
    "inertia[1]": (1.6e-5, 1.2e-6),
    "rotor_time_constant": (0.072, 0.002),
    "motors.curve[0]": (0.0227, 0.002),
    "motors.curve[1]": (0.0019, 0.007),
    "motors.curve[2]": (0.1284, 0.006),
    "body_drag.linear[0]": (0.0102, 0.004),
    "body_drag.linear[1]": (-0.001, 0.004),
    "thrust_factor_error[2]": (0.012, 0.01),
    "centre_of_mass[0]": (-4e-4, 1e-4),
    "laboratory.motion_capture.position_noise": (0.0011, 1e-4),
    "laboratory.command_link.delay_ticks": (1.2, 0.1),
}
SOURCE = Source("multiple shooting", "hover_1.bin")
CRAZYFLIE = "diagrams/vehicles/crazyflie_onboard.yaml"
DELAY_TICKS = "laboratory.command_link.delay_ticks"
PARAMETER_WITH_NEGATIVE_ESTIMATE = "body_drag.linear[1]"  # its value in `CRAZYFLIE_ESTIMATES` is negative


def correlated(count):
    """Return random correlations. Those of the thrust curve are strong, as after a fit around hover."""
    shape = np.random.default_rng(4).normal(size=(count, count + 8))
    shape[5] = 0.05 * shape[5] - shape[6]
    covariance = shape @ shape.T
    deviation = np.sqrt(np.diag(covariance))
    return covariance / np.outer(deviation, deviation)


def estimates_of(values_and_deviations, **options):
    values, deviations = np.array([*values_and_deviations.values()]).T
    covariance = correlated(13)[: len(values_and_deviations), : len(values_and_deviations)] * np.outer(
        deviations, deviations
    )
    return Estimates(
        tuple(values_and_deviations), values, covariance, **{"degrees_of_freedom": 40.0, "sources": SOURCE, **options}
    )


@pytest.fixture(scope="module")
def estimates():
    return estimates_of(
        CRAZYFLIE_ESTIMATES,
        explained_variance={"mass": ExplainedVariance(0.43, "acceleration along z")},
        not_identified={"inertia[2]": "the vehicle never turned about its vertical axis"},
    )


@pytest.fixture(scope="module")
def base(root):
    return root / CRAZYFLIE


@pytest.fixture(scope="module")
def written(estimates, base, tmp_path_factory):
    return write_vehicle(tmp_path_factory.mktemp("own") / "folder" / "my_drone.yaml", "my-drone", estimates, base=base)


@pytest.fixture(scope="module")
def nominal(estimates, base, tmp_path_factory):
    """Return a vehicle whose nominal parameters are also the estimates."""
    path = tmp_path_factory.mktemp("nominal") / "my_drone.yaml"
    return load_undesigned(write_vehicle(path, "my-drone", estimates, base=base, nominal=True))


@pytest.fixture(scope="module")
def vehicle(written):
    return load_undesigned(written)


def text_of(path):
    """Return the text of a file without line breaks in comments."""
    return re.sub(r"\n *# ", " ", path.read_text(encoding="utf-8"))


def test_values_and_covariance_are_read_back(estimates, vehicle):
    """The normal distributions have the half-widths of Student's intervals."""
    joint = joint_normal(distributions_in(vehicle))
    drawn = [name for name in estimates.names if name != DELAY_TICKS]
    assert set(joint.paths) == {scenario_path(name) for name in drawn}
    part = estimates.subset(drawn)
    order = [joint.paths.index(scenario_path(name)) for name in drawn]
    wider = scipy.stats.t.ppf(0.975, 40.0) / scipy.stats.norm.ppf(0.975)
    scale = wider**2 * np.outer(part.deviations, part.deviations)
    # A negative drag is written as zero, and all other parameters as their estimates.
    values = np.where(np.array(drawn) == PARAMETER_WITH_NEGATIVE_ESTIMATE, 0.0, part.values)
    np.testing.assert_allclose((joint.mean[order] - values) / part.deviations, 0.0, atol=1e-5)
    result = joint.covariance[np.ix_(order, order)] / scale
    np.testing.assert_allclose(np.diag(result), 1.0, rtol=2e-5)
    size, vectors = np.linalg.eigh(part.correlation)
    assert size[0] < 0.01
    np.testing.assert_allclose(np.einsum("ji,jk,ki->i", vectors, result, vectors), size, rtol=0.02)


def test_each_distribution_is_on_one_line(written):
    """Lines of comments have at most 100 characters after their indentation."""
    lines = written.read_text(encoding="utf-8").splitlines()
    shared = [line for line in lines if "shared: {" in line]
    assert max(map(len, shared)) > 150
    for line in lines:
        assert line.count("{") == line.count("}")
        assert line.count("[") == line.count("]") or line.lstrip().startswith("#")
    comments = [line.lstrip().removeprefix("# ") for line in lines if line.lstrip().startswith("#")]
    assert 80 < max(map(len, comments)) <= 100


def test_a_long_name_in_a_comment_is_not_broken(base, tmp_path):
    source = Source("prediction errors", 12 * "a_long_name_")
    result = estimates_of({"mass": CRAZYFLIE_ESTIMATES["mass"]}, sources=source)
    path = write_vehicle(tmp_path / "mine.yaml", "mine", result, base=base)
    assert path.read_text(encoding="utf-8").count(source.log) == 2


def test_a_written_distribution_and_its_comment_include_the_variation_between_stretches_of_flight(base, tmp_path):
    """The interval would be a third as wide if the variation were left out."""
    mean = Variation(np.diag([0.0, 8.0 * 1.5e-6**2]), 40.0, 8.2)
    result = estimates_of({name: CRAZYFLIE_ESTIMATES[name] for name in ("mass", "inertia[0]")}, variation=mean)
    path = write_vehicle(tmp_path / "mine.yaml", "mine", result, base=base)
    deviations = np.sqrt(np.diag(joint_normal(distributions_in(load_undesigned(path))).covariance))
    wider = scipy.stats.t.ppf(0.975, 40.0) / scipy.stats.norm.ppf(0.975)
    elsewhere = scipy.stats.t.ppf(0.975, 81.0 / (65.0 / 40.0)) / scipy.stats.norm.ppf(0.975)
    np.testing.assert_allclose(sorted(deviations), sorted([2e-4 * wider, 4.5e-6 * elsewhere]), rtol=1e-4)
    text = text_of(path)
    assert "1.70e-05 kg m² [1.39e-05, 2.01e-05] with 95 % confidence; 1.70e-05 kg m² [" in text
    assert text.count("] in another 8.2 s of flight") == 1
    assert "of a parameter and its variation among these flights. Fields that share a variable are correlated." in text
    assert text.count("correlated.") == 1


def test_the_interval_in_a_comment_is_for_another_flight_if_the_variation_between_flights_is_known(base, tmp_path):
    both = {"variation": Variation(np.array([[1e-12]]), 40.0, 8.2), "flight_variation": Variation(np.eye(1), 2.0, 9.0)}
    text = text_of(
        write_vehicle(tmp_path / "m.yaml", "m", estimates_of({"mass": CRAZYFLIE_ESTIMATES["mass"]}, **both), base=base)
    )
    assert "in another flight;" in text
    assert "in another 8.2 s" not in text


def test_an_unknown_variation_is_not_mentioned_in_the_comment(base, tmp_path):
    result = {name: CRAZYFLIE_ESTIMATES[name] for name in ("mass", "inertia[0]")}
    text = text_of(write_vehicle(tmp_path / "none.yaml", "mine", estimates_of(result), base=base))
    assert "uncertainty of a parameter. Fields" in text
    some = estimates_of(result, variation=Variation(np.array([[1e-8]]), 40.0, 8.2).with_unknown_parameters(1))
    text = text_of(write_vehicle(tmp_path / "some.yaml", "mine", some, base=base))
    assert "its variation among these flights. The variation is unknown for inertia[0]. Fields" in text


def test_drawn_samples_have_the_covariance_of_the_estimates(estimates, vehicle):
    names = ["mass", "motors.curve[0]", "motors.curve[1]", "motors.curve[2]", "centre_of_mass[0]"]
    batch = Batch.draw(vehicle, range(20_000)).varying
    part = estimates.subset(names)
    wider = (scipy.stats.t.ppf(0.975, 40.0) / scipy.stats.norm.ppf(0.975)) ** 2
    result = np.cov([batch[scenario_path(name)] for name in names]) / np.outer(part.deviations, part.deviations)
    np.testing.assert_allclose(result, wider * part.correlation, atol=0.03)
    low, high = part.intervals().T
    for name, lower, upper in zip(names, low, high, strict=True):
        drawn = batch[scenario_path(name)]
        assert np.mean((drawn > lower) & (drawn < upper)) == pytest.approx(0.95, abs=0.006)


def test_nominal_parameters_change_only_on_request(base, vehicle, nominal):
    """The controller keeps the nominal parameters with which it flew the log by default."""
    motor_fields = {"motors": vehicle.nominal.motors, "max_rotor_speed": vehicle.nominal.max_rotor_speed}
    assert vehicle.nominal == load_undesigned(base).nominal.model_copy(update=motor_fields)
    assert nominal.nominal.mass == pytest.approx(0.03345)
    assert nominal.nominal.inertia == pytest.approx((1.7e-5, 1.6e-5, 2.98e-5))
    assert nominal.nominal.motors.curve == pytest.approx((0.0227, 0.0019, 0.1284))
    assert distributions_in(nominal.nominal) == {}
    assert nominal.vehicle == vehicle.vehicle
    assert vehicle.vehicle.inertia[2] == 2.98e-5
    assert vehicle.vehicle.body_drag.linear[2] == 0.01278
    assert vehicle.laboratory.command_link.delay_ticks == 1.0
    assert vehicle.laboratory.autopilot == load_undesigned(CRAZYFLIE).laboratory.autopilot


def test_the_nominal_thrust_curve_is_written_on_request(root, tmp_path):
    """Otherwise, the nominal curve has the largest thrust of the base vehicle's motors, which take rotor speeds."""
    result = estimates_of({f"motors.curve[{i}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{i}]"] for i in range(3)})
    data_sheet = root / "diagrams" / "vehicles" / "crazyflie.yaml"
    nominal = load_undesigned(write_vehicle(tmp_path / "old.yaml", "old", result, base=data_sheet)).nominal
    full = nominal.thrust_factor * nominal.max_rotor_speed**2
    assert nominal.motors.curve == pytest.approx((0.0, 0.0, full), rel=1e-3)
    written = write_vehicle(tmp_path / "new.yaml", "new", result, base=data_sheet, nominal=True)
    vehicle = load_undesigned(written)
    assert vehicle.nominal.motors.curve == pytest.approx((0.0227, 0.0019, 0.1284))
    # A list without comments is on one line.
    assert re.search(r"^ +curve: \[0\.0227\d*, 0\.0019\d*, 0\.1284\d*\]$", written.read_text(), re.MULTILINE)


def test_a_vehicle_with_rotor_speed_motors_gets_throttle_motors_with_the_estimated_curve(root, tmp_path):
    """The log determines two of the three coefficients of the thrust curve, so the third is zero.

    The rotor speed limits become zero and a speed above that of full throttle.
    """
    result = estimates_of({"motors.curve[0]": (0.02, 0.002), "motors.curve[2]": (0.3, 0.006)})
    base = f"{root / 'diagrams' / 'laboratory.yaml'}:low_wind"
    assert load_undesigned(base).vehicle.min_rotor_speed > 0.0
    vehicle = load_undesigned(write_vehicle(tmp_path / "new.yaml", "new", result, base=base)).vehicle
    assert [each if isinstance(each, float) else each.normal.mean for each in vehicle.motors.curve] == [0.02, 0.0, 0.3]
    assert vehicle.min_rotor_speed == 0.0
    assert vehicle.thrust_factor * vehicle.max_rotor_speed**2 > 1.15 * 0.32


def test_a_thrust_curve_is_written_with_its_voltage(base, tmp_path):
    result = estimates_of({f"motors.curve[{i}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{i}]"] for i in range(3)})
    written = write_vehicle(tmp_path / "new.yml", "new", result, base=f"{base}:crazyflie_onboard", voltage=3.85)
    motors = load_undesigned(written).vehicle.motors
    assert (motors.kind, motors.voltage) == ("throttle", 3.85)
    assert motors.curve[2].normal.mean == pytest.approx(0.1284)


def test_a_falling_thrust_curve_cannot_be_nominal(base, tmp_path):
    """The autopilot could not invert the curve, so nothing is written."""
    falling = {
        **{f"motors.curve[{i}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{i}]"] for i in range(3)},
        "motors.curve[1]": (-0.1, 0.01),
    }
    with pytest.raises(InputError, match="the vehicle cannot be written: .*must increase from throttle 0 to 1"):
        write_vehicle(tmp_path / "new.yaml", "new", estimates_of(falling), base=base, nominal=True)
    assert not (tmp_path / "new.yaml").exists()


@pytest.mark.parametrize("part", ["vehicle", "nominal"])
def test_the_written_rotor_speed_limit_does_not_limit_the_thrust_curve(nominal, part):
    limited = getattr(nominal, part)
    assert limited.thrust_factor * limited.max_rotor_speed**2 > 1.15 * (0.0227 + 0.0019 + 0.1284)


def test_effects_that_contradict_an_estimate_are_switched_off(vehicle, base):
    """The single estimated time constant holds in both directions, and the estimated drag replaces all other drag."""
    assert load_undesigned(base).vehicle.rotor_time_constant_down is not None
    assert vehicle.vehicle.rotor_time_constant_down is None
    assert {"linear_drag", "quadratic_drag"} <= vehicle.vehicle.model_fields_set


def test_rotor_time_constants_of_both_directions_are_written(base, tmp_path):
    result = estimates_of({"rotor_time_constant": (0.05, 0.001), "rotor_time_constant_down": (0.08, 0.002)})
    vehicle = load_undesigned(write_vehicle(tmp_path / "lags.yaml", "lags", result, base=base)).vehicle
    assert vehicle.rotor_time_constant.normal.mean == 0.05
    assert vehicle.rotor_time_constant_down.normal.mean == 0.08


def test_the_rotor_speed_limit_of_the_base_scenario_does_not_limit_the_thrust_curve(base, tmp_path):
    base_file = tmp_path / "own.yaml"
    base_file.write_text(f"own: {{extends: {base}, vehicle: {{max_rotor_speed: 2400.0}}}}")
    result = estimates_of({f"motors.curve[{i}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{i}]"] for i in range(3)})
    vehicle = load_undesigned(write_vehicle(tmp_path / "new.yaml", "new", result, base=base_file)).vehicle
    assert vehicle.thrust_factor * vehicle.max_rotor_speed**2 > 1.15 * (0.0227 + 0.0019 + 0.1284)


def test_the_rounding_errors_of_written_values_are_small_fractions_of_their_standard_deviations(base, tmp_path):
    """Many digits are needed, since a sum of parameters may be known much better than each parameter."""
    result = estimates_of({"mass": (0.0334512345678, 2e-7), "inertia[0]": (1.712345678e-5, 1.5e-6)})
    path = write_vehicle(tmp_path / "new.yaml", "new", result, base=base)
    joint = joint_normal(distributions_in(load_undesigned(path)))
    assert np.all(np.abs(joint.mean - result.values) < 1e-5 * result.deviations)
    assert "mean: 0.033451234568\n" in path.read_text()


def test_every_value_has_a_comment_on_its_uncertainty(written):
    text = text_of(written)
    for words in (
        "0.03345 kg [0.03304, 0.03386] with 95 % confidence; explains 43 % of the variance of acceleration along z;"
        " multiple shooting, hover_1.bin\n    mass:",
        "0.0720 s [0.0679, 0.0761] with 95 % confidence; multiple shooting, hover_1.bin\n    rotor_time_constant:",
        "1.20 [0.99, 1.41] with 95 % confidence; multiple shooting, hover_1.bin; written as a whole number\n"
        "      delay_ticks: 1",
        "inertia[2] is not identified: the vehicle never turned about its vertical axis",
        "one time constant was identified for both directions\n    rotor_time_constant_down: null",
    ):
        assert words in text
    assert all(len(line) <= 120 for line in written.read_text().splitlines() if line.lstrip().startswith("#"))


def test_distributions_are_limited_to_valid_vehicles(vehicle):
    result = distributions_in(vehicle)
    assert result["vehicle.mass"].normal.min == pytest.approx(0.003345)
    assert result["vehicle.body_drag.linear.0"].normal.min == 0.0
    lag = result["vehicle.rotor_time_constant"].normal
    assert (lag.min, lag.max) == pytest.approx((0.0072, 0.072 + 6.0 * lag.standard_deviation), rel=1e-3)
    error = result["vehicle.thrust_factor_error.rotor_3"].normal
    assert error.min == pytest.approx(0.012 - 6.0 * error.standard_deviation, rel=1e-3)
    assert all(value.normal.max is None for path, value in result.items() if path == "vehicle.centre_of_mass.0")
    assert all(isinstance(value, Normal) for value in result.values())


def test_limits_contain_a_mean_that_is_known_very_well(base, tmp_path):
    """Limits have four digits. Rounding would move both limits towards the mean in this example."""
    result = {"rotor_time_constant": (0.07123412345, 1e-9), "thrust_factor_error[2]": (0.01234678912, 1e-9)}
    drawn = distributions_in(
        load_undesigned(write_vehicle(tmp_path / "sure.yaml", "sure", estimates_of(result), base=base))
    )
    for path, value in zip(("rotor_time_constant", "thrust_factor_error.rotor_3"), result.values(), strict=True):
        bell = drawn[f"vehicle.{path}"].normal
        assert bell.mean == pytest.approx(value[0], rel=1e-9)


GAINS = (
    "{attitude: null, network: null, position: {kind: pd, feed_forward: acceleration, k_p: [6.1, 6.7, 6.8],"
    " k_d: [3.5, 3.5, 3.9]}}"
)


@pytest.fixture(scope="module")
def loop(written, diagrams):
    """Return the path of a scenario file with the written vehicle in a laboratory, and with its own gains."""
    path = written.parent / "loop.yaml"
    laboratory = os.path.relpath(diagrams / "laboratory.yaml", path.parent)
    path.write_text(
        f"loop:\n  extends: [{laboratory}:low_wind, my_drone.yaml]\n  control: {GAINS}\n  duration: 1.5\n",
        encoding="utf-8",
    )
    return path


@pytest.mark.slow
def test_the_vehicle_flies_in_a_laboratory(loop):
    scenario = load_scenario(loop)
    assert scenario.vehicle.linear_drag == 0.0
    metrics = simulate(scenario, sample=3).metrics
    assert not metrics.crashed
    assert metrics.rmse < 0.4


@pytest.mark.long
def test_a_study_draws_samples_from_the_distributions_in_a_vehicle_file(loop, vehicle):
    study = run_monte_carlo(load_scenario(loop), 40, 2, num_workers=1)
    assert (study.failures, study.metrics.crashed.any()) == ({}, np.False_)
    assert set(study.parameters) == set(distributions_in(vehicle))
    # The errors of the curve's coefficients are correlated, so the thrust of hover has a small error.
    curve = np.array([study.parameters[f"vehicle.motors.curve.{i}"] for i in range(3)])
    assert np.corrcoef(curve[1:])[0, 1] < -0.95


def test_an_estimated_attitude_response_replaces_the_autopilot_of_the_base_scenario(root, tmp_path):
    """Fields that the response requires are added to the file.

    Effects that it includes, such as the reaction torque, are switched off.
    """
    result = {
        f"autopilot.{name}[{axis}]": (9.0 + axis, 0.2) for name in ("natural_frequency", "damping") for axis in range(3)
    }
    base = root / "diagrams" / "vehicles" / "crazyflie.yaml"
    path = write_vehicle(tmp_path / "answers.yaml", "answers", estimates_of(result), base=base)
    scenario = load_undesigned(path)
    assert load_undesigned(base).vehicle.reaction_torque
    assert not scenario.vehicle.reaction_torque
    assert scenario.laboratory.autopilot.kind == "response"
    assert scenario.laboratory.autopilot.damping[2].normal.mean == pytest.approx(11.0)
    assert scenario.control.attitude is None
    with pytest.raises(InputError, match=r"autopilot\.damping must also be estimated"):
        write_vehicle(tmp_path / "half.yaml", "half", estimates_of(dict([*result.items()][:3])), base=base)
    with pytest.raises(
        InputError, match=r"autopilot\.damping\[2\] must also be estimated: the base vehicle has no such parameter"
    ):
        write_vehicle(tmp_path / "half.yaml", "half", estimates_of(dict([*result.items()][:5])), base=base)


def test_an_attitude_response_replaces_the_attitude_controller_of_a_laboratory(root, tmp_path):
    """Only the acceleration of the reference can be fed forward to an attitude response."""
    result = {f"autopilot.{name}[{i}]": (9.0, 0.2) for name in ("natural_frequency", "damping") for i in range(3)}
    vehicle_file = tmp_path / "own.yaml"
    write_vehicle(vehicle_file, "own", estimates_of(result), base=root / "diagrams" / "vehicles" / "crazyflie.yaml")
    laboratory = f"{root / 'diagrams' / 'laboratory.yaml'}:low_wind"
    gains = [root / "diagrams" / "gains" / "laboratory.yaml"]
    control = load_scenario(laboratory, layers=gains).control
    assert control.attitude is not None
    assert control.position.feed_forward == "snap"
    with_response = load_scenario(laboratory, layers=[*gains, vehicle_file]).control
    assert with_response.attitude is None
    assert with_response.position == control.position.model_copy(update={"feed_forward": "acceleration"})


def test_the_autopilot_of_the_base_scenario_is_kept_if_no_attitude_response_is_estimated(root, tmp_path):
    base = root / "diagrams" / "vehicles" / "crazyflie.yaml"
    path = write_vehicle(tmp_path / "new.yaml", "new", estimates_of({"mass": (0.03345, 2e-4)}), base=base)
    assert load_undesigned(path).laboratory.autopilot == load_undesigned(base).laboratory.autopilot


def test_the_damping_of_the_base_scenario_is_kept_if_only_the_natural_frequency_is_estimated(root, tmp_path):
    base = f"{root / 'diagrams' / 'vehicles' / 'neural_fly.yaml'}:neural_fly"
    result = {f"autopilot.natural_frequency[{i}]": (9.0 + i, 0.2) for i in range(3)}
    path = write_vehicle(tmp_path / "new.yaml", "new", estimates_of(result), base=base)
    autopilot = load_undesigned(path).laboratory.autopilot
    assert [each.normal.mean for each in autopilot.natural_frequency] == [9.0, 10.0, 11.0]
    assert autopilot.damping == load_undesigned(base).laboratory.autopilot.damping


def test_distributions_of_the_initial_vehicle_are_kept(base, tmp_path):
    """The distributions of list items that were not estimated are kept."""
    base_file = tmp_path / "own.yaml"
    base_file.write_text(
        f"own: {{extends: {base}, vehicle: {{inertia: [1.7e-5, 1.7e-5, {{uniform: {{min: 2e-5, max: 4e-5}}}}]}}}}"
    )
    result = estimates_of({"inertia[1]": (1.6e-5, 1e-6)})
    scenario = load_undesigned(write_vehicle(tmp_path / "new.yaml", "new", result, base=base_file))
    drawn = distributions_in(scenario)
    assert set(drawn) == {"vehicle.inertia.1", "vehicle.inertia.2"}
    assert tuple(drawn["vehicle.inertia.2"].extremes()) == (2e-5, 4e-5)
    assert "shared" not in (tmp_path / "new.yaml").read_text()


def test_an_impossible_inertia_is_written_as_the_nearest_possible_one_with_a_remark(base, tmp_path):
    """The estimates of I_xx and I_yy are too small for I_zz of the base vehicle, by more than rounding errors."""
    actual = {"inertia[0]": (1.3e-5, 1e-6), "inertia[1]": (1.2e-5, 1e-6)}
    path = write_vehicle(tmp_path / "new.yaml", "new", estimates_of(actual), base=base, nominal=True)
    excess = 2.98e-5 - 2.5e-5
    expected = [1.3e-5 + excess / 3, 1.2e-5 + excess / 3, 2.98e-5 - excess / 3]
    vehicle = load_undesigned(path)
    np.testing.assert_allclose(vehicle.nominal.inertia, expected, rtol=1e-4)
    written = [each.normal.mean if isinstance(each, Normal) else each for each in vehicle.vehicle.inertia]
    np.testing.assert_allclose(written, expected, rtol=1e-4)
    assert "nearest rigid body: in the estimate, I_zz, 2.98e-05, is larger than I_xx + I_yy" in text_of(path)
    moments = np.array([Batch.draw(vehicle, [i]).vehicle_scenario(0).vehicle.inertia for i in range(20)])
    assert (2.0 * moments.max(axis=1) <= (1.0 + 1e-5) * moments.sum(axis=1)).all()


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ({"mass": (-0.1, 1.0)}, {}, "the estimate of mass, -0.1 kg, must be larger than 0"),
        ({"arm_length": (0.04, 0.001)}, {}, "the vehicle cannot be written: {path}:"),
        ({"mass": (0.03, 0.1)}, {"name": "my drone"}, "a vehicle cannot be called 'my drone'"),
        ({"mass": (0.03, 0.1)}, {"path": "drone.txt"}, "must end in .yaml or .yml"),
        ({"mass": (0.03, 0.1)}, {"base": "nowhere.yaml"}, "nowhere.yaml"),
        (
            {"motors.curve[0]": (0.03, 0.1)},
            {},
            "motors.curve[2] must also be estimated: the base vehicle has no such parameter",
        ),
    ],
)
def test_an_error_leaves_no_file(base, tmp_path, values, options, message):
    path = tmp_path / options.get("path", "drone.yaml")
    with pytest.raises(InputError) as caught:
        write_vehicle(path, options.get("name", "drone"), estimates_of(values), base=options.get("base", base))
    assert message.format(path=path) in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_vehicle_needs_at_least_one_estimate(estimates, base, tmp_path):
    with pytest.raises(InputError, match="at least one estimate"):
        write_vehicle(tmp_path / "none.yaml", "none", estimates.subset([]), base=base)


def test_comments_have_the_indentation_of_their_fields(written):
    """Each mapping or list adds two columns of indentation; an item follows its dash after one space."""
    lines = written.read_text().splitlines()
    inside = lines[next(i for i, line in enumerate(lines) if not line.startswith("#")) :]
    first_characters = set()
    for line, following in itertools.pairwise(inside):
        text = line.lstrip()
        if text.startswith("#"):
            assert len(line) - len(text) == len(following) - len(following.lstrip())
            first_characters.add(following.lstrip()[0] if following.lstrip()[0] in "#-" else "key")
        assert (len(line) - len(text)) % 2 == 0
        assert not text.startswith("-  ")
    assert first_characters >= {"key", "-"}


def test_overrides_are_written_unless_they_set_an_identified_parameter():
    result = vehicle_file._Entry(0.5, "identified")
    tree = {"vehicle": {"mass": result}, "laboratory": {}, "control": {}}
    for given in (
        "vehicle.mass=0.7",
        "vehicle.gravity = 9.8",
        "laboratory.motion_capture.position_noise=0.001",
        "laboratory.motion_capture.period=0.01",
        "control.attitude.fuzzy.gain=[1, 2]",
    ):
        vehicle_file._add_override(tree, given)
    assert tree["vehicle"]["mass"] is result
    assert tree["vehicle"]["gravity"].value == 9.8
    cameras = tree["laboratory"]["motion_capture"]
    assert {name: entry.value for name, entry in cameras.items()} == {"position_noise": 0.001, "period": 0.01}
    entry = tree["control"]["attitude"]["fuzzy"]["gain"]
    assert (entry.value, entry.comment) == ([1, 2], "set by the user, not identified")
    for wrong in ("route.laps=2", "vehicle=1", "vehicle.inertia.0=1", "vehicle.thrust_factor_error.rotor_2=0.1"):
        with pytest.raises(InputError, match="cannot be written to the file of a vehicle: only fields of vehicle"):
            vehicle_file._add_override(tree, wrong)


def test_overrides_are_written_to_the_file_and_used_for_the_full_thrust_of_nominal_motors(root, tmp_path):
    given = ("vehicle.mass=0.031", "nominal.thrust_factor=3e-8", "vehicle.gravity=9.8")
    result = estimates_of({f"motors.curve[{i}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{i}]"] for i in range(3)})
    base = root / "diagrams" / "vehicles" / "crazyflie.yaml"
    path = write_vehicle(tmp_path / "given.yaml", "given", result, base=base, overrides=given)
    scenario = load_undesigned(path)
    assert (scenario.vehicle.mass, scenario.nominal.thrust_factor, scenario.vehicle.gravity) == (0.031, 3e-8, 9.8)
    assert path.read_text().count("# set by the user, not identified") == 3
    full = 3e-8 * load_undesigned(base).nominal.max_rotor_speed ** 2
    assert scenario.nominal.motors.curve == pytest.approx((0.0, 0.0, full), rel=1e-3)


@pytest.mark.parametrize(
    ("value", "written", "has_comment"),
    [(-0.3, 0.0, True), (-0.04, 0.0, False), (0.04, 0.04, False), (0.3, 0.3, False)],
)
def test_a_value_beyond_its_limit_is_written_as_the_limit_with_a_comment(value, written, has_comment):
    """A comment is written if an estimate exceeds the limit of its field by more than its standard deviation."""
    estimates = Estimates(("linear_drag",), np.array([value]), np.array([[0.05**2]]), 30.0, Source("m", "log"))
    number = vehicle_file._values(estimates, "v")["linear_drag"]
    assert number["normal"]["mean"] == written
    comment = vehicle_file._comment(estimates, "linear_drag", number)
    remark = "; the estimate is outside the range of the scenario language, so the limit of the range is written"
    assert comment.endswith(remark) == has_comment


@pytest.mark.parametrize(
    "unknown", [("inertia[0]",), ("inertia[0]", "inertia[1]"), ("rotor_inertia", "motors.curve[1]")]
)
def test_parameters_that_are_not_identified_keep_their_nominal_values(base, tmp_path, unknown):
    """All coefficients of the thrust curve are written if one of them is identified, because they are correlated."""
    sheet = load_undesigned(base)
    actual = {"inertia[0]": (1.7e-5, 1e-6), "inertia[1]": (1.8e-5, 1e-6), "rotor_inertia": (2e-8, 1e-9)}
    curve = {f"motors.curve[{index}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{index}]"] for index in range(3)}
    estimates = replace(estimates_of(actual | curve), not_identified=dict.fromkeys(unknown, "it hardly moves"))
    nominal = load_undesigned(write_vehicle(tmp_path / "new.yaml", "new", estimates, base=base, nominal=True)).nominal
    for index in range(2):
        name = f"inertia[{index}]"
        expected = sheet.nominal.inertia[index] if name in unknown else actual[name][0]
        assert nominal.inertia[index] == pytest.approx(expected)
    assert nominal.inertia[2] == sheet.nominal.inertia[2]
    expected = sheet.nominal.rotor_inertia if "rotor_inertia" in unknown else 2e-8
    assert nominal.rotor_inertia == pytest.approx(expected)
    assert nominal.motors.curve == pytest.approx((0.0227, 0.0019, 0.1284))


def test_the_thrust_curve_is_not_written_to_nominal_if_no_coefficient_is_identified(base, tmp_path):
    """Neither the curve of the data sheet nor the limits of the rotors change."""
    curve = {f"motors.curve[{index}]": CRAZYFLIE_ESTIMATES[f"motors.curve[{index}]"] for index in range(3)}
    estimates = replace(estimates_of(curve), not_identified=dict.fromkeys(curve, "it hardly moves"))
    result, plain = (
        load_undesigned(write_vehicle(tmp_path / "new.yaml", "new", estimates, base=base, nominal=nominal))
        for nominal in (True, False)
    )
    assert result == plain


def test_estimates_in_the_section_nominal_are_listed(vehicle, nominal):
    """The section `nominal` of a vehicle file has no field for any other estimate."""
    names = ["mass", "inertia.0", "inertia.1", *(f"motors.curve.{index}" for index in range(3))]
    assert sorted(nominal_estimates(nominal)) == sorted(names)
    assert nominal_estimates(vehicle) == []
