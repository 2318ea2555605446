"""Tests of gain design: poles and costs of designed loops, and margins that simulated loops tolerate."""

import argparse
import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from pydrake.systems.controllers import DiscreteTimeLinearQuadraticRegulator
from ruamel.yaml import YAML

from drake_quad import InputError, load_scenario
from drake_quad.command_line.design import add_design_options, design_options
from drake_quad.design.cascade import (
    CascadeDesign,
    LoopOptions,
    attitude_plant,
    default_options,
    design_cascade,
    position_plant,
    with_gains,
    with_integrals,
)
from drake_quad.design.gains import (
    AxisPdGains,
    LoopDesign,
    OutputRegulator,
    PidGains,
    PolePair,
    Requirements,
    add_integral,
    design_loop,
    pd_loop,
    with_integral,
)
from drake_quad.linear.closed_loop import closed_loop, laboratory_plant
from drake_quad.linear.margins import FastMargins, fast_margins, frequencies, margins
from drake_quad.linear.sampled_system import SampledSystem
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.hovering import at_rest, nominal_hover

ROOT = Path(__file__).parent.parent.parent
# Scenario for which each file in `diagrams/gains` was designed, by the name of the file.
SHIPPED_SCENARIOS = {"figure_eight": "figure_eight", "laboratory": "laboratory:nominal"}


@pytest.fixture(scope="module", params=SHIPPED_SCENARIOS)
def shipped(request):
    return request.param, with_shipped_gains(request.param)


@pytest.fixture(scope="module")
def designed(shipped):
    """Return the designed cascade of a shipped scenario."""
    return design_cascade(shipped[1])


def with_shipped_gains(name, overrides=()):
    return load_scenario(SHIPPED_SCENARIOS[name], overrides, layers=[ROOT / "diagrams" / "gains" / f"{name}.yaml"])


@pytest.fixture(scope="module")
def pitch():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml")
    return attitude_plant(laboratory_plant(scenario), scenario, "pitch")


def test_the_pole_pair_has_the_given_bandwidth_and_damping(pitch):
    for damping, bandwidth in ((0.5, 2.0), (0.8, 4.0), (0.7, 6.0)):
        gains = PolePair(damping).gains(pitch, bandwidth)
        s = bandwidth * complex(-damping, np.sqrt(1.0 - damping**2))
        poles = pitch.with_feedback(np.array([gains])).poles()
        assert np.abs(poles - np.exp(s * pitch.period)).min() < 1e-9


@pytest.mark.slow
def test_the_fastest_gains_just_meet_the_requirements(pitch):
    requirements = Requirements(phase=50.0, gain=6.0, delay=0.04)
    design = design_loop(pitch, PolePair(0.8), requirements, axis="pitch")
    assert design.limits == ("phase margin",)
    assert 50.0 <= design.margins.phase < 50.05
    assert design.margins.gain > 6.0
    assert design.margins.delay > 0.04
    with pytest.raises(InputError, match=r"pitch cannot have a bandwidth of .* phase margin: 4\d\.\d°, less than 50°"):
        design_loop(pitch, PolePair(0.8), requirements, axis="pitch", effort=1.02 * design.bandwidth)
    requested = design_loop(pitch, PolePair(0.8), requirements, axis="pitch", effort=2.0)
    assert (requested.bandwidth, requested.limits) == (2.0, ())


@pytest.mark.parametrize(
    ("requirements", "limit"),
    [
        (Requirements(phase=1.0, gain=14.0), "gain margin"),
        (Requirements(phase=1.0, gain=1.0, delay=0.2), "delay margin"),
        (Requirements(phase=1.0, gain=0.5), "a slower pole"),
    ],
)
def test_the_limiting_requirement_is_named(pitch, requirements, limit):
    assert design_loop(pitch, PolePair(0.8), requirements, axis="pitch").limits == (limit,)


def test_default_requirements_are_textbook_margins():
    assert Requirements() == (45.0, 6.0, 0.0)


def test_violated_requirements_are_reported_in_their_units():
    achieved = FastMargins(gain=5.5, phase=80.0, delay=1.0)
    violated = Requirements(delay=2.0).shortfalls(achieved)
    assert {name: (text.split()[0], text.split()[-1]) for name, text in violated.items()} == {
        "gain margin": ("5.5", "dB"),
        "delay margin": ("1000.0", "ms"),
    }


def test_requirements_that_no_gains_meet_are_reported(pitch):
    with pytest.raises(InputError, match=r"for pitch; closest result: phase margin: \d\d\.\d°, less than 80°"):
        design_loop(pitch, PolePair(0.8), Requirements(phase=80.0), axis="pitch")


def test_no_pd_exists_without_a_measured_rate(pitch):
    without_rate = replace(pitch, C=pitch.C * [[1.0], [0.0]])
    with pytest.raises(
        InputError, match="no gains of this family meet the requirements for pitch; closest result: no gains"
    ):
        design_loop(without_rate, PolePair(0.8), Requirements(), axis="pitch")


def test_a_bandwidth_that_is_too_high_for_the_delay_would_need_a_negative_gain(pitch):
    with pytest.raises(InputError, match="pitch cannot have a bandwidth of 10 rad/s: a negative gain: k_P -5.0"):
        design_loop(pitch, PolePair(0.8), Requirements(), axis="pitch", effort=10.0)


@pytest.mark.slow
def test_a_regulator_is_found_for_any_delay():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", ["laboratory.command_link.delay_ticks=50"])
    plant = attitude_plant(laboratory_plant(scenario), scenario, "pitch")
    family = OutputRegulator(0.2)
    assert np.isfinite(family.cost(plant, family.gains(plant, 0.1), 0.1))
    with pytest.raises(InputError, match=r"pitch cannot have an effort of 30: phase margin"):
        design_loop(plant, family, Requirements(phase=60.0), axis="pitch", effort=30.0)


def test_a_plant_that_cannot_be_stabilised_is_reported(pitch):
    n = len(pitch.A)
    A = np.block([[pitch.A, np.zeros((n, 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    B, C = np.vstack([pitch.B, [[0.0]]]), np.hstack([pitch.C, [[1.0], [0.0]]])
    unstabilisable = replace(pitch, A=A, B=B, C=C, states=(*pitch.states, "uncontrolled"))
    with pytest.raises(
        InputError, match="no gains of this family meet the requirements for pitch; closest result: no stability"
    ):
        design_loop(unstabilisable, PolePair(0.8), Requirements(), axis="pitch")


def double_integrator(h=0.02):
    """Return a double integrator with a zero-order hold, for which a PD is full state feedback."""
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[0.5 * h * h], [h]])
    return SampledSystem(A, B, np.eye(2), np.zeros((2, 1)), h, ("x", "v"), ("u",), ("x", "v"))


def test_a_pd_with_full_state_feedback_is_the_regulator():
    plant, family = double_integrator(), OutputRegulator(0.3)
    gains = family.gains(plant, 20.0)
    assert family.cost(plant, gains, 20.0) == pytest.approx(family.min_cost(plant, 20.0), rel=1e-6)
    # Drake's DiscreteTimeLinearQuadraticRegulator computes the expected gain for the same weights.
    K, _ = DiscreteTimeLinearQuadraticRegulator(plant.A, plant.B, np.diag([1.0, 0.09]), np.eye(1) / 400.0)
    np.testing.assert_allclose(gains, K[0], rtol=1e-2)


@pytest.mark.slow
def test_the_fastest_regulator_within_its_margins_reports_its_cost_relative_to_full_state_feedback(pitch):
    family, required = OutputRegulator(0.2), Requirements()
    design = design_loop(pitch, family, required, axis="pitch")
    assert design.limits
    assert design.bandwidth is None
    cost = [family.cost(pitch, design.gains, effort) / family.min_cost(pitch, effort) for effort in (0.01, 1e3)]
    assert design.cost_ratio >= 1.0
    # For this design, and for the smallest and the largest effort, the cost is higher than that of full state feedback.
    np.testing.assert_array_less(1.0, cost)
    efforts = family.efforts(pitch)
    assert (efforts[0], efforts[-1], len(efforts)) == (pytest.approx(0.01), pytest.approx(1e3), 20)
    requested = design_loop(pitch, family, required, axis="pitch", effort=2.0)
    ratio = family.cost(pitch, requested.gains, 2.0) / family.min_cost(pitch, 2.0)
    assert requested.cost_ratio == pytest.approx(ratio)
    assert requested.gains.k_p < design.gains.k_p


def test_the_cost_equals_the_sum_over_a_simulated_impulse_response(pitch):
    family, gains, effort = OutputRegulator(0.2), AxisPdGains(6.0, 4.0), 30.0
    x, total = pitch.B.copy(), 0.0
    for _ in range(5000):
        value, rate = (pitch.C @ x)[:, 0]
        u = -gains.k_p * value - gains.k_d * rate
        total += value**2 + (0.2 * rate) ** 2 + (u / effort) ** 2
        x = pitch.A @ x + pitch.B * u
    assert family.cost(pitch, gains, effort) == pytest.approx(total, rel=1e-9)
    best = family.gains(pitch, effort)
    min_cost = family.cost(pitch, best, effort)
    for factor in ((1.001, 1.0), (0.999, 1.0), (1.0, 1.001), (1.0, 0.999)):
        assert family.cost(pitch, AxisPdGains(best.k_p * factor[0], best.k_d * factor[1]), effort) > min_cost
    assert min_cost > family.min_cost(pitch, effort)


ASYMMETRIC_VEHICLE = [
    "nominal.mass=0.75",
    "nominal.inertia=[0.0065, 0.0085, 0.0126]",
    "control.position={k_p: [0.22, 0.3, 6.0], k_d: [0.66, 0.8, 3.7]}",
    "control.attitude={k_p: [4.5, 6.0, 5.2], k_d: [3.1, 3.7, 3.4]}",
]


@pytest.mark.parametrize("overrides", [[], ASYMMETRIC_VEHICLE])
def test_poles_of_designed_loops_are_poles_of_the_whole_diagram(shipped, overrides):
    scenario = with_shipped_gains(shipped[0], overrides)
    loop = closed_loop(nominal_hover(scenario))
    position, attitude = scenario.control.position, scenario.control.attitude
    laboratory = laboratory_plant(scenario)
    expected = []
    for axis, block, i in (("z", position, 2), ("yaw", attitude, 2)):
        plant = attitude_plant(laboratory, scenario, axis)
        expected.append(plant.with_feedback(np.array([[block.k_p[i], block.k_d[i]]])).poles())
    for axis, tilt, i in (("x", 1, 0), ("y", 0, 1)):
        plant = position_plant(laboratory, scenario, axis, AxisPdGains(attitude.k_p[tilt], attitude.k_d[tilt]))
        expected.append(plant.with_feedback(np.array([[position.k_p[i], position.k_d[i]]])).poles())
    designed_poles, diagram_poles = np.concatenate(expected), loop.system.poles()
    slow_poles = designed_poles[np.abs(designed_poles) > 0.1]
    assert len(slow_poles) == (np.abs(diagram_poles) > 0.1).sum()
    for pole in slow_poles:
        assert np.abs(diagram_poles - pole).min() < 1e-6


@pytest.mark.slow
def test_shipped_gains_are_reproduced_by_their_documented_call(shipped):
    """The comment in each file of gains names the call that computes them."""
    name, scenario = shipped
    text = (ROOT / "diagrams" / "gains" / f"{name}.yaml").read_text(encoding="utf-8")
    command = shlex.split(re.match(r"# drake-quad (.*)\n", text).group(1))
    assert command == ["design", SHIPPED_SCENARIOS[name]]
    arguments = argparse.ArgumentParser()
    arguments.add_argument("scenario")
    add_design_options(arguments)
    options = design_options(arguments.parse_args(command[1:]), scenario)
    assert options == default_options(scenario.laboratory.command_link.period)
    designed_gains = design_cascade(scenario, options).gains()
    written = YAML(typ="safe").load(text)["gains"]["control"]
    assert {
        block: {name: written[block][name] for name in gains} for block, gains in designed_gains.items()
    } == designed_gains
    for block, gains in designed_gains.items():
        for kind, values in gains.items():
            assert list(getattr(getattr(scenario.control, block), kind)) == values


@pytest.mark.slow
def test_shipped_gains_have_the_required_margins(shipped, designed):
    """The required margins are 45°, 6 dB and, in the attitude loops, two ticks."""
    for axis, loop in designed.loops.items():
        achieved = margins(pd_loop(loop.plant, loop.gains))
        assert achieved.phase >= 45.0
        assert achieved.gain >= 6.0
        if axis in ("roll", "pitch", "yaw"):
            assert achieved.delay >= 2 * 0.02


def peaks(scenario, displacement, duration):
    """Return the largest deviation in each quarter of a simulation that begins with a small displacement."""
    response = initial_response(closed_loop(scenario), displacement, duration=duration)
    (row,) = displacement
    column = ("x", "y", "z", "roll", "pitch", "yaw").index(row)
    return [part.max() for part in np.array_split(np.abs(response.nonlinear[:, column]), 4)]


def grows(scenario, displacement, duration):
    """Return whether a small displacement of the simulated diagram grows after the fast modes have decayed."""
    _, _, third, last = peaks(scenario, displacement, duration)
    return last > third


def scaled(scenario, block, factor, axes):
    """Return the scenario after multiplying the gains of a block on some axes by a factor."""
    part = getattr(scenario.control, block)
    gains = {
        kind: tuple(value * (factor if i in axes else 1.0) for i, value in enumerate(getattr(part, kind)))
        for kind in ("k_p", "k_d")
    }
    control = scenario.control.model_copy(update={block: part.model_copy(update=gains)})
    return scenario.model_copy(update={"control": control})


def with_delay(scenario, ticks):
    link = scenario.laboratory.command_link
    longer = link.model_copy(update={"delay_ticks": link.delay_ticks + ticks})
    return scenario.model_copy(update={"laboratory": scenario.laboratory.model_copy(update={"command_link": longer})})


@pytest.mark.long
def test_the_simulated_loop_tolerates_its_margins(shipped):
    """All displacements still decay with 6 dB more gain in pitch, or with two more ticks of delay.

    Other tests simulate the loops of roll, yaw and position at their gain limits.
    """
    _, scenario = shipped
    resting = at_rest(nominal_hover(scenario))
    assert peaks(scaled(resting, "attitude", 2.0, (0, 1)), {"pitch": 1e-3}, 12.0)[-1] < 1e-4
    for displacement in ({"pitch": 1e-3}, {"yaw": 1e-3}, {"x": 1e-3}, {"z": 1e-3}):
        assert peaks(with_delay(resting, 2), displacement, 12.0)[-1] < 1e-4


@pytest.mark.long
@pytest.mark.parametrize(
    ("block", "axes", "row", "duration"),
    [("attitude", (2,), "yaw", 8.0), ("position", (2,), "z", 8.0), ("position", (0, 1), "x", 40.0)],
)
def test_the_stability_limit_of_the_gain_agrees_with_simulations(shipped, designed, block, axes, row, duration):
    """A small displacement decays 2 % below the stability limit, and grows 2 % above the limit."""
    _, scenario = shipped
    loop = designed.loops[row]
    factor = 10.0 ** (loop.margins.gain / 20.0)
    resting = at_rest(nominal_hover(scenario))
    assert not grows(scaled(resting, block, 0.98 * factor, axes), {row: 1e-5}, duration)
    assert grows(scaled(resting, block, 1.02 * factor, axes), {row: 1e-5}, duration)


@pytest.mark.slow
@pytest.mark.parametrize("ticks", [1, 3])
def test_the_stability_limit_of_the_delay_agrees_with_simulations(shipped, designed, ticks):
    """Two designs have delay margins 2 % above and 2 % below a whole number of ticks.

    Only the first design tolerates this delay.
    """
    _, scenario = shipped
    loop = designed.loops["yaw"]
    resting = at_rest(nominal_hover(scenario))

    grid = frequencies(0.02)
    response = pd_loop(loop.plant, loop.gains).response(np.exp(1j * grid * 0.02))[:, 0, 0]

    def factor_for(delay):
        low, high = 1.0, 10.0 ** (loop.margins.gain / 20.0)
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fast_margins(middle * response, grid).delay > delay else (low, middle)
        return low

    for fraction, is_tolerated in ((1.02, True), (0.98, False)):
        factor = factor_for(fraction * ticks * 0.02)
        assert factor > 1.05, "the designed delay margin must be larger than the tested delay"
        # The other loops are slow enough to tolerate all of these delays.
        slow = scaled(scaled(resting, "attitude", 0.3, (0, 1)), "position", 0.1, (0, 1, 2))
        changed = with_delay(scaled(slow, "attitude", factor, (2,)), ticks)
        assert grows(changed, {"yaw": 1e-5}, 12.0) != is_tolerated


@pytest.mark.slow
def test_design_options_apply_only_to_their_axes():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml")
    options = {
        "yaw": LoopOptions(PolePair(0.9), Requirements(phase=60.0)),
        "z": LoopOptions(PolePair(0.8), Requirements(), 2.0),
    }
    design = design_cascade(scenario, options)
    assert design.loops["yaw"].margins.phase >= 60.0
    assert design.loops["z"].bandwidth == 2.0
    assert design.loops["pitch"].margins.phase < 46.0
    assert design.gains()["attitude"]["k_p"][2] == design.loops["yaw"].gains.k_p


@pytest.mark.slow
def test_a_vehicle_of_thirty_grams_has_the_same_designed_gains():
    """Commands are accelerations, so the gains depend on the vehicle's lag, but not on its mass."""
    small = [
        "nominal.mass=0.03",
        "nominal.inertia=[1.4e-5, 1.4e-5, 2.2e-5]",
        "nominal.thrust_factor=2.9e-8",
        "nominal.drag_factor=7e-10",
        "nominal.arm_length=0.046",
        "nominal.layout={kind: x, rotor_1_turns: anticlockwise}",
        "nominal.min_rotor_speed=200",
        "nominal.max_rotor_speed=2600",
    ]
    gains = [
        design_cascade(load_scenario(ROOT / "diagrams" / "figure_eight.yaml", overrides)).gains()
        for overrides in ([], small)
    ]
    assert gains[0] == gains[1]


def test_the_smallest_ratio_of_a_margin_to_its_requirement_is_returned():
    achieved = FastMargins(gain=5.0, phase=60.0, delay=0.03)
    assert Requirements(40.0, 4.0, 0.02).min_ratio(achieved) == pytest.approx(1.25)
    assert Requirements(50.0, 4.0, 0.02).min_ratio(achieved) == pytest.approx(1.2)
    assert Requirements(40.0, 10.0, 0.02).min_ratio(achieved) == pytest.approx(0.5)
    assert Requirements(40.0, 4.0, 0.1).min_ratio(achieved) == pytest.approx(0.3)
    assert Requirements(0.0, 4.0, 0.0).min_ratio(achieved) == pytest.approx(1.25)
    assert Requirements(0.0, 0.0, 0.0).min_ratio(achieved) == 1.0
    assert Requirements(60.0, 5.0, 0.03).shortfalls(achieved) == {}


def test_the_search_includes_bandwidths_up_to_a_third_of_half_the_sampling_rate():
    efforts = PolePair(0.7).efforts(double_integrator(h=0.01))
    assert (efforts[0], efforts[-1], len(efforts)) == (pytest.approx(0.05), pytest.approx(np.pi / 0.03), 120)
    np.testing.assert_allclose(efforts[1:] / efforts[:-1], efforts[1] / efforts[0])


def test_no_requirement_is_reported_as_limit_if_the_largest_bandwidth_meets_all_requirements():
    """A double integrator without delay meets these weak requirements even with the largest bandwidth that is tried."""
    design = design_loop(double_integrator(), PolePair(0.8), Requirements(1.0, 0.1), axis="x")
    assert (design.axis, design.limits) == ("x", ())
    assert design.bandwidth == pytest.approx(np.pi / 0.06)
    assert design.gains == tuple(float(f"{gain:.4g}") for gain in PolePair(0.8).gains(design.plant, design.bandwidth))


@pytest.mark.slow
def test_the_largest_bandwidth_is_found_to_a_thousandth(pitch):
    """The search bisects between two bandwidths that differ by 6 %."""
    requirements = Requirements(phase=50.0, gain=6.0)
    bandwidth = design_loop(pitch, PolePair(0.8), requirements, axis="pitch").bandwidth
    design_loop(pitch, PolePair(0.8), requirements, axis="pitch", effort=bandwidth)
    with pytest.raises(InputError, match="phase margin"):
        design_loop(pitch, PolePair(0.8), requirements, axis="pitch", effort=1.001 * bandwidth)


def with_slow_mode(decay):
    """Return a double integrator with a mode that decays at the given rate, 1/s, almost independently of the loop."""
    plant = double_integrator()
    A = np.diag([0.0, 0.0, np.exp(-decay * plant.period)])
    A[:2, :2] = plant.A
    B, C = np.vstack([plant.B, [[1e-6]]]), np.hstack([plant.C, [[1e-3], [0.0]]])
    return replace(plant, A=A, B=B, C=C, states=("x", "v", "slow"))


@pytest.mark.parametrize(("decay", "is_refused"), [(1.57, False), (1.56, True)])
def test_a_pole_that_is_more_than_two_percent_slower_than_the_pole_pair_is_refused(decay, is_refused):
    """The pole pair decays at ω ζ = 1.6 1/s."""
    plant, no_requirements = with_slow_mode(decay), Requirements(0.0, 0.0, 0.0)
    if is_refused:
        words = r"x cannot have a bandwidth of 2 rad/s: a slower pole: it decays at 1\.56 1/s, the pair at 1\.6"
        with pytest.raises(InputError, match=words):
            design_loop(plant, PolePair(0.8), no_requirements, axis="x", effort=2.0)
    else:
        assert design_loop(plant, PolePair(0.8), no_requirements, axis="x", effort=2.0).bandwidth == 2.0


class ProportionalFamily:
    """Family of gains that are proportional to the effort."""

    def __init__(self, k_p, k_d):
        self.k_p, self.k_d = k_p, k_d

    def gains(self, plant, effort):
        return AxisPdGains(self.k_p * effort, self.k_d * effort)

    def efforts(self, plant):
        return np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ((1.0, -0.5), r"x cannot have an effort of 1: a negative gain: k_P 1, k_D -0\.5"),
        ((-1.0, 0.5), r"a negative gain: k_P -1, k_D 0\.5"),
        ((1.0, 0.0), r"a negative gain: k_P 1, k_D 0"),
        ((np.nan, 1.0), "no gains: none exist for this effort"),
        ((1.0, 0.001), r"no stability: a pole of magnitude 1\.000\d"),
        ((1.0, 120.0), r"no stability: a pole of magnitude 1\.\d{4}"),
    ],
)
def test_the_message_about_unacceptable_gains_gives_the_reason(gains, message):
    with pytest.raises(InputError, match=message):
        design_loop(double_integrator(), ProportionalFamily(*gains), Requirements(0.0, 0.0, 0.0), axis="x", effort=1.0)


@pytest.mark.slow
def test_the_gains_closest_to_the_requirements_are_reported():
    """The phase margin increases with the effort, so the gains with the largest effort come closest."""
    plant = double_integrator()
    phases = [margins(pd_loop(plant, AxisPdGains(effort, 0.5 * effort))).phase for effort in (1.0, 2.0, 3.0)]
    assert phases == sorted(phases)
    with pytest.raises(InputError, match=rf"closest result: phase margin: {phases[2]:.1f}°, less than 60°"):
        design_loop(plant, ProportionalFamily(1.0, 0.5), Requirements(60.0, 0.0), axis="x")


def test_an_unstable_loop_has_infinite_cost():
    family, plant = OutputRegulator(0.2), double_integrator()
    assert family.cost(plant, AxisPdGains(1.0, 0.001), 10.0) == np.inf
    assert family.cost(plant, AxisPdGains(0.0, 1.0), 10.0) == np.inf
    assert np.isfinite(family.cost(plant, AxisPdGains(1.0, 1.0), 10.0))
    # No feedback stabilises an uncontrollable mode.
    uncontrollable = replace(plant, B=np.zeros((2, 1)))
    assert np.isnan(family.gains(uncontrollable, 1.0)).all()


def test_gains_of_a_design_are_listed_axis_by_axis(pitch):
    axes = {name: 10.0 + index for index, name in enumerate(("roll", "pitch", "yaw", "x", "y", "z"))}
    achieved = margins(pd_loop(pitch, AxisPdGains(6.0, 4.0)))
    design = CascadeDesign(
        {name: LoopDesign(name, AxisPdGains(k, 0.5 * k), pitch, achieved) for name, k in axes.items()}
    )
    assert design.gains() == {
        "position": {"k_p": [13.0, 14.0, 15.0], "k_d": [6.5, 7.0, 7.5]},
        "attitude": {"k_p": [10.0, 11.0, 12.0], "k_d": [5.0, 5.5, 6.0]},
    }
    before = load_scenario(ROOT / "diagrams" / "figure_eight.yaml")
    after = with_gains(before, design.gains())
    for block, gains in design.gains().items():
        for kind, values in gains.items():
            assert list(getattr(getattr(after.control, block), kind)) == values
    assert with_gains(after, {"attitude": {"k_p": [1.0, 2.0, 3.0]}}).control.attitude.k_d == (5.0, 5.5, 6.0)
    assert with_gains(after, CascadeDesign(design.loops).gains()) == after
    restored = after.control.model_copy(update={name: getattr(before.control, name) for name in design.gains()})
    assert after.model_copy(update={"control": restored}) == before


@pytest.mark.slow
def test_axes_with_equal_plants_have_equal_gains():
    """Roll and pitch gains are equal even on an asymmetric vehicle, because commands are accelerations."""
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml", ["nominal.inertia=[0.0065, 0.0085, 0.0126]"])
    options = default_options(0.02)
    assert list(options) == ["roll", "pitch", "yaw", "z", "x", "y"]
    for axis, each in options.items():
        delay = 0.04 if axis in ("roll", "pitch", "yaw") else 0.0
        assert each == (PolePair(0.8), Requirements(45.0, 6.0, delay), None)
    design = design_cascade(scenario, {"pitch": options["pitch"]._replace(effort=2.0)})
    loops = design.loops
    assert [loop.axis for loop in loops.values()] == list(loops)
    assert loops["pitch"].bandwidth == 2.0
    assert loops["roll"].gains == loops["yaw"].gains != loops["pitch"].gains
    # If the attitude loops of two axes differ, the gains of the position loops around them differ as well.
    assert loops["x"].gains != loops["y"].gains


class ListedFamily(ProportionalFamily):
    """Family whose gains are given as a list; the effort is the position in the list, from 1 on."""

    def __init__(self, *gains):
        self.listed = gains

    def gains(self, plant, effort):
        return self.listed[round(effort) - 1]


def test_a_message_without_acceptable_gains_describes_stable_gains():
    """The message describes the gains that are closest to meeting the requirements.

    Only the first gains of the family are stable, although they have the smallest margins. The second gains are
    unstable, and the third contain a NaN.
    """
    family = ListedFamily(AxisPdGains(1.0, 0.2), AxisPdGains(1.0, 120.0), AxisPdGains(np.nan, 1.0))
    phase = margins(pd_loop(double_integrator(), AxisPdGains(1.0, 0.2))).phase
    with pytest.raises(InputError, match=rf"closest result: phase margin: {phase:.1f}°, less than 60°"):
        design_loop(double_integrator(), family, Requirements(60.0, 0.0), axis="x")


def delayed_integrator(ticks):
    """Return a double integrator that is sampled once a second and has the given input delay, s."""
    plant = double_integrator(h=1.0)
    n = 2 + ticks
    A, B, C = np.zeros((n, n)), np.zeros((n, 1)), np.hstack([plant.C, np.zeros((2, ticks))])
    A[:2, :2] = plant.A
    if ticks:
        A[:2, 2:3] = plant.B
        A[2:-1, 3:] = np.eye(ticks - 1)
        B[-1] = 1.0
    else:
        B[:] = plant.B
    return replace(plant, A=A, B=B, C=C, states=tuple(map(str, range(n))))


@pytest.mark.parametrize(
    ("ticks", "frequency"),
    [(0, 0.2), (2, 0.2), (8, 0.05), (30, 0.0125), pytest.param(120, 0.003, marks=pytest.mark.long)],
)
def test_the_search_for_a_regulator_starts_with_the_fastest_stable_gains(monkeypatch, ticks, frequency):
    """The longer the delay, the lower the bandwidth of the gains from which the search starts."""
    monkeypatch.setattr("scipy.optimize.minimize", lambda function, start, **_: SimpleNamespace(x=start))
    gains = OutputRegulator(0.2).gains(delayed_integrator(ticks), 1.0)
    assert gains == pytest.approx((frequency**2, 1.6 * frequency))


def test_the_gains_of_a_regulator_are_found_to_four_digits():
    plant, family = double_integrator(), OutputRegulator(0.3)
    for effort in (0.5, 20.0):
        K, _ = DiscreteTimeLinearQuadraticRegulator(plant.A, plant.B, np.diag([1.0, 0.09]), np.eye(1) / effort**2)
        np.testing.assert_allclose(family.gains(plant, effort), K[0], rtol=5e-5)


def test_the_derivatives_of_the_regulator_cost_match_finite_differences(pitch, monkeypatch):
    result = []

    def compare(function, start, **options):
        for logs in start + np.array([[0.0, 0.0], [0.3, -0.2], [0.1, 0.7]]):
            numeric = scipy.optimize.approx_fprime(logs, lambda tried: function(tried)[0], 1e-7)
            np.testing.assert_allclose(function(logs)[1], numeric, rtol=1e-5, atol=1e-6)
        result.append(options["jac"])
        return SimpleNamespace(x=start)

    monkeypatch.setattr("scipy.optimize.minimize", compare)
    OutputRegulator(0.2).gains(pitch, 3.0)
    assert result == [True]


def test_the_search_for_a_regulator_finds_the_minimum_after_a_step_to_unstable_gains():
    """The delay is so long that the first step of the search leads to unstable gains."""
    plant, family = delayed_integrator(8), OutputRegulator(0.2)
    gains = family.gains(plant, 1e3)
    min_cost = family.cost(plant, gains, 1e3)
    assert all(family.cost(plant, AxisPdGains(gains.k_p * each, gains.k_d), 1e3) > min_cost for each in (0.99, 1.01))


class RecordingFamily(ProportionalFamily):
    """Family of gains that are proportional to their one design parameter, the effort.

    The list `tried` contains all efforts for which a design has computed gains.
    """

    def __init__(self, k_p, k_d):
        super().__init__(k_p, k_d)
        self.tried = []

    def gains(self, plant, effort):
        self.tried.append(effort)
        return super().gains(plant, effort)

    def efforts(self, plant):
        return np.array([1.0, 90.0, 110.0, 120.0])


def test_a_design_tries_no_larger_gains_after_the_first_unstable_gains():
    """The loop is unstable if k_D is above about 100 1/s."""
    family = RecordingFamily(0.01, 1.0)
    design = design_loop(double_integrator(), family, Requirements(0.0, 0.0, 0.0), axis="x")
    assert 90.0 < design.gains.k_d < 110.0
    assert family.tried[:3] == [1.0, 90.0, 110.0]
    assert max(family.tried) == 110.0


def designed_pid(integration):
    scenario = with_integrals(load_scenario(ROOT / "diagrams" / "laboratory.yaml:nominal", ASYMMETRIC_VEHICLE))
    position = scenario.control.position.model_copy(update={"integration": integration})
    control = scenario.control.model_copy(update={"position": position})
    scenario = scenario.model_copy(update={"control": control})
    return scenario, design_cascade(scenario, integral=0.2)


@pytest.fixture(scope="module")
def pid_design():
    return designed_pid("forward_euler")


@pytest.mark.long
@pytest.mark.parametrize("integration", ["forward_euler", "backward_euler"])
def test_poles_of_loops_with_a_designed_pid_are_poles_of_the_whole_diagram(integration, pid_design):
    scenario, design = pid_design if integration == "forward_euler" else designed_pid(integration)
    diagram_poles = closed_loop(nominal_hover(with_gains(scenario, design.gains()))).system.poles()
    for axis in ("x", "y", "z"):
        loop = design.loops[axis]
        poles = loop.plant.with_feedback(np.array([loop.gains])).poles()
        for pole in poles[np.abs(poles) > 0.1]:
            assert np.abs(diagram_poles - pole).min() < 1e-6


@pytest.mark.slow
def test_an_integral_costs_at_most_the_given_fraction_of_the_phase_margin(pid_design):
    """The PD is designed with a phase margin of 45° / 0.8, since the integral may cost a fifth of it.

    A larger integral would violate the margin of 45° or exceed the largest ratio of integral to proportional gain.
    """
    _, design = pid_design
    for axis in ("x", "y", "z"):
        loop = design.loops[axis]
        k_p, k_d, k_i = loop.gains
        pd = margins(pd_loop(loop.plant, PidGains(k_p, k_d, 0.0)))
        assert pd.phase >= 45.0 / 0.8
        assert loop.margins == margins(pd_loop(loop.plant, loop.gains))
        assert loop.margins.phase >= max(0.8 * pd.phase, 45.0) - 0.02
        is_largest_ratio = k_i == pytest.approx(0.25 * k_p * pd.crossover, rel=1e-3)
        larger = margins(pd_loop(loop.plant, PidGains(k_p, k_d, 1.05 * k_i)))
        assert k_i > 0.0
        assert is_largest_ratio or larger.phase < max(0.8 * pd.phase, 45.0)


@pytest.mark.slow
def test_an_integral_reduces_a_phase_margin_by_the_given_fraction_but_not_below_the_required_margin(pid_design):
    """A slow PD has a phase margin of more than 55°, of which the integral may cost 5 %."""
    scenario, _ = pid_design
    plant = attitude_plant(laboratory_plant(scenario), scenario, "z")
    slow = design_loop(plant, PolePair(0.8), Requirements(), axis="z", effort=1.0)
    assert slow.margins.phase > 55.0
    phase = add_integral(slow, Requirements(), cost=0.05).margins.phase
    assert 0.95 * slow.margins.phase - 0.02 <= phase < 0.96 * slow.margins.phase
    # If the integral may cost half of the phase margin, it costs less, so that the required margin remains.
    required = slow.margins.phase - 1.0
    phase = add_integral(slow, Requirements(phase=required), cost=0.5).margins.phase
    assert required - 0.02 <= phase < required + 0.2


@pytest.mark.slow
def test_an_integral_leaves_the_loop_stable_even_if_hardly_any_margins_are_required(pid_design):
    """In a weakly damped loop, an integral that is 5 % larger than the designed one causes growing oscillations."""
    scenario, _ = pid_design
    plant = attitude_plant(laboratory_plant(scenario), scenario, "z")
    slow = design_loop(plant, PolePair(0.8), Requirements(), axis="z", effort=1.0)
    weakly_damped_gains = slow.gains._replace(k_d=0.1 * slow.gains.k_d)
    weakly_damped_loop = replace(slow, gains=weakly_damped_gains, margins=margins(pd_loop(plant, weakly_damped_gains)))
    result = add_integral(weakly_damped_loop, Requirements(phase=0.1, gain=0.1), cost=1.0)

    def largest_pole(factor):
        gains = np.array(result.gains) * [1.0, 1.0, factor]
        return np.abs(result.plant.with_feedback(gains[np.newaxis]).poles()).max()

    assert largest_pole(1.0) < 1.0 < largest_pole(1.05)


@pytest.mark.parametrize(("integration", "direct"), [("forward_euler", 0.0), ("backward_euler", 0.02)])
def test_the_integral_is_the_discrete_sum_of_the_measured_value(integration, direct):
    """The factor from value to integral is h / (z - 1) for forward Euler, and h z / (z - 1) for backward Euler."""
    plant = SampledSystem(
        np.array([[0.9, 0.1], [-0.2, 0.8]]),
        np.array([[0.3], [0.5]]),
        np.array([[1.0, 0.4], [0.2, 1.1]]),
        np.array([[0.06], [0.0]]),
        0.02,
        ("a", "b"),
        ("u",),
        ("value", "rate"),
    )
    z = np.array([1.1 + 0.3j, -0.7 + 0.2j])
    value, rate, integral = np.moveaxis(with_integral(plant, integration).response(z)[..., 0], -1, 0)
    np.testing.assert_allclose(np.stack([value, rate], axis=-1), plant.response(z)[..., 0])
    np.testing.assert_allclose(integral, (0.02 / (z - 1.0) + direct) * value)


def test_a_pd_is_converted_to_a_pid_only_once():
    scenario = load_scenario(ROOT / "diagrams" / "figure_eight.yaml")
    pid = with_integrals(scenario)
    assert (pid.control.position.kind, pid.control.position.k_i) == ("pid", (0.0, 0.0, 0.0))
    assert pid.control.position.k_p == scenario.control.position.k_p
    assert (pid.control.position.feed_forward, pid.control.position.derivative) == ("snap", "tracking_error")
    assert with_integrals(pid) is pid
