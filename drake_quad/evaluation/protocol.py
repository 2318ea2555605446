"""Tuning protocol: all controllers of a family are tuned with the same budget and the same stability limit."""

import itertools
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from drake_quad.design.lqg import LqgLimits, design_lqg
from drake_quad.design.tuning import Budget, LoopLimit, TuningResult, tolerated_delay, tune
from drake_quad.errors import InputError
from drake_quad.evaluation.designs import design_file, read_designs, write_designs
from drake_quad.evaluation.entries import ControllerEntry, controller_entries
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF, LaboratoryFamily
from drake_quad.evaluation.results import (
    SENSITIVITY_LIMITS,
    SENSITIVITY_VARIANT_CONTROLLERS,
    SENSITIVITY_VARIANT_LABORATORY,
    SENSITIVITY_VARIANTS,
    sensitivity_variant_name,
)
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import value_at

_MPC_HORIZON = 0.6  # s, horizon of model predictive control, as in controllers/mpc.yaml


class DesignResult(NamedTuple):
    """Design that has been written to a file.

    Attributes:
        name: name of the design in its file.
        description: text about the tuning and its result.
    """

    name: str
    description: str


def tunable_entries(
    family: LaboratoryFamily, path: Path, names: Sequence[str] | None = None
) -> dict[str, ControllerEntry]:
    """Return the controller entries that the protocol tunes, by name. Each network follows its base controller.

    A network is omitted if its base controller is neither in the file nor among the chosen entries.

    Args:
        family: family of laboratories.
        path: path of the file with the family's designs.
        names: names of the chosen entries; all by default.

    Raises:
        InputError: if a name is not one of the tunable entries.
    """
    entries = {name: each for name, each in family.entries.items() if each.parameters}
    for name in names or ():
        if name not in entries:
            raise InputError(f"there is no tunable controller {name}; choose from {', '.join(entries)}")
    chosen = {name: entry for name, entry in entries.items() if names is None or name in names}
    available = {*read_designs(path), *chosen}
    return {name: entry for name, entry in chosen.items() if not entry.base or entry.base in available}


def design_family(
    diagrams: Path,
    name: str,
    family: LaboratoryFamily,
    entries: dict[str, ControllerEntry],
    *,
    budget: Budget = Budget(),
) -> Iterator[DesignResult]:
    """Tune controller entries one after another, and write each design to the family's file when its tuning is done.

    Args:
        diagrams: folder of the shipped scenarios.
        name: name of the family.
        family: family of laboratories.
        entries: entries from `tunable_entries`.
        budget: budget of each search.
    """
    path, limit = design_file(diagrams, name), LoopLimit()
    for controller, entry in entries.items():
        scenarios = _scenarios_before_tuning(diagrams, family, path, controller, entry)
        fractions = None if entry.base else limit.margin_ratios
        before = previous_numbers(diagrams, family, path, controller, entry)
        extra_latency = 0.0
        if entry.base:
            alone = training_scenarios(diagrams, family, f"{path}:{entry.base}", entry)
            extra_latency = tolerated_delay(alone, limit.delay, budget=budget)
        result = tune(scenarios, entry.parameters, fractions, budget=budget, extra_latency=extra_latency, before=before)
        description = _description(entry, result, budget, extra_latency)
        write_designs(
            path,
            {controller: entry.tree(result.values)},
            comments={controller: description},
            header=_header(name, limit),
        )
        yield DesignResult(controller, description)
    yield from _write_predictive_control(path)


def _write_predictive_control(path: Path) -> Iterator[DesignResult]:
    """Write a model predictive controller with the regulator of the family's LQG design, if there is such a design."""
    regulator = read_designs(path).get("lqg")
    if regulator is not None:
        control = {**regulator["control"], "kind": "mpc", "horizon": _MPC_HORIZON}
        description = "the regulator of lqg, with limits over a horizon"
        write_designs(path, {"mpc": {"control": control}}, comments={"mpc": description})
        yield DesignResult("mpc", description)


def _scenarios_before_tuning(
    diagrams: Path, family: LaboratoryFamily, path: Path, name: str, entry: ControllerEntry
) -> list[Scenario]:
    """Return the training scenarios of a controller, with each tuned parameter at the geometric mean of its range."""
    # The scenarios are read from a copy of the file, since the controller may extend other designs in it. The copy is
    # in the same folder, since the paths in the file are relative to this folder.
    trial = path.with_name(f".tuning_{path.name}")
    try:
        if path.exists():
            shutil.copyfile(path, trial)
        write_designs(trial, {name: entry.geometric_mean()}, comments={})
        return training_scenarios(diagrams, family, f"{trial}:{name}", entry)
    finally:
        trial.unlink(missing_ok=True)


def training_scenarios(diagrams: Path, family: LaboratoryFamily, layer: str, entry: ControllerEntry) -> list[Scenario]:
    """Return the scenarios in which a controller of a family is trained.

    Args:
        diagrams: folder of the shipped scenarios.
        family: family of laboratories.
        layer: FILE:NAME of the controller.
        entry: description of the controller, which says whether it is trained in laps.
    """
    overrides = family.lap_overrides if entry.trained_in_laps else ()
    return [family.scenario(diagrams, each, [layer], overrides) for each in family.training_laboratories]


def previous_numbers(
    diagrams: Path, family: LaboratoryFamily, path: Path, controller: str, entry: ControllerEntry
) -> list[float] | None:
    """Return the tuned parameters of an earlier design; None if it does not exist, or a parameter is not positive."""
    if controller not in read_designs(path):
        return None
    scenario, *_ = training_scenarios(diagrams, family, f"{path}:{controller}", entry)
    try:
        numbers = [value_at(scenario, parameter.paths[0]) for parameter in entry.parameters]
    except InputError:
        return None
    return numbers if all(isinstance(number, float) and number > 0.0 for number in numbers) else None


def design_sensitivity_variants(diagrams: Path, *, budget: Budget = Budget()) -> Iterator[DesignResult]:
    """Design controllers with several limits on the peak sensitivity, and write them as `design_family` does.

    The designs show the price of a stability margin: by how much a stricter limit increases the tracking error.
    """
    family = FAMILIES[FAMILY_OF[SENSITIVITY_VARIANT_LABORATORY]]
    path = design_file(diagrams, SENSITIVITY_VARIANTS)
    entries = controller_entries(on_board=family.on_board, position_networks=False)
    for controller, sensitivity in itertools.product(SENSITIVITY_VARIANT_CONTROLLERS, SENSITIVITY_LIMITS):
        entry, limit = entries[controller], LoopLimit(sensitivity=sensitivity)
        name = sensitivity_variant_name(controller, sensitivity)
        if entry.parameters:
            scenarios = _scenarios_before_tuning(diagrams, family, path, name, entry)
            result = tune(scenarios, entry.parameters, limit.margin_ratios, budget=budget)
            tree, description = entry.tree(result.values), _description(entry, result, budget)
        else:
            scenario = load_undesigned(diagrams / family.laboratories[SENSITIVITY_VARIANT_LABORATORY])
            design = design_lqg(scenario, LqgLimits(sensitivity=sensitivity, delay=limit.delay))
            control = design.control.model_dump(mode="json", exclude_none=True)
            tree, description = {"control": control}, "designed from Riccati equations"
        write_designs(path, {name: tree}, comments={name: description}, header=_SENSITIVITY_VARIANTS_HEADER)
        yield DesignResult(name, description)


def _description(entry: ControllerEntry, result: TuningResult, budget: Budget, extra_latency: float = 0.0) -> str:
    """Return a text about a tuning and its result.

    Args:
        entry: entry that was tuned.
        result: result of the tuning.
        budget: budget of the search.
        extra_latency: additional latency in training, s.
    """
    description = (
        f"{len(entry.parameters)} numbers tuned in {budget.rounds} rounds, {100.0 * result.error:.2f} cm in training"
    )
    if extra_latency:
        description += f", also with {1e3 * extra_latency:.0f} ms of extra delay"
    fraction = f"{100.0 * min(result.min_margin_ratio, 1.0):.0f} %"
    return description if fraction == "100 %" else f"{description}, meets {fraction} of the limit"


_SENSITIVITY_VARIANTS_HEADER = (
    "Controllers for laboratory.yaml that were designed with other limits on the peak sensitivity, NAME@LIMIT, to\n"
    "show the price of stability margin in docs/controllers/report.md: drake-quad judge --tune priced"
)


def _header(name: str, limit: LoopLimit) -> str:
    return (
        f"Controllers for the family {name} of docs/controllers/report.md, which describes their tuning by\n"
        f"drake-quad judge --tune {name}\n"
        f"The limits are a peak sensitivity of {limit.sensitivity:g} and a delay margin of {1e3 * limit.delay:g} ms;\n"
        "if no design meets them, the closest one is kept. The yaw gains are those of gains/laboratory.yaml."
    )
