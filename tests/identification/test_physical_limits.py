"""Tests of the physical limits of inertia and thrust curve, as bounds of the search variables."""

import numpy as np
import pytest

from drake_quad.identification.parameters import Parameter
from drake_quad.identification.physical_limits import SearchVariables

SECOND_MOMENTS = np.array([0.3, 0.5, 0.9])  # kg m², second moments of the mass along x, y and z
INERTIA = SECOND_MOMENTS.sum() - SECOND_MOMENTS  # kg m², moments of inertia about x, y and z
CURVE = np.array([0.1, 0.7, 2.0])  # N, coefficients of the thrust curve


def parameters_with(inertia: np.ndarray = INERTIA, curve: np.ndarray = CURVE) -> list[Parameter]:
    """Return an inertia and a thrust curve among other parameters, in no particular order."""
    moments = [Parameter(f"inertia[{i}]", inertia[i], 0.1 * (i + 1), 0.02 * inertia[i], 50.0) for i in range(3)]
    powers = [Parameter(f"motors.curve[{i}]", curve[i], 1.5 + i) for i in range(3)]
    lag = Parameter("rotor_time_constant", 0.05, 0.04, 0.002, 2.5)
    centre = Parameter("centre_of_mass[0]", 0.01, 0.02)
    return [moments[2], lag, powers[1], moments[0], powers[0], centre, powers[2], moments[1]]


def values_of(parameters: list[Parameter], **changes: float) -> np.ndarray:
    return np.array([changes.get(parameter.name, parameter.start) for parameter in parameters])


def variables_by_name(parameters: list[Parameter], variables: np.ndarray) -> dict[str, float]:
    return dict(zip([parameter.name for parameter in parameters], variables.tolist(), strict=True))


def test_search_variables_are_second_moments_and_end_values_of_the_thrust_curve() -> None:
    """I_x = m_y + m_z. The derivatives of the thrust parabola at throttles 0 and 1 are K1 and K1 + 2 K2."""
    parameters = parameters_with()
    result = SearchVariables.of(parameters)
    values = values_of(parameters)
    variables = variables_by_name(parameters, result.matrix @ values)
    np.testing.assert_allclose([variables[f"inertia[{i}]"] for i in range(3)], SECOND_MOMENTS)
    k_0, k_1, k_2 = CURVE
    assert [variables[f"motors.curve[{i}]"] for i in range(3)] == pytest.approx([k_0, k_1, k_1 + 2.0 * k_2])
    assert (variables["rotor_time_constant"], variables["centre_of_mass[0]"]) == (0.05, 0.01)
    np.testing.assert_allclose(result.inverse @ (result.matrix @ values), values)
    # The scale of a sum is at most the sum of the scales.
    scales = variables_by_name(parameters, result.scale)
    assert [scales[f"inertia[{i}]"] for i in range(3)] == pytest.approx([0.5 * (0.1 + 0.2 + 0.3)] * 3)
    assert [scales[f"motors.curve[{i}]"] for i in range(3)] == pytest.approx([1.5, 2.5, 2.5 + 2.0 * 3.5])
    assert scales["rotor_time_constant"] == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("moments", "limits"),
    [
        # The smallest moment of inertia is 0.8, and 0.1 % of it is 0.0008.
        ([0.3, 0.5, 0.9], [0.0008, 0.0008, 0.0008]),
        # A flat body has no extent normal to its plane. If the second moment of the data sheet is zero or negative,
        # this value is the limit.
        ([0.3, 0.5, 0.0], [0.0003, 0.0003, 0.0]),
        ([0.3, 0.5, -0.1], [0.0002, 0.0002, -0.1]),
    ],
)
def test_second_moments_are_bounded_by_a_fraction_of_the_data_sheet_values(
    moments: list[float], limits: list[float]
) -> None:
    parameters = parameters_with(inertia=sum(moments) - np.array(moments))
    result = SearchVariables.of(parameters)
    lower, upper = (variables_by_name(parameters, each) for each in (result.lower, result.upper))
    assert [lower[f"inertia[{i}]"] for i in range(3)] == pytest.approx(limits)
    assert {upper[f"inertia[{i}]"] for i in range(3)} == {np.inf}
    # Other parameters keep their bounds.
    assert (lower["rotor_time_constant"], upper["rotor_time_constant"]) == (0.002, 2.5)
    assert (lower["centre_of_mass[0]"], upper["centre_of_mass[0]"]) == (-np.inf, np.inf)


def test_a_flat_vehicle_can_be_identified_from_the_data_sheet_of_a_tall_one() -> None:
    """The limits change the inertia of a flat body by less than 0.3 %, the resolution of an identification."""
    limits = SearchVariables.of(parameters_with())
    flat = parameters_with(inertia=np.array([0.5, 0.3, 0.8]))
    nearest = np.maximum(limits.matrix @ values_of(flat), limits.lower)
    np.testing.assert_allclose(limits.inverse @ nearest, values_of(flat), rtol=3e-3)


@pytest.mark.parametrize(("start", "limit"), [(0.1, 0.75), (1.2, 1.2)])
def test_the_limit_of_the_thrust_at_zero_throttle_is_half_of_hover_or_a_larger_data_sheet_value(
    start: float, limit: float
) -> None:
    parameters = parameters_with(curve=np.array([start, 0.7, 2.0]))
    result = SearchVariables.of(parameters)
    lower, upper = (variables_by_name(parameters, each) for each in (result.lower, result.upper))
    assert [lower[f"motors.curve[{i}]"] for i in range(3)] == [0.0, 0.0, 0.0]
    assert [upper[f"motors.curve[{i}]"] for i in range(3)] == [limit, np.inf, np.inf]


@pytest.mark.parametrize("missing", ["inertia[1]", "motors.curve[2]"])
def test_limits_on_combinations_of_parameters_need_the_whole_inertia_or_thrust_curve(missing: str) -> None:
    parameters = [parameter for parameter in parameters_with() if parameter.name != missing]
    result = SearchVariables.of(parameters)
    lower, upper = (variables_by_name(parameters, each) for each in (result.lower, result.upper))
    for parameter in parameters:
        if parameter.name.split("[")[0] == missing.split("[")[0]:
            assert (lower[parameter.name], upper[parameter.name]) == (parameter.lower, parameter.upper)
    other = "motors.curve[0]" if missing.startswith("inertia") else "inertia[0]"
    assert lower[other] >= 0.0


def test_a_parameter_is_at_a_limit_if_its_distance_is_below_a_thousandth_of_its_prior_scale() -> None:
    """A limit on a combination of parameters is ignored, since it does not fix any one of them."""
    parameters = parameters_with()
    actual = SearchVariables.of(parameters)

    def limited(**changes: float) -> set[str]:
        mask = actual.limited(values_of(parameters, **changes))
        return {parameter.name for parameter, at_limit in zip(parameters, mask, strict=True) if at_limit}

    assert limited() == set()
    for distance, at_limit in ((0.9e-3, True), (1.1e-3, False)):
        expected = {"rotor_time_constant"} if at_limit else set()
        assert limited(rotor_time_constant=0.002 + 0.04 * distance) == expected
        assert limited(rotor_time_constant=2.5 - 0.04 * distance) == expected
        low = {"motors.curve[0]": 1.5 * distance}
        assert limited(**low) == ({"motors.curve[0]"} if at_limit else set())
        high = {"motors.curve[0]": 0.75 - 1.5 * distance}
        assert limited(**high) == ({"motors.curve[0]"} if at_limit else set())
    # The body has no extent along z, and the derivative of the thrust is zero at full throttle.
    assert limited(**{"inertia[0]": SECOND_MOMENTS[1], "inertia[1]": SECOND_MOMENTS[0]}) == set()
    assert limited(**{"motors.curve[2]": -0.5 * CURVE[1]}) == set()
