"""Tests that unsuitable systems of a user are refused with a one-sentence message."""

import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, build_tracking_diagram, load_scenario, run_monte_carlo, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, Turbulence, TurbulenceParameters
from drake_quad.signals import Acceleration


class WithPorts(LeafSystem):
    """System with ports of given names and sizes."""

    def __init__(self, inputs, outputs):
        super().__init__()
        for name, size in inputs.items():
            self.DeclareVectorInputPort(name, BasicVector(size))
        for name, size in outputs.items():
            self.DeclareVectorOutputPort(name, BasicVector(size), lambda context, output: None)


INPUT_SIZES = {"measurement": 12, "reference": 11}  # numbers of components for one vehicle
OUTPUT_SIZES = {"acceleration_command": 3}  # numbers of components for one vehicle


@pytest.mark.parametrize(
    ("argument", "inputs", "outputs", "sentence"),
    [
        ("control", INPUT_SIZES, {"wrnch": 4}, "control must have the output port `wrench`, but has `wrnch`"),
        (
            "control",
            {"refrence": 11},
            {"wrench": 4},
            "has the input port `refrence`, but may only have `meas",
        ),
        ("control", INPUT_SIZES, {"wrench": 3}, "the port `wrench` of control must have 4 elements, but has 3"),
        (
            "position_controller",
            {**INPUT_SIZES, "measurement": 6},
            OUTPUT_SIZES,
            "`measurement` of position_controller must",
        ),
        (
            "position_controller",
            {"measurement": 12},
            OUTPUT_SIZES,
            "must have the input port `reference`, but has `mea",
        ),
        ("position_controller", INPUT_SIZES, {}, "must have the output port `acceleration_command`, but has none"),
        ("wind", {}, {"wind": 3, "gust": 3}, "wind must have a single output port, but has `wind`, `gust`"),
        ("wind", {"position": 3}, {"wind": 3}, "wind has the input port `position`, but may only have `state`"),
        ("wind", {}, {}, "wind must have a single output port, but has none"),
        ("wind", {"state": 6}, {"gust": 3}, "the port `state` of wind must have 12 elements, but has 6"),
        ("wind", {}, {"gust": 2}, "the port `gust` of wind must have 3 elements, but has 2"),
    ],
)
def test_the_message_about_an_unsuitable_port_names_the_port(diagrams, argument, inputs, outputs, sentence):
    with pytest.raises(InputError) as caught:
        build_tracking_diagram(load_scenario(diagrams / "hover.yaml"), **{argument: WithPorts(inputs, outputs)})
    assert sentence in str(caught.value)


def test_objects_that_are_not_systems_or_have_ports_of_the_wrong_size_are_refused(diagrams):
    scenario = load_scenario(diagrams / "hover.yaml")
    with pytest.raises(InputError, match="must be a Drake system, an object and not its class or a function that"):
        simulate(scenario, position_controller=WithPorts)
    with pytest.raises(InputError, match=r"^control must be a Drake system, .*, but is <lambda>\(n\)$"):
        simulate(scenario, control=lambda n: WithPorts(INPUT_SIZES, {"wrench": 4}))
    with pytest.raises(InputError, match="^wind must be a Drake system, but is an object of type dict$"):
        simulate(scenario, wind={})
    with pytest.raises(InputError, match="must have 12 elements for each of 3 vehicles, but has 12"):
        build_tracking_diagram(scenario, 3, position_controller=WithPorts(INPUT_SIZES, OUTPUT_SIZES))
    with pytest.raises(InputError, match="pass either control or position_controller, not both"):
        simulate(
            scenario,
            control=WithPorts(INPUT_SIZES, {"wrench": 4}),
            position_controller=WithPorts(INPUT_SIZES, OUTPUT_SIZES),
        )


def make_without_arguments():
    return WithPorts(INPUT_SIZES, OUTPUT_SIZES)


def make_with_gain(num_vehicles, gain):
    return WithPorts(INPUT_SIZES, OUTPUT_SIZES)


def make_nothing(num_vehicles):
    pass


def make_class(num_vehicles):
    return WithPorts


def make_function(num_vehicles):
    return make_nothing


def make_number(num_vehicles):
    return num_vehicles


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            make_without_arguments,
            r"position_controller must be a function of the number of vehicles .*, but is make_without_arguments\(\)$",
        ),
        (make_with_gain, r"position_controller must be a function .*, but is make_with_gain\(num_vehicles, gain\)$"),
        (make_nothing, r"position_controller must be a function .*, but make_nothing\(num_vehicles\) returns nothing$"),
        (
            make_class,
            r"position_controller must be .*, but make_class\(num_vehicles\) returns the class WithPorts and not an"
            r" object of it$",
        ),
        (make_function, r"position_controller must be .* returns make_nothing\(num_vehicles\)$"),
        (make_number, r"position_controller must be .* returns an object of type int$"),
        # `range` has no signature, so it is called with the number of vehicles.
        (range, r"position_controller must be .*, but range returns an object of type range$"),
    ],
)
def test_the_message_about_a_function_that_returns_no_system_shows_the_required_signature(diagrams, make, message):
    scenario = load_scenario(diagrams / "hover.yaml", ["duration=0.1"])
    with pytest.raises(InputError, match=message):
        run_monte_carlo(scenario, 2, position_controller=make, num_workers=1)
    with pytest.raises(InputError, match=message):
        StudyFleet(scenario, plan_route(scenario), 2, user_systems=UserSystems(position_controller=make))


def test_a_system_in_place_of_a_function_is_refused():
    words = r"^wind must be a function of the number of vehicles .*, but is an object of type WithPorts$"
    with pytest.raises(InputError, match=words):
        UserSystems(wind=WithPorts({}, {"wind": 3})).build(1)


class NamedPorts(FleetSystem):
    """Controller whose ports have the given names."""

    def declare(self, *, measured="measurement", output="acceleration_command"):
        reads = self.parameter("gains", lambda parameters: Acceleration(0.0, 0.0, 0.0)), self.input(measured)
        self.output(output, lambda gains, m: gains, *reads)


def test_a_misspelt_name_in_a_system_is_refused_with_close_matches():
    system_class = fleet_system(float)(NamedPorts)
    with pytest.raises(InputError, match=r"^there is no signal called 'measurment'; did you mean measurement\?$"):
        system_class(measured="measurment")
    with pytest.raises(InputError, match=r"'accel_command'; did you mean acceleration_command"):
        system_class(output="accel_command")
    system = system_class()
    context = system.CreateDefaultContext()
    assert system.get_parameter(context, "gains") == (0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"^there is no parameter called 'gain'; did you mean gains\?$"):
        system.get_parameter(context, "gain")
    with pytest.raises(InputError, match=r"^there is no group of the state called 'x'; there are none$"):
        system.set_state(context, "x", ())


def test_a_user_defined_wind_may_have_random_inputs(diagrams):
    turbulence = Turbulence.at_low_altitude(height=10.0, wind_at_20_feet=5.0, airspeed=5.0)
    scenario = load_scenario(diagrams / "hover.yaml", ["duration=1"])
    winds = [DrydenTurbulence(parameters=TurbulenceParameters(turbulence)) for _ in range(3)]
    flights = [simulate(scenario, seed=seed, wind=wind) for seed, wind in zip((0, 0, 1), winds, strict=True)]
    assert (flights[0]["wind"] == flights[1]["wind"]).all()
    assert abs(flights[0]["wind"] - flights[2]["wind"]).max() > 0.1


def test_a_system_of_another_diagram_is_refused():
    controller = WithPorts(INPUT_SIZES, OUTPUT_SIZES)
    scenario = load_scenario("laboratory:nominal")
    build_tracking_diagram(scenario, position_controller=controller)
    with pytest.raises(
        InputError, match=r"^position_controller is already part of another diagram; create a new object"
    ):
        build_tracking_diagram(scenario, position_controller=controller)


def test_further_outputs_of_a_control_may_stand_before_its_wrench(diagrams):
    control = WithPorts(INPUT_SIZES, {"error": 2, "wrench": 4})
    build_tracking_diagram(load_scenario(diagrams / "hover.yaml"), control=control)
