"""Tests of axis models, by comparison with the whole diagram and with flights, and of LQG designs and their limits."""

import dataclasses
import types

import numpy as np
import pytest
import scipy

from drake_quad import InputError, load_scenario, simulate
from drake_quad.control.lqg.chains import SecondOrderResponse
from drake_quad.control.lqg.design import Timing
from drake_quad.design import lqg as lqg_design
from drake_quad.design.cascade import design_cascade
from drake_quad.design.lqg import (
    ActualPlant,
    Conditions,
    LqgLimits,
    Plant,
    candidate_timings,
    considered_plants,
    design_lqg,
    flight_conditions,
    lateral_plant_model,
    measurement_noise,
    median_scenario,
    predict_performance,
    snap_limit,
    vertical_plant_model,
)
from drake_quad.flight.simulation import simulate_batch
from drake_quad.linear.disturbances import DisturbanceStatistics
from drake_quad.linear.link_margins import link_loops, link_margins
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.scenario.batch import Batch

NO_DISTURBANCE = DisturbanceStatistics(mean=0.0, deviation=0.0, time=0.5)  # m/s² and s
# The chain of lags and integrators is an exact model of a vehicle without drag.
NO_DRAG = ("vehicle.linear_drag=0", "vehicle.quadratic_drag=0", "laboratory.motion_capture.dropout_rate=0")
NO_DRAG_BUT_DELAYS = (*NO_DRAG, "laboratory.motion_capture.latency_frames=1", "laboratory.command_link.delay_ticks=2")


@pytest.fixture(scope="module")
def shipped(diagrams):
    def loaded(*overrides):
        return load_scenario(
            f"{diagrams}/laboratory.yaml:nominal", overrides, layers=[f"{diagrams}/controllers/lqg.yaml:lqg"]
        )

    return loaded


def timing_of(scenario):
    laboratory = scenario.laboratory
    return scenario.control.timing(laboratory.motion_capture.period, laboratory.command_link.period)


@pytest.fixture(scope="module")
def low_wind(diagrams):
    """Return a scenario with a controller that is designed for the default limits, and the scenario's `Conditions`."""
    scenario = load_scenario(
        f"{diagrams}/laboratory.yaml:low_wind", layers=[f"{diagrams}/controllers/lqg.yaml:lqg_low_wind"]
    )
    return scenario, flight_conditions(scenario)


def axes_of(scenario, plant, conditions):
    """Return the loop and the actual plant along x, those along z, and the timing."""
    timing, gravity = timing_of(scenario), scenario.nominal.gravity
    loops = [axis.loop(timing, gravity) for axis in (scenario.control.lateral, scenario.control.vertical)]
    models = lateral_plant_model(plant, conditions), vertical_plant_model(plant, conditions)
    actual_plants = [ActualPlant.of(model, plant, conditions, timing, gravity) for model in models]
    return [*zip(loops, actual_plants, strict=True)], timing


def loop_transfer(loop, actual_plant, timing):
    """Return the loop transfer function L of an axis, with the loop broken at the command link."""
    lifted = lqg_design._LiftedLoops.of(loop, [actual_plant], timing)
    names = tuple(str(i) for i in range(lifted.command.shape[1]))
    matrices = lifted.opened[0], lifted.lost[0], -lifted.command, np.zeros((1, 1))
    return SampledSystem(*matrices, timing.tick, names, ("u",), ("loop",))


@pytest.mark.long
@pytest.mark.parametrize(("overrides", "plant"), [(NO_DRAG, (0, 1)), (NO_DRAG_BUT_DELAYS, (1, 2))])
def test_the_loop_of_an_axis_equals_the_loop_of_the_whole_diagram(shipped, overrides, plant):
    scenario = shipped(*overrides)
    conditions = Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, 0.0)
    axes, timing = axes_of(scenario, Plant(True, 0.05, None, *plant), conditions)
    exact = link_loops(scenario)
    z = np.exp(1j * np.geomspace(0.5, 100.0, 40) * timing.tick)
    for (loop, actual_plant), signal in zip(axes, ("tau_y", "thrust"), strict=True):
        response, expected = (
            each.response(z)[:, 0, 0] for each in (loop_transfer(loop, actual_plant, timing), exact[signal])
        )
        np.testing.assert_allclose(response, expected, rtol=2e-2)


@pytest.mark.slow
def test_the_prediction_for_a_plant_does_not_depend_on_the_other_plants(shipped):
    """The plant with the longest delay sets the size of the matrices. An unstable plant does not affect the others."""
    conditions = Conditions(DisturbanceStatistics(0.2, 0.3, 0.5), NO_DISTURBANCE, 2.0, 1e-3, 4e-3, 0.03)
    delays = [(0, 1), (2, 0), (0, 6), (1, 2)]
    axes = [axes_of(shipped(), Plant(True, 0.05, None, *each), conditions) for each in delays]
    timing = axes[0][1]
    z = np.exp(1j * np.geomspace(0.5, 100.0, 40) * timing.tick)
    for number in (0, 1):
        loop, actual_plants = axes[0][0][number][0], [pairs[number][1] for pairs, _ in axes]
        together = lqg_design._LiftedLoops.of(loop, actual_plants, timing)
        alone = [predict_performance(loop, actual_plant, timing) for actual_plant in actual_plants]
        assert np.isinf([each.error for each in alone]).tolist() == [False, False, True, False]
        np.testing.assert_allclose(together.predicted(), alone, rtol=1e-7)
        expected = 1.0 / (1.0 + loop_transfer(loop, actual_plants[0], timing).response(z)[:, 0, 0])
        np.testing.assert_allclose(together.sensitivity(z), expected, rtol=1e-6)


def test_stationary_covariances_match_an_independent_solver():
    rng = np.random.default_rng(0)
    sizes = np.array([0.3, 0.5, 0.7, 0.9, 0.95, 0.99, 0.999, 0.9999])
    A = rng.normal(size=(len(sizes), 6, 6))
    A *= (sizes / np.abs(np.linalg.eigvals(A)).max(axis=1))[:, np.newaxis, np.newaxis]
    roots = rng.normal(size=(2, len(sizes), 6, 6)) * np.array([1e-6, 1.0])[:, None, None, None]
    Q = roots @ roots.transpose(0, 1, 3, 2)
    for i, j in np.ndindex(2, len(sizes)):
        (covariance,) = lqg_design._stationary_covariance(A[j : j + 1], Q[i, j : j + 1])
        np.testing.assert_allclose(covariance, scipy.linalg.solve_discrete_lyapunov(A[j], Q[i, j]), rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(("overrides", "plant", "loss"), [(NO_DRAG, (0, 1), 0.01), (NO_DRAG_BUT_DELAYS, (1, 2), 0.05)])
def test_the_predicted_error_matches_flights_in_hover(shipped, overrides, plant, loss):
    """The flights have only noise and lost commands. 64 flights of 10 s determine the error to a few per cent."""
    scenario = shipped(
        *overrides,
        "route={kind: hover, position: [0, 0, 1], duration: 12}",
        "metrics={start: 2, end: null}",
        f"laboratory.command_link.loss_rate={loss}",
    )
    axes, timing = axes_of(
        scenario, Plant(True, 0.05, None, *plant), Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, loss)
    )
    errors = [predict_performance(loop, actual_plant, timing).error for loop, actual_plant in axes]
    flights = simulate_batch(Batch.draw(scenario, range(64)), compiled=True)
    simulated = np.sqrt(np.mean([(flight["state"][100:, :3] - [0, 0, 1]) ** 2 for flight in flights], axis=(0, 1)))
    np.testing.assert_allclose(simulated, [errors[0], errors[0], errors[1]], rtol=0.1)


def test_an_unstable_loop_has_an_infinite_error(shipped):
    axes, timing = axes_of(
        shipped(), Plant(True, 0.05, None, 0, 6), Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, 0.0)
    )
    for loop, actual_plant in axes:
        prediction = predict_performance(loop, actual_plant, timing)
        assert prediction.error == np.inf
        assert prediction.pole > 1.0


def test_considered_plants_span_the_distributions_or_the_assumed_uncertainty(diagrams):
    drawn = considered_plants(load_scenario(f"{diagrams}/robustness.yaml"))
    assert {(each.latency_frames, each.delay_ticks) for each in drawn[1:]} == {(0, 1), (1, 3)}
    assert sorted({round(each.lag, 4) for each in drawn}) == [0.035, 0.055, 0.075]
    nominal = considered_plants(load_scenario(f"{diagrams}/laboratory.yaml:nominal"))
    assert nominal[0]._replace(thrust_gain=1.0) == Plant(True, 0.05, None, 0, 1)
    assert nominal[0].thrust_gain == pytest.approx(1.0, abs=0.01)
    assert {(round(each.lag, 5), each.latency_frames, each.delay_ticks) for each in nominal[1:]} == {
        *((0.03125, 0, 1), (0.03125, 1, 2)),
        *((0.08, 0, 1), (0.08, 1, 2)),
    }
    on_board = considered_plants(load_scenario(f"{diagrams}/onboard.yaml"))
    assert on_board[0].response == SecondOrderResponse(8.817, 0.7259)
    assert on_board[0].has_series_lag
    identified, *others = considered_plants(load_scenario(f"{diagrams}/vehicles/neural_fly.yaml:still"))
    assert (identified.response, identified.has_series_lag) == (SecondOrderResponse(6.75, 0.48), False)
    # The slope of the thrust curve over the throttle is 18.27 N for the vehicle, and 14.27 N for the nominal vehicle.
    assert identified.thrust_gain == pytest.approx(18.2656 / 14.27, rel=0.02)
    # Plants with faster rotors have a faster attitude response.
    assert all((other.lag < identified.lag) == (other.response.natural_frequency > 6.75) for other in others)


def test_design_conditions_are_the_disturbances_and_noise_of_the_scenario(diagrams, low_wind):
    _, conditions = low_wind
    # When the shipped controller was designed, the disturbing acceleration in flights had a standard deviation of
    # 0.205 m/s² and a time constant of 0.6 s.
    assert conditions.lateral.deviation == pytest.approx(0.19, abs=0.03)
    assert conditions.lateral.time == pytest.approx(0.7, abs=0.1)
    assert (conditions.position_noise, conditions.attitude_noise, conditions.loss_rate) == (1e-3, 4e-3, 0.01)
    bad_day = flight_conditions(load_scenario(f"{diagrams}/robustness.yaml"))
    # A log-uniform variable on [a, b] has the mean square (b² - a²) / (2 log(b / a)). If the centre of mass is off
    # centre by 1 mm, the disturbing snap is 9.5 m/s⁴.
    assert bad_day.position_noise == pytest.approx(np.sqrt((0.004**2 - 0.0005**2) / (2.0 * np.log(8.0))), rel=0.01)
    assert 5.0 < bad_day.bias < 14.0


def test_the_smallest_bias_is_assumed_for_a_vehicle_with_an_identified_attitude_response(diagrams):
    """The bias is a constant disturbance of the angular motion. Its smallest value applies in an ideal laboratory."""
    identified = flight_conditions(
        load_scenario(f"{diagrams}/vehicles/neural_fly.yaml:wind_8", ["duration=2", "metrics.start=0"])
    )
    ideal = flight_conditions(load_scenario(f"{diagrams}/figure_eight.yaml", ["duration=2", "metrics.start=0"]))
    assert identified.bias == ideal.bias
    assert identified.lateral.mean > 5.0 * ideal.lateral.mean


@pytest.mark.slow
def test_the_snap_limit_allows_twice_the_torque_that_balances_an_offset_centre_of_mass():
    """An offset r of the centre of mass causes the angular acceleration m g r / I, and therefore the snap m g² r / I.

    This snap is five times larger for the Crazyflie.
    """
    limits, constant_snap, limit_of = LqgLimits(), {}, {}
    for name in ("bad_day:crazyflie", "robustness"):
        scenario = load_scenario(name)
        conditions, vehicle = flight_conditions(scenario), median_scenario(scenario).vehicle
        levers = Batch.draw(scenario, range(32)).varying["vehicle.centre_of_mass.0"]
        constant_snap[name] = vehicle.mass * vehicle.gravity**2 * np.sqrt(np.mean(levers**2)) / vehicle.inertia[0]
        # An angular acceleration of 1 rad/s² causes a snap of g · 1 rad/s². Unequal rotors also contribute to the bias.
        assert 0.6 * conditions.bias < constant_snap[name] < 1.2 * conditions.bias
        limit_of[name] = snap_limit(limits, conditions)
    assert limit_of["robustness"] == limits.snap
    assert limit_of["bad_day:crazyflie"] > 1.8 * constant_snap["bad_day:crazyflie"] > limits.snap


def test_the_mean_delay_of_the_plants_is_rounded_to_the_nearest_and_to_the_next_larger_tick(diagrams):
    # Frames are at most 10 ms late and commands 1 to 3 ticks of 20 ms, so the mean delay of the plants is 2.3 ticks.
    bad_day = load_scenario(f"{diagrams}/robustness.yaml")
    assert candidate_timings(bad_day, considered_plants(bad_day)) == [Timing(0.01, 0.02, ticks) for ticks in (2, 3)]
    plants = [Plant(True, 0.05, None, 1, ticks) for ticks in (1, 1, 2)]
    assert [each.delay_ticks for each in candidate_timings(bad_day, plants)] == [2]


@pytest.mark.long
def test_the_assumed_noise_of_an_estimate_is_that_of_its_changes_within_a_second():
    cameras = load_scenario("laboratory:nominal", ["laboratory.motion_capture.position_noise=0.003"])
    assert measurement_noise(cameras) == (0.003, cameras.laboratory.motion_capture.attitude_noise)
    scenario = load_scenario("warehouse_uwb")
    position, attitude = measurement_noise(scenario)
    flight = simulate(scenario, sample=7)
    error = (flight["measurement"] - flight["state"])[:1000]
    change = np.sqrt(0.5 * np.square(error[50:] - error[:-50]).mean(axis=0))
    assert position == pytest.approx(np.sqrt(np.square(change[:3]).mean()), rel=0.5)
    assert attitude == pytest.approx(np.sqrt(np.square(change[3:5]).mean()), rel=0.5)


@pytest.mark.long
def test_a_design_satisfies_its_limits_with_a_state_estimator_in_the_loop():
    scenario, limits = load_scenario("warehouse_uwb"), LqgLimits(sensitivity=1.8)
    designed = scenario.model_copy(update={"control": design_lqg(scenario, limits).control})
    margins = [each for each in link_margins(designed).values() if each is not None]
    assert 1.0 < max(each.sensitivity for each in margins) <= limits.sensitivity
    assert min(each.delay for each in margins) >= limits.delay


@pytest.mark.long
def test_a_shipped_design_reaches_the_default_limits(low_wind):
    """Limits increase the error, so the best design reaches the limits on the sensitivity peak and on the snap."""
    scenario, conditions = low_wind
    limits, margins = LqgLimits(), [*link_margins(median_scenario(scenario)).values()]
    assert 0.99 * limits.sensitivity < max(each.sensitivity for each in margins) <= limits.sensitivity
    assert min(each.delay for each in margins) >= limits.delay
    axes, timing = axes_of(scenario, considered_plants(scenario)[0], conditions)
    lateral, vertical = (predict_performance(loop, actual_plant, timing).command for loop, actual_plant in axes)
    assert 0.99 * limits.snap < lateral <= snap_limit(limits, conditions) == limits.snap
    assert vertical <= limits.acceleration


@pytest.mark.long
@pytest.mark.parametrize("best_delay", [1, 2])
@pytest.mark.parametrize("name", ["laboratory.yaml:low_wind", "onboard.yaml"])
def test_a_design_assumes_the_delay_with_the_smallest_cost_and_limits_the_command_of_each_axis(
    low_wind, diagrams, monkeypatch, name, best_delay
):
    """The command along z is an acceleration. Along x and y, it is an acceleration with an autopilot, else a snap."""
    scenario, (shipped, conditions) = load_scenario(f"{diagrams}/{name}"), low_wind
    timings = [Timing(0.01, 0.02, ticks) for ticks in (1, 2)]
    stubs = {"flight_conditions": conditions, "candidate_timings": timings, "_yaw_pd": shipped.control.yaw}
    for function, value in stubs.items():
        monkeypatch.setattr(lqg_design, function, lambda *_, value=value: value)
    searches = []

    def record_search(search):
        searches.append(search)
        return dataclasses.replace(search, cost=abs(search.timing.delay_ticks - best_delay))

    monkeypatch.setattr(lqg_design._LqgSearch, "improved", record_search)
    limits = LqgLimits(sensitivity=1e3, delay=1e-6, snap=50.0, acceleration=5.0)
    design = design_lqg(scenario, limits)
    assert design.control.delay_ticks == best_delay
    first, second, vertical = searches
    assert first.max_command == second.max_command == (5.0 if design.plants[0].response else 50.0)
    assert vertical.max_command == 5.0
    assert (first.timing, second.timing, vertical.timing) == (*timings, timings[best_delay - 1])
    assert {each.chain_limits for each in searches} == {limits}


@pytest.mark.long
def test_a_design_flies_within_its_limits(diagrams, monkeypatch):
    """The exact loop satisfies the limits, although the axis models do not include the tilt due to drag."""
    monkeypatch.setattr(lqg_design, "_MAX_EVALUATIONS", 30)
    scenario = load_scenario(f"{diagrams}/vehicles/neural_fly.yaml:wind_8_sine", ["route.laps=2", "metrics.start=6.3"])
    design = design_lqg(scenario, LqgLimits(sensitivity=2.2, delay=0.05))
    assert all(np.isfinite(each.error) for each in (*design.lateral, *design.vertical))
    assert design.control.yaw is None
    # The commanded tilt depends on the estimated disturbance along z. A design could reduce the height error by
    # assuming a larger disturbance, but the tilt would become noisier. The design therefore assumes the disturbance of
    # flights.
    assert design.control.vertical.second.deviation == pytest.approx(design.conditions.vertical.deviation, rel=1e-3)
    assert design.control.max_tilt == 1.2
    designed = scenario.model_copy(update={"control": design.control})
    margins = [each for each in link_margins(median_scenario(designed)).values() if each is not None]
    assert max(each.sensitivity for each in margins) <= 2.2
    assert min(each.delay for each in margins) >= 0.05
    (flight,) = simulate_batch(Batch.draw(designed, [0]), compiled=True)
    (other,) = simulate_batch(Batch.draw(scenario, [0]), compiled=True)
    assert flight.metrics.rmse < 0.2 * other.metrics.rmse


@pytest.mark.parametrize(
    ("lags", "response", "polynomial"),
    [
        (True, None, [0.05, 1.0, 0.0, 0.0]),
        (False, SecondOrderResponse(7.0, 0.6), [1.0, 2.0 * 0.6 * 7.0, 7.0**2]),
        (True, SecondOrderResponse(7.0, 0.6), [0.05, 1.0, 2.0 * 0.6 * 7.0, 7.0**2]),
    ],
)
def test_plant_models_have_the_transfer_functions_of_attitude_and_position(lags, response, polynomial):
    """Each plant has the transfer function of its lag, 1 / (s² (T s + 1)), or of the autopilot's response."""
    conditions = Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, 0.0)
    plant = Plant(lags, 0.05, response, 0, 1, thrust_gain=1.3)
    s = 2.0 + 3.0j
    _, A, B, C, _ = lateral_plant_model(plant, conditions)
    position, thrust = (C @ np.linalg.solve(s * np.eye(len(A)) - A, B)).ravel()
    expected = (1.0 if response is None else response.natural_frequency**2) / np.polyval(polynomial, s)
    np.testing.assert_allclose([position, thrust], [expected / s**2, expected], rtol=1e-12)
    _, A, B, C, _ = vertical_plant_model(plant, conditions)
    height = (C @ np.linalg.solve(s * np.eye(len(A)) - A, B)).item()
    assert height == pytest.approx(1.3 / (s**2 * (0.05 * s + 1.0)), rel=1e-12)


@pytest.fixture(scope="module")
def search_of(shipped):
    """Return a function that creates a search along x for plants with given link delays, in ticks."""
    scenario = shipped()
    timing, control = timing_of(scenario), scenario.control
    loop = control.lateral.loop(timing, scenario.nominal.gravity)
    conditions = Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, 0.0)

    def make(*delays, limits=LqgLimits(sensitivity=1e3, delay=1e-6), max_command=1e6, loop_of=lambda axis: loop):
        plants = [Plant(True, 0.05, None, 0, delay) for delay in delays]
        actual_plants = [
            ActualPlant.of(lateral_plant_model(plant, conditions), plant, conditions, timing, scenario.nominal.gravity)
            for plant in plants
        ]
        return lqg_design._LqgSearch(
            lambda number: control.lateral, loop_of, actual_plants, max_command, timing, (1.0,), limits
        )

    return make


def test_the_cost_within_the_limits_is_the_logarithm_of_the_rms_error_over_all_plants(search_of):
    search = search_of(1, 2)
    _, (first, second) = search.result()
    cost = search.cost_of(np.zeros(1))
    assert cost == pytest.approx(0.5 * np.log(0.5 * (first.error**2 + second.error**2)), rel=1e-9)
    assert search_of(1).cost_of(np.zeros(1)) == pytest.approx(np.log(first.error), rel=1e-9)
    for change in (
        {"limits": LqgLimits(1.01, 1e-6)},
        {"limits": LqgLimits(1e3, 1.0)},
        {"max_command": 0.5 * first.command},
    ):
        assert search_of(1, 2, **change).cost_of(np.zeros(1)) > cost + 0.1
    assert search_of(1, 2, max_command=1.01 * first.command).cost_of(np.zeros(1)) == cost


def test_unstable_designs_cost_more_than_stable_ones(search_of):
    """The cost of an unstable loop increases with its largest pole. It is highest if the nominal plant is unstable."""
    stable, with_delay, with_longer_delay = (
        search_of(*delays).cost_of(np.zeros(1)) for delays in ((1,), (1, 6), (1, 9))
    )
    unstable, more_unstable = (search_of(delay, 1).cost_of(np.zeros(1)) for delay in (6, 9))
    assert stable + 10.0 < with_delay
    assert with_delay < unstable
    poles = [
        predict_performance(each.loop_of(None), each.actual_plants[0], each.timing).pole
        for each in map(search_of, (6, 9))
    ]
    assert (with_delay < with_longer_delay) == (unstable < more_unstable) == (poles[0] < poles[1])

    def failing(axis):
        raise np.linalg.LinAlgError

    assert search_of(1, loop_of=failing).cost_of(np.zeros(1)) > max(unstable, more_unstable)
    with pytest.raises(
        InputError,
        match=r"no LQG design is stable for the nominal plant: the best design has a pole of magnitude 1\.\d{4}",
    ):
        search_of(6).result()


class SearchWithKnownOptimum(lqg_design._LqgSearch):
    """Search with a known cost: the squared distance from given logarithms of the parameters, but at most 9."""

    best = np.log([3e-3, 0.7, 40.0])

    def cost_of(self, logs):
        return min(float(np.sum((logs - self.best) ** 2)), 9.0)


@pytest.mark.parametrize("initial_weight", [3e-6, 3e-3, 3.0])
def test_a_search_finds_the_minimum_cost_for_any_initial_weight(search_of, initial_weight):
    """The other parameters start within a factor of 2.5 of their best values."""
    start = search_of(1)
    search = SearchWithKnownOptimum(*(getattr(start, name) for name in start.__dataclass_fields__))
    result = dataclasses.replace(search, values=(initial_weight, 0.3, 60.0)).improved()
    np.testing.assert_allclose(result.values, np.exp(SearchWithKnownOptimum.best), rtol=1e-3)
    assert result.cost == pytest.approx(result.cost_of(np.log(result.values)), abs=1e-12)
    assert (result.actual_plants, result.timing) == (start.actual_plants, start.timing)


def test_a_limit_is_tightened_by_slightly_more_than_the_exact_loop_violates_it(search_of):
    """A signal without feedback has no margins (None), and therefore changes no limit."""
    limits = LqgLimits(sensitivity=3.0, delay=0.03)
    search = search_of(1, limits=limits._replace(sensitivity=2.5, delay=0.04))

    def margins_of_loop(sensitivity, delay):
        return types.SimpleNamespace(sensitivity=sensitivity, delay=delay)

    assert search.with_tighter_limits(limits, (margins_of_loop(3.0, 0.03), None)) is search
    assert search.with_tighter_limits(limits, (None, None)) is search
    with_tighter_sensitivity = search.with_tighter_limits(
        limits, (margins_of_loop(2.0, 0.05), margins_of_loop(4.0, 0.05), None)
    ).chain_limits
    assert 0.99 * 2.5 * 3.0 / 4.0 < with_tighter_sensitivity.sensitivity < 2.5 * 3.0 / 4.0
    assert with_tighter_sensitivity.delay == 0.04
    with_tighter_delay = search.with_tighter_limits(
        limits, (margins_of_loop(2.0, 0.02), margins_of_loop(2.0, 0.05))
    ).chain_limits
    assert 0.04 * 0.03 / 0.02 < with_tighter_delay.delay < 1.01 * 0.04 * 0.03 / 0.02
    assert with_tighter_delay.sensitivity == 2.5


@pytest.mark.slow
def test_the_yaw_pd_is_designed_as_in_a_cascade(diagrams):
    scenario = load_scenario(f"{diagrams}/laboratory.yaml:nominal")
    gains = design_cascade(scenario).loops["yaw"].gains
    yaw = lqg_design._yaw_pd(scenario)
    assert (yaw.k_p, yaw.k_d) == (gains.k_p, gains.k_d)
    assert yaw.k_p > 1.2 * yaw.k_d


@pytest.mark.long
def test_a_design_depends_on_the_nominal_vehicle_and_the_disturbances(diagrams, monkeypatch):
    """The scenario has no autopilot, and all designs satisfy the limits."""
    monkeypatch.setattr(lqg_design, "_MAX_EVALUATIONS", 1)
    scenario = load_scenario(f"{diagrams}/laboratory.yaml:low_wind", ["duration=4", "metrics.start=0"])
    design = design_lqg(scenario, LqgLimits(sensitivity=1e3, delay=1e-6))
    control, conditions, gravity = design.control, design.conditions, scenario.nominal.gravity
    x, z, plant = control.lateral, control.vertical, design.plants[0]
    assert (x.lag, x.natural_frequency, x.damping, z.lag) == (plant.lag, None, None, plant.lag)
    assert [axis.second.time for axis in (x, z)] == pytest.approx(
        [conditions.lateral.time, conditions.vertical.time], rel=5e-3
    )
    assert x.position_noise == z.position_noise == pytest.approx(conditions.position_noise, rel=1e-3)
    assert z.second.deviation == pytest.approx(conditions.vertical.deviation, rel=1e-3)
    # The first disturbance represents a constant, so it changes more slowly than the second.
    assert x.first.time == z.first.time > 10.0 * max(x.second.time, z.second.time)
    limits = scenario.control.thrust_vectoring
    assert (control.max_tilt, control.min_thrust, control.max_thrust) == (
        *(limits.max_tilt, limits.min_thrust, limits.max_thrust),
    )
    assert control.yaw == lqg_design._yaw_pd(scenario)
    timing = Timing(0.01, 0.02, control.delay_ticks)
    assert timing in candidate_timings(scenario, design.plants)
    for loop, model, predictions in (
        (x.loop(timing, gravity), lateral_plant_model, design.lateral),
        (z.loop(timing, gravity), vertical_plant_model, design.vertical),
    ):
        actual_plants = [
            ActualPlant.of(model(plant, conditions), plant, conditions, timing, gravity) for plant in design.plants
        ]
        assert predictions == tuple(predict_performance(loop, actual_plant, timing) for actual_plant in actual_plants)


def test_the_measurement_noise_of_a_plant_follows_from_the_cameras():
    """The horizontal specific thrust is measured as g times the tilt."""
    conditions = Conditions(NO_DISTURBANCE, NO_DISTURBANCE, 0.0, 1e-3, 4e-3, 0.03)
    plant, timing = Plant(True, 0.05, None, 0, 1), Timing(0.01, 0.02, 2)
    actual_plant = ActualPlant.of(lateral_plant_model(plant, conditions), plant, conditions, timing, 9.79)
    np.testing.assert_allclose(actual_plant.R, np.diag([1e-3**2, (9.79 * 4e-3) ** 2]), rtol=1e-12)
    height = ActualPlant.of(vertical_plant_model(plant, conditions), plant, conditions, timing, 9.79)
    np.testing.assert_allclose(height.R, [[1e-3**2]], rtol=1e-12)
    assert (actual_plant.loss_rate, height.plant) == (0.03, plant)


def test_the_lag_of_rotors_with_two_time_constants_is_their_geometric_mean(diagrams):
    scenario = load_scenario(f"{diagrams}/laboratory.yaml:nominal", ["vehicle.rotor_time_constant=0.04"])
    assert lqg_design._rotor_time_constant(scenario) == 0.04
    down = load_scenario(f"{diagrams}/hover.yaml", ["vehicle.rotor_time_constant=0.04"])
    down = down.model_copy(update={"vehicle": down.vehicle.model_copy(update={"rotor_time_constant_down": 0.09})})
    assert lqg_design._rotor_time_constant(down) == 0.06


def test_a_design_in_calm_air_assumes_a_small_disturbance():
    calm = flight_conditions(load_scenario("hover"))
    assert calm.lateral.deviation == calm.vertical.deviation == 0.05
