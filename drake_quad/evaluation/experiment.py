"""Flights of the evaluation, in which designed controllers fly random samples that were not used for tuning."""

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.design.certificate import certify_hover
from drake_quad.design.tuning import LATENCY
from drake_quad.errors import InputError
from drake_quad.evaluation.designs import design_file, read_designs
from drake_quad.evaluation.entries import POSITION_NETWORK_BASES
from drake_quad.evaluation.families import FAMILIES, FIRST_EVALUATION_SAMPLE, LaboratoryFamily, overrides_for_laps
from drake_quad.evaluation.results import (
    LAPS_LABORATORY,
    SENSITIVITY_LIMITS,
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANT_LABORATORY,
    SENSITIVITY_VARIANTS,
    Evaluation,
    Traits,
    laboratory_with_laps,
    read_evaluation,
    sensitivity_variant_name,
    write_evaluation,
)
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.link_margins import link_margins
from drake_quad.planning.duration import flight_duration
from drake_quad.reports.jobs import Job, run_jobs
from drake_quad.scenario.batch import Batch, median_scenario
from drake_quad.scenario.files.loading import Override
from drake_quad.scenario.models import Scenario

_NUM_TIMED_FLIGHTS = 3  # number of single-vehicle flights whose CPU time is measured


class UserController(NamedTuple):
    """Controller of the user, which is compared with the designed controllers.

    Attributes:
        name: name in the report.
        layers: scenario files that are merged over the scenario of a laboratory to add the controller.
        overrides: `field=value` assignments that are applied after the layers.
    """

    name: str
    layers: Sequence[str] = ()
    overrides: Sequence[Override] = ()


class EvaluationSizes(NamedTuple):
    """Sizes of the evaluation.

    Attributes:
        samples: number of random samples that each controller flies in each laboratory.
        num_uncompiled_samples: number of samples of a controller that cannot be compiled.
        num_lap_samples: number of samples that fly each number of laps.
        max_laps: largest number of laps.
        num_delay_samples: number of samples that fly with each additional delay.
        max_delay_frames: largest additional delay, in camera frames.
        duration: duration of a flight, s; None for the whole route.
        certifies: True to certify the controllers, which takes 20 to 80 s for each of them.
    """

    samples: int = 256
    num_uncompiled_samples: int = 32
    num_lap_samples: int = 64
    max_laps: int = 6
    num_delay_samples: int = 16
    max_delay_frames: int = 40
    duration: float | None = None
    certifies: bool = True

    @property
    def overrides(self) -> tuple[str, ...]:
        """Overrides that shorten the flights of a quick evaluation; none for a complete one."""
        return () if self.duration is None else (f"duration={self.duration!r}",)


QUICK = EvaluationSizes(
    samples=4,
    num_uncompiled_samples=2,
    num_lap_samples=2,
    max_laps=2,
    num_delay_samples=2,
    max_delay_frames=4,
    duration=1.0,
    certifies=False,
)
# A result consists of laboratory, controller and metrics, or of family, controller and `Traits` (margins and times).
Result = tuple[str, str, Metrics | Traits]


def fly_evaluation(
    diagrams: Path,
    families: Sequence[str],
    sizes: EvaluationSizes,
    folder: Path,
    *,
    only: Sequence[str] | None = None,
    user_controllers: Sequence[UserController] = (),
    progress: Callable[[int, int, str], object] = lambda *_: None,
) -> Evaluation:
    """Fly all designed controllers of the given families, and write the results after each job.

    Args:
        diagrams: folder of the shipped scenarios.
        families: names of the families.
        sizes: sizes of the evaluation.
        folder: folder for the results.
        only: names of the designed controllers to fly; all by default.
        user_controllers: user's controllers, which are flown without tuning.
        progress: called with the number of finished jobs, the total number of jobs, and the name of the last job.

    Returns:
        The results, which are also written to the folder (see `read_evaluation`).

    Raises:
        InputError: if none of the controllers in `only` has a design.
    """
    jobs = [job for name in families for job in _jobs(diagrams, name, sizes, only, user_controllers)]
    if not jobs:
        raise InputError("none of the chosen controllers has a design; design them with drake-quad judge --tune")
    flights: dict[str, dict[str, Metrics]] = {}
    traits: dict[str, dict[str, Traits]] = {}

    def keep(results: Sequence[Result]) -> None:
        for laboratory, controller, numbers in results:
            if isinstance(numbers, Traits):
                traits.setdefault(laboratory, {})[controller] = numbers
            else:
                flights.setdefault(laboratory, {})[controller] = numbers
        write_evaluation(folder, Evaluation(flights, traits))

    # The jobs run one after another, since parallel processes would increase each other's CPU times.
    run_jobs(jobs, finished=keep, progress=progress)
    return read_evaluation(folder)


def _jobs(
    diagrams: Path,
    name: str,
    sizes: EvaluationSizes,
    only: Sequence[str] | None,
    user_controllers: Sequence[UserController],
) -> Iterator[Job]:
    """Yield the jobs of a family.

    There is one job for each controller. The family with the laboratory `LAPS_LABORATORY` has two more jobs: the
    flights over several laps (`fly_laps`), and the flights of controllers that were designed with other limits on the
    peak sensitivity (`fly_sensitivity_variants`).
    """
    family, designs = FAMILIES[name], read_designs(design_file(diagrams, name))
    entries = [each for each in family.entries if each in designs and (only is None or each in only)]
    for entry in entries:
        yield Job(f"{name} {entry}", 1, partial(_collected, fly_family, diagrams, name, family, entry, sizes))
    for each in user_controllers:
        yield Job(f"{name} {each.name}", 1, partial(_collected, fly_controller, diagrams, name, family, each, sizes))
    if entries and LAPS_LABORATORY in family.laboratories:
        yield Job("laps", 1, partial(_collected, fly_laps, diagrams, name, family, entries, sizes))
        yield Job(
            SENSITIVITY_VARIANTS, 1, partial(_collected, fly_sensitivity_variants, diagrams, family, entries, sizes)
        )


def _collected(fly: Callable[..., Iterator[Result]], *arguments: Any) -> list[Result]:
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
        sizes: sizes of the evaluation.

    Yields:
        The controller's metrics in each laboratory, and then its `Traits` in the family.
    """
    path, entry = design_file(diagrams, name), family.entries[controller]
    designed = UserController(controller, [f"{path}:{controller}"])
    base = designed._replace(layers=[f"{path}:{entry.base or controller}"])
    return fly_controller(diagrams, name, family, designed, sizes, base=base, uncompiled=entry.uncompiled)


def fly_controller(
    diagrams: Path,
    name: str,
    family: LaboratoryFamily,
    controller: UserController,
    sizes: EvaluationSizes,
    *,
    base: UserController | None = None,
    uncompiled: bool = False,
) -> Iterator[Result]:
    """Fly a controller in the laboratories of a family.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        controller: controller to fly.
        sizes: sizes of the evaluation.
        base: controller without the network, whose margins are returned; by default, the controller itself.
        uncompiled: True to fly fewer samples, in an uncompiled diagram.

    Yields:
        The controller's metrics in each laboratory, and then its `Traits` in the family.
    """

    def scenario(laboratory: str, variant: UserController = controller, overrides: Sequence[str] = ()) -> Scenario:
        return family.scenario(diagrams, laboratory, variant.layers, [*variant.overrides, *overrides])

    time_in_fleet = math.nan
    for laboratory in family.laboratories:
        metrics, cpu_time = timed_flights(
            scenario(laboratory, overrides=sizes.overrides),
            sizes.num_uncompiled_samples if uncompiled else sizes.samples,
            compiled=not uncompiled,
        )
        time_in_fleet = cpu_time if laboratory == family.windiest_laboratory else time_in_fleet
        yield laboratory, controller.name, metrics
    margins = worst_margins(scenario(family.training_laboratories[0], base or controller))
    certificate = (
        certified_scales(scenario(family.training_laboratories[0]), compiled=not uncompiled)
        if sizes.certifies
        else NOT_CERTIFIED
    )
    windy = scenario(family.windiest_laboratory, overrides=sizes.overrides)
    delay = math.nan if uncompiled else delay_flown(windy, sizes)
    yield (
        name,
        controller.name,
        Traits(
            *margins,
            delay,
            single_vehicle_time(windy, compiled=not uncompiled),
            time_in_fleet,
            *certificate[:2],
            not_certified=certificate[2],
        ),
    )


def fly_laps(
    diagrams: Path, name: str, family: LaboratoryFamily, entries: Sequence[str], sizes: EvaluationSizes
) -> Iterator[Result]:
    """Fly networks with the position as input, and their base controllers, with increasing numbers of laps.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        entries: names of the controllers that may be flown.
        sizes: sizes of the evaluation.
    """
    path = design_file(diagrams, name)
    names = [
        each
        for base in POSITION_NETWORK_BASES
        for each in (base, f"{base}_t2fnn_map")
        if f"{base}_t2fnn_map" in entries
    ]
    for controller in names:
        for count in range(1, sizes.max_laps + 1):
            scenario = family.scenario(diagrams, LAPS_LABORATORY, [f"{path}:{controller}"], overrides_for_laps(count))
            yield laboratory_with_laps(count), controller, timed_flights(scenario, sizes.num_lap_samples)[0]


def fly_sensitivity_variants(
    diagrams: Path, family: LaboratoryFamily, entries: Sequence[str], sizes: EvaluationSizes
) -> Iterator[Result]:
    """Fly controllers that were designed with different limits on the peak sensitivity.

    The flights show the price of a stability margin: by how much a stricter limit increases the tracking error.

    Args:
        diagrams: folder of the shipped scenarios.
        family: family of laboratories.
        entries: names of the controllers that may be flown.
        sizes: sizes of the evaluation.
    """
    path = design_file(diagrams, SENSITIVITY_VARIANTS)
    designs = read_designs(path)
    names = [
        sensitivity_variant_name(*each)
        for each in itertools.product(SENSITIVITY_VARIANT_CONTROLLERS, SENSITIVITY_LIMITS)
        if each[0] in entries
    ]
    for name in (each for each in names if each in designs):
        scenario = family.scenario(diagrams, SENSITIVITY_VARIANT_LABORATORY, [f"{path}:{name}"], sizes.overrides)
        metrics, cpu_time = timed_flights(scenario, sizes.samples)
        yield SENSITIVITY_VARIANT_LABORATORY, name, metrics
        margins = worst_margins(family.scenario(diagrams, SENSITIVITY_VARIANT_LABORATORY, [f"{path}:{name}"]))
        yield (
            SENSITIVITY_VARIANTS,
            name,
            Traits(*margins, delay_flown(scenario, sizes), single_vehicle_time(scenario), cpu_time),
        )


def timed_flights(scenario: Scenario, count: int, *, compiled: bool = True) -> tuple[Metrics, float]:
    """Fly the samples of the evaluation, and return their metrics and the CPU time per vehicle and tick, s.

    Args:
        scenario: scenario to fly.
        count: number of samples, from `FIRST_EVALUATION_SAMPLE` on.
        compiled: True to compile the diagram to machine code; False to simulate the uncompiled diagram.
    """
    fleet = StudyFleet(scenario, plan_route(scenario), count, compiled=compiled)
    start = time.process_time()
    metrics = fleet.fly(range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + count))
    return metrics, (time.process_time() - start) / (count * _ticks(fleet))


def _ticks(fleet: StudyFleet) -> float:
    return fleet.duration / fleet.scenario.laboratory.command_link.period


def single_vehicle_time(scenario: Scenario, *, compiled: bool = True) -> float:
    """Return the CPU time per tick of the whole loop with a single vehicle, s: the minimum over several flights."""
    fleet, cpu_times = StudyFleet(scenario, plan_route(scenario), 1, compiled=compiled), []
    for sample in range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + _NUM_TIMED_FLIGHTS):
        start = time.process_time()
        metrics = fleet.fly([sample])
        simulated_time = min(fleet.duration, float(metrics.crash_time.min()))
        cpu_times.append((time.process_time() - start) * fleet.duration / simulated_time)
    return min(cpu_times) / _ticks(fleet)


def delay_flown(scenario: Scenario, sizes: EvaluationSizes) -> float:
    """Return the tolerated additional delay, s: one camera frame less than the smallest delay with a crash.

    The result is infinite if no sample crashes at any delay, and negative if a sample crashes without additional delay.
    """
    samples = range(FIRST_EVALUATION_SAMPLE, FIRST_EVALUATION_SAMPLE + sizes.num_delay_samples)
    frames = np.arange(sizes.max_delay_frames + 1)
    batch = Batch.draw(scenario, [*samples] * len(frames))
    latency = batch.varying.get(LATENCY, scenario.laboratory.motion_capture.latency_frames)
    plan = plan_route(scenario)
    delayed = batch.with_varying({LATENCY: latency + np.repeat(frames, len(samples)).astype(float)})
    fleet = simulate_fleet(delayed, plan, record=False, compiled=True)
    fleet.fly(flight_duration(scenario, plan))
    crashed = fleet.metrics().crashed.reshape(len(frames), -1).any(axis=1)
    if not crashed.any():
        return math.inf
    return (float(np.argmax(crashed)) - 1.0) * scenario.laboratory.motion_capture.period


def worst_margins(scenario: Scenario) -> tuple[float, float]:
    """Return peak sensitivity and smallest delay margin, s, for median parameters; NaN without a linear model."""
    try:
        margins = [each for each in link_margins(median_scenario(scenario)).values() if each is not None]
    except InputError:
        return math.nan, math.nan
    return max(each.sensitivity for each in margins), min(each.delay for each in margins)


class CertifiedScales(NamedTuple):
    """Result of a robustness certificate.

    Attributes:
        stable_scale: scale of the parameter ranges up to which hover is certified to be stable; NaN without a
            certificate.
        unstable_scale: smallest scale at which an unstable loop was found; NaN without a certificate.
        not_certified: reason why there is no certificate; empty if there is one.
    """

    stable_scale: float
    unstable_scale: float
    not_certified: str


NOT_CERTIFIED = CertifiedScales(math.nan, math.nan, "certificates are not computed in a quick test")


def certified_scales(scenario: Scenario, *, compiled: bool = True) -> CertifiedScales:
    """Return the result of a robustness certificate, or the reason why there is no certificate.

    The result has two scales of the parameter ranges: one at which hover is stable for all parameters in the scaled
    ranges, and a larger one at which hover is unstable for some of them. Certificates are cached on the disk, since
    each takes 20 to 80 s.

    Args:
        scenario: scenario with the controller.
        compiled: False for a controller that cannot be compiled, for which a certificate would take hours.
    """
    if not compiled:
        return NOT_CERTIFIED._replace(not_certified="a controller that cannot be compiled would take hours to certify")
    try:
        found = cached_on_disk(certify_hover, scenario)
    except InputError as error:
        return NOT_CERTIFIED._replace(not_certified=str(error))
    return CertifiedScales(found.stable_scale, found.unstable.scale, "")


def missing_designs(diagrams: Path, name: str) -> list[str]:
    """Return the names of the controllers without a design in the file of a family."""
    designs = read_designs(design_file(diagrams, name))
    return [entry for entry in FAMILIES[name].entries if entry not in designs]
