"""Fly controllers with a state estimator and with a direct measurement of the state, and compare their errors."""

from collections.abc import Callable
from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad import Scenario, load_scenario
from drake_quad.command_line.options import check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.design.cascade import design_cascade, with_gains, with_integrals
from drake_quad.design.lqg import design_lqg
from drake_quad.files import output_folder, write_table
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.hovering import with_exact_measurement
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import compare, metric_mean


def with_designed_gains(scenario: Scenario) -> Scenario:
    return with_gains(scenario, design_cascade(median_scenario(scenario)).gains())


def with_designed_integrals(scenario: Scenario) -> Scenario:
    integrating = with_integrals(scenario)
    return with_gains(integrating, design_cascade(median_scenario(integrating), integral=0.1).gains())


def with_lqg(scenario: Scenario) -> Scenario:
    return scenario.model_copy(update={"control": design_lqg(scenario).control})


# For each controller, a function that designs it for the estimator of a scenario, and returns the changed scenario.
_DESIGNS: dict[str, Callable[[Scenario], Scenario]] = {
    "PD": with_designed_gains,
    "PID": with_designed_integrals,
    "LQG": with_lqg,
}
_CONTROLLERS: dict[str, dict[str, Callable[[Scenario], Scenario]]] = {
    "indoor_flow": {"PID of the firmware": lambda scenario: scenario},
    "warehouse_uwb": _DESIGNS,
    "outdoor_gnss": _DESIGNS,
}


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/compare_estimation.py --samples 16")
    options.add_argument("--samples", type=int, default=256, help="flights of each controller (default: %(default)s)")
    options.add_argument(
        "--output", type=Path, default=Path("out/compare_estimation"), help="folder (default: %(default)s)"
    )
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (2, 10_000)})
    folder = output_folder(arguments.output)
    cases = [(name, control) for name, controls in _CONTROLLERS.items() for control in controls]
    rows = [row(name, control, arguments.samples) for name, control in new_bar(cases, desc="flying")]
    titles = ("scenario", "controller", "RMSE direct (cm)", "RMSE estimated (cm)", "ratio", "max |S|")
    print_columns(titles, rows)
    columns = {title: [each[i] for each in rows] for i, title in enumerate(titles)}
    print_files([write_table(folder / "compare_estimation.csv", columns)])


def row(name: str, control: str, samples: int) -> tuple[str, ...]:
    """Return the errors of a controller with and without the estimator of a scenario, with 95 % intervals."""
    estimated = _CONTROLLERS[name][control](load_scenario(name))
    direct, others = (fly_samples(each, range(samples)) for each in (with_exact_measurement(estimated), estimated))
    margins = [each for each in link_margins(median_scenario(estimated)).values() if each is not None]
    means = [metric_mean(each, "rmse").text(size=0.01) for each in (direct, others)]
    ratio, peak = compare(others, direct).ratio.text(levels=(1.0,)), max(each.sensitivity for each in margins)
    return (name, control, *means, ratio, f"{peak:.2f}")


if __name__ == "__main__":
    run(main)
