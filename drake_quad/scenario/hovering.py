"""Conversion of a scenario to a hover flight, with or without noise and losses, for linear analysis and design."""

from typing import Any

from drake_quad.errors import InputError
from drake_quad.scenario.effects.effect import EFFECTS
from drake_quad.scenario.estimators.motion_capture import MotionCaptureEstimator
from drake_quad.scenario.initial import InitialState
from drake_quad.scenario.models import MetricWindow, Nominal, Scenario, Vehicle
from drake_quad.scenario.motion_capture import MotionCaptureSettings
from drake_quad.scenario.paths import distributions_in, with_values
from drake_quad.scenario.routes.hover import HoverRoute
from drake_quad.signals import valid_signal

_HOVER = HoverRoute(kind="hover", position=(0.0, 0.0, 1.0))  # position in m


def at_rest(scenario: Scenario) -> Scenario:
    """Return the scenario in hover, without random or time-varying effects.

    The vehicle hovers at the position of a route of kind `hover`, and at (0, 0, 1) m for any other route. Noise, lost
    frames and packets, turbulence, gusts, sinusoidal wind, battery sag, the battery, rotor failures and obstacles are
    removed. Delays, lags, filters, drag, errors of the vehicle, the bias of the gyroscope, fans and steady wind remain.
    A payload remains if the vehicle carries it at the start of the flight.

    Raises:
        InputError: if the scenario contains a distribution, or its autopilot is firmware.
    """
    autopilot = scenario.laboratory.autopilot
    response = autopilot.attitude_response()
    if autopilot.is_firmware and response is not None:
        frequency, damping = ([value] * 3 for value in response)
        raise InputError(
            f"laboratory.autopilot of kind {autopilot.kind} is firmware, which has no linear model; for an analysis,"
            f" replace it by {{kind: response, natural_frequency: {frequency}, damping: {damping}}}, which responds"
            " similarly"
        )
    hovering = without_losses(in_hover(scenario))
    laboratory = hovering.laboratory
    calm = (source.without_turbulence() for source in laboratory.wind)
    settings = {
        "laboratory.motion_capture.position_noise": 0.0,
        "laboratory.motion_capture.attitude_noise": 0.0,
        "laboratory.motion_capture.velocity_drift": (0.0, 0.0, 0.0),
        "laboratory.autopilot": laboratory.autopilot.without_noise(),
        "laboratory.sensors": tuple([sensor.without_noise() for sensor in laboratory.sensors]),
        "laboratory.wind": tuple([source for source in calm if source is not None]),
    }
    return with_values(hovering, settings)


def in_hover(scenario: Scenario) -> Scenario:
    """Return the scenario in hover as `at_rest` does, but with noise, turbulence, lost frames and lost packets.

    Sensors are removed if neither the estimator nor the control reads them. Faults of sensors are removed, and so are
    sensor errors without a linear model, such as quantisation and vibration.

    Raises:
        InputError: if the scenario contains a distribution.
    """
    for path in distributions_in(scenario):
        if not path.startswith("route."):
            raise InputError(
                f"{path} is a distribution, but the analysis of hover needs a number; give a number, or select a sample"
            )
    laboratory = scenario.laboratory
    names, read_signals = laboratory.estimator.names_of_sensors(laboratory), scenario.control.sensor_signals()
    route = scenario.route
    if not isinstance(route, HoverRoute) or distributions_in(route):
        route = _HOVER
    settings: dict[str, Any] = {
        "route": route,
        "vehicle.battery_sag": 0.0,
        **{f"vehicle.{name}": effect.in_hover() for name, effect in scenario.vehicle.effects().items()},
        "laboratory.wind": tuple([source for source in scenario.laboratory.wind if not source.depends_on_time]),
        "laboratory.estimator": laboratory.estimator.with_explicit_noise(laboratory).in_hover(),
        "laboratory.sensors": tuple(
            [
                sensor.in_hover()
                for name, sensor in laboratory.named_sensors.items()
                if name in names or {name, valid_signal(name)} & {*read_signals}
            ]
        ),
        "duration": None,
        "sample": None,
        "crash.position_error": 1e6,
        "crash.height": -1e6,
        "space": None,
        "metrics": MetricWindow(),
        "initial": InitialState(),
        "requirements": {},
    }
    return with_values(scenario, settings)


def with_exact_measurement(scenario: Scenario) -> Scenario:
    """Return the scenario with the exact state instead of an estimate; unchanged if it has no estimator."""
    laboratory = scenario.laboratory
    if not laboratory.estimator.integrates_sensors:
        return scenario
    settings = {
        "laboratory.estimator": MotionCaptureEstimator(kind="motion_capture"),
        "laboratory.motion_capture": MotionCaptureSettings(period=laboratory.command_link.period),
        "laboratory.sensors": (),
    }
    return with_values(scenario, settings)


def without_losses(scenario: Scenario) -> Scenario:
    """Return the scenario without lost frames and packets, which a linear model cannot represent."""
    losses = "laboratory.motion_capture.dropout_rate", "laboratory.command_link.loss_rate"
    return with_values(scenario, dict.fromkeys(losses, 0.0))


def nominal_hover(scenario: Scenario) -> Scenario:
    """Return the scenario in hover at (0, 0, 1) m in still air, with the vehicle for which controllers are designed.

    This vehicle has the parameters of `nominal`. It also has those parts of `vehicle` that the ground station knows:
    the lag of accelerating rotors, the drag, and the aerodynamic forces on the rotors.
    """
    return symmetric_hover(with_nominal_vehicle(at_rest(scenario)))


def with_nominal_vehicle(scenario: Scenario) -> Scenario:
    """Return the scenario with the vehicle as the ground station knows it; see `nominal_hover`."""
    nominal = {name: getattr(scenario.nominal, name) for name in Nominal.model_fields}
    effects = [name for name, effect in EFFECTS.members.items() if effect.is_nominal]
    kept = ("rotor_time_constant", "linear_drag", "quadratic_drag", "attitude_kinematics", "time_step", *effects)
    vehicle = Vehicle().model_copy(update=nominal | {name: getattr(scenario.vehicle, name) for name in kept})
    return scenario.model_copy(update={"vehicle": vehicle})


def symmetric_hover(resting: Scenario) -> Scenario:
    """Return the result of `at_rest` at (0, 0, 1) m, without effects that couple axes or tilt the vehicle.

    These effects are wind, unequal rotors, misalignment, the angular momentum of rotors at unequal speeds, the bias of
    the gyroscope, and forces off the centre of mass, such as the drag of the body or the weight of a payload.
    """
    layouts = resting.vehicle.layout, resting.nominal.layout
    settings = {
        "route": _HOVER,
        "vehicle.thrust_factor_error": (0.0, 0.0, 0.0, 0.0),
        "vehicle.centre_of_mass": (0.0, 0.0),
        "vehicle.rotor_inertia": 0.0,
        "vehicle.layout": layouts[0] if all(layout.is_paired for layout in layouts) else layouts[1],
        **{f"vehicle.{name}": effect.symmetric() for name, effect in resting.vehicle.effects().items()},
        "laboratory.wind": (),
        "laboratory.motion_capture.misalignment": (0.0, 0.0, 0.0),
        "laboratory.autopilot": resting.laboratory.autopilot.without_bias(),
    }
    return with_values(resting, settings)
