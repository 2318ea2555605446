"""The flights by which controllers are judged, on samples on which none was tuned."""

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.design.tuning import LATENCY
from drake_quad.errors import InputError
from drake_quad.evaluation.designs import design_file, designs_in
from drake_quad.evaluation.entries import MAPPED, Entry, entries_of
from drake_quad.evaluation.families import FIRST_JUDGED, Family, laps_of
from drake_quad.evaluation.results import (
    LAPS_IN,
    PRICED,
    PRICED_CONTROLLERS,
    PRICED_IN,
    SENSITIVITIES,
    Traits,
    in_laps,
    priced_name,
)
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.link_margins import link_margins
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import Batch, middle_of
from drake_quad.scenario.models import Scenario

# Flights of a lone vehicle whose time is taken.
_TIMED = 3


class Sizes(NamedTuple):
    """How much is flown.

    Attributes:
        samples: of each controller in each laboratory.
        slow: of one that is no fleet's.
        laps: samples of each number of laps.
        most_laps: that are flown.
        delayed: samples of each further delay.
        most_frames: of further delay.
        duration: of a flight, s; None for whole routes.
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


QUICK = Sizes(samples=4, slow=2, laps=2, most_laps=2, delayed=2, most_frames=4, duration=1.0)
# What is judged: laboratory or family, controller, and what was found.
Told = tuple[str, str, Metrics | Traits]


def judge_family(diagrams: Path, name: str, family: Family, entries: Sequence[str], sizes: Sizes) -> Iterator[Told]:
    """Flies designed controllers in the laboratories of a family.

    Args:
        diagrams: folder of the shipped scenarios.
        name: of the family.
        family: of laboratories.
        entries: names of the controllers, all of which the family's file has.
        sizes: of the evaluation.

    Yields:
        A laboratory, a controller and its metrics; after the last laboratory the family, the controller and its traits.
    """
    path = design_file(diagrams, name)
    known = entries_of(on_board=family.on_board, maps=family.maps)
    margins: dict[str, tuple[float, float]] = {}
    for controller in entries:
        layer, entry = f"{path}:{controller}", known[controller]
        fleet = math.nan
        for place in family.laboratories:
            scenario = family.scenario(diagrams, place, [layer], sizes.overrides)
            metrics, spent = fly_judged(scenario, sizes, slow=entry.slow)
            fleet = spent if place == family.windiest else fleet
            yield place, controller, metrics
        base = entry.around or controller
        if base not in margins:
            margins[base] = worst_margins(family.scenario(diagrams, family.trained[0], [f"{path}:{base}"]))
        windy = family.scenario(diagrams, family.windiest, [layer], sizes.overrides)
        flown = math.nan if entry.slow else delay_flown(windy, sizes)
        yield name, controller, Traits(*margins[base], flown, lone_time(windy, slow=entry.slow), fleet)


def judge_laps(diagrams: Path, name: str, family: Family, entries: Sequence[str], sizes: Sizes) -> Iterator[Told]:
    """Flies controllers with maps, and what they stand around, lap after lap; arguments as for `judge_family`."""
    path = design_file(diagrams, name)
    names = [each for base in MAPPED for each in (base, f"{base}_t2fnn_map") if f"{base}_t2fnn_map" in entries]
    for controller in names:
        for count in range(1, sizes.most_laps + 1):
            scenario = family.scenario(diagrams, LAPS_IN, [f"{path}:{controller}"], laps_of(count))
            yield in_laps(count), controller, _fly(scenario, sizes.laps)[0]


def judge_prices(diagrams: Path, family: Family, entries: Sequence[str], sizes: Sizes) -> Iterator[Told]:
    """Flies what was designed with other limits on the sensitivity; arguments as for `judge_family`."""
    path = design_file(diagrams, PRICED)
    there = designs_in(path)
    for controller in (each for each in PRICED_CONTROLLERS if each in entries):
        for sensitivity in SENSITIVITIES:
            name = priced_name(controller, sensitivity)
            if name in there:
                scenario = family.scenario(diagrams, PRICED_IN, [f"{path}:{name}"], sizes.overrides)
                metrics, spent = fly_judged(scenario, sizes)
                yield PRICED_IN, name, metrics
                margins = worst_margins(family.scenario(diagrams, PRICED_IN, [f"{path}:{name}"]))
                yield PRICED, name, Traits(*margins, delay_flown(scenario, sizes), lone_time(scenario), spent)


def fly_judged(scenario: Scenario, sizes: Sizes, *, slow: bool = False) -> tuple[Metrics, float]:
    """The metrics of the judged samples, and the CPU time of a vehicle a tick, s; what is slow flies as it is wired."""
    return _fly(scenario, sizes.slow if slow else sizes.samples, compiled=not slow)


def _fly(scenario: Scenario, count: int, *, compiled: bool = True) -> tuple[Metrics, float]:
    fleet = StudyFleet(scenario, plan_route(scenario), count, compiled=compiled)
    begun = time.process_time()
    metrics = fleet.fly(range(FIRST_JUDGED, FIRST_JUDGED + count))
    return metrics, (time.process_time() - begun) / (count * _ticks(fleet))


def _ticks(fleet: StudyFleet) -> float:
    return fleet.duration / fleet.scenario.laboratory.command_link.period


def lone_time(scenario: Scenario, *, slow: bool = False) -> float:
    """CPU time of the whole loop a tick of a vehicle that flies alone, the least of some flights, s."""
    fleet, spent = StudyFleet(scenario, plan_route(scenario), 1, compiled=not slow), []
    for sample in range(FIRST_JUDGED, FIRST_JUDGED + _TIMED):
        begun = time.process_time()
        metrics = fleet.fly([sample])
        flown = min(fleet.duration, float(metrics.crash_time.min()))
        spent.append((time.process_time() - begun) * fleet.duration / flown)
    return min(spent) / _ticks(fleet)


def delay_flown(scenario: Scenario, sizes: Sizes) -> float:
    """The delay beyond the laboratory's own that is stood, s: one frame less than that with which a sample crashes.

    It is infinite if none that was tried makes one crash, and less than 0 if one crashes without any.
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
    """The largest peak sensitivity and the least delay margin (s) of the middle plant; NaN without a linear model."""
    try:
        found = [each for each in link_margins(middle_of(scenario)).values() if each is not None]
    except InputError:
        return math.nan, math.nan
    return max(each.sensitivity for each in found), min(each.delay for each in found)


def missing(entries: dict[str, Entry], path: Path) -> list[str]:
    """The names of entries that a file has no design of."""
    there = designs_in(path)
    return [name for name in entries if name not in there]
