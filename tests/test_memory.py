"""Tests that a fleet that needs more memory than available is refused before it is built."""

import pytest

from drake_quad import InputError, build_tracking_diagram, load_scenario, memory, run_monte_carlo
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.gym import QuadrotorVectorEnv

ONE_BILLION = 10**9
OVERSIZED_FLEETS = [
    ("num_envs", lambda scenario: QuadrotorVectorEnv(scenario, num_envs=ONE_BILLION)),
    ("num_vehicles", lambda scenario: StudyFleet(scenario, plan_route(scenario), ONE_BILLION)),
    ("num_vehicles", lambda scenario: build_tracking_diagram(scenario, ONE_BILLION)),
    ("the number of samples", lambda scenario: simulate_samples(scenario, range(ONE_BILLION))),
    ("batch", lambda scenario: run_monte_carlo(scenario, ONE_BILLION, batch_size=ONE_BILLION)),
]


@pytest.mark.parametrize(("name", "fly"), OVERSIZED_FLEETS)
def test_a_fleet_that_does_not_fit_into_memory_is_refused(name, fly):
    words = r" is 1,000,000,000, but a fleet of this size needs at least 8,000 GB of memory, and only [\d.,]+ GB are"
    with pytest.raises(InputError, match=name + words):
        fly(load_scenario("figure_eight"))


@pytest.mark.long
def test_a_batch_larger_than_its_study_needs_memory_only_for_the_study(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 10**9)
    study = run_monte_carlo(load_scenario("hover", ["route.duration=0.1"]), 2, num_workers=1, batch_size=ONE_BILLION)
    assert len(study.metrics.crashed) == 2


@pytest.mark.parametrize(("limit", "available"), [("max", 3e9), ("2000000\n", 2e6), (None, 3e9)])
def test_available_memory_is_the_minimum_of_machine_and_container(tmp_path, monkeypatch, limit, available):
    info = tmp_path / "meminfo"
    info.write_text("MemTotal:       9000000 kB\nMemAvailable:    2929687 kB\nBuffers: 0 kB\n", encoding="utf-8")
    monkeypatch.setattr(memory, "_MEMORY_INFO", info)
    monkeypatch.setattr(memory, "_CONTAINER_LIMIT", tmp_path / "memory.max")
    if limit is not None:
        (tmp_path / "memory.max").write_text(limit, encoding="utf-8")
    assert memory.available_memory() == pytest.approx(available, rel=1e-6)


def test_available_memory_is_the_physical_memory_if_there_is_no_meminfo(tmp_path, monkeypatch):
    for name in ("_MEMORY_INFO", "_CONTAINER_LIMIT"):
        monkeypatch.setattr(memory, name, tmp_path / "missing")
    monkeypatch.setattr(memory.os, "sysconf_names", {"SC_PHYS_PAGES": 1, "SC_PAGE_SIZE": 2})
    monkeypatch.setattr(memory.os, "sysconf", {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}.__getitem__)
    assert memory.available_memory() == 4_096_000
    monkeypatch.setattr(memory.os, "sysconf_names", {})
    assert memory.available_memory() is None


def test_every_fleet_is_accepted_if_the_available_memory_is_unknown(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: None)
    memory.check_fleet_fits(ONE_BILLION, "num_envs")


@pytest.mark.slow
def test_a_study_needs_memory_for_a_batch_and_not_for_all_samples(monkeypatch):
    monkeypatch.setattr(memory, "available_memory", lambda: 20_000)  # bytes, for two vehicles
    scenario = load_scenario("hover", ["route.duration=0.1"])
    with pytest.raises(InputError, match=r"^batch is 3, but a fleet of this size needs"):
        run_monte_carlo(scenario, 3, num_workers=1, batch_size=3)
    assert len(run_monte_carlo(scenario, 3, num_workers=1, batch_size=1).metrics.crashed) == 3
