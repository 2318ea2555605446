"""Tests of elementary functions on numbers, arrays, AutoDiffXd and Expression, by comparison with NumPy and SciPy."""

import math

import numpy as np
import pytest
import scipy
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression, Variable

from drake_quad.framework import elementary

# Arithmetic on Expression sets floating-point flags that have no meaning.
pytestmark = pytest.mark.filterwarnings("ignore:invalid value encountered")

ELEMENTARY_FUNCTIONS = [
    elementary.cos,
    elementary.sqrt,
    elementary.arcsin,
    elementary.arctan,
    elementary.exp,
    elementary.tanh,
]


@pytest.mark.parametrize("function", ELEMENTARY_FUNCTIONS, ids=lambda f: f.__name__)
def test_elementary_functions_agree_for_all_scalar_types(function):
    x, variable = 0.3, Variable("x")
    expected = function(x)
    assert isinstance(expected, float)
    np.testing.assert_allclose(function(np.array([x, x])), expected, rtol=1e-15)
    assert function(AutoDiffXd(x, [1.0])).value() == pytest.approx(expected, rel=1e-15)
    for each in function(np.array([AutoDiffXd(x, [1.0]), AutoDiffXd(x, [0.0])])):
        assert each.value() == pytest.approx(expected, rel=1e-15)
    assert function(Expression(variable)).Evaluate({variable: x}) == pytest.approx(expected, rel=1e-15)


def test_log1p_is_accurate_and_has_derivatives():
    """log1p accepts numbers and arrays, with and without derivatives. log(1 + x) is x for tiny x."""
    numbers = [0.3, 1e-9, 1e-20, 0.0]
    expected = np.log1p(numbers)
    assert [elementary.log1p(x) for x in numbers] == pytest.approx(expected, rel=1e-15)
    np.testing.assert_allclose(elementary.log1p(np.array(numbers)), expected, rtol=1e-15)
    with_derivatives = [AutoDiffXd(x, [1.0]) for x in numbers]
    elementwise = [elementary.log1p(x) for x in with_derivatives]
    vectorised = elementary.log1p(np.array(with_derivatives))
    for actual in (elementwise, vectorised):
        np.testing.assert_allclose([each.value() for each in actual], expected, rtol=1e-15)
    for one, other, x in zip(elementwise, vectorised, numbers, strict=True):
        assert one.derivatives() == other.derivatives()
        assert one.derivatives()[0] == pytest.approx(1.0 / (1.0 + x), rel=1e-6)


def test_a_length_that_remains_zero_has_zero_derivatives():
    """The derivative of the square root is infinite at 0. It must not turn derivatives of 0 into NaN."""
    x, y = AutoDiffXd(0.0, [0.0, 1.0]), AutoDiffXd(0.09, [0.0, 0.3])
    for actual in ([elementary.sqrt(x), elementary.sqrt(y)], elementary.sqrt(np.array([x, y]))):
        np.testing.assert_allclose([each.value() for each in actual], [0.0, 0.3])
        np.testing.assert_allclose([each.derivatives() for each in actual], [[0.0, np.inf], [0.0, 0.5]])


def test_the_error_function_has_the_right_derivatives():
    numbers = [-2.5, -0.4, 0.0, 1e-20, 0.7, 6.5]
    expected = scipy.special.erf(numbers)
    assert [elementary.erf(x) for x in numbers] == pytest.approx(expected, rel=1e-15)
    np.testing.assert_allclose(elementary.erf(np.array(numbers)), expected, rtol=1e-15)
    with_derivatives = [AutoDiffXd(x, [2.0, 0.0]) for x in numbers]
    elementwise = [elementary.erf(x) for x in with_derivatives]
    for actual in (elementwise, elementary.erf(np.array(with_derivatives))):
        np.testing.assert_allclose([each.value() for each in actual], expected, rtol=1e-15)
        slopes = [2.0 * 2.0 / math.sqrt(math.pi) * math.exp(-x * x) for x in numbers]
        np.testing.assert_allclose([each.derivatives() for each in actual], [[slope, 0.0] for slope in slopes])


@pytest.mark.parametrize(("function", "expected"), [(elementary.maximum, 2.0), (elementary.minimum, 1.0)])
def test_maximum_and_minimum_accept_all_scalar_types(function, expected):
    variable = Variable("x")
    assert function(1.0, 2.0) == function(2.0, 1.0) == expected
    np.testing.assert_array_equal(function(np.array([1.0, 2.0]), np.array([2.0, 1.0])), expected)
    one, two = AutoDiffXd(1.0, [1.0]), AutoDiffXd(2.0, [1.0])
    assert function(one, two).value() == function(np.array([two]), one)[0].value() == expected
    for value, other in ((1.0, 2.0), (2.0, 1.0)):
        assert function(Expression(variable), other).Evaluate({variable: value}) == expected
        assert function(np.array([Expression(variable)]), other)[0].Evaluate({variable: value}) == expected
    # If one argument is NaN, the functions return the second one, as compiled formulas do.
    for first, second in ((math.nan, 1.5), (1.5, math.nan)):
        np.testing.assert_array_equal(function(first, second), second)
        np.testing.assert_array_equal(function(np.array([first]), second), second)
        np.testing.assert_array_equal(function(first, np.array([second])), second)


@pytest.mark.parametrize("angle", [-10.0, -3.2, -1.0, 0.0, 2.0, 3.2, 100.0])
def test_wrapped_angles_lie_within_pi_and_keep_their_derivatives(angle):
    expected = math.atan2(math.sin(angle), math.cos(angle))
    for value in (
        elementary.wrap_angle(angle),
        elementary.wrap_angle(np.array([angle, angle]))[1],
        elementary.wrap_angle(AutoDiffXd(angle, [1.0])).value(),
        elementary.wrap_angle(np.array([AutoDiffXd(angle, [1.0])]))[0].value(),
    ):
        assert value == pytest.approx(expected, abs=1e-12)
    assert elementary.wrap_angle(AutoDiffXd(angle, [1.0])).derivatives()[0] == 1.0


@pytest.mark.parametrize("number", [-2.6, -0.4, 0.0, 1.4, 7.5])
def test_the_nearest_integer_has_no_derivatives(number):
    """`nearest` returns a whole number for every scalar type, and is idempotent."""
    expected = float(round(number))
    for value in (number, np.float64(number), AutoDiffXd(number, [1.0])):
        assert elementary.nearest(value) == elementary.nearest(elementary.nearest(value)) == expected
    for array in (np.array([number, 0.0]), np.array([AutoDiffXd(number, [1.0]), AutoDiffXd(0.0)])):
        np.testing.assert_array_equal(elementary.nearest(array), [expected, 0.0])


def test_the_function_where_selects_by_a_mask():
    assert elementary.where(True, 1.0, 2.0) == 1.0
    mask = np.array([True, False])
    np.testing.assert_array_equal(elementary.where(mask, 1.0, 2.0), [1.0, 2.0])
    # A record can contain rows, and numbers that are the same for all vehicles.
    rows = elementary.where(mask, (1.0, 2.0, 3.0), (np.array([4.0, 5.0]), 6.0, np.array([7.0, 8.0])))
    np.testing.assert_array_equal(rows, [[1.0, 5.0], [2.0, 6.0], [3.0, 8.0]])


def test_a_float_outside_the_domain_gives_nan():
    assert math.isnan(elementary.sqrt(-1.0))
    assert math.isnan(elementary.arcsin(1.1))
    assert math.isnan(elementary.sqrt(math.nan))


@pytest.mark.parametrize("angle", [0.0, 1e-300, 0.3, -1.5, math.pi / 2, math.pi, -math.pi, 7.0, -1e5])
def test_sin_cos_equals_sine_and_cosine(angle):
    expected = math.sin(angle), math.cos(angle)
    assert elementary.sin_cos(angle) == expected
    np.testing.assert_allclose(np.array(elementary.sin_cos(np.full(3, angle)))[:, 0], expected, rtol=0.0, atol=4e-16)
    sine, cosine = elementary.sin_cos(AutoDiffXd(angle, [1.0]))
    assert (sine.value(), cosine.value()) == pytest.approx(expected, abs=1e-15)
    assert (sine.derivatives()[0], cosine.derivatives()[0]) == pytest.approx((cosine.value(), -sine.value()), abs=1e-15)


@pytest.mark.parametrize("number", [0.0, 1.0, 2.0**32 + 1.0, 2.0**52 - 1.0])
def test_conversion_to_a_64_bit_word_and_back_is_exact(number):
    """The conversion accepts every scalar type and drops derivatives."""
    for value in (number, np.array([number]), AutoDiffXd(number, [1.0]), np.array([AutoDiffXd(number, [1.0])])):
        word = elementary.to_uint64(value)
        assert word.dtype == np.uint64
        assert word.tolist() == [int(number)]
        assert elementary.from_uint64(word).tolist() == [number]
    words = elementary.to_uint64(np.array([number, 3.0]))
    assert words.tolist() == [int(number), 3]


def test_lazy_where_evaluates_the_formula_only_for_vehicles_that_need_it():
    evaluated = []

    def inverse(x):
        evaluated.append(np.size(x))
        return 1.0 / x, x

    x = np.array([0.0, 2.0, 4.0, 0.0])
    actual = elementary.lazy_where(x > 0.0, inverse, (x,), (math.inf, -x))
    np.testing.assert_array_equal(actual, [[math.inf, 0.5, 0.25, math.inf], [0.0, 2.0, 4.0, 0.0]])
    actual = elementary.lazy_where(x > 9.0, inverse, (x,), (7.0, x))
    np.testing.assert_array_equal(actual, [[7.0] * 4, x])
    assert elementary.lazy_where(False, inverse, (0.0,), (1.0, 2.0)) == (1.0, 2.0)
    assert elementary.lazy_where(True, inverse, (4.0,), (1.0, 2.0)) == (0.25, 4.0)
    assert evaluated == [2, 1]
    # A result that is the same for all vehicles remains a number.
    shifted = elementary.lazy_where(x > 0.0, lambda x, y: x + y, (x, 1.0), 0.0)
    np.testing.assert_array_equal(shifted, [0.0, 3.0, 5.0, 0.0])


def test_lazy_where_has_derivatives():
    x = np.array([AutoDiffXd(value, [1.0]) for value in (1.0, 3.0)])
    actual = elementary.lazy_where(x > 2.0, lambda x: x * x, (x,), 5.0)
    assert [each.value() for each in actual] == [5.0, 9.0]
    assert actual[1].derivatives() == [6.0]
    assert elementary.lazy_where(x[1] > 2.0, lambda x: x * x, (x[1],), 5.0).derivatives() == [6.0]
