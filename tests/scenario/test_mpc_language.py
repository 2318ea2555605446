"""Tests of model predictive control in the scenario language: messages about mistakes, walls, and the horizon."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.control import control_recipes
from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch

DIAGRAMS = Path(__file__).parents[2] / "diagrams"


def load(*overrides):
    return load_scenario(
        DIAGRAMS / "laboratory.yaml:nominal", overrides, layers=[f"{DIAGRAMS}/controllers/mpc.yaml:mpc"]
    )


def structure_of(scenario):
    plan = plan_route(scenario)
    return control_recipes(Batch.draw(scenario, [0]), plan)["programme"].structure, plan


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["control.horizon=0"], "control.horizon is 0, but must be greater than 0"),
        (["control.horizon=5"], "control.horizon is 5, but must be less than or equal to 4"),
        (["control.tilt_weight=0"], "control.tilt_weight is 0, but must be"),
        (["control.corridor={kind: tunnel}"], "control.corridor.kind is 'tunnel', but must be one of 'tube', 'room'"),
        (["control.corridor={kind: tube, half_width: [0.1, 0, null]}"], "half_width.1 is 0, but must be"),
        (
            ["control.corridor={kind: room, lower: [0, null, 1], upper: [1, 2, 0.5]}"],
            "control.corridor.upper.2 is 0.5, but must be larger than lower, 1",
        ),
        (
            ["control.max_tilt={uniform: {min: 0.2, max: 0.3}}"],
            "must be a number with control.kind mpc, not a distribution",
        ),
        (["control.yaw.k_p={uniform: {min: 1, max: 3}}"], "must be a number with control.kind mpc, not a distribution"),
        (["control.lateral.lag=null"], "control.lateral.lag is missing"),
        (
            ["laboratory.motion_capture.period=0.02", "laboratory.command_link.period=0.01"],
            "must not be longer than the period of the command link, 0.01 s, with control.kind mpc",
        ),
    ],
)
def test_errors_name_the_invalid_field(overrides, words):
    with pytest.raises(InputError, match=re.escape(words)):
        load(*overrides)


@pytest.mark.slow
def test_walls_of_a_tube_move_with_the_reference_and_walls_of_a_room_are_fixed():
    tube, _ = structure_of(load("control.corridor={kind: tube, half_width: [0.1, null, 0.3], weight: 7}"))
    assert tube["corridor"] == ((-0.1, -math.inf, -0.3), (0.1, math.inf, 0.3), True, 7.0)
    room, _ = structure_of(load("control.corridor={kind: room, lower: [null, -2, 0.5], upper: [3, null, null]}"))
    assert room["corridor"] == ((-math.inf, -2.0, 0.5), (3.0, math.inf, math.inf), False, 10.0)


def test_the_horizon_is_rounded_to_ticks_and_previews_the_plan():
    structure, plan = structure_of(load("control.horizon=0.25"))
    assert structure["num_ticks"] == 12
    preview = structure["preview"]
    for tick in (0, 1, 400):
        instant = preview[tick]
        for order, part in (
            (0, instant.reference[:3]),
            (2, instant.reference[6:9]),
            (3, instant.jerk),
            (4, instant.snap[:3]),
        ):
            np.testing.assert_allclose(part, evaluate(plan.path, [0.02 * tick], order)[:, 0], atol=1e-9)
        previous_snap = preview[tick - 1].snap if tick else np.zeros(4)
        np.testing.assert_allclose(instant.before, previous_snap, atol=1e-9)


def test_the_reference_in_the_horizon_rests_after_the_end_of_the_plan():
    structure, plan = structure_of(load("control.horizon=0.25"))
    last = structure["preview"][-1]
    np.testing.assert_allclose(last.reference[:3], plan.waypoints[-1], atol=1e-9)
    for part in (last.reference[3:9], last.jerk, last.snap, last.before):
        np.testing.assert_array_equal(part, np.zeros(len(part)))
