"""Tests of the stretches of flight to which a position law is fitted, and of the output of the law in a log."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from drake_quad import load_undesigned
from drake_quad.errors import InputError
from drake_quad.identification.position_law.commands import (
    FORMS,
    at_limit,
    in_heading,
    law_output,
    specific_thrust,
)
from drake_quad.identification.position_law.pieces import block_numbers, prepared_pieces
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period
TIME = PERIOD * np.arange(600)  # s


@pytest.fixture(scope="module")
def vehicle():
    return load_undesigned("vehicles/crazyflie")


def polynomials(time):
    """Return quadratic polynomials (n, 3) and their first two derivatives."""
    bases = np.array([time**0, time, time**2]), np.array([0.0 * time, time**0, 2.0 * time])
    weights = np.array([[0.1, 0.2, -0.3], [0.3, -0.2, 0.1], [0.02, 0.05, -0.04]])
    return bases[0].T @ weights, bases[1].T @ weights, np.tile(2.0 * weights[2], (len(time), 1))


def record_of(time=TIME, **changed):
    """Return a log with polynomials as position and reference, and commands that never stay at an extreme value."""
    reference, velocity, _ = polynomials(time)
    angles = 0.2 * np.sin(np.outer(time, [3.0, 4.0, 5.0]) + np.arange(3.0))
    signals = {
        "position": -0.5 * reference,
        "velocity": -0.5 * velocity,
        "attitude": 0.9 * angles,
        "attitude_command": angles,
        "thrust_command": 0.3 + 0.05 * np.sin(6.0 * time),
        "reference_position": reference,
        "reference_velocity": velocity,
    }
    return FlightRecord("log", time, **signals | changed)


def smoothed(values):
    """Return signals (n, 3), smoothed by a binomial average over five samples; the end samples are repeated."""
    values = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    for _ in range(4):
        values = 0.5 * (values[1:] + values[:-1])
    return values


def eroded(mask):
    """Return a mask of the samples that are in the given mask with their two neighbours on each side."""
    result = mask.copy()
    for distance in (1, 2):
        result[distance:] &= mask[:-distance]
        result[:-distance] &= mask[distance:]
    result[:2] = result[-2:] = False
    return result


def integrals(values):
    """Return the integrals (n, 3) of signals by the trapezoidal rule, starting at zero."""
    steps = 0.5 * PERIOD * (values[1:] + values[:-1])
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def in_axes_of(form, record, values):
    """Return vectors along the axes of a form of the law: along the measured heading for `tilt`, else unchanged."""
    if form != "tilt":
        return values
    level = (values[:, 0] + 1j * values[:, 1]) * np.exp(-1j * record.attitude[:, 2])
    return np.column_stack([level.real, level.imag, values[:, 2]])


def test_pieces_contain_the_signals_of_the_log_and_the_command_of_each_form(vehicle):
    record, remarks = record_of(), []
    actual, limited = prepared_pieces(record, vehicle, remarks)
    assert {*actual} == {*FORMS}
    reference, velocity, acceleration = polynomials(TIME)
    thrust = record.thrust_command / vehicle.nominal.mass
    for form, (piece,) in actual.items():
        expected = {
            "command": law_output(record, thrust, form, vehicle.nominal.gravity),
            "error": in_axes_of(form, record, 1.5 * reference),
            "velocity": in_axes_of(form, record, record.velocity),
            "reference_velocity": in_axes_of(form, record, velocity),
            "reference_acceleration": in_axes_of(form, record, acceleration),
        }
        np.testing.assert_array_equal(piece.time, TIME)
        for name, values in expected.items():
            np.testing.assert_allclose(getattr(piece, name), smoothed(values), atol=1e-9, err_msg=f"{form} {name}")
        np.testing.assert_allclose(piece.travel, integrals(smoothed(expected["velocity"])), atol=1e-9)
        # A command depends on measurements up to 0.15 s before it, and smoothing on two samples on each side.
        np.testing.assert_array_equal(np.flatnonzero(piece.evaluated), np.arange(17, 598))
    assert not limited.any()
    assert len(limited) == len(TIME)
    assert remarks == [f"the thrust is divided by the nominal mass, {vehicle.nominal.mass:g} kg"]


def test_smoothing_does_not_change_lines_and_adds_half_of_the_curvature_to_parabolas(vehicle):
    """The binomial weights have a standard deviation of one period."""
    (piece,) = prepared_pieces(record_of(), vehicle, [])[0]["projected"]
    reference, velocity, acceleration = polynomials(TIME)
    inner = slice(2, -2)
    np.testing.assert_allclose(piece.error[inner], (1.5 * (reference + 0.5 * PERIOD**2 * acceleration))[inner])
    np.testing.assert_allclose(piece.velocity[inner], -0.5 * velocity[inner], atol=1e-12)
    # Except at the repeated end samples, the integral of the velocity is the displacement since the first sample.
    displacement = -0.5 * (reference - reference[2])
    np.testing.assert_allclose((piece.travel - piece.travel[2])[inner], displacement[inner], atol=1e-12)


def test_the_deviation_is_the_position_noise_in_the_form_decoupled_and_zero_in_all_others(vehicle):
    """The deviation is the noise of the logged position plus the first position error."""
    reference, *_ = polynomials(TIME)
    wrong = 1e-3 * np.random.default_rng(7).normal(size=(600, 3))
    result, _ = prepared_pieces(record_of(position=-0.5 * reference - wrong), vehicle, [])
    for form, (piece,) in result.items():
        if form != "decoupled":
            assert not piece.deviation.any()
    (piece,) = result["decoupled"]
    rest = (piece.deviation - smoothed(wrong))[2:-2]
    np.testing.assert_allclose(rest, np.tile(rest[0], (len(rest), 1)), atol=1e-9)
    np.testing.assert_allclose(rest[0], 1.5 * reference[0], atol=0.01)


def test_the_anti_windup_term_is_the_integral_of_the_output_that_the_thrust_does_not_produce(
    vehicle,
):
    """In the form `decoupled`, the tilt is computed for the thrust g, but the thrust is g + u_z.

    They produce the fraction 1 + u_z / g of the horizontal output.
    """
    record, gravity = record_of(), vehicle.nominal.gravity
    result, _ = prepared_pieces(record, vehicle, [])
    for form, (piece,) in result.items():
        if form != "decoupled":
            assert not piece.anti_windup.any()
    output = law_output(record, record.thrust_command / vehicle.nominal.mass, "decoupled", gravity)
    missing = np.zeros_like(output)
    sinks = output[:, 2] < 0.0
    produced = (1.0 + output[sinks, 2:] / gravity) * output[sinks, :2]
    missing[sinks, :2] = output[sinks, :2] - produced
    assert 100 < sinks.sum() < 500
    np.testing.assert_allclose(result["decoupled"][0].anti_windup, integrals(smoothed(missing)), atol=1e-12)


def test_derivatives_that_are_not_logged_follow_from_fitted_parabolas(vehicle):
    """The logs contain no derivatives. The derivative of a fitted parabola is exact for the quadratic test signals.

    Smoothing changes a straight line only at its ends, so the smoothed velocity is the expected one.
    """
    _, velocity, acceleration = polynomials(TIME)
    result, _ = prepared_pieces(record_of(velocity=None, reference_velocity=None), vehicle, [])
    (piece,) = result["acceleration"]
    np.testing.assert_allclose(piece.velocity, smoothed(-0.5 * velocity), atol=1e-9)
    np.testing.assert_allclose(piece.reference_velocity, smoothed(velocity), atol=1e-9)
    np.testing.assert_allclose(piece.reference_acceleration, acceleration, atol=1e-7)
    logged = np.random.default_rng(1).normal(size=(600, 3))
    for lost in ({}, {"reference_velocity": None}):
        result, _ = prepared_pieces(record_of(reference_acceleration=logged, **lost), vehicle, [])
        np.testing.assert_allclose(result["heading"][0].reference_acceleration, smoothed(logged), atol=1e-12)


@pytest.mark.parametrize(("period", "half"), [(0.01, 5), (0.02, 2), (0.05, 2), (0.004, 12)])
def test_parabolas_last_a_tenth_of_a_second_and_have_at_least_five_samples(vehicle, period, half):
    """A single wrong value of 1 changes the derivative at a distance of d samples by -d / Σ d², within the parabola."""
    time = period * np.arange(round(6.0 / period))
    reference, velocity, _ = polynomials(time)
    wrong_sample = len(time) // 2
    reference[wrong_sample, 0] += 1e-4
    result, _ = prepared_pieces(record_of(time, reference_position=reference, reference_velocity=None), vehicle, [])
    distances = np.arange(-half, half + 1)
    wrong = velocity.copy()
    wrong[wrong_sample - half : wrong_sample + half + 1, 0] -= 1e-4 * distances / np.sum(distances**2) / period
    np.testing.assert_allclose(result["acceleration"][0].reference_velocity, smoothed(wrong), atol=1e-9)


def test_samples_after_a_jump_of_the_reference_are_left_out(vehicle):
    """The reference jumps at 3 s by 20 cm along Z.

    The derivatives of the reference are those of parabolas over 0.1 s, so they are wrong from 2.95 s to 3.05 s. The
    samples of the next 0.15 s are left out as well, because commands may be delayed by this time. Smoothing affects two
    more samples on each side.
    """
    reference, *_ = polynomials(TIME)
    reference[300:, 2] += 0.2
    result, _ = prepared_pieces(record_of(reference_position=reference), vehicle, [])
    (piece,) = result["acceleration"]
    left_out = np.setdiff1d(np.arange(17, 598), np.flatnonzero(piece.evaluated))
    assert np.all(np.diff(left_out) == 1)
    assert 293 <= left_out[0] < 297
    # The parabolas before and after the jump have opposite curvatures of the same size.
    assert left_out[-1] == 599 - left_out[0] + 15
    # A reference jumps if its acceleration exceeds 50 m/s².
    for size, counts in ((49.0, True), (51.0, False)):
        bent = 0.5 * size * np.maximum(TIME - 3.0, 0.0)[:, None] ** 2 * np.array([0.0, 1.0, 0.0])
        result, _ = prepared_pieces(record_of(reference_position=bent), vehicle, [])
        assert result["acceleration"][0].evaluated[400] == counts


def test_a_stretch_ends_at_a_gap_and_needs_two_seconds_for_the_regression(vehicle):
    """The regression can use 2.01 s of the second of three stretches, and 1.98 s of the first and third.

    The time for delay and smoothing is subtracted.
    """
    time = PERIOD * np.arange(700)
    time = np.concatenate([time[:217], time[230:450], time[463:680]])
    record = record_of(time)
    actual, limited = prepared_pieces(record, vehicle, [])
    (piece,) = actual["acceleration"]
    np.testing.assert_array_equal(piece.time, time[217:437])
    np.testing.assert_allclose(piece.error, smoothed(1.5 * record.reference_position[217:437]))
    thrust = record.thrust_command / vehicle.nominal.mass
    expected = smoothed(law_output(record, thrust, "acceleration", vehicle.nominal.gravity)[217:437])
    np.testing.assert_allclose(piece.command, expected, atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(piece.evaluated), np.arange(17, 218))
    assert len(limited) == len(time)
    with pytest.raises(InputError, match="no uninterrupted stretch of flight of at least 2 s and 60 samples"):
        prepared_pieces(record.subset(slice(217)), vehicle, [])


def test_a_stretch_of_a_slow_log_needs_sixty_samples_for_the_regression(vehicle):
    """At 20 Hz, delay and smoothing need seven samples in addition to the sixty of the regression."""
    time = 0.05 * np.arange(67)
    (piece,) = prepared_pieces(record_of(time), vehicle, [])[0]["acceleration"]
    assert piece.evaluated.sum() == 60
    with pytest.raises(InputError, match="no uninterrupted stretch of flight of at least 2 s and 60 samples"):
        prepared_pieces(record_of(time[:66]), vehicle, [])


def test_samples_at_a_limit_and_on_the_ground_are_not_used_in_the_regression(vehicle):
    time = PERIOD * np.arange(1200)
    angles = record_of(time).attitude_command
    cut = np.column_stack([np.minimum(angles[:, 0], 0.15), angles[:, 1:]])
    thrust = np.where(time < 6.0, 0.3, 0.0) + 0.05 * np.sin(6.0 * time) * (time < 6.0)
    result, limited = prepared_pieces(record_of(time, attitude_command=cut, thrust_command=thrust), vehicle, [])
    (piece,) = result["acceleration"]
    # The last second before the landing is left out.
    assert not piece.evaluated[time[: len(piece.time)] > 5.0].any()
    assert len(limited) == 500
    # A sample is at a limit if its distance to the limit is less than 0.5 % of the range.
    np.testing.assert_array_equal(limited, cut[:500, 0] >= 0.15 - 0.005 * 0.35)
    # A smoothed sample depends on two neighbours on each side.
    usable = (np.arange(500) >= 15) & ~limited
    np.testing.assert_array_equal(piece.evaluated[:500], eroded(usable))


def test_logs_without_motion_are_refused(vehicle):
    resting = np.zeros((600, 3))
    almost = resting + np.where(np.arange(600) < 300, 0.0, 0.019)[:, None]
    for reference in (resting, almost):
        with pytest.raises(InputError, match="the reference of the log 'log' does not move"):
            prepared_pieces(record_of(reference_position=reference), vehicle, [])
    moving = almost * [1.0, 1.2, 1.0]
    assert prepared_pieces(record_of(reference_position=moving), vehicle, [])
    with pytest.raises(InputError, match="the log 'log' has no sample in the air"):
        prepared_pieces(record_of(thrust_command=np.zeros(600)), vehicle, [])


def test_a_measured_attitude_replaces_a_command_that_is_not_logged(vehicle):
    record, remarks = record_of(), []
    actual, _ = prepared_pieces(replace(record, attitude_command=None), vehicle, remarks)
    thrust = record.thrust_command / vehicle.nominal.mass
    expected = thrust[:, None] * rotation_matrices(record.attitude).apply([0.0, 0.0, 1.0]) - np.array(
        [0.0, 0.0, vehicle.nominal.gravity]
    )
    for form in ("acceleration", "heading", "projected"):
        np.testing.assert_allclose(actual[form][0].command, smoothed(expected), atol=1e-9, err_msg=form)
    assert remarks[0] == (
        "no attitude command is logged; the measured attitude is used instead, and the delay includes its lag"
    )
    with pytest.raises(InputError, match="lacks attitude"):
        prepared_pieces(replace(record, attitude_command=None, attitude=None), vehicle, [])


def test_a_commanded_yaw_replaces_a_measured_one_that_is_not_logged():
    """The force is along the commanded thrust axis if no attitude is measured."""
    random = np.random.default_rng(1)
    angles, thrust = random.uniform(-0.5, 0.5, (20, 3)), random.uniform(5.0, 15.0, 20)
    record = FlightRecord("log", np.arange(20.0), attitude_command=angles)
    expected = thrust[:, None] * rotation_matrices(angles).apply([0.0, 0.0, 1.0]) - [0.0, 0.0, 9.81]
    for form in ("acceleration", "heading", "projected"):
        np.testing.assert_allclose(law_output(record, thrust, form, 9.81), expected, atol=1e-12, err_msg=form)
    # A positive pitch accelerates forward, and a positive roll to the right.
    tilt = law_output(record, thrust, "tilt", 9.81)
    np.testing.assert_array_equal(tilt, np.column_stack([angles[:, 1], -angles[:, 0], thrust - 9.81]))
    along = random.normal(size=(20, 3))
    in_world = scipy.spatial.transform.Rotation.from_euler("z", angles[:, 2:]).apply(along)
    np.testing.assert_allclose(in_heading(record, in_world), along, atol=1e-12)


def test_a_command_perpendicular_to_the_measured_thrust_causes_no_division_by_zero():
    """The cosine is set to 0.2 for angles above 78°."""
    angles = np.array([[1.3, 0.0, 0.0], [1.4, 0.0, 0.0], [2.5, 0.0, 0.0]])
    cosine = np.array([np.cos(1.3), 0.2, 0.2])
    record = FlightRecord("log", np.arange(3.0), attitude=np.zeros((3, 3)), attitude_command=angles)
    axis = rotation_matrices(angles).apply([0.0, 0.0, 1.0])
    projected = law_output(record, np.full(3, 10.0), "projected", 9.81)
    np.testing.assert_allclose(projected[:, :2], 10.0 * axis[:, :2] / cosine[:, None])
    decoupled = law_output(record, np.full(3, 10.0), "decoupled", 9.81)
    np.testing.assert_allclose(decoupled[:, :2], 9.81 * axis[:, :2] / cosine[:, None])
    np.testing.assert_allclose(decoupled[:, 2], 10.0 * axis[:, 2] - 9.81)


def test_specific_thrust_follows_from_a_thrust_in_newtons_or_a_hover_thrust_or_the_median_command(vehicle):
    gravity, mass = vehicle.nominal.gravity, vehicle.nominal.mass
    fraction = np.array([0.0, 0.4, 0.5, 0.8, 0.9])
    usable = fraction > 0.0
    record = FlightRecord("log", np.arange(5.0), thrust_fraction=fraction, hover_thrust_fraction=np.full(5, 0.25))
    thrust, remark = specific_thrust(record, vehicle, usable)
    np.testing.assert_allclose(thrust, gravity * fraction / 0.25)
    assert remark is None
    thrust, remark = specific_thrust(replace(record, hover_thrust_fraction=None), vehicle, usable)
    np.testing.assert_allclose(thrust, gravity * fraction / 0.65)
    assert remark == "the median thrust command in the air, 0.65 of full thrust, is assumed to carry the weight"
    thrust, remark = specific_thrust(replace(record, thrust_command=fraction), vehicle, usable)
    np.testing.assert_allclose(thrust, fraction / mass)
    assert remark == f"the thrust is divided by the nominal mass, {mass:g} kg"
    with pytest.raises(InputError, match="thrust_fraction of the log 'log' is zero in the air; check the mapping"):
        specific_thrust(replace(record, hover_thrust_fraction=None), vehicle, ~usable)


# The samples of a triangle wave are uniformly distributed over its range.
TRIANGLE = np.abs(np.arange(2000) % 400 - 200.0) / 100.0 - 1.0


def limited(usable=None, *, thrust=TRIANGLE, roll=0.1 * TRIANGLE, pitch=0.1 * TRIANGLE):
    command = np.column_stack([roll, pitch, np.zeros(2000)])
    record = FlightRecord("log", 0.01 * np.arange(2000), attitude_command=command)
    return at_limit(record, 10.0 + thrust, np.ones(2000, dtype=bool) if usable is None else usable)


@pytest.mark.parametrize("name", ["thrust", "roll", "pitch"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_clipped_command_is_at_a_limit(name, sign):
    """Commands next to the saturation limit, or at the other extreme, are not in the mask of saturated samples."""
    size = 1.0 if name == "thrust" else 0.3
    cut = np.minimum(TRIANGLE, 0.8)
    result = limited(**{name: sign * size * cut})
    np.testing.assert_array_equal(result, cut == 0.8)
    assert not limited().any()


def test_a_clipped_tilt_is_at_a_limit():
    """The vehicle yaws at a constant tilt half of the time, so neither roll nor pitch stays at an extreme."""
    tilt = np.minimum(0.15 * (TRIANGLE + 1.0), 0.2)
    direction = 0.037 * np.arange(2000)
    pitch = np.arcsin(np.sin(tilt) * np.cos(direction))
    roll = np.arctan2(np.sin(tilt) * np.sin(direction), np.cos(tilt))
    result = limited(roll=roll, pitch=pitch)
    assert result[tilt == 0.2].all()
    assert not result[tilt < 0.199].any()


def test_a_limit_is_recognised_by_the_number_of_samples_at_and_near_an_extreme():
    samples = np.arange(2000)
    spread = 0.5 * TRIANGLE

    def num_limited(at_maximum, below_maximum, usable=None):
        thrust = np.where(samples < at_maximum, 1.0, spread)
        # The thrust has a range of 1.5. `here` samples are at the maximum. `beside` samples are below the maximum by
        # 0.75 % of the range, between the two margins of 0.5 % and 1 %.
        thrust = np.where((samples >= at_maximum) & (samples < at_maximum + below_maximum), 1.0 - 1.5 * 0.0075, thrust)
        return limited(usable, thrust=thrust).sum()

    assert (num_limited(7, 0), num_limited(8, 0)) == (0, 8)
    assert (num_limited(29, 5), num_limited(30, 5)) == (0, 30)
    assert (num_limited(1000, 0), num_limited(1001, 0)) == (1000, 0)
    # Samples on the ground are never in the mask.
    assert num_limited(20, 0, samples >= 10) == 10
    assert num_limited(600, 0, samples < 1000) == 0
    assert num_limited(15, 0, samples >= 10) == 0


def test_a_constant_command_is_not_at_a_limit():
    assert not limited(np.arange(2000) < 15, thrust=np.ones(2000)).any()
    log = FlightRecord("log", 0.01 * np.arange(2000))
    cut = np.minimum(TRIANGLE, 0.8)
    np.testing.assert_array_equal(at_limit(log, cut, np.ones(2000, dtype=bool)), cut == 0.8)


@pytest.mark.parametrize(("seconds", "expected"), [(10.0, 15), (29.0, 15), (32.0, 16), (43.2, 22)])
def test_regression_samples_are_divided_into_equal_blocks_of_two_seconds(vehicle, seconds, expected):
    """There are at least fifteen blocks, in the order of time. Only samples in `evaluated` belong to a block."""
    time = PERIOD * np.arange(1200)
    (piece,) = prepared_pieces(record_of(time), vehicle, [])[0]["acceleration"]
    count = round(seconds / PERIOD / 4)
    pieces = [piece._replace(evaluated=np.arange(1200) < count)] * 4
    numbers = block_numbers(pieces)
    assert len(numbers) == 4 * count
    assert numbers[0] == 0
    assert numbers[-1] == expected - 1
    assert {*np.diff(numbers)} == {0, 1}
    sizes = np.bincount(numbers)
    assert np.ptp(sizes) <= 1
