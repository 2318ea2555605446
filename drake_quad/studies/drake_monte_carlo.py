"""Studies with Drake's `MonteCarloSimulation`, for comparison and for code that already uses this class."""

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import MonteCarloSimulation, Simulator
from pydrake.systems.framework import Context, Diagram

from drake_quad.fleets.fleet_simulation import read_metrics
from drake_quad.flight.mission import build_tracking_diagram, plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import draw_sample
from drake_quad.scenario.models import Scenario


def drake_monte_carlo(scenario: Scenario, num_samples: int, seed: int | None = None) -> Metrics:
    """Fly samples of a scenario with `MonteCarloSimulation`, one vehicle after another.

    Drake's generator is the only source of randomness. It selects the index of the sample whose parameters are drawn,
    and it seeds the random sources of wind and noise. The flights therefore have the same distribution as the flights
    of `run_monte_carlo`, but are different flights. Each flight uses a new diagram, since Drake resets the parameters
    of a diagram to their defaults before a simulation.

    Args:
        scenario: scenario, with or without distributions.
        num_samples: number n of samples.
        seed: seed of the study; the scenario's seed by default.

    Returns:
        (n,) values of each metric.

    Raises:
        InputError: if `build_tracking_diagram` cannot build the diagram of a sample.
    """
    seed = scenario.seed if seed is None else seed
    plan = plan_route(scenario)
    flights: list[Metrics] = []

    def make_simulator(generator: RandomGenerator) -> Simulator:
        # The generator returns 32 bits, but the index of a sample has at most 31.
        drawn = draw_sample(scenario, generator() >> 1, seed=seed)
        return Simulator(build_tracking_diagram(drawn, plan=plan, drake_random=True))

    def output(diagram: Diagram, context: Context) -> float:
        flights.append(read_metrics(diagram, context))
        return float(flights[-1].rmse[0])

    # The simulation ends after the last tick and before the next event. If it ended at the tick, its updates would
    # remain pending.
    final_time = flight_duration(scenario, plan) + 0.25 * min(scenario.periods.values())
    MonteCarloSimulation(make_simulator, output, final_time, num_samples, RandomGenerator(seed))
    return flights[0].with_values(np.concatenate(values) for values in zip(*flights, strict=True))
