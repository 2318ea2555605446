"""Tests that flights have their scenario's effects, and that compiled and uncompiled flights agree."""

import math

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike

from drake_quad import InputError, simulate
from drake_quad.assembly.laboratory import laboratory_recipes
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.batch import Batch
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
)
from drake_quad.vehicle.allocation import Allocation
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.effects import NO_EFFECTS, ReactionTorque
from drake_quad.vehicle.motors import SpinDown, ThrottleAllocation, ThrustCurve
from drake_quad.vehicle.parameters import Inertia
from drake_quad.vehicle.payload import Payload, PayloadPosition
from drake_quad.vehicle.slung_load import SlungLoad

PAYLOAD_FIELDS = "mass: 0.05, position: [0.001, 0.002, -0.03], inertia: [1e-5, 2e-5, 3e-5], time: 1.2"
EFFECT_OVERRIDES = {
    "body_drag": "{linear: [0.1, 0.2, 0.3], quadratic: [0.01, 0.02, 0.03], centre_of_pressure: [0.001, 0.002, 0.003]}",
    "rotor_aerodynamics": "{lift: 0.02, climb: -0.1, drag: 1e-4, inflow: 2e-4}",
    "ground_effect": "{rotor_radius: 0.3, ground_height: 0.2}",
    "reaction_torque": "true",
    "rotor_time_constant_down": "0.07",
    "payload": f"{{{PAYLOAD_FIELDS}, event: dropped}}",
    "battery": "{voltage: 12.6, empty_voltage: 10.2, capacity: 0.05, resistance: 0.02, efficiency: 0.7}",
    "slung_load": "{mass: 0.03, length: 0.6}",
    "motors": "{kind: throttle, curve: [0.11, 1.05, 2.6]}",
}
NOMINAL_MOTORS_OVERRIDE = "nominal.motors={kind: throttle, curve: [0.1, 1.0, 2.8]}"


def overrides(*names):
    """Return the overrides that add the named effects to a scenario."""
    nominal = [NOMINAL_MOTORS_OVERRIDE] if "motors" in names else []
    return [*nominal, *(f"vehicle.{name}={EFFECT_OVERRIDES[name]}" for name in names)]


def recipes_of(scenario):
    return laboratory_recipes(Batch.draw(scenario, (0,)), plan_route(scenario), 2.0)


def test_effects_have_the_parameters_of_the_scenario(asymmetric):
    names = EFFECT_OVERRIDES.keys() - {"slung_load"}
    effects = asymmetric("pid", *overrides(*names)).vehicle.effect_parameters()
    assert effects.body_drag == BodyDrag(
        LinearDrag(0.1, 0.2, 0.3), QuadraticDrag(0.01, 0.02, 0.03), CentreOfPressure(0.001, 0.002, 0.003)
    )
    assert effects.rotor_aerodynamics == RotorAerodynamics(0.02, -0.1, 1e-4, 2e-4)
    assert effects.ground_effect == GroundEffect(0.3, 0.2)
    assert effects.reaction_torque == ReactionTorque(9.0e-5)
    assert effects.spin_down == SpinDown(0.07)
    assert effects.battery == Battery(12.6, 10.2, 0.05, 0.02, 0.7)
    assert effects.thrust_curve == ThrustCurve(0.11, 1.05, 2.6)
    payload = Payload(0.05, PayloadPosition(0.001, 0.002, -0.03), Inertia(1e-5, 2e-5, 3e-5), 0.0, 1.2)
    assert effects.payload == payload
    picked_up = asymmetric("pid", f"vehicle.payload={{{PAYLOAD_FIELDS}, event: picked_up}}")
    assert picked_up.vehicle.effect_parameters().payload == payload._replace(picked_up=1.2, dropped=math.inf)
    assert asymmetric("pid", *overrides("slung_load")).vehicle.effect_parameters().slung_load == SlungLoad(0.03, 0.6)


def test_an_effect_that_is_off_is_not_part_of_the_diagram(asymmetric):
    recipes = recipes_of(asymmetric("pid"))
    assert recipes["vehicle"].structure["effects"] == ()
    assert recipes["vehicle"].parameters.effects == NO_EFFECTS
    assert recipes["allocation"].system is Allocation


@pytest.mark.long
def test_an_autopilot_allocates_throttles_by_the_nominal_thrust_curve(asymmetric):
    recipe = recipes_of(asymmetric("pid", *overrides("motors")))["allocation"]
    assert recipe.system is ThrottleAllocation
    assert recipe.parameters.curve == ThrustCurve(0.1, 1.0, 2.8)
    flight = simulate(asymmetric("pid", "duration=0.1", "metrics.start=0", *overrides("motors")))
    assert "rotor_speed_command" not in flight.signals
    # The initial output of the link is the nominal weight, produced by four rotors with a thrust of 0.1 + u + 2.8 u²
    # each.
    hover = np.roots([2.8, 1.0, 0.1 - 0.7 * 9.79 / 4.0]).max()
    np.testing.assert_allclose([row[0] for row in flight.record("throttle_command")], hover, rtol=1e-9)


SETS_OF_EFFECTS = [
    *((name,) for name in EFFECT_OVERRIDES),
    tuple(name for name in EFFECT_OVERRIDES if name != "slung_load"),
    tuple(name for name in EFFECT_OVERRIDES if name != "payload"),
]


# The payload is dropped after 1.2 s, within the flight.
SHORT_FLIGHT_OVERRIDES = ("duration=1.4", "vehicle.mass={uniform: {min: 0.7, max: 0.75}}")


@pytest.fixture(scope="module")
def flight_without_effects(asymmetric):
    """Return a flight without effects, for comparison."""
    return simulate(asymmetric("pid", *SHORT_FLIGHT_OVERRIDES), sample=0)


@pytest.mark.long
@pytest.mark.parametrize(
    "names", SETS_OF_EFFECTS, ids=lambda names: names[0] if len(names) == 1 else f"{len(names)} effects"
)
def test_compiled_and_uncompiled_flights_of_single_vehicles_and_fleets_agree(asymmetric, flight_without_effects, names):
    """Each set of effects is also compared with a flight without effects, which it must change."""
    scenario = asymmetric("pid", *SHORT_FLIGHT_OVERRIDES, *overrides(*names))
    first, second = assert_flown_alike(Batch.draw(scenario, (0, 1)))
    assert np.abs(first["state"] - flight_without_effects["state"]).max() > 1e-6
    alone = simulate(scenario, sample=1, compiled=False)
    np.testing.assert_allclose(second["state"], alone["state"], rtol=0.0, atol=1e-12)


@pytest.mark.long
def test_parameters_of_effects_may_be_distributions(asymmetric):
    distributions = [
        "vehicle.body_drag={linear: [{uniform: {min: 0.1, max: 0.3}}, 0, 0]}",
        "vehicle.payload={mass: {uniform: {min: 0.02, max: 0.05}}, time: {choice: [0.5, 1.2]}, event: dropped}",
        "vehicle.rotor_time_constant_down={uniform: {min: 0.04, max: 0.08}}",
        "vehicle.reaction_torque=true",
    ]
    scenario = asymmetric("pid", "duration=1.4", *distributions)
    flights = assert_flown_alike(Batch.draw(scenario, range(3)))
    np.testing.assert_array_equal(flights[2]["state"], simulate(scenario, sample=2, compiled=True)["state"])
    assert len({flight["state"][-1, 0] for flight in flights}) == 3


CALM_WITHOUT_DRAG = ["laboratory.wind=[]", "vehicle.linear_drag=0", "vehicle.quadratic_drag=0"]


@pytest.mark.parametrize(
    ("drag", "derivative_per_number"),
    [
        ("body_drag={{linear: [0.1, {0!r}, 0.2]}}", 1.0),
        ("rotor_aerodynamics={{drag: {0!r}, inflow: 1e-6}}", 4.0 * 222.0),
        ("rotor_aerodynamics={{climb: -{0!r}, drag: 1e-6}}", 1.0),
    ],
)
def test_a_time_step_that_is_too_long_for_the_drag_is_refused(asymmetric, drag, derivative_per_number):
    """The limit is 2.5 m / k, with the mass m and the largest derivative k of the force with respect to velocity."""
    max_number = 2.5 * 0.74 / 0.01 / derivative_per_number
    recipes_of(asymmetric("pid", *CALM_WITHOUT_DRAG, "vehicle." + drag.format((1.0 - 1e-9) * max_number)))
    with pytest.raises(InputError, match="vehicle.time_step is 0.01 s, too long for drag with a time constant"):
        recipes_of(asymmetric("pid", *CALM_WITHOUT_DRAG, "vehicle." + drag.format((1.0 + 1e-9) * max_number)))


@pytest.mark.parametrize(
    "motion", ["laboratory.wind=[{kind: steady, velocity: [3, 0, 4]}]", "initial.velocity=[3, 0, 4]"]
)
def test_wind_and_initial_velocity_increase_the_airspeed_derivative_of_quadratic_drag_and_lift(asymmetric, motion):
    for drag in ("body_drag={{quadratic: [0.1, 0.2, {0!r}]}}", "rotor_aerodynamics={{lift: {0!r}}}"):
        max_number = 2.5 * 0.74 / 0.01 / 10.0
        recipes_of(asymmetric("pid", *CALM_WITHOUT_DRAG, motion, "vehicle." + drag.format((1.0 - 1e-9) * max_number)))
        with pytest.raises(InputError, match="too long for drag with a time constant"):
            recipes_of(
                asymmetric("pid", *CALM_WITHOUT_DRAG, motion, "vehicle." + drag.format((1.0 + 1e-9) * max_number))
            )


def test_the_largest_derivatives_of_body_drag_and_rotor_drag_are_added(asymmetric):
    """The derivatives are with respect to airspeed, in a wind of 5 m/s.

    The derivative of body drag is largest along y. That of rotor drag is largest along z in the first case, and
    perpendicular to z in the second case.
    """
    body = "vehicle.body_drag={linear: [0.1, 0.4, 0.2], quadratic: [0.03, 0.02, 0.01]}"
    rotors = "vehicle.rotor_aerodynamics={{lift: 0.07, climb: {climb}, drag: {drag}, inflow: {inflow}}}"
    derivative_along_z = 0.3 + 4.0 * 222.0 * 2e-4 + 2.0 * 0.07 * 5.0
    derivative_across_z = 4.0 * 222.0 * 2e-3
    for climb, inflow, drag, rotor_derivative in (
        ("-0.3", "2e-4", "1e-6", derivative_along_z),
        ("-0.3", "2e-4", "2e-3", derivative_across_z),
    ):
        rotor_override = rotors.format(climb=climb, inflow=inflow, drag=drag)
        for overrides, expected in (
            ((rotor_override,), rotor_derivative),
            ((body, rotor_override), 0.4 + 2.0 * 0.02 * 5.0 + rotor_derivative),
        ):
            vehicle = Batch.draw(asymmetric("pid", *overrides), (0,)).fleet_scenario.vehicle
            slopes = [effect.max_damping(vehicle, 5.0) for effect in vehicle.effects().values()]
            assert sum(slopes) == pytest.approx(expected, rel=1e-12)


def test_the_time_step_must_be_short_enough_for_every_vehicle_of_a_fleet(asymmetric):
    scenario = asymmetric("pid", *CALM_WITHOUT_DRAG, "vehicle.slung_load={mass: 0.03, length: 0.6}")
    plan = plan_route(scenario)
    for field, number, words in (
        ("vehicle.linear_drag", 200.0, "too long for drag with a time constant"),
        ("vehicle.slung_load.length", 1e-5, "too long for a slung load"),
    ):
        batch = Batch(scenario, (0, 1, 2), {field: np.array([0.3, number, 0.3])})
        with pytest.raises(InputError, match=words):
            laboratory_recipes(batch, plan, 2.0)


def test_a_time_step_that_is_too_long_for_the_swing_of_a_load_is_refused(asymmetric):
    """The largest time step is proportional to 1 / ω, with the swing frequency ω² = (1 + m_L / m) g / l."""
    assert 9.81 * (1.0 + 7.4 / 0.74) * (0.01 / 2.5) ** 2 < 0.01
    min_length = 9.81 * (1.0 + 100.0 / 0.74) * (0.01 / 2.5) ** 2
    recipes_of(asymmetric("pid", f"vehicle.slung_load={{mass: 100, length: {(1.0 + 1e-9) * min_length!r}}}"))
    with pytest.raises(InputError, match="vehicle.time_step is 0.01 s, too long for a slung load"):
        recipes_of(asymmetric("pid", f"vehicle.slung_load={{mass: 100, length: {(1.0 - 1e-9) * min_length!r}}}"))


@pytest.mark.long
@pytest.mark.parametrize("event", ["picked_up", "dropped"])
def test_velocity_is_continuous_when_a_payload_is_picked_up_or_dropped(asymmetric, event):
    """The vehicle starts trimmed with its load, and the commanded thrust does not change at the event."""
    scenario = asymmetric(
        "pid", "duration=2", f"vehicle.payload={{mass: 0.1, position: [0, 0, -0.05], time: 1.0, event: {event}}}"
    )
    flight = simulate(scenario)
    state = flight.record("state")
    jumps = np.abs(np.diff(np.array([state.v_x, state.v_y, state.v_z, state.p, state.q, state.r]), axis=1))
    event_tick = np.searchsorted(flight.time, 1.0)
    # If the mass of 0.74 kg changes by 0.1 kg, the vehicle accelerates by at most 1.3 m/s² during a tick of 20 ms.
    assert jumps[:3, event_tick - 2 : event_tick + 3].max() < 0.06
    velocity_steps = np.diff(state.v_z)
    climb_change = velocity_steps[event_tick + 1] - velocity_steps[event_tick - 2]
    assert (climb_change > 0.005) if event == "dropped" else (climb_change < -0.005)


def test_a_vehicle_with_effects_starts_trimmed(asymmetric):
    """In still air, the vehicle does not move within the first steps, with any load and at any height."""
    equal_rotors = ["vehicle.battery_sag=0", "vehicle.rotor_failure=null", *CALM_WITHOUT_DRAG]
    for names in (("payload", "ground_effect", "rotor_aerodynamics"), ("slung_load", "ground_effect", "body_drag")):
        scenario = asymmetric("pid", "duration=0.1", *equal_rotors, *overrides(*names))
        recipe = recipes_of(scenario)["vehicle"]
        vehicle = recipe._replace(structure=recipe.structure | {"time_step": 0.0}).build(1)
        context = vehicle.CreateDefaultContext()
        speeds = vehicle.get_state(context, "continuous").rotors
        vehicle.GetInputPort("rotor_speed_command").FixValue(context, speeds)
        np.testing.assert_allclose(vehicle.EvalTimeDerivatives(context).CopyToVector(), 0.0, atol=1e-11)
