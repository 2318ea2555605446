"""Write the controller of a scenario as C code, for a flight controller or any other computer.

The code computes the command of the controller, a wrench or an attitude target, from the measurement and the reference.
It is C99 without memory allocation, global variables, or libraries other than math.h. In double precision, its results
are exactly those of the simulation.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import add_controller, parser, resolve_output_folder, scenario_from_arguments
from drake_quad.command_line.output import print_files, print_table
from drake_quad.export.controller import export_controller
from drake_quad.export.projects.registered import PROJECTS
from drake_quad.exported.description import ExportDescription
from drake_quad.exported.machines import CORES, code_size, has_cross_compiler
from drake_quad.framework.c_code import PRECISIONS


def options() -> argparse.ArgumentParser:
    result = parser(
        __doc__,
        "drake-quad export robustness --controller controllers/lqg:lqg_robustness --precision single",
        output="out/export",
    )
    add_controller(result)
    result.add_argument(
        "--precision",
        choices=[*PRECISIONS],
        default="double",
        help="floating-point format; elementary functions in single precision are those of math.h (default: double)",
    )
    result.add_argument(
        "--name", default="controller", help="name of the files, and prefix of all names in C (default: %(default)s)"
    )
    result.add_argument("--mixer", action="store_true", help="also compute rotor commands from the wrench")
    result.add_argument(
        "--project",
        choices=PROJECTS,
        help="also write a project for the firmware of a vehicle, such as the Crazyflie's out-of-tree controllers",
    )
    result.add_argument("--reference", action="store_true", help="add a function that evaluates the planned reference")
    return result


def main(arguments: argparse.Namespace) -> None:
    scenario = scenario_from_arguments(arguments)
    print_flight_remarks([scenario])
    folder = resolve_output_folder(arguments, scenario)
    export = export_controller(
        scenario,
        folder,
        name=arguments.name,
        precision=arguments.precision,
        mixer=arguments.mixer,
        reference=arguments.reference,
        project=arguments.project,
    )
    print_table(summary(export.description, folder))
    print_files(export.files)
    print(f"fly the exported code\n  drake-quad fly {arguments.scenario} --controller {folder}")


def summary(description: ExportDescription, folder: Path) -> list[tuple[str, str, str]]:
    """Return the rows of a table that describes exported code: name, value and unit."""
    number = description.number_type().itemsize
    rows = [
        ("period", f"{1000.0 * description.period:g}", "ms"),
        ("inputs", ", ".join(description.inputs), ""),
        ("outputs", ", ".join(description.outputs), ""),
        ("operations per step", f"{description.num_operations:,}", "at most"),
        ("state", f"{number * description.num_states + 4:,}", "bytes"),
        ("parameters", f"{number * description.num_parameters:,}", "bytes"),
    ]
    if has_cross_compiler():
        with ThreadPoolExecutor() as pool:  # compilation for each microcontroller core takes a second
            sizes = zip(CORES, pool.map(partial(code_size, folder), CORES), strict=True)
        rows += [(f"code on {core}", f"{size / 1000.0:.1f}", "kB") for core, size in sizes]
    return rows
