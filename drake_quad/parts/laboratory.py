"""The laboratory of a scenario, and its referee."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import ConstantVectorSource

from drake_quad.elementary import Row, Rows, is_zero, sin_cos, where
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
from drake_quad.parts.part import Part
from drake_quad.planning import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario, models, wind
from drake_quad.scenario.quantities import extremes
from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor

# A fourth-order Runge-Kutta step is stable up to 2.78 time constants of a decay.
_STABLE = 2.5
_WIND = "wind."


def laboratory_parts(
    scenario: Scenario, drawn: Scenario, plan: Plan, duration: float, num_vehicles: int
) -> dict[str, Part]:
    """What the laboratory of a scenario is made of around its vehicles, by the path in its diagram.

    They are in hover at the beginning of the plan.

    Args:
        scenario: which says how long delays can get.
        drawn: the same with numbers, or an array of them, an entry a vehicle, in place of distributions.
        plan: for the nominal vehicle.
        duration: of the flight, s.
        num_vehicles: N.

    Raises:
        InputError: the vehicle's time step is too long for its drag.
    """
    believed = nominal_parameters(drawn)
    vehicle, link = drawn.vehicle, drawn.laboratory.command_link
    _check_step(drawn)
    common = {"num_vehicles": num_vehicles}
    aircraft = {
        "time_step": vehicle.time_step,
        "kinematics": vehicle.attitude_kinematics,
        "parameters": vehicle_parameters(vehicle),
        "faults": _faults(vehicle, duration),
        "initial_position": plan.waypoints[0],
        "initial_yaw": plan.initial_yaw,
    }
    radio = {
        "period": link.period,
        "delay_ticks": link.delay_ticks,
        "longest_delay": _longest(scenario.laboratory.command_link.delay_ticks),
        "loss_rate": link.loss_rate,
        "initial": (believed.mass * believed.gravity, 0.0, 0.0, 0.0),
    }
    return {
        "vehicle": Part(Quadrotor, {**common, **aircraft}),
        "allocation": Part(Allocation, {**common, "rotors": RotorModel.of(believed)}),
        "motion_capture": _motion_capture(
            drawn.laboratory.motion_capture,
            _longest(scenario.laboratory.motion_capture.latency_frames),
            num_vehicles,
        ),
        "command_link": Part(CommandLink, {**common, **radio}),
        **{f"{_WIND}{name}": part for name, part in _wind(drawn, num_vehicles).items()},
    }


def build_laboratory_of(parts: dict[str, Part], samples: Samples | None, *, own_wind: Any = None) -> Diagram:
    """The laboratory of these parts.

    Args:
        parts: of a laboratory.
        samples: that the vehicles fly; None for Drake's random sources.
        own_wind: a source of wind beside those of the parts.
    """
    systems = {path: part.build() for path, part in parts.items()}
    wind = {path.removeprefix(_WIND): systems.pop(path) for path in parts if path.startswith(_WIND)}
    if own_wind is not None:
        wind["own"] = own_wind
    return build_laboratory(**systems, wind=wind, samples=samples)


def wind_period(scenario: Scenario) -> float:
    """How long wind is held, s."""
    return scenario.vehicle.time_step or scenario.laboratory.motion_capture.period


def _check_step(scenario: Scenario) -> None:
    """Raises InputError if drag stops a vehicle so fast that its steps would not be stable."""
    vehicle = scenario.vehicle
    sources = scenario.laboratory.wind
    gusts = [_velocity(source) for source in sources if isinstance(source, wind.Gust)]
    speeds = [np.sqrt(sum(part * part for part in velocity)) for velocity in (steady_wind(scenario), *gusts)]
    airspeed = sum(speeds) + sum(jet.exit_speed for jet in jets(scenario))
    rate = np.max((vehicle.linear_drag + 2.0 * vehicle.quadratic_drag * airspeed) / vehicle.mass)
    if vehicle.time_step * rate > _STABLE:
        raise InputError(
            f"vehicle.time_step is {vehicle.time_step:g} s, too long for this much drag, which carries a vehicle along"
            f" within {1.0 / rate:.2g} s; shorten it, or make it 0 for a continuous state"
        )


def monitor_part(scenario: Scenario, num_vehicles: int) -> Part:
    """The monitor of a scenario's flight."""
    window, crash = scenario.metrics, scenario.crash
    limits = {
        "period": scenario.laboratory.command_link.period,
        "limits": CrashLimits(crash.tilt, crash.position_error, crash.height),
        "window": (window.start, math.inf if window.end is None else window.end),
    }
    return Part(FlightMonitor, {"num_vehicles": num_vehicles, **limits})


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


def _motion_capture(cameras: models.MotionCapture, longest_latency: int, num_vehicles: int) -> Part:
    options: dict[str, Any] = {"num_vehicles": num_vehicles, "period": cameras.period}
    errors = CameraErrors(*(getattr(cameras, name) for name in CameraErrors._fields))
    flawless = all(is_zero(error) for error in (*errors[:3], *errors.misalignment, cameras.latency_frames))
    if flawless and cameras.derivative_bandwidth is None:
        return Part(IdealMotionCapture, options)
    options |= {"errors": errors, "derivative_bandwidth": cameras.derivative_bandwidth}
    return Part(MotionCapture, options | {"latency_frames": cameras.latency_frames, "longest_latency": longest_latency})


def _longest(delay: Any) -> int:
    """The most ticks that a delay can take."""
    _, longest = extremes(delay)
    return int(longest or 0.0)


def _wind(scenario: Scenario, num_vehicles: int) -> dict[str, Part]:
    """What makes the wind of a scenario; sources of a kind are numbered: others leave their turbulence as it is."""
    common: dict[str, Any] = {"num_vehicles": num_vehicles, "period": wind_period(scenario)}
    sources: dict[str, Part] = {}
    mean = steady_wind(scenario)
    if not all(is_zero(part) for part in mean):
        sources["steady"] = Part(ConstantVectorSource, {"source_value": fleet_rows(mean, num_vehicles)})
    for source in scenario.laboratory.wind:
        name = f"{source.kind}_{sum(other.startswith(source.kind) for other in sources)}"
        match source:
            case wind.Gust():
                hold_time = math.inf if source.hold_time is None else source.hold_time
                gust = GustParameters(_velocity(source), source.start, source.rise_time, hold_time)
                sources[name] = Part(Gust, {**common, "gust": gust})
            case wind.Dryden():
                turbulence, heading = _dryden(source, mean)
                sources[name] = Part(DrydenTurbulence, {**common, "turbulence": turbulence, "heading": heading})
    if jets(scenario):
        sources["fans"] = Part(Fans, {**common, "jets": jets(scenario)})
    return sources


def steady_wind(scenario: Scenario) -> list[Row]:
    """The sum of all steady wind, 3 rows in W, m/s."""
    steady = [_velocity(source) for source in scenario.laboratory.wind if isinstance(source, wind.SteadyWind)]
    return [sum((velocity[axis] for velocity in steady), start=0.0) for axis in range(3)]


def _velocity(source: wind.SteadyWind | wind.Gust) -> Rows:
    """The velocity of the air, 3 rows in W, m/s."""
    if source.velocity is not None:
        return source.velocity
    sin_heading, cos_heading = sin_cos(source.heading)
    return source.speed * cos_heading, source.speed * sin_heading, 0.0


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
