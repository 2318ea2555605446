"""Flies one scenario, prints its metrics and writes signals and plots."""

import math

from command_line import flight_progress, parser, print_files, print_table, run, scenario_of

from drake_quad import Flight, simulate
from drake_quad.files import output_folder
from drake_quad.visualization.plots import save_plots


def main() -> None:
    options = parser(
        description=__doc__,
        example="python scripts/simulate.py diagrams/figure_eight.yaml --set vehicle.mass=0.7",
        output="out",
        scenario="figure_eight.yaml",
    )
    options.add_argument("--sample", type=int, help="which sample of the scenario's study to fly, from 0 on")
    arguments = options.parse_args()
    scenario = scenario_of(arguments)
    folder = output_folder(arguments.output / scenario.name)
    with flight_progress() as progress:
        flight = simulate(scenario, sample=arguments.sample, progress=progress)
    files = [*flight.save(folder), *save_plots(flight, folder)]
    sample = scenario.sample if arguments.sample is None else arguments.sample
    drawn = [("sample", str(sample), f"of seed {scenario.seed}")] if sample is not None else []
    print_table([*drawn, *summary(flight)])
    print_files(files)


def summary(flight: Flight) -> list[tuple[str, str, str]]:
    """The metrics as rows of name, value and unit; a dash where there is nothing to measure."""
    metrics = flight.metrics

    def number(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if math.isfinite(value) else "–"

    end = f"crashed at {metrics.crash_time:.2f}" if metrics.crashed else f"{flight.time[-1]:.2f}"
    return [
        ("flown", end, "s"),
        ("RMSE", number(100.0 * metrics.rmse, 2), "cm"),
        *((f"RMSE on {axis.upper()}", number(100.0 * getattr(metrics, f"rmse_{axis}"), 2), "cm") for axis in "xyz"),
        ("peak error", number(100.0 * metrics.peak_error, 2), "cm"),
        *(
            (f"control effort on {axis.upper()}", number(getattr(metrics, f"effort_{axis}"), 4), "m²/s⁴")
            for axis in "xyz"
        ),
        ("rotors saturated", number(100.0 * metrics.saturation_share, 1), "% of the ticks"),
    ]


if __name__ == "__main__":
    run(main)
