"""Flying a scenario under Drake's simulator."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator

from drake_quad.assembly.planning import flight_duration, plan_route, refuse_distributions
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.errors import InputError
from drake_quad.flight.cause import not_a_number
from drake_quad.flight.fleet_simulation import FleetSimulation, simulate_fleet
from drake_quad.flight.flight import Flight
from drake_quad.laboratory.metrics import Metrics
from drake_quad.memory import check_fleet_fits
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Batch, Scenario, distributions_in

_ACCURACY, _MAX_STEP = 1e-8, 0.1
# Of steps for a continuous state, s: a second of flight takes a quarter of a minute with these.
_MIN_STEP = 1e-5
# How Drake says that they are too long.
_TOO_FAST = "smaller than minimum allowed"


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
    compiled: bool = False,
    until: float | None = None,
    prepare: Callable[[Simulator], None] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Flight:
    """Flies one vehicle and records every signal.

    Args:
        scenario: with numbers only, unless a sample is given.
        seed: of the study, in place of the scenario's.
        sample: number of the sample of the study to fly, in place of the scenario's: with what is drawn for it, in its
            wind and with its noise. Without one, these are wind and noise of sample 0.
        position_controller: stands in for the scenario's; see `build_tracking_diagram`.
        control: stands in for the whole cascade; see there.
        wind: blows beside the scenario's; see there.
        policy: a system that stands in for the network of a control of kind `policy`: from `observation`, if it looks
            at it, to `action`.
        plan: flown instead of that of the scenario's route.
        compiled: whether the diagram is compiled to machine code first, as for studies; else it flies as it is wired,
            where every port and every state can be looked into at any time.
        until: when to stop, s; at the end of the flight if not given, and no later.
        prepare: called with Drake's simulator before it flies, to set a monitor or a rate of real time.
        progress: called now and then with the time flown and the time to fly, s.

    Raises:
        InputError: the scenario holds a distribution and no sample is given, the rotors cannot fly the route, the
            metric window or `until` lies beyond the flight, or a continuous state changes too fast.
    """
    sample = scenario.sample if sample is None else sample
    if sample is None:
        refuse_distributions(distributions_in(scenario))
    drawn = Batch.draw(scenario, [sample or 0], seed=seed).scenario_of(0)
    batch = Batch(drawn, (sample or 0,), {})
    plan = plan or plan_route(drawn)
    end = flight_duration(drawn, plan)
    # The last tick may be a little later than the end.
    if until is not None and not 0.0 < until < end + drawn.laboratory.command_link.period:
        raise InputError(f"until is {until}, but must be larger than 0 and at most the end of the flight, {end:g} s")
    own = UserSystems(position_controller, control, wind, policy)
    simulation = simulate_fleet(batch, plan, own=own, record=True, compiled=compiled)
    simulator = simulation.simulator
    # For a vehicle with a continuous state; a stepping one does not use the integrator.
    integrator = ResetIntegratorFromFlags(simulator, "runge_kutta5", _MAX_STEP)
    integrator.set_target_accuracy(_ACCURACY)
    integrator.set_requested_minimum_step_size(_MIN_STEP)
    if prepare is not None:
        prepare(simulator)
    try:
        simulation.fly(end if until is None else until, progress=progress)
    except RuntimeError as error:
        if _TOO_FAST not in str(error):
            raise
        time = simulator.get_context().get_time()
        raise InputError(
            f"vehicle.time_step is 0, but from {time:.3g} s on something moves too fast for the integration of a"
            f" continuous state, in less than {_MIN_STEP:g} s, such as roll and yaw at a pitch of 90 degrees; give it a"
            " step"
        ) from None
    return _flights(batch, plan, simulation, own)[0]


def simulate_samples(
    scenario: Scenario,
    samples: Sequence[int],
    *,
    seed: int | None = None,
    plan: Plan | None = None,
    compiled: bool = False,
) -> list[Flight]:
    """Flies samples of a study side by side and records every signal of each, as `simulate` does of one.

    Args:
        scenario: with or without distributions.
        samples: numbers of samples, from 0 on.
        seed: in place of the scenario's.
        plan: flown instead of that of the scenario's route.
        compiled: as for `simulate`.

    Raises:
        InputError: the route holds a distribution, or the rotors cannot fly it.
    """
    check_fleet_fits(len(samples), "the number of samples")
    return simulate_batch(Batch.draw(scenario, samples, seed=seed), plan=plan, compiled=compiled)


def simulate_batch(batch: Batch, *, plan: Plan | None = None, compiled: bool = False) -> list[Flight]:
    """Flies a batch and records every signal of each vehicle: a few megabytes a flight of half a minute.

    Args:
        batch: to fly.
        plan: flown instead of that of the scenario's route.
        compiled: as for `simulate`.

    Raises:
        InputError: the route holds a distribution, or the rotors cannot fly it.
    """
    plan = plan or plan_route(batch.scenario)
    simulation = simulate_fleet(batch, plan, record=True, compiled=compiled)
    simulation.fly(flight_duration(batch.scenario, plan))
    return _flights(batch, plan, simulation)


def _flights(batch: Batch, plan: Plan, simulation: FleetSimulation, own: UserSystems = UserSystems()) -> list[Flight]:
    """The flights of a fleet's vehicles so far."""
    metrics, touched = simulation.metrics(), simulation.touched()
    time, signals = simulation.recording()
    space = batch.scenario.space
    obstacles = [None, *(() if space is None else space.obstacles)]
    rows = {name: values.reshape(len(time), -1, len(batch)) for name, values in signals.items()}
    flights = []
    for i in range(len(batch)):
        mine = Metrics(*(float(value[i]) for value in metrics))
        kept = time <= mine.crash_time
        signals_of = {name: values[kept, :, i] for name, values in rows.items()}
        cause = not_a_number(time[kept], signals_of, own.given) if mine.crashed else None
        # Within the step into its crash a vehicle may have left all numbers behind.
        kept &= np.all([np.isfinite(values[:, :, i]).all(axis=1) for values in rows.values()], axis=0)
        shown = {name: values[kept, :, i] for name, values in rows.items()}
        name = obstacles[touched[i]]
        flights.append(Flight(batch.scenario_of(i), plan, time[kept], shown, mine, simulation.compiled, name, cause))
    return flights
