"""Tests of additional metrics and of requirements in flights and studies."""

import importlib
import math
import pickle
import sys

import numpy as np
import pytest

from drake_quad import InputError, flight_metric, load_scenario, metric, run_monte_carlo, simulate, simulate_samples
from drake_quad.framework.elementary import where
from drake_quad.laboratory.derived_signals import DERIVED_SIGNALS, derived_signal
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.scenario.metrics.metric import METRICS
from drake_quad.signals import State
from drake_quad.statistics.estimates import bounded_mean_interval
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import compare, metric_mean, requirement_probability, values_with_crashes
from drake_quad.studies.summary import metric_table, requirement_table

START = 1.0  # s, start of the metric window
PERIOD = 0.02  # s, control period
NUMPY_REDUCTIONS = {
    "mean": np.mean,
    "rms": lambda values: np.sqrt(np.mean(values**2)),
    "max": np.max,
    "min": np.min,
    "last": lambda values: values[-1],
    "integral": lambda values: np.sum(values) * PERIOD,
}


def additional(**metrics):
    """Return an override with additional metrics, and the start of the metric window."""
    return {"metrics": {"start": START, "additional": metrics}, "duration": 4.0}


def in_window(flight):
    """Return the state and the reference of a flight in the metric window."""
    window = flight.time >= START
    return flight["state"][window].T, flight["reference"][window].T


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
def test_reductions_over_time_agree_with_numpy(compiled):
    metrics = {rule: {"kind": rule, "of": "state.v_y"} for rule in NUMPY_REDUCTIONS}
    flight = simulate(load_scenario("laboratory:low_wind", [additional(**metrics)]), compiled=compiled)
    state, _ = in_window(flight)
    for rule, function in NUMPY_REDUCTIONS.items():
        assert getattr(flight.metrics, rule) == pytest.approx(function(state[7]), rel=1e-12), rule
    assert flight.metrics.definitions["max"].unit == "m/s"
    assert flight.metrics.definitions["integral"].unit == "m/s s"


@pytest.mark.slow
def test_derived_signals_agree_with_their_definitions():
    names = ("position_error", "yaw_error", "speed", "airspeed", "body_rate", "tilt")
    metrics = {name: {"kind": "last", "of": name} for name in names}
    flight = simulate(load_scenario("laboratory:high_wind", [additional(**metrics)]))
    state, reference, wind = (flight[name][-1] for name in ("state", "reference", "wind"))
    thrust_axis_z = math.cos(state[3]) * math.cos(state[4])
    expected = {
        "position_error": np.linalg.norm(reference[:3] - state[:3]),
        "yaw_error": reference[9] - state[5],
        "speed": np.linalg.norm(state[6:9]),
        "airspeed": np.linalg.norm(state[6:9] - wind),
        "body_rate": np.linalg.norm(state[9:]),
        "tilt": math.acos(thrust_axis_z),
    }
    for name in names:
        assert getattr(flight.metrics, name) == pytest.approx(expected[name], rel=1e-9), name
    assert {*names} == {*DERIVED_SIGNALS}


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 1.6, math.pi - 1e-9])
def test_the_tilt_is_accurate_near_the_vertical(angle):
    tilt = DERIVED_SIGNALS["tilt"].formula
    assert tilt(State(*[0.0] * 12)._replace(roll=angle)) == pytest.approx(angle, rel=1e-12)
    small = State(*[0.0] * 12)._replace(roll=3e-9, pitch=-4e-9)
    assert tilt(small) == pytest.approx(5e-9, rel=1e-12)


@pytest.mark.long
def test_shipped_metrics_are_computed_from_their_signals():
    metrics = {
        "settling_time": {"radius": 0.03},
        "tube": {"kind": "time_in_tube", "radius": 0.03},
        "command_jerk": {},
    }
    flight = simulate(load_scenario("laboratory:low_wind", [additional(**metrics)]))
    state, reference = in_window(flight)
    error = np.linalg.norm(reference[:3] - state[:3], axis=0)
    command = flight["acceleration_command"][flight.time >= START]
    jerk = np.diff(command, axis=0) / PERIOD
    assert flight.metrics.tube == pytest.approx(PERIOD * np.sum(error <= 0.03))
    assert flight.metrics.command_jerk == pytest.approx(np.sqrt(np.mean(np.sum(jerk**2, axis=1))))
    large = np.flatnonzero(error > 0.03)
    assert 0 < len(large) < len(error)
    expected = math.inf if large[-1] == len(error) - 1 else PERIOD * (large[-1] + 1)
    assert flight.metrics.settling_time == pytest.approx(expected)
    wide = simulate(load_scenario("laboratory:low_wind", [additional(settling_time={"radius": 10.0})]))
    assert wide.metrics.settling_time == 0.0


def test_the_obstacle_distance_is_measured_from_the_surface_of_the_vehicle():
    space = {"obstacles": {"ball": {"kind": "sphere", "centre": [0.0, 0.0, 4.0], "radius": 0.5}}, "radius": 0.2}
    scenario = load_scenario("hover", [{**additional(obstacle_distance={}), "space": space}])
    flight = simulate(scenario)
    state, _ = in_window(flight)
    expected = np.min(np.linalg.norm(state[:3].T - [0.0, 0.0, 4.0], axis=1)) - 0.7
    assert flight.metrics.obstacle_distance == pytest.approx(expected, rel=1e-12)
    with pytest.raises(InputError, match=r"metrics\.additional\.near needs obstacles, but hover has none"):
        simulate(load_scenario("hover", [additional(near={"kind": "obstacle_distance"})]))


def test_the_energy_is_the_integral_of_the_power_of_the_battery():
    battery = {"voltage": 12.6, "empty_voltage": 10.0, "capacity": 1.0, "resistance": 0.05, "efficiency": 0.6}
    scenario = load_scenario("hover", [{**additional(energy={}), "vehicle": {"battery": battery}}])
    flight = simulate(scenario)
    voltage, current = flight["battery"].T
    power = (voltage * current)[flight.time >= START]
    assert flight.metrics.energy == pytest.approx(PERIOD * power.sum(), rel=1e-12)
    # The charge is the integral of the current.
    assert flight["charge"][-1, 0] * 3600.0 == pytest.approx(np.trapezoid(current, flight.time), rel=1e-4)
    with pytest.raises(InputError, match=r"metrics\.additional\.energy needs the signal battery, but the signals of"):
        simulate(load_scenario("hover", [additional(energy={})]))


USER_METRICS = '''
from typing import NamedTuple
import numpy as np
from drake_quad import flight_metric, metric
from drake_quad.framework.elementary import where

@metric("m", over_time="max")
def height_loss(state, reference, *, tolerance: float = 0.0):
    """Largest height below the reference."""
    return reference.z - state.z - tolerance

class Distance(NamedTuple):
    x: float = 0.0
    length: float = 0.0

@metric("m", initial=Distance(), value=lambda sums, ticks, period: sums.length)
def distance_along_x(sums, state, ticks):
    """Distance flown along X."""
    return Distance(state.x, sums.length + where(ticks > 0.0, abs(state.x - sums.x), 0.0))

@flight_metric("m")
def error_quantile(flight, *, probability: float = 0.9):
    """Quantile of the position error."""
    return np.quantile(np.linalg.norm(flight["state"][:, :3] - flight["reference"][:, :3], axis=1), probability)
'''


@pytest.mark.long
def test_a_user_defined_metric_is_a_column_of_flights_and_studies(tmp_path, monkeypatch):
    (tmp_path / "own_metrics.py").write_text(USER_METRICS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_metrics", raising=False)
    importlib.import_module("own_metrics")
    metrics = {
        "height_loss": {},
        "tolerated": {"kind": "height_loss", "tolerance": 0.01},
        "distance_along_x": {},
        "error_quantile": {"probability": 0.5},
    }
    scenario = load_scenario("robustness", [additional(**metrics)], layers=["controllers/paper:pd"])
    study = run_monte_carlo(scenario, 5, folder=tmp_path, num_workers=1, batch_size=3)
    flights = simulate_samples(scenario, range(5), compiled=True)
    for i, flight in enumerate(flights):
        state, reference = in_window(flight)
        expected = {
            "height_loss": np.max(reference[2] - state[2]),
            "tolerated": np.max(reference[2] - state[2]) - 0.01,
            "distance_along_x": np.abs(np.diff(state[0])).sum(),
            "error_quantile": np.median(np.linalg.norm(flight["state"][:, :3] - flight["reference"][:, :3], axis=1)),
        }
        for name, value in expected.items():
            assert getattr(flight.metrics, name) == pytest.approx(value, rel=1e-12), name
            assert getattr(study.metrics, name)[i] == pytest.approx(value, rel=1e-9), name
    assert {"height loss", "tolerated", "error quantile"} <= {row[0] for row in metric_table(study).rows}
    assert "tolerated" in (tmp_path / "results.csv").read_text().splitlines()[0].split(",")
    assert fly_samples(scenario, [4]).error_quantile == pytest.approx(flights[4].metrics.error_quantile)


def range_of(name, **metrics):
    """Return the range of a metric of a scenario that has these additional metrics."""
    return metric_definitions(load_scenario("hover", [additional(**metrics)]).metrics_type)[name].value_range


@pytest.mark.parametrize(
    ("rule", "signal", "value_range"),
    [
        ("max", "tilt", "nonnegative"),
        ("integral", "speed", "nonnegative"),
        ("max", "yaw_error", "real"),
        ("min", "state.z", "real"),
        ("rms", "yaw_error", "nonnegative"),
    ],
)
def test_a_metric_of_a_signal_can_be_negative_only_if_signal_and_reduction_can_be_negative(rule, signal, value_range):
    assert range_of("mine", mine={"kind": rule, "of": signal}) == value_range


def test_the_mean_of_a_fraction_is_a_fraction_but_the_integral_of_a_fraction_is_not():
    @derived_signal("1", value_range="fraction")
    def darkness(time):
        return time * 0.0

    try:
        assert range_of("mine", mine={"kind": "mean", "of": "darkness"}) == "fraction"
        assert range_of("mine", mine={"kind": "integral", "of": "darkness"}) == "nonnegative"
    finally:
        del DERIVED_SIGNALS["darkness"]


@pytest.mark.slow
def test_intervals_and_ratios_follow_the_stated_range_of_a_metric():
    @metric("1", over_time="mean", value_range="fraction")
    def fraction_outside(state, reference):
        """Fraction of the ticks at which the vehicle is more than 2 cm from its reference."""
        x, y, z = state.x - reference.x, state.y - reference.y, state.z - reference.z
        return where(x * x + y * y + z * z > 0.02 * 0.02, 1.0, 0.0)

    @metric("m", over_time="mean")
    def drift(state, reference):
        """Mean error along X."""
        return state.x - reference.x

    metrics = fly_samples(load_scenario("laboratory:low_wind", [additional(fraction_outside={}, drift={})]), range(6))
    result = metric_mean(metrics, "fraction_outside")
    assert 0.0 < result.low < result.value < result.high < 1.0
    assert result == bounded_mean_interval(metrics.fraction_outside)
    assert compare(metrics, metrics, "fraction_outside").ratio.value == 1.0
    assert math.isnan(compare(metrics, metrics, "drift").ratio.value)


@pytest.mark.slow
@pytest.mark.parametrize(("value_range", "limits"), [("nonnegative", "not negative"), ("fraction", "between 0 and 1")])
def test_a_metric_outside_its_stated_range_is_refused(value_range, limits):
    @metric("1", over_time="last", value_range=value_range)
    def depth(state):
        """Depth below the ground."""
        return -state.z

    @flight_metric("1", value_range=value_range)
    def depth_in_flight(flight):
        """Depth below the ground."""
        return -flight["state"][-1, 2]

    for kind in ("depth", "depth_in_flight"):
        with pytest.raises(InputError, match=rf"the metric {kind} is -1.*, but its value_range .* states {limits}"):
            simulate(load_scenario("hover", [{"metrics": {"additional": {kind: {}}}, "duration": 0.1}]))


def test_a_metric_that_worker_processes_cannot_import_is_refused():
    @metric("m", over_time="max")
    def height(state):
        """Largest height."""
        return state.z

    scenario = load_scenario("hover", [additional(height={})])
    assert simulate(scenario, sample=0).metrics.height > 0.0
    with pytest.raises(InputError, match="a kind that the scenario uses cannot be sent to worker processes; define it"):
        run_monte_carlo(scenario, 2, num_workers=1)


def test_a_registered_metric_can_be_pickled_with_its_scenario():
    metrics = {"tube": {"kind": "time_in_tube", "radius": 0.2}, "highest": {"kind": "max", "of": "state.z"}}
    scenario = load_scenario("hover", [additional(**metrics, command_jerk={})])
    copy = pickle.loads(pickle.dumps(scenario))
    assert copy == scenario
    assert copy.metrics_type is scenario.metrics_type


@pytest.mark.parametrize(
    ("metrics", "message"),
    [
        ({"rmse": {"kind": "max", "of": "tilt"}}, "must have another name, since a study has another column"),
        ({"Tilt": {"kind": "max", "of": "tilt"}}, "must have a name of small letters"),
        ({"tilt": {"kind": "max", "of": "tild"}}, "must be a scalar signal: 'tild' is neither a component of a signal"),
        (
            {"tilt": {"kind": "max", "of": "state.tilt"}},
            r"is not a component of the signal state; its components are state\.x",
        ),
        ({"tilt": {"kind": "max", "of": "weights.1"}}, "its components are none that have names"),
        ({"unknown": {}}, "unknown"),
        ({"tube": {"kind": "time_in_tube", "radius": -1.0}}, "radius"),
    ],
)
def test_invalid_additional_metrics_are_refused(metrics, message):
    with pytest.raises(InputError, match=message):
        load_scenario("hover", [additional(**metrics)])


def test_invalid_definitions_of_metrics_are_refused():
    with pytest.raises(TypeError, match="needs either over_time, or initial and value"):
        metric("m")
    with pytest.raises(TypeError, match="over_time is 'mode', but must be one of"):
        metric("m", over_time="mode")
    with pytest.raises(TypeError, match="value_range is 'positive', but must be one of real, nonnegative, fraction"):
        metric("m", over_time="max", value_range="positive")
    with pytest.raises(TypeError, match="value_range is 'positive'"):
        flight_metric("m", value_range="positive")
    with pytest.raises(TypeError, match="the argument radius of inside must have a default"):

        @metric("m", over_time="max")
        def inside(state, *, radius):
            return state.x - radius

    with pytest.raises(ValueError, match="the name wind is taken by another signal"):

        @derived_signal("m/s")
        def wind(state):
            return state.v_x

    @flight_metric("m")
    def words(flight):
        return "far"

    with pytest.raises(InputError, match="the metric words must be a number, but its function returned 'far'"):
        simulate(load_scenario("hover", [additional(words={})]))


REQUIREMENTS = {
    "near": {"always": {"signal": "position_error", "below": 0.05}},
    "near_later": {"always": {"signal": "position_error", "below": 0.05}, "after": 2.0},
    "tilts": {"eventually": {"signal": "tilt", "above": 0.1}, "before": 3.0},
    "level_until": {
        "always": {"signal": "tilt", "below": 0.2},
        "until": {"signal": "tilt", "above": 0.05},
        "before": 3.0,
    },
    "inside": {
        "always": {"all": [{"signal": "state.x", "above": -3, "below": 3.0}, {"signal": "state.y", "above": -3}]}
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [True, False])
def test_requirements_concern_the_whole_flight_and_not_the_metric_window(compiled):
    scenario = load_scenario("laboratory:low_wind", [{**additional(), "requirements": REQUIREMENTS}])
    flight = simulate(scenario, compiled=compiled)
    state, reference, time = flight["state"].T, flight["reference"].T, flight.time
    error = np.linalg.norm(reference[:3] - state[:3], axis=0)
    tilt = np.arccos(np.cos(state[3]) * np.cos(state[4]))
    held = np.concatenate([[math.inf], np.minimum.accumulate(0.2 - tilt)[:-1]])
    expected = {
        "near": 0.05 - error.max(),
        "near_later": 0.05 - error[time >= 2.0].max(),
        "tilts": tilt[time <= 3.0].max() - 0.1,
        "level_until": np.minimum(tilt - 0.05, held)[time <= 3.0].max(),
        "inside": min((3.0 - np.abs(state[0])).min(), (3.0 + state[1]).min()),
    }
    for name, value in expected.items():
        assert getattr(flight.metrics, name) == pytest.approx(value, abs=1e-8), name


@pytest.mark.slow
def test_a_flight_that_crashes_satisfies_no_requirement():
    requirement = {"near": {"always": {"signal": "position_error", "below": 0.3}}}
    crash = {"position_error": 0.1}
    scenario = load_scenario("laboratory:high_wind", [{"requirements": requirement, "crash": crash}])
    study = run_monte_carlo(scenario, 40, num_workers=1)
    crashed, robustness = study.metrics.crashed, study.metrics.near
    assert 0 < crashed.sum() < 40
    assert np.all(robustness[crashed] > 0.0)
    satisfied = ~crashed & (robustness >= 0.0)
    assert requirement_probability(study.metrics, "near").value == pytest.approx(satisfied.mean())
    assert np.all(values_with_crashes(study.metrics, "near")[crashed] == -math.inf)
    (row,) = requirement_table(study).rows
    assert row[0] == "near"
    assert row[2].startswith("crash")


@pytest.mark.parametrize(
    ("requirement", "message"),
    [
        ({}, "must have either `always` or `eventually`"),
        ({"always": {"signal": "tilt"}}, r"must have a bound \(`above` or `below`\) if it has a `signal`"),
        ({"always": {"below": 1.0}}, "must have exactly one of the fields `signal`, `all` and `any`"),
        ({"always": {"signal": "tilt", "above": 1.0, "below": 0.5}}, "must be larger than `above`, 1"),
        (
            {"eventually": {"signal": "tilt", "below": 1.0}, "until": {"signal": "tilt", "below": 1.0}},
            "must have `always` if it has `until`",
        ),
        ({"always": {"signal": "tilt", "below": 1.0}, "after": 3.0, "before": 2.0}, "must be later than `after`, 3"),
        (
            {"always": {"all": [{"signal": "tilt", "below": 1.0}, {"signal": "speed", "below": 1.0}]}},
            "must not combine signals in m/s and rad",
        ),
        ({"always": {"signal": "tilts", "below": 1.0}}, "must be a scalar signal"),
    ],
)
def test_invalid_requirements_are_refused(requirement, message):
    with pytest.raises(InputError, match=message):
        load_scenario("hover", [{"requirements": {"level": requirement}}])


def test_the_message_about_an_unknown_metric_names_the_option_that_registers_it():
    message = (
        r"additional\.height_loss\.kind is 'height_loss' by default, but .*; `--import FILE\.py` registers a metric"
    )
    with pytest.raises(InputError, match=message):
        load_scenario("hover", [additional(height_loss={"tolerance": 0.01})])


def test_a_requirement_with_the_name_of_a_metric_is_refused():
    requirement = {"level": {"always": {"signal": "tilt", "below": 1.0}}}
    with pytest.raises(InputError, match="must have another name, since a study has another column"):
        load_scenario("hover", [{**additional(level={"kind": "max", "of": "tilt"}), "requirements": requirement}])


@pytest.mark.slow
def test_a_comparison_prefers_the_larger_value_if_larger_is_better():
    scenario = load_scenario("laboratory:low_wind", [additional(tube={"kind": "time_in_tube", "radius": 0.05})])
    metrics = fly_samples(scenario, range(6))
    smaller = metrics._replace(tube=metrics.tube / 2.0)
    comparison = compare(smaller, metrics, "tube")
    assert (comparison.better.value, comparison.num_pairs) == (0.0, 6)
    assert comparison.ratio.value == pytest.approx(0.5)  # defined, because times are not negative
    assert compare(metrics, smaller, "tube").better.value == 1.0


def test_the_page_on_metrics_lists_all_metric_kinds_and_derived_signals(root):
    page = (root / "docs" / "how_to" / "your_own_metric.md").read_text()
    for signal in DERIVED_SIGNALS.values():
        assert f"| `{signal.name}` | {signal.unit} |" in page
    for name, settings in METRICS.members.items():
        if name not in NUMPY_REDUCTIONS:
            assert f"| `{name}` | " in page, settings
