"""Tests of stick curves against published rates and a direct inversion."""

import numpy as np
import pytest

from drake_quad.firmware.betaflight.sticks import StickTable, rate_curve
from drake_quad.firmware.sticks import PulseTable

COMMON = {
    "quickrates_rc_expo": "OFF",
    "roll_rate_limit": "1998",
    "deadband": "0",
    "yaw_deadband": "0",
    "mid_rc": "1500",
}


def settings_of(kind, rate, super_rate, expo, **others):
    values = {"rates_type": kind, "roll_rc_rate": str(rate), "roll_srate": str(super_rate), "roll_expo": str(expo)}
    return COMMON | values | others


# Largest rates that the rate calculators of pilots give for these settings, °/s.
@pytest.mark.parametrize(
    ("kind", "rate", "super_rate", "max_rate"),
    [
        ("ACTUAL", 7, 67, 670.0),
        ("BETAFLIGHT", 100, 70, 200.0 / 0.3),
        ("KISS", 100, 70, 200.0 / 0.3),
        ("RACEFLIGHT", 37, 80, 370.0 * 1.8),
        ("QUICK", 100, 67, 670.0),
    ],
)
@pytest.mark.parametrize("expo", [0, 40])
def test_the_largest_rate_does_not_depend_on_the_expo(kind, rate, super_rate, max_rate, expo):
    curve = rate_curve(settings_of(kind, rate, super_rate, expo), "roll")
    np.testing.assert_allclose(curve(np.array([0.0, 1.0])), [0.0, max_rate], rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "rate", "super_rate", "slope"),
    [
        ("ACTUAL", 7, 67, 70.0),
        ("BETAFLIGHT", 100, 70, 200.0),
        ("KISS", 100, 70, 200.0),
        ("RACEFLIGHT", 37, 80, 370.0),
        ("QUICK", 100, 67, 200.0),
    ],
)
def test_the_rate_setting_is_the_slope_in_the_middle_of_the_stick(kind, rate, super_rate, slope):
    curve = rate_curve(settings_of(kind, rate, super_rate, 0), "roll")
    assert curve(np.array([1e-6]))[0] / 1e-6 == pytest.approx(slope, rel=1e-4)


def test_a_rate_above_two_grows_faster():
    assert rate_curve(settings_of("BETAFLIGHT", 255, 0, 0), "roll")(np.ones(1))[0] == pytest.approx(
        200.0 * (2.55 + 14.54 * 0.55) if 200.0 * (2.55 + 14.54 * 0.55) < 1998.0 else 1998.0
    )
    assert rate_curve(settings_of("BETAFLIGHT", 210, 0, 0), "roll")(np.ones(1))[0] == pytest.approx(710.8)


def test_the_expo_of_quick_rates_applies_to_the_stick_or_to_the_growth():
    x = np.array([0.5])
    growth = 1.0 - 200.0 / 670.0
    curve = 0.6 * 0.5 + 0.4 * 0.125
    by_growth = rate_curve(settings_of("QUICK", 100, 67, 40), "roll")(x)
    by_stick = rate_curve(settings_of("QUICK", 100, 67, 40, quickrates_rc_expo="ON"), "roll")(x)
    assert by_growth == pytest.approx(200.0 * 0.5 / (1.0 - growth * curve))
    assert by_stick == pytest.approx(200.0 * curve / (1.0 - growth * 0.5))


def test_rates_are_limited():
    assert rate_curve(settings_of("ACTUAL", 7, 67, 0, roll_rate_limit="500"), "roll")(np.ones(1))[0] == 500.0
    assert rate_curve(settings_of("ACTUAL", 200, 255, 0), "roll")(np.ones(1))[0] == 1998.0


@pytest.mark.parametrize("kind", ["ACTUAL", "BETAFLIGHT", "KISS", "RACEFLIGHT", "QUICK"])
@pytest.mark.parametrize("deadband", [0, 20])
def test_a_table_inverts_its_curve(kind, deadband):
    settings = settings_of(kind, 50, 60, 30, deadband=str(deadband))
    table, curve = StickTable.of(settings, "roll"), rate_curve(settings, "roll")
    pulses = PulseTable(table.fractions, table.pulses)
    for fraction in (-1.0, -0.6, -0.01, 0.0, 0.3, 0.95, 1.0):
        deflection = max(abs(pulses.pulse(fraction) - 1500) - deadband, 0) / (500 - deadband)
        slope = (curve(np.array([1.0])) - curve(np.array([0.98])))[0] / 0.02 / table.max_rate
        assert np.sign(fraction) * curve(np.array([deflection]))[0] / table.max_rate == pytest.approx(
            fraction, abs=1.1 * slope / (500 - deadband)
        )


def test_pulses_are_interpolated_and_limited():
    table = PulseTable(np.array([0.0, 0.0, 0.5, 1.0]), np.array([1000.0, 1050.0, 1500.0, 2000.0]))
    assert [table.pulse(command) for command in (-1.0, 0.25, 0.5, 0.75, 2.0)] == [1000, 1275, 1500, 1750, 2000]
    reversed_table = PulseTable(np.array([1.0, 0.0, -1.0]), np.array([1000.0, 1500.0, 2000.0]))
    assert [reversed_table.pulse(command) for command in (-1.5, -0.5, 0.0, 1.0)] == [2000, 1750, 1500, 1000]
