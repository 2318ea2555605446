"""The steps of an identification with an autopilot: candidates, windows, first states and explained shares."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from neural_fly_flight import guessed
from scipy.stats import t

from drake_quad import InputError, load_scenario
from drake_quad.identification import response_identification as response
from drake_quad.identification.fitting.evidence import Evidence, Uncertainty
from drake_quad.identification.fitting.multiple_shooting import Problem
from drake_quad.identification.fitting.open_loop import DELAY, OpenLoop, Starts, delay_of
from drake_quad.identification.fitting.random_effects import of_the_mean, variation_of
from drake_quad.identification.fitting.whitening import Noise
from drake_quad.identification.fitting.windows import held_out
from drake_quad.identification.result import Spread
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Explained
from drake_quad.identification.results.vehicle_numbers import number_of

PERIOD = 0.02
MISALIGNED = "laboratory.motion_capture.misalignment"


def record(seconds=20.0, *, name="log", period=PERIOD, **changes):
    """Return a flight without noise, whose signals are different sinusoids."""
    time = period * np.arange(round(seconds / period))

    def swings(size, rate, columns=3):
        return size * np.sin(np.outer(time, rate * (1.0 + 0.1 * np.arange(columns))) + np.arange(columns))

    signals = {
        "position": swings(1.0, 1.0),
        "velocity": swings(0.8, 1.1),
        "attitude": swings(0.2, 1.3),
        "body_rates": swings(0.3, 1.7),
        "attitude_command": swings(0.25, 1.3),
        "thrust_share": 0.5 + swings(0.1, 2.0, 1)[:, 0],
    }
    return FlightRecord(name, time, **(signals | changes))


@pytest.fixture(scope="module")
def scenario():
    return guessed()


def test_outputs_depend_on_the_logged_signals_and_on_the_kind_of_command():
    whole = record()
    names = [output.name for output in response._outputs([whole], True)]
    assert names == ["position x", "position y", "position z", "roll", "pitch", "yaw"]
    without = record(position=None)
    outputs = response._outputs([whole, without], False)
    assert [output.name for output in outputs] == [
        *(f"velocity {axis}" for axis in "xyz"),
        *("roll", "pitch", "yaw"),
        *(f"body rate {axis}" for axis in "pqr"),
    ]
    # The rows are those of the state: position, attitude, velocity and body rates.
    assert [(output.signal, output.column, output.row) for output in outputs] == [
        *(("velocity", i, 6 + i) for i in range(3)),
        *(("attitude", i, 3 + i) for i in range(3)),
        *(("body_rates", i, 9 + i) for i in range(3)),
    ]
    assert [output.row for output in response._outputs([whole], True)] == [0, 1, 2, 3, 4, 5]
    # An autopilot keeps the errors of angles from growing.
    assert [output.strays for output in response._outputs([whole], True)][3:] == [0.0] * 3
    assert min(output.strays for output in outputs) > 0.0
    # Unmodelled motion within a second is assumed to be larger than the measurement noise.
    for output in (*response._outputs([whole], False), *outputs):
        assert output.usual < output.strays
    for missing in ("attitude", "body_rates"):
        with pytest.raises(InputError, match=f"lacks {missing}"):
            response._outputs([record(**{missing: None})], False)
    response._outputs([record(body_rates=None)], True)
    with pytest.raises(InputError, match="lacks velocity"):
        response._outputs([record(position=None, velocity=None)], True)


def test_candidates_depend_on_how_the_thrust_is_commanded(scenario):
    throttles = response._candidates(scenario)
    assert {"motors.curve[0]", "motors.curve[1]"} <= {*throttles}
    assert "thrust_factor" not in throttles
    assert {name for name in throttles if name.startswith(MISALIGNED)} == {f"{MISALIGNED}[{i}]" for i in range(2)}
    assert {name for name in throttles if name.startswith("autopilot")} == {
        f"autopilot.{kind}[{i}]" for kind in ("natural_frequency", "damping") for i in range(3)
    }
    assert {name for name in throttles if name.startswith("body_drag.linear")} == {
        "body_drag.linear[0]",
        "body_drag.linear[1]",
    }
    assert "body_drag.quadratic[2]" in throttles
    speeds = load_scenario("laboratory:low_wind")
    assert "thrust_factor" in response._candidates(speeds)
    assert not {"motors.curve[0]", "motors.curve[1]"} & {*response._candidates(speeds)}
    rigid = response._rigid_candidates(scenario)
    assert {"motors.curve[0]", "motors.curve[2]", "inertia[0]", "inertia[1]", "drag_factor", DELAY} <= {*rigid}
    assert "inertia[2]" not in rigid
    assert "thrust_factor" in response._rigid_candidates(speeds)
    assert {name for name in rigid if name.startswith(MISALIGNED)} == {f"{MISALIGNED}[{i}]" for i in range(2)}
    # A force that is zero acts nowhere.
    pressure = "body_drag.centre_of_pressure[2]"
    with_drag = load_scenario("laboratory:low_wind", ["vehicle.body_drag={linear: [0.05, 0.05, 0.05]}"])
    assert pressure not in response._rigid_candidates(speeds)
    assert pressure in response._rigid_candidates(with_drag)
    for name in {*throttles, *rigid}:
        assert number_of(scenario, name) is not None
        assert response._scale(scenario, name) >= 0.0


def test_scales_of_candidates_follow_the_vehicle(scenario):
    """They follow the mass, the weight and the tick of the link, or the believed value."""
    mass, gravity = scenario.vehicle.mass, scenario.vehicle.gravity
    assert response._scale(scenario, "motors.curve[1]") == pytest.approx(0.25 * mass * gravity)
    assert response._scale(scenario, "body_drag.linear[0]") == pytest.approx(0.3 * mass)
    assert response._scale(scenario, "body_drag.quadratic[2]") == pytest.approx(0.05 * mass)
    assert response._scale(scenario, DELAY) == pytest.approx(0.03 / scenario.laboratory.command_link.period)
    assert response._scale(scenario, "autopilot.natural_frequency[1]") == 10.0
    heavy = scenario.model_copy(update={"vehicle": scenario.vehicle.model_copy(update={"mass": 2.0 * mass})})
    for name in ("rotor_aerodynamics.lift", "rotor_aerodynamics.climb", "motors.curve[0]"):
        assert response._scale(heavy, name) == pytest.approx(2.0 * response._scale(scenario, name))


def test_positive_parameters_have_a_lower_limit(scenario):
    assert response._least("autopilot.natural_frequency[0]", 10.0) == pytest.approx(0.2)
    assert response._least("inertia[1]", 0.01) == pytest.approx(2e-4)
    assert response._least("rotor_time_constant", 0.05) == 2e-3
    assert response._least("body_drag.linear[0]", 0.3) == -np.inf


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_windows_are_consecutive_airborne_and_without_gaps(scenario, share):
    """Compare with a search sample by sample. Commands of the first 0.4 s, and after a gap, are unknown."""
    first = record(12.0, name="first")
    kept = (first.time < 5.0) | (first.time > 5.5)
    thrust = np.where((first.time > 8.0) & (first.time < 8.3), 0.0, first.thrust_share)
    gapped = replace(first, thrust_share=thrust).part(kept)
    windows = response._cut([gapped, record(7.0, name="second")], scenario, share, 1.0)
    assert windows.length == 50
    assert windows.every == 1
    for place, log in enumerate(windows.records):
        flying = response.airborne(log)
        warm_up = 20
        starts = []
        sample = warm_up
        while sample + 50 < len(log.time):
            whole = flying[sample : sample + 51].all()
            steady = np.diff(log.time[sample - warm_up : sample + 51]).max() < 0.1
            starts += [sample] if whole and steady else []
            sample += 50 if whole and steady else 1
        own = windows.places == place
        assert windows.starts[own].tolist() == starts
        late = held_out(flying, share)[starts] if share else np.zeros(len(starts), dtype=bool)
        np.testing.assert_array_equal(windows.unseen[own], late)
    assert (windows.places == 0).sum() > 3
    assert windows.unseen.any() == (share > 0.0)
    some = windows.chosen(windows.places == 1)
    assert len(some.starts) == (windows.places == 1).sum()
    # Samples and times are those of the logs.
    steps = np.arange(51)
    for window, (place, start) in enumerate(zip(windows.places, windows.starts, strict=True)):
        log = windows.records[place]
        np.testing.assert_array_equal(windows.measured("velocity", 1)[window], log.velocity[start + steps, 1])
        np.testing.assert_array_equal(windows.times()[window], log.time[start + steps])


def test_angles_of_windows_are_unwrapped(scenario):
    turning = record(4.0)
    yaw = np.linspace(0.0, 12.0, len(turning.time))
    wrapped = np.column_stack([0.0 * yaw, 0.0 * yaw, (yaw + np.pi) % (2.0 * np.pi) - np.pi])
    windows = response._cut([replace(turning, attitude=wrapped)], scenario, 0.0, 1.0)
    measured = windows.measured("attitude", 2)
    np.testing.assert_allclose(np.diff(measured, axis=1), yaw[1] - yaw[0])


def test_fast_logs_are_compared_at_a_subset_of_samples(scenario):
    """Samples are 20 ms apart in long windows, and a fiftieth of the window in short ones."""
    windows = response._cut([record(12.0, period=0.005)], scenario, 0.0, 2.0)
    assert (windows.every, windows.length) == (4, 400)
    assert windows.times().shape[1] == 101
    windows = response._cut([record(6.0, period=0.002)], scenario, 0.0, 0.4)
    assert (windows.every, windows.length) == (4, 200)


def test_windows_are_simulated_with_the_commands_of_their_logs(scenario):
    """Each window starts from its own state, and its result is the same as if it were simulated alone."""
    windows = response._cut([record(3.0), record(4.0, attitude_command=np.zeros((200, 3)))], scenario, 0.0, 1.0)
    random = np.random.default_rng(2)
    bodies = 0.1 * random.normal(size=(2, len(windows.starts), 12))
    numbers = {"body_drag.linear[0]": np.array([0.3, 0.9])}
    flown = windows.fly(bodies, numbers)
    assert flown.shape == (51, 2, len(windows.starts), 12)
    for window in range(len(windows.starts)):
        alone = windows.chosen(np.array([window])).fly(bodies[:, [window]], numbers)
        np.testing.assert_allclose(flown[:, :, window], alone[:, :, 0], atol=1e-12)
    assert len({*windows.places.tolist()}) == 2


def test_first_states_are_fitted_by_straight_lines(scenario):
    """They are exact for linear signals, and use the first tenth of a second and a little more."""
    base = record(6.0)
    slopes = np.array([[0.3, -0.2, 0.5], [0.1, 0.04, -0.2]])
    line = {"position": 1.0 + np.outer(base.time, slopes[0]), "attitude": 0.2 + np.outer(base.time, slopes[1])}
    windows = response._cut([replace(base, **line)], scenario, 0.0, 1.0)
    model = response._Model.of(scenario, response._outputs(windows.records, True), [])
    states = model.first_states(windows)
    begins = windows.times()[:, :1]
    np.testing.assert_allclose(states[:, :3], 1.0 + begins * slopes[0])
    np.testing.assert_allclose(states[:, 3:6], 0.2 + begins * slopes[1])
    np.testing.assert_allclose(states[:, 6:9], np.tile(slopes[0], (len(begins), 1)))
    np.testing.assert_allclose(states[:, 9:], np.tile(slopes[1], (len(begins), 1)))
    # Later samples do not count.
    size = {"position": 3.0, "attitude": 0.3}
    bent = {name: values + np.where(base.time % 1.0 > 0.95, size[name], 0.0)[:, None] for name, values in line.items()}
    later = response._cut([replace(base, **bent)], scenario, 0.0, 1.0)
    same = later.starts % 50 == 0
    np.testing.assert_allclose(model.first_states(later)[same], states[same])


def test_a_tilt_of_the_markers_rotates_the_measured_attitude(scenario):
    """The tilt itself is measured if the vehicle is level."""
    windows = response._cut([record(3.0, attitude_command=np.zeros((150, 3)))], scenario, 0.0, 1.0)
    names = (f"{MISALIGNED}[0]", f"{MISALIGNED}[1]")
    model = response._Model.of(scenario, response._outputs(windows.records, True), names)
    states = np.zeros((2, len(windows.starts), 12))
    predicted = model.predictions(windows, names, np.array([[0.02, -0.03], [0.0, 0.0]]), states)
    assert predicted.shape == (2, len(windows.starts), 6, 51)
    own = [number_of(scenario, f"{MISALIGNED}[{i}]") for i in range(3)]
    np.testing.assert_allclose(np.abs(predicted[0, :, 3]), 0.02, atol=1e-3)
    np.testing.assert_allclose(np.abs(predicted[0, :, 4]), 0.03, atol=1e-3)
    np.testing.assert_allclose(
        predicted[1, :, 3:6],
        np.broadcast_to(np.array(own)[:, None], (len(windows.starts), 3, 51)) * [[0], [0], [1]],
        atol=1e-9,
    )


def test_responses_of_angles_whose_commands_vary_less_than_the_noise_are_no_candidates(scenario):
    """The variation of each angle is its root mean square within windows."""
    base = record(8.0)
    command = np.stack([0.05 * np.sin(7.0 * base.time), 3.0 + 0.004 * np.sin(7.0 * base.time), 0.0 * base.time], axis=1)
    windows = response._cut([replace(base, attitude_command=command)], scenario, 0.0, 1.0)
    names = ("autopilot.damping[0]", "rotor_time_constant", "autopilot.damping[1]", "autopilot.natural_frequency[2]")
    model = response._Model.of(scenario, response._outputs([base], True), names)
    noises = [Noise(1e-3, 0.0)] * 3 + [Noise(white, 0.0) for white in (0.03, 2e-3, 1e-3)]
    why = {}
    kept, values = response._excited(model, windows, noises, names, np.arange(4.0), why)
    assert kept == names[:3]
    np.testing.assert_array_equal(values, [0.0, 1.0, 2.0])
    assert set(why) == {names[3]}
    assert why[names[3]].startswith(
        "the command of yaw varies by 0 rad, less than the noise of what is measured, 0.001"
    )
    # The root mean square of 0.05 sin is 0.035, and that of 0.004 sin is 0.0028.
    louder = noises[:3] + [Noise(white, 0.0) for white in (0.04, 3.2e-3, 1e-3)]
    kept, values = response._excited(model, windows, louder, names, np.arange(4.0), {})
    assert kept == ("rotor_time_constant",)
    np.testing.assert_array_equal(values, [1.0])
    rest = ("rotor_time_constant",)
    assert response._excited(model, windows, louder, rest, np.ones(1), {})[0] == rest


def test_numbers_with_too_large_an_uncertainty_are_not_identified():
    found = response._untold(("a", "b"), np.array([0.51, 0.49]), np.array([1.0, 1.0]))
    assert list(found) == ["a"]
    assert found["a"].endswith("would be 0.51, where it may well be off by 1")


def test_numbers_that_are_held_at_zero_are_reported_with_their_intervals(scenario):
    period = scenario.laboratory.command_link.period
    names = ("body_drag.linear[0]", DELAY, "inertia[0]")
    said = response._below_remarks(
        scenario, names, np.array([True, True, False]), np.array([-0.2, -1.5, 1.0]), np.array([0.1, 0.5, 1.0])
    )
    assert said[0].startswith("body_drag.linear[0] came out at -0.20 ± 0.10 ")
    assert said[1].startswith(
        f"{DELAY} came out at {-1.5e3 * period:.2g} ± {0.5e3 * period:.2g} ms, and is held at zero"
    )
    assert len(said) == 2


def test_remarks_count_windows_and_logs(scenario):
    windows = response._cut([record(6.0), record(5.0)], scenario, 0.4, 1.0)
    known = int((~windows.unseen).sum())
    (remark,) = response._remarks(windows, ())
    assert remark == f"{known} windows of 1 s were fitted and {len(windows.unseen) - known} held out, of 2 logs"
    (remark,) = response._remarks(response._cut([record(6.0)], scenario, 0.0, 1.0), ())
    assert remark == "4 windows of 1 s were fitted and 0 held out, of 1 log"
    assert len(response._remarks(windows, ("rotor_aerodynamics.climb", "inertia[0]"))) == 3
    assert len(response._remarks(windows, ("body_drag.centre_of_pressure[2]",))) == 2


def test_blocks_have_equally_many_windows_and_are_at_most_thirty():
    for count, together in ((5, 1), (30, 1), (31, 2), (61, 3)):
        blocks = response._blocks(SimpleNamespace(starts=np.arange(count)))
        np.testing.assert_array_equal(blocks, np.arange(count) // together)


def test_variations_are_residuals_of_a_straight_line():
    random = np.random.default_rng(3)
    times = 5.0 + np.sort(random.uniform(size=(4, 30)), axis=1)
    values = random.normal(size=(4, 30))
    expected = [v - np.polyval(np.polyfit(t, v, 1), t) for t, v in zip(times, values, strict=True)]
    np.testing.assert_allclose(response._varying(values, times), expected, atol=1e-9)


def test_noises_are_alike_if_drift_agrees_to_a_tenth_and_white_noise_to_a_twentieth():
    one = Noise(1.0, 2.0)
    for other, alike in (
        (Noise(1.0, 2.0), True),
        (Noise(1.04, 2.0), True),
        (Noise(1.06, 2.0), False),
        (Noise(0.94, 2.0), False),
        (Noise(1.0, 2.2), True),
        (Noise(1.0, 2.3), False),
        (Noise(1.0, 1.7), False),
    ):
        assert response._alike(one, other) == alike


@pytest.fixture(scope="module")
def left(scenario):
    """Return a model, windows of which a third is held out, and residuals of 0.1 of the variation plus noise."""
    windows = response._cut([record(12.0, name="log")], scenario, 0.34, 1.0)
    outputs = response._outputs(windows.records, True)
    model = response._Model.of(scenario, outputs, ("rotor_time_constant", "body_drag.linear[0]"))
    random = np.random.default_rng(5)
    residuals = np.stack(
        [0.1 * response._varying(windows.measured(o.signal, o.column), windows.times()) for o in outputs], axis=1
    ) + 1e-3 * random.normal(size=(len(windows.starts), 6, 51))
    slopes = random.normal(size=(len(windows.starts), 6, 51, 2)) * np.array([1.0, 0.3])
    return model, windows, response._Left(residuals, slopes)


def detrended(values, times):
    return np.array([v - np.polyval(np.polyfit(t, v, 1), t) for t, v in zip(times, values, strict=True)])


def test_series_hold_the_measurements_and_their_explained_share(left):
    model, windows, rest = left
    noises = [Noise(0.1 * i, 0.0) for i in range(6)]
    series = response._series(model, windows, rest, noises)
    for o, (fitted, output) in enumerate(zip(series, model.outputs, strict=True)):
        np.testing.assert_array_equal(fitted.measured, windows.measured(output.signal, output.column))
        # The residuals of the model are predicted minus measured.
        np.testing.assert_allclose(fitted.residual, -rest.residuals[:, o])
        assert (fitted.name, fitted.unit, fitted.deviation) == (output.name, output.unit, 0.1 * o)
        assert fitted.log.tolist() == ["log"] * len(windows.starts)
        for share, chosen in ((fitted.share, windows.unseen), (fitted.share_fitted, ~windows.unseen)):
            varies = detrended(fitted.measured[chosen], fitted.time[chosen])
            expected = 1.0 - np.sum(fitted.residual[chosen] ** 2) / np.sum(varies**2)
            assert share == pytest.approx(expected)
            assert 0.9 < share < 1.0


def test_a_number_explains_the_growth_of_residuals_at_its_believed_value(left):
    """The share is that of held-out windows, and of the output where it is largest."""
    model, windows, rest = left
    names = ("rotor_time_constant", "body_drag.linear[0]")
    values = np.array([0.3, 0.35])
    found = response._explained(model, windows, names, rest, values, model.outputs)
    chosen = windows.unseen
    for i, name in enumerate(names):
        change = model.believed[name] - values[i]
        shares = []
        for o, output in enumerate(model.outputs):
            whole = np.sum(detrended(windows.measured(output.signal, output.column), windows.times())[chosen] ** 2)
            own = rest.residuals[chosen, o]
            other = own + change * rest.slopes[chosen, o, :, i]
            shares.append(min((np.sum(other**2) - np.sum(own**2)) / whole, 1.0))
        best = int(np.argmax(shares))
        assert found[name].share == pytest.approx(shares[best])
        assert found[name].output == model.outputs[best].name
    # If the whole model explains next to nothing, no number explains anything.
    poor = rest._replace(residuals=12.0 * rest.residuals)
    assert response._explained(model, windows, names, poor, values, model.outputs) == {}
    # All windows count if none is held out.
    seen = replace(windows, unseen=np.zeros(len(windows.starts), dtype=bool))
    assert response._explained(model, seen, names, rest, values, model.outputs)[names[0]].share > 0.0


def test_the_explained_share_of_a_constant_is_undefined():
    assert np.isnan(response._share(np.zeros(4), np.ones(4)))
    assert response._share(np.array([3.0, 4.0]), np.array([0.0, 1.0])) == pytest.approx(1.0 - 1.0 / 25.0)


def test_the_task_of_an_identification_follows_from_the_logged_signals(monkeypatch, scenario):
    kept = []

    def identified(records, flown, task, share, own):
        kept.append((flown, task, share, own))
        raise StopIteration

    monkeypatch.setattr(response, "_identified", identified)

    def asked(function, *records, base=scenario, **options):
        with pytest.raises(StopIteration):
            function(records, base, **options)
        return kept.pop()

    flown, task, share, own = asked(response.identify_from_poses, record())
    assert task.names == response._candidates(scenario)
    assert share == pytest.approx(1.0 / 3.0)
    assert own is flown
    assert flown.vehicle.rotor_time_constant_down is None
    assert asked(response.identify_from_poses, record(), held_out_share=0.1)[2] == 0.1
    _, task, share, _ = asked(response.identify_attitude_response, record())
    assert {output.signal for output in task.outputs} == {"attitude"}
    assert set(task.names) == {
        name for name in response._candidates(scenario) if name.startswith(("autopilot.", MISALIGNED)) or name == DELAY
    }
    assert share == pytest.approx(1.0 / 3.0)
    speeds = load_scenario("laboratory:low_wind")
    _, task, _, _ = asked(response.identify_from_poses, record(), base=speeds)
    assert task.names == response._rigid_candidates(speeds)
    # A log of throttles gives the vehicle throttle motors.
    throttled = record(motor_command=np.full((1000, 4), 0.5))
    assert asked(response.identify_from_poses, throttled, base=speeds)[0].vehicle.motors.kind == "throttle"
    # Without attitudes and body rates, the vehicle is taken to be level.
    flown, task, _, own = asked(response.identify_from_poses, record(attitude=None, body_rates=None), base=speeds)
    assert task.names[0] == "motors.curve[2]"
    assert flown.laboratory.autopilot.kind == "response"
    assert own.laboratory.autopilot.kind == "none"


def test_too_few_windows_are_refused(scenario):
    with pytest.raises(InputError, match="there are 4 stretches of 3 s to be fitted, too few: it takes 5"):
        response.identify_from_poses([record(13.0)], scenario, held_out_share=0.0)


@pytest.mark.parametrize("windows", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_deviations_of_numbers_that_vary_from_stretch_to_stretch_are_those_of_the_mean(windows):
    """Numbers that are held keep theirs, and nothing is known of how they vary."""
    random = np.random.default_rng(7)
    root = random.normal(size=(windows, 2, 2))
    information = 50.0 * (np.eye(2) + 0.1 * root @ root.swapaxes(1, 2))
    # The first number is another one in each tenth of the flight.
    own = 3.0 * np.repeat(random.normal(size=10), -(-windows // 10))[:windows]
    scores = random.normal(size=(windows, 2)) * 7.0 - information[:, :, 0] * own[:, None]
    parts = Evidence(("a", "c"), np.zeros(2), np.ones(2), information, scores - scores.mean(axis=0), 30.0)
    variance = np.array([[4.0, 0.5, 0.1], [0.5, 9.0, 0.2], [0.1, 0.2, 1.0]]) * 1e-3
    freedom, free = np.array([20.0, 21.0, 22.0]), np.array([0, 2])
    wider, degrees, found = response._of_stretches(variance, freedom, parts, free)
    if windows < 20:
        assert found is None
        np.testing.assert_array_equal(wider, variance)
        np.testing.assert_array_equal(degrees, freedom)
        return
    among = np.ix_(free, free)
    varied = variation_of(parts)
    mean = of_the_mean(Uncertainty(variance[among], freedom[free], variance[among]), parts, varied)
    assert mean.covariance[0, 0] > 2.0 * variance[0, 0]
    np.testing.assert_allclose(wider[among], mean.covariance)
    assert wider[1, 1] == variance[1, 1]
    np.testing.assert_allclose(
        wider[0, 1] / np.sqrt(wider[0, 0] * wider[1, 1]), variance[0, 1] / np.sqrt(variance[0, 0] * variance[1, 1])
    )
    np.testing.assert_array_equal(degrees, [mean.degrees_of_freedom[0], 21.0, mean.degrees_of_freedom[1]])
    np.testing.assert_array_equal(found.covariance[among], varied.covariance)
    assert np.isnan(found.covariance[1, 1])


def test_what_is_left_changes_with_a_number_while_initial_states_follow(scenario):
    """The vehicle itself made the flight. Its initial states are fitted again with a number that differs a little."""
    logged = record(8.0)
    loop = OpenLoop(scenario, logged, delay=float(delay_of(scenario)))
    flown = loop.fly(Starts(np.array([0]), len(logged.time) - 1), np.zeros((1, 1, 12)))[:, 0, 0]
    logged = replace(logged, position=flown[:, :3], attitude=flown[:, 3:6])
    windows = response._cut([logged], scenario, 0.3, 1.0)
    names = ("body_drag.linear[0]", "autopilot.natural_frequency[1]")
    model = response._Model.of(scenario, response._outputs(windows.records, True), names)
    parameters = np.array([model.believed[name] for name in names])

    def left(values):
        return response._refitted(model, windows, names, SimpleNamespace(parameters=values))

    own = left(parameters)
    assert own.residuals.shape == (len(windows.starts), 6, 51)
    assert own.slopes.shape == (*own.residuals.shape, 2)
    for i, name in enumerate(names):
        step = 1e-2 * model.scales[name] * np.eye(2)[i]
        change = (left(parameters + step).residuals - left(parameters - step).residuals) / (2.0 * step[i])
        size = np.abs(change).max()
        assert size > 0.0
        np.testing.assert_allclose(own.slopes[..., i], change, atol=0.05 * size)


@pytest.fixture
def fits(monkeypatch):
    """Replace fits by known results: the drag is negative, and the damping is not identified."""
    kept = SimpleNamespace(calls=[])
    names = ("body_drag.linear[0]", DELAY, "rotor_time_constant", "autopilot.damping[0]")
    scales = np.array([0.8, 1.5, 0.04, 0.5])
    problem = Problem(None, scales, None, np.array([0.3, 1.0, 0.05, 0.7]), 4.0 * scales, np.full(4, -np.inf))
    first = SimpleNamespace(parameters=np.array([-0.5, 1.4, 0.06, 0.9]), states="states")
    variance = np.diag(np.square([0.1, 0.2, 0.004, 0.26]))

    def fit(held, start, states, **options):
        kept.calls.append((held, start, states))
        return SimpleNamespace(parameters=np.array([1e-9, 1.6, 0.07, 0.7]), states="again")

    def told(model, windows, sought, not_seen):
        kept.seen, kept.sought = windows, sought
        not_seen["autopilot.damping[1]"] = "the command of pitch does not vary"
        return names, first, problem, [Noise(0.1 * i, 0.0) for i in range(6)]

    everything = Evidence(names, first.parameters, scales, np.ones((3, 4, 4)), np.ones((3, 4)), 9.0)
    monkeypatch.setattr(response, "fit", fit)
    monkeypatch.setattr(response, "_told", told)
    monkeypatch.setattr(response, "uncertainty", lambda *_: Uncertainty(variance, np.full(4, 12.0), variance))
    monkeypatch.setattr(response, "_evidence", lambda model, windows, *_: everything)
    monkeypatch.setattr(
        response, "_of_stretches", lambda variance, freedom, parts, free: (4.0 * variance, freedom, None)
    )
    monkeypatch.setattr(response, "_refitted", lambda *_: "left")
    monkeypatch.setattr(response, "_explained", lambda *_: {name: Explained(0.4, "roll") for name in names})
    monkeypatch.setattr(response, "_series", lambda *_: ("series",))
    monkeypatch.setattr(response, "hold_out", lambda parts: {"of": parts.names})
    kept.scales, kept.first = scales, first
    return kept


def test_what_is_not_told_or_below_zero_is_held_and_the_rest_is_fitted_with_it(fits, scenario):
    found = response.identify_from_poses([record(40.0)], scenario, held_out_share=0.3)
    assert not fits.seen.unseen.any()
    assert fits.sought == response._candidates(scenario)
    ((held, start, states),) = fits.calls
    # Drag at zero, and the damping as it was believed.
    fixed = np.array([True, False, False, True])
    target = np.array([0.0, 1.0, 0.05, 0.7])
    np.testing.assert_array_equal(held.believed, target)
    np.testing.assert_allclose(held.beliefs, np.where(fixed, 1e-6 * fits.scales, 4.0 * fits.scales))
    np.testing.assert_array_equal(start, [0.0, 1.4, 0.06, 0.7])
    assert states == "states"
    estimates = found.estimates
    assert estimates.names == ("body_drag.linear[0]", DELAY, "rotor_time_constant")
    np.testing.assert_array_equal(estimates.values, [0.0, 1.6, 0.07])
    np.testing.assert_allclose(estimates.deviations, [0.2, 0.4, 0.008])
    assert {*estimates.not_seen} == {"autopilot.damping[0]", "autopilot.damping[1]"}
    assert "would be 0.26, where it may well be off by 0.5" in estimates.not_seen["autopilot.damping[0]"]
    assert {*estimates.explained} == {*estimates.names}
    assert found.held_out == {"of": (DELAY, "rotor_time_constant")}


@pytest.mark.parametrize(("ticks", "is_zero"), [(-0.3, False), (-0.5, True)])
def test_a_delay_is_held_at_zero_if_it_is_below_by_more_than_two_standard_deviations(fits, scenario, ticks, is_zero):
    """The standard deviation of the delay is 0.2 ticks. Drag, of 0.1 N s/m, must not be below zero at all."""
    fits.first.parameters[:2] = -0.1, ticks
    found = response.identify_from_poses([record(40.0)], scenario, held_out_share=0.3)
    ((held, start, _),) = fits.calls
    assert (held.beliefs[1] < 1e-3 * fits.scales[1]) == is_zero
    assert start[:2].tolist() == [0.0, 0.0 if is_zero else ticks]
    assert any(remark.startswith(f"{DELAY} came out at") for remark in found.remarks) == is_zero


def test_an_identification_has_the_delay_in_seconds_the_noise_and_what_was_held_at_zero(fits, scenario):
    found = response.identify_from_poses([record(40.0)], scenario, held_out_share=0.3)
    period = scenario.laboratory.command_link.period
    delay = Spread(float(delay_of(scenario, 1.6)), pytest.approx(0.4 * period), "s", 12.0)
    assert found.delay == delay
    assert found.further["white noise of pitch"].value == pytest.approx(0.4)
    assert found.further["white noise of pitch"].unit == "rad"
    assert len(found.further) == 6
    assert found.outputs == ("series",)
    assert found.vehicle.vehicle.rotor_time_constant == 0.07
    assert found.vehicle.vehicle.body_drag.linear[0] == 0.0
    (held,) = (remark for remark in found.remarks if "is held at zero" in remark)
    # With the interval that it would have had.
    reach = t.ppf(0.975, 12.0) * 0.1
    assert held.startswith(f"body_drag.linear[0] came out at -0.50 ± {reach:.2f} ")
