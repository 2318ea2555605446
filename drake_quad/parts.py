"""What a scenario's numbers make: the systems of its laboratory and of its control.

Numbers may be arrays, an entry a vehicle, as `draw_samples` gives them.
"""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import ConstantVectorSource

from drake_quad.control.attitude import AttitudeController
from drake_quad.control.cascade import build_cascade
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.systems import build_fuzzy_network
from drake_quad.control.integral import IntegralCorrection
from drake_quad.control.position import build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring
from drake_quad.elementary import Row, Rows, is_zero, where
from drake_quad.errors import InputError
from drake_quad.fleet import fleet_rows
from drake_quad.laboratory.command_link import CommandLink
from drake_quad.laboratory.flight_monitor import CrashLimits, FlightMonitor
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.motion_capture import CameraErrors, IdealMotionCapture, MotionCapture
from drake_quad.laboratory.tape import Samples
from drake_quad.laboratory.wind.dryden import WIND_AT_20_FEET, DrydenTurbulence, Turbulence
from drake_quad.laboratory.wind.fans import Fans, Jet
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.planning import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, controllers, models, wind
from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor

# A fourth-order Runge-Kutta step is stable up to 2.78 time constants of a decay.
_STABLE = 2.5


def control(scenario: Scenario, plan: Plan, num_vehicles: int, position_controller: Any = None) -> Diagram:
    """The cascade of a scenario, with its own position controller or with another; it believes the nominal numbers."""
    position, attitude = scenario.control.position, scenario.control.attitude
    period = scenario.laboratory.command_link.period
    if position_controller is None:
        position_controller = build_position_controller(
            num_vehicles=num_vehicles,
            k_p=position.k_p,
            k_d=position.k_d,
            derivative=position.derivative,
            feed_forward=position.feed_forward,
            correction=_correction(position, plan, {"num_vehicles": num_vehicles, "period": period}),
        )
    believed = nominal_parameters(scenario)
    limits = scenario.control.thrust_vectoring
    weight = believed.mass * believed.gravity
    thrust_vectoring = ThrustVectoring(
        num_vehicles=num_vehicles,
        mass=believed.mass,
        gravity=believed.gravity,
        limits=ThrustLimits(np.tan(limits.max_tilt), limits.min_thrust * weight, limits.max_thrust * weight),
    )
    attitude_controller = AttitudeController(
        num_vehicles=num_vehicles, k_p=attitude.k_p, k_d=attitude.k_d, inertia=believed.inertia
    )
    return build_cascade(
        position=position_controller,
        thrust_vectoring=thrust_vectoring,
        attitude=attitude_controller,
        feed_forward=position.feed_forward,
    )


def _correction(position: controllers.PositionController, plan: Plan, common: dict[str, Any]) -> Any:
    """What is subtracted from a position controller's PD, if anything is."""
    match position:
        case controllers.PidPosition():
            correction = IntegralCorrection(k_i=position.k_i, limit=position.integral_limit, **common)
            correction.set_name("integral")
            return correction
        case controllers.Type1Position() | controllers.Type2Position():
            return _network(position, plan, common)
    return None


def _network(
    position: controllers.Type1Position | controllers.Type2Position, plan: Plan, common: dict[str, Any]
) -> Diagram:
    learning = position.learning
    law: Any
    slope: Row = 1.0
    reset_times: list[float] = []
    match learning:
        case controllers.CovarianceLearning():
            law = CovarianceLaw(learning.gain, learning.initial_covariance, learning.forgetting)
            slope = learning.slope
            if learning.reset == "at_segments":
                reset_times = plan.leg_times[1:]
        case controllers.GradientLearning():
            law, slope = GradientLaw(learning.rate), learning.slope
        case controllers.SignLearning():
            law = SignLaw(learning.rate, learning.initial_slope)
    limit = math.inf if learning.weight_limit is None else learning.weight_limit
    return build_fuzzy_network(
        axes=position.axes,
        antecedents=antecedents(position),
        law=law,
        slope=slope,
        limits=Limits(limit, learning.deadzone, learning.leakage),
        initial_weight=learning.initial_weight,
        reset_times=reset_times,
        **common,
    )


def antecedents(position: controllers.Type1Position | controllers.Type2Position) -> Antecedents:
    """The antecedents of a controller's network."""
    network = position.network
    inputs = (FuzzySets(sets.scale, sets.centres, sets.widths) for sets in (network.error, network.rate))
    exponents = (network.a1, network.a2, network.q) if isinstance(network, controllers.Ellipses) else (1.0, 1.0, 0.0)
    return Antecedents(*exponents, *inputs)


def laboratory(scenario: Scenario, plan: Plan, duration: float, samples: Samples) -> Diagram:
    """The laboratory of a scenario around its vehicles, in hover at the beginning of the plan.

    Args:
        scenario: without distributions.
        plan: for the nominal vehicle.
        duration: of the flight, s.
        samples: that the vehicles fly.
    """
    num_vehicles = len(samples.numbers)
    believed = nominal_parameters(scenario)
    vehicle, link = scenario.vehicle, scenario.laboratory.command_link
    _check_step(scenario)
    return build_laboratory(
        vehicle=Quadrotor(
            num_vehicles=num_vehicles,
            time_step=vehicle.time_step,
            kinematics=vehicle.attitude_kinematics,
            parameters=vehicle_parameters(vehicle),
            faults=_faults(vehicle, duration),
            initial_position=plan.waypoints[0],
            initial_yaw=plan.initial_yaw,
        ),
        allocation=Allocation(num_vehicles=num_vehicles, rotors=RotorModel.of(believed)),
        motion_capture=_motion_capture(scenario.laboratory.motion_capture, num_vehicles),
        command_link=CommandLink(
            num_vehicles=num_vehicles,
            period=link.period,
            delay_ticks=link.delay_ticks,
            loss_rate=link.loss_rate,
            initial=(believed.mass * believed.gravity, 0.0, 0.0, 0.0),
        ),
        wind=_wind(scenario, num_vehicles),
        samples=samples,
    )


def _check_step(scenario: Scenario) -> None:
    """Raises InputError if drag stops a vehicle so fast that its steps would not be stable."""
    vehicle = scenario.vehicle
    sources = scenario.laboratory.wind
    gusts = [source.velocity for source in sources if isinstance(source, wind.Gust)]
    speeds = [np.sqrt(sum(part * part for part in velocity)) for velocity in (steady_wind(scenario), *gusts)]
    airspeed = sum(speeds) + sum(jet.exit_speed for jet in jets(scenario))
    rate = np.max((vehicle.linear_drag + 2.0 * vehicle.quadratic_drag * airspeed) / vehicle.mass)
    if vehicle.time_step * rate > _STABLE:
        raise InputError(
            f"vehicle.time_step is {vehicle.time_step:g} s, too long for this much drag, which carries a vehicle along"
            f" within {1.0 / rate:.2g} s; shorten it, or make it 0 for a continuous state"
        )


def monitor(scenario: Scenario, num_vehicles: int) -> Any:
    """The monitor of a scenario's flight."""
    window, crash = scenario.metrics, scenario.crash
    return FlightMonitor(
        num_vehicles=num_vehicles,
        period=scenario.laboratory.command_link.period,
        limits=CrashLimits(crash.tilt, crash.position_error, crash.height),
        window=(window.start, math.inf if window.end is None else window.end),
    )


def vehicle_parameters(vehicle: models.Vehicle) -> QuadrotorParameters:
    """The vehicle as it is."""
    fields = {name: getattr(vehicle, name) for name in QuadrotorParameters._fields}
    fields["thrust_factor"] = [vehicle.thrust_factor * (1.0 + error) for error in vehicle.thrust_factor_error]
    return QuadrotorParameters(**fields)


def _faults(vehicle: models.Vehicle, duration: float) -> RotorFaults | None:
    failure = vehicle.rotor_failure
    if failure is None and is_zero(vehicle.battery_sag):
        return None
    faults = RotorFaults(battery_sag=vehicle.battery_sag / duration)
    if failure is None:
        return faults
    left = [where(failure.rotor == number, failure.speed_factor, 1.0) for number in (1.0, 2.0, 3.0, 4.0)]
    return faults._replace(failure_time=failure.time, failure_factor=left)


def _motion_capture(cameras: models.MotionCapture, num_vehicles: int) -> Any:
    errors = CameraErrors(*(getattr(cameras, name) for name in CameraErrors._fields))
    flawless = all(is_zero(error) for error in (*errors[:3], *errors.misalignment, cameras.latency_frames))
    if flawless and cameras.derivative_bandwidth is None:
        return IdealMotionCapture(num_vehicles=num_vehicles, period=cameras.period)
    return MotionCapture(
        num_vehicles=num_vehicles,
        period=cameras.period,
        errors=errors,
        derivative_bandwidth=cameras.derivative_bandwidth,
        latency_frames=cameras.latency_frames,
    )


def _wind(scenario: Scenario, num_vehicles: int) -> dict[str, Any]:
    """What makes the wind of a scenario; sources of a kind are numbered: others leave their turbulence as it is."""
    period = scenario.vehicle.time_step or scenario.laboratory.motion_capture.period
    common: dict[str, Any] = {"num_vehicles": num_vehicles, "period": period}
    sources: dict[str, Any] = {}
    mean = steady_wind(scenario)
    if not all(is_zero(part) for part in mean):
        sources["steady"] = ConstantVectorSource(fleet_rows(mean, num_vehicles))
    for source in scenario.laboratory.wind:
        name = f"{source.kind}_{sum(other.startswith(source.kind) for other in sources)}"
        match source:
            case wind.Gust():
                hold_time = math.inf if source.hold_time is None else source.hold_time
                gust = GustParameters(source.velocity, source.start, source.rise_time, hold_time)
                sources[name] = Gust(gust=gust, **common)
            case wind.Dryden():
                turbulence, heading = _dryden(source, mean)
                sources[name] = DrydenTurbulence(turbulence=turbulence, heading=heading, **common)
    if jets(scenario):
        sources["fans"] = Fans(jets=jets(scenario), **common)
    return sources


def steady_wind(scenario: Scenario) -> list[Row]:
    """The sum of all steady wind, 3 rows in W, m/s."""
    steady = [source.velocity for source in scenario.laboratory.wind if isinstance(source, wind.SteadyWind)]
    return [sum((velocity[axis] for velocity in steady), start=0.0) for axis in range(3)]


def jets(scenario: Scenario) -> list[Jet]:
    """The jets of all fans."""
    return [
        Jet.of_fan(
            position=fan.position,
            direction=fan.direction,
            flow=fan.flow,
            diameter=fan.diameter,
            turbulence=fan.turbulence,
        )
        for fan in scenario.laboratory.wind
        if isinstance(fan, wind.Fan)
    ]


def _dryden(source: wind.Dryden, mean: Rows) -> tuple[Turbulence, Row]:
    """The turbulence and its heading, both by the steady wind where the source does not say."""
    x, y, z = mean
    airspeed = np.sqrt(x * x + y * y + z * z) if source.airspeed is None else source.airspeed
    heading = np.arctan2(y, x) if source.heading is None else source.heading
    level = WIND_AT_20_FEET[source.level] * source.intensity
    return Turbulence.at_low_altitude(height=source.height, wind_at_20_feet=level, airspeed=airspeed), heading
