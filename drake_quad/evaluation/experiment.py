"""Experiment of the evaluation: flights of designed controllers on samples that were not used for tuning."""

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.design.tuning import LATENCY
from drake_quad.errors import InputError
from drake_quad.evaluation.designs import design_file, designs_in
from drake_quad.evaluation.entries import MAPPED
from drake_quad.evaluation.families import FAMILIES, FIRST_JUDGED, LaboratoryFamily, laps_of
from drake_quad.evaluation.results import (
    LAPS_IN,
    PRICED,
    PRICED_CONTROLLERS,
    PRICED_IN,
    SENSITIVITIES,
    Evaluation,
    Traits,
    in_laps,
    priced_name,
    read_evaluation,
    write_evaluation,
)
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.link_margins import link_margins
from drake_quad.planning.duration import flight_duration
from drake_quad.reports.jobs import Job, run_jobs
from drake_quad.scenario.batch import Batch, middle_of
from drake_quad.scenario.files.loading import Override
from drake_quad.scenario.models import Scenario

_NUM_TIMED_FLIGHTS = 3  # number of flights of a single vehicle whose CPU time is measured


class OwnController(NamedTuple):
    """Controller of the user's, which is compared with the designed ones.

    Attributes:
        name: name in the report.
        layers: layers over a laboratory.
        overrides: overrides of the laboratory.
    """

    name: str
    layers: Sequence[str] = ()
    overrides: Sequence[Override] = ()


class EvaluationSizes(NamedTuple):
    """Numbers of samples of the experiment.

    Attributes:
        samples: samples of each controller in each laboratory.
        slow: samples of a controller that cannot be flown in fleets.
        laps: samples of each number of laps.
        most_laps: largest number of laps.
        delayed: samples of each additional delay.
        most_frames: largest additional delay, camera frames.
        duration: duration of a flight, s; None for whole routes.
    """

    samples: int = 256
    slow: int = 32
    laps: int = 64
    most_laps: int = 6
    delayed: int = 16
    most_frames: int = 40
    duration: float | None = None

    @property
    def overrides(self) -> tuple[str, ...]:
        """Overrides for shorter flights."""
        return () if self.duration is None else (f"duration={self.duration!r}",)


QUICK = EvaluationSizes(samples=4, slow=2, laps=2, most_laps=2, delayed=2, most_frames=4, duration=1.0)
# Result of a flight: the laboratory and the controller's metrics, or the family and the controller's traits.
Result = tuple[str, str, Metrics | Traits]


def fly_evaluation(
    diagrams: Path,
    families: Sequence[str],
    sizes: EvaluationSizes,
    folder: Path,
    *,
    only: Sequence[str] | None = None,
    own: Sequence[OwnController] = (),
    progress: Callable[[int, int, str], object] = lambda *_: None,
) -> Evaluation:
    """Fly all designed controllers of some families, and write the numbers after each job.

    Args:
        diagrams: folder of the shipped scenarios.
        families: names of the families.
        sizes: sizes of the experiment.
        folder: folder for the numbers.
        only: names of the designed controllers; all by default.
        own: further controllers, which fly as they are.
        progress: called with the number of jobs that are done, the number of all jobs, and the name of the last one.

    Returns:
        The numbers that `read_evaluation` reads from the folder.

    Raises:
        InputError: none of these controllers has a design.
    """
    jobs = [job for name in families for job in _jobs(diagrams, name, sizes, only, own)]
    if not jobs:
        raise InputError("there is no design of what shall be flown")
    flights: dict[str, dict[str, Metrics]] = {}
    traits: dict[str, dict[str, Traits]] = {}

    def keep(results: Sequence[Result]) -> None:
        for place, controller, numbers in results:
            if isinstance(numbers, Traits):
                traits.setdefault(place, {})[controller] = numbers
            else:
                flights.setdefault(place, {})[controller] = numbers
        write_evaluation(folder, Evaluation(flights, traits))

    # Workers are not used, since processes that fly at the same time increase each other's CPU times.
    run_jobs(jobs, finished=keep, progress=progress)
    return read_evaluation(folder)


def _jobs(
    diagrams: Path, name: str, sizes: EvaluationSizes, only: Sequence[str] | None, own: Sequence[OwnController]
) -> Iterator[Job]:
    """Yield the jobs of a family."""
    family, designs = FAMILIES[name], designs_in(design_file(diagrams, name))
    entries = [each for each in family.entries if each in designs and (only is None or each in only)]
    for entry in entries:
        yield Job(f"{name} {entry}", 1, partial(_results, fly_family, diagrams, name, family, entry, sizes))
    for each in own:
        yield Job(f"{name} {each.name}", 1, partial(_results, fly_controller, diagrams, name, family, each, sizes))
    if entries and LAPS_IN in family.laboratories:
        yield Job("laps", 1, partial(_results, fly_laps, diagrams, name, family, entries, sizes))
        yield Job(PRICED, 1, partial(_results, fly_priced, diagrams, family, entries, sizes))


def _results(fly: Callable[..., Iterator[Result]], *arguments: Any) -> list[Result]:
    return [*fly(*arguments)]


def fly_family(
    diagrams: Path, name: str, family: LaboratoryFamily, controller: str, sizes: EvaluationSizes
) -> Iterator[Result]:
    """Fly a designed controller in the laboratories of a family.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        controller: name of the controller in the family's file.
        sizes: sizes of the experiment.

    Yields:
        Each laboratory with the controller's metrics, and then the family with the controller's traits.
    """
    path, entry = design_file(diagrams, name), family.entries[controller]
    flown = OwnController(controller, [f"{path}:{controller}"])
    around = flown._replace(layers=[f"{path}:{entry.around or controller}"])
    return fly_controller(diagrams, name, family, flown, sizes, around=around, slow=entry.slow)


def fly_controller(
    diagrams: Path,
    name: str,
    family: LaboratoryFamily,
    controller: OwnController,
    sizes: EvaluationSizes,
    *,
    around: OwnController | None = None,
    slow: bool = False,
) -> Iterator[Result]:
    """Fly a controller in the laboratories of a family.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        controller: controller that is flown.
        sizes: sizes of the experiment.
        around: controller without its network, whose margins are returned; by default the controller itself.
        slow: True to fly fewer samples, without compiling the diagram.

    Yields:
        Each laboratory with the controller's metrics, and then the family with the controller's traits.
    """

    def scenario(place: str, flown: OwnController = controller, overrides: Sequence[str] = ()) -> Scenario:
        return family.scenario(diagrams, place, flown.layers, [*flown.overrides, *overrides])

    time_in_fleet = math.nan
    for place in family.laboratories:
        metrics, spent = timed_flights(
            scenario(place, overrides=sizes.overrides), sizes.slow if slow else sizes.samples, compiled=not slow
        )
        time_in_fleet = spent if place == family.windiest else time_in_fleet
        yield place, controller.name, metrics
    margins = worst_margins(scenario(family.trained[0], around or controller))
    windy = scenario(family.windiest, overrides=sizes.overrides)
    delay = math.nan if slow else delay_flown(windy, sizes)
    yield name, controller.name, Traits(*margins, delay, lone_time(windy, compiled=not slow), time_in_fleet)


def fly_laps(
    diagrams: Path, name: str, family: LaboratoryFamily, entries: Sequence[str], sizes: EvaluationSizes
) -> Iterator[Result]:
    """Fly networks over the position and their base controllers with an increasing number of laps.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        entries: names of the controllers that may be flown.
        sizes: sizes of the experiment.
    """
    path = design_file(diagrams, name)
    names = [each for base in MAPPED for each in (base, f"{base}_t2fnn_map") if f"{base}_t2fnn_map" in entries]
    for controller in names:
        for count in range(1, sizes.most_laps + 1):
            scenario = family.scenario(diagrams, LAPS_IN, [f"{path}:{controller}"], laps_of(count))
            yield in_laps(count), controller, timed_flights(scenario, sizes.laps)[0]


def fly_priced(
    diagrams: Path, family: LaboratoryFamily, entries: Sequence[str], sizes: EvaluationSizes
) -> Iterator[Result]:
    """Fly designs with other limits on the peak sensitivity.

    Args:
        diagrams: folder of the shipped scenarios.
        family: family of laboratories.
        entries: names of the controllers that may be flown.
        sizes: sizes of the experiment.
    """
    path = design_file(diagrams, PRICED)
    designs = designs_in(path)
    names = [priced_name(*each) for each in itertools.product(PRICED_CONTROLLERS, SENSITIVITIES) if each[0] in entries]
    for name in (each for each in names if each in designs):
        scenario = family.scenario(diagrams, PRICED_IN, [f"{path}:{name}"], sizes.overrides)
        metrics, spent = timed_flights(scenario, sizes.samples)
        yield PRICED_IN, name, metrics
        margins = worst_margins(family.scenario(diagrams, PRICED_IN, [f"{path}:{name}"]))
        yield PRICED, name, Traits(*margins, delay_flown(scenario, sizes), lone_time(scenario), spent)


def timed_flights(scenario: Scenario, count: int, *, compiled: bool = True) -> tuple[Metrics, float]:
    """Return the metrics of the judged samples, and the CPU time of a vehicle per tick, s.

    Args:
        scenario: scenario to fly.
        count: number of samples.
        compiled: True to compile the diagram to machine code. Otherwise the original diagram is simulated.
    """
    fleet = StudyFleet(scenario, plan_route(scenario), count, compiled=compiled)
    begun = time.process_time()
    metrics = fleet.fly(range(FIRST_JUDGED, FIRST_JUDGED + count))
    return metrics, (time.process_time() - begun) / (count * _ticks(fleet))


def _ticks(fleet: StudyFleet) -> float:
    return fleet.duration / fleet.scenario.laboratory.command_link.period


def lone_time(scenario: Scenario, *, compiled: bool = True) -> float:
    """Return the CPU time of a lone vehicle's whole loop per tick, the shortest of some flights, s."""
    fleet, spent = StudyFleet(scenario, plan_route(scenario), 1, compiled=compiled), []
    for sample in range(FIRST_JUDGED, FIRST_JUDGED + _NUM_TIMED_FLIGHTS):
        begun = time.process_time()
        metrics = fleet.fly([sample])
        flown = min(fleet.duration, float(metrics.crash_time.min()))
        spent.append((time.process_time() - begun) * fleet.duration / flown)
    return min(spent) / _ticks(fleet)


def delay_flown(scenario: Scenario, sizes: EvaluationSizes) -> float:
    """Return the tolerated additional delay, s: one frame less than the smallest one with which a sample crashes.

    The delay is infinite if no sample crashes with any delay, and negative if one crashes without additional delay.
    """
    samples = range(FIRST_JUDGED, FIRST_JUDGED + sizes.delayed)
    frames = np.arange(sizes.most_frames + 1)
    batch = Batch.draw(scenario, [*samples] * len(frames))
    own = batch.varying.get(LATENCY, scenario.laboratory.motion_capture.latency_frames)
    plan = plan_route(scenario)
    fleet = simulate_fleet(
        batch.with_varying({LATENCY: own + np.repeat(frames, len(samples)).astype(float)}), plan, compiled=True
    )
    fleet.fly(flight_duration(scenario, plan))
    crashed = fleet.metrics().crashed.reshape(len(frames), -1).any(axis=1)
    if not crashed.any():
        return math.inf
    return (float(np.argmax(crashed)) - 1.0) * scenario.laboratory.motion_capture.period


def worst_margins(scenario: Scenario) -> tuple[float, float]:
    """Return the peak sensitivity and the smallest delay margin (s) of the middle plant; NaN without a linear model."""
    try:
        found = [each for each in link_margins(middle_of(scenario)).values() if each is not None]
    except InputError:
        return math.nan, math.nan
    return max(each.sensitivity for each in found), min(each.delay for each in found)


def missing_designs(diagrams: Path, name: str) -> list[str]:
    """Return the names of the controllers for which a family has no design."""
    designs = designs_in(design_file(diagrams, name))
    return [entry for entry in FAMILIES[name].entries if entry not in designs]
