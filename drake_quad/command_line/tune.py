"""Tune parameters of a scenario's controller for the smallest error on training samples, under limits on its loops.

The limits apply to the peak sensitivity and the delay margin. Several fields can share a tuned value, for example the
gains of x and y.
"""

import argparse

from drake_quad import InputError, Scenario
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_stability_limits,
    check_ranges,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_columns, print_files, print_margins
from drake_quad.design.tuning import Budget, LoopLimit, TuningParameter, tune, with_parameter_values
from drake_quad.files import output_folder, write_atomically
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import value_at
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import values_without_crashes

# Unless a range is given, a parameter may change by this factor in both directions from its current value.
_DEFAULT_RANGE_FACTOR = 4.0
# Number of held-out samples on which the tuned controller is tested. They follow the training samples.
_NUM_TEST_SAMPLES = 32
# Smallest and largest value of each option; the delay margin is in s.
_RANGES = {"sensitivity": (1.1, 100.0), "delay-margin": (1e-3, 10.0), "samples": (1, 1000), "rounds": (1, 200)}


def options() -> argparse.ArgumentParser:
    result = parser(
        __doc__,
        "drake-quad tune laboratory:low_wind --controller"
        " controllers/designed/laboratory:pid --tune control.position.k_i.0,control.position.k_i.1=0.1:3",
        output="out/tuned",
        scenario="laboratory:low_wind",
    )
    add_controller(result)
    result.add_argument(
        "--tune",
        metavar="FIELD[,FIELD...][=LOW:HIGH]",
        action="append",
        default=[],
        help="field to tune and its range, or several fields that are set to the same value; can be given several times"
        " (default: k_p and k_d of x and y; default range: within a factor of 4 of the current value)",
    )
    limit, budget = LoopLimit(), Budget()
    add_stability_limits(result, limit.sensitivity, limit.delay)
    result.add_argument(
        "--samples", type=int, default=budget.samples, help="number of training samples (default: %(default)s)"
    )
    result.add_argument(
        "--rounds", type=int, default=budget.rounds, help="number of rounds of the search (default: %(default)s)"
    )
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, _RANGES)
    scenario = scenario_from_arguments(arguments)
    print_flight_remarks([scenario])
    specs = arguments.tune or [f"control.position.{gain}.0,control.position.{gain}.1" for gain in ("k_p", "k_d")]
    parameters = [parse_tuning_parameter(text, scenario) for text in specs]
    limit = LoopLimit(arguments.sensitivity, arguments.delay_margin)
    folder = output_folder(resolve_output_folder(arguments, scenario))
    budget = Budget()._replace(samples=arguments.samples, rounds=arguments.rounds)
    result = tune([scenario], parameters, limit.margin_ratios, budget=budget)
    tuned = with_parameter_values(scenario, parameters, result.values)
    file = write_atomically(folder / "scenario.yaml", lambda path: save_scenario(tuned, path))
    rows = [
        (", ".join(parameter.paths), f"{value_at(scenario, parameter.paths[0]):.4g}", f"{number:.4g}")
        for parameter, number in zip(parameters, result.values, strict=True)
    ]
    test_samples = range(budget.samples, budget.samples + _NUM_TEST_SAMPLES)
    rows.append(
        (
            f"RMSE on {_NUM_TEST_SAMPLES} held-out samples",
            rmse_text(scenario, test_samples),
            rmse_text(tuned, test_samples),
        )
    )
    print_columns(("", "before", "tuned"), rows)
    print()
    print_margins(link_margins(median_scenario(tuned)))
    if result.min_margin_ratio < 1.0:
        print(
            "\nno candidate meets the limits; the smallest margin of the best candidate is"
            f" {100.0 * result.min_margin_ratio:.0f} % of its limit"
        )
    print_files([file])


def parse_tuning_parameter(text: str, scenario: Scenario) -> TuningParameter:
    """Return the parameter and its range from a value of `--tune`."""
    fields, _, limits = text.partition("=")
    paths = tuple(fields.split(","))
    values = [value_at(scenario, path) for path in paths]
    for path, value in zip(paths, values, strict=True):
        if not path.startswith("control.") or not isinstance(value, float) or not value > 0.0:
            raise InputError(f"--tune {path} must name a field of `control` whose value is a number above 0")
    if not limits:
        return TuningParameter(paths, values[0] / _DEFAULT_RANGE_FACTOR, values[0] * _DEFAULT_RANGE_FACTOR)
    low, _, high = limits.partition(":")
    try:
        parameter = TuningParameter(paths, float(low), float(high))
    except ValueError:
        raise InputError(f"--tune has the range {limits}; write it as LOW:HIGH with two numbers") from None
    if not 0.0 < parameter.low < parameter.high:
        raise InputError(f"--tune has the range {limits}, but LOW must be above 0 and HIGH above LOW")
    return parameter


def rmse_text(scenario: Scenario, samples: range) -> str:
    """Return the mean RMSE of the samples that do not crash, and the number of crashes, as text."""
    metrics = fly_samples(scenario, samples)
    errors, crashed = values_without_crashes(metrics, "rmse"), int(metrics.crashed.sum())
    mean = f"{100.0 * errors.mean():.2f} cm" if len(errors) else "–"
    return f"{mean}, {crashed} crashed" if crashed else mean
