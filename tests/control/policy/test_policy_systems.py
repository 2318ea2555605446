"""Tests of a policy in a diagram: its observation at each tick, and its memory."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.control.policy.network import Dense, Gru, Network, evaluate_network
from drake_quad.control.policy.observation import ObservationParameters, ObservationSpec
from drake_quad.control.policy.systems import Observation, Policy
from drake_quad.framework.symbols import Matrix


def network_of(inputs, outputs, seed=0):
    rng = np.random.default_rng(seed)

    def matrix(rows, columns):
        return Matrix(0.5 * rng.normal(size=(rows, columns)), rng.normal(size=rows))

    layers = Dense(matrix(4, inputs), "tanh"), Gru(matrix(9, 4), matrix(9, 3), (0.3, 0.1, -0.2))
    return Network((*layers, Dense(matrix(outputs, 3))), inputs)


def changing_source(rows, seed):
    """Return a vector source whose elements change with time."""
    rng = np.random.default_rng(seed)
    return TrajectorySource(PiecewisePolynomial.FirstOrderHold([0.0, 10.0], rng.normal(size=(rows, 2))))


@pytest.mark.parametrize("history", [1, 3])
def test_the_history_contains_earlier_observations_and_actions(history):
    spec = ObservationSpec(("position_error", "action"), "world", history)
    initial = (0.25, -0.5)
    builder = DiagramBuilder()
    observation = builder.AddSystem(
        Observation(spec=spec, num_actions=2, parameters=ObservationParameters(1.0, initial), period=0.02)
    )
    network = network_of(5 * history, 2)
    policy = builder.AddSystem(Policy(network=network, period=0.02))
    sources = [builder.AddSystem(changing_source(rows, rows)) for rows in (12, 11)]
    for source, port in zip(sources, ("measurement", "reference"), strict=True):
        builder.Connect(source.get_output_port(), observation.GetInputPort(port))
    builder.Connect(observation.get_output_port(), policy.get_input_port())
    builder.Connect(policy.get_output_port(), observation.GetInputPort("action"))
    logs = [LogVectorOutput(system.get_output_port(), builder, 0.02) for system in (observation, policy)]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.2)
    observed_rows, actions_logged = (log.FindLog(simulator.get_context()).data().T for log in logs)

    states = [
        [source.get_output_port().Eval(context_at(source, 0.02 * k))[:3] for source in sources] for k in range(11)
    ]
    errors = [reference - state for state, reference in states]
    actions, memory = [np.array(initial)], network.memory
    rows = [np.concatenate([errors[0], initial])] * (history - 1)
    for k in range(11):
        rows = [np.concatenate([errors[k], actions[-1]]), *rows][:history]
        np.testing.assert_allclose(observed_rows[k], np.concatenate(rows), atol=1e-12, err_msg=str(k))
        step = evaluate_network(network, np.concatenate(rows).tolist(), memory)
        np.testing.assert_allclose(actions_logged[k], step.output, atol=1e-12)
        memory = step.memory
        actions.append(np.array(step.output))


def context_at(source, time):
    context = source.CreateDefaultContext()
    context.SetTime(time)
    return context


@pytest.mark.parametrize("signals", [("wind",), ("rotor_speed",), ("position_error", "action")])
def test_an_observation_has_input_ports_only_for_its_signals(signals):
    spec = ObservationSpec(signals, "world", 1)
    observation = Observation(spec=spec, num_actions=2, parameters=ObservationParameters(1.0, (0.0, 0.0)))
    for name in ("wind", "rotor_speed"):
        assert observation.HasInputPort(name) is (name in signals)
    assert not observation.HasInputPort("reference_ahead")
