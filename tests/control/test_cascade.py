"""Tests of the cascade as a diagram: its connections and its outputs."""

import math

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad.control.attitude import AttitudeController, AttitudeParameters
from drake_quad.control.cascade import POSITION_SIGNALS, build_cascade
from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorParameters
from drake_quad.control.disturbance.laws import IncrementalLaw
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets, firing_strengths
from drake_quad.control.fuzzy.set_learning import SetLearning
from drake_quad.control.fuzzy.systems import FuzzyRules, FuzzyRulesParameters, Lead, WeightLearning, build_fuzzy_network
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringParameters
from drake_quad.geometry.per_axis import PerAngle, PerAxis
from drake_quad.signals import Acceleration, Attitude, Jerk, Reference, Snap, State, Torque, Wrench

GAINS = PdGains(PerAxis(1.3, 1.0, 5.0), PerAxis(1.5, 1.2, 3.2))  # 1/s² and 1/s, for X, Y and Z
VECTORING_PARAMETERS = VectoringParameters(
    mass=0.7, gravity=9.79, limits=ThrustLimits(tan_max_tilt=math.tan(0.4), min_thrust=3.0, max_thrust=12.0)
)
ATTITUDE_PARAMETERS = AttitudeParameters(
    k_p=PerAngle(17.0, 14.0, 5.0), k_d=PerAngle(7.5, 6.8, 3.1), i_xx=0.0065, i_yy=0.0085, i_zz=0.0126
)
INPUTS = {
    "measurement": State(
        x=0.3, y=-0.2, z=1.1, roll=0.05, pitch=-0.04, yaw=0.6, v_x=0.2, v_y=-0.1, v_z=0.3, p=0.2, q=-0.3, r=0.1
    ),
    "reference": Reference(
        x=0.5, y=0.1, z=1.0, v_x=0.4, v_y=-0.2, v_z=0.1, a_x=0.3, a_y=0.2, a_z=-0.1, yaw=0.8, yaw_rate=0.25
    ),
    "reference_jerk": Jerk(0.6, -0.7, 0.4),
    "reference_snap": Snap(-1.1, 0.9, 0.5, 0.3),
}


def cascade(feed_forward, position=None, network=None):
    position = position or build_position_controller(ProportionalDerivative(feeds_forward=True, parameters=GAINS))
    thrust_vectoring, attitude = (
        ThrustVectoring(parameters=VECTORING_PARAMETERS),
        AttitudeController(parameters=ATTITUDE_PARAMETERS),
    )
    return build_cascade(
        position=position,
        network=network,
        thrust_vectoring=thrust_vectoring,
        attitude=attitude,
        feed_forward=feed_forward,
    )


def output_of(system, **inputs):
    """Return the only output of a system for the signals in `INPUTS`."""
    context = system.CreateDefaultContext()
    for name, rows in inputs.items():
        system.GetInputPort(name).FixValue(context, rows)
    return system.get_output_port().Eval(context)


def port_names(system):
    inputs = [system.get_input_port(i).get_name() for i in range(system.num_input_ports())]
    return inputs, [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]


@pytest.mark.parametrize("feed_forward", ["none", "acceleration", "jerk", "snap"])
def test_cascade_outputs_equal_the_outputs_of_its_parts_in_sequence(feed_forward):
    """Each part is evaluated separately, with outputs of the previous parts and the inputs that are fed forward."""
    control = cascade(feed_forward)
    given = {name: rows for name, rows in INPUTS.items() if control.HasInputPort(name)}
    assert ("reference_jerk" in given, "reference_snap" in given) == (
        feed_forward in ("jerk", "snap"),
        feed_forward == "snap",
    )
    context = control.CreateDefaultContext()
    for name, rows in given.items():
        control.GetInputPort(name).FixValue(context, rows)

    def output(name):
        return control.GetOutputPort(name).Eval(context)

    measurement, reference = INPUTS["measurement"], INPUTS["reference"]
    pd = ProportionalDerivative(feeds_forward=True, parameters=GAINS)
    *_, command, fed = output_of(pd, measurement=measurement, reference=reference).reshape(4, 3)
    np.testing.assert_allclose(output("acceleration_command"), command + fed, rtol=1e-14)
    vectored = output_of(ThrustVectoring(parameters=VECTORING_PARAMETERS), acceleration_command=command + fed, **given)
    thrust, attitude, rates, accelerations = np.split(vectored, [1, 4, 7])
    assert np.any(rates[:2] != 0.0) == (feed_forward in ("jerk", "snap"))
    assert np.any(accelerations != 0.0) == (feed_forward == "snap")
    np.testing.assert_allclose(output("attitude_command"), attitude, rtol=1e-14)
    torque = output_of(
        AttitudeController(parameters=ATTITUDE_PARAMETERS),
        measurement=measurement,
        attitude_command=attitude,
        body_rate_command=rates,
        angular_acceleration_command=accelerations,
    )
    np.testing.assert_allclose(output("wrench"), [*thrust, *torque], rtol=1e-14)


def test_the_thrust_at_rest_on_the_reference_is_the_nominal_weight():
    control = cascade("snap")
    context = control.CreateDefaultContext()
    for name, rows in INPUTS.items():
        control.GetInputPort(name).FixValue(context, 0.0 * np.array(rows))
    wrench = Wrench(*control.GetOutputPort("wrench").Eval(context))
    assert wrench == pytest.approx(Wrench(0.7 * 9.79, 0.0, 0.0, 0.0), abs=1e-15)


def test_outputs_of_the_position_controller_are_outputs_of_the_cascade():
    common_outputs = ["wrench", "acceleration_command", "attitude_command"]
    pd_outputs = ["error", "error_rate", "pd", "correction"]
    pd = ProportionalDerivative(parameters=GAINS)
    assert port_names(cascade("none")) == (["measurement", "reference"], common_outputs + pd_outputs)
    network = build_fuzzy_network(rules=FuzzyRules(adaptive=True), learning=WeightLearning(), sets=SetLearning())
    estimator_numbers = EstimatorParameters(
        (IncrementalLaw(3.0),) * 3, (AxisCommand(0.1, 0.1),) * 3, 1.0, PerAxis(0.0, 0.0, 0.0)
    )
    corrected = build_position_controller(
        pd, disturbance=DisturbanceEstimator(parameters=estimator_numbers), takes_correction=True
    )
    assert port_names(cascade("snap", corrected, network)) == ([*INPUTS], [*common_outputs, *POSITION_SIGNALS])
    integral = IntegralCorrection(parameters=IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6))
    pid = build_position_controller(ProportionalDerivative(parameters=GAINS), integral=integral)
    assert port_names(cascade("jerk", pid)) == ([*INPUTS][:3], common_outputs + pd_outputs)


class Constant(LeafSystem):
    """Position controller with a constant command and no other outputs."""

    def __init__(self, command):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12))
        self.DeclareVectorInputPort("reference", BasicVector(11))
        self.DeclareVectorOutputPort(
            "acceleration_command", BasicVector(3), lambda context, output: output.SetFromVector(command)
        )


class Estimator(LeafSystem):
    """Controller with every output that a network can read, and with inputs for the outputs of a network."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12))
        self.DeclareVectorInputPort("reference", BasicVector(11))
        correction = self.DeclareVectorInputPort("correction", BasicVector(3))
        self.DeclareVectorInputPort("learned_disturbance", BasicVector(3))
        for index, name in enumerate(("error", "error_rate", "pd", "disturbance")):
            rows = 0.1 * (index + 1.0) * np.array([1.0, -2.0, 3.0])
            write_rows = lambda context, output, rows=rows: output.SetFromVector(rows)  # noqa: E731
            self.DeclareVectorOutputPort(name, BasicVector(3), write_rows, {self.nothing_ticket()})
        self.DeclareVectorOutputPort(
            "acceleration_command",
            BasicVector(3),
            lambda context, output: output.SetFromVector(-correction.Eval(context)),
            {self.input_port_ticket(correction.get_index())},
        )


def test_a_network_corrects_any_controller_and_reads_its_disturbance_estimate():
    """The network reads the estimated disturbance on each axis and the height. The command is its negative output."""
    inputs, sets = ("z", "disturbance"), Antecedents(1.3, 0.7, 0.4, (FuzzySets(0.6), FuzzySets(1.1)))
    learning = WeightLearning(learns_from="feedback")
    network = build_fuzzy_network(
        rules=FuzzyRules(inputs=inputs, parameters=FuzzyRulesParameters((sets,))), learning=learning
    )
    control = cascade("none", Estimator(), network)
    assert port_names(control)[0] == ["measurement", "reference"]
    context, weights = control.CreateDefaultContext(), np.linspace(-1.0, 1.0, 9)
    learning.set_state(learning.GetMyMutableContextFromRoot(context), "weights", (tuple(weights),) * 2)
    for name in ("measurement", "reference"):
        control.GetInputPort(name).FixValue(context, INPUTS[name])
    expected = [weights @ firing_strengths((1.1, disturbance), sets) for disturbance in (0.4, -0.8)]
    np.testing.assert_allclose(control.GetOutputPort("correction").Eval(context), [*expected, 0.0], rtol=1e-14)
    command = control.GetOutputPort("acceleration_command").Eval(context)
    np.testing.assert_allclose(command, [-expected[0], -expected[1], 0.0], rtol=1e-14)


@pytest.mark.parametrize("leads", [False, True])
def test_a_controller_receives_the_disturbance_learned_for_the_present_position(leads):
    """The correction of the command belongs to the position after the lead time, the disturbance to the current one."""
    lead, sets = 0.3, Antecedents(1.3, 0.7, 0.4, (FuzzySets(0.1, (-1.0, 0.2, 0.9)),))
    rules = FuzzyRules(inputs=("z",), leads=leads, parameters=FuzzyRulesParameters((sets,), Lead(lead)))
    learning, position = WeightLearning(num_rules=3, leads=leads), Estimator()
    control = cascade("none", position, build_fuzzy_network(rules=rules, learning=learning))
    context, weights = control.CreateDefaultContext(), (-1.0, 0.3, 0.8)
    learning.set_state(learning.GetMyMutableContextFromRoot(context), "weights", (weights,) * 2)
    for name in ("measurement", "reference"):
        control.GetInputPort(name).FixValue(context, INPUTS[name])
    position_context = position.GetMyContextFromRoot(context)
    received = {
        name: position.GetInputPort(name).Eval(position_context) for name in ("correction", "learned_disturbance")
    }
    z, v_z = INPUTS["measurement"].z, INPUTS["measurement"].v_z
    for name, ahead in (("correction", leads * lead), ("learned_disturbance", 0.0)):
        expected = np.dot(weights, firing_strengths((z + ahead * v_z,), sets))
        np.testing.assert_allclose(received[name], [expected, expected, 0.0], rtol=1e-14)
    assert v_z != 0.0


def test_the_cascade_accepts_any_position_controller():
    """Eq (7) and the attitude law need only the commanded acceleration of the position controller."""
    command = Acceleration(0.4, -0.3, 0.2)
    control = cascade("none", Constant(command))
    assert port_names(control) == (["measurement", "reference"], ["wrench", "acceleration_command", "attitude_command"])
    context = control.CreateDefaultContext()
    control.GetInputPort("measurement").FixValue(context, [0.0] * 12)
    control.GetInputPort("reference").FixValue(context, [0.0] * 11)
    up = command.z + 9.79
    thrust = math.hypot(command.x, command.y, up)
    attitude = Attitude(math.asin(-command.y / thrust), math.atan2(command.x, up), 0.0)
    np.testing.assert_allclose(control.GetOutputPort("attitude_command").Eval(context), attitude, rtol=1e-12)
    torque = Torque(0.0065 * 17.0 * attitude.roll, 0.0085 * 14.0 * attitude.pitch, 0.0)
    np.testing.assert_allclose(control.GetOutputPort("wrench").Eval(context), [0.7 * thrust, *torque], rtol=1e-12)
