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
from drake_quad.firmware.pilot import PilotParameters, StickPilot
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
from drake_quad.vehicle.downwash import DownwashParameters
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors
from drake_quad.vehicle.motors import SpinDown, ThrottleAllocation, ThrottleModel, ThrustCurve
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.payload import Payload, PayloadPosition
from drake_quad.vehicle.quadrotor import HoverPose, Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotor, Rotors
from drake_quad.vehicle.slung_load import SlungLoad
from drake_quad.worlds.downwash import Downwash
from drake_quad.worlds.proximity import Proximity, Radii


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
        """True if the system can be compiled: it has no continuous state and solves no optimisation problem."""
        return self.structure.get("time_step") != 0.0 and self.system is not PredictiveProgramme

    @property
    def other_parameters(self) -> Any:
        """Parameters that all differ from those of the example, and between vehicles."""
        if self.parameters is None:
            return None
        if isinstance(self.parameters, Samples):
            return Samples(self.parameters.seed + 1, [sample + 10 for sample in self.parameters.indices])
        layout = layout_of(type(self.parameters), self.parameters)
        growth = 1.1 + 0.05 * np.arange(self.num_vehicles)
        # Each parameter has a different factor, so that ratios of parameters also differ from those of the example.
        rows = [(growth + 0.01 * i) * row for i, row in enumerate(layout.flatten(self.parameters))]
        return layout.build([float(row[0]) for row in rows] if self.num_vehicles == 1 else rows)


PD_GAINS = PdGains(PerAxis(1.3, 1.0, 5.0), PerAxis(1.5, 1.2, 3.2))  # 1/s² and 1/s, for X, Y and Z
PD_ATTITUDE = AttitudeParameters(
    k_p=PerAngle(17.0, 14.0, 5.0), k_d=PerAngle(7.5, 6.8, 3.1), i_xx=0.0065, i_yy=0.0085, i_zz=0.0126
)
INCREMENTAL_ATTITUDE = IncrementalAttitudeParameters(
    attitude=PD_ATTITUDE, law=IncrementalLaw(6.1), lag=0.07, limit=41.0
)
AXIS_LAGS = (AxisCommand(0.21, 0.06), AxisCommand(0.23, 0.07), AxisCommand(0.05, 0.04))
START_POSITION = PerAxis(0.3, -0.2, 1.1)  # m
KALMAN_ESTIMATOR = EstimatorParameters(
    laws=(
        KalmanLaw(time_constant=0.4, gain=KalmanMemory(position=0.31, velocity=2.2, disturbance=5.1)),
        KalmanLaw(time_constant=0.5, gain=KalmanMemory(position=0.33, velocity=2.4, disturbance=5.3)),
        KalmanLaw(time_constant=0.6, gain=KalmanMemory(position=0.36, velocity=2.7, disturbance=5.6)),
    ),
    lags=AXIS_LAGS,
    limit=4.1,
    start=START_POSITION,
)
ADAPTIVE_ESTIMATOR = EstimatorParameters(
    laws=(
        AdaptiveLaw(adaptation=1.2, bandwidth=2.1),
        AdaptiveLaw(adaptation=1.3, bandwidth=2.5),
        AdaptiveLaw(adaptation=1.4, bandwidth=3.7),
    ),
    lags=AXIS_LAGS,
    limit=4.2,
    start=START_POSITION,
)
INCREMENTAL_ESTIMATOR = EstimatorParameters(
    laws=(IncrementalLaw(4.1), IncrementalLaw(4.6), IncrementalLaw(5.3)),
    lags=AXIS_LAGS,
    limit=4.3,
    start=START_POSITION,
)
TILT_ESTIMATOR = TiltEstimatorParameters(
    laws=ADAPTIVE_ESTIMATOR.laws, lag=0.06, gravity=9.79, limit=4.4, start=START_POSITION
)
THRUST_VECTORING = VectoringParameters(
    mass=0.68, gravity=9.81, limits=ThrustLimits(tan_max_tilt=0.7, min_thrust=2.0, max_thrust=12.0)
)
VEHICLE = QuadrotorConfig(
    QuadrotorParameters(
        mass=0.74,
        inertia=Inertia(0.0071, 0.0079, 0.0131),
        rotor_inertia=9.0e-5,
        rotors=Rotors(
            Rotor(x=0.161, y=0.012, z=0.021, direction=-1.0, thrust_factor=4.15e-5, drag_factor=1.0e-6),
            Rotor(x=-0.014, y=-0.168, z=0.017, direction=1.0, thrust_factor=4.02e-5, drag_factor=1.1e-6),
            Rotor(x=-0.172, y=0.009, z=0.025, direction=-1.0, thrust_factor=4.17e-5, drag_factor=0.9e-6),
            Rotor(x=0.011, y=0.158, z=0.019, direction=1.0, thrust_factor=4.12e-5, drag_factor=1.05e-6),
        ),
        gravity=9.8,
        linear_drag=0.12,
        quadratic_drag=0.02,
        rotor_time_constant=0.04,
        min_rotor_speed=70.0,
        max_rotor_speed=290.0,
        centre_of_mass=CentreOfMass(-0.003, 0.008),
    ),
    RotorFaults(battery_sag=0.01, failure_time=5.0, failure_factor=SpeedFactors(0.9, 0.8, 0.7, 0.6)),
    HoverPose(1.0, 2.0, 3.0, 0.4),
)
EFFECTS = Effects(
    BodyDrag(LinearDrag(0.11, 0.12, 0.13), QuadraticDrag(0.021, 0.022, 0.023), CentreOfPressure(0.031, 0.032, 0.033)),
    RotorAerodynamics(lift=0.041, climb=0.14, drag=1.1e-4, inflow=1.2e-4),
    GroundEffect(rotor_radius=0.15, ground_height=-0.4),
    ReactionTorque(9.1e-5),
    SpinDown(0.05),
)
VEHICLE_WITH_EFFECTS = VEHICLE._replace(
    effects=EFFECTS._replace(
        battery=Battery(voltage=12.5, empty_voltage=10.1, capacity=1.3, resistance=0.03, efficiency=0.71),
        slung_load=SlungLoad(mass=0.16, length=0.77),
    )
)
VEHICLE_WITH_THROTTLE = VEHICLE_WITH_EFFECTS._replace(
    effects=VEHICLE_WITH_EFFECTS.effects._replace(thrust_curve=ThrustCurve(0.1, 0.9, 3.1))
)
VEHICLE_WITH_PAYLOAD = VEHICLE._replace(
    effects=EFFECTS._replace(
        payload=Payload(
            mass=0.17,
            position=PayloadPosition(0.034, 0.035, 0.036),
            inertia=Inertia(1.1e-4, 1.2e-4, 1.3e-4),
            picked_up=0.9,
            dropped=1.9,
        )
    )
)
TURBULENCE = TurbulenceParameters(
    turbulence=Turbulence(PerDirection(1.1, 0.9, 0.7), PerDirection(20.0, 22.0, 3.0), 5.0), heading=0.7
)
JETS = (
    Jet(
        outlet=Outlet(0.5, -2.0, 1.0),
        direction=Direction(0.6, 0.64, 0.48),
        exit_speed=6.0,
        diameter=0.7,
        turbulence=0.2,
    ),
    Jet(
        outlet=Outlet(-1.5, 2.5, 0.8),
        direction=Direction(-0.6, -0.48, 0.64),
        exit_speed=5.0,
        diameter=0.8,
        turbulence=0.25,
    ),
)
GUST = GustParameters(velocity=Wind(1.0, 2.0, 3.0), start=1.1, rise_time=2.2, hold_time=3.3)  # m/s and s
CAMERA_PARAMETERS = CameraParameters(
    position_noise=1e-3,
    attitude_noise=4e-3,
    dropout_rate=0.1,
    misalignment=Attitude(0.1, 0.2, 0.3),
    derivative_bandwidth=100.0,
    latency_frames=2.0,
    velocity_error=VelocityError(0.05, -0.1, 0.2),
    velocity_drift=VelocityDrift(0.03, 0.02, 0.01),
    drift_time=0.4,
)
WRENCH_LINK = LinkParameters(delay_ticks=2.0, loss_rate=0.1, initial=Wrench(6.0, 0.1, 0.2, 0.3))
ATTITUDE_LINK = LinkParameters(
    delay_ticks=2.0,
    loss_rate=0.1,
    initial=AttitudeTarget(thrust=6.0, roll=0.1, pitch=0.2, yaw=0.3, p=0.4, q=0.5, r=0.6),
)
AUTOPILOT = AutopilotParameters(
    k_attitude=LoopGains(6.0, 5.5, 2.8),
    k_rate=LoopGains(14.0, 12.0, 9.0),
    inertia=Inertia(0.0065, 0.0085, 0.0126),
    gyroscope=Gyroscope(noise=0.004, bias=BodyRates(0.01, -0.02, 0.03)),
    attitude_noise=0.002,
    initial=Wrench(6.6, 0.1, 0.2, 0.3),
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
    position=PidLoopGains(PerAxis(2.1, 1.9, 2.3), _terms(0.4)),
    velocity=PidLoopGains(PerAxis(0.43, 0.41, 5.7), _terms(0.2)),
    velocity_feed_forward=0.3,
    mass=0.7,
    gravity=9.79,
    command=TiltParameters(hover_thrust=6.1, min_thrust=2.2, max_thrust=11.0),
)
ACCELERATION_CASCADE = CascadeParameters(
    position=PidLoopGains(PerAxis(0.95, 0.93, 1.1)),
    velocity=PidLoopGains(PerAxis(1.8, 1.7, 4.1), tuple(map(_with_first_order_filter, _terms(0.6)))),
    velocity_feed_forward=0.9,
    mass=0.71,
    gravity=9.78,
    command=AccelerationParameters(
        feed_forward=0.8,
        max_speed=1.2,
        max_ascent=0.7,
        max_descent=0.5,
        tan_max_tilt=0.6,
        min_thrust=2.1,
        max_thrust=11.5,
        horizontal_margin=3.3,
    ),
)
ATTITUDE_RESPONSE_VEHICLE = AttitudeResponseConfig(
    VEHICLE, AttitudeResponse(NaturalFrequencies(6.8, 6.4, 3.1), DampingRatios(0.5, 0.7, 1.1))
)
ANTECEDENTS = Antecedents(
    a1=1.4,
    a2=0.6,
    q=0.3,
    inputs=(FuzzySets(1.8, (-1.0, 0.1, 1.2), (1.1, 0.9, 1.3)), FuzzySets(0.7, (-0.9, 0.2, 0.8), (1.2, 1.0, 1.4))),
)
CIRCULAR_ANTECEDENTS = ANTECEDENTS._replace(
    inputs=(ANTECEDENTS.inputs[0], CircularSets(1.3, (-0.1, 0.4, 0.8), (0.5, 0.6, 0.7)))
)
LEARNING_LIMITS = LearningLimits(weight=0.9, deadzone=0.01, leakage=0.02)
NOISE_SAMPLES = Samples(3, (5, 6))  # seed, and the indices of the samples of two vehicles
RANDOM_STREAMS = (
    Stream(name="here", kind=StreamKind.WIND, num_rows=3, distribution=RandomDistribution.kGaussian, period=0.01),
    Stream(name="there", kind=StreamKind.NOISE, num_rows=1, distribution=RandomDistribution.kUniform, period=0.02),
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
    position=SensorPosition(0.03, -0.02, 0.05),
    gravity=9.79,
    bias=SpecificForce(0.1, -0.2, 0.15),
    noise=0.07,
    latency_samples=2.0,
)
ACCELEROMETER_STRUCTURE = {"name": "accelerometer", "law": ACCELEROMETER}
VIBRATION = Vibration(
    responses=tuple(
        Responses(*(Vector(*(1e-6 * (3.0 * i + j + k + 0.5) for k in range(3))) for j in range(3))) for i in range(4)
    ),
    harmonics=(0.11, 0.12, 0.13),
    initial_phases=RotorAngles(0.4, 1.4, 2.4, 2.9),
    period=0.01,
)
INERTIAL_ERRORS = InertialErrors(
    scale_error=Vector(0.01, 0.02, -0.03),
    misalignment=BodyAxes.of(0.021, -0.034, 0.055),
    bandwidth=LowPass.of(61.0, 0.01),
    bias_instability=BiasInstability(deviation=0.071, correlation=Correlation.of(0.9, 0.01)),
    bias_random_walk=0.013,
    temperature_coefficient=WarmUp(change=Vector(0.31, -0.22, 0.17), step=0.19),
    vibration=VIBRATION,
    full_scale=8.6,
    resolution=1.7e-3,
)
FAULTY_ACCELEROMETER = FaultySensor(
    sensor=ACCELEROMETER_PARAMETERS._replace(errors=INERTIAL_ERRORS),
    fault=SensorFault(start=0.015, end=0.055, rate=0.6),
)
FAULTY_ACCELEROMETER_STRUCTURE = {
    **ACCELEROMETER_STRUCTURE,
    "noisy": True,
    "errors": InertialErrors._fields,
    "fault": FaultKind(is_reported=True, is_random=True),
}
SENSOR_POSITION = SensorPosition(0.04, -0.03, 0.06)  # m, relative to the centre of mass
OTHER_SENSORS = {
    "gyroscope": (
        GYROSCOPE,
        GyroscopeParameters(bias=BodyRates(0.02, -0.01, 0.03), noise=0.07, latency_samples=1.0, errors=INERTIAL_ERRORS),
    ),
    "barometer": (
        BAROMETER,
        BarometerParameters(
            position=SENSOR_POSITION,
            bias=0.21,
            height_noise=0.31,
            latency_samples=1.0,
            errors=BarometerErrors(
                drift=HeightDrift(deviation=0.41, correlation=Correlation.of(0.7, 0.01)),
                dynamic_pressure=0.0123,
                ground_effect=GroundPressure(depth=0.51, length=0.61),
            ),
        ),
    ),
    "magnetometer": (
        MAGNETOMETER,
        MagnetometerParameters(
            earth=EarthField(0.2, 0.3, -0.4),
            hard_iron=MagneticField(0.011, 0.012, 0.013),
            field_noise=0.05,
            latency_samples=1.0,
            errors=MagnetometerErrors(
                SoftIron(0.021, -0.022, 0.023, 0.024, 0.025, -0.026),
                MotorInterference(Vector(0.031, 0.032, 0.033), (0.34, 0.35, 0.36, 0.37)),
            ),
        ),
    ),
    "gnss": (
        GNSS,
        GnssParameters(
            position=SENSOR_POSITION,
            position_noise=PositionDeviation(0.11, 0.12, 0.13),
            velocity_noise=VelocityDeviation(0.014, 0.015, 0.016),
            latency_samples=1.0,
            errors=GnssErrors(
                PositionDrift(deviation=PositionDeviation(0.21, 0.22, 0.23), correlation=Correlation.of(0.8, 0.01)),
                Multipath(deviation=PositionDeviation(0.31, 0.32, 0.33), threshold=0.5),
            ),
        ),
    ),
    "range_finder": (
        RANGE_FINDER,
        RangeFinderParameters(
            position=SENSOR_POSITION,
            ground=0.07,
            min_distance=0.25,
            max_distance=0.95,
            bias=0.02,
            distance_noise=0.08,
            relative_noise=0.09,
            latency_samples=1.0,
        ),
    ),
    "optical_flow": (
        OPTICAL_FLOW,
        OpticalFlowParameters(
            position=SENSOR_POSITION,
            ground=0.07,
            min_distance=0.25,
            max_distance=0.95,
            max_flow=1.6,
            flow_noise=0.08,
            scale_error=0.09,
            latency_samples=1.0,
        ),
    ),
    "uwb_range": (
        UWB_RANGE,
        UwbParameters(
            anchor=Anchor(1.1, -0.9, 2.1),
            position=SENSOR_POSITION,
            max_distance=2.3,
            bias=0.08,
            distance_noise=0.09,
            latency_samples=1.0,
            errors=UwbErrors(Outliers(threshold=0.5, deviation=0.41)),
        ),
    ),
}
LOSSY_LINK = {"longest_delay": 3, "loses_packets": True}


THRUST_RANGE = ThrustRange(min_thrust=2.0, max_thrust=12.0)  # N
RATES_SCALE = RatesScale(
    thrust=THRUST_RANGE,
    rates=BodyRates(5.0, 4.0, 2.0),
    gains=PerAngle(10.0, 9.0, 3.0),
    i_xx=0.0065,
    i_yy=0.0085,
    i_zz=0.0126,
)
SPEED_SCALE = SpeedScale(
    min_speed=60.0,
    max_speed=300.0,
    wrenches=PerRotor(
        Wrench(4.1e-5, 1.1e-6, -7.0e-6, 1.3e-6),
        Wrench(4.2e-5, -7.1e-6, 1.2e-6, -1.4e-6),
        Wrench(4.3e-5, 1.5e-6, 7.2e-6, 1.6e-6),
        Wrench(4.4e-5, 7.3e-6, 1.7e-6, -1.8e-6),
    ),
)
OBSERVATION_PARAMETERS = ObservationParameters(top_speed=290.0, initial_action=(0.1, -0.2, 0.3))
OBSERVATION_SPEC = ObservationSpec(
    signals=("position_error", "rotation", "reference_ahead", "rotor_speed", "wind", "action"),
    frame="body",
    history=3,
    turn=0.4,
)
HEADING_OBSERVATION = {
    "spec": ObservationSpec(signals=("velocity", "rotation"), frame="reference_heading"),
    "num_actions": 3,
}
ACCELERATION_SCALE = AccelerationScale(5.0, 4.0, 3.0)  # m/s²
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


NOMINAL_THRUST = ThrustParameters(mass=0.68, gravity=9.81, tan_max_tilt=0.7, min_thrust=2.0, max_thrust=12.0, lead=0.07)
TORQUE_LQG = LqgParameters(
    lateral=_loop(TorqueChain, 2, 2, 1),
    vertical=_loop(VerticalChain, 1, 2, 2),
    thrust=NOMINAL_THRUST,
    torques=TorqueParameters(
        i_xx=0.0065, i_yy=0.0085, i_zz=0.0126, yaw_k_p=5.0, yaw_k_d=3.1, max_snap=400.0, lead=0.09
    ),
    target=None,
)
TARGET_LQG = LqgParameters(
    lateral=_loop(AttitudeChain, 2, 1, 3),
    vertical=_loop(VerticalChain, 1, 1, 4),
    thrust=NOMINAL_THRUST,
    torques=None,
    target=TargetParameters(0.2, 0.03),
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
GROUND_EFFECT = Effects(ground_effect=GroundEffect(rotor_radius=0.11, ground_height=0.05))  # m
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
FILTER_WITH_TWO_SENSORS = FILTER._replace(aiding=(*FILTER.aiding, AidingParameters(HeightAiding(0.31), 21.0, 7.0)))
FILTER_WITH_TWO_SENSORS_STRUCTURE = {
    **FILTER_STRUCTURE,
    "aiding": (
        *FILTER_STRUCTURE["aiding"],
        Aiding("height", "height", 2),
    ),  # height readings are stored until position readings arrive
}

STICK_PILOT = PilotParameters(attitude_gain=8.1, yaw_gain=3.1, thrust_factor=4.2e-5, max_rotor_speed=510.0, gravity=9.7)

FLEET_SYSTEMS = [
    Example(Allocation, RotorModel.of(VEHICLE.parameters)),
    Example(Allocation, RotorModel.of(VEHICLE.parameters), {"paired": True, "priority": "thrust"}, num_vehicles=2),
    Example(AttitudeAutopilot, AUTOPILOT, {"noisy": True}, num_vehicles=2),
    Example(AttitudeAutopilot, AUTOPILOT, {"period": 0.005}, has_all_ports=False),
    Example(
        AttitudeAutopilot,
        PID_AUTOPILOT,
        {"rules": LoopRules(gyroscopic=False, attitude_integrates_first=True, rate_integrates_first=True)},
        num_vehicles=2,
        has_all_ports=False,
    ),
    Example(AttitudeAutopilot, PX4_AUTOPILOT, has_all_ports=False),
    Example(AttitudeController, PD_ATTITUDE),
    Example(StickPilot, STICK_PILOT, {"mode": "acro"}),
    Example(StickPilot, STICK_PILOT._replace(curve=ThrustCurve(0.1, 0.9, 3.1)), num_vehicles=2),
    Example(Broadcast, structure={"num_rows": 2}, num_vehicles=3),
    Example(CommandLink, WRENCH_LINK, LOSSY_LINK, num_vehicles=2),
    Example(ErrorStateKalmanFilter, FILTER, FILTER_STRUCTURE, num_vehicles=2),
    Example(ComplementaryFilter, COMPLEMENTARY_FILTER, COMPLEMENTARY_STRUCTURE, num_vehicles=2),
    Example(ErrorStateKalmanFilter, FILTER_WITH_TWO_SENSORS, FILTER_WITH_TWO_SENSORS_STRUCTURE, has_all_ports=False),
    Example(CommandLink, WRENCH_LINK, has_all_ports=False),
    Example(AccelerationActuation, ACCELERATION_SCALE, {"frame": "reference_heading", "turn": -0.7}, num_vehicles=2),
    Example(AccelerationActuation, ACCELERATION_SCALE, has_all_ports=False),
    Example(AttitudeActuation, AttitudeScale(thrust=THRUST_RANGE, tilt=0.6, yaw=0.5), num_vehicles=2),
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
    Example(Downwash, DownwashParameters(2000.0, 0.2, -0.1, 0.02)),
    Example(Downwash, DownwashParameters(2000.0, 0.2, -0.1, 0.02), {"count": 3}, num_vehicles=2, has_all_ports=False),
    Example(FlightMonitor, structure={"has_neighbours": True}),
    Example(FlightMonitor, num_vehicles=3, has_all_ports=False),
    Example(Proximity, Radii((0.6, 0.7))),
    Example(Proximity, Radii((0.1, 0.2, 0.3)), {"count": 3}, num_vehicles=2, has_all_ports=False),
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
    Example(SineWind, SineParameters(velocity=Wind(1.0, 2.0, 3.0), frequency=1.1, phase=2.2)),
    Example(IntegralCorrection, IntegralGains(k_i=PerAxis(0.3, 0.2, 1.5), limit=0.6), num_vehicles=2),
    Example(
        IntegralCorrection, IntegralGains(k_i=PerAxis(0.3, 0.2, 1.5), limit=0.6), {"integration": "backward_euler"}
    ),
    Example(
        IntegratingAttitudeController,
        IntegratingAttitudeParameters(attitude=PD_ATTITUDE, k_i=PerAngle(9.0, 7.0, 5.0), limit=3.0),
    ),
    Example(
        IntegratingAttitudeController,
        IntegratingAttitudeParameters(attitude=PD_ATTITUDE, k_i=PerAngle(9.0, 7.0, 5.0), limit=3.0),
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
        PidCascade,
        TILT_CASCADE,
        {
            "num_ticks": 5,
            "tick": 0.002,
            "rules": CascadeRules(position_integrates_first=True, velocity_integrates_first=True),
        },
        num_vehicles=2,
    ),
    Example(PidCascade, ACCELERATION_CASCADE),
    Example(PidCascade, ACCELERATION_CASCADE, {"rules": CascadeRules(decouples_vertical=False)}, num_vehicles=2),
    Example(PredictiveProgramme, structure=MPC_STRUCTURE, num_vehicles=2),
    Example(PredictiveProgramme, structure={**MPC_STRUCTURE, "nominal": TARGET_LQG, **TARGET_REGULATORS}),
    Example(ProportionalDerivative, PD_GAINS, {"feeds_forward": True}),
    Example(Quadrotor, VEHICLE, {"faulty": True}, has_all_ports=False),
    Example(
        Quadrotor,
        VEHICLE_WITH_EFFECTS,
        {"faulty": True, "effects": VEHICLE_WITH_EFFECTS.effects.names, "has_external_load": True},
    ),
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
        ThrottleModel(rotors=RotorModel.of(VEHICLE.parameters), thrust_factor=4.2e-5, curve=ThrustCurve(0.1, 0.9, 3.1)),
    ),
    Example(ThrustOnly),
    Example(ThrustVectoring, THRUST_VECTORING),
    Example(ThrustVectoring, THRUST_VECTORING, {"projects": True}, num_vehicles=2),
    Example(ThrustVectoring, THRUST_VECTORING, {"projects": True, "sequence": "zxy"}, num_vehicles=2),
    Example(TiltDisturbanceEstimator, TILT_ESTIMATOR, {"delay_ticks": 2}),
    Example(TiltDisturbanceEstimator, TILT_ESTIMATOR, num_vehicles=2),
    Example(
        WeightLearning,
        LearningParameters(
            slope=1.4,
            law=CovarianceLaw(gain=0.8, initial_covariance=5.0, forgetting=0.997),
            limits=LEARNING_LIMITS,
            initial_weight=0.05,
        ),
        {"axes": ("x", "z"), "num_rules": 4, "reset_times": (1.0, 2.0), "leads": True},
        num_vehicles=2,
    ),
    Example(
        SetLearning,
        AdaptationParameters(
            (ANTECEDENTS, ANTECEDENTS._replace(a1=1.7)),
            AdaptationRates(centres=0.3, widths=0.2, exponents=0.1),
            LearningParameters(slope=1.4, law=GradientLaw(0.4), limits=LEARNING_LIMITS, initial_weight=0.05),
        ),
        {"axes": ("x", "z")},
        num_vehicles=2,
    ),
    Example(
        WeightLearning,
        LearningParameters(slope=1.4, law=GradientLaw(0.4), limits=LEARNING_LIMITS, initial_weight=0.05),
        has_all_ports=False,
    ),
    Example(
        WeightLearning,
        LearningParameters(
            slope=1.4, law=SignLaw(rate=0.4, initial_slope=0.2), limits=LEARNING_LIMITS, initial_weight=0.05
        ),
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
"""Classes and functions with a `pydrake_system` block in the docstring, each with a function that makes an example."""
