"""Estimate the probability of a rare event, and find the worst samples.

Subset simulation needs tens of thousands of flights for a probability of 1e-6, where plain sampling needs tens of
millions. Random parameters, initial states, wind and noise are varied together.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from drake_quad.command_line.options import (
    check_ranges,
    scenario_from_arguments,
)
from drake_quad.command_line.output import flying_command, print_columns, print_files, remark
from drake_quad.command_line.progress import counting_bar
from drake_quad.command_line.searches import open_search, search_parser
from drake_quad.errors import InputError, short_repr
from drake_quad.files import write_table
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.studies.risk import DEFAULT_HALF_WIDTH, DEFAULT_PERIOD, Event, Risk, estimate_risk
from drake_quad.visualization.risk_plots import plot_coordinates, plot_exceedance
from drake_quad.visualization.style import save_figures

_NUM_TABLE_ROWS = 8  # rows of the printed table, each with one random number
_MAX_SCIENTIFIC = 0.01  # largest probability that is printed with an exponent instead of as a percentage


def options() -> argparse.ArgumentParser:
    result = search_parser(__doc__, "drake-quad risk robustness --event 'peak_error > 0.5' --to 50% --population 500")
    result.add_argument(
        "--event",
        default="crash",
        metavar="EVENT",
        help="'crash', or a metric and a bound in the unit of the metric, as in 'peak_error > 0.8'; for a requirement,"
        " 'NAME < 0' (default: %(default)s)",
    )
    result.add_argument(
        "--to",
        default=f"{DEFAULT_HALF_WIDTH:.0%}",
        metavar="PERCENT",
        help="half-width of the 95 %% interval, relative to the estimate, at which the estimation ends (default:"
        " %(default)s)",
    )
    result.add_argument(
        "--flights",
        type=int,
        default=200_000,
        help="number of flights after which the estimation ends (default: %(default)s)",
    )
    result.add_argument(
        "--population",
        type=int,
        default=1000,
        help="number of samples in each step of subset simulation, a multiple of 10 and at least 500 (default:"
        " %(default)s)",
    )
    result.add_argument(
        "--noise-period",
        type=float,
        default=DEFAULT_PERIOD,
        metavar="SECONDS",
        help="length of the periods whose wind and noise are drawn separately, a multiple of the control period"
        " (default: %(default)g)",
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"flights": (1, 1e9), "noise-period": (1e-3, 1e4)})
    half_width = parse_percent(arguments.to)
    scenario = scenario_from_arguments(arguments)
    event = Event.parse(arguments.event, scenario)
    began = time.perf_counter()
    with (
        open_search(arguments, scenario) as (folder, options),
        counting_bar(str(event), arguments.flights) as show,
    ):
        risk = estimate_risk(
            scenario,
            event,
            half_width=half_width,
            max_flights=arguments.flights,
            size=arguments.population,
            noise_period=arguments.noise_period,
            progress=show,
            **options,
        )
    seconds = time.perf_counter() - began
    print_risk(risk, scenario.name, seconds)
    files = [write_runs(folder / "runs.csv", risk), write_coordinates(folder / "coordinates.csv", risk)]
    figures = {"exceedance": plot_exceedance(risk)} if event.metric != "crash" else {}
    if risk.coordinates:
        figures["coordinates"] = plot_coordinates(risk)
    files += save_figures(figures, folder, vector=arguments.vector)
    print("worst samples, each from a different run")
    for number, worst in enumerate(risk.scenarios, start=1):
        file = folder / f"worst_{number}.yaml"
        save_scenario(worst, file)
        files.append(file)
        print(f"  {flying_command('fly', worst, file)}")
    print_files(files)


def parse_percent(text: str) -> float:
    """Return the fraction that a text such as `30%` states.

    Raises:
        InputError: if the text is not a percentage above 0 %.
    """
    try:
        value = 0.01 * parse_float(text.strip().removesuffix("%").strip())
    except ValueError:
        value = -1.0
    if not 0.0 < value < 100.0:
        raise InputError(f"--to {short_repr(text)} must be a percentage above 0 %, as in 30%")
    return value


def print_risk(risk: Risk, name: str, seconds: float) -> None:
    """Print the estimated probability, and the random numbers of the samples at which the event occurs."""
    probability = risk.probability
    text = f"{probability.value:.2g} [{probability.low:.1e}, {probability.high:.1e}]"
    if probability.value > _MAX_SCIENTIFIC:
        text = probability.percent()
    print(
        f"{name}: the probability of {risk.event} is {text}, from {len(risk.runs)} independent runs with"
        f" {risk.num_flights:,} flights in {seconds:.0f} s"
    )
    if not risk.is_precise:
        remark("the interval is wider than requested, because the largest number of flights was reached")
    if any(len(run.levels) > 1 for run in risk.runs):
        # The 95 % interval of plain sampling with n flights has the relative half-width 1.96 √((1 - p) / (p n)).
        relative = 0.5 * (probability.high - probability.low) / probability.value
        plain = 1.96**2 * (1.0 - probability.value) / (probability.value * relative**2)
        print(f"plain sampling needs about {plain:.1e} flights for this interval")
    rows = [
        (each.name, each.mean.text(signed=True), f"{each.deviation:.2f}", "")
        for each in risk.coordinates[:_NUM_TABLE_ROWS]
    ]
    if rows:
        print(
            f"random numbers of the samples with {risk.event}; over all samples, each has mean 0 and standard"
            " deviation 1"
        )
        print_columns(("random number", "mean", "deviation", ""), rows)


def write_runs(path: Path, risk: Risk) -> Path:
    """Write a table with the probability and the number of flights of each run."""
    return write_table(
        path,
        {
            "run": range(len(risk.runs)),
            "probability": [run.probability for run in risk.runs],
            "steps": [len(run.levels) for run in risk.runs],
            "flights": [run.num_evaluations for run in risk.runs],
        },
    )


def write_coordinates(path: Path, risk: Risk) -> Path:
    """Write a table with the distribution of each random number over the samples at which the event occurs."""
    means = np.array([each.mean for each in risk.coordinates]).reshape(-1, 3)
    return write_table(
        path,
        {
            "random_number": [each.name for each in risk.coordinates],
            "mean": means[:, 0],
            "mean_low": means[:, 1],
            "mean_high": means[:, 2],
            "deviation": [each.deviation for each in risk.coordinates],
        },
    )
