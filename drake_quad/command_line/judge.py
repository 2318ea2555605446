"""Fly all designed controllers in all laboratories, and write a report that compares their performance.

In laboratories with random parameters, controllers are also certified, which takes a minute for each of them.

The option --tune instead designs the controllers for families of laboratories, all by the same procedure, and writes
them into diagrams/controllers/designed. A second run without --tune then writes the report.
"""

import argparse
import time
from pathlib import Path

from drake_quad import InputError
from drake_quad.command_line.options import add_controller, check_ranges, named_controllers, parser_without_options
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.command_line.progress import progress_bar
from drake_quad.design.tuning import Budget
from drake_quad.evaluation.claims import CONTROLLER_NAMES
from drake_quad.evaluation.designs import design_file
from drake_quad.evaluation.experiment import QUICK, EvaluationSizes, UserController, fly_evaluation, missing_designs
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF
from drake_quad.evaluation.protocol import design_family, design_sensitivity_variants, tunable_entries
from drake_quad.evaluation.report import write_report
from drake_quad.evaluation.results import SENSITIVITY_VARIANTS, Evaluation
from drake_quad.files import output_folder
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.files.shipped import shipped_folder
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import crash_probability, values_without_crashes

# Smallest and largest value of each option.
_RANGES = {"samples": (2, 10_000), "rounds": (1, 1000)}


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad judge --quick --family outdoor")
    result.add_argument(
        "--family",
        action="append",
        choices=FAMILIES,
        help="family of laboratories; can be given several times (default: all)",
    )
    result.add_argument(
        "--only",
        action="append",
        metavar="NAME",
        choices=list(dict.fromkeys(name for family in FAMILIES.values() for name in family.entries)),
        help="designed controller; can be given several times (default: all)",
    )
    add_controller(result, several="can be given several times; is compared with the designed controllers, not tuned")
    result.add_argument(
        "--samples",
        type=int,
        default=EvaluationSizes().samples,
        help="number of samples in each laboratory (default: %(default)s)",
    )
    result.add_argument(
        "--quick", action="store_true", help="simulate a few samples for one second each, as a quick test"
    )
    result.add_argument(
        "--tune",
        nargs="*",
        choices=[*FAMILIES, SENSITIVITY_VARIANTS],
        help="design the controllers for these families, or for all families if none is named;"
        f" {SENSITIVITY_VARIANTS} designs controllers with other stability limits",
    )
    result.add_argument(
        "--rounds", type=int, default=Budget().rounds, help="number of rounds of each search (default: %(default)s)"
    )
    result.add_argument(
        "--output", type=Path, help="output folder (default: out/controllers, or out/controllers_quick with --quick)"
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, _RANGES)
    if arguments.tune is not None:
        tune(arguments)
        return
    sizes = QUICK if arguments.quick else EvaluationSizes(samples=arguments.samples)
    families = arguments.family or [*FAMILIES]
    folder = output_folder(arguments.output or Path("out/controllers_quick" if arguments.quick else "out/controllers"))
    user_entries = user_controllers(arguments.controller)
    start_time = time.monotonic()
    for name in families:
        missing = missing_designs(shipped_folder(), name)
        if missing:
            remark(f"the family {name} has no design of {', '.join(missing)}, so these controllers are left out")
    with progress_bar("flying") as progress:
        evaluation = fly_evaluation(
            shipped_folder(),
            families,
            sizes,
            folder,
            only=arguments.only,
            user_controllers=user_entries,
            progress=progress,
        )
    files = [folder / "flights.csv", folder / "traits.csv", *write_report(folder, evaluation)]
    print_errors(evaluation)
    print(f"simulated in {time.monotonic() - start_time:.0f} s")
    print_files(files)


def user_controllers(specs: list[str]) -> list[UserController]:
    """Return the controllers that `--controller` names.

    If a designed controller has the same short name, the user's controller is listed by its full name.

    Raises:
        InputError: if a controller cannot be loaded, or two controllers have the same name.
    """
    laboratory = str(shipped_folder() / "laboratory.yaml:nominal")
    return [
        UserController(
            spec if each.name in CONTROLLER_NAMES else each.name, each.layers, (*each.overrides, *each.assignments)
        )
        for spec, each in named_controllers(specs, laboratory).items()
    ]


def tune(arguments: argparse.Namespace) -> None:
    """Design controllers, and print a line for each as soon as it is written."""
    if not (shipped_folder().parent / "pyproject.toml").exists():
        raise InputError(
            "--tune writes into diagrams/ of a source checkout, but the package is installed without a checkout; run"
            " the command in a checkout"
        )
    budget = Budget(rounds=arguments.rounds)
    for name in arguments.tune or [*FAMILIES, SENSITIVITY_VARIANTS]:
        path = design_file(shipped_folder(), name)
        if name == SENSITIVITY_VARIANTS:
            designs = design_sensitivity_variants(shipped_folder(), budget=budget)
        else:
            designs = design_family(
                shipped_folder(),
                name,
                FAMILIES[name],
                tunable_entries(FAMILIES[name], path, arguments.only),
                budget=budget,
            )
        start_time = time.monotonic()
        for design in designs:
            duration = time.monotonic() - start_time
            print(f"{name}: {design.name}, {design.description}, {duration:.0f} s", flush=True)
            start_time = time.monotonic()
        print_files([path])


def print_errors(evaluation: Evaluation) -> None:
    """Print the mean errors of all controllers in all laboratories."""
    laboratories = [laboratory for laboratory in FAMILY_OF if laboratory in evaluation.flights]
    rows = [
        (CONTROLLER_NAMES[name], *(error_text(evaluation.flights[laboratory].get(name)) for laboratory in laboratories))
        for name in evaluation.controllers
    ]
    print("mean RMSE in cm, followed by the fraction of crashes if there are any")
    print_columns(("", *laboratories), rows)


def error_text(metrics: Metrics | None) -> str:
    """Return the mean error in cm as text, with the fraction of crashes; a dash if the controller did not fly."""
    if metrics is None:
        return "–"
    error = mean_interval(values_without_crashes(metrics, "rmse")).without_interval().text(size=0.01)
    return f"{error} {crash_probability(metrics).without_interval().percent()}" if metrics.crashed.any() else error
