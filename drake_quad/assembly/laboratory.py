"""Assembly of a scenario's laboratory diagram and flight monitor."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram

from drake_quad.errors import InputError
from drake_quad.framework.recipe import Recipe
from drake_quad.framework.records import record_like
from drake_quad.laboratory.flight_monitor import CrashLimits, FlightMonitor, Surroundings, Window
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.planning.duration import window_end, window_start
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.randomness.noise import ExportedRandomNumbers
from drake_quad.randomness.streams import Samples
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.quantities import any_nonzero
from drake_quad.scenario.winds.source import WindSource, speed, steady_wind
from drake_quad.scenario.winds.source import WindSurroundings as WindSurroundings
from drake_quad.signals import AttitudeTarget, Wind, Wrench
from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.authority import explain_missing_wrench
from drake_quad.vehicle.faults import RotorFaults
from drake_quad.vehicle.motors import ThrottleAllocation, ThrottleModel
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import HoverPose, InitialMotion, QuadrotorConfig, initial_body_state

# Largest allowed product of the vehicle's time step (s) and its fastest decay rate or natural frequency (1/s). The
# fourth-order Runge-Kutta method is stable up to 2.78.
_MAX_STEP_TIMES_RATE = 2.5
# Prefixes of the paths of wind systems and sensors in the laboratory.
_WIND_PREFIX = "wind."
_SENSORS_PREFIX = "sensors."


def laboratory_recipes(
    batch: Batch, plan: Plan, duration: float, *, has_external_load: bool = False
) -> dict[str, Recipe]:
    """Return a `Recipe` for each system in the laboratory diagram, including the vehicles, keyed by the system's path.

    Args:
        batch: samples to fly, with one vehicle for each.
        plan: plan that the vehicles follow. By default, they hover at its first point at time 0.
        duration: duration of the flight, s.
        has_external_load: True if other systems compute a force and a torque on the vehicle.

    Raises:
        InputError: if the time step of the vehicle is too long for its drag, its slung load, or its attitude response,
            or if the rotors of a vehicle cannot produce every torque.
    """
    scenario, fleet = batch.scenario, batch.fleet_scenario
    _check_step(fleet)
    pose, motion = _initial_state(scenario, fleet, plan)
    estimator = scenario.laboratory.estimator.recipe(scenario, fleet, initial_body_state(pose, motion))
    cameras = scenario.laboratory.motion_capture.recipe(
        fleet.laboratory.motion_capture, reports_losses=estimator is not None
    )
    return {
        "vehicle": _vehicle(scenario, fleet, pose, motion, duration, has_external_load),
        **({"motion_capture": cameras} if scenario.laboratory.estimator.reads_motion_capture else {}),
        **({"estimator": estimator} if estimator is not None else {}),
        "command_link": _command_link(scenario, fleet.laboratory.command_link, plan.initial_yaw),
        **_autopilot_and_allocation(scenario, fleet.laboratory.autopilot),
        **{f"{_WIND_PREFIX}{name}": recipe for name, recipe in _wind(scenario, fleet).items()},
        **{f"{_SENSORS_PREFIX}{name}": recipe for name, recipe in _sensors(scenario, fleet).items()},
    }


def build_laboratory_from_recipes(
    recipes: dict[str, Recipe],
    num_vehicles: int,
    samples: Samples | ExportedRandomNumbers | None,
    *,
    user_wind: Any = None,
) -> Diagram:
    """Build the laboratory diagram from recipes.

    Args:
        recipes: recipes from `laboratory_recipes`, keyed by path.
        num_vehicles: number of vehicles N.
        samples: source of the random noise: the samples of a study, None for Drake's random sources, or
            `ExportedRandomNumbers` for input ports.
        user_wind: user's source of wind, in addition to the sources in the recipes.
    """
    systems = {path: recipe.build(num_vehicles) for path, recipe in recipes.items()}
    sources, sensors = (
        {path.removeprefix(prefix): systems.pop(path) for path in recipes if path.startswith(prefix)}
        for prefix in (_WIND_PREFIX, _SENSORS_PREFIX)
    )
    if user_wind is not None:
        sources["own"] = user_wind
    return build_laboratory(**systems, wind=sources, sensors=sensors, samples=samples)


def wind_period(scenario: Scenario) -> float:
    """Return the sampling period of the wind, s."""
    return scenario.vehicle.time_step or scenario.laboratory.motion_capture.period


def build_monitor(scenario: Scenario, plan: Plan, num_vehicles: int, *, has_neighbours: bool = False) -> FlightMonitor:
    """Build the flight monitor, which detects crashes and computes the metrics of flights along a plan."""
    space, tilt = scenario.flight_space(), scenario.crash.tilt
    solids = () if space is None else tuple(obstacle.shape for obstacle in space.obstacles)
    return FlightMonitor(
        num_vehicles=num_vehicles,
        period=scenario.laboratory.command_link.period,
        limits=record_like(CrashLimits, scenario.crash, tilt=math.inf if tilt is None else tilt),
        surroundings=Surroundings(solids, 0.0 if space is None else space.radius),
        window=Window(window_start(scenario, plan), window_end(scenario, plan)),
        metrics=scenario.metrics_type,
        has_neighbours=has_neighbours,
    )


def vehicle_parameters(vehicle: Any) -> QuadrotorParameters:
    """Return the true parameters of a vehicle, given the field `vehicle` of a scenario or a `Batch.fleet_scenario`."""
    rotors = rotors_of(vehicle)
    factors = (b * (1.0 + error) for b, error in zip(rotors.thrust_factors, vehicle.thrust_factor_error, strict=True))
    return record_like(QuadrotorParameters, vehicle, rotors=rotors.with_thrust_factors(*factors))


def _allocation(scenario: Scenario) -> Recipe:
    nominal, curve = nominal_parameters(scenario), scenario.nominal.motors.thrust_curve()
    structure = {
        "paired": scenario.nominal.layout.is_paired,
        "priority": scenario.laboratory.allocation.priority,
    }
    if curve is None:
        return Recipe(Allocation, structure, RotorModel.of(nominal))
    return Recipe(ThrottleAllocation, structure, ThrottleModel.of(nominal, curve))


def _initial_state(scenario: Scenario, fleet: Any, plan: Plan) -> tuple[HoverPose, InitialMotion]:
    """Return the position and yaw of the vehicles at time 0, and their tilt, velocity, body rates and rotor speeds."""
    x, y, z = map(float, plan.waypoints[0])
    start = HoverPose(x, y, z, plan.initial_yaw)
    return scenario.initial.pose(fleet.initial, start), scenario.initial.motion(fleet.initial)


def _vehicle(
    scenario: Scenario, fleet: Any, pose: HoverPose, motion: InitialMotion, duration: float, has_external_load: bool
) -> Recipe:
    """Return the recipe for the vehicle.

    Raises:
        InputError: if the rotors of a vehicle in the batch cannot produce every torque.
    """
    vehicle = scenario.vehicle
    effects = fleet.vehicle.effect_parameters()
    structure = {
        "time_step": vehicle.time_step,
        "kinematics": vehicle.attitude_kinematics,
        "faulty": "rotor_failure" in vehicle.effects() or any_nonzero(vehicle.battery_sag, fleet.vehicle.battery_sag),
        "effects": effects.names,
        **({"has_external_load": True} if has_external_load else {}),
    }
    parameters = vehicle_parameters(fleet.vehicle)
    # A layout with paired rotors can produce every torque for all values of its parameters.
    if not vehicle.layout.is_paired and (missing := explain_missing_wrench(parameters.rotors)):
        raise InputError(f"vehicle.layout cannot produce {missing} in some of the samples; narrow its distributions")
    config = QuadrotorConfig(parameters, _faults(fleet.vehicle, duration), pose, effects, motion)
    return fleet.laboratory.autopilot.vehicle_recipe(structure, config)


def jump_times(batch: Batch) -> tuple[float, ...]:
    """Return the sorted times at which the forces on vehicles with a continuous state are discontinuous, s.

    An integrator with error control cannot step across a discontinuity. A simulation must stop just before each of
    these times and continue from the time itself. Vehicles with a time step have no jump times.
    """
    if batch.scenario.vehicle.time_step > 0.0:
        return ()
    times = [time for effect in batch.fleet_scenario.vehicle.effects().values() for time in effect.event_times()]
    return tuple(sorted({float(time) for vehicles in times for time in np.ravel(vehicles)}))


def _faults(fleet: Any, duration: float) -> RotorFaults:
    faults = RotorFaults() if fleet.rotor_failure is None else fleet.rotor_failure.parameters()
    return faults._replace(battery_sag=fleet.battery_sag / duration)


def _check_step(fleet: Any) -> None:
    """Raise InputError if the motion of the vehicle is too fast for its time step to be stable."""
    vehicle, sources = fleet.vehicle, fleet.laboratory.wind
    wind_speed = speed(steady_wind(sources)) + sum(source.max_speed() for source in sources)
    airspeed = wind_speed + speed(Wind(*fleet.initial.velocity))
    drag = vehicle.linear_drag + 2.0 * vehicle.quadratic_drag * airspeed
    effects = vehicle.effects()
    steepest = sum(effect.max_damping(vehicle, airspeed) for effect in effects.values())
    rates = {
        "drag with a time constant of {time:.2g} s": (drag + steepest) / vehicle.mass,
        **{
            f"a {name.replace('_', ' ')} that swings at {{rate:.2g}} rad/s": effect.natural_frequency(vehicle)
            for name, effect in effects.items()
        },
        "an attitude response with a time constant of {time:.2g} s": fleet.laboratory.autopilot.fastest_decay(),
    }
    for motion, row in rates.items():
        rate = np.max(row)
        if vehicle.time_step * rate > _MAX_STEP_TIMES_RATE:
            raise InputError(
                f"vehicle.time_step is {vehicle.time_step:g} s, too long for"
                f" {motion.format(time=1.0 / rate, rate=rate)}; shorten it, or make it 0 for a continuous state"
            )


def _command_link(scenario: Scenario, fleet: Any, yaw: float) -> Recipe:
    """Return the recipe for the radio link. Its output is a hover command until the first packet arrives.

    Args:
        scenario: scenario that contains the link.
        fleet: settings of the link from `Batch.fleet_scenario`, in which each random field is an (N,) array.
        yaw: yaw of the initial hover, rad.
    """
    link, nominal = scenario.laboratory.command_link, nominal_parameters(scenario)
    command, weight = scenario.laboratory.autopilot.command, nominal.mass * nominal.gravity
    hover: dict[str, Wrench | AttitudeTarget] = {
        "wrench": Wrench(weight, 0.0, 0.0, 0.0),
        "attitude_target": AttitudeTarget(weight, 0.0, 0.0, yaw, 0.0, 0.0, 0.0),
    }
    return link.recipe(fleet, command, hover[command])


def _autopilot_and_allocation(scenario: Scenario, fleet: Any) -> dict[str, Recipe]:
    """Return the recipes for the systems that command the motors, keyed by their names in the diagram.

    Args:
        scenario: scenario that contains the autopilot.
        fleet: settings of the autopilot from `Batch.fleet_scenario`, in which each random field is an (N,) array.
    """
    recipes: dict[str, Recipe] = fleet.recipes(
        nominal_parameters(scenario),
        settings=scenario.laboratory.autopilot,
        follows_attitude=not scenario.control.commands_rates_only(),
        curve=scenario.nominal.motors.thrust_curve(),
    )
    return recipes if "firmware" in recipes else {"allocation": _allocation(scenario), **recipes}


def _wind(scenario: Scenario, fleet: Any) -> dict[str, Recipe]:
    """Return a recipe for each wind system of a scenario, keyed by the system's name."""
    by_kind: dict[type[WindSource], list[Any]] = {}
    for settings, source in zip(scenario.laboratory.wind, fleet.laboratory.wind, strict=True):
        by_kind.setdefault(type(settings), []).append(source)
    surroundings = WindSurroundings(steady_wind(fleet.laboratory.wind), wind_period(scenario))
    recipes: dict[str, Recipe] = {}
    # The order is fixed, since it affects the rounding of the total wind and the order of systems in drawings.
    for kind in sorted(by_kind, key=lambda kind: kind.depends_on_position):
        recipes |= kind.recipes(by_kind[kind], surroundings)
    return recipes


def _sensors(scenario: Scenario, fleet: Any) -> dict[str, Recipe]:
    """Return a recipe for each sensor of a scenario, keyed by the name of the sensor's port."""
    settings, drawn = scenario.laboratory.named_sensors, fleet.laboratory.named_sensors
    return {name: sensor.recipe(drawn[name], fleet.vehicle) for name, sensor in settings.items()}
