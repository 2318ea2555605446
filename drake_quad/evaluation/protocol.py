"""Protocol that tunes all controllers for a family of laboratories with the same budget and the same limit."""

import itertools
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drake_quad.design.lqg import LqgLimits, design_lqg
from drake_quad.design.tuning import Budget, LoopLimit, TuningResult, tolerated_delay, tune
from drake_quad.errors import InputError
from drake_quad.evaluation.designs import design_file, designs_in, write_designs
from drake_quad.evaluation.entries import ControllerEntry, entries_of
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF, LaboratoryFamily
from drake_quad.evaluation.results import PRICED, PRICED_CONTROLLERS, PRICED_IN, SENSITIVITIES, priced_name
from drake_quad.scenario.batch import middle_of
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import value_at

# Horizon of model predictive control, s, as in controllers/mpc.yaml.
_HORIZON = 0.6


class Designed(NamedTuple):
    """Design that has been written to a file.

    Attributes:
        name: name of the design in its file.
        words: description of the tuning and its result.
    """

    name: str
    words: str


def tunable(family: LaboratoryFamily, path: Path, names: Sequence[str] | None = None) -> dict[str, ControllerEntry]:
    """Return the entries of a family that the protocol tunes by name, each network after its base controller.

    A network is omitted if its base controller is neither in the file nor tuned before.

    Args:
        family: family of laboratories.
        path: path of the file with the family's designs.
        names: names of the entries; all by default.

    Raises:
        InputError: a name is not that of an entry that the protocol tunes.
    """
    entries = {name: each for name, each in family.entries.items() if each.knobs}
    for name in names or ():
        if name not in entries:
            raise InputError(f"{name} is no controller that is tuned here; these are {', '.join(entries)}")
    chosen = {name: entry for name, entry in entries.items() if names is None or name in names}
    there = {*designs_in(path), *chosen}
    return {name: entry for name, entry in chosen.items() if not entry.around or entry.around in there}


def design_family(
    diagrams: Path,
    name: str,
    family: LaboratoryFamily,
    entries: dict[str, ControllerEntry],
    *,
    budget: Budget = Budget(),
) -> Iterator[Designed]:
    """Tune entries one after another, and write each design into the family's file as soon as it is found.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        entries: entries from `tunable`.
        budget: budget of each search.
    """
    path, limit = design_file(diagrams, name), LoopLimit()
    for controller, entry in entries.items():
        scenarios = _untuned(diagrams, family, path, controller, entry)
        shares = None if entry.around else _shares(limit)
        before = numbers_before(diagrams, family, path, controller, entry)
        later = 0.0
        if entry.around:
            alone = training(diagrams, family, f"{path}:{entry.around}", entry)
            later = tolerated_delay(alone, limit.delay, budget=budget)
        found = tune(scenarios, entry.knobs, shares, budget=budget, extra_latency=later, before=before)
        words = _words(entry, found, budget, later)
        write_designs(path, {controller: entry.tree(found.numbers)}, said={controller: words}, head=_head(name, limit))
        yield Designed(controller, words)
    yield from _predictive(path)


def _predictive(path: Path) -> Iterator[Designed]:
    """Write model predictive control with the regulator of the family's LQG, if it has one."""
    regulator = designs_in(path).get("lqg")
    if regulator is not None:
        control = {**regulator["control"], "kind": "mpc", "horizon": _HORIZON}
        words = "the regulator of lqg, which keeps to its limits over a horizon"
        write_designs(path, {"mpc": {"control": control}}, said={"mpc": words})
        yield Designed("mpc", words)


def _untuned(diagrams: Path, family: LaboratoryFamily, path: Path, name: str, entry: ControllerEntry) -> list[Scenario]:
    """Return the scenarios in which an entry is trained, with its numbers in the middle of their ranges."""
    # This is a copy of the file, since the entry may extend the designs in it. It is in the same folder, since designs
    # are found relative to their file.
    trial = path.with_name(f".tuning_{path.name}")
    try:
        if path.exists():
            shutil.copyfile(path, trial)
        write_designs(trial, {name: entry.middle()}, said={})
        return training(diagrams, family, f"{trial}:{name}", entry)
    finally:
        trial.unlink(missing_ok=True)


def training(diagrams: Path, family: LaboratoryFamily, layer: str, entry: ControllerEntry) -> list[Scenario]:
    """Return the scenarios in which an entry of a family is trained.

    Args:
        diagrams: folder of the shipped scenarios.
        family: family of laboratories.
        layer: FILE:NAME of the controller.
        entry: entry of the controller.
    """
    overrides = family.laps if entry.laps else ()
    return [family.scenario(diagrams, each, [layer], overrides) for each in family.trained]


def numbers_before(
    diagrams: Path, family: LaboratoryFamily, path: Path, controller: str, entry: ControllerEntry
) -> list[float] | None:
    """Return the values of an entry's knobs in an earlier design; None if there is no design with positive values."""
    if controller not in designs_in(path):
        return None
    scenario, *_ = training(diagrams, family, f"{path}:{controller}", entry)
    try:
        numbers = [value_at(scenario, knob.paths[0]) for knob in entry.knobs]
    except InputError:
        return None
    return numbers if all(isinstance(number, float) and number > 0.0 for number in numbers) else None


def design_prices(diagrams: Path, *, budget: Budget = Budget()) -> Iterator[Designed]:
    """Design controllers for several limits of the peak sensitivity, and write them as `design_family` does."""
    family = FAMILIES[FAMILY_OF[PRICED_IN]]
    path = design_file(diagrams, PRICED)
    entries = entries_of(on_board=family.on_board, maps=False)
    for controller, sensitivity in itertools.product(PRICED_CONTROLLERS, SENSITIVITIES):
        entry, limit = entries[controller], LoopLimit(sensitivity=sensitivity)
        name = priced_name(controller, sensitivity)
        if entry.knobs:
            scenarios = _untuned(diagrams, family, path, name, entry)
            found = tune(scenarios, entry.knobs, _shares(limit), budget=budget)
            tree, words = entry.tree(found.numbers), _words(entry, found, budget)
        else:
            place = load_undesigned(diagrams / family.laboratories[PRICED_IN])
            design = design_lqg(place, LqgLimits(sensitivity=sensitivity, delay=limit.delay))
            control = design.control.model_dump(mode="json", exclude_none=True)
            tree, words = {"control": control}, "by its designer"
        write_designs(path, {name: tree}, said={name: words}, head=_PRICED_HEAD)
        yield Designed(name, words)


def _shares(limit: LoopLimit) -> Callable[[Scenario], np.ndarray]:
    """Return a function from a scenario to the shares of a limit that the loops of its middle plant meet."""
    return lambda scenario: limit.shares_met(middle_of(scenario))


def _words(entry: ControllerEntry, found: TuningResult, budget: Budget, later: float = 0.0) -> str:
    """Return the description of a tuning and its result.

    Args:
        entry: entry that was tuned.
        found: result of the tuning.
        budget: budget of the search.
        later: additional latency in training, s.
    """
    words = f"{len(entry.knobs)} numbers tuned in {budget.rounds} rounds, {100.0 * found.error:.2f} cm in training"
    if later:
        words += f", also {1e3 * later:.0f} ms late"
    kept = f"{100.0 * min(found.share, 1.0):.0f} %"
    return words if kept == "100 %" else f"{words}, with {kept} of the limit"


_PRICED_HEAD = (
    "Controllers for laboratory.yaml with other limits on the peak sensitivity, NAME@LIMIT, for the price of margin\n"
    "in docs/controllers/report.md: drake-quad judge --tune priced"
)


def _head(name: str, limit: LoopLimit) -> str:
    return (
        f"Controllers for the family {name} of docs/controllers/report.md, which says how they were tuned:\n"
        f"drake-quad judge --tune {name}\n"
        f"The limit is a peak sensitivity of {limit.sensitivity:g} and a delay margin of {1e3 * limit.delay:g} ms, or\n"
        "the best that is reached. The yaw's gains are as designed in gains/laboratory.yaml."
    )
