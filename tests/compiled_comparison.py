"""Comparison of flights that are simulated by uncompiled and by compiled diagrams."""

import numpy as np

from drake_quad.flight.simulation import simulate_batch

# The tolerance is relative to the amplitude of a signal, or to 1 in its units.
TOLERANCE = 1e-9


def assert_alike(actual, expected, name=""):
    """Assert that two arrays agree within the tolerance; NaN and infinities must be at the same places."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape, name
    size = max(1.0, np.max(np.abs(expected[np.isfinite(expected)]), initial=0.0))
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=TOLERANCE * size, err_msg=name)


def assert_flights_alike(actual, expected):
    """Assert that two flights have the same ticks, signals and metrics, and the same crash at the same tick."""
    np.testing.assert_array_equal(actual.time, expected.time)
    assert actual.signals.keys() == expected.signals.keys()
    for name, values in expected.signals.items():
        assert_alike(actual[name], values, name)
    assert_metrics_alike(actual.metrics, expected.metrics)
    assert actual.obstacle_hit == expected.obstacle_hit


def assert_metrics_alike(actual, expected):
    np.testing.assert_array_equal(actual.crash_time, expected.crash_time)
    for name, values in expected._asdict().items():
        assert_alike(getattr(actual, name), values, name)


def assert_flown_alike(batch, *, plan=None):
    """Simulate a batch compiled and uncompiled, assert that the flights are equal, and return the compiled ones."""
    uncompiled = simulate_batch(batch, plan=plan, compiled=False)
    compiled = simulate_batch(batch, plan=plan, compiled=True)
    assert all(flight.compiled for flight in compiled)
    assert not any(flight.compiled for flight in uncompiled)
    for actual, expected in zip(compiled, uncompiled, strict=True):
        assert_flights_alike(actual, expected)
    return compiled
