"""Tests of fleets whose vehicles restart at different times, by comparison with Drake's simulator."""

import numpy as np
import pytest
from pydrake.systems.framework import LeafSystem

from drake_quad import load_scenario
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.compilation.clocked_fleet import ClockedFleet, Initializer
from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate
from drake_quad.framework.machine_code import LANES
from drake_quad.gym.task import environment_scenario
from drake_quad.scenario.batch import Batch

SELECTED_OUTPUTS = ("state", "measurement", "reference")


@pytest.fixture
def windy_scenario(diagrams):
    return load_scenario(diagrams / "robustness.yaml", {"duration": 1.0}, layers=["controllers/paper:pd"])


def restart_vehicles(fleet, diagram, vehicles):
    """Restart vehicles of the fleet with the initial values of a diagram's first vehicles."""
    initial = Initializer(diagram, outputs=SELECTED_OUTPUTS).initial_values(diagram.CreateDefaultContext())
    fleet.restart(np.array(vehicles), type(initial)._make(rows[: len(vehicles)] for rows in initial))


@pytest.mark.long
def test_vehicles_that_start_at_different_times_have_the_flights_of_single_vehicles(windy_scenario):
    """The scenario has wind and noise, and some vehicles restart while others continue."""
    n, plan = LANES + 3, plan_route(windy_scenario)
    diagrams = [build_fleet_diagram(Batch.draw(windy_scenario, range(first, first + n)), plan) for first in (0, 40)]
    fleet = ClockedFleet(diagrams[0], tick=0.02, num_ticks=60, outputs=SELECTED_OUTPUTS, monitor="monitor")
    restart_vehicles(fleet, diagrams[0], range(n))
    restarted = [1, LANES, n - 1]
    none = np.zeros((n, 0))
    recorded = {name: [] for name in SELECTED_OUTPUTS}
    for tick in range(45):
        if tick == 17:
            restart_vehicles(fleet, diagrams[1], restarted)
        fleet.advance(none)
        for name in SELECTED_OUTPUTS:
            recorded[name].append(fleet.outputs(name))
    assert fleet.clocks[restarted].tolist() == [28] * 3
    assert fleet.clocks[0] == 45
    for vehicle, sample, first, last in [(0, 0, 0, 45), (LANES + 1, LANES + 1, 0, 45), (1, 1, 0, 17)] + [
        (each, 40 + k, 17, 45) for k, each in enumerate(restarted)
    ]:
        flight = simulate(windy_scenario, sample=sample, until=1.0, compiled=False)
        for name in SELECTED_OUTPUTS:
            actual = np.array([rows[vehicle] for rows in recorded[name][first:last]])
            np.testing.assert_allclose(actual, flight[name][1 : 1 + last - first], rtol=0.0, atol=1e-9)


def test_the_next_state_of_the_monitor_is_its_state_a_tick_later(windy_scenario):
    n, plan = 3, plan_route(windy_scenario)
    diagram = build_fleet_diagram(Batch.draw(windy_scenario, range(n)), plan)
    fleet = ClockedFleet(diagram, tick=0.02, num_ticks=60, outputs=SELECTED_OUTPUTS, monitor="monitor")
    restart_vehicles(fleet, diagram, range(n))
    for _ in range(25):
        fleet.advance(np.zeros((n, 0)))
    sums = fleet.next_state("sums")
    for vehicle in range(n):
        metrics = simulate(windy_scenario, sample=vehicle, until=0.5, compiled=False).metrics
        np.testing.assert_allclose(np.sqrt(sums.records[0].squares.x[vehicle] / 26), metrics.rmse_x, rtol=1e-9)
    assert sums.ticks.tolist() == [26.0] * n
    assert fleet.next_state("crash_time").crash_time.tolist() == [np.inf] * n


def test_the_clock_of_a_vehicle_stays_at_its_last_tick(windy_scenario):
    diagram = build_fleet_diagram(Batch.draw(windy_scenario, range(2)), plan_route(windy_scenario))
    fleet = ClockedFleet(diagram, tick=0.02, num_ticks=3, outputs=SELECTED_OUTPUTS, monitor="monitor")
    restart_vehicles(fleet, diagram, range(2))
    for _ in range(5):
        fleet.advance(np.zeros((2, 0)))
    assert fleet.clocks.tolist() == [3, 3]
    np.testing.assert_allclose(
        fleet.outputs("reference")[0], plan_route(windy_scenario).reference().value(0.08).ravel()[:11]
    )


class PythonWind(LeafSystem):
    """Zero wind in plain Python."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("wind", 6, lambda context, output: output.SetZero())


def test_diagrams_whose_vehicles_cannot_have_individual_clocks_are_refused(windy_scenario):
    def fleet_of(scenario, **user_systems):
        diagram = build_fleet_diagram(
            Batch.draw(scenario, range(2)), plan_route(scenario), user_systems=UserSystems(**user_systems)
        )
        return ClockedFleet(diagram, tick=0.02, num_ticks=3, outputs=SELECTED_OUTPUTS, monitor="monitor")

    with pytest.raises(
        InputError, match="laboratory.wind.own.source, a PythonWind, cannot be compiled, so vehicles of"
    ):
        fleet_of(windy_scenario, wind=PythonWind())
    slow = load_scenario("figure_eight", {"laboratory.motion_capture.period": 0.04})
    with pytest.raises(InputError, match="must repeat in every tick of 0.02 s, but repeat only every 0.04 s"):
        fleet_of(slow)
    task = environment_scenario("figure_eight")
    with pytest.raises(InputError, match="control.policy of figure_eight is missing; give the file of a network"):
        fleet_of(task)
