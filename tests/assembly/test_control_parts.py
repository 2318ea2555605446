"""What the numbers of a scenario become in the systems of its control, one after another."""

import math

import pytest

from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.assembly.control import control_parts
from drake_quad.assembly.planning import plan_route

WEIGHT = 0.7 * 9.79


def options(scenario):
    plan = plan_route(scenario)
    return {path: part.options for path, part in control_parts(scenario, plan, 1).items()}, plan


def test_the_cascade_has_the_gains_of_the_scenario_and_believes_its_nominal_numbers(asymmetric):
    found, _ = options(asymmetric("pid"))
    assert list(found) == ["position.pd", "position.integral", "thrust_vectoring", "attitude"]
    pd, integral, vectoring, attitude = found.values()
    assert (pd["k_p"], pd["k_d"]) == ((1.3, 1.0, 5.0), (1.5, 1.3, 3.2))
    assert (pd["derivative"], pd["feed_forward"]) == ("tracking_error", True)
    assert (integral["k_i"], integral["limit"], integral["period"]) == ((0.3, 0.2, 1.5), 0.6, 0.02)
    assert (vectoring["mass"], vectoring["gravity"]) == (0.7, 9.79)
    assert tuple(vectoring["limits"]) == pytest.approx((math.tan(0.2), 0.975 * WEIGHT, 1.11 * WEIGHT))
    assert (attitude["k_p"], attitude["k_d"]) == ((17.0, 14.0, 5.0), (7.5, 6.8, 3.1))
    assert attitude["inertia"] == (0.0065, 0.0085, 0.0126)


def test_a_network_has_the_sets_and_the_law_of_the_scenario(asymmetric):
    found, plan = options(asymmetric("pd_t2fnn"))
    rules, learning = found["position.network.rules"], found["position.network.learning"]
    error = FuzzySets(2.4, (-1.0, -0.1, 0.8), (1.1, 0.9, 1.0))
    rate = FuzzySets(1.4, (-0.9, -0.4, 0.3, 1.1), (0.8, 0.7, 0.9, 1.2))
    assert rules["antecedents"] == Antecedents(1.3, 0.7, 0.4, error, rate)
    assert rules["axes"] == learning["axes"] == ("x", "y", "z")
    assert (learning["num_rules"], learning["slope"], learning["initial_weight"]) == (12, 1.4, 0.05)
    assert learning["law"] == CovarianceLaw(0.8, 5.0, 0.997)
    assert learning["limits"] == Limits(0.9, 0.01, 0.02)
    # The route begins with the first leg, at which nothing has been learned yet.
    assert learning["reset_times"] == plan.leg_times[1:]
    assert len(plan.leg_times) > 3
    never, _ = options(asymmetric("pd_t2fnn", "control.position.learning.reset=never"))
    assert never["position.network.learning"]["reset_times"] == []


def test_a_network_of_type_1_has_triangles_and_the_other_laws_their_numbers(asymmetric):
    found, _ = options(asymmetric("pd_t1fnn"))
    sets = found["position.network.rules"]["antecedents"]
    assert (sets.a1, sets.a2, sets.q) == (1.0, 1.0, 0.0)
    learning = found["position.network.learning"]
    assert (learning["law"], learning["limits"]) == (SignLaw(0.05, 0.2), Limits(1.5, 0.03, 0.0))
    gradient = "control.position.learning={kind: gradient, rate: 0.4, slope: 1.7}"
    learning = options(asymmetric("pd_t1fnn", gradient))[0]["position.network.learning"]
    assert (learning["law"], learning["slope"], learning["limits"]) == (GradientLaw(0.4), 1.7, Limits())
