"""Draws the diagram of a scenario as SVG: the loop, and each diagram inside it."""

from command_line import folder_of, parser, print_files, run, scenario_of

from drake_quad.assembly.tracking import build_tracking_diagram
from drake_quad.files import output_folder, write_text
from drake_quad.scenario import draw_sample
from drake_quad.visualization.block_drawing import drawings, svg


def main() -> None:
    arguments = parser(
        description=__doc__,
        example="python scripts/draw_diagram.py diagrams/laboratory.yaml:low_wind",
        output="out/drawings",
        scenario="figure_eight.yaml",
    ).parse_args()
    scenario = draw_sample(scenario_of(arguments), 0)
    folder = output_folder(folder_of(arguments, scenario.name))
    pictures = {path: svg(text) for path, text in drawings(build_tracking_diagram(scenario)).items()}
    files = [write_text(folder / f"{path.replace('/', '_') or 'loop'}.svg", text) for path, text in pictures.items()]
    print_files(files)


if __name__ == "__main__":
    run(main)
