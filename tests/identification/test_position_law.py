"""Tests of position laws that are identified from logs, by comparison with the laws that were flown."""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy
from ruamel.yaml import YAML

from drake_quad import load_scenario, load_undesigned, read_log
from drake_quad.command_line.identify_controller import write_controller
from drake_quad.control.pid_cascade.acceleration import _limited_force
from drake_quad.control.pid_cascade.parameters import (
    AccelerationParameters,
    CascadeParameters,
    CascadeRules,
    PidLoopGains,
)
from drake_quad.errors import InputError
from drake_quad.flight.simulation import simulate_samples
from drake_quad.geometry.axes import Vector
from drake_quad.identification.model import STATE_ROWS
from drake_quad.identification.position_law.commands import FORMS, at_limit, in_heading, law_output, unproduced_output
from drake_quad.identification.position_law.control import control_layer
from drake_quad.identification.position_law.law import AxisLaw, PositionLaw, identify_position_law
from drake_quad.identification.position_law.pieces import prepared_pieces
from drake_quad.identification.position_law.regression import Shape, _integration_rule_bias, excited_terms, search_fit
from drake_quad.identification.result import EstimatedValue
from drake_quad.identification.synthetic_flights import random_waypoint_route
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord

PERIOD = 0.02  # s, sampling period
SAMPLES = 750  # samples of a log
GRAVITY = 9.81  # m/s²
K_P = 4.0  # 1/s², gain of the position error
K_V = 3.0  # 1/s, gain of the velocity error
K_I = 0.8  # 1/s³, integral gain
DELAY = 0.06  # s, delay of the command
FILTER = 0.1  # s, time constant of the velocity filter
RNG = np.random.default_rng(4)


@pytest.fixture(scope="module")
def vehicle():
    return load_undesigned("vehicles/crazyflie")


def waves(time, amplitude, slow):
    """Return sums (n, 3) of sines with incommensurable frequencies, and their first two derivatives."""
    rates = slow * np.outer([1.0, 1.31, 0.83], [1.0, 1.73, 2.9])
    phases = rates * time[:, None, None] + np.arange(9.0).reshape(3, 3)
    parts = amplitude * np.array([1.0, 0.5, 0.2])
    return (
        (parts * np.sin(phases)).sum(axis=2),
        (parts * rates * np.cos(phases)).sum(axis=2),
        -(parts * rates**2 * np.sin(phases)).sum(axis=2),
    )


def attitude_along(force, yaw):
    """Return the roll, pitch and yaw that align the body's z axis with the forces (n, 3)."""
    axis = force / np.linalg.norm(force, axis=1, keepdims=True)
    forward = np.cos(yaw) * axis[:, 0] + np.sin(yaw) * axis[:, 1]
    left = np.cos(yaw) * axis[:, 1] - np.sin(yaw) * axis[:, 0]
    return np.column_stack([-np.arcsin(left), np.arctan2(forward, axis[:, 2]), yaw])


def flown(vehicle, *, delay=DELAY, filter_time=FILTER, limit=np.inf, noise=0.02):
    """Return the log of a PID controller with a filtered velocity; white noise in m/s² is added to the command."""
    time = PERIOD * np.arange(SAMPLES)

    def measured(time_points):
        reference, error = waves(time_points, 0.6, 0.9), waves(time_points + 5.0, 0.15, 2.6)
        return reference, [one - other for one, other in zip(reference, error, strict=True)]

    late = time - delay
    (p_r, v_r, a_r), (position, velocity, _) = measured(late)
    if filter_time > 0.0:
        fine = np.arange(-3.0, time[-1] + PERIOD, 2e-3)
        fraction = 2e-3 / filter_time
        filtered = scipy.signal.lfilter([fraction], [1.0, fraction - 1.0], measured(fine)[1][1], axis=0)
        velocity = np.column_stack([np.interp(late, fine, column) for column in filtered.T])
    error = np.clip(p_r - position, -limit, limit)
    integral = scipy.integrate.cumulative_trapezoid(error, time, axis=0, initial=0.0)
    output = K_P * error + K_V * (v_r - velocity) + K_I * integral + a_r + noise * RNG.normal(size=error.shape)
    force = output + np.array([0.0, 0.0, GRAVITY])
    yaw = 0.3 * np.sin(0.4 * time)
    (reference, reference_velocity, _), (position, velocity, _) = measured(time)
    return FlightRecord(
        "made",
        time,
        position=position,
        velocity=velocity,
        attitude=attitude_along(force, yaw + 0.02),
        attitude_command=attitude_along(force, yaw),
        thrust_command=vehicle.nominal.mass * np.linalg.norm(force, axis=1),
        reference_position=reference,
        reference_velocity=reference_velocity,
    )


def assert_in_interval(spread, true):
    assert spread.value == pytest.approx(true, abs=spread.half_width)


@pytest.mark.long
def test_gains_filter_and_delay_of_the_log_are_recovered(vehicle):
    law = identify_position_law([flown(vehicle)], vehicle)
    assert law.form == "acceleration"
    assert {axis for each in law.axes for axis in each.axes} == {"x", "y", "z"}
    for axis in law.axes:
        for name, true in (("position", K_P), ("velocity", K_V), ("integral", K_I), ("delay", DELAY)):
            assert_in_interval(axis.gains[name], true)
        assert axis.gains["filter_time"].value == pytest.approx(FILTER, abs=0.02)
        assert axis.gains["reference_acceleration"].value == pytest.approx(1.0, abs=0.1)
        assert axis.gains["velocity"].half_width < 0.3


@pytest.mark.long
def test_the_limit_of_the_position_error_and_the_fraction_of_limited_samples_are_found(vehicle):
    record = flown(vehicle, filter_time=0.0, limit=0.12)
    law = identify_position_law([record], vehicle)
    beyond = np.abs(record.reference_position - record.position) > 0.12
    for axis in law.axes:
        assert axis.gains["error_limit"].value == pytest.approx(0.12, abs=0.01)
        assert axis.at_error_limit == pytest.approx(
            beyond[:, ["xyz".index(each) for each in axis.axes]].mean(), abs=0.03
        )
        assert_in_interval(axis.gains["position"], K_P)


def test_the_output_of_a_law_is_recovered_from_the_commands_in_each_form(vehicle):
    output = np.array([[1.0, -2.0, 0.5], [-0.3, 0.8, -1.5]])
    yaw, measured_yaw = np.array([0.4, -0.9]), np.array([0.5, -0.7])
    force = output + np.array([0.0, 0.0, GRAVITY])
    size = np.linalg.norm(force, axis=1)
    measured = np.column_stack([[0.1, -0.2], [0.05, 0.3], measured_yaw])
    along = attitude_along(force, yaw)
    aligned = np.sum(force * rotation_matrices(measured).apply([0.0, 0.0, 1.0]), axis=1)
    level = np.column_stack([output[:, :2], np.full(2, GRAVITY)])
    tilted = attitude_along(level, yaw)
    upright = (output[:, 2] + GRAVITY) / np.cos(tilted[:, 0]) / np.cos(tilted[:, 1])
    forward = np.cos(measured_yaw) * output[:, 0] + np.sin(measured_yaw) * output[:, 1]
    left = np.cos(measured_yaw) * output[:, 1] - np.sin(measured_yaw) * output[:, 0]
    commands = {
        "acceleration": (along, size),
        "heading": (np.column_stack([attitude_along(force, measured_yaw)[:, :2], yaw]), size),
        "decoupled": (tilted, upright),
        "projected": (along, aligned),
        "tilt": (np.column_stack([-left, forward, yaw]), output[:, 2] + GRAVITY),
    }
    assert commands.keys() == set(FORMS)
    for form, (command, thrust) in commands.items():
        record = FlightRecord("made", np.arange(2.0), attitude=measured, attitude_command=command)
        expected = in_heading(record, output) if form == "tilt" else output
        np.testing.assert_allclose(law_output(record, thrust, form, GRAVITY), expected, atol=1e-12, err_msg=form)


def test_the_axes_along_the_heading_are_forward_left_and_up():
    record = FlightRecord("made", np.arange(2.0), attitude=np.array([[0.3, 0.2, 0.0], [0.0, 0.0, 0.5 * np.pi]]))
    turned = in_heading(record, np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]))
    np.testing.assert_allclose(turned, [[1.0, 2.0, 3.0], [2.0, -1.0, 3.0]], atol=1e-12)


@pytest.mark.parametrize("climb", [-4.0, -0.5, 0.0, 2.0])
def test_the_unproduced_output_is_the_output_that_the_anti_windup_of_px4_subtracts(climb):
    """PX4 integrates the velocity error minus 2 / k_v times the output that the thrust does not produce."""
    gain, mass = 3.0, 0.7
    limits = AccelerationParameters(1.0, 12.0, 3.0, 3.0, 10.0, 0.0, 100.0, 0.0)
    gains = PidLoopGains(Vector(gain, gain, 4.0))
    numbers = CascadeParameters(gains, gains, 0.0, mass, GRAVITY, limits)
    output, error = np.array([[1.5, -0.8, climb]]), np.array([0.2, -0.1, 0.3])
    _, integrated = _limited_force(Vector(*output[0]), Vector(*error), numbers, CascadeRules())
    taken = gain / 2.0 * (error - np.array(integrated))
    np.testing.assert_allclose(unproduced_output(output, "decoupled", GRAVITY)[0], taken, atol=1e-12)
    assert not unproduced_output(output, "acceleration", GRAVITY).any()


def regression_of(record, vehicle, form, axis):
    """Return the least-squares gains by name, and R², without a delay."""
    pieces = prepared_pieces(record, vehicle, [])[0][form]
    fit = search_fit(pieces, (axis,), excited_terms(pieces, (axis,)), [Shape()], ())
    return dict(zip(fit.terms, fit.gains.tolist(), strict=True)), fit.explained_variance


def test_errors_are_integrated_along_the_heading_in_the_form_tilt(vehicle):
    """The vehicle yaws by more than a full turn, so integrals along the heading differ from integrals along x and y."""
    time = PERIOD * np.arange(SAMPLES)
    reference, error = waves(time, 0.6, 0.9), waves(time + 5.0, 0.15, 2.6)
    position, velocity = reference[0] - error[0], reference[1] - error[1]
    heading = FlightRecord("made", time, attitude=np.column_stack([0.0 * time, 0.0 * time, 0.5 * time]))
    along, moving = in_heading(heading, error[0]), in_heading(heading, velocity)
    sums = scipy.integrate.cumulative_simpson(np.stack([along, moving]), x=time, axis=1, initial=0.0)
    output = 0.4 * along - 0.3 * moving + 0.08 * sums[0] - 0.06 * sums[1]
    record = replace(
        heading,
        position=position,
        velocity=velocity,
        attitude_command=np.column_stack([-output[:, 1], output[:, 0], 0.0 * time]),
        thrust_command=vehicle.nominal.mass * (GRAVITY + output[:, 2]),
        reference_position=reference[0],
        reference_velocity=reference[1],
    )
    for axis in range(3):
        gains, explained = regression_of(record, vehicle, "tilt", axis)
        assert explained > 0.99999
        for name, true in (("position", 0.4), ("velocity", 0.3), ("integral", 0.08), ("displacement", 0.06)):
            assert gains[name] == pytest.approx(true, rel=0.01), name


def test_the_integral_of_px4_is_found_while_its_anti_windup_is_active(vehicle):
    """PX4 does not increase the tilt during a downward acceleration, so the vehicle accelerates less than commanded."""
    time = PERIOD * np.arange(SAMPLES)
    (reference, v_r, a_r), error = waves(time, 0.6, 1.6), waves(time + 5.0, 0.15, 2.6)
    output, integral = np.zeros((SAMPLES, 3)), np.zeros(3)
    for i in range(SAMPLES):
        velocity_error = 1.2 * error[0][i] + error[1][i]
        output[i] = 3.0 * velocity_error + a_r[i] + integral
        missing = output[i] * [1.0, 1.0, 0.0] * max(0.0, -output[i, 2] / GRAVITY)
        integral = integral + PERIOD * 0.6 * (velocity_error - 2.0 / 3.0 * missing)
    attitude = attitude_along(np.column_stack([output[:, :2], np.full(SAMPLES, GRAVITY)]), 0.0 * time)
    record = FlightRecord(
        "made",
        time,
        position=reference - error[0],
        velocity=v_r - error[1],
        attitude_command=attitude,
        thrust_command=vehicle.nominal.mass * (GRAVITY + output[:, 2]) / np.cos(attitude[:, :2]).prod(axis=1),
        reference_position=reference,
        reference_velocity=v_r,
        reference_acceleration=a_r,
    )
    for axis in range(3):
        gains, explained = regression_of(record, vehicle, "decoupled", axis)
        assert explained > 0.99999
        assert gains["integral"] == pytest.approx(0.72, rel=0.03)  # flown as a sum, fitted as an integral


def test_rounded_signals_do_not_bias_the_delay(vehicle):
    """Signals are rounded to 1 cm and 1 cm/s. The delay along Z would be wrong by 4.5 ms if they were not smoothed."""
    record = flown(vehicle, delay=0.0, filter_time=0.0, noise=0.0)
    rounded = replace(
        record,
        **{name: np.round(getattr(record, name), 2) for name in ("position", "velocity", "reference_velocity")},
        attitude_command=np.round(record.attitude_command, 3),
    )
    pieces = prepared_pieces(rounded, vehicle, [])[0]["acceleration"]
    for axis in range(3):
        fit = search_fit(pieces, (axis,), excited_terms(pieces, (axis,)), [Shape()], ("delay",))
        assert abs(fit.shape.delay) < 0.1 * PERIOD


def test_the_integration_rule_changes_gains_by_half_a_period_times_the_integral_gain():
    """The cascade has the gains 2 and 3, and integrates the velocity error with the gain 0.9."""
    cascade = {"position": 6.9, "velocity": 3.0, "reference_velocity": 3.0, "integral": 1.8}
    bounds = _integration_rule_bias(cascade, 0.02)
    assert bounds == pytest.approx({"position": 0.018, "velocity": 0.009, "reference_velocity": 0.009})
    # No cascade has the gains of this PID controller, which does not integrate the velocity error.
    assert _integration_rule_bias({"position": 1.0, "velocity": 1.0, "integral": 1.0}, 0.02)["velocity"] == 0.0


def test_too_few_samples_and_a_jumping_reference_are_refused(vehicle):
    record = flown(vehicle)
    slow = replace(record, time=40.0 * record.time).subset(slice(50))
    jumping = replace(record, reference_position=RNG.normal(size=(SAMPLES, 3)))
    for log in (slow, jumping):
        with pytest.raises(InputError, match="has no uninterrupted stretch of flight of at least 2 s and 60 samples"):
            identify_position_law([log], vehicle)


def test_samples_at_a_limit_are_distinguished_from_a_smooth_maximum():
    time = 0.01 * np.arange(2000)
    smooth = 0.5 * np.sin(time)
    usable = np.ones(2000, dtype=bool)

    def limited(pitch):
        command = np.column_stack([0.1 * np.cos(0.7 * time), pitch, 0.0 * time])
        return at_limit(FlightRecord("made", time, attitude_command=command), 10.0 + np.sin(1.3 * time), usable)

    assert not limited(smooth).any()
    cut = np.minimum(smooth, 0.4)
    np.testing.assert_array_equal(limited(np.round(cut, 4))[cut == 0.4], True)
    assert limited(cut)[smooth < 0.39].sum() == 0


def test_logs_without_a_moving_reference_or_a_required_signal_are_refused(vehicle):
    record = flown(vehicle)
    resting = replace(record, reference_position=np.zeros((SAMPLES, 3)))
    with pytest.raises(InputError, match="use a log with a moving reference"):
        identify_position_law([resting], vehicle)
    with pytest.raises(InputError, match="lacks reference_position"):
        identify_position_law([replace(record, reference_position=None)], vehicle)
    with pytest.raises(InputError, match="has no thrust command"):
        identify_position_law([replace(record, thrust_command=None)], vehicle)
    with pytest.raises(InputError, match="at least one log is needed"):
        identify_position_law([], vehicle)


@pytest.mark.long
def test_commands_that_no_position_law_explains_are_refused(vehicle):
    record = flown(vehicle)
    turned = replace(record, attitude_command=record.attitude_command[::-1], thrust_command=record.thrust_command[::-1])
    with pytest.raises(InputError, match="of the variance of the command"):
        identify_position_law([turned], vehicle)


def law_of(form="acceleration", **gains):
    """Return a law with the given gains on all axes."""
    spreads = {name: EstimatedValue(value, 1e-4, "", 20.0) for name, value in gains.items()}
    return PositionLaw((AxisLaw(("x", "y"), spreads, 0.999), AxisLaw(("z",), spreads, 0.999)), form, 0.0)


def cascade_law(position, velocity, of_position, of_velocity, fraction, form="acceleration"):
    """Return the linear law of a cascade, from its expanded equation."""
    return law_of(
        form,
        position=velocity * position + fraction * of_velocity,
        velocity=velocity,
        reference_velocity=fraction * velocity,
        reference_acceleration=0.7,
        integral=velocity * of_position + of_velocity * position,
        displacement=(1.0 - fraction) * of_velocity,
        double_integral=of_velocity * of_position,
    )


@pytest.mark.parametrize(
    ("position", "velocity", "of_position", "of_velocity", "fraction"),
    [(0.95, 1.8, 0.0, 0.4, 1.0), (2.0, 5.74, 0.5, 3.44, 0.0), (1.5, 3.0, 0.0, 0.9, 0.4)],
)
def test_gains_of_a_cascade_follow_from_its_linear_law(position, velocity, of_position, of_velocity, fraction):
    control = control_layer(cascade_law(position, velocity, of_position, of_velocity, fraction))["control"]
    assert control["kind"] == "pid_cascade"
    np.testing.assert_allclose(control["position"]["k_p"], position, rtol=1e-4)
    np.testing.assert_allclose(control["velocity"]["k_p"], velocity, rtol=1e-4)
    np.testing.assert_allclose(control["velocity"]["k_i"], of_velocity, rtol=1e-4)
    np.testing.assert_allclose(control["position"].get("k_i", 0.0), of_position, rtol=1e-3)
    assert control["velocity_feed_forward"] == pytest.approx(fraction)
    assert control["command"] == {"kind": "acceleration", "feed_forward": 0.7}


def test_an_integral_gain_that_no_cascade_can_have_is_refused():
    law = law_of(position=1.0, velocity=1.0, reference_velocity=1.0, reference_acceleration=0.5, integral=2.0)
    with pytest.raises(InputError, match="no cascade of position and velocity represents the law"):
        control_layer(law)


def test_a_controller_is_not_written_if_an_axis_is_not_identified():
    law = replace(law_of(position=1.0, velocity=1.0), not_identified={"z": "why"})
    with pytest.raises(InputError, match="not identified on z"):
        control_layer(law)


@pytest.mark.parametrize(
    ("law", "base", "kind"),
    [
        (law_of(position=4.0, velocity=3.0, reference_velocity=3.0, reference_acceleration=1.0), "figure_eight", "pd"),
        (law_of(position=4.0, velocity=3.0, reference_velocity=0.0, integral=1.0), "figure_eight", "pid"),
        (cascade_law(2.0, 0.43, 0.0, 0.1, 0.0, "tilt"), "onboard", "pid_cascade"),
    ],
)
def test_the_written_controller_is_valid_in_the_scenario_language(diagrams, law, base, kind, tmp_path):
    path = tmp_path / "controller.yaml"
    write_controller(control_layer(law), law, path, "a command")
    assert YAML(typ="safe").load(path.read_text(encoding="utf-8"))["controller"]
    control = load_scenario(f"{diagrams}/{base}.yaml", layers=[f"{path}:controller"]).control
    assert kind in (control.kind, getattr(control.position, "kind", None))
    np.testing.assert_allclose(control.position.k_p, 4.0 if kind != "pid_cascade" else 2.0, rtol=1e-4)


def logged(flight):
    """Return the log of a simulated flight, rounded to the resolution of a Crazyflie's log."""
    signals = flight.signals
    values = dict(zip(STATE_ROWS, np.split(signals["measurement"], len(STATE_ROWS), axis=1), strict=True))
    if "attitude_target" in signals:
        thrust, command = signals["attitude_target"][:, 0], signals["attitude_target"][:, 1:4]
    else:
        thrust, command = signals["wrench"][:, 0], signals["attitude_command"]
    values |= {"attitude_command": command, "thrust_command": thrust}
    values |= {"reference_position": signals["reference"][:, :3], "reference_velocity": signals["reference"][:, 3:6]}
    return FlightRecord("flight", flight.time, **{name: np.round(each, 3) for name, each in values.items()})


PID_CONTROL = (
    "control={kind: cascade, position: {kind: pid, k_p: [2.5, 2.5, 6.0], k_d: [2.4, 2.4, 4.0], k_i: [0.8, 0.8, 2.0],"
    " integral_limit: 20.0, derivative: tracking_error, feed_forward: acceleration}}"
)
TILT_CASCADE = (
    "control={kind: pid_cascade, position: {k_p: [1.2, 1.2, 1.5]}, velocity: {k_p: [0.3, 0.3, 4.0],"
    " k_i: [0.06, 0.06, 1.0]}, velocity_feed_forward: 0.0, command: {kind: tilt}}"
)
PX4_CASCADE = (
    "control={kind: pid_cascade, position: {k_p: [1.2, 1.2, 1.5]}, velocity: {k_p: [3.0, 3.0, 4.0],"
    " k_i: [0.6, 0.6, 1.0]}, velocity_feed_forward: 1.0, command: {kind: acceleration}}"
)
ATTITUDE_CONTROLLER_ON_BOARD = (
    "laboratory.autopilot={kind: attitude, k_attitude: [8.0, 8.0, 3.0], k_rate: [25.0, 25.0, 8.0]}",
    "vehicle.time_step=0.0025",
)


@pytest.mark.long
@pytest.mark.parametrize(
    ("overrides", "form", "true"),
    [
        (
            (*ATTITUDE_CONTROLLER_ON_BOARD, PX4_CASCADE),
            "decoupled",
            {"position": 7.0, "velocity": 4.0, "integral": 1.5, "reference_velocity": 4.0},
        ),
        ((PID_CONTROL,), "heading", {"position": 6.0, "velocity": 4.0, "integral": 2.0}),
        (
            (*ATTITUDE_CONTROLLER_ON_BOARD, TILT_CASCADE),
            "tilt",
            {"position": 6.0, "velocity": 4.0, "integral": 1.5, "displacement": 1.0},
        ),
    ],
)
def test_the_law_of_a_simulated_flight_is_found(diagrams, overrides, form, true):
    route = f"route={json.dumps(random_waypoint_route(1.25))}"
    exact = "laboratory.motion_capture.derivative_bandwidth=null"
    scenario = load_scenario(f"{diagrams}/laboratory.yaml:low_wind", [route, "metrics.start=0", exact, *overrides])
    flight = simulate_samples(scenario, [0], compiled=True)[0]
    law = identify_position_law([logged(flight).subset(slice(1200))], scenario)
    assert law.form == form
    vertical = next(axis for axis in law.axes if "z" in axis.axes)
    for name, value in true.items():
        assert_in_interval(vertical.gains[name], value)


@pytest.mark.long
def test_the_gains_of_a_real_flight_are_those_of_its_firmware(root):
    """The firmware's Lee controller had k_p = 10, k_d = 7 and k_i = 5 (info08.yaml of crazyswarm2-tools)."""
    record = read_log(root / "tests/data/crazyflie/crazyswarm2/log08.xz")
    law = identify_position_law([record], load_undesigned("vehicles/crazyflie", ["nominal.mass=0.0333"]))
    level = law.axes[0]
    assert level.axes == ("x", "y")
    assert level.explained_variance > 0.999
    for name, true in (("position", 10.0), ("velocity", 7.0), ("reference_velocity", 7.0), ("integral", 5.0)):
        assert_in_interval(level.gains[name], true)
    position = control_layer(law)["control"]["position"]
    assert (position["kind"], position["derivative"]) == ("pid", "tracking_error")
    assert position["feed_forward"] == "acceleration"


def test_lists_of_a_written_controller_are_on_one_line(tmp_path):
    path = tmp_path / "controller.yaml"
    write_controller({"controller": {"control": {"k_p": [1.0, 2.0, 3.0]}}}, law_of(position=1.0), path, "a command")
    assert "k_p: [1.0, 2.0, 3.0]" in path.read_text(encoding="utf-8")
