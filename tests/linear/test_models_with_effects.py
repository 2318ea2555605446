"""Tests of operating points and linear models of vehicles with effects beyond the equations of the paper."""

import numpy as np
import pytest
from oracle.effects import Forces, accelerations

from drake_quad import InputError, load_scenario, simulate
from drake_quad.design.sensitivity import flight_sensitivities
from drake_quad.linear.closed_loop import closed_loop, laboratory_plant
from drake_quad.linear.vehicle_model import STATES, SWING_STATES, affine_vehicle, find_trim, linear_vehicle
from drake_quad.linear.vehicle_model import to_state_space as named
from drake_quad.scenario.hovering import at_rest, nominal_hover
from drake_quad.scenario.numbers import with_number
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
)
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import ThrustCurve
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters
from drake_quad.vehicle.payload import Payload, PayloadPosition, loaded_body
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig
from drake_quad.vehicle.slung_load import SlungLoad

MANY_EFFECTS = Effects(
    BodyDrag(LinearDrag(0.1, 0.2, 0.3), QuadraticDrag(0.04, 0.05, 0.06), CentreOfPressure(0.01, -0.02, 0.03)),
    RotorAerodynamics(lift=0.03, climb=0.11, drag=2e-4, inflow=3e-4),
    GroundEffect(rotor_radius=0.21, ground_height=-0.4),
    ReactionTorque(9.0e-5),
    payload=Payload(0.05, PayloadPosition(0.02, -0.01, -0.05), Inertia(2e-4, 3e-4, 5e-4)),
)
SLUNG_LOAD = SlungLoad(mass=0.17, length=0.8)  # kg and m


def test_a_trim_balances_all_effects(asymmetric_vehicle):
    velocity, wind = (2.0, 1.0, -0.5), (1.0, -2.0, 0.3)
    trim = find_trim(
        asymmetric_vehicle, velocity=velocity, wind=wind, position=(0.0, 0.0, -0.2), yaw=0.6, effects=MANY_EFFECTS
    )
    pairs, torque = Forces(asymmetric_vehicle, MANY_EFFECTS).at(
        trim.state, trim.rotor_speed, np.array(wind), np.zeros(4)
    )
    carried = [
        (MANY_EFFECTS.payload.mass, np.array(MANY_EFFECTS.payload.position), np.diag(MANY_EFFECTS.payload.inertia))
    ]
    remaining = accelerations(asymmetric_vehicle, trim.state, trim.rotor_speed, pairs, torque, carried)
    np.testing.assert_allclose(remaining, 0.0, atol=1e-9)


def test_a_trim_includes_a_payload_if_the_vehicle_carries_it_at_the_beginning_of_a_flight(asymmetric_vehicle):
    """A payload that is dropped later is included, and a payload that is picked up later is not."""
    bare = find_trim(asymmetric_vehicle)
    later = find_trim(asymmetric_vehicle, effects=Effects(payload=MANY_EFFECTS.payload._replace(picked_up=0.5)))
    np.testing.assert_allclose(later.rotor_speed, bare.rotor_speed, rtol=1e-9)
    laden, dropped = (
        find_trim(asymmetric_vehicle, effects=Effects(payload=payload))
        for payload in (MANY_EFFECTS.payload, MANY_EFFECTS.payload._replace(dropped=0.5))
    )
    np.testing.assert_allclose(dropped.rotor_speed, laden.rotor_speed, rtol=1e-9)
    assert np.abs(laden.rotor_speed - bare.rotor_speed).min() > 1.0


@pytest.mark.parametrize(
    "effects", [MANY_EFFECTS, MANY_EFFECTS._replace(payload=None, slung_load=SLUNG_LOAD)], ids=["laden", "slung"]
)
def test_a_linear_model_in_flight_matches_finite_differences(asymmetric_vehicle, effects):
    velocity, wind = (2.0, 1.0, -0.5), (1.0, -2.0, 0.3)
    pose = {"position": (0.0, 0.0, -0.2), "yaw": 0.6}
    trim = find_trim(asymmetric_vehicle, velocity=velocity, wind=wind, **pose, effects=effects)
    system = affine_vehicle(trim, asymmetric_vehicle, effects=effects)
    config = QuadrotorConfig(asymmetric_vehicle, effects=effects)
    vehicle = Quadrotor(time_step=0.0, effects=effects.names, parameters=config)
    context = vehicle.CreateDefaultContext()
    swing = np.zeros(len(SWING_STATES) if effects.slung_load else 0)
    point = np.concatenate([trim.state, trim.rotor_speed, swing, trim.rotor_speed, trim.wind])
    count = len(STATES) + len(swing)

    def rates(x):
        context.SetContinuousState(x[:count])
        vehicle.GetInputPort("rotor_speed_command").FixValue(context, x[count : count + 4])
        vehicle.GetInputPort("wind").FixValue(context, x[count + 4 :])
        return vehicle.EvalTimeDerivatives(context).CopyToVector()

    steps = 1e-6 * np.maximum(1.0, np.abs(point))
    units = np.eye(len(point))
    numeric = np.array([(rates(point + h * e) - rates(point - h * e)) / (2.0 * h) for h, e in zip(steps, units)]).T
    np.testing.assert_allclose(np.hstack([system.A(), system.B()]), numeric, atol=1e-6)


@pytest.mark.slow
def test_a_slung_load_swings_as_a_double_pendulum():
    """Both swings have ω² = (1 + m_L / m) g / l and no damping, because the load has no drag."""
    parameters = QuadrotorParameters()
    effects = Effects(slung_load=SLUNG_LOAD)
    trim = find_trim(parameters, effects=effects)
    assert 4.0 * 4.13e-5 * trim.rotor_speed[0] ** 2 == pytest.approx((0.68 + 0.17) * 9.81, rel=1e-12)
    system = linear_vehicle(trim, parameters, effects=effects)
    poles = np.linalg.eigvals(system.A())
    swinging = np.sort(poles[np.abs(poles.imag) > 1.0].imag)
    frequency = np.sqrt((1.0 + 0.17 / 0.68) * 9.81 / 0.8)
    np.testing.assert_allclose(swinging, [-frequency, -frequency, frequency, frequency], rtol=1e-9)
    assert named(system).state_labels[len(STATES) :] == [
        "swing_roll",
        "swing_pitch",
        "swing_roll_rate",
        "swing_pitch_rate",
    ]


def test_linear_models_omit_the_thrust_curve_and_the_battery():
    parameters = QuadrotorParameters()
    effects = Effects(thrust_curve=ThrustCurve(0.1, 1.0, 2.8), battery=Battery(12.6, 10.0, 1.0, 0.02, 0.7))
    trim = find_trim(parameters, effects=effects)
    bare = linear_vehicle(find_trim(parameters), parameters)
    np.testing.assert_array_equal(linear_vehicle(trim, parameters, effects=effects).A(), bare.A())


@pytest.fixture
def laboratory(diagrams):
    return lambda *overrides: load_scenario(diagrams / "laboratory.yaml:nominal", overrides)


PAYLOAD_OVERRIDE = "vehicle.payload={{mass: 0.05, position: [0.001, 0.002, -0.03], time: {}, event: {}}}"


def test_at_rest_keeps_a_payload_if_the_vehicle_carries_it_at_the_beginning_and_removes_the_battery(laboratory):
    for time, event, is_carried in ((2.0, "dropped", True), (2.0, "picked_up", False), (0.0, "picked_up", True)):
        resting = at_rest(laboratory(PAYLOAD_OVERRIDE.format(time, event))).vehicle
        payload = resting.effect_parameters().payload
        assert (payload is not None) == is_carried
        if payload is not None:
            masses = [loaded_body(0.68, Inertia(), payload, moment).mass for moment in (0.0, 1.0, 3.0, 1e4)]
            assert masses == pytest.approx([0.73] * 4)
    assert at_rest(laboratory(PAYLOAD_OVERRIDE.format(0.0, "dropped"))).vehicle.payload is None
    battery = "vehicle.battery={voltage: 12, empty_voltage: 10, capacity: 1, resistance: 0, efficiency: 0.7}"
    assert at_rest(laboratory(battery)).vehicle.battery is None


def test_the_nominal_vehicle_has_the_aerodynamics_of_the_actual_one(laboratory):
    drag = "vehicle.body_drag={linear: [0.1, 0.2, 0.3], centre_of_pressure: [0.01, 0.02, 0.03]}"
    omitted_effects = [
        "vehicle.ground_effect={rotor_radius: 0.1}",
        "vehicle.reaction_torque=true",
        PAYLOAD_OVERRIDE.format(1, "dropped"),
    ]
    vehicle = nominal_hover(laboratory(drag, "vehicle.rotor_aerodynamics={lift: 0.02}", *omitted_effects)).vehicle
    assert vehicle.body_drag.linear == (0.1, 0.2, 0.3)
    assert vehicle.body_drag.centre_of_pressure == (0.0, 0.0, 0.0)
    assert vehicle.rotor_aerodynamics.lift == 0.02
    assert (vehicle.ground_effect, vehicle.reaction_torque, vehicle.payload) == (None, False, None)


ALL_EFFECTS_OVERRIDES = [
    "vehicle.body_drag={linear: [0.1, 0.2, 0.3], centre_of_pressure: [0.001, 0.002, 0.01]}",
    "vehicle.rotor_aerodynamics={lift: 0.02, climb: 0.1, drag: 1e-4, inflow: 2e-4}",
    "vehicle.ground_effect={rotor_radius: 0.3, ground_height: 0.2}",
    "vehicle.reaction_torque=true",
    "vehicle.rotor_time_constant_down=0.06",
    "nominal.motors={kind: throttle, curve: [0.1, 1.0, 2.8]}",
    "vehicle.motors={kind: throttle, curve: [0.11, 1.05, 2.6]}",
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "load",
    [PAYLOAD_OVERRIDE.format(1.0, "dropped"), "vehicle.slung_load={mass: 0.02, length: 0.5}"],
    ids=["payload", "slung load"],
)
def test_a_loop_with_all_effects_has_an_equilibrium_and_a_linear_model(laboratory, load):
    wind = "laboratory.wind=[{kind: steady, velocity: [1, 0.5, 0]}]"
    loop = closed_loop(laboratory(*ALL_EFFECTS_OVERRIDES, load, wind))
    poles = loop.system.poles()
    slung = "slung_load" in load
    assert any(name.endswith("swing.roll") for name in loop.system.states) == slung
    # The load is not controlled, so its swing may grow slowly.
    assert np.abs(poles).max() < (1.01 if slung else 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", ["nominal", "actual"])
def test_a_laboratory_with_effects_has_a_linear_plant(laboratory, vehicle):
    """The specific thrust is that of the nominal thrust curve, for the throttle at which the vehicle hovers."""
    plant, specific_thrust = laboratory_plant(laboratory(*ALL_EFFECTS_OVERRIDES[5:]), vehicle=vehicle)
    if vehicle == "nominal":
        assert specific_thrust == pytest.approx(9.81, rel=1e-9)
    else:
        throttle = (np.sqrt(1.05**2 + 4.0 * 2.6 * (0.68 * 9.81 / 4.0 - 0.11)) - 1.05) / 5.2
        nominal = 4.0 * (0.1 + throttle + 2.8 * throttle**2)
        assert specific_thrust == pytest.approx(nominal / 0.68, rel=1e-9)
    assert len(plant.states) > 0
    laboratory_plant(laboratory(*ALL_EFFECTS_OVERRIDES, PAYLOAD_OVERRIDE.format(1.0, "dropped")), vehicle=vehicle)


@pytest.mark.long
@pytest.mark.parametrize(
    "load",
    [PAYLOAD_OVERRIDE.format(1.0, "dropped"), "vehicle.slung_load={mass: 0.02, length: 0.5}"],
    ids=["payload", "slung load"],
)
def test_flight_sensitivities_of_the_rmse_match_finite_differences_between_flights(laboratory, load):
    scenario = laboratory("duration=1.4", "metrics.start=0", *ALL_EFFECTS_OVERRIDES, load)
    # The other effects do not depend on the kind of load, so each is tested with one load only.
    fields = {
        "payload": ("body_drag.linear.0", "rotor_aerodynamics.climb", "payload.mass"),
        "slung_load": (
            *("ground_effect.rotor_radius", "rotor_time_constant_down", "motors.curve.1", "slung_load.mass"),
        ),
    }["payload" if "payload" in load else "slung_load"]
    fields = [f"vehicle.{field}" for field in fields]
    sensitivities = flight_sensitivities(scenario, fields)
    for i, field in enumerate(fields):
        step = 1e-4 * sensitivities.values[i]
        low, high = (
            simulate(with_number(scenario, field, sensitivities.values[i] + side * step)).metrics.rmse
            for side in (-1.0, 1.0)
        )
        scale = sensitivities.metrics["rmse"] / sensitivities.values[i]
        assert sensitivities.gradients["rmse"][i] == pytest.approx(
            (high - low) / (2.0 * step), rel=1e-3, abs=1e-6 * scale
        ), field


def test_sensitivity_to_the_time_at_which_a_payload_is_dropped_is_refused(laboratory):
    with pytest.raises(InputError, match="vehicle.payload.time: the flight depends on it discontinuously"):
        flight_sensitivities(
            laboratory("duration=1", PAYLOAD_OVERRIDE.format(0.5, "dropped")), ["vehicle.payload.time"]
        )
