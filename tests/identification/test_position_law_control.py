"""Tests of the conversion of identified position laws to the `control` section of a scenario."""

import numpy as np
import pytest

from drake_quad.identification.evidence import quantile
from drake_quad.identification.position_law.control import control_layer
from drake_quad.identification.position_law.law import AxisLaw, PositionLaw
from drake_quad.identification.result import EstimatedValue

# Gains of a PD controller with feed-forward, in units of s.
PD_GAINS = {"position": 4.0, "velocity": 3.0, "reference_velocity": 3.0, "reference_acceleration": 1.0}


def law_of(*axes, form="acceleration", half_width=1e-3):
    """Return a law from the gains of X, Y and Z. A gain is a value, or a value with the half-width of its interval."""
    result = []
    for name, gains in zip("xyz", axes, strict=True):
        pairs = {key: value if isinstance(value, tuple) else (value, half_width) for key, value in gains.items()}
        spreads = {key: EstimatedValue(value, width / quantile(9.0), "", 9.0) for key, (value, width) in pairs.items()}
        result.append(AxisLaw((name,), spreads, 0.999))
    # The order of the axes in a position law does not matter.
    return PositionLaw(tuple(result[::-1]), form, 0.0)


def control_of(*axes, **options):
    return control_layer(law_of(*(axes if len(axes) == 3 else axes * 3), **options))["control"]


def test_a_pd_has_the_gains_of_each_axis_to_five_digits():
    control = control_of(*(PD_GAINS | {"position": 4.0 + i, "velocity": 3.0 - 0.0123456789 * i} for i in range(3)))
    assert control == {
        "position": {
            "kind": "pd",
            "k_p": [4.0, 5.0, 6.0],
            "k_d": [3.0, 2.9877, 2.9753],
            "derivative": "tracking_error",
            "feed_forward": "acceleration",
        }
    }


def test_a_law_without_an_error_limit_has_no_sample_at_the_limit():
    for axis in law_of(PD_GAINS, PD_GAINS, PD_GAINS).axes:
        assert axis.at_error_limit == 0.0
        assert axis.gain("error_limit") == 0.0


def test_a_pid_has_an_integral_on_each_axis_whose_law_has_one():
    control = control_of(PD_GAINS, PD_GAINS | {"integral": 2.0}, PD_GAINS | {"integral": -0.0001})
    assert control["position"]["kind"] == "pid"
    assert control["position"]["k_i"] == [0.0, 2.0, 0.0]


@pytest.mark.parametrize(
    ("integral", "kind"),
    [
        # The integral gain must exceed the half-width of its interval, and 0.5 % of the position gain.
        ((0.3, 0.29), "pid"),
        ((0.3, 0.31), "pd"),
        ((-0.3, 0.29), "pid"),
        ((0.021, 0.001), "pid"),
        ((0.019, 0.001), "pd"),
    ],
)
def test_an_integral_gain_that_may_be_zero_is_left_out(integral, kind):
    assert control_of(PD_GAINS | {"integral": integral})["position"]["kind"] == kind


@pytest.mark.parametrize(
    ("reference_velocity", "derivative", "fraction"),
    [
        ((0.0, 1e-3), "measurement", 0.0),
        # The velocity gain is 3, so the feedforward is the gain of the reference velocity divided by 3. A feedforward
        # that differs from 0 or 1 by less than 0.05, or by less than its half-width, becomes 0 or 1.
        ((0.14, 1e-3), "measurement", 0.0),
        ((-0.14, 1e-3), "measurement", 0.0),
        ((0.16, 1e-3), None, 0.16 / 3.0),
        ((0.9, 0.91), "measurement", 0.0),
        ((0.9, 0.89), None, 0.3),
        ((2.86, 1e-3), "tracking_error", 1.0),
        ((2.84, 1e-3), None, 2.84 / 3.0),
        ((3.14, 1e-3), "tracking_error", 1.0),
        ((2.4, 0.61), "tracking_error", 1.0),
        ((2.4, 0.59), None, 0.8),
        ((-0.16, 1e-3), None, 0.0),
        # If the interval contains both 0 and 1, the feedforward is 0.
        ((1.6, 1.7), "measurement", 0.0),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pd_feeds_forward_either_the_whole_reference_velocity_or_none_of_it(
    reference_velocity, derivative, fraction, sign
):
    """A feedforward between 0 and 1 gives a cascade. The feedforward does not depend on the sign of the gains."""
    value, half_width = reference_velocity
    control = control_of(PD_GAINS | {"velocity": sign * 3.0, "reference_velocity": (sign * value, half_width)})
    if derivative is None:
        assert control["kind"] == "pid_cascade"
        assert control["velocity_feed_forward"] == pytest.approx(fraction, rel=1e-4)
    else:
        assert "kind" not in control
        assert control["position"]["derivative"] == derivative


def test_the_velocity_feedforward_is_averaged_over_the_axes_that_determine_it():
    """If no axis determines the velocity feedforward, the law acts on the error and its derivative."""
    without = {"position": 4.0, "velocity": 3.0}
    control = control_of(without, without | {"reference_velocity": 0.9}, without | {"reference_velocity": 1.5})
    assert control["velocity_feed_forward"] == pytest.approx(0.4)
    control = control_of(without)
    assert control["position"]["derivative"] == "tracking_error"
    assert control["position"]["feed_forward"] == "none"


@pytest.mark.parametrize(
    ("fed", "expected"),
    [
        ((0.0, 1e-3), "none"),
        ((0.04, 1e-3), "none"),
        ((0.3, 0.31), "none"),
        ((0.96, 1e-3), "acceleration"),
        ((0.7, 0.31), "acceleration"),
        ((0.3, 0.29), 0.3),
        ((0.06, 1e-3), 0.06),
        ((0.94, 1e-3), 0.94),
        ((-0.06, 1e-3), 0.0),
    ],
)
def test_an_acceleration_feedforward_near_zero_or_one_becomes_zero_or_one(fed, expected):
    control = control_of(PD_GAINS | {"reference_acceleration": fed})
    if isinstance(expected, str):
        assert control["position"]["feed_forward"] == expected
    else:
        assert control["command"] == {"kind": "acceleration", "feed_forward": expected}


def test_a_pd_has_acceleration_feedforward_if_at_least_one_axis_has_it():
    control = control_of(PD_GAINS, PD_GAINS | {"reference_acceleration": 0.0}, PD_GAINS)
    assert control["position"]["feed_forward"] == "acceleration"
    control = control_of(PD_GAINS | {"reference_acceleration": 0.2}, PD_GAINS, {"position": 1.0, "velocity": 2.0})
    assert control["command"]["feed_forward"] == pytest.approx(0.6)
    control = control_of({"position": 1.0, "velocity": 2.0, "reference_velocity": 1.0})
    assert control["command"]["feed_forward"] == 0.0


@pytest.mark.parametrize("name", ["displacement", "double_integral", "error_limit"])
@pytest.mark.parametrize("axis", range(3))
def test_a_law_with_a_term_that_a_pid_lacks_is_a_cascade(name, axis):
    laws = [dict(PD_GAINS) for _ in range(3)]
    laws[axis][name] = 0.5
    assert control_of(*laws)["kind"] == "pid_cascade"
    laws[axis][name] = (0.5, 0.6)
    assert "kind" not in control_of(*laws)


def test_a_limit_of_the_error_limits_the_velocity_of_a_cascade():
    """The limit of the velocity is the position gain times the limit of the error; 1000 m/s means no limit."""
    control = control_of(
        PD_GAINS | {"error_limit": 0.5}, PD_GAINS, PD_GAINS | {"velocity": 2.0, "reference_velocity": 2.0}
    )
    np.testing.assert_allclose(control["position"]["k_p"], [4.0 / 3.0, 4.0 / 3.0, 2.0], rtol=1e-4)
    np.testing.assert_allclose(control["position"]["limit"], [2.0 / 3.0, 1000.0, 1000.0], rtol=1e-4)
    assert "k_i" not in control["position"]
    assert "k_i" not in control["velocity"]
    assert "limit" not in control_of(PD_GAINS | {"displacement": 0.5})["position"]


def test_a_law_that_commands_a_tilt_is_written_as_a_cascade_with_tilt_commands():
    control = control_of(PD_GAINS, form="tilt")
    assert (control["kind"], control["command"]) == ("pid_cascade", {"kind": "tilt"})
    assert control["velocity_feed_forward"] == 1.0


def test_axes_of_a_cascade_have_individual_gains():
    """Half of the velocity is fed forward.

    The position loop has the gains K and K_i, and the velocity loop has the gains k and k_i'. The law of such a cascade
    has the gains k_p = k K + ½ k_i', k_x = ½ k_i' and k_i = k_i' K + k K_i.
    """
    loops = [(1.0, 2.0, 0.3, 0.4), (1.5, 3.0, 0.0, 0.6), (2.0, 4.0, 0.5, 0.0)]
    control = control_of(
        *(
            {
                "position": velocity * position + 0.5 * of_velocity,
                "velocity": velocity,
                "reference_velocity": 0.5 * velocity,
                "integral": of_velocity * position + velocity * of_position,
                "displacement": 0.5 * of_velocity,
                "double_integral": 1.0,
            }
            for position, velocity, of_position, of_velocity in loops
        )
    )
    for index, (loop, name) in enumerate(
        [("position", "k_p"), ("velocity", "k_p"), ("position", "k_i"), ("velocity", "k_i")]
    ):
        np.testing.assert_allclose(control[loop][name], [each[index] for each in loops], rtol=1e-4, atol=1e-9)
    assert control["velocity_feed_forward"] == 0.5


def test_integral_gains_are_not_negative():
    """An integral gain of a loop that would be negative is set to zero.

    The displacement gain of the law determines the integral gain of the velocity loop. The rest of the law's integral
    gain determines the integral gain of the position loop.
    """
    base = {"position": 4.0, "velocity": 2.0, "reference_velocity": 1.0}
    control = control_of(base | {"displacement": -0.5, "double_integral": 1.0, "integral": -1.0})
    assert "k_i" not in control["position"]
    assert "k_i" not in control["velocity"]
    assert control["position"]["k_p"] == [2.0] * 3
    # If the law has no double integral, the position loop has no integral gain.
    control = control_of(base | {"displacement": 0.5, "integral": 9.0})
    assert "k_i" not in control["position"]
    assert control["velocity"]["k_i"] == [1.0] * 3


def test_the_larger_of_two_possible_position_gains_is_taken():
    """With the whole reference velocity fed forward, k_p = k K + k_i' = 10 and k_i = k_i' K = 12.

    For the velocity gain k = 2, the position gain K is either 3 with the integral gain k_i' = 4, or 2 with k_i' = 6.
    """
    law = {"position": 10.0, "velocity": 2.0, "reference_velocity": 2.0, "reference_acceleration": 0.5}
    control = control_of(law | {"integral": 12.0})
    assert control["position"]["k_p"] == [3.0] * 3
    assert control["velocity"]["k_i"] == [4.0] * 3
    # Both roots coincide if the integral gain is the largest one that a cascade can have.
    control = control_of(law | {"integral": 12.5})
    assert control["position"]["k_p"] == [2.5] * 3
    control = control_of(law | {"integral": -1.0})
    assert "k_i" not in control["velocity"]
