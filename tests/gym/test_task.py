"""The scenario that an environment makes of a given scenario."""

import pytest

from drake_quad import load_scenario
from drake_quad.design.cascade import design_cascade
from drake_quad.gym.task import task_of
from drake_quad.scenario.files.loading import with_fields


@pytest.mark.slow
def test_a_missing_attitude_control_is_designed_as_the_attitude_loop_of_any_cascade():
    """RAPTOR commands rotor speeds, so its scenario has no attitude control. The plant alone determines the gains."""
    scenario = load_scenario("figure_eight", layers=["controllers/raptor:raptor_plus"])
    assert getattr(scenario.control, "attitude", None) is None
    gains = {"k_p": [4.0, 5.0, 6.0], "k_d": [2.0, 3.0, 4.0]}
    cascade = {"position": {"kind": "pd", "feed_forward": "none", **gains}, "attitude": gains}
    expected = design_cascade(with_fields(scenario, {"control": cascade})).gains()["attitude"]
    for action in ("attitude", "acceleration", {"kind": "rates"}):
        found = task_of(scenario, action=action).control.attitude
        assert {"k_p": [*found.k_p], "k_d": [*found.k_d]} == expected
    for action in ("rotor_speeds", {"kind": "rates", "k_rate": [20.0, 20.0, 5.0]}):
        assert task_of(scenario, action=action).control.attitude is None
