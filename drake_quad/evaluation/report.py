"""The report of the evaluation, as Markdown."""

import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from drake_quad.design.tuning import Budget, LoopLimit
from drake_quad.evaluation.answers import WORDS, Answer, beside, best_in, delay_words
from drake_quad.evaluation.entries import entries_of
from drake_quad.evaluation.families import FAMILIES, FIRST_JUDGED, Family
from drake_quad.evaluation.results import PRICED, Evaluation, Traits
from drake_quad.files import write_table
from drake_quad.laboratory.metrics import Metrics
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.report import image, table
from drake_quad.studies.statistics import Interval, crash_probability, of_survivors

FIGURES = {
    "errors": "Mean RMSE of every controller in every laboratory, with 95 % intervals, which mostly are narrower than"
    " the marks. Hollow: more than 5 % of the vehicles crash, and the mean is that of the others.",
    "margins": "RMSE in high wind against the peak sensitivity and against the delay that is flown without a crash,"
    " beyond the laboratory's own; lines join designs of one controller with other limits.",
    "networks": "By how much a network makes the mean RMSE smaller over the same samples, with 95 % intervals; left of"
    " zero it harms.",
    "laps": "RMSE in the last of so many laps of high wind, with 95 % intervals: with a network over the position, and"
    " without.",
}
# Columns of the summary that have intervals.
_MEANS = {"rmse": "rmse", "peak": "peak_error", "effort_x": "effort_x", "effort_y": "effort_y", "effort_z": "effort_z"}


def report_markdown(found: Evaluation, answers: Sequence[Answer], figures: Sequence[str]) -> str:
    """The whole report, which shows the figures of the folder `figures` beside it.

    Args:
        found: what was flown.
        answers: of `all_answers`.
        figures: names of the figures that there are.
    """
    template = files(__package__).joinpath("report_template.md").read_text(encoding="utf-8")
    budget, limit = Budget(), LoopLimit()
    fields = {
        "best": _best(found),
        "verdicts": table(
            ("statement", "what was flown", "verdict"),
            [(each.statement, each.evidence, f"**{each.verdict}**") for each in answers],
        ),
        "count": ", ".join(
            f"{number} × {verdict}" for verdict, number in Counter(each.verdict for each in answers).most_common()
        ),
        "rules": "\n".join(f"- {rule}: {_numbers(answers, rule)}" for rule in dict.fromkeys(e.rule for e in answers)),
        "families": "\n\n".join(_family(found, name, family) for name, family in FAMILIES.items()),
        "priced": _priced(found),
        "entries": _entries(),
        "absent": _absent(found),
        "samples": str(max(len(each.rmse) for flown in found.flights.values() for each in flown.values())),
        "places": str(len({place for _, place, *_ in _flown(found)})),
        "first_judged": str(FIRST_JUDGED),
        "rounds": str(budget.rounds),
        "candidates": str(budget.candidates),
        "training": str(budget.samples),
        "checks": str(budget.checks),
        "steps": str(budget.steps),
        "sensitivity": f"{limit.sensitivity:g}",
        "delay": f"{1e3 * limit.delay:g}",
        "trained": "; ".join(f"{name}: {' and '.join(each.trained)}" for name, each in FAMILIES.items()),
        "machine": machine(),
        **{f"figure_{name}": image(name, FIGURES[name], width=640) if name in figures else "" for name in FIGURES},
    }
    return template.format_map(fields)


def write_summary(path: Path, found: Evaluation) -> Path:
    """Writes a row for each controller in each laboratory, and returns the path."""
    rows = []
    for family, place, name, metrics in _flown(found):
        crashes = crash_probability(metrics)
        row: dict[str, object] = {
            "family": family,
            "laboratory": place,
            "controller": name,
            "samples": len(metrics.rmse),
        }
        for column, metric in _MEANS.items():
            row |= _ends(column, mean_interval(of_survivors(metrics, metric)))
        row |= _ends("crashes", crashes)
        rows.append(row | found.traits[family][name]._asdict())
    return write_table(path, {column: [row[column] for row in rows] for column in rows[0]}, digits=6)


def machine() -> str:
    """What the times were measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, Python {platform.python_version()}"


def _flown(found: Evaluation) -> list[tuple[str, str, str, Metrics]]:
    """Family, laboratory, controller and flights of all that a family's file designs."""
    return [
        (family, place, name, found.flights[place][name])
        for family, each in FAMILIES.items()
        for place in each.laboratories
        for name in found.traits.get(family, {})
        if name in found.flights.get(place, {})
    ]


def _ends(name: str, found: Interval) -> dict[str, float]:
    return {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}


def _best(found: Evaluation) -> str:
    """Return a sentence for each laboratory."""
    lines = []
    for place in dict.fromkeys(place for _, place, *_ in _flown(found)):
        best, *equals = best_in(found, place)
        mean = mean_interval(of_survivors(found.flights[place][best], "rmse"))
        words = f"- {place}: {WORDS[best]}, {mean.text(unit='cm', size=0.01)}"
        if "pd" in found.flights[place] and best != "pd":
            share = beside(found.flights[place]["pd"], found.flights[place][best]).share
            words += f"; the tuned PD {share.ratio()} times that"
        if equals:
            words += f"; not significantly different from {', '.join(WORDS[name] for name in equals)}"
        lines.append(words)
    return "\n".join(lines)


def _family(found: Evaluation, name: str, family: Family) -> str:
    traits = found.traits.get(name, {})
    if not traits:
        return f"### {name}\n\nNo controller was flown here."
    rows = []
    for controller, each in traits.items():
        flown = [found.flights[place][controller] for place in family.laboratories]
        windy = found.flights[family.windiest][controller]
        crashed = [int(metrics.crashed.sum()) for metrics in flown]
        effort = [of_survivors(windy, f"effort_{axis}") for axis in "xyz"]
        rows.append(
            (
                WORDS[controller] + ("" if len(windy.rmse) == _most(found) else f" ({len(windy.rmse)} samples)"),
                *(mean_interval(of_survivors(metrics, "rmse")).text(size=0.01) for metrics in flown),
                ", ".join(map(str, crashed)) if any(crashed) else "0",
                mean_interval(of_survivors(windy, "peak_error")).text(size=0.01),
                f"{sum(float(values.mean()) for values in effort):.2f}" if len(effort[0]) else "–",
                *_of_traits(each),
            )
        )
    places = [f"{place} (cm)" for place in family.laboratories]
    header = ("", *places, "crashes", f"peak in {family.windiest} (cm)", "effort (m²/s⁴)", *_TRAITS)
    shares = _crash_shares(found, family, traits)
    return f"### {name}\n\n{table(header, rows)}" + (f"\n\nCrashes: {shares}." if shares else "")


_TRAITS = ("max \\|S\\|", "delay margin (ms)", "delay flown (ms)", "µs a tick, lone", "in a fleet")


def _of_traits(each: Traits) -> tuple[str, ...]:
    return (
        _number(each.sensitivity, ".2f"),
        _number(1e3 * each.delay, ".0f"),
        delay_words(each.delay_flown).removesuffix(" ms"),
        _number(1e6 * each.lone, ".0f"),
        _number(1e6 * each.fleet, ".2f"),
    )


def _crash_shares(found: Evaluation, family: Family, traits: Mapping[str, Traits]) -> str:
    """The probabilities of crashes, with their intervals, where there are any."""
    shares = [
        f"{WORDS[name]} in {place} {crash_probability(found.flights[place][name]).percent()}"
        for place in family.laboratories
        for name in traits
        if found.flights[place][name].crashed.any()
    ]
    return "; ".join(shares)


def _priced(found: Evaluation) -> str:
    rows = []
    for name, each in found.traits.get(PRICED, {}).items():
        controller, _, limit = name.partition("@")
        metrics = found.flights["high wind"][name]
        mean = mean_interval(of_survivors(metrics, "rmse")).text(size=0.01)
        rows.append((WORDS[controller], limit, mean, str(int(metrics.crashed.sum())), *_of_traits(each)))
    return table(("", "limit", "high wind (cm)", "crashes", *_TRAITS), rows) if rows else "None were flown."


def _entries() -> str:
    entries = entries_of(on_board=False, maps=True).values()
    rows = [
        (each.words, each.told, f"the search, {len(each.knobs)} numbers" if each.knobs else "the designer of LQG")
        for each in entries
    ]
    return table(("", "told beside mass, inertia and reference", "tuned by"), rows)


def _absent(found: Evaluation) -> str:
    absent = {
        family: [
            WORDS[name]
            for name in entries_of(on_board=each.on_board, maps=each.maps)
            if name not in found.traits.get(family, {})
        ]
        for family, each in FAMILIES.items()
    }
    lines = [f"- {family}: {', '.join(names)}" for family, names in absent.items() if names]
    return "Without a design, and so not flown:\n\n" + "\n".join(lines) if lines else "All have a design everywhere."


def _most(found: Evaluation) -> int:
    return max(len(each.rmse) for flown in found.flights.values() for each in flown.values())


def _numbers(answers: Sequence[Answer], rule: str) -> str:
    return ", ".join(str(number) for number, each in enumerate(answers, start=1) if each.rule == rule)


def _number(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"
