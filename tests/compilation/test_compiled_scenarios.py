"""Tests that compiled and uncompiled diagrams have the same flights, for shipped and random scenarios."""

import os
from pathlib import Path

import numpy as np
import pytest
from compiled_comparison import assert_flown_alike
from covering import covering
from random_scenarios import scenario_of, structures
from ruamel.yaml import YAML

from drake_quad import load_scenario
from drake_quad.assembly.control import control_recipes
from drake_quad.assembly.laboratory import laboratory_recipes
from drake_quad.flight.mission import plan_route
from drake_quad.scenario.batch import Batch

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
# Each diagram structure is compiled once and flown with several sets of parameters. `make fuzz` tests more cases.
NUM_FUZZ_CASES = os.environ.get("FUZZ_CASES")
SAMPLES_PER_STRUCTURE = 8
STRUCTURES_PER_SEED = 8
NUM_STRUCTURES = int(NUM_FUZZ_CASES) // 100 if NUM_FUZZ_CASES else STRUCTURES_PER_SEED


def specs():
    """Yield all scenarios in `diagrams`, and asymmetric scenarios, which reveal errors that symmetry hides."""
    for path in sorted((ROOT / "diagrams").glob("*.yaml")):
        yield from (f"{path}:{name}" for name in YAML(typ="safe").load(path))
    yield from (
        f"{ROOT}/tests/asymmetric.yaml:{name}" for name in ("pid", "pd_t2fnn", "pd_t1fnn", "lqg", "lqg_on_board")
    )


def _kind(value):
    """Return the type of a number, or the representation of any other value."""
    return type(value) if type(value) in (int, float) else repr(value)


def features_of(batch, plan):
    """Return the features of a batch's diagram: the class of each system, with each of its structural arguments.

    A structural argument, such as `effects`, determines ports and events of a system. Each item of a tuple, such as
    each effect, is a separate feature. Numbers, such as periods, count as equal if they have the same type.
    """
    recipes = laboratory_recipes(batch, plan, 1.0) | control_recipes(batch, plan)
    features = set()
    for each in recipes.values():
        for name, value in each.structure.items():
            items = value if type(value) is tuple else (value,)
            features |= {(each.system, name, _kind(item)) for item in items}
        features.add((each.system,))
    return features


@pytest.mark.long
@pytest.mark.usefixtures("cached_results")
def test_every_system_of_the_shipped_scenarios_has_the_same_flight_when_compiled():
    """The test flies a subset of the scenarios that covers all features of `features_of`.

    Obstacles are removed, because their plans take seconds, and the last test compares flights among obstacles.
    """
    plans, batches, features = {}, {}, {}
    for spec in specs():
        scenario = load_scenario(spec, ["duration=0.6", "metrics={start: 0, end: null}"])
        scenario = scenario.model_copy(update={"space": None})
        route = str(scenario.route), str(scenario.nominal)
        plan = plans[spec] = plans[route] = plans.get(route) or plan_route(scenario)
        batches[spec] = Batch.draw(scenario, [3])
        features[spec] = features_of(batches[spec], plan)
    for spec in covering(features):
        (flight,) = assert_flown_alike(batches[spec], plan=plans[spec])
        assert len(flight.time) == round(0.6 / flight.scenario.laboratory.command_link.period) + 1, spec


@pytest.mark.long
@pytest.mark.parametrize("number", range(NUM_STRUCTURES))
def test_random_scenarios_have_the_same_flights_when_compiled(number, tmp_path):
    rng = np.random.default_rng([number, 1])
    structure = structures(np.random.default_rng(number // STRUCTURES_PER_SEED), STRUCTURES_PER_SEED)[
        number % STRUCTURES_PER_SEED
    ]
    scenario = scenario_of(structure, rng, tmp_path, duration=0.7)
    flights = assert_flown_alike(Batch.draw(scenario, range(SAMPLES_PER_STRUCTURE)))
    assert len({flight.metrics.rmse for flight in flights}) == SAMPLES_PER_STRUCTURE
    if NUM_FUZZ_CASES:
        assert_flown_alike(Batch.draw(scenario, [number]))


OBSTACLES = {
    "pillar": {"kind": "cylinder", "centre": [1.9, 2.3, 1.0], "radius": 0.05, "height": 4.0},
    "beam": {"kind": "box", "centre": [9.0, 1.6, 2.0], "size": [0.3, 0.3, 0.3], "rotation": [0.1, 0.2, 0.3]},
    "ball": {"kind": "sphere", "centre": [-0.3, 3.9, 1.98], "radius": 0.1},
    "rock": {"kind": "hull", "points": [[0, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]], "centre": [-1.8, 1.9, 1.8]},
}


@pytest.mark.long
def test_compiled_fleets_uncompiled_fleets_and_single_vehicles_hit_the_same_obstacles():
    scenario = load_scenario(f"{ROOT}/diagrams/robustness.yaml", {"space": {"obstacles": OBSTACLES}, "duration": 12.0})
    fleet = assert_flown_alike(Batch.draw(scenario, range(8)))
    touched = [flight.obstacle_hit for flight in fleet]
    assert len({*touched}) > 2
    single = assert_flown_alike(Batch.draw(scenario, [5]))[0]
    assert (single.obstacle_hit, single.crash) == (fleet[5].obstacle_hit, fleet[5].crash)
    for flight in fleet:
        if flight.obstacle_hit is not None:
            state, solid = flight.record("state"), scenario.space.obstacles[flight.obstacle_hit].shape()
            distances = solid.distances(np.column_stack([state.x, state.y, state.z]))
            assert distances[-1] < 0.17 <= distances[:-1].min()
