"""Tests of the networks of policies, by comparison with NumPy and SciPy."""

import numpy as np
import pytest
import scipy
from pydrake.autodiffutils import AutoDiffXd

from drake_quad.control.policy.network import ACTIVATIONS, WITH_ALPHA, Dense, Gru, Network, evaluate_network
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import ROW
from drake_quad.framework.symbols import Matrix


def matrix_of(rng, rows, columns):
    return Matrix(rng.normal(size=(rows, columns)), rng.normal(size=rows))


def arrays_of(matrix):
    biases, weights = zip(*matrix.biases_and_weights(), strict=True)
    return np.array(weights), np.array(biases)


EXPECTED_ACTIVATIONS = {
    "identity": lambda x: x,
    "relu": lambda x: np.maximum(x, 0.0),
    "tanh": np.tanh,
    "sigmoid": lambda x: 1.0 / (1.0 + np.exp(-x)),
    "elu": lambda x: np.where(x > 0.0, x, np.exp(x) - 1.0),
    "silu": lambda x: x / (1.0 + np.exp(-x)),
    "leaky_relu": lambda x: np.where(x > 0.0, x, 0.01 * x),
    "gelu": lambda x: x * scipy.stats.norm.cdf(x),
    "gelu_tanh": lambda x: x / (1.0 + np.exp(-2.0 * np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3))),
}


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_activations_match_their_formulas(activation):
    x = np.linspace(-4.0, 4.0, 41)
    values = [ACTIVATIONS[activation](each) for each in x.tolist()]
    np.testing.assert_allclose(values, EXPECTED_ACTIVATIONS[activation](x), rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(ACTIVATIONS[activation](x), values, rtol=1e-12, atol=1e-15)


def test_gelu_is_close_to_its_approximation():
    """According to the authors of GELU, the two differ by at most 5e-4."""
    x = np.linspace(-6.0, 6.0, 401)
    np.testing.assert_allclose(ACTIVATIONS["gelu_tanh"](x), ACTIVATIONS["gelu"](x), atol=5e-4)


@pytest.mark.parametrize(("activation", "alpha"), [("elu", 0.7), ("leaky_relu", 0.2), ("leaky_relu", -0.1)])
def test_elu_and_leaky_relu_have_a_parameter(activation, alpha):
    x = np.linspace(-3.0, 3.0, 13)
    expected = np.where(x > 0.0, x, alpha * (np.expm1(x) if activation == "elu" else x))
    neurons = Dense(Matrix(np.eye(1), np.zeros(1)), activation, alpha)
    np.testing.assert_allclose([neurons.formula(each) for each in x.tolist()], expected, rtol=1e-14)
    np.testing.assert_allclose(evaluate_network(Network((neurons,), 1), [x], ()).output[0], expected, rtol=1e-14)


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_compiled_activations_and_their_derivatives_are_correct(activation):
    """Compiled values agree with NumPy to rounding, and derivatives with central differences."""
    x = np.linspace(-4.0, 4.05, 60)
    alpha = 0.3 if activation in WITH_ALPHA else None
    network = Network((Dense(Matrix(np.eye(1), np.zeros(1)), activation, alpha),), 1)

    def formula(row):
        return evaluate_network(network, [row], ()).output[0]

    compiled = np.empty_like(x)
    kernel(formula, (ROW,), (ROW,), single_vehicle=False)(len(x), 0.0, compiled, x)
    np.testing.assert_allclose(compiled, formula(x), rtol=1e-13, atol=1e-15)
    step = 1e-5
    slopes = [(formula(AutoDiffXd(each, [1.0])) + AutoDiffXd(0.0, [0.0])).derivatives()[0] for each in x.tolist()]
    differences = (formula(x + step) - formula(x - step)) / (2.0 * step)
    np.testing.assert_allclose(slopes, differences, atol=1e-8)


def test_dense_layers_act_on_the_scaled_input():
    rng = np.random.default_rng(0)
    layers = Dense(matrix_of(rng, 5, 3), "tanh"), Dense(matrix_of(rng, 2, 5), "elu")
    offset, scale = (0.1, -0.2, 0.3), (2.0, 0.5, 8.0)
    network = Network(layers, 3, offset, scale, 1.5)
    inputs = np.array([0.7, -0.4, 0.9])
    rows = np.clip((inputs - offset) * scale, -1.5, 1.5)
    assert rows[2] == 1.5
    for layer in layers:
        weights, biases = arrays_of(layer.matrix)
        rows = EXPECTED_ACTIVATIONS[layer.activation](weights @ rows + biases)
    step = evaluate_network(network, inputs.tolist(), ())
    np.testing.assert_allclose(step.output, rows, rtol=1e-13)
    assert step.memory == network.memory == ()
    assert network.num_outputs == 2


def test_recurrent_units_match_their_equations():
    rng = np.random.default_rng(1)
    units, inputs = 3, 2
    layer = Gru(matrix_of(rng, 9, inputs), matrix_of(rng, 9, units), (0.1, -0.2, 0.3))
    network = Network((layer,), inputs)
    assert network.num_outputs == units
    (W, b), (U, c) = arrays_of(layer.input_matrix), arrays_of(layer.memory_matrix)
    memory, h = network.memory, np.array(layer.initial)
    for x in rng.normal(size=(6, inputs)):
        step = evaluate_network(network, x.tolist(), memory)
        new, old = (W @ x + b).reshape(3, units), (U @ h + c).reshape(3, units)
        r, z = 1.0 / (1.0 + np.exp(-(new[:2] + old[:2])))
        h = z * h + (1.0 - z) * np.tanh(new[2] + r * old[2])
        np.testing.assert_allclose(step.output, h, rtol=1e-12)
        assert step.memory == (step.output,)
        memory = step.memory


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_activations_reach_their_limits_for_large_inputs(activation):
    above = {"tanh": 1.0, "sigmoid": 1.0}.get(activation, 1000.0)
    below = {"identity": -1000.0, "tanh": -1.0, "elu": -1.0, "leaky_relu": -10.0}.get(activation, 0.0)
    for x, expected in ((1000.0, above), (-1000.0, below)):
        assert ACTIVATIONS[activation](x) == pytest.approx(expected, rel=1e-12)
        np.testing.assert_allclose(ACTIVATIONS[activation](np.array([x])), [expected], rtol=1e-12)
