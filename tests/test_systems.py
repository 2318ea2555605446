"""Every system: its port block tells the truth, and a copy is like the original."""

import inspect
import math
import re

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram

from drake_quad.control.attitude import AttitudeController
from drake_quad.control.cascade import build_cascade
from drake_quad.control.fuzzy.inference import Antecedents
from drake_quad.control.fuzzy.laws import CovarianceLaw
from drake_quad.control.fuzzy.systems import FuzzyRules, WeightLearning, build_fuzzy_network
from drake_quad.control.integral import IntegralCorrection
from drake_quad.control.position import ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring
from drake_quad.laboratory.command_link import CommandLink
from drake_quad.laboratory.flight_monitor import FlightMonitor
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.motion_capture import CameraErrors, IdealMotionCapture, MotionCapture
from drake_quad.laboratory.tape import Samples, Stream, Tape, TapePlayer
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, Turbulence
from drake_quad.laboratory.wind.fans import Fans, Jet
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.laboratory.wind.wind import build_held_wind, build_wind
from drake_quad.randomness import Kind
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import SameForAll, build_reference
from drake_quad.vehicle.allocation import Allocation
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.quadrotor import Quadrotor

GAINS = {"k_p": (1.0, 2.0, 3.0), "k_d": (1.0, 2.0, 3.0)}
VECTORING = {"mass": 0.68, "gravity": 9.81, "limits": ThrustLimits(0.7, 2.0, 12.0)}


def cascade():
    return build_cascade(
        position=build_position_controller(ProportionalDerivative(**GAINS)),
        thrust_vectoring=ThrustVectoring(**VECTORING),
        attitude=AttitudeController(**GAINS, inertia=(1.0, 1.0, 1.0)),
        feed_forward="snap",
    )


SAMPLES = Samples(0, (5, 6))
TURBULENCE = Turbulence.at_low_altitude(height=10.0, wind_at_20_feet=15.0, airspeed=5.0)
JET = Jet((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), exit_speed=6.0, diameter=0.7, turbulence=0.2)


def motion_capture():
    errors = CameraErrors(1e-3, 4e-3, dropout_rate=0.1, misalignment=(0.1, 0.2, 0.3))
    return MotionCapture(num_vehicles=2, errors=errors, derivative_bandwidth=100.0, latency_frames=2)


def network():
    return build_fuzzy_network(
        rules=FuzzyRules(num_vehicles=2), learning=WeightLearning(num_vehicles=2, initial_weight=0.5)
    )


def sources():
    return {"dryden_0": DrydenTurbulence(num_vehicles=2, turbulence=TURBULENCE), "fans": fans()}


def wind():
    return build_wind(sources(), num_vehicles=2)


def fans():
    return Fans(num_vehicles=2, jets=[JET, JET])


def fans_without_turbulence():
    return Fans(jets=[JET._replace(turbulence=0.0)])


def tape_player():
    stream = Stream("here", Kind.WIND, rows=3, distribution=RandomDistribution.kGaussian)
    return TapePlayer(num_vehicles=2, tapes=[Tape(SAMPLES, [stream], period=0.01)])


def laboratory():
    return build_laboratory(
        vehicle=Quadrotor(num_vehicles=2),
        allocation=Allocation(num_vehicles=2),
        motion_capture=motion_capture(),
        command_link=CommandLink(num_vehicles=2, delay_ticks=2, loss_rate=0.1),
        wind=sources(),
        samples=SAMPLES,
    )


SYSTEMS = [
    (Allocation, Allocation),
    (AttitudeController, lambda: AttitudeController(**GAINS, inertia=(1.0, 1.0, 1.0))),
    (CommandLink, lambda: CommandLink(num_vehicles=2, delay_ticks=3, loss_rate=0.1, initial=(1.0, 0.0, 0.0, 0.0))),
    (CommandLink, lambda: CommandLink(num_vehicles=2, delay_ticks=np.array([3.0, 1.0]), loss_rate=0.1)),
    (DrydenTurbulence, lambda: DrydenTurbulence(num_vehicles=2, turbulence=TURBULENCE)),
    (Fans, fans),
    (FlightMonitor, FlightMonitor),
    (FuzzyRules, lambda: FuzzyRules(num_vehicles=2, antecedents=Antecedents(1.4, 0.6, 0.3))),
    (Gust, lambda: Gust(gust=GustParameters((1.0, 2.0, 3.0), 1.0, 2.0))),
    (IntegralCorrection, lambda: IntegralCorrection(num_vehicles=2, k_i=(1.0, 2.0, 3.0), limit=2.0)),
    (IdealMotionCapture, IdealMotionCapture),
    (MotionCapture, motion_capture),
    (ProportionalDerivative, lambda: ProportionalDerivative(**GAINS, feed_forward=True)),
    (Quadrotor, lambda: Quadrotor(faults=RotorFaults(0.01, 5.0, (1.0, 0.0, 1.0, 1.0)))),
    (Quadrotor, lambda: Quadrotor(num_vehicles=2, initial_position=(1.0, 2.0, 3.0))),
    (Quadrotor, lambda: Quadrotor(time_step=0.0, kinematics="small_angle")),
    (SameForAll, lambda: SameForAll(num_vehicles=3, num_rows=2)),
    (TapePlayer, tape_player),
    (ThrustVectoring, lambda: ThrustVectoring(**VECTORING)),
    (
        WeightLearning,
        lambda: WeightLearning(num_vehicles=2, axes=("x", "z"), law=CovarianceLaw(1.0, 20.0), num_rules=4),
    ),
    (build_cascade, cascade),
    (build_fuzzy_network, network),
    (build_held_wind, lambda: build_held_wind(fans_without_turbulence(), period=0.01)),
    (build_laboratory, laboratory),
    (
        build_position_controller,
        lambda: build_position_controller(ProportionalDerivative(**GAINS, feed_forward=True)),
    ),
    (build_wind, wind),
    (build_reference, lambda: build_reference(Plan.hover([0.0, 0.0, 1.0], duration=1.0), num_vehicles=2)),
]
systems = pytest.mark.parametrize(("documented", "make"), SYSTEMS, ids=lambda value: getattr(value, "__name__", ""))


def documented_ports(docstring):
    """The names in the port block of a docstring, by direction."""
    block = docstring.split(".. pydrake_system::")[1]
    ports = {}
    for direction in ("input", "output"):
        found = re.search(rf"{direction}_ports:\n((?:\s*- [\w.]+\n)+)", block)
        ports[direction] = re.findall(r"- ([\w.]+)", found.group(1)) if found else []
    return ports


@systems
def test_the_port_block_names_the_ports(documented, make):
    system = make()
    ports = documented_ports(documented.__doc__)
    assert ports["input"] == [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]
    assert ports["output"] == [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]


@systems
def test_a_diagram_has_the_name_in_its_port_block(documented, make):
    system = make()
    if isinstance(system, Diagram):
        assert system.get_name() == re.search(r"name: (\w+)", documented.__doc__)[1]


@systems
def test_with_derivatives_the_values_are_the_same(documented, make):
    """All outputs, and the state after a tick, with any numbers at the inputs and as the state before."""
    system = make()
    converted = system.ToScalarType[AutoDiffXd]()
    contexts = system.CreateDefaultContext(), converted.CreateDefaultContext()
    rng = np.random.default_rng(0)
    for i in range(system.num_input_ports()):
        numbers = rng.uniform(0.1, 0.9, system.get_input_port(i).size())
        for each, context in zip((system, converted), contexts, strict=True):
            each.get_input_port(i).FixValue(context, numbers)
    for context in contexts:
        context.SetTime(1.2)
    if not isinstance(system, Diagram) and system.GetUniquePeriodicDiscreteUpdateAttribute():
        groups = range(contexts[0].num_discrete_state_groups())
        before = [rng.uniform(0.1, 0.9, contexts[0].get_discrete_state(group).size()) for group in groups]
        for context in contexts:
            for group, numbers in zip(groups, before, strict=True):
                context.SetDiscreteState(group, numbers)
        after = [
            each.EvalUniquePeriodicDiscreteUpdate(context)
            for each, context in zip((system, converted), contexts, strict=True)
        ]
        for group in groups:
            same_values(after[1].get_vector(group).CopyToVector(), after[0].get_vector(group).CopyToVector())
        changed = [(after[0].get_vector(group).CopyToVector() != before[group]).any() for group in groups]
        assert any(changed)
    for i in range(system.num_output_ports()):
        outputs = [each.get_output_port(i).Eval(context) for each, context in zip((system, converted), contexts)]
        same_values(outputs[1], outputs[0])


def same_values(with_derivatives, numbers):
    values = [getattr(value, "value", lambda value=value: value)() for value in with_derivatives]
    np.testing.assert_allclose(values, numbers, rtol=1e-12, atol=1e-12)


@systems
def test_converts_to_autodiff_with_the_same_ports_and_defaults(documented, make):
    system = make()
    converted = system.ToScalarType[AutoDiffXd]()
    assert converted.num_input_ports() == system.num_input_ports()
    for i in range(system.num_output_ports()):
        assert converted.get_output_port(i).size() == system.get_output_port(i).size()
    context, converted_context = system.CreateDefaultContext(), converted.CreateDefaultContext()
    assert converted_context.num_total_states() == context.num_total_states()
    for i in range(context.num_discrete_state_groups()):
        values = [value.value() for value in converted_context.get_discrete_state(i).CopyToVector()]
        assert values == list(context.get_discrete_state(i).CopyToVector())


DEFAULTS = {
    Allocation: {"rotors": (4.13e-5, 8.5e-7, 0.17, 60.0, 300.0)},
    AttitudeController: {},
    CommandLink: {"period": 0.02, "delay_ticks": 0, "longest_delay": None, "loss_rate": 0.0, "initial": (0.0,) * 4},
    DrydenTurbulence: {"period": 0.01, "heading": 0.0},
    Fans: {"period": 0.01},
    FlightMonitor: {"period": 0.02, "limits": (math.radians(80.0), 5.0, -0.5), "window": (0.0, math.inf)},
    FuzzyRules: {
        "axes": ("x", "y"),
        "antecedents": (1.2, 0.8, 0.5, *[(1.0, (-1.0, 0.0, 1.0), (1.0, 1.0, 1.0))] * 2),
    },
    Gust: {"period": 0.01},
    IntegralCorrection: {"period": 0.02},
    IdealMotionCapture: {"period": 0.01},
    MotionCapture: {
        "period": 0.01,
        "errors": (0.0, 0.0, 0.0, (0.0, 0.0, 0.0)),
        "derivative_bandwidth": None,
        "latency_frames": 0,
        "longest_latency": None,
    },
    ProportionalDerivative: {"derivative": "tracking_error", "feed_forward": False},
    Quadrotor: {
        "time_step": 0.01,
        "kinematics": "exact",
        "parameters": (
            *(0.68, (0.007, 0.007, 0.012), 6.5e-5, (4.13e-5,) * 4, 8.5e-7, 0.17, 9.81, 0.0, 0.0),
            *(0.05, 60.0, 300.0, (0.0, 0.0)),
        ),
        "faults": None,
        "initial_position": (0.0, 0.0, 0.0),
        "initial_yaw": 0.0,
    },
    SameForAll: {"num_rows": 1},
    TapePlayer: {},
    ThrustVectoring: {},
    WeightLearning: {
        "period": 0.02,
        "axes": ("x", "y"),
        "num_rules": 9,
        "slope": 1.0,
        "law": (1.0, 1.0, 1.0),
        "limits": (math.inf, 0.0, 0.0),
        "initial_weight": 0.0,
        "reset_times": (),
    },
}


@pytest.mark.parametrize("system", DEFAULTS, ids=lambda system: system.__name__)
def test_a_system_that_is_told_nothing_else_is_one_vehicle_s_at_the_periods_of_the_loop(system):
    """The vehicle's and the wind's is 10 ms, as is that of the cameras; commands and what learns have 20 ms."""
    parameters = inspect.signature(system.declared_by.declare).parameters.values()
    defaults = {each.name: each.default for each in parameters if each.default is not inspect.Parameter.empty}
    assert defaults == {"num_vehicles": 1, **DEFAULTS[system]}


def test_every_system_s_defaults_are_known():
    assert {documented for documented, _ in SYSTEMS if inspect.isclass(documented)} == DEFAULTS.keys()
