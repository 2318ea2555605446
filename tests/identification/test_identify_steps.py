"""Tests of the steps before and after the fit: choice of windows and parameters, and results."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.identification import flight_differences
from drake_quad.identification import identify as module
from drake_quad.identification.delays import frame_age, total_delay
from drake_quad.identification.evidence import quantile
from drake_quad.identification.fit import PredictionFit
from drake_quad.identification.model import DELAY
from drake_quad.identification.parameters import Parameter, parameter_names
from drake_quad.identification.prediction_errors import Gains, Output, PredictionNoise, Predictor
from drake_quad.identification.prepared_logs import MAX_DELAY, PreparedLogs, prepare, window_blocks
from drake_quad.identification.result import ForecastOutput
from drake_quad.identification.results.estimates import ExplainedVariance
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period
POSE = [Output(signal, column) for signal in ("position", "attitude") for column in range(3)]
NOISE_NAMES = [f"laboratory.motion_capture.{signal}_noise" for signal in ("position", "attitude")]
EMPTY_GAINS = Gains(*(np.empty(0) for _ in Gains._fields))


def log_of(seconds, *, period=PERIOD, **signals):
    count = round(seconds / period)
    random = np.random.default_rng(1)
    values = {
        "position": random.normal(size=(count, 3)),
        "attitude": 0.01 * random.normal(size=(count, 3)),
        "rotor_speed_command": np.full((count, 4), 200.0),
    }
    return FlightRecord("log", period * np.arange(count), **{**values, **signals})


@pytest.fixture(autouse=True)
def no_disturbance(monkeypatch):
    """Replace the estimate of the disturbance by zero, since the predictors of these tests have no filter."""
    monkeypatch.setattr(
        flight_differences, "estimated_force", lambda each, _: np.zeros((2, len(each.windows), each.sizes.length))
    )


@pytest.fixture(scope="module")
def rotors():
    return load_scenario("laboratory:low_wind")


def noise_of(outputs, *, force=1e-3):
    usual = {"position": 1e-3, "attitude": 4e-3}
    disturbance = np.array([force, force, force, 1.0, 1.0, 1.0])
    return PredictionNoise(np.array([usual[output.signal] for output in outputs]), disturbance, np.full(6, 0.2))


def fitted_to(predictor: Predictor, parameters: list[Parameter], *, seed=0, noise=None, strength=1e3) -> PredictionFit:
    """Return a fit at the prior means with random errors and derivatives.

    The derivatives are inversely proportional to the prior standard deviations of the parameters.
    """
    random = np.random.default_rng(seed)
    size = len(predictor.outputs) * predictor.sizes.length
    scales = np.array([parameter.scale for parameter in parameters])
    jacobian = strength * random.normal(size=(len(predictor.windows), size, len(parameters))) / np.sqrt(size) / scales
    return PredictionFit(
        np.array([parameter.start for parameter in parameters]),
        noise_of(predictor.outputs) if noise is None else noise,
        EMPTY_GAINS,
        jacobian,
        random.normal(size=(len(predictor.windows), size)),
        scales**-2.0,
    )


def forecast_of(explained, outputs=POSE):
    nothing = np.zeros((2, 4))
    names = [f"{output.signal} {output.column}" for output in outputs]
    return tuple(ForecastOutput(name, "m", nothing, nothing, nothing, explained, 0.1) for name in names)


class Recorded:
    """Stub of search and forecast that records its calls. The search returns the prior means."""

    def __init__(self, monkeypatch, *, noise=None):
        self.fits, self.forecasts, self.noise = [], [], noise
        monkeypatch.setattr(module, "fit", self.fit)
        monkeypatch.setattr(module, "forecast", self.forecast)
        monkeypatch.setattr(module, "noise_covariance", lambda predictor, fitted: 1e-4 * np.eye(18))

    def fit(self, predictor, parameters, noise, start=None):
        result = fitted_to(predictor, parameters, noise=self.noise, seed=len(self.fits))
        result = result._replace(values=result.values * (1.0 + 0.01 * (1 + len(self.fits))))
        self.fits.append(
            SimpleNamespace(predictor=predictor, names=parameter_names(parameters), noise=noise, start=start)
        )
        self.fits[-1].found = result
        return result

    def forecast(self, predictor, values, noise):
        self.forecasts.append((predictor, values, noise))
        return forecast_of(0.8)


def times_of(predictor, log, *, settle=True):
    """Return the first and last time of each window, with or without the settling time of the filter."""
    before = predictor.sizes.settle if settle else 0
    return [(log.time[start - before], log.time[start + predictor.sizes.length]) for _, start in predictor.windows]


def test_the_forecast_is_evaluated_on_flight_that_was_not_fitted(monkeypatch, rotors):
    """The last third of the flight is held out. The final fit uses all of the flight, and starts from the first fit."""
    log, calls = log_of(24.0), Recorded(monkeypatch)
    result = module.identify([log], rotors)
    training, final = calls.fits
    ((forecast, values, noise),) = calls.forecasts
    limit = 16.0 - 1e-9
    assert max(end for _, end in times_of(training.predictor, log)) < limit
    assert min(begin for begin, _ in times_of(forecast, log)) >= limit
    assert max(end for _, end in times_of(final.predictor, log)) > 22.0
    assert forecast.sizes.length == 50
    assert training.start is None
    np.testing.assert_array_equal(values, training.found.values)
    assert noise is training.found.noise
    np.testing.assert_array_equal(final.start, training.found.values)
    assert final.noise is training.found.noise
    assert training.names == final.names
    # The vehicle of the first fit is kept for comparisons on the held-out flight.
    assert result.training_vehicle.vehicle.thrust_factor == pytest.approx(1.01 * rotors.vehicle.thrust_factor)
    assert result.vehicle.vehicle.thrust_factor == pytest.approx(1.02 * rotors.vehicle.thrust_factor)
    assert len(result.outputs) == 6


def test_the_parameters_are_fitted_once_if_no_flight_is_held_out(monkeypatch, rotors):
    log, calls = log_of(24.0), Recorded(monkeypatch)
    result = module.identify([log], rotors, held_out_fraction=0.0)
    (only,) = calls.fits
    assert (calls.forecasts, result.outputs, result.training_vehicle) == ([], (), None)
    assert only.start is None
    assert dict(result.estimates.explained_variance) == {}


def test_parameters_hidden_by_a_disturbance_are_fixed_in_a_further_fit(monkeypatch, rotors):
    """The vehicle hardly moves, so its drag is smaller than the disturbing force."""
    noise = noise_of(POSE, force=0.3)
    calls = Recorded(monkeypatch, noise=noise)
    log = log_of(24.0, position=np.zeros((2400, 3)))
    result = module.identify([log], rotors, held_out_fraction=0.0)
    first, second = calls.fits
    assert "linear_drag" in first.names
    assert second.names == [name for name in first.names if name != "linear_drag"]
    indices = [first.names.index(name) for name in second.names]
    np.testing.assert_array_equal(second.start, first.found.values[indices])
    assert second.noise is first.found.noise
    assert second.predictor.model.names == tuple(second.names)
    assert "linear_drag" not in result.estimates.names
    assert result.estimates.not_identified["linear_drag"].startswith("the disturbing force, such as wind, is")


@pytest.mark.parametrize(("period", "latency", "start"), [(0.01, 0, 0.01), (0.05, 0, 0.025), (0.01, 12, 0.075)])
def test_the_initial_delay_is_the_age_of_a_camera_frame_clipped_to_limits(monkeypatch, period, latency, start):
    """The initial delay is at least half a sample and at most half of the largest delay."""
    overrides = [f"laboratory.motion_capture.latency_frames={latency}", "laboratory.motion_capture.period=0.01"]
    scenario = load_scenario("laboratory:low_wind", overrides)
    assert frame_age(scenario) == pytest.approx(0.01 * (1 + latency))
    given = []

    class StopError(Exception):
        pass

    def parameters_of(*_, delay, max_delay, **__):
        given.extend([delay, max_delay])
        raise StopError

    monkeypatch.setattr(module, "parameters_of", parameters_of)
    with pytest.raises(StopError):
        module.identify([log_of(20.0, period=period)], scenario)
    assert given == pytest.approx([start, MAX_DELAY])


def test_an_identified_vehicle_has_the_estimated_values_and_the_estimated_total_delay(rotors):
    logs, _ = prepare([log_of(5.0)], rotors)
    for delay, expected in ((frame_age(rotors) + 0.013, frame_age(rotors) + 0.013), (0.0, frame_age(rotors))):
        actual = module._vehicle(logs, rotors, {"thrust_factor": 5e-5, DELAY: delay})
        assert actual.vehicle.thrust_factor == 5e-5
        assert total_delay(actual) == pytest.approx(expected)
    without_delay = module._vehicle(logs, rotors, {"thrust_factor": 5e-5})
    assert total_delay(without_delay) == total_delay(rotors)
    assert without_delay.vehicle.motors == rotors.vehicle.motors
    throttles = log_of(
        5.0, rotor_speed_command=None, motor_command=np.full((500, 4), 0.5), battery_voltage=np.full(500, 11.4)
    )
    logs, scenario = prepare([throttles], rotors)
    assert module._vehicle(logs, scenario, {"motors.curve[1]": 2.0}).vehicle.motors.voltage == pytest.approx(11.4)


def result_of(rotors, monkeypatch, *, change=lambda fitted, names: fitted, forecast_outputs=(), reasons=None):
    """Return the identification that follows from an artificial fit, and this fit, its predictor and its parameters."""
    monkeypatch.setattr(module, "noise_covariance", lambda predictor, fitted: np.diag(np.linspace(1e-4, 2e-4, 18)))
    logs, scenario = prepare([log_of(30.0)], rotors)
    parameters = module.parameters_of(
        logs.scenario, logs.signals, has_motor_throttles=False, delay=0.02, max_delay=MAX_DELAY
    )
    names = parameter_names(parameters)
    predictor = logs.predictor(names, logs.flying)
    fitted = change(fitted_to(predictor, parameters), names)

    def fit_of_others(predictor, parameters, noise, start):
        return fitted_to(predictor, parameters)._replace(values=start, noise=noise)

    monkeypatch.setattr(module, "fit", fit_of_others)
    training = module._Training(logs.flying, parameters, fitted, forecast_outputs) if forecast_outputs else None
    result = module._result(logs, scenario, predictor, parameters, fitted, training, reasons or {})
    return result, fitted, predictor, parameters


def test_estimates_have_the_uncertainty_of_the_fit_and_exclude_the_delay(monkeypatch, rotors):
    actual, fitted, predictor, parameters = result_of(rotors, monkeypatch)
    names, estimates = parameter_names(parameters), actual.estimates
    indices = [i for i, name in enumerate(names) if name != DELAY]
    assert estimates.names == (*(names[i] for i in indices), *NOISE_NAMES)
    np.testing.assert_array_equal(estimates.values[: len(indices)], fitted.values[indices])
    np.testing.assert_array_equal(estimates.values[len(indices) :], [1e-3, 4e-3])
    expected = fitted.uncertainty(window_blocks(predictor))
    number = len(indices)
    np.testing.assert_allclose(estimates.covariance[:number, :number], expected.covariance[np.ix_(indices, indices)])
    np.testing.assert_allclose(estimates.degrees_of_freedom[:number], expected.degrees_of_freedom[indices])
    # The fit gives the variance of the logarithm of each noise level, which is the relative variance of the noise
    # level. The number of measurements is the number of degrees of freedom.
    variances = np.linspace(1e-4, 2e-4, 18)[[0, 3]] * np.square([1e-3, 4e-3])
    np.testing.assert_allclose(estimates.covariance[number:, number:], np.diag(variances))
    np.testing.assert_array_equal(estimates.covariance[number:, :number], 0.0)
    np.testing.assert_array_equal(estimates.degrees_of_freedom[number:], fitted.errors.size)
    delay_index = names.index(DELAY)
    assert actual.delay.value == fitted.values[delay_index]
    assert actual.delay.deviation == pytest.approx(np.sqrt(expected.covariance[delay_index, delay_index]))
    assert actual.delay.degrees_of_freedom == expected.degrees_of_freedom[delay_index]
    assert actual.delay.half_width == pytest.approx(
        quantile(expected.degrees_of_freedom[delay_index]) * np.sqrt(expected.covariance[delay_index, delay_index])
    )
    # Thirty seconds give 23 windows of 1.25 s. A tenth of them is held out at a time.
    assert actual.remarks[0] == "23 windows of 1.2 s in the air were fitted"
    assert set(actual.held_out) == {*names}
    assert estimates.variation.covariance.shape == (number + 2, number + 2)
    assert np.isnan(np.diag(estimates.variation.covariance)[number:]).all()
    assert estimates.sources_of(0)[0].method == "prediction errors of attitude and position"
    assert estimates.sources_of(0)[0].log == "log"
    assert actual.vehicle.vehicle.inertia[1] == pytest.approx(rotors.vehicle.inertia[1])
    assert total_delay(actual.vehicle) == pytest.approx(max(0.02, frame_age(rotors)))


@pytest.mark.parametrize("weak", ["inertia[2]", DELAY])
def test_a_parameter_without_influence_is_not_identified(monkeypatch, rotors, weak):
    """The parameter keeps its initial value.

    An unidentified delay causes a remark, and leaves the command link unchanged.
    """

    def without(fitted, names):
        jacobian = fitted.jacobian.copy()
        jacobian[:, :, names.index(weak)] = 0.0
        values = fitted.values.copy()
        values[names.index(DELAY)] = 0.1
        values[names.index("inertia[2]")] *= 3.0
        return fitted._replace(jacobian=jacobian, values=values)

    result, *_ = result_of(rotors, monkeypatch, change=without)
    assert weak not in result.held_out
    if weak == DELAY:
        assert result.delay is None
        assert any(remark.startswith("the delay is not identified: its 95 % interval is") for remark in result.remarks)
        assert DELAY not in result.estimates.not_identified
        assert total_delay(result.vehicle) == total_delay(rotors)
    else:
        assert result.estimates.not_identified[weak].startswith("its 95 % interval is")
        assert weak not in result.estimates.names
        assert result.fitted[weak] == pytest.approx(3.0 * rotors.vehicle.inertia[2])
        assert result.vehicle.vehicle.inertia == rotors.vehicle.inertia
        assert total_delay(result.vehicle) == pytest.approx(0.1)


def test_logs_that_determine_nothing_but_a_delay_are_refused(monkeypatch, rotors):
    def only_informative(informative):
        def change(fitted, names):
            jacobian = np.zeros_like(fitted.jacobian)
            for name in informative:
                jacobian[:, :, names.index(name)] = fitted.jacobian[:, :, names.index(name)]
            return fitted._replace(jacobian=jacobian)

        return change

    for informative in ((), (DELAY,)):
        with pytest.raises(InputError, match="^cannot identify the vehicle: the logs determine none of its parameters"):
            result_of(rotors, monkeypatch, change=only_informative(informative))
    result, *_ = result_of(rotors, monkeypatch, change=only_informative(("thrust_factor",)))
    assert set(result.estimates.identified) == {"thrust_factor", *NOISE_NAMES}


def test_all_reasons_why_parameters_are_not_identified_are_reported(monkeypatch, rotors):
    def with_small_noise(fitted, names):
        measured = fitted.noise.measured.copy()
        measured[:3] = 1.5e-5
        return fitted._replace(noise=fitted.noise._replace(measured=measured))

    result, *_ = result_of(
        rotors, monkeypatch, change=with_small_noise, reasons={"linear_drag": "wind"}, forecast_outputs=forecast_of(0.7)
    )
    reasons = result.estimates.not_identified
    assert reasons["linear_drag"] == "wind"
    assert reasons[NOISE_NAMES[0]] == "it is below 2e-05 m or rad"
    assert reasons["mass"].startswith("motion determines forces only relative to the mass")
    assert NOISE_NAMES[0] not in result.estimates.names
    assert result.estimates.value(NOISE_NAMES[1]) == 4e-3
    assert result.estimates.explained_variance["thrust_factor"].fraction == 0.7
    assert len(result.outputs) == 6


def test_parameters_that_missing_commands_distort_are_not_identified(monkeypatch, rotors):
    monkeypatch.setattr(module, "distorted_parameters", lambda *_: {"inertia[0]": "commands are missing"})
    result, *_ = result_of(rotors, monkeypatch, forecast_outputs=forecast_of(0.7))
    assert result.estimates.not_identified["inertia[0]"] == "commands are missing"
    for vehicle in (result.vehicle, result.training_vehicle):
        assert vehicle.vehicle.inertia[0] == rotors.vehicle.inertia[0]


def test_a_parameter_is_listed_with_the_explained_variance_of_its_most_sensitive_output():
    """The most sensitive output has the largest sum of squared derivatives over all windows."""
    outputs = [Output("position", 0), Output("position", 2), Output("attitude", 1)]
    parameters = [Parameter(name, 1.0, 1.0) for name in ("mass", DELAY, "inertia[1]", "linear_drag")]
    jacobian = np.full((3, 5, 3, 4), 0.1)
    jacobian[:, :, 1, 0] = -2.0
    jacobian[1, :, 2, 2] = 7.0
    jacobian[:, :, 0, 2] = 3.0
    jacobian[:, :, 0, 3] = 1.0
    fitted = SimpleNamespace(jacobian=jacobian.reshape(3, 15, 4))
    none = np.zeros(1)
    fractions = {"x": np.nan, "z": 0.5, "pitch": 0.9}
    forecast_outputs = [
        ForecastOutput(name, "m", none, none, none, fraction, 0.1) for name, fraction in fractions.items()
    ]
    result = module._explained(parameters, fitted, SimpleNamespace(outputs=outputs), forecast_outputs)
    # No variance is listed for `linear_drag`, whose output x does not vary, or for the delay, which is no parameter of
    # the vehicle.
    assert result == {"mass": ExplainedVariance(0.5, "z"), "inertia[1]": ExplainedVariance(0.9, "pitch")}


def test_remarks_name_effects_that_a_log_cannot_distinguish():
    predictor = SimpleNamespace(windows=range(8), duration=10.0)
    names = ["rotor_time_constant", "rotor_time_constant_down", "rotor_aerodynamics.climb"]
    fitted = SimpleNamespace(values=np.array([0.04, 0.06, 0.1]))
    windows, lag, climb = module._remarks(predictor, fitted, names)
    assert windows == "8 windows of 1.2 s in the air were fitted"
    assert lag == "small motions lag by the mean of the two time constants, 50 ms"
    assert climb.startswith("climb includes the linear drag along z of the body")
    assert module._remarks(predictor, fitted, names[:1]) == (windows,)


def test_logs_without_poses_give_no_estimates_of_pose_noise(rotors):
    outputs = [Output("body_rates", column) for column in range(3)]
    noise = PredictionNoise(np.full(3, 0.02), np.ones(6), np.ones(6))
    logs = SimpleNamespace(records=[log_of(3.0)], scenario=rotors, loop_period=None)
    names, values, covariance, weak = module._noise_estimates(
        logs, SimpleNamespace(outputs=outputs), SimpleNamespace(noise=noise)
    )
    assert (names, len(values), covariance.shape, weak) == ([], 0, (0, 0), {})


def test_the_error_of_an_estimated_pose_is_no_noise_of_motion_capture(rotors):
    laboratory = load_scenario("indoor_flow").laboratory
    logs = SimpleNamespace(records=[log_of(3.0)], scenario=rotors.model_copy(update={"laboratory": laboratory}))
    names, _, _, reasons = module._noise_estimates(logs, SimpleNamespace(outputs=POSE), SimpleNamespace())
    assert names == []
    assert set(reasons) == {*NOISE_NAMES}


def test_missing_commands_and_attitude_noise_are_indistinguishable(monkeypatch, rotors):
    fast_commands = 200.0 + np.random.default_rng(3).normal(size=(400, 4))
    predictor = SimpleNamespace(outputs=POSE)
    monkeypatch.setattr(module, "noise_covariance", lambda *_: np.eye(6))

    def estimates(**commands):
        logs = SimpleNamespace(records=[log_of(4.0, **commands)], scenario=rotors, loop_period=None)
        fitted = SimpleNamespace(noise=noise_of(POSE))
        names, values, covariance, unidentified = module._noise_estimates(logs, predictor, fitted)
        assert len(values) == len(covariance) == len(names)
        return names, unidentified

    assert estimates() == (NOISE_NAMES, {})
    names, unidentified = estimates(rotor_speed_command=fast_commands)
    assert names == NOISE_NAMES[:1]
    assert "lack commands between its samples (log)" in unidentified[NOISE_NAMES[1]]


def test_undetermined_parameters_have_a_reason():
    rotors = load_scenario("laboratory:low_wind", ["vehicle.quadratic_drag=0.01"])
    assert set(module.undetermined_parameters(rotors, ["inertia[2]", "linear_drag"])) == {
        "mass",
        "drag_factor",
        "quadratic_drag",
    }
    assert set(module.undetermined_parameters(rotors, [])) == {"mass"}
    without_quadratic_drag = load_scenario("laboratory:low_wind", ["vehicle.quadratic_drag=0"])
    assert set(module.undetermined_parameters(without_quadratic_drag, ["linear_drag"])) == {"mass"}
    assert set(module.undetermined_parameters(load_scenario("neural_fly:still"), [])) == {"mass", "thrust_factor"}


def test_remarks_on_clocks_and_on_fast_commands_are_listed_after_remarks_on_the_fit(monkeypatch, rotors):
    result = module.Identification(None, rotors, (), remarks=("first",))
    monkeypatch.setattr(module, "_identified", lambda *_: result)
    monkeypatch.setattr(module, "synchronise", lambda records: module.SynchronisedRecords(records, False, ["clocks"]))
    monkeypatch.setattr(module, "fast_command_remarks", lambda records: ["fast"])
    assert module.identify([log_of(1.0)], rotors).remarks == ("first", "clocks", "fast")


def test_prepared_logs_list_their_signals():
    logs = PreparedLogs([log_of(3.0)], load_scenario("hover"), POSE, [np.full(300, True)], False)
    assert (logs.signals, logs.has_poses, logs.voltage) == ({"position", "attitude"}, True, None)
    assert not logs._replace(outputs=[Output("body_rates", 0)]).has_poses
    assert logs._replace(outputs=[Output("velocity", 0)]).has_poses
