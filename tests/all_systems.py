"""Examples of all systems: every FleetSystem class, and every diagram that a function of the package builds."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from pydrake.common import RandomDistribution

from drake_quad.control.attitude import AttitudeController, AttitudeParameters
from drake_quad.control.cascade import build_cascade
from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorParameters
from drake_quad.control.disturbance.laws import AdaptiveLaw, IncrementalLaw, KalmanLaw, KalmanMemory
from drake_quad.control.disturbance.response import AxisCommand
from drake_quad.control.disturbance.tilt import TiltDisturbanceEstimator, TiltEstimatorParameters
from drake_quad.control.fuzzy.adaptation import AdaptationRates
from drake_quad.control.fuzzy.inference import Antecedents, CircularSets, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, LearningLimits, SignLaw
from drake_quad.control.fuzzy.set_learning import AdaptationParameters, SetLearning
from drake_quad.control.fuzzy.systems import (
    FuzzyRules,
    FuzzyRulesParameters,
    Lead,
    LearningParameters,
    WeightLearning,
    build_fuzzy_network,
)
from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeParameters,
)
from drake_quad.control.incremental_attitude import IncrementalAttitudeController, IncrementalAttitudeParameters
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.lqg.chains import AttitudeChain, TorqueChain, VerticalChain
from drake_quad.control.lqg.design import AxisLoop, Regulator
from drake_quad.control.lqg.laws import LqgParameters, TargetParameters, ThrustParameters, TorqueParameters
from drake_quad.control.lqg.system import LinearQuadraticGaussian
from drake_quad.control.mpc.constraints import Corridor, Preview
from drake_quad.control.mpc.system import PredictiveProgramme
from drake_quad.control.pid_cascade.parameters import (
    AccelerationParameters,
    CascadeParameters,
    CascadeRules,
    PidLoopGains,
    TiltParameters,
)
from drake_quad.control.pid_cascade.system import PidCascade
from drake_quad.control.policy.actions import (
    AccelerationScale,
    AttitudeScale,
    PerRotor,
    RatesScale,
    SpeedScale,
    ThrustRange,
)
from drake_quad.control.policy.actuation import (
    AccelerationActuation,
    AttitudeActuation,
    OffboardRateActuation,
    OnboardRateActuation,
    RotorSpeedActuation,
)
from drake_quad.control.policy.network import Dense, Gru, Network
from drake_quad.control.policy.observation import ObservationParameters, ObservationSpec
from drake_quad.control.policy.systems import Observation, Policy, build_policy_control
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringParameters
from drake_quad.estimation.complementary_filter import ComplementaryFilter, ComplementaryParameters, TimeConstants
from drake_quad.estimation.corrections import HeightAiding, PositionAiding
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.framework.symbols import Matrix
from drake_quad.geometry.axes import BodyAxes, Vector
from drake_quad.geometry.per_axis import PerAngle, PerAxis
from drake_quad.laboratory.command_link import CommandLink, LinkParameters
from drake_quad.laboratory.flight_monitor import FlightMonitor
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.motion_capture import CameraParameters, MotionCapture, VelocityDrift, VelocityError
from drake_quad.laboratory.sensors.accelerometer import (
    ACCELEROMETER,
    AccelerometerParameters,
    SensorPosition,
    SpecificForce,
)
from drake_quad.laboratory.sensors.barometer import (
    BAROMETER,
    BarometerErrors,
    BarometerParameters,
    GroundPressure,
    HeightDrift,
)
from drake_quad.laboratory.sensors.gauss_markov import Correlation
from drake_quad.laboratory.sensors.gnss import (
    GNSS,
    GnssErrors,
    GnssParameters,
    Multipath,
    PositionDeviation,
    PositionDrift,
    VelocityDeviation,
)
from drake_quad.laboratory.sensors.gyroscope import GYROSCOPE, GyroscopeParameters
from drake_quad.laboratory.sensors.inertial import BiasInstability, InertialErrors, LowPass, WarmUp
from drake_quad.laboratory.sensors.magnetometer import (
    MAGNETOMETER,
    EarthField,
    MagneticField,
    MagnetometerErrors,
    MagnetometerParameters,
    MotorInterference,
    SoftIron,
)
from drake_quad.laboratory.sensors.optical_flow import OPTICAL_FLOW, OpticalFlowParameters
from drake_quad.laboratory.sensors.range_finder import RANGE_FINDER, RangeFinderParameters
from drake_quad.laboratory.sensors.sensor import (
    FaultKind,
    FaultySensor,
    Sensor,
    SensorFault,
    build_sensors,
    error_names,
)
from drake_quad.laboratory.sensors.uwb_range import UWB_RANGE, Anchor, Outliers, UwbErrors, UwbParameters
from drake_quad.laboratory.sensors.vibration import Responses, RotorAngles, Vibration
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, PerDirection, Turbulence, TurbulenceParameters
from drake_quad.laboratory.wind.fans import Direction, Fans, Jet, Outlet
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.laboratory.wind.sine import SineParameters, SineWind
from drake_quad.laboratory.wind.wind import SteadyWind, build_held_wind, build_wind
from drake_quad.pid.filters import butterworth, first_order
from drake_quad.pid.loop import Derivative, Integral, Terms
from drake_quad.randomness.noise import NoiseSource, Stream, TickByTick, random_streams
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.reference.plan import Plan
from drake_quad.reference.source import build_reference
from drake_quad.signals import (
    Attitude,
    AttitudeTarget,
    BodyRates,
    EstimateDeviation,
    Jerk,
    Reference,
    Snap,
    State,
    Wind,
    Wrench,
)
from drake_quad.vehicle.aerodynamics import (
    BodyDrag,
    CentreOfPressure,
    GroundEffect,
    LinearDrag,
    QuadraticDrag,
    RotorAerodynamics,
)
from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.attitude_response import (
    AttitudeResponse,
    AttitudeResponseConfig,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.autopilot import (
    AttitudeAutopilot,
    AutopilotParameters,
    Gyroscope,
    LoopAxisTerms,
    LoopGains,
    LoopRules,
    ThrustOnly,
)
from drake_quad.vehicle.battery import Battery
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors
from drake_quad.vehicle.motors import SpinDown, ThrottleAllocation, ThrottleModel, ThrustCurve
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.payload import Payload, PayloadPosition
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotor, Rotors
from drake_quad.vehicle.slung_load import SlungLoad


class Example(NamedTuple):
    """Example of a FleetSystem.

    Attributes:
        system: class of the system.
        parameters: parameters of the system, all different, nonzero and finite; None if the system has none.
        structure: arguments of the constructor that determine the ports and events.
        num_vehicles: number N of vehicles.
        has_all_ports: whether the example has all ports that its class can have.
    """

    system: Any
    parameters: Any = None
    structure: Mapping[str, Any] = MappingProxyType({})
    num_vehicles: int = 1
    has_all_ports: bool = True

    def make(self) -> Any:
        return self.make_with(self.parameters)

    def make_with(self, parameters: Any) -> Any:
        """Return the system with the given parameters, or with no parameters if they are None."""
        given = {} if parameters is None else {"parameters": parameters}
        return self.system(num_vehicles=self.num_vehicles, **self.structure, **given)

    @property
    def flat_parameters(self) -> list[Any]:
        """Parameters of the example as a flat list of numbers; empty if the system has none."""
        if self.parameters is None or isinstance(self.parameters, Samples):
            return []
        return layout_of(type(self.parameters), self.parameters).flatten(self.parameters)

    @property
    def is_compiled(self) -> bool:
        """True if the system can be compiled, since it has no continuous state and solves no optimisation problem."""
        return self.structure.get("time_step") != 0.0 and self.system is not PredictiveProgramme

    @property
    def other_parameters(self) -> Any:
        """Parameters whose numbers all differ from those of the example, and between vehicles."""
        if self.parameters is None:
            return None
        if isinstance(self.parameters, Samples):
            return Samples(self.parameters.seed + 1, [sample + 10 for sample in self.parameters.indices])
        layout = layout_of(type(self.parameters), self.parameters)
        growth = 1.1 + 0.05 * np.arange(self.num_vehicles)
        # Each row is multiplied by a different factor, so that ratios of rows differ from those of the example, too.
        rows = [(growth + 0.01 * i) * row for i, row in enumerate(layout.flatten(self.parameters))]
        return layout.build([float(row[0]) for row in rows] if self.num_vehicles == 1 else rows)


PD_GAINS = PdGains(PerAxis(1.3, 1.0, 5.0), PerAxis(1.5, 1.2, 3.2))
PD_ATTITUDE = AttitudeParameters(PerAngle(17.0, 14.0, 5.0), PerAngle(7.5, 6.8, 3.1), 0.0065, 0.0085, 0.0126)
INCREMENTAL_ATTITUDE = IncrementalAttitudeParameters(PD_ATTITUDE, IncrementalLaw(6.1), 0.07, 41.0)
AXIS_LAGS = (AxisCommand(0.21, 0.06), AxisCommand(0.23, 0.07), AxisCommand(0.05, 0.04))
START_POSITION = PerAxis(0.3, -0.2, 1.1)
KALMAN_ESTIMATOR = EstimatorParameters(
    (
        KalmanLaw(0.4, KalmanMemory(0.31, 2.2, 5.1)),
        KalmanLaw(0.5, KalmanMemory(0.33, 2.4, 5.3)),
        KalmanLaw(0.6, KalmanMemory(0.36, 2.7, 5.6)),
    ),
    AXIS_LAGS,
    4.1,
    START_POSITION,
)
ADAPTIVE_ESTIMATOR = EstimatorParameters(
    (AdaptiveLaw(1.2, 2.1), AdaptiveLaw(1.3, 2.5), AdaptiveLaw(1.4, 3.7)), AXIS_LAGS, 4.2, START_POSITION
)
INCREMENTAL_ESTIMATOR = EstimatorParameters(
    (IncrementalLaw(4.1), IncrementalLaw(4.6), IncrementalLaw(5.3)), AXIS_LAGS, 4.3, START_POSITION
)
TILT_ESTIMATOR = TiltEstimatorParameters(ADAPTIVE_ESTIMATOR.laws, 0.06, 9.79, 4.4, START_POSITION)
THRUST_VECTORING = VectoringParameters(0.68, 9.81, ThrustLimits(0.7, 2.0, 12.0))
VEHICLE = QuadrotorConfig(
    QuadrotorParameters(
        mass=0.74,
        inertia=Inertia(0.0071, 0.0079, 0.0131),
        rotor_inertia=9.0e-5,
        rotors=Rotors(
            Rotor(0.161, 0.012, 0.021, -1.0, 4.15e-5, 1.0e-6),
            Rotor(-0.014, -0.168, 0.017, 1.0, 4.02e-5, 1.1e-6),
            Rotor(-0.172, 0.009, 0.025, -1.0, 4.17e-5, 0.9e-6),
            Rotor(0.011, 0.158, 0.019, 1.0, 4.12e-5, 1.05e-6),
        ),
        gravity=9.8,
        linear_drag=0.12,
        quadratic_drag=0.02,
        rotor_time_constant=0.04,
        min_rotor_speed=70.0,
        max_rotor_speed=290.0,
        centre_of_mass=CentreOfMass(-0.003, 0.008),
    ),
    RotorFaults(0.01, 5.0, SpeedFactors(0.9, 0.8, 0.7, 0.6)),
    HoverPose(1.0, 2.0, 3.0, 0.4),
)
EFFECTS = Effects(
    BodyDrag(LinearDrag(0.11, 0.12, 0.13), QuadraticDrag(0.021, 0.022, 0.023), CentreOfPressure(0.031, 0.032, 0.033)),
    RotorAerodynamics(0.041, 0.14, 1.1e-4, 1.2e-4),
    GroundEffect(0.15, -0.4),
    ReactionTorque(9.1e-5),
    SpinDown(0.05),
)
VEHICLE_WITH_EFFECTS = VEHICLE._replace(
    effects=EFFECTS._replace(
        battery=Battery(12.5, 10.1, 1.3, 0.03, 0.71),
        slung_load=SlungLoad(0.16, 0.77),
    )
)
VEHICLE_WITH_THROTTLE = VEHICLE_WITH_EFFECTS._replace(
    effects=VEHICLE_WITH_EFFECTS.effects._replace(thrust_curve=ThrustCurve(0.1, 0.9, 3.1))
)
VEHICLE_WITH_PAYLOAD = VEHICLE._replace(
    effects=EFFECTS._replace(
        payload=Payload(0.17, PayloadPosition(0.034, 0.035, 0.036), Inertia(1.1e-4, 1.2e-4, 1.3e-4), 0.9, 1.9)
    )
)
TURBULENCE = TurbulenceParameters(Turbulence(PerDirection(1.1, 0.9, 0.7), PerDirection(20.0, 22.0, 3.0), 5.0), 0.7)
JETS = (
    Jet(Outlet(0.5, -2.0, 1.0), Direction(0.6, 0.64, 0.48), 6.0, 0.7, 0.2),
    Jet(Outlet(-1.5, 2.5, 0.8), Direction(-0.6, -0.48, 0.64), 5.0, 0.8, 0.25),
)
GUST = GustParameters(Wind(1.0, 2.0, 3.0), 1.1, 2.2, 3.3)
CAMERA_PARAMETERS = CameraParameters(
    1e-3,
    4e-3,
    0.1,
    Attitude(0.1, 0.2, 0.3),
    100.0,
    2.0,
    VelocityError(0.05, -0.1, 0.2),
    VelocityDrift(0.03, 0.02, 0.01),
    0.4,
)
WRENCH_LINK = LinkParameters(2.0, 0.1, Wrench(6.0, 0.1, 0.2, 0.3))
ATTITUDE_LINK = LinkParameters(2.0, 0.1, AttitudeTarget(6.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
AUTOPILOT = AutopilotParameters(
    LoopGains(6.0, 5.5, 2.8),
    LoopGains(14.0, 12.0, 9.0),
    Inertia(0.0065, 0.0085, 0.0126),
    Gyroscope(0.004, BodyRates(0.01, -0.02, 0.03)),
    0.002,
    Wrench(6.6, 0.1, 0.2, 0.3),
)


def _terms(scale: float) -> tuple[Terms, Terms, Terms]:
    """Return PID terms of three axes, with coefficients that all differ."""
    first, second, third = (
        Terms(
            Integral(scale * k, 0.7 * scale * k, 3.1 + k),
            Derivative(0.02 * scale * k, butterworth(90.0 + k, 0.005)),
            0.03 * scale * k,
            1.5 * scale * k,
        )
        for k in (1.1, 1.3, 1.7)
    )
    return first, second, third


def _with_first_order_filter(terms: Terms) -> Terms:
    lag = first_order(55.0, 0.005)
    # No parameter of an example may be zero, so the zero coefficients of a first-order filter are replaced.
    low_pass = lag._replace(b_1=1e-3, b_2=2e-3, a_2=3e-3)
    return Terms(Integral(terms.integral.k_i, terms.integral.limit), Derivative(terms.derivative.k_d, low_pass))


PID_AUTOPILOT = AUTOPILOT._replace(
    attitude=LoopAxisTerms(*_terms(1.2)),
    rate=LoopAxisTerms(*_terms(21.0)),
    gyroscope_filter=butterworth(130.0, 0.0025),
    max_rates=BodyRates(3.1, 3.3, 2.2),
)
PX4_AUTOPILOT = AUTOPILOT._replace(
    rate=LoopAxisTerms(*map(_with_first_order_filter, _terms(22.0))), max_rates=BodyRates(3.2, 3.4, 2.1), yaw_weight=0.4
)
TILT_CASCADE = CascadeParameters(
    PidLoopGains(PerAxis(2.1, 1.9, 2.3), _terms(0.4)),
    PidLoopGains(PerAxis(0.43, 0.41, 5.7), _terms(0.2)),
    0.3,
    0.7,
    9.79,
    TiltParameters(6.1, 2.2, 11.0),
)
ACCELERATION_CASCADE = CascadeParameters(
    PidLoopGains(PerAxis(0.95, 0.93, 1.1)),
    PidLoopGains(PerAxis(1.8, 1.7, 4.1), tuple(map(_with_first_order_filter, _terms(0.6)))),
    0.9,
    0.71,
    9.78,
    AccelerationParameters(0.8, 1.2, 0.7, 0.5, 0.6, 2.1, 11.5, 3.3),
)
ATTITUDE_RESPONSE_VEHICLE = AttitudeResponseConfig(
    VEHICLE, AttitudeResponse(NaturalFrequencies(6.8, 6.4, 3.1), DampingRatios(0.5, 0.7, 1.1))
)
ANTECEDENTS = Antecedents(
    1.4,
    0.6,
    0.3,
    (FuzzySets(1.8, (-1.0, 0.1, 1.2), (1.1, 0.9, 1.3)), FuzzySets(0.7, (-0.9, 0.2, 0.8), (1.2, 1.0, 1.4))),
)
CIRCULAR_ANTECEDENTS = ANTECEDENTS._replace(
    inputs=(ANTECEDENTS.inputs[0], CircularSets(1.3, (-0.1, 0.4, 0.8), (0.5, 0.6, 0.7)))
)
LEARNING_LIMITS = LearningLimits(0.9, 0.01, 0.02)
NOISE_SAMPLES = Samples(3, (5, 6))
RANDOM_STREAMS = (
    Stream("here", StreamKind.WIND, 3, RandomDistribution.kGaussian, 0.01),
    Stream("there", StreamKind.NOISE, 1, RandomDistribution.kUniform, 0.02),
)
ALL_CAMERA_ERRORS = {
    "noisy": True,
    "loses_frames": True,
    "misaligned": True,
    "velocity_scaled": True,
    "filtered": True,
    "drifts": True,
    "longest_latency": 2,
}
ACCELEROMETER_PARAMETERS = AccelerometerParameters(
    SensorPosition(0.03, -0.02, 0.05), 9.79, SpecificForce(0.1, -0.2, 0.15), 0.07, 2.0
)
ACCELEROMETER_STRUCTURE = {"name": "accelerometer", "law": ACCELEROMETER}
VIBRATION = Vibration(
    tuple(
        Responses(*(Vector(*(1e-6 * (3.0 * i + j + k + 0.5) for k in range(3))) for j in range(3))) for i in range(4)
    ),
    (0.11, 0.12, 0.13),
    RotorAngles(0.4, 1.4, 2.4, 2.9),
    0.01,
)
INERTIAL_ERRORS = InertialErrors(
    scale_error=Vector(0.01, 0.02, -0.03),
    misalignment=BodyAxes.of(0.021, -0.034, 0.055),
    bandwidth=LowPass.of(61.0, 0.01),
    bias_instability=BiasInstability(0.071, Correlation.of(0.9, 0.01)),
    bias_random_walk=0.013,
    temperature_coefficient=WarmUp(Vector(0.31, -0.22, 0.17), 0.19),
    vibration=VIBRATION,
    full_scale=8.6,
    resolution=1.7e-3,
)
FAULTY_ACCELEROMETER = FaultySensor(
    ACCELEROMETER_PARAMETERS._replace(errors=INERTIAL_ERRORS), SensorFault(0.015, 0.055, 0.6)
)
FAULTY_ACCELEROMETER_STRUCTURE = {
    **ACCELEROMETER_STRUCTURE,
    "noisy": True,
    "errors": InertialErrors._fields,
    "fault": FaultKind(is_reported=True, is_random=True),
}
SENSOR_POSITION = SensorPosition(0.04, -0.03, 0.06)
OTHER_SENSORS = {
    "gyroscope": (GYROSCOPE, GyroscopeParameters(BodyRates(0.02, -0.01, 0.03), 0.07, 1.0, INERTIAL_ERRORS)),
    "barometer": (
        BAROMETER,
        BarometerParameters(
            SENSOR_POSITION,
            0.21,
            0.31,
            1.0,
            BarometerErrors(HeightDrift(0.41, Correlation.of(0.7, 0.01)), 0.0123, GroundPressure(0.51, 0.61)),
        ),
    ),
    "magnetometer": (
        MAGNETOMETER,
        MagnetometerParameters(
            EarthField(0.2, 0.3, -0.4),
            MagneticField(0.011, 0.012, 0.013),
            0.05,
            1.0,
            MagnetometerErrors(
                SoftIron(0.021, -0.022, 0.023, 0.024, 0.025, -0.026),
                MotorInterference(Vector(0.031, 0.032, 0.033), (0.34, 0.35, 0.36, 0.37)),
            ),
        ),
    ),
    "gnss": (
        GNSS,
        GnssParameters(
            SENSOR_POSITION,
            PositionDeviation(0.11, 0.12, 0.13),
            VelocityDeviation(0.014, 0.015, 0.016),
            1.0,
            GnssErrors(
                PositionDrift(PositionDeviation(0.21, 0.22, 0.23), Correlation.of(0.8, 0.01)),
                Multipath(PositionDeviation(0.31, 0.32, 0.33), 0.5),
            ),
        ),
    ),
    "range_finder": (RANGE_FINDER, RangeFinderParameters(SENSOR_POSITION, 0.07, 0.25, 0.95, 0.02, 0.08, 0.09, 1.0)),
    "optical_flow": (
        OPTICAL_FLOW,
        OpticalFlowParameters(SENSOR_POSITION, 0.07, 0.25, 0.95, 1.6, 0.08, 0.09, 1.0),
    ),
    "uwb_range": (
        UWB_RANGE,
        UwbParameters(Anchor(1.1, -0.9, 2.1), SENSOR_POSITION, 2.3, 0.08, 0.09, 1.0, UwbErrors(Outliers(0.5, 0.41))),
    ),
}
LOSSY_LINK = {"longest_delay": 3, "loses_packets": True}


THRUST_RANGE = ThrustRange(2.0, 12.0)
RATES_SCALE = RatesScale(THRUST_RANGE, BodyRates(5.0, 4.0, 2.0), PerAngle(10.0, 9.0, 3.0), 0.0065, 0.0085, 0.0126)
SPEED_SCALE = SpeedScale(
    60.0,
    300.0,
    PerRotor(
        Wrench(4.1e-5, 1.1e-6, -7.0e-6, 1.3e-6),
        Wrench(4.2e-5, -7.1e-6, 1.2e-6, -1.4e-6),
        Wrench(4.3e-5, 1.5e-6, 7.2e-6, 1.6e-6),
        Wrench(4.4e-5, 7.3e-6, 1.7e-6, -1.8e-6),
    ),
)
OBSERVATION_PARAMETERS = ObservationParameters(290.0, (0.1, -0.2, 0.3))
OBSERVATION_SPEC = ObservationSpec(
    ("position_error", "rotation", "reference_ahead", "rotor_speed", "wind", "action"), "body", 3, 0.4
)
HEADING_OBSERVATION = {"spec": ObservationSpec(("velocity", "rotation"), "reference_heading"), "num_actions": 3}
ACCELERATION_SCALE = AccelerationScale(5.0, 4.0, 3.0)
OBSERVATION_STRUCTURE = {"spec": OBSERVATION_SPEC, "num_actions": 3, "num_ahead": 2}


def _network_of(inputs, outputs) -> Network:
    """Return a network with a layer of each type."""
    rng = np.random.default_rng(inputs)

    def matrix(rows, columns) -> Matrix:
        return Matrix(rng.normal(size=(rows, columns)), rng.normal(size=rows))

    layers = (
        Dense(matrix(5, inputs), "tanh"),
        Gru(matrix(12, 5), matrix(12, 4), (0.1, 0.2, 0.3, 0.4)),
        Dense(matrix(outputs, 4)),
    )
    return Network(layers, inputs, (0.1,) * inputs, (0.9,) * inputs, 3.0)


def _loop(kind, measured, delay, seed) -> AxisLoop:
    """Return the control loop of one axis, with coefficients that all differ.

    Args:
        kind: record type of the loop's state.
        measured: number of measured quantities.
        delay: delay of the command, ticks.
        seed: seed of the coefficients.
    """
    rng = np.random.default_rng(seed)

    def rows() -> Any:
        return kind(*rng.uniform(0.01, 0.2, len(kind._fields)).tolist())

    A = tuple(rows() for _ in kind._fields)
    L = tuple(rows() for _ in range(measured))
    return AxisLoop(A, rows(), L, rows(), tuple(rng.uniform(0.1, 0.3, delay).tolist()), 1.7 + 0.1 * seed)


NOMINAL_THRUST = ThrustParameters(0.68, 9.81, 0.7, 2.0, 12.0, 0.07)
TORQUE_LQG = LqgParameters(
    _loop(TorqueChain, 2, 2, 1),
    _loop(VerticalChain, 1, 2, 2),
    NOMINAL_THRUST,
    TorqueParameters(0.0065, 0.0085, 0.0126, 5.0, 3.1, 400.0, 0.09),
    None,
)
TARGET_LQG = LqgParameters(
    _loop(AttitudeChain, 2, 1, 3), _loop(VerticalChain, 1, 1, 4), NOMINAL_THRUST, None, TargetParameters(0.2, 0.03)
)


def _regulator(loop: AxisLoop) -> Regulator:
    """Return a stable regulator for the states of a loop, with coefficients that all differ."""
    count = len(loop.K) + len(loop.K_pending)
    rng = np.random.default_rng(count)
    A = np.eye(count) * 0.7 + rng.uniform(0.0, 0.2 / count, (count, count))
    B, K = rng.uniform(0.1, 0.2, count), rng.uniform(0.01, 0.1, count)
    return Regulator(tuple(map(tuple, A.tolist())), tuple(B.tolist()), tuple(K.tolist()), 0.3)


MPC_STRUCTURE: dict[str, Any] = {
    "nominal": TORQUE_LQG,
    "lateral": _regulator(TORQUE_LQG.lateral),
    "vertical": _regulator(TORQUE_LQG.vertical),
    "preview": (
        Preview(
            Reference(*[0.1 * i for i in range(11)]), Jerk(0.1, 0.2, 0.3), Snap(0.1, 0.2, 0.3, 0.4), Snap(*[0.0] * 4)
        ),
    ),
    "num_ticks": 4,
    "corridor": Corridor(PerAxis(-0.3, -0.4, -np.inf), PerAxis(0.2, np.inf, 0.1), follows_reference=True, weight=20.0),
}
TARGET_REGULATORS = {"lateral": _regulator(TARGET_LQG.lateral), "vertical": _regulator(TARGET_LQG.vertical)}
GROUND_EFFECT = Effects(ground_effect=GroundEffect(0.11, 0.05))
FILTER = FilterParameters(
    InertialNoise(0.011, 0.12, 0.0013, 0.0014),
    EstimateDeviation(*(0.3 + 0.02 * np.arange(15)).tolist()),
    (AidingParameters(PositionAiding(0.21, 0.22, 0.23), 24.0, 6.0, Vector(0.11, -0.12, 0.13)),),
    initial_yaw=0.34,
    gravity=9.79,
    imu=Vector(0.02, 0.03, -0.04),
)
FILTER_STRUCTURE: dict[str, Any] = {
    "aiding": (Aiding("position", "position", 4, can_miss=True, latency=1),),
    "period": 0.002,
    "block_samples": 2,
}
COMPLEMENTARY_FILTER = ComplementaryParameters(
    TimeConstants(1.1, 7.2, 0.53, 0.24, 0.35), (PositionAiding(0.21, 0.22, 0.23),), initial_yaw=0.34, gravity=9.79
)
COMPLEMENTARY_STRUCTURE = {"aiding": (Aiding("position", "position", 4, can_miss=True),), "period": 0.002}
FILTER_OF_TWO = FILTER._replace(aiding=(*FILTER.aiding, AidingParameters(HeightAiding(0.31), 21.0, 7.0)))
FILTER_OF_TWO_STRUCTURE = {
    **FILTER_STRUCTURE,
    "aiding": (*FILTER_STRUCTURE["aiding"], Aiding("height", "height", 2)),  # its readings wait for the position
}

FLEET_SYSTEMS = [
    Example(Allocation, RotorModel.of(VEHICLE.parameters)),
    Example(Allocation, RotorModel.of(VEHICLE.parameters), {"paired": True, "priority": "thrust"}, num_vehicles=2),
    Example(AttitudeAutopilot, AUTOPILOT, {"noisy": True}, num_vehicles=2),
    Example(AttitudeAutopilot, AUTOPILOT, {"period": 0.005}, has_all_ports=False),
    Example(
        AttitudeAutopilot, PID_AUTOPILOT, {"rules": LoopRules(False, True, True)}, num_vehicles=2, has_all_ports=False
    ),
    Example(AttitudeAutopilot, PX4_AUTOPILOT, has_all_ports=False),
    Example(AttitudeController, PD_ATTITUDE),
    Example(Broadcast, structure={"num_rows": 2}, num_vehicles=3),
    Example(CommandLink, WRENCH_LINK, LOSSY_LINK, num_vehicles=2),
    Example(ErrorStateKalmanFilter, FILTER, FILTER_STRUCTURE, num_vehicles=2),
    Example(ComplementaryFilter, COMPLEMENTARY_FILTER, COMPLEMENTARY_STRUCTURE, num_vehicles=2),
    Example(ErrorStateKalmanFilter, FILTER_OF_TWO, FILTER_OF_TWO_STRUCTURE, has_all_ports=False),
    Example(CommandLink, WRENCH_LINK, has_all_ports=False),
    Example(AccelerationActuation, ACCELERATION_SCALE, {"frame": "reference_heading", "turn": -0.7}, num_vehicles=2),
    Example(AccelerationActuation, ACCELERATION_SCALE, has_all_ports=False),
    Example(AttitudeActuation, AttitudeScale(THRUST_RANGE, 0.6, 0.5), num_vehicles=2),
    Example(OffboardRateActuation, RATES_SCALE, num_vehicles=2),
    Example(OnboardRateActuation, RATES_SCALE, num_vehicles=2),
    Example(RotorSpeedActuation, SPEED_SCALE, {"order": (2, 0, 3, 1)}, num_vehicles=2),
    Example(Observation, OBSERVATION_PARAMETERS, OBSERVATION_STRUCTURE, num_vehicles=2),
    Example(Observation, OBSERVATION_PARAMETERS, HEADING_OBSERVATION, has_all_ports=False),
    Example(Policy, structure={"network": _network_of(7, 3)}, num_vehicles=2),
    Example(
        CommandLink, ATTITUDE_LINK, {"signal": "attitude_target", **LOSSY_LINK}, num_vehicles=2, has_all_ports=False
    ),
    Example(
        CommandLink,
        WRENCH_LINK._replace(delay_ticks=np.array([3.0, 1.0])),
        LOSSY_LINK,
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(DisturbanceEstimator, KALMAN_ESTIMATOR, {"delay_ticks": 2}),
    Example(DisturbanceEstimator, ADAPTIVE_ESTIMATOR, {"delay_ticks": 1}, num_vehicles=2),
    Example(DisturbanceEstimator, INCREMENTAL_ESTIMATOR, num_vehicles=2),
    Example(DrydenTurbulence, TURBULENCE, num_vehicles=2),
    Example(Fans, JETS, num_vehicles=2),
    Example(Fans, JETS),
    Example(FlightMonitor),
    Example(FlightMonitor, num_vehicles=3),
    Example(FuzzyRules, FuzzyRulesParameters((ANTECEDENTS,), Lead(0.13)), {"leads": True}, num_vehicles=2),
    Example(
        FuzzyRules,
        FuzzyRulesParameters((CIRCULAR_ANTECEDENTS,)),
        {"inputs": ("z", "phase"), "lap_times": (0.0, 3.0, 7.0)},
        has_all_ports=False,
    ),
    Example(GeometricAttitudeController, PD_ATTITUDE),
    Example(GeometricAttitudeController, PD_ATTITUDE, {"transports": False}, num_vehicles=2),
    Example(Gust, GUST),
    Example(IncrementalAttitudeController, INCREMENTAL_ATTITUDE, {"delay_ticks": 1}),
    Example(IncrementalAttitudeController, INCREMENTAL_ATTITUDE, num_vehicles=2),
    Example(SineWind, SineParameters(Wind(1.0, 2.0, 3.0), 1.1, 2.2)),
    Example(IntegralCorrection, IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6), num_vehicles=2),
    Example(IntegralCorrection, IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6), {"integration": "backward_euler"}),
    Example(IntegratingAttitudeController, IntegratingAttitudeParameters(PD_ATTITUDE, PerAngle(9.0, 7.0, 5.0), 3.0)),
    Example(
        IntegratingAttitudeController,
        IntegratingAttitudeParameters(PD_ATTITUDE, PerAngle(9.0, 7.0, 5.0), 3.0),
        {"period": 0.01, "integration": "backward_euler", "transports": False},
        num_vehicles=2,
    ),
    Example(
        LinearQuadraticGaussian, TORQUE_LQG, {"takes_correction": True, "takes_perturbation": True}, num_vehicles=2
    ),
    Example(
        LinearQuadraticGaussian,
        TORQUE_LQG,
        {"takes_correction": True, "loses_frames": True},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(LinearQuadraticGaussian, TARGET_LQG, {"signal": "attitude_target", "period": 0.005}, has_all_ports=False),
    Example(MotionCapture, CAMERA_PARAMETERS, ALL_CAMERA_ERRORS, num_vehicles=2),
    Example(MotionCapture, CAMERA_PARAMETERS, ALL_CAMERA_ERRORS),
    Example(MotionCapture, CAMERA_PARAMETERS, has_all_ports=False),
    Example(NoiseSource, NOISE_SAMPLES, {"streams": RANDOM_STREAMS}, num_vehicles=2),
    Example(
        PidCascade, TILT_CASCADE, {"num_ticks": 5, "tick": 0.002, "rules": CascadeRules(True, True)}, num_vehicles=2
    ),
    Example(PidCascade, ACCELERATION_CASCADE),
    Example(PidCascade, ACCELERATION_CASCADE, {"rules": CascadeRules(decouples_vertical=False)}, num_vehicles=2),
    Example(PredictiveProgramme, structure=MPC_STRUCTURE, num_vehicles=2),
    Example(PredictiveProgramme, structure={**MPC_STRUCTURE, "nominal": TARGET_LQG, **TARGET_REGULATORS}),
    Example(ProportionalDerivative, PD_GAINS, {"feeds_forward": True}),
    Example(Quadrotor, VEHICLE, {"faulty": True}, has_all_ports=False),
    Example(Quadrotor, VEHICLE_WITH_EFFECTS, {"faulty": True, "effects": VEHICLE_WITH_EFFECTS.effects.names}),
    Example(
        Quadrotor,
        VEHICLE_WITH_THROTTLE,
        {"time_step": 0.0, "effects": VEHICLE_WITH_THROTTLE.effects.names},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(
        Quadrotor,
        VEHICLE_WITH_PAYLOAD,
        {"effects": VEHICLE_WITH_PAYLOAD.effects.names},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(Quadrotor, VEHICLE, num_vehicles=2, has_all_ports=False),
    Example(
        Quadrotor,
        VEHICLE,
        {"time_step": 0.0, "kinematics": "small_angle", "faulty": True},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(AttitudeResponseQuadrotor, ATTITUDE_RESPONSE_VEHICLE, {"faulty": True}),
    Example(
        AttitudeResponseQuadrotor,
        ATTITUDE_RESPONSE_VEHICLE._replace(vehicle=ATTITUDE_RESPONSE_VEHICLE.vehicle._replace(effects=GROUND_EFFECT)),
        {"effects": ("ground_effect",)},
    ),
    Example(
        AttitudeResponseQuadrotor,
        ATTITUDE_RESPONSE_VEHICLE,
        {"time_step": 0.0, "kinematics": "small_angle"},
        num_vehicles=2,
    ),
    Example(
        Sensor,
        ACCELEROMETER_PARAMETERS,
        {**ACCELEROMETER_STRUCTURE, "noisy": True, "longest_latency": 2},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(Sensor, FAULTY_ACCELEROMETER, {**FAULTY_ACCELEROMETER_STRUCTURE, "longest_latency": 2}, num_vehicles=2),
    Example(Sensor, ACCELEROMETER_PARAMETERS, ACCELEROMETER_STRUCTURE, has_all_ports=False),
    Example(SteadyWind, Wind(0.7, -0.5, 0.3), num_vehicles=2),
    Example(
        TickByTick, structure={"stream": RANDOM_STREAMS[0], "period": 4.0 * RANDOM_STREAMS[0].period}, num_vehicles=2
    ),
    Example(
        ThrottleAllocation,
        ThrottleModel(RotorModel.of(VEHICLE.parameters), 4.2e-5, ThrustCurve(0.1, 0.9, 3.1)),
    ),
    Example(ThrustOnly),
    Example(ThrustVectoring, THRUST_VECTORING),
    Example(ThrustVectoring, THRUST_VECTORING, {"projects": True}, num_vehicles=2),
    Example(ThrustVectoring, THRUST_VECTORING, {"projects": True, "sequence": "zxy"}, num_vehicles=2),
    Example(TiltDisturbanceEstimator, TILT_ESTIMATOR, {"delay_ticks": 2}),
    Example(TiltDisturbanceEstimator, TILT_ESTIMATOR, num_vehicles=2),
    Example(
        WeightLearning,
        LearningParameters(1.4, CovarianceLaw(0.8, 5.0, 0.997), LEARNING_LIMITS, 0.05),
        {"axes": ("x", "z"), "num_rules": 4, "reset_times": (1.0, 2.0), "leads": True},
        num_vehicles=2,
    ),
    Example(
        SetLearning,
        AdaptationParameters(
            (ANTECEDENTS, ANTECEDENTS._replace(a1=1.7)),
            AdaptationRates(0.3, 0.2, 0.1),
            LearningParameters(1.4, GradientLaw(0.4), LEARNING_LIMITS, 0.05),
        ),
        {"axes": ("x", "z")},
        num_vehicles=2,
    ),
    Example(WeightLearning, LearningParameters(1.4, GradientLaw(0.4), LEARNING_LIMITS, 0.05), has_all_ports=False),
    Example(
        WeightLearning,
        LearningParameters(1.4, SignLaw(0.4, 0.2), LEARNING_LIMITS, 0.05),
        num_vehicles=2,
        has_all_ports=False,
    ),
]


SENSOR_EXAMPLES = [
    Example(
        Sensor,
        parameters,
        {
            "name": name,
            "law": law,
            "noisy": True,
            "longest_latency": 1,
            "errors": error_names(parameters),
        },
        num_vehicles=2,
        has_all_ports=False,
    )
    for name, (law, parameters) in OTHER_SENSORS.items()
]
"""Examples of all kinds of sensors except for the accelerometer, with all errors."""


def _policy_control() -> Any:
    spec = ObservationSpec(("position_error", "body_rates"))
    return build_policy_control(
        observation=Observation(
            spec=spec, num_actions=4, parameters=ObservationParameters(290.0, (0.1, 0.2, 0.3, 0.4))
        ),
        policy=Policy(network=_network_of(6, 4)),
        actuation=OffboardRateActuation(parameters=RATES_SCALE),
    )


def _cascade() -> Any:
    return build_cascade(
        position=build_position_controller(ProportionalDerivative(parameters=PD_GAINS)),
        thrust_vectoring=ThrustVectoring(parameters=THRUST_VECTORING),
        attitude=AttitudeController(parameters=PD_ATTITUDE),
        feed_forward="snap",
    )


def _corrected_pid() -> Any:
    """Return a PID controller with all optional ports: those of the integral and of the correction."""
    integral = IntegralCorrection(parameters=IntegralGains(PerAxis(0.3, 0.2, 1.5), 0.6))
    return build_position_controller(
        ProportionalDerivative(parameters=PD_GAINS), integral=integral, takes_correction=True
    )


def _network() -> Any:
    learning = LearningParameters(initial_weight=0.5)
    return build_fuzzy_network(
        rules=FuzzyRules(num_vehicles=2, leads=True),
        learning=WeightLearning(num_vehicles=2, leads=True, parameters=learning),
    )


def _sources() -> dict[str, Any]:
    return {
        "dryden_0": DrydenTurbulence(num_vehicles=2, parameters=TURBULENCE),
        "fans": Fans(num_vehicles=2, parameters=JETS),
    }


def _wind() -> Any:
    sources = _sources()
    return build_wind(sources, streams=random_streams(sources, StreamKind.WIND), num_vehicles=2)


def _sensors() -> Any:
    sensors = {
        "accelerometer": Sensor(num_vehicles=2, **FAULTY_ACCELEROMETER_STRUCTURE, parameters=FAULTY_ACCELEROMETER)
    }
    streams = random_streams(sensors, StreamKind.NOISE)
    return build_sensors(sensors, streams=streams, available=[*ACCELEROMETER.reads, "rotor_speed"])


def _laboratory() -> Any:
    return build_laboratory(
        vehicle=Quadrotor(num_vehicles=2),
        allocation=Allocation(num_vehicles=2),
        motion_capture=MotionCapture(num_vehicles=2, **ALL_CAMERA_ERRORS, parameters=CAMERA_PARAMETERS),
        command_link=CommandLink(num_vehicles=2, **LOSSY_LINK, parameters=WRENCH_LINK),
        wind=_sources(),
        samples=NOISE_SAMPLES,
    )


def _position_wind(state: State) -> Wind:
    return Wind(0.1 * state.x, 0.2 * state.y, 0.3 * state.z)


@fleet_system(float, AutoDiffXd)
class PositionWind(FleetSystem):
    """User-defined wind that depends on the position."""

    def declare(self) -> None:
        self.output("wind", _position_wind, self.input("state"))


DIAGRAMS: list[tuple[Callable[..., Any], Callable[[], Any]]] = [
    (build_cascade, _cascade),
    (build_fuzzy_network, _network),
    (build_held_wind, lambda: build_held_wind(PositionWind(), period=0.01)),
    (build_laboratory, _laboratory),
    (build_policy_control, _policy_control),
    (build_position_controller, _corrected_pid),
    (build_sensors, _sensors),
    (build_wind, _wind),
    (
        build_reference,
        lambda: build_reference(Plan.hover([0.0, 0.0, 1.0], duration=1.0), num_vehicles=2, ahead=[0.2, 0.5]),
    ),
]

SYSTEMS = [(each.system, each.make) for each in FLEET_SYSTEMS if each.has_all_ports] + DIAGRAMS
"""Classes and functions with a port block in their docstring, each with a function that makes a complete example."""
