"""The same study by Drake's own Monte Carlo tool, to compare with, and for what is built on it."""

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
    """Flies samples of a scenario by `MonteCarloSimulation`, one vehicle after another.

    Drake's generator is the only source of randomness: it picks the number of the sample whose parameters are drawn,
    and Drake seeds the random sources of wind and noise with it, as it does in any diagram. So the flights have the
    distribution of `run_monte_carlo`'s, but are none of them. A diagram is built for each, since Drake sets parameters
    to their defaults before it simulates.

    Args:
        scenario: with or without distributions.
        num_samples: n.
        seed: in place of the scenario's.

    Returns:
        (n,) arrays of each metric.

    Raises:
        InputError: as `build_tracking_diagram`.
    """
    seed = scenario.seed if seed is None else seed
    plan = plan_route(scenario)
    flights: list[Metrics] = []

    def make_simulator(generator: RandomGenerator) -> Simulator:
        # 31 of its 32 bits: samples are numbered so far.
        drawn = draw_sample(scenario, generator() >> 1, seed=seed)
        return Simulator(build_tracking_diagram(drawn, plan=plan, drake_random=True))

    def output(diagram: Diagram, context: Context) -> float:
        flights.append(read_metrics(diagram, context))
        return float(flights[-1].rmse[0])

    # Past the last tick, whose updates would else be left pending, and short of the next event.
    final_time = flight_duration(scenario, plan) + 0.25 * min(scenario.periods.values())
    MonteCarloSimulation(make_simulator, output, final_time, num_samples, RandomGenerator(seed))
    return Metrics(*(np.concatenate(values) for values in zip(*flights, strict=True)))
