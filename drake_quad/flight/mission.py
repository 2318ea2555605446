"""Plan of a scenario, and its diagrams: the closed loop, the laboratory without a controller, and the vehicle."""

from typing import Any

from pydrake.systems.framework import Diagram

from drake_quad.assembly.laboratory import build_laboratory_from_recipes, laboratory_recipes
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError
from drake_quad.flight.hover_error import nominal_tracking_error
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.framework.recipe import Recipe
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.route import plan_route_in_space
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Mission, Scenario
from drake_quad.scenario.paths import distributions_in, refuse_distributions
from drake_quad.scenario.routes.route import PlannedRoute
from drake_quad.space.space import Space

_MAX_OBSTACLE_PLANS = 16  # largest number of cached plans
# Cache of plans around obstacles. The key is the JSON text of the fields on which the plan depends.
_obstacle_plans: "ThreadSafeCache[PlannedRoute]" = ThreadSafeCache(_MAX_OBSTACLE_PLANS)


def plan_route(mission: Mission) -> Plan:
    """Return the plan for the route of a scenario, for the nominal vehicle.

    Raises:
        InputError: if the route contains a distribution, if no path satisfies the conditions of the route, if the
            rotors cannot fly the path, or if obstacles block every path.
    """
    return plan_route_with_problem(mission).plan


def plan_route_with_problem(mission: Mission) -> PlannedRoute:
    """Return the plan for the route of a scenario, and the planning problem that this plan solves.

    Planning around obstacles takes seconds, so these plans are cached.

    Raises:
        InputError: under the same conditions as in `plan_route`.
    """
    if mission.space is None:
        return plan_route_in_space(mission, None)
    # The plan depends on the fields of `Mission`. If the clearance includes a predicted tracking error, the plan
    # depends on all fields of the scenario, because the prediction does.
    key_fields = None if mission.space.tracking_error_factor else set(Mission.model_fields)

    def make() -> PlannedRoute:
        space = planning_space(mission)
        return plan_route_in_space(mission, space)._replace(space=space)

    return _obstacle_plans.get(mission.model_dump_json(include=key_fields), make)


def build_tracking_diagram(
    scenario: Scenario,
    num_vehicles: int = 1,
    *,
    position_controller: Any = None,
    control: Any = None,
    wind: Any = None,
    plan: Plan | None = None,
    record: bool = False,
    drake_random: bool = False,
) -> Diagram:
    """Build the closed loop of a scenario, for N vehicles with identical parameters.

    Vehicle i flies with the wind and noise of sample s + i, where s is the scenario's `sample`, or 0 if it has none.

    The subsystems are `reference`, `control`, `laboratory`, `monitor` and, if requested, `recorder`. The diagram
    exports the signals of the loop under their names. In the default context, the vehicles have the initial state of
    the scenario: unless `initial` is given, they hover at the first point of the reference.

    Args:
        scenario: scenario without distributions.
        num_vehicles: number N of vehicles.
        position_controller: system that replaces the scenario's position controller and its network. Its inputs are
            `measurement` (12 rows) and `reference` (11 rows), its output is `acceleration_command` (3 rows, m/s²).
            The diagram takes ownership of the system.
        control: system that replaces the whole cascade. Its inputs are `measurement` and `reference`, its output is
            `wrench` (4 rows: F_z in N; τ_x, τ_y, τ_z in N m) or, with an autopilot on board, `attitude_target` (7 rows:
            F_z in N; roll, pitch, yaw in rad; p, q, r in rad/s). The diagram takes ownership of the system.
        wind: additional source of wind, with one output port of 3 rows, the velocity of the air in W (m/s), and
            optionally the input port `state` (12 rows). The diagram takes ownership of the source. It samples the
            source at the vehicle's time step, unless the source is a FleetSystem with periodic updates, as in
            `drake_quad.laboratory`.
        plan: plan to fly; by default the plan for the scenario's route.
        record: True to add a recorder of all signals, sampled at every control tick.
        drake_random: True to connect wind and noise to Drake's random sources, for Drake's Monte Carlo tools, instead
            of the random numbers of the samples.

    Raises:
        InputError: if the scenario contains a distribution, the rotors cannot fly the route, the ports of a given
            system do not match the loop, or the fleet does not fit into memory.
    """
    batch = _identical_vehicles(scenario, num_vehicles)
    user_systems = UserSystems(position_controller, control, wind)
    plan = plan or plan_route(scenario)
    return build_fleet_diagram(batch, plan, user_systems=user_systems, record=record, drake_random=drake_random)


def build_laboratory_diagram(
    scenario: Scenario, num_vehicles: int = 1, *, plan: Plan | None = None, drake_random: bool = False
) -> Diagram:
    """Build the laboratory of a scenario without its controller: all systems from a command to a measurement.

    The command link sends the command to the rotors of the vehicle, which moves in the wind. Motion capture measures
    the state of the vehicle. If the port `crashed` is not connected, no vehicle crashes. In the default context the
    vehicles hover at the first point of the plan. The scenario's `sample` determines wind and noise, as in
    `build_tracking_diagram`.

    A port of k rows contains k N values for N vehicles: row by row, with one value per vehicle in each row.

    Input ports:

    - `wrench` (4 rows): F_z in N along z of the body, and τ_x, τ_y, τ_z in N m about its axes. With an autopilot on
      board it is `attitude_target` (7 rows): F_z in N; roll, pitch, yaw in rad; p, q, r in rad/s.
    - `crashed` (1 row): 1 to freeze the state of a vehicle, 0 otherwise.

    Output ports:

    - `measurement`, `state` (12 rows): x, y, z in m, roll, pitch, yaw in rad, and v_x, v_y, v_z in m/s in the world
      frame; p, q, r in rad/s about the axes of the body.
    - `rotor_speed` (4 rows): in rad/s.
    - `rotor_speed_command` (4 rows): in rad/s. For motors with a thrust curve it is `throttle_command`, from 0 to 1.
    - `shortfall` (4 rows): the part of the wrench that the rotors cannot produce, in N and N m.
    - `wind` (3 rows): velocity of the air at the vehicle in the world frame, in m/s.

    A slung load adds the output `swing` (4 rows: roll and pitch in rad, their rates in rad/s), a battery `charge` (1
    row, in A h) and `battery` (2 rows, in V and A), and an autopilot `wrench`.

    Args:
        scenario: scenario without distributions.
        num_vehicles: number N of vehicles.
        plan: plan at whose first point the vehicles hover at time 0; by default the plan for the scenario's route.
        drake_random: True to connect wind and noise to Drake's random sources instead of the random numbers of the
            samples.

    Raises:
        InputError: under the same conditions as in `build_tracking_diagram`.
    """
    batch = _identical_vehicles(scenario, num_vehicles)
    samples = None if drake_random else batch.noise_samples
    return build_laboratory_from_recipes(_recipes(batch, plan), num_vehicles, samples)


def build_vehicle(scenario: Scenario, num_vehicles: int = 1, *, plan: Plan | None = None) -> FleetSystem:
    """Build only the vehicle of a scenario, without cameras, command link and allocation.

    The system is a `Quadrotor`, whose docstring describes all ports. Its inputs are `rotor_speed_command` (4 rows,
    rad/s) and `wind` (3 rows, m/s; if not connected, the air is still). Its outputs are `state` (12 rows, as in
    `build_laboratory_diagram`) and `rotor_speed` (4 rows, rad/s). A port of k rows contains k N numbers for N vehicles.
    In the default context the vehicles hover at the first point of the plan. If `vehicle.time_step` is 0, the state is
    continuous, as Drake's `Linearize` requires.

    With an autopilot of kind `response`, the system is an `AttitudeResponseQuadrotor`.

    Args:
        scenario: scenario without distributions.
        num_vehicles: number N of vehicles.
        plan: plan at whose first point the vehicles hover at time 0; by default the plan for the scenario's route.

    Raises:
        InputError: under the same conditions as in `build_tracking_diagram`.
    """
    return _recipes(_identical_vehicles(scenario, num_vehicles), plan)["vehicle"].build(num_vehicles)


def _identical_vehicles(scenario: Scenario, num_vehicles: int) -> Batch:
    """Return a batch of vehicles that differ only in wind and noise.

    Raises:
        InputError: if the scenario contains a distribution, or the fleet does not fit into memory.
    """
    check_fleet_fits(num_vehicles, "num_vehicles")
    refuse_distributions(distributions_in(scenario))
    first = scenario.sample or 0
    return Batch.draw(scenario, range(first, first + num_vehicles))


def _recipes(batch: Batch, plan: Plan | None) -> dict[str, Recipe]:
    plan = plan or plan_route(batch.scenario)
    return laboratory_recipes(batch, plan, flight_duration(batch.scenario, plan))


def planning_space(mission: Mission) -> Space | None:
    """Return the obstacles, bounds and clearances for planning a route; None if the mission has no `space`.

    If `space.tracking_error_factor` is not zero, the clearance includes this factor times a predicted tracking error.

    Raises:
        InputError: if the tracking error cannot be predicted; see `nominal_tracking_error`.
    """
    if mission.space is None or not mission.space.tracking_error_factor:
        return mission.flight_space()
    if not isinstance(mission, Scenario):
        raise InputError(
            "space.tracking_error_factor multiplies a predicted tracking error, which requires a scenario with"
            " laboratory and control; set the factor to 0, or plan the route of a complete scenario"
        )
    try:
        predicted = nominal_tracking_error(mission)
    except InputError as error:
        raise InputError(f"space.tracking_error_factor: {error}") from error
    return mission.flight_space(tracking_error=predicted.rms.value)
