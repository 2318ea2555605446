"""Tests of the fleets of a worker."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.flight.mission import plan_route
from drake_quad.studies import flying
from drake_quad.studies.flying import BatchJob, build_fleet, code_versions, delete_fleets, fly_batch, fly_trial


@pytest.fixture
def job():
    scenario = load_scenario("diagrams/robustness.yaml", ["duration=0.1"])
    yield BatchJob("a study", code_versions(UserSystems()), scenario, plan_route(scenario), 10, UserSystems(), True)
    delete_fleets()


class Fleet:
    """Fleet that records its arguments instead of flying."""

    built: list
    flown: list

    def __init__(self, scenario, plan, num_vehicles, **options):
        self.num_vehicles = num_vehicles
        Fleet.built.append((scenario, plan, num_vehicles, options))

    def fly(self, samples, **options):
        Fleet.flown.append((self.num_vehicles, [*samples], options))


@pytest.fixture
def fleet(monkeypatch):
    Fleet.built, Fleet.flown = [], []
    monkeypatch.setattr(flying, "StudyFleet", Fleet)
    return Fleet


def test_fleet_sizes_are_halved_and_each_fleet_is_built_once(job, fleet):
    sizes = {count: flying._fleet(job, count).num_vehicles for count in (10, 6, 5, 4, 3, 2, 1, 10, 3)}
    assert sizes == {10: 10, 6: 10, 5: 5, 4: 5, 3: 3, 2: 2, 1: 1}
    assert [num_vehicles for _, _, num_vehicles, _ in fleet.built] == [10, 5, 3, 2, 1]
    assert all(
        scenario is job.scenario and plan is job.plan and options == {"user_systems": UserSystems(), "compiled": True}
        for scenario, plan, _, options in fleet.built
    )


def test_studies_do_not_share_fleets(job, fleet):
    flying._fleet(job, 10)
    flying._fleet(job._replace(key="another study"), 10)
    flying._fleet(job._replace(key="another study"), 10)
    assert len(fleet.built) == 2
    delete_fleets()
    flying._fleet(job._replace(key="another study"), 10)
    assert len(fleet.built) == 3


def test_user_systems_are_passed_to_the_fleets(job, fleet):
    for name in UserSystems._fields:
        systems = UserSystems(**{name: Fleet})
        other_job = job._replace(key=name, code=code_versions(systems), user_systems=systems)
        flying._fleet(other_job, 10)
        assert fleet.built[-1][3] == {"user_systems": systems, "compiled": True}


def test_a_worker_with_different_code_refuses_every_batch(job, fleet):
    """If the check of the code fails, no fleet is built, so the next batch is checked as well."""
    wrong = job._replace(key="wrong", code={**job.code, "numpy": "0.1"})
    for _ in range(2):
        with pytest.raises(InputError, match="has numpy"):
            flying._fleet(wrong, 10)
    assert fleet.built == []


def test_a_worker_that_refuses_a_study_deletes_earlier_fleets(job, fleet):
    flying._fleet(job, 10)
    with pytest.raises(InputError, match="has numpy"):
        flying._fleet(job._replace(key="wrong", code={**job.code, "numpy": "0.1"}), 10)
    assert vars(flying._thread_data) == {}


def test_a_fleet_flies_two_ticks_before_a_fork(job, fleet):
    build_fleet(job)
    assert fleet.flown == [(10, list(range(10)), {"duration": 0.04})]


@pytest.mark.slow
def test_rows_contain_index_drawn_values_and_metrics(job):
    scenario = job.scenario
    (row,) = fly_batch(job, [6])
    single_flight = simulate(scenario, sample=6, compiled=False)
    assert row[0] == 6.0
    assert row[1] == pytest.approx(single_flight.scenario.vehicle.mass, rel=1e-12)
    assert row[-1] == single_flight.metrics.crash_time == np.inf
    assert row[-2] == single_flight.metrics.crashed == 0.0
    np.testing.assert_allclose(row[-1 - len(single_flight.metrics) : -2], single_flight.metrics[:-1], rtol=1e-9)


def test_a_trial_flies_the_last_sample_twice_alone_and_once_in_the_batch(job, monkeypatch):
    flown = []

    def fly(given, samples):
        assert given is job
        flown.append([*samples])
        return np.array([[sample, len(flown)] for sample in samples])

    monkeypatch.setattr(flying, "fly_batch", fly)
    assert fly_trial(job, range(2, -1, -1)).tolist() == [[0, 1], [0, 2], [0, 3]]
    assert flown == [[0], [0], [2, 1, 0]]
