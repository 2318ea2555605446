"""What a model explains of a flight that goes on, beside what would be if nothing acted any more."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad.identification.fitting.forecast import forecast, named
from drake_quad.identification.fitting.predictor import FORCE

PERIOD, SETTLE, LENGTH, WINDOWS = 0.1, 3, 6, 4
OUTPUTS = (("position", 1), ("attitude", 2), ("body_rates", 0), (FORCE, 2))


class Gains(SimpleNamespace):
    def _replace(self, **changes):
        return Gains(**{**vars(self), **changes})


@pytest.fixture
def predictor():
    """Windows of constant acceleration, of which a model misses a known share of what happens after they settle."""
    random = np.random.default_rng(7)
    state = random.normal(size=(12, WINDOWS))
    time = PERIOD * np.arange(LENGTH)[:, None]
    curved = random.normal(size=(4, WINDOWS)) * time[:, None] ** 2
    begun = np.stack(
        [state[1] + time * state[7], state[5] + time * state[11], state[9] + 0.0 * time, 9.8 + 0.0 * time * state[0]], 1
    )
    measured = np.concatenate([random.normal(size=(SETTLE, 4, WINDOWS)), begun + curved])
    misses = np.zeros((SETTLE + LENGTH, 4, 1, WINDOWS))
    for i, share in enumerate((0.5, 0.1, 0.0, 1.0)):
        misses[SETTLE:, i, 0] = share * curved[:, i]
    kept = {}

    def errors(parameters, gains, noise, keep):
        kept.update(parameters=parameters, gain=gains.gain, keep=keep)
        return misses, state[:, None]

    counted = np.arange(SETTLE + LENGTH) >= SETTLE
    gains = Gains(gain=np.ones((SETTLE + LENGTH, 12, 4, WINDOWS)))
    made = SimpleNamespace(
        gains=lambda parameters, noise: gains,
        errors=errors,
        measured=measured,
        counted=counted,
        period=PERIOD,
        outputs=OUTPUTS,
    )
    return made, kept, curved, state


def test_the_share_that_is_explained_is_of_what_goes_beyond_coasting(predictor):
    """A position goes on at its velocity, an angle at its body rate, a rate stays; a force has its mean."""
    made, _, curved, state = predictor
    found = forecast(made, np.array([1.0, 2.0]), None)
    np.testing.assert_allclose(found.time, PERIOD * np.arange(LENGTH))
    np.testing.assert_array_equal(found.measured, made.measured[SETTLE:])
    expected = [1.0 - 0.5**2, 1.0 - 0.1**2, 1.0]
    np.testing.assert_allclose(found.explained[:3], expected)
    force = made.measured[SETTLE:, 3]
    missed = np.sum(curved[:, 3] ** 2)
    assert found.explained[3] == pytest.approx(1.0 - missed / np.sum((force - force.mean()) ** 2))
    np.testing.assert_allclose(found.predicted[:, 0], state[1] + found.time[:, None] * state[7] + 0.5 * curved[:, 0])
    assert found.names == ("position y", "yaw", "body rate p", "specific force along z")


def test_after_it_has_settled_a_predictor_measures_nothing(predictor):
    made, kept, *_ = predictor
    forecast(made, np.array([1.0, 2.0]), None)
    np.testing.assert_array_equal(kept["gain"][:SETTLE], 1.0)
    np.testing.assert_array_equal(kept["gain"][SETTLE:], 0.0)
    assert kept["keep"] == SETTLE
    np.testing.assert_array_equal(kept["parameters"], [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("signal", "column", "words"),
    [
        ("attitude", 0, "roll"),
        ("attitude", 2, "yaw"),
        ("body_rates", 1, "body rate q"),
        ("position", 2, "position z"),
        (FORCE, 1, "specific force along y"),
    ],
)
def test_outputs_are_named(signal, column, words):
    assert named(signal, column) == words
