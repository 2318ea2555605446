"""Tests of flights: their signals, saved files and plots, and the samples, winds and faults that they simulate."""

import csv
import re

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.design.sensitivity import flight_sensitivities
from drake_quad.fleets.fleet_simulation import fly
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.scenario.batch import Batch, draw_sample
from drake_quad.signals import SIGNALS, State, Wind
from drake_quad.visualization.plots import PLOTS, save_plots


@pytest.fixture(scope="module")
def flight(diagrams):
    return simulate(load_scenario(diagrams / "figure_eight.yaml", ["duration=3.0"]))


def test_components_of_a_signal_have_names(flight):
    for name, values in flight.signals.items():
        record = flight.record(name)
        assert type(record) is SIGNALS[name]
        for row, expected in zip(record, values.T, strict=True):
            np.testing.assert_array_equal(row, expected)
    state, reference = flight.record("state"), flight.record("reference")
    distance = np.linalg.norm([reference.x - state.x, reference.y - state.y, reference.z - state.z], axis=0)
    np.testing.assert_allclose(flight.euclidean_error, distance, rtol=1e-12)


@pytest.mark.long
def test_components_of_network_signals_are_numbered(asymmetric):
    """The signal `weights` has one component for each rule, and `covariance_trace` has one for each axis."""
    few_sets = "control.network.inputs.error={scale: 2.4, centres: [-1.0, 0.8], widths: [1.1, 1.0]}"
    flight = simulate(asymmetric("pd_t2fnn", "duration=1.1", "control.network.axes=[x, y]", few_sets))
    weights, traces = flight.record("weights"), flight.record("covariance_trace")
    assert (len(weights), len(traces)) == (16, 2)
    np.testing.assert_array_equal(weights[13], flight["weights"][:, 13])


def test_saved_files_contain_the_flight(flight, tmp_path):
    arrays, table, scenario, metrics = flight.save(tmp_path / "deep" / "folder")
    with np.load(arrays) as loaded:
        np.testing.assert_array_equal(loaded["time"], flight.time)
        for name, values in flight.signals.items():
            np.testing.assert_array_equal(loaded[name], values)
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(flight.time) == 151
    state, speeds = flight.record("state"), flight.record("rotor_speed")
    np.testing.assert_allclose([float(row["state.z (m)"]) for row in rows], state.z, rtol=1e-8)
    rotor_3 = [float(row["rotor_speed.rotor_3 (rad/s)"]) for row in rows]
    np.testing.assert_allclose(rotor_3, speeds.rotor_3, rtol=1e-8)
    assert b"\r" not in table.read_bytes() + metrics.read_bytes()
    assert load_scenario(scenario) == flight.scenario
    with metrics.open(encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert row.pop("crash_time") == ""
    np.testing.assert_allclose([float(value) for value in row.values()], flight.metrics[:-1], rtol=1e-11)
    names = ["flight.csv", "flight.npz", "metrics.csv", "scenario.yaml"]
    assert sorted(path.name for path in arrays.parent.iterdir()) == names


def test_a_saved_scenario_repeats_the_flight(flight, tmp_path):
    again = simulate(load_scenario(flight.save(tmp_path)[2]))
    np.testing.assert_array_equal(again["state"], flight["state"])


def test_a_folder_that_cannot_be_written_is_refused(flight, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write to the output folder .*file:"):
        flight.save(tmp_path / "file")


def test_a_scenario_that_does_not_belong_to_a_flight_is_not_overwritten(flight, tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text("mine: {extends: hover}")
    with pytest.raises(InputError, match=r"scenario\.yaml does not belong to a flight and would be overwritten"):
        flight.save(tmp_path)
    assert [*tmp_path.iterdir()] == [path]
    assert path.read_text() == "mine: {extends: hover}"
    path.unlink()
    flight.save(tmp_path)
    assert len(flight.save(tmp_path)) == 4


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_plots_label_every_axis_with_a_unit(flight, tmp_path):
    assert [path.name for path in save_plots(flight, tmp_path)] == [f"{name}.png" for name in PLOTS]
    for plot in PLOTS.values():
        for axes in plot(flight).axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            shared = [label for label in labels if label]
            assert all("(" in label for label in shared)


def test_path_plot_shows_the_flown_path_and_the_reference(flight):
    _, plane = PLOTS["path"](flight).axes
    drawn = {line.get_label(): line.get_xydata() for line in plane.get_lines()}
    for label, signal in (("flown", "state"), ("reference", "reference")):
        record = flight.record(signal)
        np.testing.assert_array_equal(drawn[label].T, [record.x, record.y])


ALL_IMPERFECTIONS = [
    "crash.position_error=50",
    "duration=6",
    "vehicle.mass={normal: {mean: 0.7, standard_deviation: 0.03, min: 0.6}}",
    "vehicle.inertia=[{uniform: {min: 0.0065, max: 0.0075}}, 0.007, 0.012]",
    "vehicle.thrust_factor_error=[{normal: {mean: 0, standard_deviation: 0.002, min: -0.1}}, 0.001, 0, -0.001]",
    "vehicle.centre_of_mass=[{uniform: {min: -0.0005, max: 0.0005}}, 0.0002]",
    "vehicle.battery_sag=0.03",
    "laboratory.motion_capture.misalignment=[0.01, {uniform: {min: -0.02, max: 0.02}}, 0.02]",
    "laboratory.motion_capture.dropout_rate=0.02",
    "laboratory.motion_capture.latency_frames={choice: [0, 1]}",
    "laboratory.command_link.delay_ticks={choice: [0, 1, 2]}",
    "control.position.k_p=[{uniform: {min: 0.2, max: 0.3}}, 0.25, 5]",
]
STEADY_WIND = "{kind: steady, velocity: [{uniform: {min: -1, max: 1}}, 0.5, 0]}"
FAN_WIND = (
    "{kind: fan, position: [-1.2, -5.5, 1.5], direction: [0, 1, 0], flow: {uniform: {min: 2, max: 3}}, diameter: 0.75}"
)
DRYDEN_WIND = "{kind: dryden, level: light}"
GUST_WIND = "{kind: gust, velocity: [1, 0, 0], start: 2, rise_time: 0.5}"
ALL_WINDS = f"laboratory.wind=[{STEADY_WIND}, {FAN_WIND}, {DRYDEN_WIND}, {GUST_WIND}]"


@pytest.fixture(scope="module")
def imperfect(diagrams):
    return load_scenario(diagrams / "laboratory.yaml:high_wind", [*ALL_IMPERFECTIONS, ALL_WINDS])


def final_positions(scenario, samples, seed):
    """Return the (3, N) final positions of the vehicles of a fleet, m."""
    diagram = build_fleet_diagram(Batch.draw(scenario, samples, seed=seed), plan_route(scenario))
    simulator = Simulator(diagram)
    fly(simulator, 6.0)
    return diagram.GetOutputPort("state").Eval(simulator.get_context()).reshape(12, -1)[:3]


@pytest.mark.long
def test_a_repeated_sample_has_a_bitwise_equal_flight(imperfect):
    first, again = (simulate(imperfect, seed=3, sample=7) for _ in range(2))
    for name in first.signals:
        np.testing.assert_array_equal(first[name], again[name])
    other = simulate(imperfect, seed=3, sample=8)
    assert np.abs(other["state"] - first["state"])[-1, :3].max() > 0.01
    assert np.abs(simulate(imperfect, seed=4, sample=7)["state"] - first["state"])[-1, :3].max() > 0.01


@pytest.mark.long
def test_the_flight_of_a_sample_does_not_depend_on_the_other_vehicles_of_the_fleet(imperfect):
    """The final positions agree to 1e-9 m."""
    alone = simulate(imperfect, seed=3, sample=7, compiled=False)["state"][-1, :3]
    for samples, index in (([7, 2], 0), (range(12), 7), ([40, 7, 1], 1)):
        position = final_positions(imperfect, samples, seed=3)[:, index]
        np.testing.assert_allclose(position, alone, rtol=0.0, atol=1e-9)


@pytest.mark.slow
def test_identical_vehicles_have_individual_wind_and_noise(diagrams):
    """The first vehicle has the wind and noise of the scenario's sample; the others follow in order of the samples."""
    scenario = load_scenario(diagrams / "outdoor.yaml", ["duration=1", "sample=3"])
    diagram = build_tracking_diagram(scenario, 3)
    alone = [simulate(scenario, sample=sample, compiled=False)["wind"][-1] for sample in (3, 4, 5)]
    assert np.ptp(alone, axis=0).min() > 1e-3
    # The wind that is recorded at a tick is the wind of the time step before this tick.
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.0)
    wind = diagram.GetOutputPort("wind").Eval(simulator.get_context()).reshape(3, 3)
    np.testing.assert_allclose(wind, np.transpose(alone), atol=1e-9)


@pytest.mark.long
def test_samples_that_are_recorded_in_a_fleet_fly_as_they_fly_alone(imperfect):
    """Each flight has a scenario with the drawn values and the index of its sample."""
    flights = simulate_samples(imperfect, [40, 7], seed=3)
    alone = simulate(imperfect, seed=3, sample=7, compiled=False)
    assert [flight.scenario.sample for flight in flights] == [40, 7]
    assert flights[1].scenario == alone.scenario
    assert flights[0].scenario.vehicle.mass != alone.scenario.vehicle.mass
    for name in alone.signals:
        np.testing.assert_allclose(flights[1][name], alone[name], atol=1e-7, err_msg=name)


@pytest.mark.long
def test_wind_and_noise_do_not_depend_on_other_distributions(imperfect, diagrams):
    fixed = draw_sample(imperfect, 5)
    other = fixed.model_copy(update={"vehicle": fixed.vehicle.model_copy(update={"mass": 0.75})})
    a, b = simulate(fixed), simulate(other)
    assert np.abs(a["state"] - b["state"]).max() > 1e-3
    # The noise is the difference of measurement and state if there are no filters and no dropouts.
    overrides = [
        "duration=2",
        f"laboratory.wind=[{DRYDEN_WIND}]",
        "laboratory.motion_capture.derivative_bandwidth=null",
    ]
    masses = ("0.68", "{uniform: {min: 0.6, max: 0.8}}")
    scenarios = [
        load_scenario(diagrams / "laboratory.yaml:nominal", [*overrides, f"vehicle.mass={mass}"]) for mass in masses
    ]
    a, b = (simulate(scenario, sample=2) for scenario in scenarios)
    assert a.scenario.vehicle.mass != b.scenario.vehicle.mass
    np.testing.assert_array_equal(a["wind"], b["wind"])
    noise = [flight["measurement"][0, :6] - flight["state"][0, :6] for flight in (a, b)]
    np.testing.assert_allclose(noise[0], noise[1], atol=1e-12)
    assert np.abs(noise[0]).min() > 1e-6


@pytest.mark.slow
def test_turbulence_does_not_depend_on_other_wind_sources(diagrams):
    winds = []
    for sources in (f"[{DRYDEN_WIND}]", f"[{GUST_WIND}, {DRYDEN_WIND}]"):
        winds.append(
            simulate(load_scenario(diagrams / "hover.yaml", ["duration=2", f"laboratory.wind={sources}"]))["wind"]
        )
    np.testing.assert_allclose(winds[1][:90], winds[0][:90], atol=1e-12)


@pytest.mark.long
def test_a_saved_sample_repeats_its_flight(imperfect, tmp_path):
    flight = simulate(imperfect, seed=3, sample=7)
    again = simulate(load_scenario(flight.save(tmp_path)[2]))
    np.testing.assert_array_equal(again["state"], flight["state"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "vehicle.rotor_failure={rotor: 2, time: 3.0}",
        "laboratory.wind=[{kind: gust, velocity: [60, 0, 0], start: 3, rise_time: 0.2}]",
    ],
)
def test_failures_and_strong_gusts_end_in_a_crash_with_finite_metrics(diagrams, fault):
    flight = simulate(load_scenario(diagrams / "laboratory.yaml:nominal", [fault]))
    assert 3.0 < flight.metrics.crash_time < 8.0
    assert all(np.isfinite(value) for value in flight.metrics[:-1])
    assert np.isfinite(flight["state"]).all()


@pytest.mark.long
@pytest.mark.usefixtures("unrendered_figures")
def test_a_flight_that_diverged_can_be_plotted(diagrams, tmp_path):
    flight = simulate(load_scenario(diagrams / "outdoor.yaml", ["duration=1"]))
    flight["state"][-1] = np.nan
    assert (tmp_path / "wind.png") in save_plots(flight, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["{kind: x}", "{kind: h, length: 0.2, width: 0.3, rotor_1_turns: anticlockwise}"])
def test_other_rotor_layouts_fly_like_the_plus_if_no_rotor_saturates(diagrams, layout):
    """Small differences remain, because rotor speeds lag their commands and thrust is not linear in rotor speed.

    The error is larger if the layout of the vehicle is not the layout that the controller assumes.
    """
    plus, other, mistaken = (
        simulate(load_scenario(diagrams / "figure_eight.yaml", ["duration=6", *overrides]), compiled=True)
        for overrides in ([], [f"nominal.layout={layout}"], [f"nominal.layout={layout}", "vehicle.layout={kind: plus}"])
    )
    assert other.metrics.rmse == pytest.approx(plus.metrics.rmse, rel=1e-3)
    np.testing.assert_allclose(other["state"], plus["state"], atol=1e-3)
    assert np.abs(other["rotor_speed"] - plus["rotor_speed"]).max() > 0.05
    assert mistaken.metrics.rmse > 1.5 * plus.metrics.rmse


def test_the_controller_uses_the_nominal_parameters(diagrams):
    """A vehicle that is heavier by Δm hovers Δm g / (m k_P) lower, since the controller does not know its mass."""
    scenario = load_scenario(diagrams / "hover.yaml", ["route.duration=20", "vehicle.mass=0.75"])
    height = simulate(scenario).record("state").z[-1]
    nominal = load_scenario(diagrams / "hover.yaml", ["route.duration=20", "nominal.mass=0.75"])
    assert nominal.vehicle.mass == 0.75
    assert simulate(nominal).record("state").z[-1] == pytest.approx(1.0, abs=1e-9)
    # The commanded vertical thrust is 0.68 (9.81 + k_P e), and it must be 0.75 · 9.81.
    k_p = scenario.control.position.k_p[2]
    assert 1.0 - height == pytest.approx((0.75 / 0.68 - 1.0) * 9.81 / k_p, rel=0.01)


def test_the_repr_of_a_flight_is_one_line_that_names_its_signals(diagrams):
    scenario = load_scenario(diagrams / "hover.yaml", ["duration=1"])
    for compiled, suffix in ((False, ""), (True, ", compiled")):
        flight = simulate(scenario, compiled=compiled)
        line = rf"<Flight of hover{suffix}: 1\.00 s, RMSE \S+ cm; reference, .*wind, crashed>"
        assert re.fullmatch(line, repr(flight))
    with pytest.raises(KeyError, match="weights is not a signal of this flight; its signals are reference, "):
        flight["weights"]


def test_a_user_defined_wind_may_be_a_leaf_system_or_a_fleet_system(diagrams):
    """The flights with both systems are equal. The wind depends on the position, and neither system has a state."""
    scenario = load_scenario(diagrams / "figure_eight.yaml", ["duration=2", "vehicle.linear_drag=0.3"])

    class Leaf(LeafSystem):
        def __init__(self):
            super().__init__()
            state = self.DeclareVectorInputPort("state", BasicVector(12))
            self.DeclareVectorOutputPort(
                "wind", BasicVector(3), lambda context, output: output.SetFromVector(shear(State(*state.Eval(context))))
            )

    @fleet_system(float)
    class Fleet(FleetSystem):
        def declare(self):
            self.output("wind", shear, self.input("state"))

    def shear(state):
        return Wind(2.0 * state.z, 0.5 * state.x, 0.0)

    flights = [simulate(scenario, wind=wind) for wind in (Leaf(), Fleet())]
    np.testing.assert_allclose(flights[0]["state"], flights[1]["state"], rtol=0.0, atol=1e-12)


@pytest.mark.long
def test_forces_on_a_continuous_state_jump_at_the_exact_instant(diagrams):
    """A rotor fails between two ticks, and a vehicle drops its load between two ticks."""
    instant = 0.287654321
    base_overrides = ["vehicle.time_step=0", "duration=0.4", "crash.tilt=null"]
    failing = load_scenario(
        diagrams / "hover.yaml", [*base_overrides, f"vehicle.rotor_failure={{rotor: 2, time: {instant}}}"]
    )
    flight = simulate(failing)
    coasting = np.exp(-np.maximum(flight.time - instant, 0.0) / failing.vehicle.rotor_time_constant)
    speed = flight["rotor_speed"]
    np.testing.assert_allclose(speed[:, 1], speed[0, 1] * coasting, rtol=1e-7)
    np.testing.assert_allclose(speed[:, 0][flight.time <= instant], speed[0, 0], rtol=1e-12)

    idle_overrides = ["control.position={k_p: [0, 0, 0], k_d: [0, 0, 0]}", "vehicle.rotor_time_constant=0.005"]
    drop = f"vehicle.payload={{mass: 0.1, time: {instant}, event: dropped}}"
    dropping = load_scenario(diagrams / "hover.yaml", [*base_overrides, *idle_overrides, drop])
    flight = simulate(dropping)
    climb_rate = flight["state"][:, 8]
    mass = dropping.vehicle.mass
    after = flight.time > instant
    rate_change = -0.1 * dropping.vehicle.gravity / (mass + 0.1) * (instant - flight.time[~after][-1])
    np.testing.assert_allclose(climb_rate[after], climb_rate[~after][-1] + rate_change, atol=1e-7)
    assert climb_rate[-1] < -0.2
    (sensitivity,) = flight_sensitivities(dropping, ["vehicle.mass"]).gradients["rmse"]
    assert np.isfinite(sensitivity)
