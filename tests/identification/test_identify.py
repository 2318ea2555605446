"""What identifies a vehicle is chosen by what logs hold, and what they cannot be is told in a sentence."""

import numpy as np
import pytest

from drake_quad import InputError, identify, load_scenario
from drake_quad.identification import identify as module
from drake_quad.identification.logs.record import FlightRecord


def test_without_a_log_nothing_is_identified():
    with pytest.raises(InputError, match="there is no log to identify a vehicle from"):
        identify([], load_scenario("hover"))


def test_equations_without_a_solution_are_told_in_a_sentence(monkeypatch):
    """As of a gyroscope that shows 10⁸ rad/s now and then."""

    def fail(*_, **__):
        np.linalg.cholesky(np.zeros((2, 2)))

    monkeypatch.setattr(module, "identify_from_poses", fail)
    record = FlightRecord("log", np.array([0.0, 0.1]))
    with pytest.raises(
        InputError, match=r"^the logs cannot be fitted \(Matrix is not positive definite\): they hold numb"
    ):
        identify([record], load_scenario("hover"))
