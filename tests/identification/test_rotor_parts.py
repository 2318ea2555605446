"""The steps of an identification by prediction errors: outputs, candidates, limits and remarks."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm, t

from drake_quad import InputError, load_scenario
from drake_quad.identification import rotor_identification as rotors
from drake_quad.identification.fitting.evidence import Evidence, Uncertainty
from drake_quad.identification.fitting.flown_model import DELAY
from drake_quad.identification.fitting.forecast import Forecast
from drake_quad.identification.fitting.predictor import FORCE, Output, PredictionNoise
from drake_quad.identification.fitting.windows import Cut
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Explained
from drake_quad.identification.results.vehicle_numbers import with_throttles


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("laboratory:low_wind")


def record(count=400, period=0.01, **signals):
    time = period * np.arange(count)
    return FlightRecord(
        "log", time, **{name: np.full((count, width), value) for name, (width, value) in signals.items()}
    )


IMU = {"body_rates": (3, 0.1), "specific_force": (3, 1.0)}
POSES = {"position": (3, 0.1), "attitude": (3, 0.0)}


def test_outputs_are_measured_and_not_derived_signals():
    """Velocities are left out. Body rates are left out if there are attitudes, unless there is an accelerometer."""

    def outputs(*logs):
        return [output.signal for output in rotors._outputs([record(**log) for log in logs])][::3]

    assert outputs(POSES) == ["position", "attitude"]
    assert outputs(POSES | IMU) == ["position", "attitude", "body_rates", FORCE]
    assert outputs(IMU) == ["body_rates", FORCE]
    assert outputs(POSES | {"body_rates": (3, 0.0), "velocity": (3, 0.0)}) == ["position", "attitude"]
    assert outputs({"position": (3, 0.0), "body_rates": (3, 0.0)}) == ["position", "body_rates"]
    # A signal that one of the logs lacks is no output.
    assert outputs(POSES | IMU, IMU) == ["body_rates", FORCE]
    assert [output.column for output in rotors._outputs([record(**POSES)])] == [0, 1, 2, 0, 1, 2]
    for log in ({"position": (3, 0.0)}, {"velocity": (3, 0.0)}):
        with pytest.raises(InputError, match="needs body_rates and specific_force, or position and attitude"):
            outputs(log)


def test_commands_of_thrust_and_torque_go_through_the_believed_allocation(scenario):
    """The allocated rotor speeds give the commanded thrust again."""
    wrench = np.array([[6.0, 0.02, -0.01, 0.005]] * 5)
    log = FlightRecord("log", 0.01 * np.arange(5), thrust_command=wrench[:, 0], torque_command=wrench[:, 1:])
    speeds = rotors._commanded(log, scenario, "rotor_speed_command").rotor_speed_command
    nominal = scenario.nominal
    np.testing.assert_allclose(nominal.thrust_factor * np.sum(speeds**2, axis=1), 6.0)
    assert speeds.shape == (5, 4)
    throttled = load_scenario("neural_fly:still")
    shares = rotors._commanded(log, throttled, "motor_command").motor_command
    k_0, k_1, k_2 = throttled.nominal.motors.curve
    np.testing.assert_allclose(np.sum(k_0 + k_1 * shares + k_2 * shares**2, axis=1), 6.0)
    own = record(5, rotor_speed_command=(4, 200.0))
    assert rotors._commanded(own, scenario, "rotor_speed_command") is own
    with pytest.raises(InputError, match="lacks motor_command, or thrust_command with torque_command; its motors"):
        rotors._commanded(own, scenario, "motor_command")
    with pytest.raises(InputError, match=r"lacks rotor_speed_command, or thrust_command with torque_command$"):
        rotors._commanded(record(5, **POSES), scenario, "rotor_speed_command")


def test_fast_logs_are_resampled_to_at_most_eight_milliseconds():
    for period, step in ((0.02, 1), (0.01, 1), (0.004, 2), (0.002, 4), (0.001, 8)):
        again = rotors._resampled(record(400, period, **POSES))
        assert again.period == pytest.approx(step * period)


def names_of(vehicle, *signals):
    return {each.name: each for each in rotors._sought(vehicle, {*signals})}


def test_candidates_are_parameters_of_the_vehicle_that_the_outputs_determine(scenario):
    vehicle = scenario.vehicle
    candidates = names_of(vehicle, "position", "attitude")
    assert {"thrust_factor", "rotor_time_constant", "inertia[2]", "centre_of_mass[1]", "linear_drag", DELAY} <= {
        *candidates
    }
    assert "rotor_inertia" not in candidates or vehicle.reaction_torque
    assert ("rotor_time_constant_down" in candidates) == (vehicle.rotor_time_constant_down is not None)
    # Positions alone do not determine inertia, and attitudes alone do not determine drag.
    assert not any("inertia" in name or "centre" in name for name in names_of(vehicle, "position"))
    assert "linear_drag" not in names_of(vehicle, "attitude")
    still = vehicle.model_copy(update={"linear_drag": 0.0})
    assert "linear_drag" not in names_of(still, "position", "attitude")
    inertia = candidates["inertia[1]"]
    value = vehicle.inertia[1]
    assert (inertia.scale, inertia.least, inertia.most) == pytest.approx((value, 0.02 * value, 50.0 * value))
    drag = candidates["linear_drag"]
    assert (drag.scale, drag.least, drag.most) == pytest.approx((vehicle.linear_drag, 0.0, 1e3 * vehicle.linear_drag))
    delay = candidates[DELAY]
    assert (delay.scale, delay.least, delay.most) == pytest.approx((0.01, -0.045, 0.045))


@pytest.mark.parametrize(
    ("layout", "arm"),
    [
        ("{kind: x}", 0.17),
        ("{kind: plus, length: 0.3, width: 0.5}", 0.2),
        (
            "{kind: rotors, rotors: [{position: [0.1, 0, 0], turns: clockwise}, {position: [0, -0.3, 0], turns:"
            " anticlockwise}, {position: [-0.1, 0, 0], turns: clockwise}, {position: [0, 0.3, 0], turns:"
            " anticlockwise}]}",
            0.2,
        ),
    ],
)
def test_the_centre_of_mass_is_sought_within_the_mean_arm_of_any_layout(layout, arm):
    vehicle = load_scenario("hover", [f"nominal.layout={layout}"]).vehicle
    centre = names_of(vehicle, "attitude")["centre_of_mass[0]"]
    assert (centre.scale, centre.least, centre.most) == pytest.approx((0.2 * arm, -arm, arm))


def test_effects_of_the_vehicle_are_candidates_if_the_outputs_determine_them():
    overrides = [
        "vehicle.body_drag={linear: [0.3, 0.0, 0.2], centre_of_pressure: [0, 0, 0.01]}",
        "vehicle.rotor_aerodynamics={climb: 0.4}",
        "vehicle.linear_drag=0.0",
        "vehicle.rotor_time_constant_down=0.08",
        "vehicle.reaction_torque=true",
    ]
    vehicle = with_throttles(load_scenario("laboratory:low_wind", overrides)).vehicle
    vehicle = vehicle.model_copy(update={"motors": vehicle.motors.model_copy(update={"curve": (0.5, -1.0, 9.0)})})
    candidates = names_of(vehicle, "position", "attitude", FORCE)
    assert {f"motors.curve[{i}]" for i in range(3)} <= {*candidates}
    assert "thrust_factor" not in candidates
    assert {name for name in candidates if name.startswith("body_drag.linear")} == {
        "body_drag.linear[0]",
        "body_drag.linear[2]",
    }
    assert {
        "body_drag.centre_of_pressure[2]",
        "rotor_aerodynamics.climb",
        "rotor_inertia",
        "rotor_time_constant_down",
    } <= {*candidates}
    curve = candidates["motors.curve[1]"]
    assert (curve.scale, curve.least, curve.most) == pytest.approx((8.5, -85.0, 85.0))
    assert (candidates["body_drag.linear[2]"].scale, candidates["body_drag.linear[2]"].most) == pytest.approx(
        (0.2, 200.0)
    )
    climb = candidates["rotor_aerodynamics.climb"]
    assert (climb.scale, climb.least, climb.most) == pytest.approx((0.4, -400.0, 400.0))
    # A turning accelerometer determines the centre of pressure, and positions determine drag.
    assert "body_drag.centre_of_pressure[2]" not in names_of(vehicle, "position", "attitude")
    assert not any(name.startswith("body_drag.linear") for name in names_of(vehicle, "body_rates", FORCE))
    assert "body_drag.centre_of_pressure[2]" in names_of(vehicle, "body_rates", FORCE)


def problem(scenario, signals=POSES, *, count=3000, period=0.01):
    log = record(count, period, rotor_speed_command=(4, 200.0), **signals)
    return rotors._Problem(scenario.vehicle, "rotor_speed_command", [log], rotors._outputs([log]))


@pytest.mark.parametrize(
    ("signals", "count", "horizon", "length"),
    [
        (POSES, 6000, False, 2.5),
        # Windows of a shorter flight are a sixteenth of it, which keeps the number of blocks, and at least a second.
        (POSES, 3200, False, 2.0),
        (POSES, 1200, False, 1.0),
        (POSES, 6000, True, 0.5),
        (IMU, 6000, False, 1.0),
        (IMU, 6000, True, 0.1),
    ],
)
def test_the_length_of_windows_follows_from_outputs_and_flight_time(scenario, signals, count, horizon, length):
    own = problem(scenario, signals, count=count)
    flying = [np.ones(count, dtype=bool)]
    predictor = own.predictor(
        rotors._sought(scenario.vehicle, {o.signal for o in own.outputs}), flying, horizon=horizon
    )
    settle = 0.5 if signals is POSES else 0.4
    assert predictor.sizes == Cut(round(length / 0.01), round(settle / 0.01), 40)
    assert own.kind == ("world" if signals is POSES else "body")
    assert len(rotors._blocks(predictor)) == len(predictor.windows)


def test_too_few_windows_are_refused(scenario):
    own = problem(scenario, count=300)
    with pytest.raises(
        InputError, match="the logs have 2 stretches of 1.5 s in the air without a gap; .* takes 4 at least"
    ):
        own.predictor(rotors._sought(scenario.vehicle, {"position", "attitude"}), [np.ones(300, dtype=bool)])


def test_a_search_starts_from_the_vehicle_and_half_a_sample_of_delay(scenario):
    own = problem(scenario)
    sought = rotors._sought(scenario.vehicle, {"position", "attitude"})
    values = dict(zip([each.name for each in sought], own.values(sought), strict=True))
    assert values[DELAY] == pytest.approx(0.005)
    assert values["inertia[1]"] == scenario.vehicle.inertia[1]
    assert values["thrust_factor"] == scenario.vehicle.thrust_factor
    choice = rotors._choice(sought, own.values(sought))
    np.testing.assert_array_equal(choice.scale, [each.scale for each in sought])
    np.testing.assert_array_equal(choice.least, [each.least for each in sought])
    np.testing.assert_array_equal(choice.most, [each.most for each in sought])


def test_blocks_last_some_seconds_and_are_enough_for_an_interval():
    def blocks(windows, seconds):
        made = SimpleNamespace(windows=range(windows), sizes=Cut(round(seconds / 0.01), 0, 0), period=0.01)
        return rotors._blocks(made)

    # 100 s make blocks of 4 s, 20 s make 15 blocks, and eight windows make eight blocks.
    assert len(np.unique(blocks(100, 1.0))) == 25
    assert len(np.unique(blocks(20, 1.0))) == 15
    assert blocks(8, 1.0).tolist() == list(range(8))
    assert (np.diff(blocks(100, 1.0)) >= 0).all()


def sought(*names, scale=1.0, least=-9.0, most=9.0):
    return [rotors._Sought(name, scale, least, most) for name in names]


def test_numbers_at_a_limit_or_with_a_wide_interval_or_from_one_stretch_are_not_identified():
    """The interval of a positive number is too wide if it is wider than the number itself."""
    given = [
        *sought("low", "high"),
        *sought("wide"),
        *sought("positive", least=0.01),
        *sought("lone"),
        *sought("well"),
        *sought(DELAY),
    ]
    values = np.array([-8.9999, 8.9999, 1.0, 0.3, 1.0, 1.0, 8.9999])
    freedom = np.array([20.0, 20.0, 20.0, 20.0, 1.5, 20.0, 20.0])
    reach = np.array([0.1, 0.1, 1.01, 0.31, 0.9, 0.99, 0.1])
    deviations = reach / t.ppf(0.975, freedom)
    uncertainty = Uncertainty(np.diag(deviations**2), freedom, np.eye(7))
    found = rotors._wide(given, SimpleNamespace(parameters=values), uncertainty)
    assert set(found) == {"low", "high", "wide", "positive", "lone"}
    assert found["low"] == "the best fit is at the limit of what is looked for, -9"
    assert found["wide"].startswith("its interval would be 1.0 ± 1.")
    assert found["lone"] == "hardly more than one stretch of the flights tells it, as 1"


def test_drag_below_the_disturbance_is_not_identified():
    """The disturbance is the mass times the noise of a force; drag is that at the flown speed, taken over 0.1 s."""
    time = 0.02 * np.arange(200)
    place = np.stack([0.5 * np.sin(2.0 * time), 0.1 * np.sin(2.0 * time), 0.0 * time], axis=1)[:, :, None]
    outputs = [Output("attitude", 0), *(Output("position", i) for i in range(3))]
    measured = np.concatenate([np.zeros((200, 1, 1)), place], axis=1)
    predictor = SimpleNamespace(outputs=outputs, measured=measured, counted=np.ones(200, dtype=bool), period=0.02)
    speed = np.sqrt(np.mean(((place[5:] - place[:-5]) / 0.1) ** 2, axis=(0, 2)))
    vehicle = SimpleNamespace(mass=2.0)
    given = sought("linear_drag", "body_drag.linear[0]", "body_drag.linear[1]", "inertia[0]")
    for factor, expected in (
        (0.99, {"linear_drag", "body_drag.linear[1]"}),
        (1.01, {"linear_drag", "body_drag.linear[0]", "body_drag.linear[1]"}),
    ):
        force = factor * np.array([0.3 * speed[0], 0.3 * speed[0], 0.0]) / 2.0
        fitted = SimpleNamespace(
            parameters=np.full(4, 0.3),
            noise=PredictionNoise(np.ones(4), np.concatenate([force, np.ones(3)]), np.ones(6)),
        )
        found = rotors._swamped(vehicle, predictor, given, fitted)
        assert set(found) == expected
    assert found["body_drag.linear[0]"].startswith(
        f"what disturbs, as wind does, is {2.0 * force[0]:.2g} N, and drag itself {0.3 * speed[0]:.2g} N"
    )
    without = SimpleNamespace(outputs=outputs[:1], measured=measured[:, :1], counted=predictor.counted, period=0.02)
    assert rotors._swamped(vehicle, without, given, fitted) == {}


def test_a_number_is_explained_by_its_most_informative_output():
    forecast = Forecast(
        ("position x", "roll", "body rate q", "position z"),
        np.empty(0),
        np.empty(0),
        np.empty(0),
        np.array([0.1, 0.2, 0.3, 0.4]),
    )
    names = ["inertia[0]", "inertia[1]", "centre_of_mass[0]", "linear_drag", "thrust_factor", "inertia[2]"]
    assert rotors._explained(names, forecast) == {
        "inertia[0]": Explained(0.2, "roll"),
        "inertia[1]": Explained(0.3, "body rate q"),
        "centre_of_mass[0]": Explained(0.3, "body rate q"),
        "linear_drag": Explained(0.1, "position x"),
        "thrust_factor": Explained(0.4, "position z"),
    }


def test_numbers_that_no_flight_determines_are_reported_with_a_reason(scenario):
    vehicle = scenario.vehicle.model_copy(update={"quadratic_drag": 0.02})
    why = rotors._not_seen(vehicle, ["linear_drag", "thrust_factor"], {"position", "attitude"})
    assert {"mass", "drag_factor", "inertia[0]", "rotor_time_constant", "quadratic_drag"} <= {*why}
    assert "looks like linear drag" in why["quadratic_drag"]
    assert "hardly depend on it" in why["inertia[0]"]
    assert "linear_drag" not in why
    assert DELAY not in why
    assert (
        "quadratic_drag" not in rotors._not_seen(scenario.vehicle, ["linear_drag"], {"position"})
        or scenario.vehicle.quadratic_drag > 0.0
    )
    dragged = load_scenario("laboratory:low_wind", ["vehicle.body_drag={linear: [0.1, 0.1, 0.1]}"])
    throttled = with_throttles(dragged).vehicle
    why = rotors._not_seen(throttled, [], {"body_rates", FORCE})
    assert "show their thrust" in why["thrust_factor"]
    assert all("as a product only" in why[f"body_drag.linear[{i}]"] for i in range(3))
    assert "as a product only" not in rotors._not_seen(throttled, [], {"position", FORCE}).get(
        "body_drag.linear[0]", ""
    )


def test_remarks_give_the_flight_time_and_the_mean_of_two_lags():
    predictor = SimpleNamespace(
        windows=range(12), sizes=Cut(250, 50, 40), inputs=SimpleNamespace(period=0.005), split=2, period=0.01
    )
    fitted = SimpleNamespace(rounds=3, parameters=np.array([1.0, 0.04, 0.06]))
    names = ["thrust_factor", "rotor_time_constant", "rotor_time_constant_down"]
    assert rotors._remarks(predictor, fitted, names) == (
        "30.0 s in the air in 12 windows, 3 rounds",
        "the lag of small motions is between its two: 50 ms in the mean",
    )
    assert len(rotors._remarks(predictor, fitted, names[:2])) == 1


def test_a_number_is_identified_if_all_blocks_but_the_best_determine_it(monkeypatch):
    """The information at the start must give 1.96 standard deviations below the scale of the number."""
    random = np.random.default_rng(6)
    windows, samples = 20, 30
    sizes = np.array([1.0, 0.02, 1.0, 1.0])
    slopes = random.normal(size=(windows, samples, 4)) * sizes
    # A single block determines the third number well.
    slopes[1:, :, 2] *= 1e-3
    given = [
        rotors._Sought(name, scale, -9.0, 9.0) for name, scale in (("a", 1.0), ("b", 1.0), ("c", 1.0), ("d", 0.02))
    ]
    monkeypatch.setattr(rotors, "whitened", lambda *_: (None, slopes.copy(), None, None))
    monkeypatch.setattr(rotors, "_blocks", lambda _: np.arange(windows))
    predictor = SimpleNamespace(gains=lambda *_: None)
    kept = [each.name for each in rotors._told(predictor, given, np.zeros(4), None)]
    expected = []
    for i, name in enumerate("abcd"):
        own = np.sum((slopes[:, :, i] * given[i].scale) ** 2, axis=1)
        if norm.ppf(0.975) / np.sqrt(own.sum() - own.max()) < 1.0:
            expected.append(name)
    assert kept == expected
    assert "a" in kept
    assert not {"b", "c"} & {*kept}


def test_a_delay_has_an_interval():
    delay = rotors.Delay(0.02, 0.003, 9.0)
    assert delay.interval == pytest.approx((0.02 - 0.003 * t.ppf(0.975, 9), 0.02 + 0.003 * t.ppf(0.975, 9)))


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_what_is_held_out_is_forecast_and_the_rest_is_fitted_before_all_is(monkeypatch, scenario, share):
    """The last samples in the air are held out, and the fit to the rest is where the fit to all samples begins."""
    used, fits = [], []
    log = record(2000, rotor_speed_command=(4, 200.0), **POSES)
    noise = rotors._first_noise(rotors._outputs([log]))

    def predictor(problem, sought, flying, *, horizon=False):
        used.append((flying[0], horizon, [each.name for each in sought]))
        return f"predictor {len(used)}"

    def fit(predictor, choice, begun):
        fits.append((predictor, choice.start, begun))
        covariance = Uncertainty(np.eye(1), np.ones(1), np.eye(1))
        return SimpleNamespace(
            parameters=choice.start + 1.0, noise=f"noise of {predictor}", covariance=lambda blocks: covariance
        )

    monkeypatch.setattr(rotors._Problem, "predictor", predictor)
    monkeypatch.setattr(rotors, "_told", lambda predictor, sought, start, noise: sought[:2])
    monkeypatch.setattr(rotors, "fit", fit)
    monkeypatch.setattr(rotors, "forecast", lambda *arguments: arguments)
    monkeypatch.setattr(rotors, "_blocks", lambda predictor: None)
    monkeypatch.setattr(rotors, "_identified", lambda *arguments: arguments)
    *_, shown = rotors.identify([log], scenario, share=share)
    flying = rotors.airborne(log)
    late = np.cumsum(flying) > (1.0 - share) * flying.sum()
    every, spared = flying, flying & late
    if share == 0.0:
        assert shown is None
        expected = [(every, False), (every, False)]
        ((predictor_of_all, start, begun),) = fits
    else:
        expected = [(every & ~spared, False), (every & ~spared, False), (spared, True), (every, False)]
        (rest, first, begun_first), (predictor_of_all, start, begun) = fits
        assert rest == "predictor 2"
        np.testing.assert_array_equal(begun_first.measured, noise.measured)
        np.testing.assert_array_equal(start, first + 1.0)
        assert begun == "noise of predictor 2"
        told, parameters, its_noise = shown
        assert (told, its_noise) == ("predictor 3", "noise of predictor 2")
        np.testing.assert_array_equal(parameters, first + 1.0)
    assert predictor_of_all == f"predictor {len(used)}"
    assert len(used) == len(expected)
    for (own, horizon, _), (parts, ahead) in zip(used, expected, strict=True):
        np.testing.assert_array_equal(own, parts)
        assert horizon == ahead
    # All that may be told is looked at first, and then only what is.
    assert [len(names) == 2 for *_, names in used] == [False, *[True] * (len(used) - 1)]


def test_limits_of_a_thrust_curve_are_around_zero_whatever_its_sign(scenario):
    vehicle = with_throttles(scenario).vehicle
    for sign in (1.0, -1.0):
        curve = (0.1 * sign, 0.2 * sign, 0.5 * sign)
        own = vehicle.model_copy(update={"motors": vehicle.motors.model_copy(update={"curve": curve})})
        for i in range(3):
            limits = names_of(own, "position", "attitude")[f"motors.curve[{i}]"]
            assert (limits.scale, limits.least, limits.most) == pytest.approx((0.8, -8.0, 8.0))


COVARIANCE = 1e-2 * np.array([[4.0, 0.1, 0.2, 0.3], [0.1, 5.0, 0.4, 0.5], [0.2, 0.4, 6.0, 0.6], [0.3, 0.5, 0.6, 7.0]])
# Covariance of the logarithms of the noise: six outputs, and twelve numbers of the disturbance.
APART = np.diag(np.arange(1.0, 19.0)) + 0.5


@pytest.fixture
def fit(monkeypatch):
    """A fit of four numbers, the delay among them, of which wind swamps one; as arguments of what makes a result."""
    given = sought("thrust_factor", "inertia[0]", DELAY, "inertia[1]")
    outputs = [Output(name, column) for name in ("position", "attitude") for column in range(3)]
    uncertainty = Uncertainty(COVARIANCE, np.array([11.0, 12.0, 13.0, 14.0]), np.eye(4))
    noise = PredictionNoise(np.array([2.0, 2.0, 2.0, 3.0, 3.0, 3.0]), np.full(6, 0.3), np.ones(6))
    windows, errors = 8, np.zeros((8, 50))
    evidence = Evidence(("a",), np.zeros(1), np.ones(1), np.ones((8, 1, 1)), np.zeros((8, 1)), 2.0)

    def tell(names, scales, seconds):
        assert (list(names), scales.tolist(), seconds) == ([each.name for each in given], [1.0] * 4, 20.0)
        return evidence

    fitted = SimpleNamespace(
        parameters=np.array([1.0, 2.0, 0.01, 3.0]), noise=noise, errors=errors, rounds=2, evidence=tell
    )
    predictor = SimpleNamespace(
        windows=range(windows),
        sizes=Cut(250, 50, 40),
        inputs=SimpleNamespace(period=0.01),
        split=1,
        period=0.01,
        outputs=outputs,
    )
    monkeypatch.setattr(rotors, "noise_covariance", lambda *_: APART)
    monkeypatch.setattr(rotors, "_swamped", lambda *_: {"inertia[0]": "wind"})
    monkeypatch.setattr(rotors, "_wide", lambda *_: {})
    return predictor, given, fitted, uncertainty


def test_the_result_has_the_identified_parameters_and_the_noise_of_the_cameras(fit, scenario):
    """The delay has its own field, and a parameter that is not identified is left out with the reason."""
    told = Forecast(("roll", "pitch", "position z"), np.empty(0), np.empty(0), np.empty(0), np.array([0.1, 0.2, 0.3]))
    found = rotors._identified([record(**POSES)], scenario.vehicle, *fit, told)
    estimates = found.estimates
    cameras = [f"laboratory.motion_capture.{name}_noise" for name in ("position", "attitude")]
    assert list(estimates.names) == ["thrust_factor", "inertia[1]", *cameras]
    np.testing.assert_array_equal(estimates.values, [1.0, 3.0, 2.0, 3.0])
    np.testing.assert_allclose(estimates.covariance[:2, :2], COVARIANCE[np.ix_([0, 3], [0, 3])])
    np.testing.assert_array_equal(estimates.covariance[:2, 2:], 0.0)
    # The covariance is that of the logarithms, times the noise of both.
    np.testing.assert_allclose(
        estimates.covariance[2:, 2:], [[APART[0, 0] * 4.0, APART[0, 3] * 6.0], [APART[3, 0] * 6.0, APART[3, 3] * 9.0]]
    )
    np.testing.assert_array_equal(estimates.degrees_of_freedom, [11.0, 14.0, 400.0, 400.0])
    assert estimates.explained == {"thrust_factor": Explained(0.3, "position z"), "inertia[1]": Explained(0.2, "pitch")}
    assert estimates.not_seen["inertia[0]"] == "wind"
    assert "weigh it" in estimates.not_seen["mass"]
    assert str(estimates.sources_of(0)[0]) == "prediction errors of attitude and position, log"
    assert estimates.remarks == ("20.0 s in the air in 8 windows, 2 rounds",)
    assert found.delay == rotors.Delay(0.01, pytest.approx(np.sqrt(6e-2)), 13.0)
    _, _, fitted, _ = fit
    assert (found.noise, found.forecast, found.fitted) == (fitted.noise, told, fitted)


def test_without_a_number_that_is_told_there_is_no_result(fit, scenario, monkeypatch):
    monkeypatch.setattr(rotors, "_wide", lambda *_: {"thrust_factor": "wide", "inertia[1]": "flat"})
    with pytest.raises(InputError, match=r"tell no number of the vehicle: inertia\[0\]: wind; thrust_factor: wide; in"):
        rotors._identified([record(**POSES)], scenario.vehicle, *fit, None)


def test_an_accelerometer_has_no_noise_of_cameras(fit, scenario):
    """Without anything that was held out, nothing is explained."""
    predictor, given, fitted, uncertainty = fit
    inertial = SimpleNamespace(**{**vars(predictor), "outputs": [Output(FORCE, column) for column in range(3)]})
    found = rotors._identified([record(**IMU)], scenario.vehicle, inertial, given, fitted, uncertainty, None)
    assert found.estimates.names == ("thrust_factor", "inertia[1]")
    assert found.estimates.explained == {}
    assert str(found.estimates.sources_of(0)[0]) == "prediction errors of specific force, log"


def test_signals_are_named_in_alphabetical_order(fit, scenario):
    predictor, given, fitted, uncertainty = fit
    outputs = [Output(name, column) for name in ("position", "attitude", FORCE, "body_rates") for column in range(3)]
    every = SimpleNamespace(**{**vars(predictor), "outputs": outputs})
    found = rotors._identified([record(**IMU)], scenario.vehicle, every, given, fitted, uncertainty, None)
    source = str(found.estimates.sources_of(0)[0])
    assert source == "prediction errors of attitude and body rates and position and specific force, log"


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_limits_of_the_thrust_in_a_climb_are_around_zero_whatever_its_sign(sign):
    vehicle = load_scenario("laboratory:low_wind", [f"vehicle.rotor_aerodynamics={{climb: {0.4 * sign}}}"]).vehicle
    climb = names_of(vehicle, "position", "attitude")["rotor_aerodynamics.climb"]
    assert (climb.scale, climb.least, climb.most) == pytest.approx((0.4, -400.0, 400.0))
