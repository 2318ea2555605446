"""Tunes numbers of a scenario's controller: least error on training samples, under a limit on its loops.

A number may stand in several fields, as a gain does on x and y.
"""

import argparse

from drake_quad import InputError, Scenario
from drake_quad.command_line.options import add_controller, check_ranges, folder_of, parser, scenario_of
from drake_quad.command_line.output import print_columns, print_files, print_margins
from drake_quad.design.tuning import Budget, Knob, LoopLimit, tune, with_numbers
from drake_quad.files import output_folder, write_atomically
from drake_quad.linear.link_margins import link_margins
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import value_at
from drake_quad.studies.comparison import fly_samples
from drake_quad.studies.statistics import values_without_crashes

# A number without a range may become smaller or larger by this factor.
_DEFAULT_RANGE_FACTOR = 4.0
# Number of held-out samples that test the tuned controller; they follow the training samples.
_NUM_TEST_SAMPLES = 32
_RANGES = {"sensitivity": (1.1, 100.0), "delay-margin": (1e-3, 10.0), "samples": (1, 1000), "rounds": (1, 200)}


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
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
        help="a number to tune; by default within a factor of 4 of what it is (default: k_p and k_d of x and y)",
    )
    limit, budget = LoopLimit(), Budget()
    result.add_argument("--sensitivity", type=float, default=limit.sensitivity, metavar="PEAK", help="(%(default)s)")
    result.add_argument("--delay-margin", type=float, default=limit.delay, metavar="SECONDS", help="(%(default)s)")
    result.add_argument("--samples", type=int, default=budget.samples, help="to train on (%(default)s)")
    result.add_argument("--rounds", type=int, default=budget.rounds, help="of the search (%(default)s)")
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    check_ranges(arguments, _RANGES)
    scenario = scenario_of(arguments)
    written = arguments.tune or [f"control.position.{gain}.0,control.position.{gain}.1" for gain in ("k_p", "k_d")]
    knobs = [knob_of(text, scenario) for text in written]
    limit = LoopLimit(arguments.sensitivity, arguments.delay_margin)
    folder = output_folder(folder_of(arguments, scenario.name))
    budget = Budget()._replace(samples=arguments.samples, rounds=arguments.rounds)
    found = tune([scenario], knobs, limit.shares_met, budget=budget)
    tuned = with_numbers(scenario, knobs, found.numbers)
    file = write_atomically(folder / "scenario.yaml", lambda path: save_scenario(tuned, path))
    rows = [
        (", ".join(knob.paths), f"{value_at(scenario, knob.paths[0]):.4g}", f"{number:.4g}")
        for knob, number in zip(knobs, found.numbers, strict=True)
    ]
    judged = range(budget.samples, budget.samples + _NUM_TEST_SAMPLES)
    rows.append((f"RMSE on {_NUM_TEST_SAMPLES} other samples", judgement(scenario, judged), judgement(tuned, judged)))
    print_columns(("", "before", "tuned"), rows)
    print()
    print_margins(link_margins(tuned))
    if found.share < 1.0:
        print(f"\nnone of what was tried keeps the limit; this meets {100.0 * found.share:.0f} % of it")
    print_files([file])


def knob_of(text: str, scenario: Scenario) -> Knob:
    """Return the numbers that a value of `--tune` names, with their range."""
    fields, _, ends = text.partition("=")
    paths = tuple(fields.split(","))
    values = [value_at(scenario, path) for path in paths]
    for path, value in zip(paths, values, strict=True):
        if not path.startswith("control.") or not isinstance(value, float) or not value > 0.0:
            raise InputError(f"--tune names {path}, which is no number larger than 0 of the control")
    if not ends:
        return Knob(paths, values[0] / _DEFAULT_RANGE_FACTOR, values[0] * _DEFAULT_RANGE_FACTOR)
    low, _, high = ends.partition(":")
    try:
        knob = Knob(paths, float(low), float(high))
    except ValueError:
        raise InputError(f"--tune has the range {ends}, but must have LOW:HIGH") from None
    if not 0.0 < knob.low < knob.high:
        raise InputError(f"--tune has the range {ends}, which must rise, from above 0")
    return knob


def judgement(scenario: Scenario, samples: range) -> str:
    """Return as text the mean RMSE of the samples that do not crash, and the number of crashes."""
    metrics = fly_samples(scenario, samples)
    errors, crashed = values_without_crashes(metrics, "rmse"), int(metrics.crashed.sum())
    mean = f"{100.0 * errors.mean():.2f} cm" if len(errors) else "–"
    return f"{mean}, {crashed} crashed" if crashed else mean
