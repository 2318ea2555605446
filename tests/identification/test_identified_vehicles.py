"""Tests that vehicles are identified from simulated flights, and published vehicles from real flights."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
from neural_fly_flight import DIAGRAM, guessed, write_flight

from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate, simulate_samples
from drake_quad.identification.delays import total_delay
from drake_quad.identification.identify import identify
from drake_quad.identification.model import DELAY, LogModel
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.result import Identification
from drake_quad.identification.results.vehicle_values import vehicle_value
from drake_quad.identification.synthetic_flights import SYNTHETIC_FLIGHTS, record_of
from drake_quad.identification.windows import WindowSizes, split_into_windows
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.models import Scenario

# Delay from a logged command to the logged pose that follows from it, s. A logged pose is 10 ms old, which adds to the
# delay. A logged command is that of the preceding control period, 20 ms earlier, which reduces the delay.
DELAY_IN_LABORATORY = 0.01 - 0.02


def simulated_log(kind: str, diagrams: Path, *overrides: str) -> tuple[FlightRecord, Scenario, Scenario]:
    """Return the log of a simulated flight, its scenario, and the initial scenario of the identification."""
    known = SYNTHETIC_FLIGHTS[kind]
    (flight,) = simulate_samples(known.simulated_scenario(diagrams, overrides), [1], compiled=True)
    return record_of(flight, known.samples_per_row), flight.scenario, known.initial_scenario(diagrams)


def true_value(scenario: Scenario, name: str) -> float:
    """Return the true value of a parameter; for the thrust factor, the average of all rotors and of the flight."""
    value = vehicle_value(scenario, name)
    if name != "thrust_factor":
        return value
    # The speed of the rotors falls at a constant rate during a flight, and the thrust is proportional to its square.
    sag = scenario.vehicle.battery_sag
    return value * (1.0 + np.mean(scenario.vehicle.thrust_factor_error)) * (1.0 - sag + sag**2 / 3.0)


def identified_own_flight(name: str, sample: int, folder: Path) -> tuple[Identification, Scenario]:
    """Return the identification of at most 6 s of a flight from its saved flight.csv, and the flight's scenario."""
    scenario = load_scenario(name)
    duration = min(flight_duration(scenario, plan_route(scenario)), 6.0)
    flight = simulate(scenario.model_copy(update={"duration": duration}), sample=sample, compiled=True)
    flight.save(folder)
    result = identify([read_log(folder / "flight.csv")], flight.scenario, held_out_fraction=0.0)
    return result, flight.scenario


def outside(identification: Identification, true: Scenario) -> dict[str, tuple[float, float]]:
    """Return the parameters whose interval does not contain the true value, each with its error and half-width."""
    estimates = identification.estimates
    rows = zip(estimates.names, estimates.values, estimates.quantiles() * estimates.deviations, strict=True)
    errors = {
        name: (value - true_value(true, name), half_width)
        for name, value, half_width in rows
        if name in estimates.identified
    }
    return {name: (error, half_width) for name, (error, half_width) in errors.items() if abs(error) > half_width}


@pytest.mark.long
def test_prediction_errors_of_the_right_vehicle_are_white(diagrams: Path) -> None:
    """The errors have unit variance and no autocorrelation.

    The flight is in calm air, and the predictor has the true parameters, delay and noise.
    """
    record, scenario, _ = simulated_log("calm", diagrams, "duration=16", "laboratory.command_link.loss_rate=0")
    sizes = WindowSizes(length=100, settle=50, warm_up=25)
    windows = split_into_windows([record], [record.time > 1.0], sizes)
    outputs = [Output(signal, column) for signal in ("position", "attitude") for column in range(3)]
    predictor = Predictor(LogModel(scenario, [DELAY]), [record], windows, sizes, outputs, split=2)
    noise = PredictionNoise(np.repeat([1e-3, 4e-3], 3), np.full(6, 1e-3), np.full(6, 0.1))
    gains = predictor.gains(np.array([DELAY_IN_LABORATORY]), noise)
    errors = gains.errors[predictor.evaluated]
    white = (gains.whitening[predictor.evaluated] @ errors.transpose(0, 2, 1)[..., None])[..., 0]
    count = white[..., 0].size
    np.testing.assert_allclose(np.mean(white**2, axis=(0, 1)), 1.0, atol=5.0 * np.sqrt(2.0 / count))
    for lag in (1, 2, 5):
        correlation = np.mean(white[lag:] * white[:-lag], axis=(0, 1))
        np.testing.assert_allclose(correlation, 0.0, atol=5.0 / np.sqrt(count))
    wrong = predictor.gains(np.array([0.01]), noise).errors[predictor.evaluated]
    assert np.mean(wrong**2) > 2.0 * np.mean(errors**2)


@pytest.mark.long
@pytest.mark.parametrize(("kind", "seconds"), [("calm", 9), ("autopilot", 11)])
def test_a_simulated_vehicle_is_identified(diagrams: Path, kind: str, seconds: int) -> None:
    """At most two of about fifteen 95 % intervals do not contain the true value.

    Intervals of twice the width all do.
    """
    record, scenario, initial = simulated_log(kind, diagrams, f"duration={seconds}")
    result = identify([record], initial, held_out_fraction=0.0)
    assert len(result.estimates.identified) >= 10
    missed = outside(result, scenario)
    assert len(missed) <= 2, missed
    assert all(abs(error) < 2.0 * half_width for error, half_width in missed.values()), missed
    assert result.delay is not None
    true = total_delay(scenario) if kind == "autopilot" else DELAY_IN_LABORATORY
    assert abs(result.delay.value - true) < 1.5 * result.delay.half_width


@pytest.mark.long
def test_a_thrust_curve_is_identified_for_the_voltage_of_the_full_battery(diagrams: Path) -> None:
    """The thrust at the voltage in flight is smaller by at least 1.4 %."""
    record, scenario, initial = simulated_log("battery", diagrams, "duration=9")
    result = identify([record], initial, held_out_fraction=0.0).vehicle.vehicle.motors
    assert result.voltage == 12.6
    assert np.all((record.of("battery_voltage")[100:] / 12.6) ** 2 < 0.986)
    throttle = np.median(record.of("motor_command"))
    thrust, true = (np.polyval(motors.curve[::-1], throttle) for motors in (result, scenario.vehicle.motors))
    assert thrust == pytest.approx(true, rel=0.003)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "hover",
        "figure_eight",
        "crazyswarm2:sheet_100",
        "crazyswarm2:log145",
        "outdoor_gnss",
        "warehouse_uwb",
    ],
)
def test_the_flight_of_a_shipped_scenario_is_identified(name: str, tmp_path: Path) -> None:
    """The log is the saved flight.csv. All intervals contain the true values."""
    result, scenario = identified_own_flight(name, 0, tmp_path)
    assert not outside(result, scenario)


@pytest.mark.long
@pytest.mark.parametrize("name", ["robustness", "slalom", "nanobench"])
def test_the_flight_of_a_random_vehicle_is_identified(name: str, tmp_path: Path) -> None:
    """Each of about ten 95 % intervals contains the true value, or at most one fails by less than its half-width."""
    result, scenario = identified_own_flight(name, 1, tmp_path)
    failures = [abs(error / half_width) for error, half_width in outside(result, scenario).values()]
    assert len(failures) <= 1
    assert max(failures, default=0.0) < 2.0


@pytest.mark.long
@pytest.mark.parametrize(
    "motors", [[], [f"{part}.motors={{kind: throttle, curve: [0.0, 1.0, 3.4]}}" for part in ("nominal", "vehicle")]]
)
def test_the_voltage_of_a_simulated_battery_is_read_from_its_log(motors: list[str], tmp_path: Path) -> None:
    """The battery loses a tenth of its voltage during the flight, and the rotors a fifth of their thrust."""
    battery = "{voltage: 12.6, empty_voltage: 10.5, capacity: 0.018, resistance: 0.02, efficiency: 0.6}"
    overrides = [*motors, f"vehicle.battery={battery}", "duration=8"]
    flight = simulate(load_scenario("laboratory:low_wind", overrides), compiled=True)
    flight.save(tmp_path)
    voltage = flight.record("battery").voltage
    assert voltage[-1] < 0.93 * voltage[0]
    result = identify([read_log(tmp_path / "flight.csv")], flight.scenario, held_out_fraction=0.0)
    thrust = [name for name in result.estimates.names if name.startswith(("thrust_factor", "motors.curve"))]
    assert thrust
    assert not {*thrust} & {*outside(result, flight.scenario)}


@pytest.mark.long
def test_heights_are_sufficient_to_identify_thrust(diagrams: Path) -> None:
    """The vehicle climbs and descends, and the log has neither attitudes nor velocities."""
    route = (
        "route={kind: waypoints, top_speed: null, top_acceleration: null, times: [0, 1, 2, 3, 4.2, 5, 6.5, 7.5, 9],"
        " waypoints: [[0,0,1],[0,0,1.6],[0,0,1.2],[0,0,2],[0,0,1.1],[0,0,1.5],[0,0,0.9],[0,0,1.8],[0,0,1]]}"
    )
    overrides = ["vehicle.thrust_factor=3.9e-5", "vehicle.linear_drag=0", "vehicle.quadratic_drag=0"]
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal", [route, *overrides])
    (flight,) = simulate_samples(scenario, [0], compiled=True)
    record = record_of(flight)
    heights = replace(record, attitude=None, velocity=None, body_rates=None)
    result = identify([heights], load_scenario(diagrams / "laboratory.yaml:nominal"), held_out_fraction=0.0)
    assert result.estimates.value("thrust_factor") == pytest.approx(3.9e-5, rel=0.01)
    assert not outside(result, scenario)
    assert "inertia[0]" not in result.estimates.names


@pytest.mark.long
def test_a_residual_force_determines_drag(tmp_path: Path) -> None:
    """A log in Neural-Fly's format determines the thrust curve, and drag along x, the direction of flight."""
    overrides = ["laboratory.command_link.loss_rate=0", "laboratory.motion_capture.misalignment=[0.0, 0.02, 0.0]"]
    scenario = load_scenario(f"{DIAGRAM}:still", [*overrides, "duration=10", "metrics.start=0"])
    result = identify([read_log(write_flight(tmp_path / "still.csv", scenario))], guessed(), held_out_fraction=0.0)
    missed = outside(result, scenario)
    assert len(missed) <= 2, missed
    assert "body_drag.linear[0]" in result.estimates.identified
    assert result.estimates.value("motors.curve[1]") == pytest.approx(18.27, rel=0.05)
    assert "autopilot.damping[2]" in result.estimates.not_identified


@pytest.mark.long
def test_a_log_of_hover_gives_no_thrust_curve(root: Path) -> None:
    """The throttles of the shipped PX4 log vary by a few per cent, which determines at most one coefficient."""
    base = load_scenario("hover", ["nominal.mass=2.0"], layers=["vehicles/hummingbird"])
    record = read_log(root / "tests" / "data" / "px4" / "sample_px4_events.ulg.xz")
    result = identify([record], base, held_out_fraction=0.0).estimates
    assert not any(name.startswith(("motors.curve", "inertia", "rotor_time")) for name in result.identified)
    curve = [result.value(f"motors.curve[{power}]") for power in range(3)]
    thrust = np.polyval(curve[::-1], np.linspace(0.0, 1.0, 50))
    assert np.all(thrust >= 0.0)
    assert np.all(np.diff(thrust) >= 0.0)


def crazyflie() -> Scenario:
    """Return the vehicle before its identification: weighed mass, geometry, and parameters of the data sheet."""
    return load_scenario(
        "diagrams/hover.yaml",
        [
            "nominal.mass=0.027",
            "nominal.layout={kind: x, length: 0.056, width: 0.056, rotor_1_turns: anticlockwise}",
            "nominal.motors={kind: throttle, curve: [0.0, 0.0, 0.14]}",
            "nominal.min_rotor_speed=0",
            "nominal.max_rotor_speed=5000",
            "vehicle.motors={kind: throttle, curve: [0.0, 0.0, 0.14]}",
            "vehicle.body_drag={linear: [0.0147, 0.0147, 0.0128], centre_of_pressure: [0, 0, 0.005]}",
            "vehicle.rotor_time_constant=0.06",
            "vehicle.rotor_time_constant_down=0.07",
        ],
        layers=["diagrams/vehicles/crazyflie.yaml"],
    )


@pytest.mark.long
def test_identified_crazyflie_parameters_agree_with_published_values() -> None:
    """Lag, inertia about x and y, and thrust curve agree with arXiv 2404.07837, which used the same logs."""
    logs = sorted(Path("tests/data/crazyflie/arpl").glob("log*"))[:2]
    estimates = identify([read_log(path) for path in logs], crazyflie(), held_out_fraction=0.0).estimates
    lag = 0.5 * (estimates.value("rotor_time_constant") + estimates.value("rotor_time_constant_down"))
    assert lag == pytest.approx(0.072, abs=0.007)
    assert estimates.value("inertia[0]") == pytest.approx(1.029e-5, rel=0.2)
    assert estimates.value("inertia[1]") == pytest.approx(1.105e-5, rel=0.2)
    indices = [estimates.names.index(f"motors.curve[{i}]") for i in range(3)]
    for_new_flight = estimates.for_new_flight()
    covariance = for_new_flight.covariance[np.ix_(indices, indices)]
    quantile = scipy.stats.t.ppf(0.975, np.asarray(for_new_flight.degrees_of_freedom)[indices].min())
    for throttle in (0.3, 0.4, 0.5, 0.6, 0.7, 0.85):
        powers = throttle ** np.arange(3.0)
        published, value = powers @ [0.0227, -0.0119, 0.1284], powers @ estimates.values[indices]
        assert abs(value - published) < quantile * np.sqrt(powers @ covariance @ powers), throttle
