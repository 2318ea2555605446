"""Tests of the thrust, trim force and wind that are estimated for each flight, and of the prediction for a next one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario
from drake_quad.flight.simulation import simulate
from drake_quad.identification.evidence import Evidence
from drake_quad.identification.fit import fit
from drake_quad.identification.flight_differences import (
    TRIM_FORCE,
    flight_differences,
    forces_of,
    next_flight_variance,
    thrust_direction,
    with_differences,
    within_flights,
)
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.prepared_logs import block_numbers_of_windows, initial_noise, prepare
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import EstimatedValue, FlightDifference
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.results.vehicle_values import vehicle_value
from drake_quad.identification.synthetic_flights import SYNTHETIC_FLIGHTS, record_of

WINDOWS = 20  # number of windows
SAMPLES = 30  # samples in each window


def turned(heading: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotate horizontal vectors from the body axes to the world axes."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]], axis=-1)


def values_of(forces: dict[str, EstimatedValue], name: str) -> list[float]:
    return [forces[f"{name}.{axis}"].value for axis in "xy"]


def test_the_trim_force_and_the_wind_are_separated_if_the_vehicle_turns() -> None:
    trim, wind = np.array([0.3, -0.1]), np.array([-0.5, 0.2])
    heading = np.linspace(0.0, 4.0, WINDOWS * SAMPLES).reshape(WINDOWS, SAMPLES)
    result = forces_of(heading, turned(heading, trim) + wind, np.arange(WINDOWS))
    np.testing.assert_allclose(values_of(result, "trim_force"), trim)
    np.testing.assert_allclose(values_of(result, "wind_force"), wind)


@pytest.mark.parametrize("change", [0.0, 0.2])
def test_the_trim_force_at_one_heading_includes_the_wind(change: float) -> None:
    trim, wind, mean = np.array([0.3, -0.1]), np.array([-0.5, 0.2]), 0.7
    heading = mean + change * np.sin(np.arange(WINDOWS * SAMPLES)).reshape(WINDOWS, SAMPLES)
    actual = forces_of(heading, turned(heading, trim) + wind, np.arange(WINDOWS))
    assert set(actual) == {*TRIM_FORCE}
    expected = trim + turned(np.array(-mean), wind)
    np.testing.assert_allclose(values_of(actual, "trim_force"), expected, atol=0.5 * change**2)


def test_a_flight_without_a_force_has_no_trim_force_and_a_tiny_standard_deviation() -> None:
    result = forces_of(np.zeros((WINDOWS, SAMPLES)), np.zeros((WINDOWS, SAMPLES, 2)), np.arange(WINDOWS))
    assert values_of(result, "trim_force") == [0.0, 0.0]
    assert 0.0 < result["trim_force.x"].deviation < 1e-9


def test_intervals_contain_the_mean_of_a_fluctuating_force() -> None:
    """The fluctuation has a correlation time of 0.5 s, so successive samples are not independent."""
    rng, period, time, trials = np.random.default_rng(3), 0.1, 0.5, 400
    decay, held = np.exp(-period / time), 0
    blocks = np.arange(80) // 8
    heading = np.zeros((80, 5))
    for _ in range(trials):
        noise = rng.normal(size=(80 * 5 + 100, 2))
        force = 0.2 + scipy.signal.lfilter([np.sqrt(1.0 - decay**2)], [1.0, -decay], noise, axis=0)[100:]
        result = forces_of(heading, force.reshape(80, 5, 2), blocks)["trim_force.x"]
        held += abs(result.value - 0.2) < result.half_width
    assert 0.9 < held / trials < 0.98


def test_the_interval_for_the_next_flight_follows_from_the_spread_of_earlier_flights() -> None:
    """The interval follows Student's distribution with F - 1 degrees of freedom for F flights."""
    rng, trials, flights = np.random.default_rng(1), 4000, 4
    values = 2.0 + 0.5 * rng.normal(size=(trials, flights + 1))
    spreads = [[EstimatedValue(value, 0.0, "N") for value in row[:-1]] for row in values]
    deviations = np.sqrt([next_flight_variance(row) for row in spreads])
    inside = np.abs(values[:, -1] - values[:, :-1].mean(axis=1)) < scipy.stats.t.ppf(0.975, flights - 1) * deviations
    assert inside.mean() == pytest.approx(0.95, abs=0.012)
    # The variance of the estimation errors is subtracted from the variance of the flights' values.
    assert next_flight_variance([EstimatedValue(value, 0.2, "N") for value in (0.0, 0.3, 0.6)]) == pytest.approx(
        (0.09 - 0.04) * 4.0 / 3.0
    )
    assert next_flight_variance([EstimatedValue(value, 0.4, "N") for value in (0.0, 0.3, 0.6)]) == 0.0


def evidence_of(scales: np.ndarray, windows: int = 6) -> tuple[Evidence, SimpleNamespace]:
    """Return the evidence of flights that differ only in their thrust, linearised at the mean thrust."""
    rng = np.random.default_rng(0)
    names, values = ("inertia[0]", "motors.curve[1]", "motors.curve[2]"), np.array([0.01, 2.0, 3.0])
    rows = rng.normal(size=(len(scales) * windows, 8, 3))
    information = rows.swapaxes(1, 2) @ rows
    deviations = np.repeat(scales, windows)[:, None] * np.array([0.0, 2.0, 3.0])
    scores = -np.einsum("wij,wj->wi", information, deviations)
    predictor = SimpleNamespace(
        windows=[SimpleNamespace(record=flight) for flight in np.repeat(range(len(scales)), windows)]
    )
    return Evidence(names, values, np.ones(3), information, scores, 60.0), predictor


def test_flights_agree_after_correction_for_their_thrust_differences() -> None:
    scales = np.array([0.05, -0.02, -0.03])
    evidence, predictor = evidence_of(scales)
    logs = SimpleNamespace(records=[SimpleNamespace(name=name) for name in "abc"], signals={"body_rates"})
    result = flight_differences(logs, predictor, SimpleNamespace(), evidence)
    assert [each.name for each in result] == ["a", "b", "c"]
    assert [each.forces for each in result] == [{}] * 3
    np.testing.assert_allclose([each.thrust.value for each in result], scales, rtol=1e-9)
    # If the windows agree exactly, the standard deviation follows from the model.
    direction = thrust_direction(evidence.names, evidence.values)
    model = np.einsum("i,wij,j->w", direction, evidence.information, direction).reshape(3, -1).sum(axis=1)
    np.testing.assert_allclose([each.thrust.deviation for each in result], model**-0.5)
    np.testing.assert_allclose(within_flights(evidence, predictor, result).scores, 0.0, atol=1e-9)


def test_parts_of_windows_belong_to_the_flight_of_their_window() -> None:
    scales = np.array([0.05, -0.02, -0.03])
    evidence, predictor = evidence_of(scales)
    predictor.windows = predictor.windows[::2]
    logs = SimpleNamespace(records=[SimpleNamespace(name=name) for name in "abc"], signals={"body_rates"})
    result = flight_differences(logs, predictor, SimpleNamespace(), evidence)
    np.testing.assert_allclose([each.thrust.value for each in result], scales, rtol=1e-9)
    np.testing.assert_allclose(within_flights(evidence, predictor, result).scores, 0.0, atol=1e-9)


def test_the_standard_deviation_of_a_thrust_difference_follows_from_the_jackknife_over_windows() -> None:
    evidence, predictor = evidence_of(np.array([0.05, -0.05]))
    scores = evidence.scores + 20.0 * np.random.default_rng(5).normal(size=evidence.scores.shape)
    logs = SimpleNamespace(records=[SimpleNamespace(name=name) for name in "ab"], signals={"body_rates"})
    result = flight_differences(logs, predictor, SimpleNamespace(), evidence._replace(scores=scores))
    direction = np.array([0.0, 2.0, 3.0])
    for flight, each in enumerate(result):
        windows = slice(6 * flight, 6 * flight + 6)
        information, score = direction @ evidence.information[windows] @ direction, scores[windows] @ direction
        step = -score.sum() / information.sum()
        others = -(score.sum() - score) / (information.sum() - information)
        deviation = np.sqrt(5.0 / 6.0 * np.sum((others - step) ** 2))
        assert deviation > 2.0 * information.sum() ** -0.5
        assert (each.thrust.value, each.thrust.deviation) == pytest.approx((step, deviation))
        assert each.thrust.degrees_of_freedom == pytest.approx(information.sum() ** 2 / np.sum(information**2) - 1.0)
        assert each.thrust.unit == "1"


def test_a_flight_of_one_window_or_without_information_has_no_thrust_difference() -> None:
    logs = SimpleNamespace(records=[SimpleNamespace(name=name) for name in "ab"], signals={"body_rates"})
    for windows, known in ((1, False), (2, True)):
        evidence, predictor = evidence_of(np.array([0.05, -0.05]), windows)
        result = flight_differences(logs, predictor, SimpleNamespace(), evidence)
        assert [each.thrust is not None for each in result] == [known, known]
    evidence.information[:2] = 0.0
    result = flight_differences(logs, predictor, SimpleNamespace(), evidence)
    assert [each.thrust is not None for each in result] == [False, True]


WINDOW_LENGTH = 8  # samples


def logs_with_forces(counts: list[int]) -> tuple[SimpleNamespace, SimpleNamespace, SimpleNamespace, np.ndarray]:
    """Return logs, predictor and fit of flights, and the forces (W, T, 2) that the filter estimates, N.

    Each flight has several windows. As in a filter, the field `disturbance` of the gains contains the force that is
    predicted for the next sample. It consists of a decaying and a constant part.
    """
    random, mass = np.random.default_rng(8), 0.7
    num_windows, settle, period = sum(counts), 3, 0.02
    windows = [(flight, 5 + WINDOW_LENGTH * i) for flight, count in enumerate(counts) for i in range(count)]
    predictor = SimpleNamespace(
        windows=[SimpleNamespace(record=flight, start=start) for flight, start in windows],
        sizes=SimpleNamespace(length=WINDOW_LENGTH),
        rows=np.arange(6, 20),
        period=period,
        evaluated=np.arange(settle + WINDOW_LENGTH) >= settle,
        duration=2.0 * num_windows,
    )
    decaying, constant = random.normal(size=(2, settle + WINDOW_LENGTH, 2, num_windows))
    memory = np.array([0.05, 0.3, 9.0, 9.0, 9.0, 9.0])
    disturbance = random.normal(size=(settle + WINDOW_LENGTH, 14, num_windows))
    # State components 12 to 19 are the disturbance: force along x, y, z, torque about x, y, z, constant force along x,
    # y.
    disturbance[:, 6:8] = decaying * np.exp(-period / memory[:2])[:, None]
    disturbance[:, 12:] = constant
    fitted = SimpleNamespace(
        noise=SimpleNamespace(correlation_time=memory), gains=SimpleNamespace(disturbance=disturbance)
    )
    attitudes = [random.normal(size=(5 + WINDOW_LENGTH * count, 3)) for count in counts]
    records = [
        SimpleNamespace(name="abc"[flight], attitude=attitude, of={"attitude": attitude}.__getitem__)
        for flight, attitude in enumerate(attitudes)
    ]
    scenario = SimpleNamespace(vehicle=SimpleNamespace(mass=mass))
    logs = SimpleNamespace(records=records, signals={"position", "attitude"}, scenario=scenario)
    return logs, predictor, fitted, mass * (decaying + constant)[settle:].transpose(2, 0, 1)


def test_forces_of_a_flight_follow_from_the_filter_in_its_windows() -> None:
    """Two windows of two seconds form a block. The short flight has shorter blocks, since it needs at least five."""
    counts = [24, 8]
    logs, predictor, fitted, force = logs_with_forces(counts)
    evidence, _ = evidence_of(np.array([0.0, 0.0]), 16)
    result = flight_differences(logs, predictor, fitted, evidence)
    for flight, first in ((0, 0), (1, 24)):
        count = counts[flight]
        heading = logs.records[flight].attitude[5:, 2].reshape(count, WINDOW_LENGTH)
        expected = forces_of(heading, force[first : first + count], block_numbers_of_windows(count, 2.0 * count, 5))
        for name, spread in expected.items():
            actual = result[flight].forces[name]
            assert (actual.value, actual.deviation) == pytest.approx((spread.value, spread.deviation))
            assert actual.degrees_of_freedom == pytest.approx(spread.degrees_of_freedom)
        assert {*result[flight].forces} == {*TRIM_FORCE, "wind_force.x", "wind_force.y"}


def test_trim_forces_require_positions_and_attitudes_in_all_logs() -> None:
    logs, predictor, fitted, _ = logs_with_forces([2, 2])
    evidence, _ = evidence_of(np.array([0.0, 0.0]), 2)
    assert all(each.forces for each in flight_differences(logs, predictor, fitted, evidence))
    logs.signals = {"attitude"}
    assert not any(each.forces for each in flight_differences(logs, predictor, fitted, evidence))
    logs.signals = {"position"}
    logs.records[1].attitude = None
    assert not any(each.forces for each in flight_differences(logs, predictor, fitted, evidence))


def test_a_single_flight_or_a_model_without_thrust_parameters_has_no_thrust_difference() -> None:
    evidence, predictor = evidence_of(np.array([0.0]))
    logs = SimpleNamespace(records=[SimpleNamespace(name="a")], signals={"body_rates"})
    (result,) = flight_differences(logs, predictor, SimpleNamespace(), evidence)
    assert result.thrust is None
    assert within_flights(evidence, predictor, [result]).scores is not None
    evidence, predictor = evidence_of(np.array([0.05, -0.05]))
    logs.records.append(SimpleNamespace(name="b"))
    evidence = evidence._replace(names=("inertia[0]", "inertia[1]", "inertia[2]"))
    assert not thrust_direction(evidence.names, evidence.values).any()
    result = flight_differences(logs, predictor, SimpleNamespace(), evidence)
    assert [each.thrust for each in result] == [None, None]
    np.testing.assert_array_equal(within_flights(evidence, predictor, result).scores, evidence.scores)


def estimates() -> Estimates:
    return Estimates(
        ("linear_drag", "motors.curve[1]", "motors.curve[2]"),
        np.array([0.1, 2.0, 3.0]),
        np.diag([1e-4, 4e-4, 9e-4]),
        30.0,
        Source("prediction errors", "a, b, c"),
    )


def differences(thrusts: list[float], trims: list[float] | None) -> list[FlightDifference]:
    """Return differences of flights with the given thrusts and trim forces along x."""
    result = []
    for i, thrust in enumerate(thrusts):
        forces = (
            {}
            if trims is None
            else {name: EstimatedValue(value, 0.03, "N", 8.0) for name, value in zip(TRIM_FORCE, (trims[i], 0.2))}
        )
        result.append(FlightDifference("abcd"[i], EstimatedValue(thrust, 0.0, "1", 8.0), forces))
    return result


def test_the_distribution_for_the_next_flight_has_the_spread_of_the_flights() -> None:
    scenario = load_scenario("hover", ["vehicle.trim_force={x: 0.5}"])
    thrusts, trims = [0.04, -0.01, -0.03], [0.1, 0.3, -0.4]
    actual = with_differences(estimates(), differences(thrusts, trims), scenario, 20.0)
    assert actual.names[3:] == TRIM_FORCE
    np.testing.assert_allclose(actual.values[3:], [0.5 + 0.0, 0.2])
    np.testing.assert_allclose(actual.deviations[3:], 0.03 / np.sqrt(3.0))
    np.testing.assert_allclose(np.asarray(actual.degrees_of_freedom)[3:], 24.0)
    assert actual.sources_of(4) == (Source("mean force that the model does not explain", "a, b, c"),)
    variation = actual.flight_variation
    assert (variation.degrees_of_freedom, variation.duration) == (2.0, 20.0)
    thrust = 4.0 / 3.0 * np.var(thrusts, ddof=1)
    expected = np.zeros((5, 5))
    expected[1:3, 1:3] = thrust * np.outer([2.0, 3.0], [2.0, 3.0])
    expected[3, 3] = 4.0 / 3.0 * (np.var(trims, ddof=1) - 0.03**2)
    np.testing.assert_allclose(variation.covariance, expected, atol=1e-15)
    # The variance for the next flight includes the variance between flights. Three flights give two degrees of freedom.
    new = actual.for_new_flight()
    assert new.deviations[3] == pytest.approx(np.sqrt(3e-4 + expected[3, 3]))
    assert new.degrees_of_freedom[3] == pytest.approx(2.0, rel=0.01)
    assert new.flight_variation is None
    np.testing.assert_allclose(new.covariance[0, 0], 1e-4)


def test_variation_between_flights_is_estimated_from_at_least_three_flights() -> None:
    base, scenario = estimates(), load_scenario("hover")
    assert with_differences(base, differences([0.1, -0.1], [0.1, -0.1]), scenario, 20.0) is base
    result = with_differences(base, differences([0.1, 0.0, -0.1], None), scenario, 20.0)
    assert result.names == base.names
    assert result.flight_variation.covariance[1, 2] == pytest.approx(0.01 * 4.0 / 3.0 * 6.0)


def test_a_trim_force_is_estimated_only_if_all_flights_have_forces() -> None:
    scenario = load_scenario("hover")
    turning = Estimates(
        ("inertia[0]",), np.array([0.01]), np.array([[1e-8]]), 30.0, Source("prediction errors", "a, b, c")
    )
    flights = [each._replace(thrust=None) for each in differences([0.0] * 3, [0.1, 0.3, -0.4])]
    result = with_differences(turning, flights, scenario, 20.0)
    assert result.names == ("inertia[0]", *TRIM_FORCE)
    assert result.flight_variation.covariance[0, 0] == 0.0
    assert result.flight_variation.covariance[1, 1] > 0.0
    flights[1] = flights[1]._replace(forces={})
    assert with_differences(turning, flights, scenario, 20.0).names == ("inertia[0]",)


def test_the_variance_of_the_mean_trim_force_is_the_mean_variance_of_all_flights_over_their_number() -> None:
    """The degrees of freedom follow Satterthwaite's formula."""
    varying = replace(estimates(), variation=Variation(np.diag([1e-4, 0.0, 0.0]), 9.0, 8.0))
    deviations, freedoms = np.array([0.03, 0.1, 0.02, 0.05]), np.array([8.0, 4.0, 12.0, 20.0])
    trims = zip([0.1, 0.3, -0.4, 0.2], deviations, freedoms)
    flights = differences([0.0] * 4, [0.0] * 4)
    flights = [
        each._replace(forces={**each.forces, "trim_force.x": EstimatedValue(value, deviation, "N", freedom)})
        for each, (value, deviation, freedom) in zip(flights, trims, strict=True)
    ]
    actual = with_differences(varying, flights, load_scenario("hover"), 20.0)
    assert actual.value("trim_force.x") == pytest.approx(0.05)
    assert actual.deviations[3] == pytest.approx(np.sqrt(np.sum(deviations**2)) / 4.0)
    expected = np.sum(deviations**2) ** 2 / np.sum(deviations**4 / freedoms)
    assert actual.degrees_of_freedom[3] == pytest.approx(expected)
    assert actual.degrees_of_freedom[4] == pytest.approx(32.0)
    np.testing.assert_array_equal(actual.correlation[3:], np.eye(5)[3:])
    np.testing.assert_array_equal(np.isfinite(np.diag(actual.variation.covariance)), [True] * 3 + [False] * 2)


@pytest.mark.long
def test_changes_of_a_vehicle_between_its_flights_are_estimated(root) -> None:
    """Attitude noise of 4 mrad limits the accuracy of the trim force to 0.3 % of the weight."""
    known = SYNTHETIC_FLIGHTS["calm"]
    inertia_overrides = ["vehicle.inertia=[0.007, 0.007, 0.012]", "vehicle.centre_of_mass=[0, 0]"]
    common_overrides = [
        *inertia_overrides,
        "vehicle.rotor_time_constant=0.05",
        "vehicle.linear_drag=0.1",
        "vehicle.thrust_factor=4e-5",
    ]
    true_values = [(0.97, 0.05, 0.0), (1.0, -0.05, 0.03), (1.03, 0.0, -0.03)]
    records = []
    for scale, x, y in true_values:
        overrides = [f"vehicle.thrust_factor={4e-5 * scale}", f"vehicle.trim_force={{x: {x}, y: {y}}}"]
        flight = simulate(
            known.simulated_scenario(root / "diagrams", [*common_overrides, *overrides, "duration=16"]), compiled=True
        )
        records.append(record_of(flight))
    scenario = known.simulated_scenario(root / "diagrams", common_overrides)
    logs, _ = prepare(records, scenario)
    predictor = logs.predictor(("thrust_factor",), logs.flying)
    start = vehicle_value(scenario, "thrust_factor")
    fitted = fit(predictor, [Parameter("thrust_factor", start, start)], initial_noise(logs.outputs))
    evidence = fitted.evidence(("thrust_factor",), (start,), predictor.duration)
    result = flight_differences(logs, predictor, fitted, evidence)
    weight = scenario.vehicle.mass * scenario.vehicle.gravity
    for each, (scale, *trim) in zip(result, true_values, strict=True):
        assert (1.0 + each.thrust.value) * fitted.values[0] == pytest.approx(4e-5 * scale, rel=0.01)
        for name, force in zip(TRIM_FORCE, trim, strict=True):
            assert each.forces[name].value == pytest.approx(force, abs=0.003 * weight)
