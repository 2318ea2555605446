"""Report of the evaluation: its text and its files."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.design.tuning import Budget, LoopLimit
from drake_quad.evaluation.claims import WORDS, all_claims, beside, best_in, delay_words
from drake_quad.evaluation.entries import entries_of
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF, FIRST_JUDGED, LaboratoryFamily
from drake_quad.evaluation.figures import evaluation_figures
from drake_quad.evaluation.results import PRICED, Evaluation, Traits
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.claims import Claim, verdict_counts, verdict_table, write_claims
from drake_quad.reports.page import filled_template, image, table, write_figures, write_page
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import crash_probability, values_without_crashes

FIGURES = {
    "errors": "Mean RMSE of every controller in every laboratory, with 95 % intervals, most of which are narrower than"
    " the marks. A mark is hollow if more than 5 % of the vehicles crash; the mean is then that of the others.",
    "margins": "RMSE in high wind against the peak sensitivity and against the delay that is flown without a crash,"
    " beyond the laboratory's own; lines join designs of one controller with other limits.",
    "networks": "Reduction of the mean RMSE by a network over the same samples, with 95 % intervals; left of zero the"
    " network makes the error larger.",
    "laps": "RMSE in the last of so many laps of high wind, with 95 % intervals: with a network over the position, and"
    " without.",
}
# Metrics of the summary by the name of their column; each mean has an interval.
_MEANS = {"rmse": "rmse", "peak": "peak_error", "effort_x": "effort_x", "effort_y": "effort_y", "effort_z": "effort_z"}


# Fields of `Claim` by the headings of their columns, in the file and in the report.
_COLUMNS = {"statement": "words", "verdict": "verdict", "evidence": "evidence", "rule": "rule"}
_SHOWN_COLUMNS = {"statement": "words", "what was flown": "evidence"}


def write_report(folder: Path, found: Evaluation) -> list[Path]:
    """Write the tables, the figures and the pages of the report, and return the files."""
    claims = all_claims(found)
    figures = write_figures(evaluation_figures(found), folder)
    return [
        write_summary(folder / "summary.csv", found),
        *([write_claims(folder / "answers.csv", claims, _COLUMNS)] if claims else []),
        *write_page(folder, report_markdown(found, claims, figures)),
    ]


def report_markdown(found: Evaluation, claims: Sequence[Claim], figures: Sequence[str]) -> str:
    """Return the report as Markdown, with links to its figures in the adjacent folder `figures`.

    Args:
        found: numbers of the evaluation.
        claims: claims with their verdicts.
        figures: names of the figures that were written.
    """
    limit = LoopLimit()
    return filled_template(
        __package__,
        best=_best(found),
        verdicts=verdict_table(claims, _SHOWN_COLUMNS),
        count=verdict_counts(claims),
        rules="\n".join(f"- {rule}: {_numbers(claims, rule)}" for rule in dict.fromkeys(each.rule for each in claims)),
        families="\n\n".join(_family(found, name, family) for name, family in FAMILIES.items()),
        priced=_priced(found),
        entries=_entries(),
        absent=_absent(found),
        samples=_most(found),
        num_places=len({place for _, place, *_ in _flown(found)}),
        first_judged=FIRST_JUDGED,
        budget=Budget(),
        limit=limit,
        delay=1e3 * limit.delay,
        trained="; ".join(f"{name}: {' and '.join(each.trained)}" for name, each in FAMILIES.items()),
        machine=machine(),
        figures={name: image(name, caption, width=640) if name in figures else "" for name, caption in FIGURES.items()},
    )


def write_summary(path: Path, found: Evaluation) -> Path:
    """Write a row for each controller in each laboratory, and return the path."""
    rows: list[dict[str, Any]] = [
        {
            "family": family,
            "laboratory": place,
            "controller": name,
            "samples": len(metrics.rmse),
            **{column: mean_interval(values_without_crashes(metrics, metric)) for column, metric in _MEANS.items()},
            "crashes": crash_probability(metrics),
            **found.traits[family][name]._asdict(),
        }
        for family, place, name, metrics in _flown(found)
    ]
    return write_rows(path, rows, digits=6)


def machine() -> str:
    """Return the processor and the Python version, which the computing times depend on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, Python {platform.python_version()}"


def _flown(found: Evaluation) -> list[tuple[str, str, str, Metrics]]:
    """Return the family, laboratory, name and metrics of each controller that was flown in a family."""
    return [
        (family, place, name, found.flights[place][name])
        for place, family in FAMILY_OF.items()
        for name in found.traits.get(family, {})
        if name in found.flights.get(place, {})
    ]


def _best(found: Evaluation) -> str:
    """Return a list in Markdown with the best controllers in each laboratory."""
    lines = []
    for place in dict.fromkeys(place for _, place, *_ in _flown(found)):
        best, *equals = best_in(found, place)
        mean = mean_interval(values_without_crashes(found.flights[place][best], "rmse"))
        words = f"- {place}: {WORDS[best]}, {mean.text(unit='cm', size=0.01)}"
        if "pd" in found.flights[place] and best != "pd":
            share = beside(found.flights[place]["pd"], found.flights[place][best]).share
            words += f"; the RMSE of the tuned PD is {share.ratio()} times as large"
        if equals:
            words += f"; not significantly different from {', '.join(WORDS[name] for name in equals)}"
        lines.append(words)
    return "\n".join(lines)


def _family(found: Evaluation, name: str, family: LaboratoryFamily) -> str:
    traits = found.traits.get(name, {})
    if not traits:
        return f"### {name}\n\nNo controller was flown here."
    rows = []
    for controller, each in traits.items():
        flown = [found.flights[place][controller] for place in family.laboratories]
        windy = found.flights[family.windiest][controller]
        crashed = [int(metrics.crashed.sum()) for metrics in flown]
        effort = [values_without_crashes(windy, f"effort_{axis}") for axis in "xyz"]
        rows.append(
            (
                WORDS[controller] + ("" if len(windy.rmse) == _most(found) else f" ({len(windy.rmse)} samples)"),
                *(mean_interval(values_without_crashes(metrics, "rmse")).text(size=0.01) for metrics in flown),
                ", ".join(map(str, crashed)) if any(crashed) else "0",
                mean_interval(values_without_crashes(windy, "peak_error")).text(size=0.01),
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


def _crash_shares(found: Evaluation, family: LaboratoryFamily, traits: Mapping[str, Traits]) -> str:
    """Return the crash probabilities of the controllers and laboratories with a crash as text, with intervals."""
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
        mean = mean_interval(values_without_crashes(metrics, "rmse")).text(size=0.01)
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
        family: [WORDS[name] for name in each.entries if name not in found.traits.get(family, {})]
        for family, each in FAMILIES.items()
    }
    lines = [f"- {family}: {', '.join(names)}" for family, names in absent.items() if names]
    return (
        "These controllers have no design and are not flown:\n\n" + "\n".join(lines)
        if lines
        else "All controllers have a design for every family."
    )


def _most(found: Evaluation) -> int:
    return max(len(each.rmse) for flown in found.flights.values() for each in flown.values())


def _numbers(claims: Sequence[Claim], rule: str) -> str:
    return ", ".join(str(number) for number, each in enumerate(claims, start=1) if each.rule == rule)


def _number(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"
