"""Tests of plans, and of the reference that a control receives from a plan."""

import numpy as np
import pytest

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate, hermite_path
from drake_quad.reference.routes import Leg
from drake_quad.reference.source import build_reference

EXAMPLE_PLAN = Plan.with_constant_yaw(minimum_snap([[0, 0, 0], [1, 2, 1], [3, 1, 2]], [0.5, 1.5, 3.0]), 0.3)


def test_the_reference_diagram_outputs_the_derivatives_of_the_plan():
    times = [0.5, 3.0]
    turning = hermite_path(np.array(times), np.array([[[0.3], [0.0], [0.4]], [[0.8], [0.2], [-0.1]]]))
    plan = Plan(EXAMPLE_PLAN.path, turning)
    source = build_reference(plan)
    context = source.CreateDefaultContext()
    for time in (0.5, 1.0, 1.5, 2.9):
        context.SetTime(time)
        position, velocity, acceleration, jerk, snap = (evaluate(EXAMPLE_PLAN.path, [time], k)[:, 0] for k in range(5))
        yaw = [evaluate(turning, [time], order)[0, 0] for order in range(3)]
        reference = source.GetOutputPort("reference").Eval(context)
        np.testing.assert_allclose(reference, [*position, *velocity, *acceleration, *yaw[:2]], atol=1e-12)
        np.testing.assert_allclose(source.GetOutputPort("reference_jerk").Eval(context), jerk, atol=1e-11)
        np.testing.assert_allclose(source.GetOutputPort("reference_snap").Eval(context), [*snap, yaw[2]], atol=1e-10)


def test_the_reference_hovers_before_and_after_the_plan():
    source = build_reference(EXAMPLE_PLAN)
    context = source.CreateDefaultContext()
    for time, position in ((0.0, [0, 0, 0]), (9.0, [3, 1, 2])):
        context.SetTime(time)
        reference = source.GetOutputPort("reference").Eval(context)
        np.testing.assert_allclose(reference, [*position, *[0.0] * 6, 0.3, 0.0], atol=1e-11)


def test_all_vehicles_of_a_fleet_get_the_same_reference():
    single_reference, fleet = build_reference(EXAMPLE_PLAN), build_reference(EXAMPLE_PLAN, num_vehicles=4)
    assert [system.get_name() for system in single_reference.GetSystems()] == ["trajectory", "parts"]
    contexts = single_reference.CreateDefaultContext(), fleet.CreateDefaultContext()
    for context in contexts:
        context.SetTime(1.7)
    for name in ("reference", "reference_jerk", "reference_snap"):
        single = single_reference.GetOutputPort(name).Eval(contexts[0])
        np.testing.assert_array_equal(
            fleet.GetOutputPort(name).Eval(contexts[1]).reshape(-1, 4), np.repeat(single[:, np.newaxis], 4, axis=1)
        )


def test_a_hover_plan_stays_at_its_position():
    plan = Plan.hover([1.0, 2.0, 3.0], duration=5.0)
    assert plan.duration == 5.0
    np.testing.assert_array_equal(plan.waypoints, [[1.0, 2.0, 3.0]] * 2)
    np.testing.assert_array_equal(plan.reference().value(2.0)[:, 0], [1.0, 2.0, 3.0, *[0.0] * 15])


def test_a_plan_has_leg_times_and_an_initial_yaw():
    plan = Plan.with_constant_yaw(EXAMPLE_PLAN.path, 0.3, (Leg("away", 0), Leg("back", 1)))
    assert plan.leg_times == [0.5, 1.5]
    assert plan.initial_yaw == 0.3
    assert plan.duration == 2.5
    np.testing.assert_array_equal(plan.yaw.times, [0.5, 3.0])
    assert (EXAMPLE_PLAN.legs, Plan(EXAMPLE_PLAN.path, EXAMPLE_PLAN.yaw).legs) == ((), ())
    hover = Plan.hover([0.0, 0.0, 1.0], duration=2.0, yaw=0.7)
    assert (hover.legs, hover.leg_times, hover.initial_yaw) == ((("hover", 0),), [0.0], 0.7)


def test_derivatives_of_a_plan_agree_with_its_path():
    for order in range(5):
        trajectory = EXAMPLE_PLAN.derivative(order)
        for time in (0.5, 0.9, 2.2):
            expected = evaluate(EXAMPLE_PLAN.path, [time], order)
            np.testing.assert_allclose(trajectory.value(time), expected, atol=1e-10 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.0, 4.0), (4.0, 0.0)])
def test_the_reference_continues_until_path_and_yaw_are_at_rest(speed, yaw_rate):
    """Either path or yaw is in steady motion and brakes for seconds, while the other one is at rest."""
    times, zero = np.array([0.0, 1.0]), np.zeros(3)
    path = hermite_path(times, np.array([[[x, 0.0, 0.0], [speed, 0.0, 0.0], zero, zero] for x in (0.0, speed)]))
    yaw = hermite_path(times, np.array([[[angle], [yaw_rate], [0.0]] for angle in (0.0, yaw_rate)]))
    plan = Plan(path, yaw)
    assert plan.brakes
    assert plan.rest_time > 5.0
    reference = plan.reference()
    for time in np.linspace(0.0, plan.rest_time + 3.0, 40):
        clipped_times = [min(time, part.times[-1]) for part in (plan.extended_path, plan.extended_yaw)]
        position = [evaluate(plan.extended_path, clipped_times[:1], order)[:, 0] for order in range(3)]
        angle = [evaluate(plan.extended_yaw, clipped_times[1:], order)[0, 0] for order in range(2)]
        np.testing.assert_allclose(reference.value(time)[:11, 0], [*np.ravel(position), *angle], atol=1e-9)
