"""Draw the block diagram of a scenario as SVG files: one for the whole loop, and one for each diagram inside it."""

import argparse

from drake_quad.command_line.options import add_controller, parser, resolve_output_folder, scenario_from_arguments
from drake_quad.command_line.output import print_files
from drake_quad.files import output_folder, write_text
from drake_quad.flight.mission import build_tracking_diagram
from drake_quad.scenario.batch import draw_sample
from drake_quad.visualization.block_drawing import drawings, svg


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad draw laboratory:low_wind", output="out/drawings")
    add_controller(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    scenario = draw_sample(scenario_from_arguments(arguments), 0)
    folder = output_folder(resolve_output_folder(arguments, scenario))
    pictures = {path: svg(text) for path, text in drawings(build_tracking_diagram(scenario)).items()}
    files = [write_text(folder / f"{path.replace('/', '_') or 'loop'}.svg", text) for path, text in pictures.items()]
    print_files(files)
