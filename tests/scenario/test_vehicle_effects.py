"""Tests that attributes and methods of every effect, including a user's effect, agree with the vehicle's motion."""

import math
from importlib import import_module
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import FirstOrderTaylorApproximation

from drake_quad import InputError, load_scenario
from drake_quad.geometry.axes import Vector
from drake_quad.identification.results.estimates import declaration_of
from drake_quad.linear.vehicle_model import find_trim
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect, VehicleEffect
from drake_quad.scenario.hovering import in_hover, nominal_hover
from drake_quad.scenario.models import Vehicle
from drake_quad.scenario.schema import file_schema, language_page
from drake_quad.signals import RotorSpeed, State, Wrench
from drake_quad.vehicle.aerodynamics import Flow
from drake_quad.vehicle.attitude_response import (
    AttitudeResponse,
    AttitudeResponseConfig,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.effects import Effects, hover_equivalent
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.trim_force import TrimForce

EXAMPLE_SCRIPT = Path(__file__).parent.parent.parent / "scripts" / "ceiling_effect.py"
PAPER_VEHICLE = QuadrotorParameters()
INITIAL_HEIGHT = 0.3  # m, near the ground
NUM_STATES = len(State._fields) + len(RotorSpeed._fields)
# Field values of the tested effects. In all other effects, required fields are 0.1.
EFFECT_FIELDS = {
    "body_drag": {"linear": [0.1, 0.2, 0.3], "quadratic": [0.03, 0.01, 0.02], "centre_of_pressure": [0.01, 0.0, 0.03]},
    "rotor_aerodynamics": {"lift": 0.02, "climb": -0.1, "drag": 1e-4, "inflow": 2e-4},
    "ground_effect": {"rotor_radius": 0.2},
    "payload": {"mass": 0.1, "position": [0.02, 0.0, -0.05], "time": 0.1, "event": "picked_up"},
    "battery": {"voltage": 12.6, "empty_voltage": 10.2, "capacity": 0.01, "resistance": 0.02, "efficiency": 0.7},
    "slung_load": {"mass": 0.1, "length": 0.6},
    "rotor_failure": {"rotor": 2.0, "time": 0.1},
    "trim_force": {"x": 0.3, "y": -0.2, "z": 0.1},
}


def test_the_hover_state_includes_a_payload_that_is_dropped_later():
    """The vehicle is trimmed with the payload, unless the payload is dropped at time zero."""
    dropped = {**EFFECT_FIELDS["payload"], "event": "dropped"}
    payload = EFFECTS.members["payload"](**dropped)
    assert has_constant_acceleration("payload", payload.in_hover())
    assert payload.model_copy(update={"time": 0.0}).in_hover() is None


def test_a_hovering_vehicle_tilts_against_its_trim_force():
    """In hover, the thrust and the trim force together cancel the weight."""
    force = TrimForce(0.3, -0.2, 0.1)
    trim = find_trim(PAPER_VEHICLE, effects=Effects(loads=(force,)))
    weight = PAPER_VEHICLE.mass * PAPER_VEHICLE.gravity
    roll, pitch = trim.state[3:5]
    assert pitch == pytest.approx(-math.asin(force.x / weight), abs=1e-9)
    assert roll == pytest.approx(math.asin(force.y / (weight * math.cos(pitch))), abs=1e-9)
    thrust = rotor_action(RotorSpeed(*trim.rotor_speed), PAPER_VEHICLE).wrench.thrust
    assert thrust + force.z == pytest.approx(weight * math.cos(roll) * math.cos(pitch), rel=1e-9)


@pytest.fixture
def ceiling_effect(monkeypatch):
    """Register the effect of the example during a test, and return it."""
    monkeypatch.syspath_prepend(EXAMPLE_SCRIPT.parent)
    return EFFECTS.register(import_module(EXAMPLE_SCRIPT.stem).CeilingEffect)


def example(name, kind):
    required = {name: 0.1 for name, field in kind.model_fields.items() if field.is_required()}
    return kind.model_validate(EFFECT_FIELDS.get(name, required))


def with_effect(name, effect):
    return Vehicle(**{name: effect})


def vehicle_in_hover(name, effect, speed=0.0, time_step=0.01):
    """Return the paper's vehicle in hover with an effect, in a context that holds the initial rotor speeds."""
    effects = with_effect(name, effect).effect_parameters()
    faults = effect.parameters() if name == "rotor_failure" else RotorFaults()
    pose = HoverPose(0.0, 0.0, INITIAL_HEIGHT, 0.0)
    structure = {"effects": effects.names, "faulty": name == "rotor_failure", "time_step": time_step}
    vehicle = Quadrotor(**structure, parameters=QuadrotorConfig(PAPER_VEHICLE, faults, pose, effects))
    context = vehicle.CreateDefaultContext()
    speeds = hover_rotor_speeds(hover_equivalent(PAPER_VEHICLE, effects, INITIAL_HEIGHT))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, np.array(speeds))
    if speed:
        state = context.get_discrete_state(0).CopyToVector()
        state[6:9] = speed * np.array([1.0, -0.7, 0.5])
        context.SetDiscreteState(0, state)
    return vehicle, context


def state_after(name, effect, speed=0.0, until=0.4):
    """Return the state after a flight with a given initial speed, in which hover rotor speeds are commanded."""
    vehicle, context = vehicle_in_hover(name, effect, speed)
    simulator = Simulator(vehicle, context)
    simulator.AdvanceTo(until + 1e-9)  # just after the last update
    return vehicle.GetOutputPort("state").Eval(context)


def has_constant_acceleration(name, effect):
    """Return whether the acceleration of a hovering vehicle with an effect is constant."""
    at_start, half_way, at_end = (state_after(name, effect, until=until)[6:] for until in (0.0, 0.2, 0.4))
    return np.abs(at_end - 2.0 * half_way + at_start).max() < 1e-9


def rotates_body(name, effect):
    return np.abs(state_after(name, effect, speed=2.0)[9:12]).max() > 1e-9


def slopes_along_axes_of(effect):
    """Return the absolute derivatives of the force along each axis with respect to the airspeed along this axis, N s/m.

    They are computed at airspeeds from -5 to 5 m/s.
    """
    rotors, wrench = RotorSpeed(*[PAPER_VEHICLE.max_rotor_speed] * 4), Wrench(8.0, 0.0, 0.0, 0.0)

    def force(air):
        return np.array(
            effect.parameters()
            .load(Flow(Vector(*air), Vector(*air), rotors, wrench, INITIAL_HEIGHT, PAPER_VEHICLE))
            .force
        )

    intervals = [(s - 1e-5, s) for s in np.linspace(-4.99, 5.0, 31)]
    return [abs((force(b * e) - force(a * e)) @ e) / (b - a) for e in np.eye(3) for a, b in intervals]


def check_member(name, kind):
    effect = example(name, kind)
    vehicle = with_effect(name, effect)
    assert isinstance(effect.parameters(), kind.record)
    assert has_constant_acceleration(name, effect) != kind.depends_on_time
    hovering = effect.in_hover()
    assert hovering is None or has_constant_acceleration(name, hovering)
    assert rotates_body(name, effect) == kind.couples_axes
    symmetric = effect.symmetric()
    assert symmetric is None or not rotates_body(name, symmetric)
    assert effect.event_times() == ((effect.time,) if "time" in kind.model_fields else ())
    if isinstance(effect, AirLoadEffect):
        assert max(slopes_along_axes_of(effect)) <= effect.max_damping(vehicle, 5.0) * (1.0 + 1e-6)
    else:
        assert effect.max_damping(vehicle, 5.0) == 0.0
    if not kind.depends_on_time:
        system, context = vehicle_in_hover(name, effect, time_step=0.0)
        ports = system.GetInputPort("rotor_speed_command").get_index(), system.GetOutputPort("state").get_index()
        matrix = FirstOrderTaylorApproximation(system, context, *ports).A()
        has_states = len(matrix) > NUM_STATES
        swings = np.abs(np.linalg.eigvals(matrix).imag).max() if has_states else 0.0
        assert swings == pytest.approx(effect.natural_frequency(vehicle), rel=1e-9, abs=1e-6)


def check_response(name, kind):
    """Assert that `AttitudeResponseQuadrotor` rejects an effect exactly if the effect is declared as unsupported.

    The only exception is a rotor failure, which is declared as unsupported but is not rejected.
    """
    vehicle = with_effect(name, example(name, kind))
    effects = vehicle.effect_parameters()
    response = AttitudeResponse(NaturalFrequencies(6.8, 6.4, 3.1), DampingRatios(0.5, 0.7, 1.1))
    config = AttitudeResponseConfig(QuadrotorConfig(PAPER_VEHICLE, effects=effects), response)
    allowed = name not in vehicle.effects_unsupported_by_response()
    try:
        AttitudeResponseQuadrotor(effects=effects.names, parameters=config)
    except ValueError as error:
        assert not allowed
        assert name in str(error)
    else:
        assert allowed or name == "rotor_failure", "an identified response models the rotation of the vehicle"


@pytest.mark.parametrize(("name", "kind"), EFFECTS.members.items(), ids=[*EFFECTS.members])
def test_declarations_of_every_effect_agree_with_the_simulated_motion(name, kind):
    """An effect declares whether it changes in hover, whether it couples the axes, and how fast it oscillates."""
    check_member(name, kind)
    check_response(name, kind)


def test_a_user_s_effect_is_checked_like_a_shipped_one(ceiling_effect):
    check_member("ceiling", ceiling_effect)
    check_response("ceiling", ceiling_effect)


def test_forces_that_depend_on_the_height_change_within_a_step(ceiling_effect):
    """The height of a rising vehicle agrees with that of an integrator with error control."""
    effect, rows_at_the_end = ceiling_effect(rotor_radius=0.3, height=0.8), []
    for time_step in (0.01, 0.0):
        vehicle, context = vehicle_in_hover("ceiling", effect, time_step=time_step)
        simulator = Simulator(vehicle, context)
        simulator.get_mutable_integrator().set_target_accuracy(1e-11)
        simulator.AdvanceTo(0.3 + 1e-9)  # just after the last update
        rows_at_the_end.append(vehicle.GetOutputPort("state").Eval(context)[[2, 8]])
    assert rows_at_the_end[0][1] > 0.05
    np.testing.assert_allclose(*rows_at_the_end, rtol=1e-7)


def hover(**changes):
    fields = {"rotor_radius": {"uniform": {"min": 0.1, "max": 0.3}}, "height": 1.3, **changes}
    return load_scenario("hover", {"duration": 1.0, "vehicle.ceiling": fields})


@pytest.mark.slow
def test_a_user_s_effect_flies_uncompiled_and_compiled(ceiling_effect):
    """The acceleration in the first step follows from the thrust that the ceiling adds."""
    batch = Batch.draw(hover(), range(2))
    for flight, radius in zip(assert_flown_alike(batch), batch.varying["vehicle.ceiling.rotor_radius"], strict=True):
        gained = 9.81 * (0.25 * radius / 0.3) ** 2
        assert flight.record("state").v_z[1] == pytest.approx(0.02 * gained, rel=1e-3)


@pytest.mark.long
def test_a_user_s_effect_is_part_of_the_language(ceiling_effect):
    EFFECTS.remove("ceiling")
    original_scenario = load_scenario("hover")
    with pytest.raises(InputError, match="called 'ceiling.rotor_radius'"):
        declaration_of("ceiling.rotor_radius")
    EFFECTS.register(ceiling_effect)
    assert declaration_of("ceiling.rotor_radius").unit == "m"
    assert original_scenario.vehicle.effects() == {}
    assert nominal_hover(original_scenario).vehicle.effects() == {}
    assert "CeilingEffect" in file_schema()["$defs"]
    assert "[CeilingEffect](#ceilingeffect)" in language_page()
    assert in_hover(hover(rotor_radius=0.1)).vehicle.effects() == {}
    assert nominal_hover(hover(rotor_radius=0.1)).vehicle.effects() == {}
    with pytest.raises(InputError, match=r"vehicle.ceiling.rotor_radius is -0.1, but must be at least 0"):
        hover(rotor_radius=-0.1)
    EFFECTS.remove("ceiling")
    assert "CeilingEffect" not in file_schema()["$defs"]
    with pytest.raises(InputError, match="vehicle.ceiling is unknown"):
        hover()


def test_an_effect_with_missing_attributes_is_refused(ceiling_effect):
    class IncompleteEffect(VehicleEffect):
        description: ClassVar = ""
        record: ClassVar = ceiling_effect.record
        is_nominal: ClassVar = False

    class EffectWithoutSlope(AirLoadEffect):
        field: ClassVar = "steep"
        description: ClassVar = ""
        record: ClassVar = ceiling_effect.record
        is_nominal: ClassVar = False
        depends_on_time: ClassVar = False
        couples_axes: ClassVar = False
        belongs_to_airframe: ClassVar = False

    class EffectNamedBattery(ceiling_effect):
        field: ClassVar = "battery"

    class EffectNamedMass(ceiling_effect):
        field: ClassVar = "mass"

    with pytest.raises(
        TypeError, match="IncompleteEffect must define field and depends_on_time and couples_axes and belongs"
    ):
        EFFECTS.register(IncompleteEffect)
    with pytest.raises(TypeError, match="EffectWithoutSlope must define max_damping"):
        EFFECTS.register(EffectWithoutSlope)
    with pytest.raises(ValueError, match="the name battery of .* is taken by BatteryEffect"):
        EFFECTS.register(EffectNamedBattery)
    with pytest.raises(ValueError, match="the name mass of .* is taken by another field"):
        EFFECTS.register(EffectNamedMass)
    with pytest.raises(TypeError, match="dict must extend VehicleEffect"):
        EFFECTS.register(dict)
