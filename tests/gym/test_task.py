"""Tests of the conversion of a scenario to the task of an environment."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.design.cascade import design_cascade
from drake_quad.gym.task import environment_scenario
from drake_quad.scenario.files.loading import with_fields


@pytest.mark.long
def test_a_missing_attitude_controller_is_designed_like_the_attitude_loop_of_a_cascade():
    """The scenario of RAPTOR has no attitude controller, because it commands rotor speeds."""
    scenario = load_scenario("figure_eight", layers=["controllers/raptor:raptor_plus"])
    assert getattr(scenario.control, "attitude", None) is None
    gains = {"k_p": [4.0, 5.0, 6.0], "k_d": [2.0, 3.0, 4.0]}
    cascade = {"position": {"kind": "pd", "feed_forward": "none", **gains}, "attitude": gains}
    expected = design_cascade(with_fields(scenario, {"control": cascade})).gains()["attitude"]
    for action in ("attitude", "acceleration", {"kind": "rates"}):
        actual = environment_scenario(scenario, action=action).control.attitude
        assert {"k_p": [*actual.k_p], "k_d": [*actual.k_d]} == expected
    for action in ("rotor_speeds", {"kind": "rates", "k_rate": [20.0, 20.0, 5.0]}):
        assert environment_scenario(scenario, action=action).control.attitude is None


def test_action_fields_can_be_arrays_and_invalid_actions_are_reported():
    attitude = load_scenario("figure_eight").control.attitude
    actual = environment_scenario(
        "figure_eight", action={"kind": "rates", "max_rates": np.array([5.0, 4.0, 3.0])}
    ).control
    assert (actual.action.max_rates, actual.attitude) == ((5.0, 4.0, 3.0), attitude)
    assert environment_scenario("figure_eight", action={"kind": "rates", "k_rate": np.ones(3)}).control.attitude is None
    for action, words in (
        ({"kind": "rates", "max_rates": "fast"}, "control.action.max_rates is 'fast', but must be a list"),
        ({"kind": "torques"}, "control.action.kind is 'torques', but must be one of"),
        ({"kind": ["rates"]}, "control.action.kind is .*, but must be one of"),
        ({"max_acceleration": [1.0, 1.0, 1.0]}, "control.action.kind is missing"),
        ({"kind": "acceleration", 3: 4}, "control.action"),
    ):
        with pytest.raises(InputError, match=words):
            environment_scenario("figure_eight", action=action)
