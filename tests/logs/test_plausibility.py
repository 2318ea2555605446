"""Tests of the units of logs, and of the limits beyond which a log is reported as doubtful."""

import numpy as np
import pytest
import scipy.constants as known

from drake_quad.logs.conversion import Table, _Clocks
from drake_quad.logs.plausibility import implausible_signals, position_jumps
from drake_quad.logs.record import QUANTITIES
from drake_quad.logs.timing import increasing_samples, timing_remarks
from drake_quad.logs.units import UNITS

# Size of each unit in SI units.
UNIT_SCALES = {
    "ms": known.milli,
    "us": known.micro,
    "ns": known.nano,
    "cm": known.centi,
    "mm": known.milli,
    "cm/s": known.centi,
    "mm/s": known.milli,
    "km/h": known.kmh,
    "mm/s²": known.milli,
    "g": known.g,
    "mrad": known.milli,
    "deg": known.degree,
    "mrad/s": known.milli,
    "deg/s": known.degree,
    "rpm": 2.0 * known.pi / known.minute,
    "%": 0.01,
    "uint16": 1.0 / (2**16 - 1),
    "servo us": known.milli,
    "mN": known.milli,
    "gf": known.gram * known.g,
    "mN m": known.milli,
    "mV": known.milli,
}


def test_unit_scales_agree_with_published_constants():
    for of, units in UNITS.items():
        for name, unit in units.items():
            assert unit.scale == pytest.approx(1.0 if name == of else UNIT_SCALES[name])
            assert unit.zero == (1000.0 if name == "servo us" else 0.0)
    assert {quantity.unit for quantity in QUANTITIES.values()} <= {*UNITS}


def path(count=400, period=0.01):
    """Return times (s) and positions (m) along a straight line at 1 m/s."""
    time = period * np.arange(count)
    return time, np.column_stack([time, 0.0 * time, 1.0 + 0.0 * time])


@pytest.mark.parametrize(
    ("period", "size", "is_reported"),
    [
        # A step counts as a jump if it is at least 0.1 m.
        (0.01, 0.11, True),
        (0.01, 0.09, False),
        # A jump must also be larger than the step that an acceleration of 500 m/s² causes in one sampling period.
        (0.05, 500.0 * 0.05**2 + 0.05, True),
        (0.05, 500.0 * 0.05**2 - 0.05, False),
    ],
)
@pytest.mark.parametrize("axis", [0, 2])
def test_a_jump_is_a_step_that_no_vehicle_can_fly(period, size, is_reported, axis):
    time, position = path(period=period)
    position[200:, axis] += size
    result = list(position_jumps(7.0 + time, position))
    assert bool(result) == is_reported
    if is_reported:
        assert result[0].startswith(f"position jumps once, by up to {size:.2g} m at {time[200]:.4g} s:")


def test_the_largest_of_several_jumps_is_reported():
    time, position = path()
    for row, size in ((100, 0.2), (200, 0.5), (300, -0.3)):
        position[row:, 1] += size
    (sentence,) = position_jumps(time, position)
    assert sentence.startswith("position jumps 3 times, by up to 0.5 m at 2 s:")


def test_a_jump_exceeds_the_noise_by_a_factor_of_eight():
    """White noise is measured by the median difference between successive steps."""
    random = np.random.default_rng(1)
    time, position = path(count=4000)
    noisy = position + 0.05 * random.normal(size=position.shape)
    steps = np.diff(noisy, axis=0)
    differences = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    median = np.median(np.minimum(differences[:-1], differences[1:]))
    assert not list(position_jumps(time, noisy))
    for factor, is_reported in ((6.0, False), (11.0, True)):
        jumping = noisy.copy()
        jumping[2000:, 0] += factor * median
        assert bool(list(position_jumps(time, jumping))) == is_reported


@pytest.mark.parametrize(("ratio", "is_reported"), [(7.9, False), (8.1, True)])
def test_steps_up_to_eight_times_the_usual_ones_count_as_noise(ratio, is_reported):
    """The steps of a position that alternates by 2 cm differ from their neighbours by 4 cm."""
    time, position = path()
    position[:, 0] = 0.02 * (np.arange(len(time)) % 2)
    # The step before sample 201 differs from its neighbours by the usual 4 cm and by the added jump.
    position[201:, 0] += (ratio - 1.0) * 0.04
    result = list(position_jumps(time, position))
    assert bool(result) == is_reported
    if is_reported:
        assert result[0].startswith("position jumps once, by up to 0.32 m at 2.01 s:")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_positions_show_no_jump(count):
    """A jump is a step that differs from the steps before and after it, which requires four positions."""
    time, position = path(count=count)
    position[2:, 0] += 9.0
    assert not list(position_jumps(time, position))


def test_signals_that_are_zero_throughout_are_reported():
    time, position = path()
    zeros = np.zeros_like(position)
    names = ("position", "velocity", "attitude", "body_rates", "specific_force")
    for name in names:
        signals = dict.fromkeys(names, position) | {name: zeros}
        assert next(implausible_signals(signals, time)).startswith(f"{name} is zero throughout")
    both = {"velocity": zeros, "attitude": zeros, "thrust_fraction": zeros}
    assert list(implausible_signals(both, time)) == [
        "velocity and attitude are zero throughout: they may not have been measured"
    ]


@pytest.mark.parametrize(("height", "is_reported"), [(0.24, True), (0.26, False), (-0.24, True), (-0.26, False)])
def test_a_vehicle_below_a_quarter_of_a_metre_may_not_have_flown(height, is_reported):
    time, position = path()
    position[:, 2] = np.linspace(0.0, height, len(time))
    assert bool(list(implausible_signals({"position": position}, time))) == is_reported


@pytest.mark.parametrize(
    ("extent", "distance", "is_reported"), [(1.0, 1.9, False), (1.0, 2.1, True), (3.0, 2.9, False), (3.0, 3.1, True)]
)
def test_a_reference_is_reported_if_its_distance_exceeds_two_metres_and_the_extent_of_the_flight(
    extent, distance, is_reported
):
    time, position = path()
    position[:, 0] = np.linspace(0.0, extent, len(time))
    reference = position.copy()
    reference[150:, 1] += distance
    result = list(implausible_signals({"position": position, "reference_position": reference}, time))
    assert bool(result) == is_reported
    if is_reported:
        limit = max(2.0, extent)
        assert result[0].startswith(
            f"reference_position is up to {distance:.3g} m away from a vehicle that moves by {limit:.3g} m,"
            " first at 1.5 s:"
        )


@pytest.mark.parametrize(("fraction", "is_reported"), [(0.045, False), (0.055, True)])
def test_time_steps_that_vary_by_a_twentieth_of_their_median_are_uneven(fraction, is_reported):
    time = np.cumsum(1.0 + fraction * np.where(np.arange(1000) % 2, 1.0, -1.0))
    median = np.median(np.diff(time))
    assert bool(list(timing_remarks(time))) == (np.std(np.diff(time)) > 0.05 * median) == is_reported


def test_times_beyond_1e12_seconds_are_left_out():
    for latest, is_kept in ((9.9e11, True), (1.1e12, False), (-9.9e11, False), (-1.1e12, False)):
        assert increasing_samples(np.array([0.0, 1.0, latest]))[0][2] == is_kept


@pytest.mark.parametrize("name", ["imu", ""])
def test_a_remark_on_a_faulty_clock_is_given_once_and_names_the_table(name):
    """Commands use the times at which rows were written, and measurements the times at which they were sampled.

    Both clocks of the table have a fault.
    """
    written, sampled = np.array([0.0, 1.0, 1.0, 2.0]), np.array([0.0, 0.9, 1.0, 0.5])
    table = Table(name, written, {}, sampled)
    clocks = _Clocks()
    time, rows = clocks.of(table, "motor_command")
    assert (time.tolist(), rows.tolist()) == ([0.0, 1.0, 2.0], [0, 1, 3])
    beginning = f"{name}: 1 sample left out" if name else "1 sample left out"
    assert clocks.remarks == [f"{beginning}: they repeat the time of the preceding sample"]
    time, rows = clocks.of(table, "body_rates")
    assert (time.tolist(), rows.tolist()) == ([0.0, 0.9, 1.0], [0, 1, 2])
    first, second = clocks.remarks
    assert second.startswith(f"{beginning}: the clock goes back once, by up to 0.5 s")
    # Reading the same clock again, or another clock with the same fault, adds no remark.
    assert clocks.of(table, "thrust_fraction")[0] is clocks.of(table, "motor_command")[0]
    clocks.of(Table(name, written.copy(), {}), "body_rates")
    assert clocks.remarks == [first, second]
