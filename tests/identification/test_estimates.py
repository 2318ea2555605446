"""Tests of parameter estimates: names, valid values and uncertainty."""

import numpy as np
import pytest
import scipy

from drake_quad import InputError
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import EstimatedValue
from drake_quad.identification.results.estimates import Estimates, ExplainedVariance, Source, scenario_path

SOURCE = Source("least squares", "flight.bin")


def estimates(**changes):
    given = {
        "names": ("mass", "inertia[2]"),
        "values": np.array([0.033, 3e-5]),
        "covariance": np.array([[4e-8, 1e-11], [1e-11, 1e-14]]),
        "degrees_of_freedom": 12.0,
        "sources": SOURCE,
        **changes,
    }
    return Estimates(**given)


def test_estimates_are_written_with_units_and_intervals():
    """Student's 97.5 % quantile of 12 degrees of freedom is 2.1788."""
    text = str(estimates(not_identified={"linear_drag": "it did not move"}))
    assert text.splitlines() == [
        "mass: 0.03300 kg [0.03256, 0.03344]",
        "inertia[2]: 3.000e-05 kg m² [2.978e-05, 3.022e-05]",
        "not identified: linear_drag: it did not move",
    ]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("weight", "there is no parameter of a vehicle or its laboratory called 'weight'; there are mass, inertia"),
        ("body_drag.linears[0]", "did you mean body_drag.linear or body_drag.quadratic?"),
        ("inertia", "'inertia' is not a parameter; it must be inertia[0] to inertia[2]"),
        ("inertia[3]", "it must be inertia[0] to inertia[2]"),
        ("mass[0]", "it must be mass"),
        ("vehicle.mass", "called 'vehicle.mass'"),
        ("inertia[0].x", "called 'inertia[0].x'"),
    ],
)
def test_parameter_names_are_those_of_the_scenario_language(name, message):
    with pytest.raises(InputError) as caught:
        estimates(names=("mass", name))
    assert message in str(caught.value)


def test_parameters_have_a_path_in_a_scenario():
    assert scenario_path("inertia[2]") == "vehicle.inertia.2"
    assert scenario_path("thrust_factor_error[2]") == "vehicle.thrust_factor_error.rotor_3"
    assert scenario_path("autopilot.damping[0]") == "laboratory.autopilot.damping.0"
    position_noise = "laboratory.motion_capture.position_noise"
    assert scenario_path(position_noise) == position_noise


def test_intervals_use_students_t_distribution():
    actual = estimates(degrees_of_freedom=np.array([5.0, np.inf]))
    low, high = actual.intervals().T
    np.testing.assert_allclose(low, actual.values - actual.deviations * [2.570582, 1.959964], rtol=1e-6)
    np.testing.assert_allclose(high - actual.values, actual.values - low)
    np.testing.assert_allclose(actual.deviations, [2e-4, 1e-7])
    assert actual.correlation[0, 1] == pytest.approx(0.5)
    assert actual.units == ("kg", "kg m²")
    expected = scipy.stats.t.interval(0.95, 12, loc=0.033, scale=2e-4)
    assert tuple(estimates().intervals()[0]) == pytest.approx(expected)


def test_the_variance_for_a_new_flight_is_the_error_variance_plus_the_variation():
    """The degrees of freedom of the sum follow from Satterthwaite's formula."""
    varies = Variation(np.array([[12e-8, 0.0], [0.0, 0.0]]), 9.0, 8.0)
    result = estimates(variation=varies).for_new_flight()
    np.testing.assert_allclose(result.covariance, [[16e-8, 1e-11], [1e-11, 1e-14]])
    np.testing.assert_allclose(result.degrees_of_freedom, [16.0**2 / (4.0**2 / 12.0 + 12.0**2 / 9.0), 12.0])
    assert result.variation is None
    plain = estimates()
    assert plain.for_new_flight() is plain
    # The variation between flights adds to the variation within a flight.
    between = Variation(np.array([[4e-8, 0.0], [0.0, 0.0]]), 2.0, 40.0)
    result = estimates(variation=varies, flight_variation=between).for_new_flight()
    assert result.covariance[0, 0] == pytest.approx(20e-8)
    assert result.degrees_of_freedom[0] == pytest.approx(20.0**2 / (4.0**2 / 12.0 + 12.0**2 / 9.0 + 4.0**2 / 2.0))
    assert result.flight_variation is None
    part = estimates(flight_variation=between).subset(["inertia[2]", "mass"])
    np.testing.assert_array_equal(part.flight_variation.covariance, [[0.0, 0.0], [0.0, 4e-8]])
    part = estimates(variation=varies).subset(["inertia[2]", "mass"])
    np.testing.assert_array_equal(part.variation.covariance, [[0.0, 0.0], [0.0, 12e-8]])


def test_an_unknown_variation_does_not_change_the_covariance_for_a_new_flight():
    varies = Variation(np.array([[12e-8]]), 9.0, 8.0).with_unknown_parameters(1)
    np.testing.assert_array_equal(varies.covariance, np.diag([12e-8, np.nan]))
    result = estimates(variation=varies)
    np.testing.assert_array_equal(result.variation_known, [True, False])
    np.testing.assert_array_equal(estimates().variation_known, [False, False])
    np.testing.assert_allclose(result.for_new_flight().covariance, [[16e-8, 1e-11], [1e-11, 1e-14]])
    assert result.for_new_flight().degrees_of_freedom[1] == pytest.approx(12.0)


def test_few_degrees_of_freedom_widen_an_interval():
    """The half-width of the 95 % interval is 2.36 standard deviations for seven degrees of freedom."""
    assert EstimatedValue(1.0, 0.1, "N", 7.0).half_width == pytest.approx(0.2365, abs=1e-4)
    assert EstimatedValue(1.0, 0.1, "N").half_width == pytest.approx(0.1960, abs=1e-4)


def test_a_covariance_with_rounding_errors_becomes_symmetric():
    result = estimates(covariance=[[4e-8, 1e-11], [1e-11 * (1.0 + 1e-9), 1e-14]])
    np.testing.assert_array_equal(result.covariance, result.covariance.T)


def test_a_subset_of_estimates_keeps_the_data_of_its_parameters():
    result = estimates(
        names=("mass", "inertia[2]", "arm_length"),
        values=[0.033, 3e-5, 0.05],
        covariance=np.diag([1.0, 4.0, 9.0]) + 0.1,
        degrees_of_freedom=[1.0, 2.0, 3.0],
        sources=((SOURCE,), (SOURCE, Source("scale", "none")), (SOURCE,)),
        explained_variance={"mass": ExplainedVariance(0.5, "thrust"), "arm_length": ExplainedVariance(0.1, "roll")},
        not_identified={"drag_factor": "yaw was not moved", "mass": "it was"},
    )
    part = result.subset(["arm_length", "inertia[2]"])
    assert part.names == ("arm_length", "inertia[2]")
    np.testing.assert_array_equal(part.values, [0.05, 3e-5])
    np.testing.assert_array_equal(part.covariance, [[9.1, 0.1], [0.1, 4.1]])
    assert (tuple(part.degrees_of_freedom), part.sources_of(1)) == ((3.0, 2.0), (SOURCE, Source("scale", "none")))
    assert part.explained_variance == {"arm_length": ExplainedVariance(0.1, "roll")}
    # A parameter that is not identified may be among the estimates, with the value of the data sheet.
    assert result.identified == ("inertia[2]", "arm_length")
    assert result.not_identified == part.not_identified == {"drag_factor": "yaw was not moved", "mass": "it was"}
    assert part.value("arm_length") == 0.05
    with pytest.raises(InputError, match="no estimate of drag_factor: yaw was not moved"):
        part.value("drag_factor")
    with pytest.raises(InputError, match="no estimate of mass"):
        part.subset(["mass"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ("mass", "mass")}, "'mass' is estimated twice"),
        ({"values": [0.033]}, "2 names need"),
        ({"values": [0.033, np.nan]}, "'inertia\\[2\\]' has mean nan"),
        ({"covariance": np.diag([1.0, 0.0])}, "variance 0"),
        ({"degrees_of_freedom": 0.0}, "degrees of freedom"),
        ({"sources": ((SOURCE,),)}, "an item for each of the 2 estimates, not 1"),
        ({"not_identified": {"weight": "it was not weighed"}}, "no parameter .* called 'weight'"),
    ],
)
def test_invalid_estimates_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        estimates(**changes)
