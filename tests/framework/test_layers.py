"""Tests of network layers. Machine code evaluates a layer in a loop, and Python evaluates it as sums of rows."""

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd

from drake_quad.framework import elementary
from drake_quad.framework.elementary import dense
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import rows_layout
from drake_quad.framework.symbols import Matrix


def squared(x):
    return x * x


def identity_of(x):
    return x


def matrix_of(outputs, inputs, seed=0):
    rng = np.random.default_rng([outputs, inputs, seed])
    return Matrix(rng.normal(size=(outputs, inputs)), rng.normal(size=outputs))


def numbers_of(matrix):
    biases, weights = zip(*matrix.biases_and_weights(), strict=True)
    return np.array(weights), np.array(biases)


@pytest.mark.parametrize("n", [1, 3, 8, 19])
@pytest.mark.parametrize(("outputs", "inputs"), [(1, 1), (7, 3), (8, 5), (9, 24), (33, 2)])
def test_machine_code_and_python_sum_in_the_same_order(outputs, inputs, n):
    """The sums agree to the last bit, even if the number of rows is not a multiple of the loop's block size."""
    matrix = matrix_of(outputs, inputs)

    def formula(rows):
        return tuple(dense(matrix, rows, squared))

    rows = np.random.default_rng(n).normal(size=(inputs, n))
    actual = np.empty(outputs * n)
    kernel(formula, (rows_layout(inputs),), (rows_layout(outputs),), single_vehicle=n == 1)(
        n, 0.0, actual, rows.ravel()
    )
    expected = np.array([formula(column.tolist()) for column in rows.T]).T
    np.testing.assert_array_equal(actual.reshape(outputs, n), expected)
    weights, biases = numbers_of(matrix)
    np.testing.assert_allclose(expected, (weights @ rows + biases[:, None]) ** 2, rtol=1e-12, atol=1e-14)


def test_layers_can_be_in_series_and_inside_a_branch():
    """The example has two layers with the same matrix, a constant row, and a layer inside a branch."""
    first, second = matrix_of(5, 3), matrix_of(4, 5)

    def inner(x, y):
        return tuple(dense(matrix_of(2, 2), [x, y], elementary.tanh))

    def formula(rows):
        hidden = dense(first, [rows[0], 0.5, rows[1]], elementary.tanh)
        again = dense(first, [rows[1], rows[0], hidden[4]], elementary.tanh)
        out = dense(second, again, identity_of)
        some = elementary.lazy_where(rows[0] > 0.0, inner, (out[0], out[2]), (7.0, -7.0))
        return (*out, *some)

    rows = np.random.default_rng(1).normal(size=(2, 21))
    actual = np.empty(6 * 21)
    kernel(formula, (rows_layout(2),), (rows_layout(6),), single_vehicle=False)(21, 0.0, actual, rows.ravel())
    expected = np.array([formula(column.tolist()) for column in rows.T]).T
    np.testing.assert_allclose(actual.reshape(6, 21), expected, rtol=1e-14)
    assert {*(expected[4] == 7.0).tolist()} == {True, False}


def test_the_derivatives_of_a_layer_are_its_weights_times_the_derivative_of_the_activation():
    matrix = matrix_of(3, 2)
    weights, _ = numbers_of(matrix)
    rows = [AutoDiffXd(0.3, [1.0, 0.0]), AutoDiffXd(-0.2, [0.0, 1.0])]
    actual = dense(matrix, rows, elementary.tanh)
    values = np.array([each.value() for each in dense(matrix, rows, identity_of)])
    slopes = np.array([each.derivatives() for each in actual])
    np.testing.assert_allclose(slopes, (1.0 - np.tanh(values) ** 2)[:, None] * weights, rtol=1e-13)


def test_matrices_are_equal_if_their_elements_are_equal():
    assert matrix_of(3, 2) == matrix_of(3, 2)
    assert hash(matrix_of(3, 2)) == hash(matrix_of(3, 2))
    assert matrix_of(3, 2) != matrix_of(3, 2, seed=1)
    weights, biases = numbers_of(matrix_of(3, 2))
    assert Matrix(weights, biases) == matrix_of(3, 2)
    assert Matrix(weights.T, biases[:2]) != matrix_of(3, 2)
    assert len(repr(matrix_of(200, 200))) < 100


def test_the_elements_of_a_matrix_cannot_be_changed():
    """Machine code is cached under a digest of the matrix, so a changed matrix would run the wrong code."""
    matrix = matrix_of(3, 2)
    with pytest.raises(ValueError, match="read-only"):
        matrix._numbers[0, 0] = 1.0


def test_an_activation_that_uses_other_rows_is_refused():
    def formula(rows):
        return tuple(dense(matrix_of(2, 2), rows, lambda x: x + rows[0]))

    with pytest.raises(TypeError, match="uses a row that is not one of its arguments"):
        kernel(formula, (rows_layout(2),), (rows_layout(2),), single_vehicle=True)
