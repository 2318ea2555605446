"""Tests of the fuzzy network as a diagram, and in flights."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad import load_scenario, simulate
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets, firing_strengths
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, SignLaw
from drake_quad.control.fuzzy.systems import (
    FuzzyRules,
    FuzzyRulesParameters,
    LearningParameters,
    WeightLearning,
    build_fuzzy_network,
)
from drake_quad.studies.comparison import fly_samples

H = 0.02  # s, control tick


@pytest.fixture(scope="module")
def scenario_with(diagrams):
    """Return a function that loads a scenario of the laboratory with one of the paper's controllers."""

    def load(controller, *overrides, laboratory="nominal"):
        paper = f"{diagrams / 'controllers' / 'paper.yaml'}:{controller}"
        return load_scenario(diagrams / f"laboratory.yaml:{laboratory}", overrides, layers=[paper])

    return load


def simulated(network, inputs, ticks, num_vehicles=1):
    """Return the simulator and the corrections (ticks, 3, N) of a network with given trajectories (3 N,) as inputs."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("network", network)
    for name, trajectory in inputs.items():
        if network.HasInputPort(name):
            source = builder.AddNamedSystem(name, TrajectorySource(trajectory))
            builder.Connect(source.get_output_port(), network.GetInputPort(name))
    builder.ExportOutput(network.GetOutputPort("correction"), "correction")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    corrections = []
    simulator.Initialize()
    for tick in range(ticks):
        if tick:
            simulator.AdvanceTo(tick * H)
        corrections.append(diagram.GetOutputPort("correction").Eval(simulator.get_context()).reshape(3, num_vehicles))
    return simulator, np.array(corrections)


def smooth_inputs(rng, num_vehicles):
    """Return random trajectories of all network inputs, which pass through all fuzzy sets."""
    times = np.linspace(0.0, 2.0, 9)
    names = ("error", "error_rate", "pd", "disturbance")
    return {
        name: PiecewisePolynomial.CubicShapePreserving(times, rng.normal(size=(3 * num_vehicles, 9)) * 0.6)
        for name in names
    }


LAWS = [
    CovarianceLaw(gain=0.8, initial_covariance=30.0),
    CovarianceLaw(gain=0.8, initial_covariance=30.0, forgetting=0.99),
    GradientLaw(3.0),
    SignLaw(rate=0.5, initial_slope=0.1),
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("axes", "learns_from", "has_estimator"),
    [
        (("x", "y"), "surface", True),
        (("x", "z"), "feedback", True),
        (("x", "z"), "feedback", False),
        (("y",), "surface", True),
    ],
)
def test_the_network_diagram_matches_the_learning_equations(law, axes, learns_from, has_estimator):
    """The correction of each tick follows from the previous weights. The weights follow from the equations of the law.

    Without an estimator, the network learns only from the feedback of the PD.
    """
    rng = np.random.default_rng(3)
    inputs, sets = smooth_inputs(rng, 1), Antecedents(1.3, 0.7, 0.4, (FuzzySets(1.5), FuzzySets(0.7)))
    parameters = LearningParameters(slope=1.7, law=law, initial_weight=0.2)
    learning = WeightLearning(axes=axes, learns_from=learns_from, parameters=parameters)
    network = build_fuzzy_network(
        rules=FuzzyRules(axes=axes, parameters=FuzzyRulesParameters((sets,))), learning=learning
    )
    if not has_estimator:
        del inputs["disturbance"]
    _, corrections = simulated(network, inputs, 80)
    for axis in axes:
        i = "xyz".index(axis)
        weights, memory = (0.2,) * 9, law.memory(9)
        for tick in range(80):
            e, rate, pd = (float(inputs[name].value(tick * H)[i, 0]) for name in ("error", "error_rate", "pd"))
            firing = firing_strengths((e, rate), sets)
            assert corrections[tick, i, 0] == pytest.approx(np.dot(firing, weights), abs=1e-12)
            d = float(inputs["disturbance"].value(tick * H)[i, 0]) if has_estimator else 0.0
            signal = rate + 1.7 * e if learns_from == "surface" else pd - d
            weights, memory = law.step(weights, memory, firing, signal, H)
    others = [i for i in range(3) if "xyz"[i] not in axes]
    np.testing.assert_array_equal(corrections[:, others], 0.0)


def test_each_vehicle_of_a_fleet_learns_like_a_single_vehicle():
    """Each vehicle of the fleet has its own network, with its own parameters and inputs."""
    rng = np.random.default_rng(4)
    n = 40
    inputs = smooth_inputs(rng, n)
    rows = {name: rng.uniform(*limits, n) for name, limits in (("a1", (1.1, 2.0)), ("gain", (0.2, 1.0)))}
    slope, scale, q = rng.uniform(0.5, 2.0, n), rng.uniform(0.8, 2.0, n), rng.uniform(0.0, 1.0, n)

    def network(pick, count):
        sets = Antecedents(pick(rows["a1"]), 0.7, pick(q), (FuzzySets(pick(scale)), FuzzySets(0.7)))
        law = CovarianceLaw(pick(rows["gain"]), 30.0)
        learning = WeightLearning(num_vehicles=count, parameters=LearningParameters(slope=pick(slope), law=law))
        return build_fuzzy_network(
            rules=FuzzyRules(num_vehicles=count, parameters=FuzzyRulesParameters((sets,))), learning=learning
        )

    _, fleet = simulated(network(lambda row: row, n), inputs, 60, n)
    for i in (0, 7, 39):
        picked = {
            name: PiecewisePolynomial.CubicShapePreserving(
                np.linspace(0.0, 2.0, 9),
                np.column_stack([trajectory.value(time)[i::n, 0] for time in np.linspace(0.0, 2.0, 9)]),
            )
            for name, trajectory in inputs.items()
        }
        _, alone = simulated(network(lambda row, i=i: float(row[i]), 1), picked, 60)
        np.testing.assert_allclose(fleet[:, :, i], alone[:, :, 0], atol=1e-11)


@pytest.mark.parametrize(("reset_time", "tick"), [(0.8, 40), (0.801, 41), (0.819, 41), (0.82, 41)])
def test_a_covariance_reset_acts_at_the_first_tick_at_or_after_its_time(reset_time, tick):
    """Learning at this tick already uses the initial covariance."""
    inputs, law = smooth_inputs(np.random.default_rng(5), 1), CovarianceLaw(0.8, 30.0)
    learning = WeightLearning(axes=("x", "z"), reset_times=(reset_time,), parameters=LearningParameters(law=law))
    network = build_fuzzy_network(rules=FuzzyRules(axes=("x", "z")), learning=learning)
    # The simulator has not yet processed the learning step of the last tick.
    simulator, _ = simulated(network, inputs, tick + 1)
    port = simulator.get_system().GetSubsystemByName("network").GetOutputPort("covariance_trace")
    context = network.GetMyContextFromRoot(simulator.get_context())
    assert (port.Eval(context) < 0.9 * 270.0).all()
    simulator.AdvancePendingEvents()
    for axis, covariance_trace in zip((0, 2), port.Eval(context), strict=True):
        firing = np.array(
            firing_strengths([inputs[name].value(tick * H)[axis, 0] for name in ("error", "error_rate")], Antecedents())
        )
        initial = 30.0 * np.eye(9)
        g = initial @ firing
        after = initial - H * np.outer(g, g) / (1.0 + H * firing @ g)
        assert covariance_trace == pytest.approx(np.trace(after), rel=1e-12)


def test_reversing_the_sign_in_eq_14_increases_the_error():
    """The correction reduces a steady error of 0.5 / k_P. With the opposite sign it increases the error."""
    errors = {}
    for sign in (1.0, -1.0):
        sets = Antecedents(1.2, 0.8, 0.5, (FuzzySets(1.8), FuzzySets(0.55)))
        law = CovarianceLaw(0.7, 6.0)
        weights, memory = (0.0,) * 9, law.memory(9)
        x = v = 0.0
        for _ in range(1500):
            e, rate = -x, -v
            firing = firing_strengths((e, rate), sets)
            u = 1.4 * e + 1.4 * rate - sign * float(np.dot(firing, weights))
            weights, memory = law.step(weights, memory, firing, rate + 2.1 * e, H)
            x, v = x + H * v, v + H * (u + 0.5)
        errors[sign] = abs(x)
    assert errors[1.0] < 0.05 < 0.5 / 1.4 < errors[-1.0]


@pytest.mark.long
@pytest.mark.parametrize("laboratory", ["nominal", "low_wind"])
def test_the_network_reduces_the_error_as_reported_in_the_paper(scenario_with, laboratory):
    """The network reduces the error by at least 43 % in at least 95 of 100 samples, and no sample crashes."""
    pd, network = (
        fly_samples(scenario_with(controller, laboratory=laboratory), range(100)) for controller in ("pd", "pd_t2fnn")
    )
    assert not pd.crashed.any()
    assert not network.crashed.any()
    assert (network.rmse <= (1.0 - 0.43) * pd.rmse).sum() >= 95
    # The paper reports errors of 0.97 m and 0.5 m.
    assert pd.rmse.mean() == pytest.approx(0.95, abs=0.05)
    assert network.rmse.mean() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("controller", ["pd_t1fnn", "pid", "pd_feed_forward"])
def test_a_sample_has_the_same_error_in_a_single_flight_and_in_a_fleet(scenario_with, controller):
    scenario = scenario_with(controller, "duration=3", laboratory="low_wind")
    fleet = fly_samples(scenario, [4, 2, 9])
    alone = simulate(scenario, sample=2, compiled=False).metrics
    assert fleet.rmse[1] == pytest.approx(alone.rmse, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    "learning",
    [
        "{kind: gradient, rate: 2.0, slope: 2.0, leakage: 0.02, deadzone: 0.02}",
        "{kind: sign, rate: 0.05, initial_slope: 0.2, weight_limit: 3.0}",
        "{kind: covariance, slope: 2.1, gain: 0.7, initial_covariance: 6.0, forgetting: 0.999, weight_limit: 5}",
        "{kind: covariance, slope: 2.1, gain: 0.7, initial_covariance: 6.0, reset: at_segments}",
    ],
)
def test_every_learning_law_reduces_the_error_in_flight(scenario_with, learning):
    overrides = [f"control.network.learning={learning}"]
    error = simulate(scenario_with("pd_t2fnn", *overrides), sample=0).metrics.rmse
    assert error < 0.9 * simulate(scenario_with("pd"), sample=0).metrics.rmse


@pytest.mark.slow
def test_a_network_corrects_only_its_chosen_axes(scenario_with):
    flight = simulate(scenario_with("pd_t2fnn", "control.network.axes=[z]", "duration=4"), sample=0)
    assert flight["weights"].shape[1] == 9
    x, y, z = flight.record("correction")
    np.testing.assert_array_equal([x, y], 0.0)
    assert np.abs(z).max() > 0.0
    np.testing.assert_allclose(
        flight["acceleration_command"], flight["pd"] - flight["correction"], atol=1e-12, err_msg="eq (14)"
    )


def test_weights_are_ordered_by_axis_and_the_set_of_the_last_input_varies_fastest():
    """A single rule fires on each axis, because the error and the error rate are at centres of their sets."""
    sets = FuzzySets(1.0, (-1.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    antecedents = Antecedents(1.0, 1.0, 0.5, (sets, sets))
    (x, y) = (firing_strengths(inputs, antecedents) for inputs in ((-1.0, 1.0), (0.0, -1.0)))
    assert (x.index(max(x)), y.index(max(y))) == (2, 3)
    learning = WeightLearning(axes=("x", "y"), initial_weights=(tuple(range(9)), tuple(range(10, 19))))
    context = learning.CreateDefaultContext()
    learning.GetInputPort("firing").FixValue(context, [*x, *y])
    weights = learning.GetOutputPort("weights").Eval(context)
    np.testing.assert_array_equal(weights, [*range(9), *range(10, 19)])
    np.testing.assert_allclose(learning.GetOutputPort("correction").Eval(context), [2.0, 13.0, 0.0], atol=1e-12)
