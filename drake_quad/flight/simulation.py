"""Simulation of a scenario's flights with Drake's simulator."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError, short_repr
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.cause import non_finite_value
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metric, Metrics, check_range, recorded_metrics
from drake_quad.memory import check_fleet_fits
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, refuse_distributions

# Settings of the integrator with error control, which is used if the diagram has a continuous state.
_INTEGRATOR_ACCURACY = 1e-8  # target accuracy
_MAX_INTEGRATOR_STEP = 0.1  # s, largest step
# Smallest step of the integrator for a continuous state, s. With steps of this length, simulating one second of a
# flight takes 15 seconds.
_MIN_INTEGRATOR_STEP = 1e-5
# Part of the message of Drake's exception if the integration requires a smaller step.
_STEP_ERROR_TEXT = "smaller than minimum allowed"


class RecordedSimulation(Protocol):
    """Simulation of a vehicle in N samples, with recorded signals."""

    @property
    def compiled(self) -> bool:
        """True if the diagram is compiled."""

    def metrics(self) -> Metrics:
        """Return the metrics up to the current time, as (N,) arrays."""

    def obstacle_hit(self) -> np.ndarray:
        """Return the (N,) numbers of the obstacles that were hit, counted from 1; 0 for no collision."""

    def recording(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the (ticks,) times, s, and the (ticks, components · N) signals by name."""


def simulate(
    scenario: Scenario,
    *,
    seed: int | None = None,
    sample: int | None = None,
    position_controller: Any = None,
    control: Any = None,
    wind: Any = None,
    policy: Any = None,
    plan: Plan | None = None,
    compiled: bool | None = None,
    until: float | None = None,
    prepare: Callable[[Simulator], None] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Flight:
    """Simulate one vehicle and record all signals.

    Args:
        scenario: scenario without distributions, unless a sample is given.
        seed: seed of the study; by default the seed of the scenario.
        sample: index of the sample to fly, which determines the random parameters, the wind and the noise; by default
            the sample of the scenario. If neither is given, wind and noise are drawn for sample 0.
        position_controller: system that replaces the scenario's position controller; see `build_tracking_diagram`.
        control: system that replaces the whole cascade; see `build_tracking_diagram`.
        wind: system with an additional wind; see `build_tracking_diagram`.
        policy: system that replaces the network of a control of kind `policy`, with the output port `action` and
            optionally the input port `observation`.
        plan: plan to fly; by default the plan for the scenario's route.
        compiled: True to compile the diagram to machine code, False to simulate the original diagram, whose subsystems
            can be inspected at any time. The results are identical. By default the diagram is compiled unless `prepare`
            or a system is given, or the vehicle has a continuous state.
        until: time at which the simulation stops, s; the end of the flight if not given.
        prepare: function that is called with Drake's simulator before the simulation, for example to set a monitor or a
            real-time rate.
        progress: function that is called repeatedly with the simulated time and the total time, s.

    Raises:
        InputError: if the scenario contains a distribution and no sample is given, the rotors cannot fly the route, the
            metric window or `until` is after the end of the flight, or a continuous state changes too fast for the
            integrator.
    """
    sample = scenario.sample if sample is None else sample
    if sample is None:
        refuse_distributions(distributions_in(scenario))
    drawn = Batch.draw(scenario, [sample or 0], seed=seed).vehicle_scenario(0)
    batch = Batch(drawn, (sample or 0,), {})
    plan = plan or plan_route(drawn)
    end = flight_duration(drawn, plan)
    # The last tick of a flight may be up to one control period after `end`.
    if until is not None and not 0.0 < until < end + drawn.laboratory.command_link.period:
        raise InputError(f"until is {until}, but must be larger than 0 and at most the end of the flight, {end:g} s")
    user_systems = UserSystems(position_controller, control, wind, policy)
    if compiled is None:
        compiled = _is_compiled_by_default(drawn) and not user_systems.specified and prepare is None
    simulation = simulate_fleet(batch, plan, user_systems=user_systems, record=True, compiled=compiled)
    simulator = simulation.simulator
    # The integrator is used only if the vehicle has a continuous state.
    integrator = ResetIntegratorFromFlags(simulator, "runge_kutta5", _MAX_INTEGRATOR_STEP)
    integrator.set_target_accuracy(_INTEGRATOR_ACCURACY)
    integrator.set_requested_minimum_step_size(_MIN_INTEGRATOR_STEP)
    if prepare is not None:
        prepare(simulator)
    try:
        simulation.fly(end if until is None else until, progress=progress)
    except RuntimeError as error:
        if _STEP_ERROR_TEXT not in str(error):
            raise
        time = simulator.get_context().get_time()
        raise InputError(
            f"vehicle.time_step is 0, but from {time:.3g} s on the continuous state changes too fast: its integration"
            f" needs steps shorter than {_MIN_INTEGRATOR_STEP:g} s, for example near the singularity at a pitch of 90"
            " degrees; set vehicle.time_step to a positive number"
        ) from None
    return collect_flights(batch, plan, simulation, user_systems)[0]


def simulate_samples(
    scenario: Scenario,
    samples: Sequence[int],
    *,
    seed: int | None = None,
    plan: Plan | None = None,
    compiled: bool | None = None,
) -> list[Flight]:
    """Simulate samples of a study in parallel, as `simulate` does for one sample, and record all signals.

    Args:
        scenario: scenario, which may contain distributions.
        samples: indices of the samples, counted from 0.
        seed: seed of the study; by default the seed of the scenario.
        plan: plan to fly; by default the plan for the scenario's route.
        compiled: see `simulate`.

    Raises:
        InputError: if the route contains a distribution, or the rotors cannot fly it.
    """
    check_fleet_fits(len(samples), "the number of samples")
    return simulate_batch(Batch.draw(scenario, samples, seed=seed), plan=plan, compiled=compiled)


def simulate_batch(batch: Batch, *, plan: Plan | None = None, compiled: bool | None = None) -> list[Flight]:
    """Simulate a batch and record all signals.

    The signals of half a minute of flight take a few megabytes per vehicle.

    Args:
        batch: batch of samples.
        plan: plan to fly; by default the plan for the scenario's route.
        compiled: see `simulate`.

    Raises:
        InputError: if the route contains a distribution, or the rotors cannot fly it.
    """
    plan = plan or plan_route(batch.scenario)
    if compiled is None:
        compiled = _is_compiled_by_default(batch.scenario)
    simulation = simulate_fleet(batch, plan, record=True, compiled=compiled)
    simulation.fly(flight_duration(batch.scenario, plan))
    return collect_flights(batch, plan, simulation)


def _is_compiled_by_default(scenario: Scenario) -> bool:
    """Return True unless the vehicle has a continuous state, which only Drake's integrators can simulate."""
    return scenario.vehicle.time_step > 0.0


def collect_flights(
    batch: Batch, plan: Plan, simulation: RecordedSimulation, user_systems: UserSystems = UserSystems()
) -> list[Flight]:
    """Return the flight of each vehicle of a fleet, up to the current time of the simulation, with all its metrics."""
    metrics, obstacle_hit = simulation.metrics(), simulation.obstacle_hit()
    time, signals = simulation.recording()
    space = batch.scenario.space
    obstacles = [None, *(() if space is None else space.obstacles)]
    rows = {name: values.reshape(len(time), -1, len(batch)) for name, values in signals.items()}
    flights = []
    for i in range(len(batch)):
        metrics_of_vehicle = metrics.with_values(float(value[i]) for value in metrics)
        ticks = time <= metrics_of_vehicle.crash_time
        up_to_crash = {name: values[ticks, :, i] for name, values in rows.items()}
        cause = (
            non_finite_value(time[ticks], up_to_crash, user_systems.specified) if metrics_of_vehicle.crashed else None
        )
        # Ticks with NaN or infinite values, which can occur in the last step before a crash, are omitted.
        ticks &= np.all([np.isfinite(values[:, :, i]).all(axis=1) for values in rows.values()], axis=0)
        recorded = {name: values[ticks, :, i] for name, values in rows.items()}
        obstacle = obstacles[obstacle_hit[i]]
        flight = Flight(
            batch.vehicle_scenario(i),
            plan,
            time[ticks],
            recorded,
            metrics_of_vehicle,
            simulation.compiled,
            obstacle,
            cause,
        )
        functions = recorded_metrics(type(metrics))
        values = {name: _checked_metric(name, metric, metric.value(flight)) for name, metric in functions.items()}
        flights.append(replace(flight, metrics=metrics_of_vehicle._replace(**values)))
    return flights


def _checked_metric(name: str, metric: Metric, value: Any) -> float:
    """Check the value of a metric of a recorded flight, and return it as a float.

    Raises:
        InputError: if the value is not a number, or outside the range that the metric's definition states.
    """
    if not isinstance(value, int | float | np.number):
        raise InputError(f"the metric {name} must be a number, but its function returned {short_repr(value)}")
    check_range(name, metric, value)
    return float(value)


def fly_with_metrics(
    fleet: StudyFleet, batch: Batch, progress: Callable[[float, float], None] | None = None
) -> Metrics:
    """Fly a batch and return all metrics of its n vehicles as (n,) arrays.

    The result includes metrics that are functions of a recorded flight.
    """
    metrics = fleet.fly_batch(batch, progress=progress)
    if not recorded_metrics(type(metrics)):
        return metrics
    flights = collect_flights(batch.padded(fleet.num_vehicles), fleet.plan, fleet.simulation)[: len(batch)]
    return metrics.with_values(np.transpose([flight.metrics for flight in flights]))
