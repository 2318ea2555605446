"""Fly thousands of samples of a scenario in fleets, on all cores or on a cluster, and summarise their metrics."""

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.flight_remarks import print_comparison_remarks, print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_vector,
    check_extra,
    check_metric,
    controlled_scenarios,
    parser,
    resolve_output_folder,
)
from drake_quad.command_line.output import flying_command, print_columns, print_files, remark
from drake_quad.command_line.progress import progress_bar
from drake_quad.command_line.workers import add_workers, open_executor
from drake_quad.errors import did_you_mean, join_names
from drake_quad.scenario.batch import check_pairs
from drake_quad.scenario.correlation import correlated_pairs
from drake_quad.scenario.paths import distributions_in
from drake_quad.studies.monte_carlo import DRAWS, run_monte_carlo, with_draws
from drake_quad.studies.statistics import metric_mean, most_influential_path, worst_samples
from drake_quad.studies.stopping import StoppingRule
from drake_quad.studies.study import PARQUET_FILE, Study
from drake_quad.studies.summary import (
    Summary,
    comparison_table,
    crash_text,
    influence_table,
    metric_table,
    obstacle_table,
    overview_table,
    requirement_table,
)
from drake_quad.visualization.style import save_figures


def options() -> argparse.ArgumentParser:
    result = parser(
        __doc__,
        "drake-quad study robustness --samples 200 --workers 2",
        output="out/monte_carlo",
        scenario="robustness",
    )
    result.add_argument("--samples", type=int, default=1000, help="number of samples (default: %(default)s)")
    add_controller(
        result, several="can be given several times; all fly the same samples, and the first is the baseline"
    )
    result.add_argument(
        "--until",
        action="append",
        default=[],
        metavar="RULE",
        help="end the study as soon as an estimate is precise, as in 'crash ± 0.2 %%' or, relative to the mean,"
        " 'rmse ± 1 %%'; can be given several times; --samples is then the largest number of samples",
    )
    result.add_argument(
        "--draws",
        choices=DRAWS,
        help="method by which random parameters are drawn: independently (random), or in replicates that cover the"
        " distributions evenly (latin_hypercube, sobol), which often makes means more precise (default: the method of"
        " the scenario, or random)",
    )
    result.add_argument("--batch", type=int, help="number of vehicles in a fleet (default: about a thousand)")
    add_workers(result, task="study")
    result.add_argument(
        "--metric",
        metavar="NAME",
        default="rmse",
        help="metric to plot and compare, see the page on metrics (default: %(default)s)",
    )
    result.add_argument(
        "--over",
        metavar="FIELD",
        help="random parameter over which the crash probability is plotted (default: the parameter with the largest"
        " influence on crashes)",
    )
    result.add_argument(
        "--parquet", action="store_true", help=f"also write the table as {PARQUET_FILE}, for large studies"
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    scenarios = scenarios_from_arguments(arguments)
    if arguments.parquet:
        check_extra("--parquet", "tables", "pandas", "pyarrow")
    folder = resolve_output_folder(arguments, next(iter(scenarios.values())))
    folders = {name: folder / name if arguments.controller else folder for name in scenarios}
    studies: dict[str, Study] = {}
    began = time.perf_counter()
    with open_executor(arguments) as pool:
        for name, scenario in scenarios.items():
            with progress_bar(name, unit=" flights", mininterval=0.2) as progress:
                studies[name] = run_monte_carlo(
                    scenario,
                    arguments.samples,
                    folder=folders[name],
                    resume=arguments.resume,
                    num_workers=arguments.workers,
                    batch_size=arguments.batch,
                    executor=pool,
                    compiled=not arguments.wired,
                    until=arguments.until,
                    progress=progress,
                )
    seconds = time.perf_counter() - began
    files = [folders[name] / "results.csv" for name in studies]
    if arguments.parquet:
        files += [study.to_parquet(folders[name] / PARQUET_FILE) for name, study in studies.items()]
    files += save_plots(studies, folder, arguments)
    for name, study in studies.items():
        if study.invalid_lines:
            lines = ", ".join(map(str, study.invalid_lines[:5])) + (", ..." if len(study.invalid_lines) > 5 else "")
            remark(
                f"{folders[name] / 'results.csv'}: lines {lines} had been altered, so their samples were flown again"
            )
        method = "uncompiled" if arguments.wired else "compiled"
        print_study(name, study, folders[name], method, metric=arguments.metric)
        print_rules([StoppingRule.parse(text, study.scenario) for text in arguments.until], study)
    if len(studies) > 1:
        print_comparison(studies, arguments.metric)
    print_files(files)
    print_rate(studies, seconds)
    if any(study.failures for study in studies.values()):
        raise RuntimeError(failure(studies, folders))


def scenarios_from_arguments(arguments: argparse.Namespace) -> dict[str, Scenario]:
    """Return the scenarios to fly by name: one for each controller, or a single scenario without `--controller`."""
    scenarios = controlled_scenarios(arguments)
    if arguments.draws is not None:
        scenarios = {name: with_draws(each, arguments.draws, arguments.samples) for name, each in scenarios.items()}
    check_pairs(scenarios)
    print_flight_remarks(scenarios.values())
    print_comparison_remarks(scenarios)
    for name, scenario in scenarios.items():
        if not distributions_in(scenario):
            remark(f"{name} has no distribution, so its samples differ only by wind and noise, if there are any")
            break
    for name, scenario in scenarios.items():
        check_metric(scenario, arguments.metric)
        random_fields = [*distributions_in(scenario)]
        if arguments.over is not None and arguments.over not in random_fields:
            names = f"its random parameters are: {join_names(random_fields) or 'none'}"
            raise InputError(
                f"--over: {arguments.over} is not a random parameter of {name};"
                f" {did_you_mean(arguments.over, random_fields, 1) or names}"
            )
    return scenarios


def save_plots(studies: Mapping[str, Study], folder: Path, arguments: argparse.Namespace) -> list[Path]:
    """Plot the distributions, convergence and crash probabilities of all studies, and the influences in each study."""
    studies = {name: study for name, study in studies.items() if len(study.samples)}
    if not studies:
        return []
    # Matplotlib takes half a second to import, so it is imported only in the main process, and after the flights.
    from drake_quad.visualization.study_plots import (
        plot_convergence,
        plot_crash_probability,
        plot_distribution,
        plot_influences,
    )

    metric = arguments.metric
    figures = {"distribution": plot_distribution(studies, metric), "convergence": plot_convergence(studies, metric)}
    for name, study in studies.items():
        suffix = f"_{name}" if len(studies) > 1 else ""
        if study.parameters and math.isfinite(metric_mean(study.metrics, metric).value):
            figures[f"influences{suffix}"] = plot_influences(study, metric)
        if study.parameters and study.metrics.crashed.any():
            figures[f"crash_influences{suffix}"] = plot_influences(study, "crashed")
    common = most_influential_path(studies.values())
    if common and any(study.metrics.crashed.any() for study in studies.values()):
        figures["crash_probability"] = plot_crash_probability(studies, arguments.over or common)
    return save_figures(figures, folder, vector=arguments.vector)


def print_study(name: str, study: Study, folder: Path, method: str, *, metric: str = "rmse") -> None:
    """Print estimates of the metrics, the largest influences, and commands that fly the worst samples again."""
    print(
        f"{name}: {len(study.samples):,} samples of seed {study.scenario.seed}, {study.duration:.2f} s each, diagrams"
        f" {method}; {crash_text(study)}"
    )
    if (draws := study.scenario.draws) is not None:
        count = len({*draws.replicates(study.samples)})
        print(
            f"{draws.kind} draws in {count} independent replicates of {draws.size} samples, from which the intervals"
            " follow"
        )
    print_summary(metric_table(study))
    if study.scenario.requirements:
        print_summary(requirement_table(study))
    if (touches := obstacle_table(study)).rows:
        print_summary(touches)
    if pairs := correlated_pairs(distributions_in(study.scenario)):
        first, others = pairs[0], f"; {len(pairs) - 1:,} more pairs" if len(pairs) > 1 else ""
        print(
            f"random parameters are correlated ({first.first} and {first.second}: {first.correlation:+.2f}{others}), so"
            " the influence of a parameter includes the influences of correlated parameters"
        )
    if study.parameters and len(study.samples):
        print_influences(study, metric)
        command = flying_command("sensitivities", study.scenario, folder / "scenario.yaml", "--sample 0")
        print(f"more: {command}")
    if len(study.samples):
        print("worst samples:")
    outcomes = {
        sample: _outcome_of(study, int(np.searchsorted(study.samples, sample))) for sample in worst_samples(study)
    }
    width = max(18, *map(len, outcomes.values())) if outcomes else 0
    for sample, outcome in outcomes.items():
        command = flying_command("fly", study.scenario, folder / "scenario.yaml", f"--sample {sample}")
        print(f"  {outcome:<{width}}  {command}")


def print_rules(rules: Sequence[StoppingRule], study: Study) -> None:
    """Print the estimate of each stopping rule. Its interval stays valid when the rule ends the study."""
    for rule in rules:
        met = "" if rule.is_met(study.metrics) else "; not precise enough for --until"
        print(f"{rule.quantity}: {rule.text(study.metrics)}, confidence sequence{met}")


def print_influences(study: Study, metric: str) -> None:
    """Print the random parameters with the largest influence on the metric and on crashes."""
    for name in [metric, "crashed"] if study.metrics.crashed.any() else [metric]:
        table = influence_table(study, name)
        print_summary(table if table.rows else table._replace(headings=()))


def _outcome_of(study: Study, index: int) -> str:
    """Return the outcome of the sample at an index: its RMSE, or the time and the obstacle of its crash."""
    metrics, obstacle = study.metrics.take(index), study.hit_obstacle_name(index)
    if not metrics.crashed:
        return f"{100.0 * metrics.rmse:.1f} cm"
    return f"crashed{'' if obstacle is None else f' into {obstacle}'} at {metrics.crash_time:.2f} s"


def print_comparison(studies: Mapping[str, Study], metric: str) -> None:
    """Print a paired comparison of each controller with the first, on the samples in which neither crashes."""
    print(f"paired comparison with {next(iter(studies))} on the same samples:")
    print_summary(comparison_table(studies, metric))
    print_summary(overview_table(studies))


def print_summary(summary: Summary) -> None:
    """Print a summary as a table, followed by its remarks. Without headings, only the remarks are printed."""
    if summary.headings:
        print_columns(summary.headings, summary.rows)
    for sentence in summary.remarks:
        print(sentence)


def print_rate(studies: Mapping[str, Study], seconds: float) -> None:
    """Print the simulation speed of the studies, including the start of the workers."""
    simulated_time = sum(study.simulated_time for study in studies.values())
    if simulated_time > 0.0:
        print(f"simulation speed: {simulated_time / seconds:,.0f} vehicle-seconds per second")
    else:
        print("all samples had already been flown")


def failure(studies: Mapping[str, Study], folders: Mapping[str, Path]) -> str:
    """Return an error message with the number of samples that failed, and the reason for the first failure."""
    failures = [(name, *each) for name, study in studies.items() for each in sorted(study.failures.items())]
    name, sample, reason = failures[0]
    return (
        f"{len(failures):,} samples could not be simulated (sample {sample} of {name}: {reason});"
        f" {folders[name] / 'failed.csv'} lists them, and --resume tries them again"
    )
