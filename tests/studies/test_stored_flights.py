"""Tests of searches with several workers, and of searches that are resumed."""

from collections import namedtuple
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.falsification import MIN_FLIGHTS, find_worst_case
from drake_quad.studies.processes import Workers
from drake_quad.studies.risk import estimate_risk
from drake_quad.studies.sobol_indices import sobol_indices
from drake_quad.studies.stored_flights import FLIGHTS_FILE, stored_flights
from drake_quad.studies.study_folder import StudyInterrupted
from drake_quad.studies.worker_pool import ExecutorPool

MASS_DISTRIBUTION = "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.5}}"
NOISY_OVERRIDES = ["duration=0.1", MASS_DISTRIBUTION, "laboratory.motion_capture.position_noise=0.003"]
POINTS, NUMBERS = np.random.default_rng(0).random((10, 2)), np.arange(10)
Values = namedtuple("Values", ["total"])


class Sum:
    """Stub of an evaluator whose value is the sum of the coordinates. Batches of three end in reverse order."""

    plan = None

    def __init__(self):
        self.flown = []

    def batches(self, points, noise):
        for first in range(0, len(points), 3)[::-1]:
            part = points[first : first + 3]
            self.flown += part.tolist()
            yield np.arange(first, first + len(part)), Values(part.sum(axis=1) + noise[first : first + 3, 0])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("hover", NOISY_OVERRIDES)


@pytest.fixture
def search(scenario, tmp_path, monkeypatch):
    """Return a function that evaluates points in two calls, and returns their values and the flown points."""
    monkeypatch.setattr("drake_quad.studies.stored_flights.flight_duration", lambda *_: 1.0)

    def evaluate(points=POINTS, value=lambda values: values.total, *, resume=False, progress=None, **settings):
        evaluator = Sum()
        options = {
            "user_systems": UserSystems(),
            "compiled": True,
            "folder": tmp_path,
            "resume": resume,
            "progress": progress,
        }
        with stored_flights(
            evaluator, value, scenario, {"search": "sum", **settings}, max_flights=20, **options
        ) as flights:
            values = [flights(points[part], NUMBERS[part]) for part in (slice(4), slice(4, None))]
        assert flights.num_flights == len(points)
        return np.concatenate(values), evaluator.flown

    return evaluate


def test_each_flight_has_the_value_of_its_own_point(search):
    values, flown = search()
    np.testing.assert_array_equal(values, POINTS.sum(axis=1) + NUMBERS)
    assert sorted(flown) == sorted(POINTS.tolist())


@pytest.mark.parametrize("num_bytes", [0, 10, 60, 130, 400, 10_000])
def test_a_search_that_was_killed_flies_only_missing_points(search, tmp_path, num_bytes):
    """The file is cut at any byte, as if the process had been killed before the rest was written."""
    values, _ = search()
    content = (tmp_path / FLIGHTS_FILE).read_bytes()
    (tmp_path / FLIGHTS_FILE).write_bytes(content[:num_bytes])
    num_stored = max(content[:num_bytes].count(b"\n") - 1, 0)
    reported = []
    resumed_values, flown = search(resume=True, progress=reported.append)
    np.testing.assert_array_equal(resumed_values, values)
    assert sorted(flown) == sorted(POINTS[num_stored:].tolist())
    # Progress counts stored flights as well.
    assert sum(reported) == len(POINTS)
    assert 0 not in reported
    assert (tmp_path / FLIGHTS_FILE).read_bytes() == content


def test_infinite_and_small_values_are_read_as_they_were_written(search):
    exact = np.array([np.inf, -np.inf, 0.1 + 0.2, 1e-300, -1.0 / 3.0, 0.0, 1.0, 2.0, 3.0, 4.0])

    numbers = dict(zip((POINTS.sum(axis=1) + NUMBERS).tolist(), exact, strict=True))
    first, _ = search(value=lambda values: np.array([numbers[each] for each in values.total]))
    resumed_values, flown = search(resume=True)
    np.testing.assert_array_equal(first, exact)
    np.testing.assert_array_equal(resumed_values, exact)
    assert flown == []


def test_an_interruption_says_how_many_flights_are_saved(search):
    def interrupt(count):
        raise KeyboardInterrupt

    with pytest.raises(StudyInterrupted, match=r"interrupted: 1 flights are in .*flights.csv, and --resume continues"):
        search(progress=interrupt)
    assert len(search(resume=True)[1]) == 9


def test_a_search_with_other_settings_or_points_is_not_continued(search, tmp_path):
    search(metric="rmse")
    with pytest.raises(InputError, match="already contains a study; continue it with --resume"):
        search(metric="rmse")
    with pytest.raises(InputError, match="contains a different study: its metric is rmse, not peak_error"):
        search(metric="peak_error", resume=True)
    with pytest.raises(InputError, match="since flight 0 of the earlier run had other random numbers"):
        search(1.0 - POINTS, metric="rmse", resume=True)
    (tmp_path / FLIGHTS_FILE).unlink()
    with pytest.raises(InputError, match="study.yaml exists already and is not overwritten"):
        search(metric="peak_error")


SEARCHES = {
    "risk": lambda scenario, **more: (
        estimate_risk(scenario, "peak_error > 0.0013", size=500, half_width=1.0, noise_period=0.05, **more).probability
    ),
    "falsify": lambda scenario, **more: find_worst_case(
        scenario, "peak_error", max_flights=3 * MIN_FLIGHTS, num_noise=1, **more
    ).point.tolist(),
    "sobol": lambda scenario, **more: sobol_indices(scenario, "rmse_z", num_points=16, **more),
}


@pytest.mark.long
@pytest.mark.parametrize("name", SEARCHES)
def test_results_are_equal_for_any_number_of_workers_and_after_an_interruption(scenario, name, tmp_path):
    search, folders, calls = SEARCHES[name], [tmp_path / each for each in ("here", "workers")], []
    expected = search(scenario, folder=folders[0])

    def interrupt(*_):
        calls.append(None)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with Workers(2) as workers, pytest.raises(StudyInterrupted, match="and --resume continues"):
        search(scenario, pool=workers, folder=folders[1], progress=interrupt)
    with Workers(3) as workers:
        assert search(scenario, pool=workers, folder=folders[1], resume=True) == expected
    contents = [(folder / FLIGHTS_FILE).read_bytes() for folder in folders]
    assert contents[0] == contents[1]


@pytest.mark.long
def test_metrics_do_not_depend_on_the_workers(scenario):
    local = Evaluator(scenario, num_vehicles=4, noise_period=0.05)
    noise = np.arange(2 * len(POINTS)).reshape(-1, 2)
    expected = local(POINTS[:, :1], noise)
    with ThreadPoolExecutor(2) as executor:
        with_workers = Evaluator(scenario, num_vehicles=4, noise_period=0.05, pool=ExecutorPool(executor, 2))
        for _ in range(2):
            np.testing.assert_array_equal(with_workers(POINTS[:, :1], noise), expected)
    assert with_workers.num_flights == 20
