"""Networks, against NumPy and against the package that publishes one."""

import numpy as np
import pytest

from drake_quad.control.policy.network import ACTIVATIONS, Dense, Gru, Network, passed
from drake_quad.framework.symbols import Matrix


def matrix_of(rng, rows, columns):
    return Matrix(rng.normal(size=(rows, columns)), rng.normal(size=rows))


def numbers(matrix):
    biases, weights = zip(*matrix.biases_and_weights(), strict=True)
    return np.array(weights), np.array(biases)


EXPECTED = {
    "identity": lambda x: x,
    "relu": lambda x: np.maximum(x, 0.0),
    "tanh": np.tanh,
    "sigmoid": lambda x: 1.0 / (1.0 + np.exp(-x)),
    "elu": lambda x: np.where(x > 0.0, x, np.exp(x) - 1.0),
    "silu": lambda x: x / (1.0 + np.exp(-x)),
}


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_activations(activation):
    x = np.linspace(-4.0, 4.0, 41)
    found = [ACTIVATIONS[activation](each) for each in x.tolist()]
    np.testing.assert_allclose(found, EXPECTED[activation](x), rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(ACTIVATIONS[activation](x), found, rtol=1e-13, atol=1e-16)


def test_layers_of_neurons_follow_each_other_behind_a_prepared_input():
    rng = np.random.default_rng(0)
    layers = Dense(matrix_of(rng, 5, 3), "tanh"), Dense(matrix_of(rng, 2, 5), "elu")
    offset, scale = (0.1, -0.2, 0.3), (2.0, 0.5, 8.0)
    network = Network(layers, 3, offset, scale, 1.5)
    inputs = np.array([0.7, -0.4, 0.9])
    rows = np.clip((inputs - offset) * scale, -1.5, 1.5)
    assert rows[2] == 1.5
    for layer in layers:
        weights, biases = numbers(layer.matrix)
        rows = EXPECTED[layer.activation](weights @ rows + biases)
    step = passed(network, inputs.tolist(), ())
    np.testing.assert_allclose(step.output, rows, rtol=1e-13)
    assert step.memory == network.memory == ()
    assert network.num_outputs == 2


def test_recurrent_units_remember_as_their_equations_say():
    rng = np.random.default_rng(1)
    units, inputs = 3, 2
    layer = Gru(matrix_of(rng, 9, inputs), matrix_of(rng, 9, units), (0.1, -0.2, 0.3))
    network = Network((layer,), inputs)
    assert network.num_outputs == units
    (W, b), (U, c) = numbers(layer.of_input), numbers(layer.of_memory)
    memory, h = network.memory, np.array(layer.initial)
    for x in rng.normal(size=(6, inputs)):
        step = passed(network, x.tolist(), memory)
        new, old = (W @ x + b).reshape(3, units), (U @ h + c).reshape(3, units)
        r, z = 1.0 / (1.0 + np.exp(-(new[:2] + old[:2])))
        h = z * h + (1.0 - z) * np.tanh(new[2] + r * old[2])
        np.testing.assert_allclose(step.output, h, rtol=1e-12)
        assert step.memory == (step.output,)
        memory = step.memory
