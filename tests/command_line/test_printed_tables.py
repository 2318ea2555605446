"""Tests that commands print results in the right units and write them to tables. The results are invented."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from ruamel.yaml import YAML

from drake_quad import InputError, load_scenario
from drake_quad.command_line import (
    compare,
    compare_log,
    design,
    design_lqg,
    falsify,
    fly,
    identify,
    identify_controller,
    judge,
    output,
    plan,
    replay,
    replicate,
    risk,
    sensitivities,
    study,
)
from drake_quad.command_line import map as stability_map
from drake_quad.design.gains import AxisPdGains, PidGains, ProportionalGain
from drake_quad.design.sensitivity import Sensitivities
from drake_quad.design.stability_map import MappedGains, StabilityMap
from drake_quad.files import read_table
from drake_quad.flight.mission import plan_route
from drake_quad.identification.position_law.law import AxisLaw, PositionLaw
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import EstimatedValue, ForecastOutput, Identification
from drake_quad.identification.results.estimates import Estimates, ExplainedVariance, Source
from drake_quad.identification.validation.comparison import LogComparison
from drake_quad.identification.validation.prediction import Predictions
from drake_quad.identification.validation.reference import LoggedReference
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.margins import Margins
from drake_quad.logs.record import FlightRecord, SignalOrigin
from drake_quad.planning.feasibility import plan_demand
from drake_quad.planning.nominal import planned_parameters
from drake_quad.reference.active_constraints import ActiveConstraint
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.replication.published import Cell, Runs
from drake_quad.replication.table_ii import TableEntry
from drake_quad.statistics.interval import Interval, plus_minus, spread_text
from drake_quad.statistics.replicates import INDEPENDENT
from drake_quad.studies.risk import Coordinate
from drake_quad.studies.study import Study

RNG = np.random.default_rng(8)


def cells(text):
    """Return the cells of each line of a printed table; cells are at least two spaces apart."""
    return [re.split(r" {2,}", line.strip()) for line in text.splitlines()]


def metrics_of(rmse, crashed=()):
    """Return metrics with the given RMSE; the given flights crash after 3 s. Other metrics equal their field index."""
    rmse = np.asarray(rmse, dtype=float)
    time = np.full(len(rmse), np.inf)
    time[list(crashed)] = 3.0
    return Metrics(rmse, *(np.full(len(rmse), float(i)) for i in range(1, len(Metrics._fields) - 1)), time)


def test_tables_are_aligned(capsys):
    output.print_table([("mass", "1", "kg"), ("error", "12.5", "")])
    output.print_columns(("name", "x", ""), [("a", "10", "left"), ("longer", "2", "")])
    assert capsys.readouterr().out.splitlines() == [
        "mass      1 kg",
        "error  12.5",
        "name     x",
        "a       10  left",
        "longer   2",
    ]


def test_margins_have_a_row_for_each_loop(capsys):
    margins = Margins(
        gain=7.26, gain_reduction=-8.34, phase=45.67, delay=0.1234, disk=0.8, crossover=2.345, sensitivity=1.456,
        bandwidth=3.789,
    )  # fmt: skip
    output.print_margins({"thrust": margins, "yaw": None})
    title, header, row = cells(capsys.readouterr().out)
    assert title[0].startswith("stability margins")
    assert header == ["signal", "max |S|", "delay", "phase", "gain", "gain reduction", "crossover", "bandwidth"]
    assert row == ["thrust", "1.46", "123 ms", "45.7°", "7.3 dB", "-8.3 dB", "2.35 rad/s", "3.79 rad/s"]


@pytest.mark.slow
def test_predictions_have_a_row_for_each_horizon_that_is_reached(capsys):
    """The RMS value of equal errors is the error, in cm and degrees. No prediction reaches the horizon of 1 s."""
    errors = np.empty((2, 2, 12))
    errors[0], errors[1] = 0.02, 0.04
    errors[:, 1] = np.nan
    errors_by_quantity = {"position": errors, "attitude": errors, "body_rates": errors, "velocity": errors}
    predictions = Predictions(("mine", "other"), (0.5, 1.0), np.array(["a"] * 12), np.arange(12.0), errors_by_quantity)
    output.print_predictions(predictions)
    header, *rows = cells(capsys.readouterr().out)
    assert header == ["horizon", "mine", "other", "improvement over other (%)", "unit"]
    printed = [(row[0], row[1], *(float(cell.split()[0]) for cell in row[2:5]), row[5]) for row in rows]
    degrees = math.degrees(0.02)
    assert printed == [
        ("position", "0.5 s", 2.0, 4.0, 50.0, "cm"),
        ("attitude", "0.5 s", pytest.approx(degrees, rel=1e-2), pytest.approx(2.0 * degrees, rel=1e-2), 50.0, "°"),
        ("body rates", "0.5 s", 0.02, 0.04, 50.0, "rad/s"),
    ]
    height = Predictions(("mine", "other"), (0.5, 1.0), predictions.log, predictions.time, {"height": errors})
    output.print_predictions(height)
    _, row = cells(capsys.readouterr().out)
    assert (row[0], float(row[2].split()[0]), row[-1]) == ("height", 2.0, "cm")


def test_compared_controllers_have_means_deviations_and_relative_errors(capsys, tmp_path):
    first, second = 0.1 + 0.01 * RNG.uniform(size=8), 0.05 + 0.01 * RNG.uniform(size=8)
    one, other = metrics_of(first), metrics_of(second, crashed=[2])
    alone = metrics_of([0.2])
    flights = {"calm": {"pd": one, "pid": other}, "windy": {"pd": alone}}
    compare.print_comparison(flights, dict.fromkeys(flights, INDEPENDENT))
    header, *rows = cells(capsys.readouterr().out)
    assert header == [
        "scenario", "controller", "RMSE", "peak", "effort X (m²/s⁴)", "effort Y (m²/s⁴)", "relative RMSE",
    ]  # fmt: skip
    simulated = np.delete(second, 2)
    assert [row[:3] for row in rows] == [
        ["calm", "pd", plus_minus(100.0 * first.mean(), 100.0 * first.std(ddof=1)) + " cm"],
        ["calm", "pid", plus_minus(100.0 * simulated.mean(), 100.0 * simulated.std(ddof=1)) + " cm"],
        ["windy", "pd", "20.0 cm"],
    ]
    # The peak error is 4 m, and the efforts are 5 and 6 m²/s⁴.
    assert rows[2][3:] == ["400 cm", "5.00", "6.00", "100 %"]
    assert rows[0][6:] == ["100 %"]
    pairs = np.delete(first, 2)
    assert float(rows[1][6].split()[0]) == pytest.approx(100.0 * simulated.mean() / pairs.mean(), abs=0.5)
    assert rows[1][7] == "1 crashed"
    table = read_table(compare.write_flights(tmp_path / "comparison.csv", flights))
    assert list(table) == ["scenario", "controller", "sample", *Metrics._fields]
    np.testing.assert_array_equal(table["sample"], [*range(8), *range(8), 0])
    np.testing.assert_allclose(table["rmse"], [*first, *second, 0.2])
    assert [*table["controller"]] == ["pd"] * 8 + ["pid"] * 8 + ["pd"]
    assert np.flatnonzero(np.isfinite(table["crash_time"])).tolist() == [10]


@pytest.fixture(scope="module")
def compared():
    """Return twenty predictions of a log, two of which crash.

    The logged errors along z are a tenth of those along x and y.
    """
    rng = np.random.default_rng(4)
    time = 3.0 + 0.01 * np.arange(50)
    predicted = 0.01 + 0.001 * rng.normal(size=(20, 50, 3))
    simulated = predicted[0] * [1.0, 1.0, 0.1]
    predicted[[3, 7], 30:] = np.nan
    reference = LoggedReference(SimpleNamespace(knots=(0.0, 1.0, 2.0)), 0.0, 4.0, 0.00123)
    record = FlightRecord("log7", np.arange(2.0))
    return LogComparison(record, None, reference, None, time, np.zeros((50, 3)), simulated, predicted)


def test_a_log_is_compared_in_centimetres_axis_by_axis(compared, capsys):
    compare_log.print_comparison(compared)
    first, second, header, *rows, crashes, last = capsys.readouterr().out.splitlines()
    assert first == "log7: 50 samples, from 3.00 to 3.49 s of the log"
    assert second == "reference: 2 pieces of degree 7, within 1.23 mm of the logged positions"
    assert cells(header) == [["error (cm)", "axis", "measured", "predicted median [95 %]", "measured within 95 %"]]
    rows = cells("\n".join(rows))
    assert [row[:2] for row in rows] == [
        [name, axis] for name in ("RMSE", "mean", "95th percentile") for axis in ("x", "y", "z", "all")
    ]
    figures = compared.logged_statistics
    np.testing.assert_allclose(
        [float(row[2]) for row in rows],
        100.0 * np.concatenate([figures.rmse, figures.mean, figures.largest]),
        atol=5e-3,
    )
    assert [row[4] for row in rows] == [
        "yes" if inside else "no" for name in ("rmse", "mean", "largest") for inside in compared.within(name)
    ]
    assert {row[4] for row in rows if row[1] in ("z", "all")} == {"no"}
    assert {row[4] for row in rows if row[1] in ("x", "y")} == {"yes"}
    # The predicted median on each axis is about a centimetre. The upper end of each 95 % interval is a crash, since
    # 10 % of the flights crash.
    for row in rows:
        median, high = re.fullmatch(r"(\S+) \[\S+, (\S+)\]", row[3]).groups()
        assert float(median) == pytest.approx(math.sqrt(3.0) if row[1] == "all" else 1.0, abs=0.4)
        assert high == "crash"
    assert crashes == "2 of 20 simulated flights crash"
    assert re.fullmatch(
        rf"The measured RMSE, {100.0 * figures.rmse[3]:.2f} cm, is outside the 95 % interval of 20 simulated flights,"
        r" whose median is 1\.\d+ cm \[.*\]\.",
        last,
    )
    assert "is within the 95 % interval" in compare_log.verdict(replace(compared, logged_error=compared.predicted[0]))


def test_equal_predictions_of_a_log_are_printed_without_an_interval(compared, capsys):
    equal_predictions = replace(compared, predicted=np.full((3, 50, 3), 0.02))
    compare_log.print_comparison(equal_predictions)
    lines = capsys.readouterr().out.splitlines()
    rows = cells("\n".join(lines[3:-1]))
    assert [row[3:] for row in rows[:3]] == [["2.00", "–"]] * 3
    assert lines[-1].endswith("All simulated flights have an RMSE of 3.46 cm.")


def test_the_table_of_a_compared_log_is_in_metres(compared, tmp_path, monkeypatch):
    for name in ("log_comparison_plots.plot_log_comparison", "replay.page.save_replay", "style.save_figures"):
        monkeypatch.setattr(f"drake_quad.visualization.{name}", lambda *_, **__: [])
    monkeypatch.setattr(compare_log, "flights_to_compare", lambda _: None)
    monkeypatch.setattr(compare_log, "save_scenario", lambda _, path: path.write_text("scenario"))
    files = compare_log.save_comparison(compared, tmp_path, SimpleNamespace(vector=None))
    table = read_table(files[0])
    assert list(table) == ["error", "axis", "flown (m)", "median (m)", "low (m)", "high (m)"]
    assert [*table["error"]] == [name for name in ("rmse", "mean", "largest") for _ in range(4)]
    assert [*table["axis"]] == ["x", "y", "z", "all"] * 3
    for column, name in enumerate(("rmse", "mean", "largest")):
        rows = slice(4 * column, 4 * column + 4)
        np.testing.assert_allclose(table["flown (m)"][rows], getattr(compared.logged_statistics, name), rtol=1e-5)
        for end, values in zip(("median", "low", "high"), compared.interval(name), strict=True):
            np.testing.assert_allclose(table[f"{end} (m)"][rows], values, rtol=1e-5)


def loop_of(gains, *, limits=(), cost_ratio=None):
    margins = Margins(
        gain=7.26, gain_reduction=-8.34, phase=45.67, delay=0.1234, disk=0.876, crossover=2.345, sensitivity=1.456,
        bandwidth=3.789,
    )  # fmt: skip
    return SimpleNamespace(
        gains=gains, margins=margins, plant=SimpleNamespace(period=0.02), limits=limits, cost_ratio=cost_ratio
    )


def test_a_design_has_a_row_for_each_axis_in_order(capsys):
    loops = {
        "x": loop_of(PidGains(1.23456, 2.0, 0.5), limits=("phase", "delay"), cost_ratio=1.234),
        "z": loop_of(AxisPdGains(3.0, 4.0)),
    }
    on_board = {"roll rate": loop_of(ProportionalGain(9.0))}
    design.print_design(SimpleNamespace(loops=loops, on_board=on_board, all_loops=on_board | loops))
    title, header, *rows = cells(capsys.readouterr().out)
    assert title == ["stability margins of each loop, opened at its commanded acceleration, or rate"]
    assert header == [
        "axis", "k_P or k", "k_D", "k_I", "phase", "gain", "delay", "ticks", "disk", "crossover", "bandwidth",
        "max |S|", "limited by",
    ]  # fmt: skip
    margins = ["45.7°", "7.3 dB", "123 ms", "6.2", "0.88", "2.35 rad/s", "3.79 rad/s", "1.46"]
    assert rows == [
        ["roll rate", "9", "–", "–", *margins, "as requested"],
        ["z", "3", "4", "–", *margins, "as requested"],
        ["x", "1.235", "2", "0.5", *margins, "phase, delay; cost 1.23 × the cost of full state feedback"],
    ]
    design.print_design(SimpleNamespace(loops=loops, on_board={}, all_loops=loops))
    title, header, *rows = cells(capsys.readouterr().out)
    assert title == ["stability margins of each loop, opened at its commanded acceleration"]
    assert header[1] == "k_P"
    assert [row[0] for row in rows] == ["z", "x"]


def test_modes_of_a_loop_have_a_frequency_a_damping_and_states(capsys):
    """Modes faster than 60 rad/s are left out. If a mode involves states of the vehicle, only these are listed."""

    def oscillator(frequency, damping):
        return np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]])

    slow, fast, rotors = oscillator(1.0, 0.6), oscillator(70.0, 0.5), np.array([[-25.0]])
    names = (
        "plant.vehicle.state.x", "plant.vehicle.state.v_x", "plant.vehicle.state.roll", "plant.vehicle.state.p",
        "plant.vehicle.rotor_speed.rotor_1", "laboratory.estimator.estimate.gyroscope_bias.z",
    )  # fmt: skip
    A = scipy.linalg.expm(0.01 * scipy.linalg.block_diag(slow, fast, rotors, 1e-13))
    design.print_modes(SimpleNamespace(system=SimpleNamespace(A=A, states=names, period=0.01)))
    _, title, header, drift, first, second = cells(capsys.readouterr().out)
    assert title == ["modes of the whole closed loop over a period of 0.01 s"]
    assert header == ["frequency", "damping", "time constant", "states"]
    assert drift == ["< 0.01 rad/s", "–", "> 100 s", "estimator"]
    assert first[:3] == ["1.00 rad/s", "0.60", "1.67 s"]
    assert set(first[3].split(", ")) == {"x", "v_x"}
    assert second == ["25.00 rad/s", "1.00", "0.04 s", "rotors"]


def test_each_plant_of_a_regulator_has_a_row_with_its_predicted_errors(capsys):
    answer = SimpleNamespace(natural_frequency=6.789)
    plants = [
        SimpleNamespace(lag=0.0456, response=None, latency_frames=2, delay_ticks=1),
        SimpleNamespace(lag=0.05, response=answer, latency_frames=3, delay_ticks=4),
    ]
    lateral, vertical = ([SimpleNamespace(error=error) for error in errors] for errors in ((0.01, 0.02), (0.03, 0.04)))
    design_lqg.print_plants(SimpleNamespace(plants=plants, lateral=lateral, vertical=vertical))
    _, header, *rows = cells(capsys.readouterr().out)
    assert header == [
        "rotor lag", "attitude ω_n", "camera latency (frames)", "link delay (ticks)", "x and y", "z",
    ]  # fmt: skip
    assert rows == [
        ["46 ms", "–", "2", "1", "1.00 cm", "3.00 cm"],
        ["50 ms", "6.79 rad/s", "3", "4", "2.00 cm", "4.00 cm"],
    ]


@pytest.mark.slow
def test_a_regulator_is_written_as_yaml_that_a_scenario_can_extend(tmp_path):
    control = load_scenario("laboratory:low_wind", layers=["controllers/designed/laboratory:lqg"]).control
    path = tmp_path / "lqg.yaml"
    design_lqg.write_control(SimpleNamespace(control=control), path, "drake-quad design-lqg")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# drake-quad design-lqg\nlqg:\n")
    assert YAML(typ="safe").load(text) == {"lqg": {"control": control.model_dump(mode="json", exclude_none=True)}}
    # Blocks that contain only numbers are written on one line.
    assert re.search(r"first: \{deviation: ", text)
    assert load_scenario("laboratory:low_wind", layers=[f"{path}:lqg"]).control == control


def test_the_metrics_of_a_flight_are_in_their_units():
    numbers = dict(zip(Metrics._fields, (0.1 * (i + 1) for i in range(len(Metrics._fields))), strict=True))
    flight = SimpleNamespace(
        metrics=Metrics(**(numbers | {"effort_z": math.nan})),
        crash="",
        time=np.array([0.0, 4.0]),
    )
    rows = fly.summary(flight)
    assert rows[0] == ("flight time", "4.00", "s")
    expected = [
        ("RMSE", "rmse"),
        *((f"RMSE on {axis}", f"rmse_{axis.lower()}") for axis in "XYZ"),
        ("peak error", "peak_error"),
    ]
    assert rows[1:6] == [(words, f"{100.0 * numbers[name]:.2f}", "cm") for words, name in expected]
    assert rows[6:9] == [
        ("control effort on X", f"{numbers['effort_x']:.4f}", "m²/s⁴"),
        ("control effort on Y", f"{numbers['effort_y']:.4f}", "m²/s⁴"),
        ("control effort on Z", "–", "m²/s⁴"),
    ]
    assert rows[9] == ("ticks with saturated rotors", f"{100.0 * numbers['saturated_fraction']:.1f}", "%")
    flight.crash = "crashed at 1.20 s"
    assert fly.summary(flight)[0] == ("flight time", "crashed at 1.20", "s")


def identified():
    """Return an identification of three parameters. The first varies between flights; the last explains no variance."""
    estimates = Estimates(
        ("mass", "autopilot.damping[0]", "linear_drag"),
        np.array([0.5, 0.7, 0.1]),
        np.diag([0.0004, 0.0025, 0.0001]),
        1e9,
        Source("m", "a"),
        explained_variance={
            "mass": ExplainedVariance(0.123, "climb"),
            "autopilot.damping[0]": ExplainedVariance(4e-4, "roll"),
        },
        not_identified={"quadratic_drag": "it hovers"},
        variation=Variation(np.diag([0.0016, np.nan, np.nan]), 4.0, 10.0),
    )
    time = np.arange(4)[:, None] + np.linspace(0.0, 1.0, 5)
    measured = np.zeros_like(time)
    predicted = np.full_like(time, 0.25)
    output = ForecastOutput("height", "m", time, measured, predicted, 0.9, 0.125)
    none = output._replace(name="pitch", unit="rad", explained_variance=-0.1)
    return Identification(
        estimates, None, (output, none), EstimatedValue(0.0321, 0.001, "s"), None, ("of the flights",),
        {"mass": SimpleNamespace(num_covered=9, errors=np.zeros(10))},
    )  # fmt: skip


def test_estimates_are_printed_with_intervals_and_explained_variance(capsys):
    identify.print_estimates(identified())
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert cells(lines[1]) == [["parameter", "value", "unit", "new flight", "within", "explained variance"]]
    mass, damping, drag = cells("\n".join(lines[2:5]))
    # The standard deviation of the mean is 0.02 kg. For a new flight, it is √(0.02² + 0.04²) kg. The second variance
    # has 4 degrees of freedom, so the sum has 6.25 degrees of freedom by the Welch-Satterthwaite formula.
    half_width_for_new_flight = scipy.stats.t.ppf(0.975, 6.25) * math.sqrt(0.002)
    assert mass == [
        "mass",
        plus_minus(0.5, 1.96 * 0.02),
        "kg",
        spread_text(half_width_for_new_flight),
        "9 of 10",
        "12.3 % of climb",
    ]
    assert damping == ["autopilot.damping[0]", plus_minus(0.7, 1.96 * 0.05), "–"]
    assert drag == ["linear_drag", plus_minus(0.1, 1.96 * 0.01), "N s/m", "–"]
    assert lines[5:] == [
        f"delay from a command to the measurement of its effect: {plus_minus(32.1, 1.96)} ms",
        "not identified: quadratic_drag: it hovers",
    ]
    assert printed.err == "remark: of the flights\n"


@pytest.mark.parametrize(("weak", "is_remarked"), [(["mass"], False), (["mass", "linear_drag"], True)])
def test_a_remark_is_printed_if_few_parameters_are_identified(capsys, weak, is_remarked):
    result = identified()
    estimates = replace(result.estimates, not_identified=dict.fromkeys(weak, "it hovers"))
    identify.print_estimates(replace(result, estimates=estimates))
    is_printed = "remark: the logs identify only 1 of 3 parameters; " in capsys.readouterr().err
    assert is_printed == is_remarked


def test_explained_variances_of_outputs_are_printed(capsys):
    identify.print_score(identified())
    _, header, *rows = cells(capsys.readouterr().out)
    assert header == ["output", "explained variance", "RMS error", "white noise"]
    assert rows == [
        ["height", "90.0 %", "0.25", "0.12", "m"],
        ["pitch", "none", "0.25", "0.12", "rad"],
    ]
    assert identify.variance_text(0.0) == "none"


def test_the_contents_of_logs_are_printed(capsys):
    time = 5.0 + 0.02 * np.arange(1501)
    origins = SignalOrigin("position", "p.x to p.z (mm)", 50.0, "", 0.0), SignalOrigin("wind", "w", 5.0, "held", 0.125)
    record = FlightRecord("log7", time, position=np.zeros((1501, 3)), remarks=("it has a gap",), origins=origins)
    identify.print_logs([record])
    printed = capsys.readouterr()
    first, header, *rows = cells(printed.out)
    assert first == ["log7: 30.0 s, 1,501 samples at 50 Hz"]
    assert header == ["signal", "rate", "resampled", "not a number", "columns of the log"]
    assert rows == [["position", "50 Hz", "p.x to p.z (mm)"], ["wind", "5 Hz", "held", "12 %", "w"]]
    assert printed.err == "remark: log7: it has a gap\n"


def test_measurement_noise_and_trim_in_hover_are_printed(capsys, monkeypatch):
    record = FlightRecord("log7", np.arange(3.0))
    noise = SimpleNamespace(
        signal="body_rates", unit="rad/s", at_rest=np.full(3, np.nan), in_flight=np.array([0.3, 0.0, 0.4])
    )
    monkeypatch.setattr(identify, "white_noise", lambda _: [noise])
    monkeypatch.setattr(
        identify, "hover_means", lambda _, weight: {"mean roll": EstimatedValue(0.01 * weight, 0.01, "rad")}
    )
    monkeypatch.setattr(identify, "delay_by_correlation", lambda _: 0.0456)
    identify.print_hover([record], 10.0)
    header, row, *lines = capsys.readouterr().out.splitlines()
    assert cells(header) == [["at rest", "in flight"]]
    assert cells(row) == [["log7: white noise of body rates", "–", f"{math.sqrt(0.25 / 3.0):.2g}", "rad/s"]]
    assert lines == [
        f"log7: mean roll in hover {plus_minus(0.1, 1.96 * 0.01)} rad",
        "log7: delay of the attitude behind its command, by correlation: 46 ms",
    ]
    monkeypatch.setattr(identify, "delay_by_correlation", lambda _: None)
    identify.print_hover([record], 10.0)
    assert "correlation" not in capsys.readouterr().out


def test_throttles_of_all_logs_are_combined_without_the_throttles_at_rest():
    """The throttle of 0.1 at rest before and after the flight is left out."""
    time = 0.02 * np.arange(1000)
    in_flight = ((time > 3.0) & (time < 17.0))[:, None]
    four = FlightRecord("a", time, motor_command=np.where(in_flight, [0.5, 0.6, 0.7, 0.8], 0.1))
    one = FlightRecord("b", time, thrust_fraction=np.where(in_flight[:, 0], 0.9, 0.1))
    assert np.unique(identify.throttles([four, one])).tolist() == [0.5, 0.6, 0.7, 0.8, 0.9]
    assert identify.throttles([FlightRecord("c", time)]) is None


def test_a_map_has_a_row_for_each_pair_of_gains_and_names_the_best_pair(capsys, tmp_path):
    k_p, k_d = np.array([1.0, 2.0]), np.array([3.0, 4.0, 5.0])
    size = np.array([[0.9, 0.9, 1.1], [0.9, 0.9, 0.9]])
    linear = StabilityMap(size, 0.1 + size, 0.2 + size)
    rmse = np.array([[0.30, 0.20, 0.01], [0.02, 0.10, 0.40]])
    crash_time = np.full((2, 3), np.inf)
    crash_time[1, 0] = 1.5
    panel = SimpleNamespace(
        title="nominal", linear=linear, simulated=Metrics(rmse, *[rmse] * (len(Metrics._fields) - 2), crash_time)
    )
    gains = MappedGains("control.position", ("k_p", "k_d"), ("k_P", "k_D"), ("1/s²", "1/s"))
    stability_map.print_panel(panel, gains, k_p, k_d)
    assert capsys.readouterr().out == (
        "nominal: 83 % of the gains are stable, 83 % do not crash;"
        " smallest RMSE with stable gains: 10.00 cm at k_P = 2, k_D = 4\n"
    )
    panel.simulated = panel.simulated._replace(crash_time=np.zeros((2, 3)))
    stability_map.print_panel(panel, gains, k_p, k_d)
    assert capsys.readouterr().out.endswith("0 % do not crash; all flights with stable gains crashed\n")
    panel.simulated = panel.simulated._replace(crash_time=crash_time)
    panels = [(panel.title, panel.linear, panel.simulated), ("worst", panel.linear, panel.simulated)]
    table = read_table(stability_map.write_map(tmp_path / "map.csv", panels, gains, k_p, k_d))
    np.testing.assert_array_equal(table["k_P (1/s²)"], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(table["k_D (1/s)"], [3, 4, 5, 3, 4, 5])
    for title in ("nominal", "worst"):
        np.testing.assert_array_equal(table[f"{title}: stable"], [1, 1, 0, 1, 1, 1])
        np.testing.assert_allclose(table[f"{title}: damping"], 0.1 + size.ravel())
        np.testing.assert_allclose(table[f"{title}: delay margin (s)"], 0.2 + size.ravel())
        np.testing.assert_allclose(table[f"{title}: RMSE (m)"], rmse.ravel())
        np.testing.assert_array_equal(table[f"{title}: crash time (s)"], crash_time.ravel())


def test_sensitivities_are_sorted_by_the_effect_of_a_change_of_one_per_cent(capsys, tmp_path):
    fields = ("a", "b", "c", "d")
    gradients = {"rmse": np.array([0.1, -2.0, 7.0, np.nan]), "effort_x": np.zeros(4), "rmse_x": np.full(4, np.nan)}
    metrics = {"rmse": 0.4, "effort_x": 0.0, "rmse_x": 1.0}
    result = Sensitivities(fields, np.array([2.0, 0.5, 0.0, 4.0]), metrics, 1.25, gradients)
    sensitivities.print_sensitivities(result, "rmse")
    crash, first, header, *rows = capsys.readouterr().out.splitlines()
    assert crash.startswith("crashed at 1.25 s;")
    assert first == "rmse 0.4 (SI units)"
    assert cells(header) == [["field", "value", "derivative", "change for +1 %"]]
    assert cells("\n".join(rows)) == [
        ["b", "0.5", "-2", "-2.500 %"],
        ["a", "2", "0.1", "+0.500 %"],
        ["c", "0", "7", "–"],
        ["d", "4", "nan", "–"],
    ]
    table = read_table(sensitivities.write_sensitivities(tmp_path / "table.csv", result))
    assert [*table["field"]] == ["(metric)", *fields]
    np.testing.assert_allclose(
        [float(value or "nan") for value in map(str, table["value"])], [np.nan, 2.0, 0.5, 0.0, 4.0]
    )
    np.testing.assert_allclose(table["rmse"], [0.4, 0.1, -2.0, 7.0, np.nan])
    uncrashed = Sensitivities(fields, result.values, metrics, np.inf, gradients)
    for name in ("effort_x", "rmse_x"):
        sensitivities.print_sensitivities(uncrashed, name)
        assert capsys.readouterr().out.endswith(f"{name} has no derivative, because it is zero in this flight\n")


def test_default_fields_of_sensitivities_depend_on_the_layout_and_the_autopilot():
    position = [f"control.position.{gain}.{axis}" for gain in ("k_p", "k_d") for axis in (0, 1, 2)]
    vehicle = ["vehicle.mass", "nominal.mass", "vehicle.thrust_factor", "nominal.thrust_factor"]
    vehicle += ["vehicle.rotor_time_constant"]
    attitude = [f"control.attitude.{gain}.{axis}" for gain in ("k_p", "k_d") for axis in (0, 1)]
    turning = [f"{owner}.inertia.{axis}" for owner in ("vehicle", "nominal") for axis in (0, 1)]
    on_board = "laboratory.autopilot."
    air = ["vehicle.linear_drag", "vehicle.quadratic_drag"]  # drag fields of the vehicle in `onboard`
    response = "laboratory.autopilot={kind: response, natural_frequency: [6.8, 6.1, 3], damping: [0.5, 0.5, 0.7]}"
    fields = {
        name: [*sensitivities.default_fields(load_scenario(*arguments))]
        for name, arguments in {
            "plus": ("hover",),
            "h": ("hover", ["nominal.layout={kind: h, length: 0.2, width: 0.3}"]),
            "attitude": ("onboard",),
            "response": ("onboard", [response, "control.position.feed_forward=acceleration"]),
            "cascade": (
                "onboard",
                [
                    "control={kind: pid_cascade, position: {k_p: [1, 1, 1]}, velocity: {k_p: [1.8, 1.8, 4],"
                    " k_d: [0.2, 0.2, 0]}, command: {kind: acceleration}}"
                ],
            ),
        }.items()
    }
    assert fields["plus"] == [*vehicle, *position, *turning, "vehicle.arm_length", *attitude]
    assert fields["h"] == [
        *vehicle, *position, *turning, "vehicle.layout.length", "vehicle.layout.width", *attitude,
    ]  # fmt: skip
    assert fields["attitude"] == [
        *vehicle, *air, *position, *turning, "vehicle.arm_length",
        *(f"{on_board}{gain}.{axis}" for gain in ("k_attitude", "k_rate") for axis in (0, 1)),
        *(f"{on_board}gyroscope_bias.{axis}" for axis in (0, 1)),
    ]  # fmt: skip
    vehicle += air
    loops = [f"control.{loop}.k_p.{axis}" for loop in ("position", "velocity") for axis in (0, 1, 2)]
    assert fields["cascade"][len(vehicle) :][:8] == [*loops, "control.velocity.k_d.0", "control.velocity.k_d.1"]
    # Drag fields that are zero are left out, and the others are included.
    drag = {"vehicle.body_drag": "{linear: [0.1, 0.2, 0.0], quadratic: [0, 0, 0.3]}", "vehicle.linear_drag": 0.0}
    dragged = sensitivities.default_fields(load_scenario("hover", [f"{path}={value}" for path, value in drag.items()]))
    assert [path for path in dragged if "drag" in path] == [
        "vehicle.body_drag.linear.0", "vehicle.body_drag.linear.1", "vehicle.body_drag.quadratic.2",
    ]  # fmt: skip
    # Inertia and arm lengths are left out, since the attitude response replaces them.
    assert fields["response"] == [
        *vehicle, *position,
        *(f"{on_board}{number}.{axis}" for number in ("natural_frequency", "damping") for axis in (0, 1)),
    ]  # fmt: skip


def test_active_limits_of_a_plan_are_printed_with_their_segments():
    constraints = [
        ActiveConstraint("speed", "", 4, 1.0), ActiveConstraint("speed", "", 0, 1.1),
        ActiveConstraint("speed", "", 2, 1.2),
        ActiveConstraint("speed", "", 3, 1.3), ActiveConstraint("corridor", "y max", 1, 1.4),
    ]  # fmt: skip
    assert plan.binding_summary(constraints) == "speed on segments 0, 2-4; corridor y max on segment 1"
    assert plan.binding_summary([]) == "none"


def test_the_summary_of_a_plan_has_its_length_peaks_and_rotor_speeds():
    """The expected values are computed from samples of the path. A limit is printed only if there is one."""
    mission = load_scenario("figure_eight")
    simulated = plan_route(mission)
    rows = {name: (value, unit) for name, value, unit in plan.summary(mission, simulated, PathLimits(speed=9.0), None)}
    times = np.linspace(0.0, simulated.duration, 20_001)
    positions = evaluate(simulated.path, times)
    assert float(rows["length"][0]) == pytest.approx(np.linalg.norm(np.diff(positions, axis=1), axis=0).sum(), abs=0.02)
    assert rows["duration"] == (f"{simulated.duration:.3f}", "s")
    assert rows["waypoints"] == (str(len(simulated.path.times)), "")
    for name, order, unit in (("speed", 1, "m/s of 9"), ("acceleration", 2, "m/s²"), ("snap", 4, "m/s⁴")):
        peak = np.linalg.norm(evaluate(simulated.path, times, order), axis=0).max()
        assert float(rows[f"top {name}"][0]) == pytest.approx(peak, rel=1e-2)
        assert rows[f"top {name}"][1] == unit
    parameters = planned_parameters(mission)
    rotors = np.array(plan_demand(simulated, parameters, times).rotor_speed)
    lowest, highest = map(float, rows["rotor speeds"][0].split(" to "))
    assert (lowest, highest) == pytest.approx((rotors.min(), rotors.max()), abs=1.0)
    assert rows["rotor speeds"][1] == f"rad/s of {parameters.min_rotor_speed:g} to {parameters.max_rotor_speed:g}"


def test_errors_of_table_ii_are_printed_next_to_the_published_ones(capsys):
    gap = Runs((math.nan,) * 3, math.nan)
    runs = Runs((0.1, 0.1, 0.1), 0.1)
    entries = [
        TableEntry(Cell("low_wind", "pd"), "rmse", Runs((0.2, 0.2, 0.2), 0.2), runs, Interval(0.15, 0.14, 0.16), 0),
        TableEntry(Cell("low_wind", "pd"), "effort_x", runs, runs, Interval(0.3, 0.2, 0.4), 0),
        TableEntry(Cell("no_wind", "pd_t2fnn"), "rmse", gap, runs, Interval(0.05, 0.04, 0.06), 0),
    ]
    replicate.print_errors(entries)
    header, first, second = cells(capsys.readouterr().out)
    assert header == ["wind", "controller", "RMSE (m)", "RMSE in the paper (m)", "deviation"]
    assert first[2:] == ["0.150 [0.140, 0.160]", "0.200", "-25.0 %"]
    assert second[2:] == ["0.050 [0.040, 0.060]", "–", "–"]
    assert first[0] != second[0]
    assert first[1] != second[1]


def studied(**given):
    """Return a study of four samples, one of which crashes."""
    mass = np.array([0.5, 0.6, 0.7, 0.8])
    numbers = {"vehicle.mass": mass}
    metrics = metrics_of([0.1, 0.2, 0.3, 0.4], crashed=[1])
    return Study(load_scenario("robustness"), 10.0, np.array([0, 2, 3, 5]), numbers, metrics, **given)


def test_the_worst_samples_are_printed_with_the_command_that_repeats_them(capsys, tmp_path):
    study.print_study("mine", studied(), tmp_path, "compiled")
    text = capsys.readouterr().out
    assert text.startswith("mine: 4 samples of seed 0, 10.00 s each, diagrams compiled; 1 crashed, ")
    worst = cells(text.split("worst samples:\n")[1])
    fly_again = f"drake-quad fly {tmp_path / 'scenario.yaml'} --sample"
    assert worst == [
        ["crashed at 3.00 s", f"{fly_again} 2"],
        ["40.0 cm", f"{fly_again} 5"],
        ["30.0 cm", f"{fly_again} 3"],
        ["10.0 cm", f"{fly_again} 0"],
    ]
    # All commands begin in the same column, to the right of the longest outcome.
    starts = {line.index("drake-quad") for line in text.split("worst samples:\n")[1].splitlines()}
    assert starts == {2 + 18 + 2}


def test_the_largest_influences_are_printed_with_the_paths_of_their_fields(capsys, tmp_path):
    rng = np.random.default_rng(1)
    mass, x, unrelated = rng.uniform(0.5, 1.0, size=(3, 200))
    metrics = metrics_of(0.1 + mass + 6.0 * (x - 0.75) ** 2, crashed=np.flatnonzero(x > 0.95))
    numbers = {"vehicle.drag_factor": unrelated, "vehicle.centre_of_mass.0": x, "vehicle.mass": mass}
    result = Study(load_scenario("robustness"), 10.0, np.arange(200), numbers, metrics)
    study.print_study("mine", result, tmp_path, "compiled")
    text = capsys.readouterr().out
    header, first, second, *crashes = cells(text.split("largest influences on ")[1].split("more:")[0])
    assert header == ["RMSE", "rank correlation"]
    assert (first[0], second[0], len(second)) == ("vehicle.mass", "vehicle.centre_of_mass.0", 3)
    assert first[1].startswith("+0.")
    assert second[2] == "of the distance from its median"
    assert crashes == []  # only two parameters have a significant influence
    _, header, first = text.partition("largest influences on crashes")
    assert first.splitlines()[1].startswith("vehicle.centre_of_mass.0")
    command = f"drake-quad sensitivities {tmp_path / 'scenario.yaml'} --sample 0\n"
    assert f"more: {command}" in text
    study.print_study("mine", result, tmp_path, "compiled", metric="peak_error")
    assert "influence on peak error\n" in capsys.readouterr().out


def test_a_study_of_few_samples_states_that_no_influence_is_significant(capsys, tmp_path):
    study.print_study("mine", studied(), tmp_path, "compiled")
    assert "\nno random parameter has a significant influence on RMSE\n" in capsys.readouterr().out


def test_the_simulation_speed_counts_only_newly_flown_time(capsys):
    study.print_rate({"a": studied(simulated_time=1000.0), "b": studied(simulated_time=2000.0)}, 1.5)
    assert capsys.readouterr().out == "simulation speed: 2,000 vehicle-seconds per second\n"
    study.print_rate({"a": studied()}, 1.5)
    assert capsys.readouterr().out == "all samples had already been flown\n"


def test_failed_samples_are_counted_and_the_first_is_explained(tmp_path):
    studies = {
        "none": studied(),
        "pd": studied(failures={7: "later", 4: "too slow"}),
        "pid": studied(failures={1: "also"}),
    }
    folders = {name: tmp_path / name for name in studies}
    assert study.failure(studies, folders) == (
        "3 samples could not be simulated (sample 4 of pd: too slow);"
        f" {tmp_path / 'pd' / 'failed.csv'} lists them, and --resume tries them again"
    )


def test_crashes_of_replayed_flights_are_counted(capsys):
    flights = [SimpleNamespace(metrics=SimpleNamespace(crashed=crashed)) for crashed in (True, False, True)]
    replay.print_crashes({"a": flights, "b": flights[1:2]})
    assert capsys.readouterr().out == "a: 3 flights, 2 crashed\nb: 1 flights, 0 crashed\n"


def test_judge_prints_errors_in_centimetres_and_the_fraction_of_crashes(capsys):
    metrics = metrics_of([0.1, 0.2, 0.3, 0.9], crashed=[3])
    assert judge.error_text(None) == "–"
    assert judge.error_text(metrics) == "20.0 25.0 %"
    assert judge.error_text(metrics_of([0.1, 0.3])) == "20.0"
    result = SimpleNamespace(
        controllers=["pd", "indi"],
        flights={"outdoor": {"pd": metrics}, "no wind": {"pd": metrics, "indi": metrics_of([0.1, 0.3])}, "moon": {}},
    )
    judge.print_errors(result)
    _, header, first, second = cells(capsys.readouterr().out)
    assert header == ["no wind", "outdoor"]
    assert first == ["PD", "20.0 25.0 %", "20.0 25.0 %"]
    assert second == ["INDI", "20.0", "–"]


def test_the_table_of_random_numbers_of_an_event_has_a_row_for_each_number(tmp_path):
    coordinates = (
        Coordinate("vehicle.mass", Interval(1.5, 1.25, 1.75), 0.5),
        Coordinate("wind", Interval(-0.5, -0.75, 0.0), 1.0),
    )
    table = read_table(risk.write_coordinates(tmp_path / "table.csv", SimpleNamespace(coordinates=coordinates)))
    assert {name: column.tolist() for name, column in table.items()} == {
        "random_number": ["vehicle.mass", "wind"],
        "mean": [1.5, -0.5],
        "mean_low": [1.25, -0.75],
        "mean_high": [1.75, 0.0],
        "deviation": [0.5, 1.0],
    }
    assert not any(
        map(len, read_table(risk.write_coordinates(tmp_path / "t.csv", SimpleNamespace(coordinates=()))).values())
    )


def test_the_parameters_of_a_worst_case_are_sorted_by_their_distance_from_the_median(capsys):
    found = SimpleNamespace(
        names=("vehicle.mass", "noise", "laboratory.command_link.loss_rate"),
        point=np.array([0.5, -1.25, -2.0]),
        values={"vehicle.mass": (0.68, 0.70123), "laboratory.command_link.loss_rate": (0.1, 0.02)},
        nominal=load_scenario("hover"),
    )
    falsify.print_parameters(found)
    header, *rows = cells(capsys.readouterr().out)
    assert header == ["random parameter", "nominal", "worst", "deviations", "unit"]
    assert rows == [
        ["laboratory.command_link.loss_rate", "0.1", "0.02", "-2.00"],
        ["noise", "–", "–", "-1.25"],
        ["vehicle.mass", "0.68", "0.7012", "+0.50", "kg"],
    ]


def test_an_identified_position_law_is_printed_with_the_fractions_of_limited_samples(capsys):
    gains = {"position": EstimatedValue(4.0, 0.1, "1/s²"), "reference_acceleration": EstimatedValue(1.0, 0.01, "1")}
    horizontal = AxisLaw(("x", "y"), gains, 0.98765, {"filter_time": "too short"}, at_error_limit=0.125)
    law = PositionLaw((horizontal,), "heading", 0.25, {"z": "no motion"}, ("a remark",))
    identify_controller.print_law(law)
    printed = capsys.readouterr()
    title, header, *rows = cells(printed.out)
    assert title == ["position law with 95 % intervals"]
    assert header == ["axis", "gain", "value", "unit"]
    assert rows == [
        ["x and y", "position", "4.00 ± 0.20", "1/s²"],
        ["x and y", "reference acceleration", "1.000 ± 0.020"],
        ["x and y: the law explains 98.77 % of the variance of the command"],
        ["x and y: the position error is limited in 12.5 % of the samples"],
        ["not identified: filter time on x and y: too short"],
        ["not identified: z: no motion"],
        ["form of the command: thrust along the commanded roll and pitch at the measured yaw"],
        ["25.0 % of the samples are left out, because a command is at its limit"],
    ]
    assert printed.err == "remark: a remark\n"


def test_a_range_of_gains_must_be_nonnegative_and_increasing():
    assert stability_map._grid("--k-p", (0.0, 4.0), 5).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    for limits in ((-1.0, 4.0), (4.0, 4.0), (0.0, math.inf), (math.nan, 1.0)):
        with pytest.raises(
            InputError, match="--k-p .*: the first gain must be at least 0, and the second must be larger than it"
        ):
            stability_map._grid("--k-p", limits, 5)
