import math

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.design.certificate import _Cell, certify_hover
from drake_quad.design.uncertain_hover import Range, UncertainHover, parameters_in_hover
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.linear.fractional_model import spectral_radii
from drake_quad.linear.hover_fleet import HoverFleet
from drake_quad.scenario.hovering import at_rest, symmetric_hover
from drake_quad.scenario.paths import map_leaves

# Uncertain fields, with the centres of their ranges.
CENTRES = {"vehicle.mass": 0.68, "vehicle.rotor_time_constant": 0.05}
# Half-widths of the ranges of these fields, relative to their centres.
SPREADS = np.array([0.05, 0.3])
DELAY = {"laboratory.command_link.delay_ticks": 8.0}
UNCERTAIN_LAG = "vehicle.rotor_time_constant={uniform: {min: 0.035, max: 0.065}}"


def delayed_hover(*overrides):
    """Return a hover scenario with a command delay that makes the loop unstable if the rotors are slow."""
    return load_scenario("hover", [*overrides, *(f"{path}={value}" for path, value in DELAY.items())])


@pytest.fixture(scope="module")
def certificate():
    mass = f"vehicle.mass={{uniform: {{min: {0.95 * 0.68}, max: {1.05 * 0.68}}}}}"
    counts = []
    result = certify_hover(delayed_hover(mass, UNCERTAIN_LAG), progress=lambda count, step: counts.append(count))
    assert sum(counts) == result.num_loops
    return result


def poles_at(numbers):
    scenario = map_leaves(delayed_hover(), lambda path, value: numbers.get(path, value))
    return np.abs(closed_loop(symmetric_hover(at_rest(scenario))).system.poles())


@pytest.mark.long
def test_the_bounds_enclose_the_critical_scale_within_ten_per_cent(certificate):
    assert 0.9 * certificate.unstable.scale < certificate.stable_scale < certificate.unstable.scale < math.inf
    assert certificate.gap < 0.1
    assert certificate.parameters == tuple(CENTRES)
    assert certificate.without_equilibrium.scale == math.inf
    # The four axes X, Y, Z and yaw are independent parts of the loop. Each part has a cell, and each division adds two.
    assert certificate.num_cells in range(4, 40, 2)


@pytest.mark.long
def test_the_exact_loop_at_the_found_parameters_is_barely_unstable(certificate):
    assert 1.0 < poles_at(certificate.unstable.values).max() < 1.01
    for (path, centre), spread in zip(CENTRES.items(), SPREADS, strict=True):
        distance = abs(certificate.unstable.values[path] / centre - 1.0)
        assert distance <= spread * certificate.unstable.scale + 1e-9


@pytest.mark.long
def test_an_unstable_loop_diverges_with_the_stated_growth_time(certificate):
    loop, time = certificate.growth
    period = 0.02
    assert poles_at(loop.values).max() == pytest.approx(math.exp(period / time), rel=1e-6)
    assert certificate.unstable.scale <= loop.scale <= 2.0 * certificate.unstable.scale
    assert time < 10.0


@pytest.mark.slow
def test_the_certified_box_is_each_range_multiplied_by_the_stable_scale(certificate):
    for (path, centre), spread in zip(CENTRES.items(), SPREADS, strict=True):
        half = centre * spread * certificate.stable_scale
        assert certificate.certified_box[path] == pytest.approx((centre - half, centre + half))


@pytest.mark.slow
def test_impossible_moments_of_inertia_are_corrected_independently_for_each_loop():
    moments = [(0, 0.005, 0.0055), (1, 0.005, 0.0055), (2, 0.0105, 0.0125)]
    overrides = [f"vehicle.inertia.{axis}={{uniform: {{min: {low}, max: {high}}}}}" for axis, low, high in moments]
    hover = UncertainHover(load_scenario("hover", overrides), UserSystems(), lambda count, step: None)
    # The third moment of inertia of a rigid body is at most the sum of the other two. Here, the third moment exceeds
    # this sum. The other two are at their upper bounds, so only the third one can be corrected.
    z = np.array([[0.9], [1.4]]) * np.ones(3)
    together = hover.radii(z, np.zeros(2, dtype=int), "test")
    alone = [hover.radii(row[np.newaxis], np.zeros(1, dtype=int), "test")[0] for row in z]
    assert together == pytest.approx(alone, rel=1e-9)
    corrected = hover.all_values(z, np.zeros(2, dtype=int))
    upper_bounds = [0.00525 + 0.00025 * scale for scale in (0.9, 1.4)]
    assert corrected == pytest.approx(np.array([[bound, bound, 2.0 * bound] for bound in upper_bounds]))


@pytest.mark.long
def test_parameters_that_do_not_affect_an_unstable_part_of_the_loop_are_at_their_centres():
    ranges = [f"vehicle.inertia.{axis}={{uniform: {{min: 0.0049, max: 0.0091}}}}" for axis in (0, 1)]
    scenario = delayed_hover("vehicle.inertia.2=0.006", "nominal.inertia.2=0.012", *ranges)
    hover = UncertainHover(scenario, UserSystems(), lambda count, step: None)
    roll, pitch = hover.parts()
    assert (roll.ranges.tolist(), pitch.ranges.tolist()) == ([0], [1])
    hover.loops_in([(roll, -np.ones(1), np.ones(1))], [np.array([[-1.0], [1.0]])])
    # The roll motion is unstable at the lower end of its range.
    assert hover.unstable.scale == pytest.approx(1.0)
    assert hover.unstable.values == pytest.approx({"vehicle.inertia.0": 0.0049, "vehicle.inertia.1": 0.007})


@pytest.mark.long
def test_all_loops_on_a_grid_within_the_certified_scale_are_stable(certificate):
    resting = symmetric_hover(at_rest(delayed_hover()))
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 25)]), axis=-1).reshape(-1, 2)
    fractions = grid * SPREADS * certificate.stable_scale
    loops = HoverFleet(resting, [*CENTRES])(np.array([*CENTRES.values()]) * (1.0 + fractions))
    assert spectral_radii(loops).max() < 1.0


@pytest.mark.long
def test_the_scale_of_a_single_parameter_agrees_with_a_bisection():
    result = certify_hover(delayed_hover(UNCERTAIN_LAG))
    low, high = 0.05, 0.05 + 0.015 * 8.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        stable = poles_at({"vehicle.rotor_time_constant": middle}).max() < 1.0
        low, high = (middle, high) if stable else (low, middle)
    critical = (low - 0.05) / 0.015
    assert 0.9 * critical < result.stable_scale <= 1.001 * critical
    assert result.unstable.scale == pytest.approx(critical, rel=0.02)


@pytest.mark.long
def test_loops_without_an_equilibrium_do_not_count_as_unstable():
    # The commanded thrust is 0.3 to 1.8 times the nominal weight. From scale 0.7 / 0.3 = 2.33 on, the range of the mass
    # contains vehicles that weigh less than the smallest thrust. Below this scale, all loops are stable.
    overrides = [f"{path}={{uniform: {{min: {0.7 * value}, max: {1.3 * value}}}}}" for path, value in CENTRES.items()]
    result = certify_hover(load_scenario("hover", overrides))
    assert result.without_equilibrium.scale == pytest.approx(0.7 / 0.3, rel=0.01)
    assert result.without_equilibrium.values["vehicle.mass"] < 0.3 * 0.68
    assert result.unstable.scale > result.without_equilibrium.scale
    assert result.gap < 0.1


@pytest.mark.long
def test_a_certificate_depends_only_on_the_seed():
    first, second = (certify_hover(delayed_hover(UNCERTAIN_LAG)) for _ in range(2))
    assert first == second


@pytest.mark.long
def test_no_scale_is_certified_if_the_loop_is_unstable_at_the_centre_of_the_ranges():
    result = certify_hover(load_scenario("hover", [UNCERTAIN_LAG, "laboratory.command_link.delay_ticks=20"]))
    assert result.stable_scale == result.unstable.scale == result.gap == result.num_cells == 0.0
    assert poles_at(result.unstable.values | {"laboratory.command_link.delay_ticks": 20.0}).max() > 1.0


def test_parameters_that_do_not_affect_hover_are_left_out_of_the_certificate():
    ranges, choices, left_out = parameters_in_hover(load_scenario("robustness"))
    assert [each.path for each in ranges if "inertia" in each.path] == [f"vehicle.inertia.{i}" for i in range(3)]
    assert [each.path for each in choices] == [
        "laboratory.motion_capture.latency_frames",
        "laboratory.command_link.delay_ticks",
    ]
    assert {"laboratory.wind.2.speed", "laboratory.command_link.loss_rate"} <= set(left_out)


def test_a_range_is_scaled_about_its_centre_and_stays_positive():
    z = np.array([-100.0, -1.0, 0.0, 1.0, 2.0])
    assert Range("", "", 0.6, 0.8, False).at(z).tolist() == pytest.approx([0.07, 0.6, 0.7, 0.8, 0.9])
    assert Range("", "", -0.1, 0.3, False).at(z).tolist() == pytest.approx([-19.9, -0.1, 0.1, 0.3, 0.5])
    assert Range("", "", 0.1, 0.4, True).at(z[1:]).tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8])


@pytest.mark.parametrize("limits", [(0.6, 0.8, False), (-0.1, 0.3, False), (0.1, 0.4, True)])
def test_scaled_parameters_are_recovered_from_their_values(limits):
    z = np.array([-1.5, -1.0, 0.0, 0.3, 2.0])
    each = Range("", "", *limits)
    assert each.scaled(each.at(z)) == pytest.approx(z)


def test_a_scenario_in_which_no_distribution_with_a_range_affects_hover_is_refused():
    with pytest.raises(InputError, match="no distribution with a range in hover acts on hover"):
        certify_hover(load_scenario("hover", ["laboratory.command_link.delay_ticks={choice: [1, 2]}"]))


@pytest.mark.long
def test_a_network_that_learns_cannot_be_certified(diagrams):
    learning = load_scenario("hover", [UNCERTAIN_LAG], layers=[f"{diagrams}/controllers/paper.yaml:pd_t2fnn"])
    with pytest.raises(InputError, match="has poles at 1 in hover"):
        certify_hover(learning)


def test_the_range_of_a_normal_distribution_without_a_limit_ends_three_deviations_from_its_mean():
    mass = {"normal": {"mean": 0.7, "standard_deviation": 0.01, "min": 0.66}}
    (one,), _, _ = parameters_in_hover(load_scenario("hover", {"vehicle": {"mass": mass}}))
    assert (one.low, one.high) == pytest.approx((0.66, 0.73))


def test_the_smallest_scale_outside_a_box_is_that_of_the_nearest_combination():
    cell = _Cell("x", np.array([-1.0, 0.5]), np.array([2.0, 3.0]))
    # Combinations outside the box have a first parameter below -0.5 or above 1, or a second one below 0.6 or above 2.
    assert cell.min_scale_outside(np.array([-0.5, 0.6]), np.array([1.0, 2.0])) == 0.5
    assert cell.min_scale_outside(np.array([-0.7, 0.5]), np.array([0.8, 2.5])) == 0.5
    around_zero = _Cell("x", np.array([-1.0, -1.0]), np.array([2.0, 3.0]))
    assert around_zero.min_scale_outside(np.array([-0.5, -0.6]), np.array([1.9, 2.9])) == 0.5
