"""Flies all designed controllers in all laboratories, and writes a report that says what each is worth.

With --tune, designs the controllers of families of laboratories anew, all by one protocol, and writes them into
diagrams/controllers/designed; the report is then made by a run without.
"""

import argparse
import time
from pathlib import Path

from drake_quad import InputError
from drake_quad.command_line.options import add_controller, bare_parser, check_ranges, controller_of
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.command_line.progress import progress_bar
from drake_quad.design.tuning import Budget
from drake_quad.evaluation.claims import CONTROLLER_NAMES
from drake_quad.evaluation.designs import design_file
from drake_quad.evaluation.experiment import QUICK, EvaluationSizes, UserController, fly_evaluation, missing_designs
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF
from drake_quad.evaluation.protocol import design_family, design_priced, tunable_entries
from drake_quad.evaluation.report import write_report
from drake_quad.evaluation.results import PRICED_DESIGNS, Evaluation
from drake_quad.files import output_folder
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.files.shipped import shipped_folder
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import crash_probability, values_without_crashes

_RANGES = {"samples": (2, 10_000), "rounds": (1, 1000)}


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad judge --quick --family outdoor")
    result.add_argument("--family", action="append", choices=FAMILIES, help="of laboratories; repeatable (all)")
    result.add_argument("--only", action="append", metavar="NAME", help="a designed controller; repeatable (all)")
    add_controller(result, several="flown as it is beside the designed ones; repeatable")
    result.add_argument(
        "--samples", type=int, default=EvaluationSizes().samples, help="in each laboratory (%(default)s)"
    )
    result.add_argument("--quick", action="store_true", help="a few samples over a second of flight")
    result.add_argument(
        "--tune",
        nargs="*",
        choices=[*FAMILIES, PRICED_DESIGNS],
        help=f"design the controllers of these families anew, all if none is named; {PRICED_DESIGNS}: those with other"
        " limits",
    )
    result.add_argument("--rounds", type=int, default=Budget().rounds, help="of each search (%(default)s)")
    result.add_argument("--output", type=Path, help="folder (default: out/controllers, or out/controllers_quick)")
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    check_ranges(arguments, _RANGES)
    if arguments.tune is not None:
        tune(arguments)
        return
    sizes = QUICK if arguments.quick else EvaluationSizes(samples=arguments.samples)
    families = arguments.family or [*FAMILIES]
    folder = output_folder(arguments.output or Path("out/controllers_quick" if arguments.quick else "out/controllers"))
    own = own_controllers(arguments.controller)
    start = time.monotonic()
    for name in families:
        absent = missing_designs(shipped_folder(), name)
        if absent:
            remark(f"{name} has no design of {', '.join(absent)}, which are not flown")
    with progress_bar("flying") as progress:
        found = fly_evaluation(
            shipped_folder(), families, sizes, folder, only=arguments.only, own=own, progress=progress
        )
    files = [folder / "flights.csv", folder / "traits.csv", *write_report(folder, found)]
    print_errors(found)
    print(f"flown in {time.monotonic() - start:.0f} s")
    print_files(files)


def own_controllers(specs: list[str]) -> list[UserController]:
    """Return the controllers of `--controller`. A controller with the short name of a designed one keeps its full name.

    Raises:
        InputError: if one of them cannot be loaded, or is given twice.
    """
    laboratory = str(shipped_folder() / "laboratory.yaml:nominal")
    found: list[UserController] = []
    for spec in specs:
        name, layers, overrides = controller_of(spec, laboratory)
        name = spec if name in CONTROLLER_NAMES else name
        if name in (each.name for each in found):
            raise InputError(f"--controller {spec}: another controller is called {name}; rename it")
        found.append(UserController(name, layers, overrides))
    return found


def tune(arguments: argparse.Namespace) -> None:
    """Design controllers, and print a line on each as soon as it is written."""
    if not (shipped_folder().parent / "pyproject.toml").exists():
        raise InputError("--tune writes into diagrams/ of a checkout, and this is an installed package")
    budget = Budget(rounds=arguments.rounds)
    for name in arguments.tune or [*FAMILIES, PRICED_DESIGNS]:
        path = design_file(shipped_folder(), name)
        if name == PRICED_DESIGNS:
            designs = design_priced(shipped_folder(), budget=budget)
        else:
            designs = design_family(
                shipped_folder(),
                name,
                FAMILIES[name],
                tunable_entries(FAMILIES[name], path, arguments.only),
                budget=budget,
            )
        start = time.monotonic()
        for design in designs:
            duration = time.monotonic() - start
            print(f"{name}: {design.name}, {design.description}, {duration:.0f} s", flush=True)
            start = time.monotonic()
        print_files([path])


def print_errors(found: Evaluation) -> None:
    """Print the mean errors of all controllers."""
    places = [place for place in FAMILY_OF if place in found.flights]
    rows = [
        (CONTROLLER_NAMES[name], *(error_in(found.flights[place].get(name)) for place in places))
        for name in found.controllers
    ]
    print("mean RMSE (cm), and the share of crashes where there are any")
    print_columns(("", *places), rows)


def error_in(metrics: Metrics | None) -> str:
    """Return the mean error as text."""
    if metrics is None:
        return "–"
    error = mean_interval(values_without_crashes(metrics, "rmse")).without_interval().text(size=0.01)
    return f"{error} {crash_probability(metrics).without_interval().percent()}" if metrics.crashed.any() else error
