"""Every effect on the vehicle answers every question truthfully, and effects of one's own are equals."""

from typing import ClassVar, NamedTuple

import numpy as np
import pytest
from both_ways import assert_flown_alike
from pydantic import Field
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import Linearize

from drake_quad import InputError, load_scenario
from drake_quad.geometry.axes import Vector
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect, VehicleEffect
from drake_quad.scenario.hovering import as_believed, in_hover
from drake_quad.scenario.models import Vehicle
from drake_quad.scenario.quantities import NonNegative
from drake_quad.scenario.schema import file_schema, language_page
from drake_quad.signals import RotorSpeed, Row, State, Wrench
from drake_quad.vehicle.aerodynamics import Flow, Load
from drake_quad.vehicle.dynamics import hover_rotor_speeds
from drake_quad.vehicle.effects import as_in_hover
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Place, Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.responding import (
    AttitudeResponse,
    DampingRatios,
    NaturalFrequencies,
    RespondingNumbers,
    RespondingQuadrotor,
)

PAPER = QuadrotorParameters()
HEIGHT = 0.3
NUM_STATES = len(State._fields) + len(RotorSpeed._fields)
# Values of fields; other effects have 0.1 in the fields that must be given.
FIELDS = {
    "body_drag": {"linear": [0.1, 0.2, 0.3], "quadratic": [0.03, 0.01, 0.02], "centre_of_pressure": [0.01, 0.0, 0.03]},
    "rotor_aerodynamics": {"lift": 0.02, "climb": -0.1, "drag": 1e-4, "inflow": 2e-4},
    "ground_effect": {"rotor_radius": 0.2},
    "payload": {"mass": 0.1, "position": [0.02, 0.0, -0.05], "time": 0.1, "event": "picked_up"},
    "battery": {"voltage": 12.6, "empty_voltage": 10.2, "capacity": 0.01, "resistance": 0.02, "efficiency": 0.7},
    "slung_load": {"mass": 0.1, "length": 0.6},
    "rotor_failure": {"rotor": 2.0, "time": 0.1},
}


class Ceiling(NamedTuple):
    """Share of the thrust that rotors gain at a ceiling, and the height of the ceiling."""

    share: Row
    height: Row

    def load(self, flow: Flow) -> Load:
        """Return the thrust that the rotors gain, which decreases with the squared distance from the ceiling."""
        distance = 1.0 + self.height - flow.height
        gained = self.share * flow.wrench.thrust / (distance * distance)
        return Load(Vector(0.0, 0.0, gained), Vector(0.0, 0.0, 0.0))


class CeilingEffect(AirLoadEffect):
    """Thrust that rotors gain below a ceiling."""

    share: NonNegative = Field(description="share of the thrust at the ceiling (1)")
    height: NonNegative = Field(default=3.0, description="height of the ceiling (m)")
    field: ClassVar = "ceiling"
    meaning: ClassVar = "above the vehicle, if any"
    record: ClassVar = Ceiling
    is_believed: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = False

    def max_slope(self, vehicle, airspeed):
        """Return 0, since the load depends on the place only."""
        return 0.0


def ceiling():
    """Register the effect of this file during a test."""
    return EFFECTS.member(CeilingEffect)


def example(name, kind):
    required = {name: 0.1 for name, field in kind.model_fields.items() if field.is_required()}
    return kind.model_validate(FIELDS.get(name, required))


def with_effect(name, effect):
    return Vehicle(**{name: effect})


def built(name, effect, speed=0.0, time_step=0.01):
    """Return the paper's vehicle in hover with an effect, in a context with the rotor speeds of the start held."""
    effects = with_effect(name, effect).effect_numbers()
    faults = effect.numbers() if name == "rotor_failure" else RotorFaults()
    place = Place(0.0, 0.0, HEIGHT, 0.0)
    structure = {"effects": effects.names, "faulty": name == "rotor_failure", "time_step": time_step}
    vehicle = Quadrotor(**structure, numbers=QuadrotorNumbers(PAPER, faults, place, effects))
    context = vehicle.CreateDefaultContext()
    speeds = hover_rotor_speeds(as_in_hover(PAPER, effects, HEIGHT))
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, np.array(speeds))
    if speed:
        state = context.get_discrete_state(0).CopyToVector()
        state[6:9] = speed * np.array([1.0, -0.7, 0.5])
        context.SetDiscreteState(0, state)
    return vehicle, context


def flown(name, effect, speed=0.0):
    """Return the state after 0.4 s in which the rotor speeds of hover are commanded, from a velocity on."""
    vehicle, context = built(name, effect, speed)
    simulator = Simulator(vehicle, context)
    simulator.AdvanceTo(0.4)
    return vehicle.GetOutputPort("state").Eval(context)


def stays(name, effect):
    return np.abs(flown(name, effect)[6:]).max() < 1e-9


def couples(name, effect):
    return np.abs(flown(name, effect, speed=2.0)[9:12]).max() > 1e-9


def slopes_along_axes(effect):
    """Return the changes of the force on each axis with the airspeed along it, up to 5 m/s, N s/m."""
    rotors, wrench = RotorSpeed(*[PAPER.max_rotor_speed] * 4), Wrench(8.0, 0.0, 0.0, 0.0)

    def force(air):
        return np.array(effect.numbers().load(Flow(Vector(*air), Vector(*air), rotors, wrench, HEIGHT, PAPER)).force)

    ends = [(s - 1e-5, s) for s in np.linspace(-4.99, 5.0, 31)]
    return [abs((force(b * e) - force(a * e)) @ e) / (b - a) for e in np.eye(3) for a, b in ends]


def check_member(name, kind):
    effect = example(name, kind)
    vehicle = with_effect(name, effect)
    assert isinstance(effect.numbers(), kind.record)
    assert stays(name, effect) != kind.depends_on_time
    lasting = effect.in_hover()
    assert lasting is None or stays(name, lasting)
    assert couples(name, effect) == kind.couples_axes
    even = effect.symmetric()
    assert even is None or not couples(name, even)
    assert effect.event_times() == ((effect.time,) if "time" in kind.model_fields else ())
    if isinstance(effect, AirLoadEffect):
        assert max(slopes_along_axes(effect)) <= effect.max_slope(vehicle, 5.0) * (1.0 + 1e-6)
    else:
        assert effect.max_slope(vehicle, 5.0) == 0.0
    if not kind.depends_on_time:
        system, context = built(name, effect, time_step=0.0)
        ports = system.GetInputPort("rotor_speed_command").get_index(), system.GetOutputPort("state").get_index()
        matrix = Linearize(system, context, *ports).A()
        has_states = len(matrix) > NUM_STATES
        swings = np.abs(np.linalg.eigvals(matrix).imag).max() if has_states else 0.0
        assert swings == pytest.approx(effect.natural_frequency(vehicle), rel=1e-9, abs=1e-6)


def check_response(name, kind):
    """A vehicle that responds as a whole takes exactly the effects that the language allows beside a response."""
    vehicle = with_effect(name, example(name, kind))
    effects = vehicle.effect_numbers()
    response = AttitudeResponse(NaturalFrequencies(6.8, 6.4, 3.1), DampingRatios(0.5, 0.7, 1.1))
    numbers = RespondingNumbers(QuadrotorNumbers(PAPER, effects=effects), response)
    allowed = name not in vehicle.without_response()
    try:
        RespondingQuadrotor(effects=effects.names, numbers=numbers)
    except ValueError as error:
        assert not allowed
        assert name in str(error)
    else:
        assert allowed or name == "rotor_failure", "a response contains how the vehicle turns"


@pytest.mark.parametrize(("name", "kind"), EFFECTS.items(), ids=EFFECTS.names)
def test_every_effect_answers_truthfully(name, kind):
    """The vehicle with the effect stays in hover, turns and swings as the effect says."""
    check_member(name, kind)
    check_response(name, kind)


def test_an_effect_of_a_user_is_checked_like_ours():
    """It becomes stronger on the way to the ceiling, so the vehicle leaves its place."""
    check_member("ceiling", ceiling())
    check_response("ceiling", CeilingEffect)


def hover(**changes):
    ceiling = {"share": {"uniform": {"min": 0.1, "max": 0.3}}, **changes}
    return load_scenario("hover", {"duration": 1.0, "vehicle.ceiling": ceiling})


@pytest.mark.slow
def test_an_effect_of_a_user_flies_wired_and_compiled():
    """The thrust that it adds is missing in the command after the controller has settled."""
    ceiling()
    batch = Batch.draw(hover(height=1.0), range(2))
    assert_flown_alike(batch)
    vehicle = batch.fleet_scenario.vehicle
    assert vehicle.effect_numbers().loads[0].share.tolist() == batch.varying["vehicle.ceiling.share"].tolist()


@pytest.mark.slow
def test_an_effect_of_a_user_is_part_of_the_language():
    with pytest.raises(InputError, match="vehicle.ceiling is unknown"):
        hover()
    ceiling()
    assert "CeilingEffect" in file_schema()["$defs"]
    assert "| `share` |" in language_page()
    assert in_hover(hover(share=0.1)).vehicle.effects() == {}
    assert as_believed(hover(share=0.1)).vehicle.effects() == {}
    with pytest.raises(InputError, match=r"vehicle.ceiling.share is -0.1, but must be at least 0"):
        hover(share=-0.1)
    EFFECTS.remove("ceiling")
    assert "CeilingEffect" not in file_schema()["$defs"]
    with pytest.raises(InputError, match="vehicle.ceiling is unknown"):
        hover()


def test_an_effect_without_answers_is_refused():
    class Silent(VehicleEffect):
        meaning: ClassVar = ""
        record: ClassVar = Ceiling
        is_believed: ClassVar = False

    class Steep(AirLoadEffect):
        field: ClassVar = "steep"
        meaning: ClassVar = ""
        record: ClassVar = Ceiling
        is_believed: ClassVar = False
        depends_on_time: ClassVar = False
        couples_axes: ClassVar = False
        belongs_to_airframe: ClassVar = False

    class Taken(CeilingEffect):
        field: ClassVar = "battery"

    class OfTheVehicle(CeilingEffect):
        field: ClassVar = "mass"

    with pytest.raises(TypeError, match="Silent must define field and depends_on_time and couples_axes and belongs"):
        EFFECTS.member(Silent)
    with pytest.raises(TypeError, match="Steep must define max_slope"):
        EFFECTS.member(Steep)
    with pytest.raises(ValueError, match="there is another VehicleEffect called battery: BatteryEffect"):
        EFFECTS.member(Taken)
    with pytest.raises(ValueError, match="there is another field mass"):
        EFFECTS.member(OfTheVehicle)
    with pytest.raises(TypeError, match="dict must extend VehicleEffect"):
        EFFECTS.member(dict)
