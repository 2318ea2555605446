"""The choice of an identification method, and the merging of partial identifications."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.identification import identify as module
from drake_quad.identification.forecast import Forecast
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import Identification, Spread
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Estimates, Explained, Source

PERIOD = 0.02


def record(seconds, *names, **signals):
    """Return an airborne log with constant signals."""
    count = round(seconds / PERIOD)
    widths = {"specific_force": 3, "body_rates": 3, "attitude": 3, "position": 3, "residual_force": 3, "velocity": 3}
    values = {name: np.zeros((count, widths[name])) for name in names}
    commands = {"rotor_speed_command": np.full((count, 4), 200.0)} | signals
    return FlightRecord("log", PERIOD * np.arange(count), **values, **commands)


@pytest.fixture(scope="module")
def rotors(root):
    return load_scenario(root / "diagrams" / "laboratory.yaml:low_wind")


@pytest.fixture(scope="module")
def attitudes(root):
    """Return a scenario with an autopilot whose attitude responds as a whole."""
    return load_scenario(root / "diagrams" / "neural_fly.yaml:still")


@pytest.fixture
def chosen(monkeypatch):
    """Return a function that gives the chosen method, its scenario and the held-out share of the flight."""
    calls = []

    def instead(name):
        def call(records, scenario, *_, held_out_share=None, share=None, **__):
            calls.append((name, scenario, held_out_share if share is None else share))
            raise StopIteration

        return call

    monkeypatch.setattr(module, "identify_from_poses", instead("poses"))
    monkeypatch.setattr(module, "identify_attitude_response", instead("attitude and forces"))
    monkeypatch.setattr(module.rotor_identification, "identify", instead("prediction errors"))

    def way(records, scenario, **options):
        with pytest.raises(StopIteration):
            identify(records, scenario, **options)
        return calls.pop()

    return way


INERTIAL = ("specific_force", "body_rates")
POSES = ("position", "attitude")


def test_prediction_errors_are_used_with_an_accelerometer_or_half_a_minute_of_poses(chosen, rotors):
    assert chosen([record(5.0, *INERTIAL)], rotors)[0] == "prediction errors"
    assert chosen([record(31.0, *POSES)], rotors)[0] == "prediction errors"
    assert chosen([record(16.0, *POSES)] * 2, rotors)[0] == "prediction errors"
    assert chosen([record(29.0, *POSES)], rotors)[0] == "poses"
    assert chosen([record(31.0, "position", "velocity")], rotors)[0] == "poses"
    assert chosen([record(31.0, "attitude")], rotors)[0] == "poses"
    # A single log without an accelerometer or a gyroscope rules prediction errors out.
    assert chosen([record(5.0, *INERTIAL), record(5.0, "body_rates")], rotors)[0] == "poses"
    assert chosen([record(5.0, *INERTIAL), record(5.0, "specific_force")], rotors)[0] == "poses"


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [8.0, 31.0], ids=["multiple shooting", "prediction errors"])
def test_a_flight_without_motion_identifies_only_the_thrust(rotors, seconds):
    """No estimate is divided by a variance of zero: a NumPy warning fails the test."""
    vehicle = rotors.vehicle
    speed = np.sqrt(0.25 * vehicle.mass * vehicle.gravity / vehicle.thrust_factor)
    commands = np.full((round(seconds / PERIOD), 4), speed)
    still = record(seconds, *POSES, "body_rates", "velocity", rotor_speed_command=commands)
    found = identify([still], rotors)
    told = dict(zip(found.estimates.names, found.estimates.values, strict=True))
    assert told["thrust_factor"] == pytest.approx(vehicle.thrust_factor, rel=1e-3)
    assert {"inertia[0]", "inertia[1]", "rotor_time_constant"} <= {*found.estimates.not_seen}
    assert np.isfinite(found.estimates.intervals()).all()


def test_forces_are_used_behind_an_autopilot_if_all_logs_have_them(chosen, attitudes):
    whole = ("residual_force", "attitude", "velocity", "position")
    commands = {"attitude_command": np.zeros((500, 3)), "thrust_share": np.full(500, 0.5)}
    with_forces = record(10.0, *whole, wind=np.zeros((500, 3)), **commands)
    without = record(10.0, "attitude", "velocity", "position", **commands)
    assert chosen([with_forces], attitudes)[0] == "attitude and forces"
    assert chosen([with_forces, without], attitudes)[0] == "poses"
    assert chosen([record(40.0, *POSES)], attitudes)[0] == "poses"


def test_a_third_of_the_airborne_time_is_held_out_by_default(chosen, rotors, attitudes):
    assert chosen([record(5.0, *INERTIAL)], rotors)[2] == pytest.approx(1.0 / 3.0)
    assert chosen([record(5.0, *INERTIAL)], rotors, held_out_share=0.2)[2] == 0.2
    assert chosen([record(5.0, *POSES)], attitudes, held_out_share=0.2)[2] == 0.2


def test_a_log_of_throttles_gives_the_vehicle_throttle_motors(chosen, rotors):
    throttles = record(5.0, *INERTIAL, motor_command=np.full((250, 4), 0.5))
    assert chosen([record(5.0, *INERTIAL), throttles], rotors)[1].vehicle.motors.kind == "throttle"
    assert chosen([record(5.0, *INERTIAL)], rotors)[1] is rotors


def test_without_a_log_there_is_nothing_to_identify(rotors):
    with pytest.raises(InputError, match="there is no log to identify a vehicle from"):
        identify([], rotors)


def estimates(names, deviations, *, freedom=9.0, **options):
    values = np.arange(1.0, 1.0 + len(names))
    return Estimates(names, values, np.diag(np.square(deviations)), freedom, Source("m", names[0]), **options)


def test_identifications_of_attitude_and_forces_are_merged(monkeypatch, attitudes):
    """The forces take into account the deviation of the attitude's delay, and both parts are uncorrelated."""
    turning = estimates(
        ("autopilot.damping[0]",),
        [0.1],
        explained={"autopilot.damping[0]": Explained("roll", 0.4)},
        variation=Variation(np.array([[0.04]]), 9.0, 5.0),
    )
    forces = estimates(
        ("body_drag.linear[0]", "body_drag.linear[1]"), [0.2, 0.3], freedom=5.0, not_seen={"mass": "why"}
    )
    given = {}

    def identify_forces(records, vehicle, *, delay_deviation, held_out_share):
        given.update(vehicle=vehicle, deviation=delay_deviation, share=held_out_share)
        return Identification(forces, vehicle, ("force",), None, {"a": Spread(1.0, 0.1, "N")}, ("one",))

    delay = Spread(0.03, 0.004, "s")
    response = Identification(
        turning,
        attitudes,
        ("angle",),
        delay,
        {"b": Spread(2.0, 0.2, "rad")},
        ("other",),
        {"autopilot.damping[0]": "held"},
    )
    monkeypatch.setattr(module, "tells_forces", lambda _: True)
    monkeypatch.setattr(module, "identify_attitude_response", lambda *_, **__: response)
    monkeypatch.setattr(module, "identify_forces", identify_forces)
    found = identify([record(5.0)], attitudes, held_out_share=0.25)
    assert given == {"vehicle": attitudes, "deviation": 0.004, "share": 0.25}
    assert found.estimates.names == (*turning.names, *forces.names)
    np.testing.assert_array_equal(found.estimates.values, [1.0, 1.0, 2.0])
    np.testing.assert_allclose(found.estimates.covariance, np.diag([0.01, 0.04, 0.09]))
    np.testing.assert_array_equal(found.estimates.degrees_of_freedom, [9.0, 5.0, 5.0])
    assert found.estimates.explained == {"autopilot.damping[0]": Explained("roll", 0.4)}
    assert found.estimates.not_seen == {"mass": "why"}
    np.testing.assert_array_equal(np.diag(found.estimates.variation.covariance), [0.04, np.nan, np.nan])
    assert found.outputs == ("force", "angle")
    assert found.delay is delay
    assert set(found.further) == {"a", "b"}
    assert found.remarks == ("other", "one")
    assert found.held_out == {"autopilot.damping[0]": "held"}
    assert found.vehicle.vehicle.body_drag.linear[:2] == pytest.approx((1.0, 2.0))
    assert found.vehicle.laboratory.autopilot.damping[0] == pytest.approx(1.0)


def test_windows_of_a_forecast_are_listed_one_after_another():
    """The outputs have the units of their signals, and all of them are held out."""
    random = np.random.default_rng(1)
    time = PERIOD * np.arange(5)
    measured, predicted = random.normal(size=(2, 5, 3, 4))
    names = ("position x", "roll", "specific force along z")
    forecast = Forecast(names, time, measured, predicted, np.array([0.9, 0.8, 0.7]))
    outputs = module._series(forecast, np.array([1e-3, 2e-3, 3e-3]), "a log")
    assert [output.name for output in outputs] == list(names)
    assert [output.unit for output in outputs] == ["m", "rad", "m/s²"]
    for i, output in enumerate(outputs):
        np.testing.assert_allclose(output.time, [time + 0.08 * window for window in range(4)])
        np.testing.assert_array_equal(output.measured, measured[:, i].T)
        np.testing.assert_array_equal(output.predicted, predicted[:, i].T)
        np.testing.assert_allclose(output.residual, (measured - predicted)[:, i].T)
        assert output.held_out.all()
        assert output.log.tolist() == ["a log"] * 4
        assert (output.share, output.deviation) == (forecast.explained[i], 1e-3 * (i + 1))
        assert np.isnan(output.share_fitted)
    (rate,) = module._series(forecast._replace(names=("body rate q",)), np.ones(1), "a log")
    assert rate.unit == "rad/s"


def test_a_delay_is_added_to_the_link_of_the_vehicle(monkeypatch, rotors):
    """The delay is in ticks of the link, beyond the delay that the laboratory has with zero ticks."""
    found = estimates(("thrust_factor",), [1e-7])
    result = SimpleNamespace(
        estimates=found,
        delay=SimpleNamespace(value=0.053, deviation=0.002, degrees_of_freedom=7.0),
        forecast=None,
        noise=None,
        evidence=None,
    )
    monkeypatch.setattr(module, "hold_out", lambda _: {"thrust_factor": 1, "delay": 2, "other": 3})
    own = module._translated(result, rotors, [])
    assert own.delay == Spread(0.053, 0.002, "s", 7.0)
    assert float(module.delay_of(own.vehicle)) == pytest.approx(0.053)
    assert own.held_out == {"thrust_factor": 1, module.rotor_identification.DELAY: 2}
    assert own.outputs == ()
    result.delay = None
    own = module._translated(result, rotors, [])
    assert own.delay is None
    assert own.vehicle.laboratory == rotors.laboratory


def test_equations_without_a_solution_are_refused_in_one_sentence(monkeypatch):
    """Such equations arise if a gyroscope now and then shows 10⁸ rad/s."""

    def fail(*_, **__):
        np.linalg.cholesky(np.zeros((2, 2)))

    monkeypatch.setattr(module, "identify_from_poses", fail)
    nothing = FlightRecord("log", np.array([0.0, 0.1]))
    with pytest.raises(
        InputError, match=r"^the logs cannot be fitted \(Matrix is not positive definite\): their values are not"
    ):
        identify([nothing], load_scenario("hover"))
