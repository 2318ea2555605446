"""Report of the evaluation: text, tables and files."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.design.tuning import Budget, LoopLimit
from drake_quad.evaluation.claims import (
    CONTROLLER_NAMES,
    all_claims,
    best_controllers,
    compare_common_samples,
    delay_text,
)
from drake_quad.evaluation.entries import controller_entries
from drake_quad.evaluation.families import FAMILIES, FAMILY_OF, FIRST_EVALUATION_SAMPLE, LaboratoryFamily
from drake_quad.evaluation.figures import evaluation_figures
from drake_quad.evaluation.results import SENSITIVITY_VARIANTS, Evaluation, Traits
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reports.claims import Claim, verdict_counts, verdict_table, write_claims
from drake_quad.reports.page import filled_template, image, table, write_figures, write_page
from drake_quad.reports.results import write_rows
from drake_quad.statistics.estimates import mean_interval
from drake_quad.studies.statistics import crash_probability, values_without_crashes

CAPTIONS = {
    "errors": "Mean RMSE of every controller in every laboratory, with 95 % intervals, most of which are narrower than"
    " the markers. A marker is hollow if more than 5 % of the vehicles crash; the mean is then that of the flights"
    " without a crash.",
    "margins": "RMSE in high wind as a function of the peak sensitivity and of the tolerated additional delay. Lines"
    " connect designs of the same controller with different limits.",
    "networks": "Reduction of the mean RMSE by a network, on the same samples, with 95 % intervals. Left of zero, the"
    " network increases the error.",
    "laps": "RMSE in each lap in high wind, with 95 % intervals, with and without a network that has the position as"
    " input.",
}
# Metrics whose means are columns of the summary, by the name of the column.
_MEAN_COLUMNS = {
    "rmse": "rmse",
    "peak": "peak_error",
    "effort_x": "effort_x",
    "effort_y": "effort_y",
    "effort_z": "effort_z",
}


# Columns of the tables of claims, in the file answers.csv and in the report: heading and field of `Claim`.
_FILE_COLUMNS = {"statement": "statement", "verdict": "verdict", "evidence": "evidence", "rule": "rule"}
_REPORT_COLUMNS = {"claim": "statement", "evidence": "evidence"}


def write_report(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write the tables, the figures and the pages of the report, and return the files."""
    claims = all_claims(evaluation)
    figures = write_figures(evaluation_figures(evaluation), folder)
    return [
        write_summary(folder / "summary.csv", evaluation),
        *([write_claims(folder / "answers.csv", claims, _FILE_COLUMNS)] if claims else []),
        *write_page(folder, report_markdown(evaluation, claims, figures)),
    ]


def report_markdown(evaluation: Evaluation, claims: Sequence[Claim], figures: Sequence[str]) -> str:
    """Return the report as Markdown, with links to its figures in the adjacent folder `figures`.

    Args:
        evaluation: results of all controllers.
        claims: claims with their verdicts.
        figures: names of the figures that were written.
    """
    limit = LoopLimit()
    return filled_template(
        __package__,
        best=_best(evaluation),
        verdicts=verdict_table(claims, _REPORT_COLUMNS),
        count=verdict_counts(claims),
        rules="\n".join(
            f"- {rule}: {_claim_numbers(claims, rule)}" for rule in dict.fromkeys(each.rule for each in claims)
        ),
        families="\n\n".join(_family_section(evaluation, name, family) for name, family in FAMILIES.items()),
        sensitivity_variants=_sensitivity_variants_table(evaluation),
        entries=_entries_table(),
        missing=_missing_designs_text(evaluation),
        samples=_max_samples(evaluation),
        num_laboratories=len({laboratory for _, laboratory, *_ in _flown(evaluation)}),
        first_sample=FIRST_EVALUATION_SAMPLE,
        budget=Budget(),
        limit=limit,
        delay=1e3 * limit.delay,
        training="; ".join(f"{name}: {' and '.join(each.training_laboratories)}" for name, each in FAMILIES.items()),
        machine=machine(),
        figures={
            name: image(name, caption, width=640) if name in figures else "" for name, caption in CAPTIONS.items()
        },
    )


def write_summary(path: Path, evaluation: Evaluation) -> Path:
    """Write a CSV file with a row for each controller in each laboratory, and return its path."""
    rows: list[dict[str, Any]] = [
        {
            "family": family,
            "laboratory": laboratory,
            "controller": name,
            "samples": len(metrics.rmse),
            **{
                column: mean_interval(values_without_crashes(metrics, metric))
                for column, metric in _MEAN_COLUMNS.items()
            },
            "crashes": crash_probability(metrics),
            **evaluation.traits[family][name]._asdict(),
        }
        for family, laboratory, name, metrics in _flown(evaluation)
    ]
    return write_rows(path, rows, digits=6)


def machine() -> str:
    """Return the processor name and the Python version, since computing times depend on both."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.machine()}, Python {platform.python_version()}"


def _flown(evaluation: Evaluation) -> list[tuple[str, str, str, Metrics]]:
    """Return the family, laboratory, controller name and metrics of all flights of designed controllers."""
    return [
        (family, laboratory, name, evaluation.flights[laboratory][name])
        for laboratory, family in FAMILY_OF.items()
        for name in evaluation.traits.get(family, {})
        if name in evaluation.flights.get(laboratory, {})
    ]


def _best(evaluation: Evaluation) -> str:
    """Return a Markdown list with the best controllers in each laboratory."""
    lines = []
    for laboratory in dict.fromkeys(laboratory for _, laboratory, *_ in _flown(evaluation)):
        best, *equals = best_controllers(evaluation, laboratory)
        mean = mean_interval(values_without_crashes(evaluation.flights[laboratory][best], "rmse"))
        line = f"- {laboratory}: {CONTROLLER_NAMES[best]}, {mean.text(unit='cm', size=0.01)}"
        if "pd" in evaluation.flights[laboratory] and best != "pd":
            ratio = compare_common_samples(
                evaluation.flights[laboratory]["pd"], evaluation.flights[laboratory][best]
            ).ratio
            line += f"; the RMSE of the tuned PD is {ratio.ratio()} times as large"
        if equals:
            line += f"; not significantly different from {', '.join(CONTROLLER_NAMES[name] for name in equals)}"
        lines.append(line)
    return "\n".join(lines)


def _family_section(evaluation: Evaluation, name: str, family: LaboratoryFamily) -> str:
    traits = evaluation.traits.get(name, {})
    if not traits:
        return f"### {name}\n\nNo controller was flown here."
    rows, certified = [], any(np.isfinite(each.stable_scale) for each in traits.values())
    for controller, each in traits.items():
        results = [evaluation.flights[laboratory][controller] for laboratory in family.laboratories]
        windy = evaluation.flights[family.windiest_laboratory][controller]
        crashed = [int(metrics.crashed.sum()) for metrics in results]
        effort = [values_without_crashes(windy, f"effort_{axis}") for axis in "xyz"]
        rows.append(
            (
                CONTROLLER_NAMES[controller]
                + ("" if len(windy.rmse) == _max_samples(evaluation) else f" ({len(windy.rmse)} samples)"),
                *(mean_interval(values_without_crashes(metrics, "rmse")).text(size=0.01) for metrics in results),
                ", ".join(map(str, crashed)) if any(crashed) else "0",
                mean_interval(values_without_crashes(windy, "peak_error")).text(size=0.01),
                f"{sum(float(values.mean()) for values in effort):.2f}" if len(effort[0]) else "–",
                *_trait_texts(each),
                *([_certificate_text(each)] if certified else []),
            )
        )
    laboratories = [f"{laboratory} (cm)" for laboratory in family.laboratories]
    header = (
        "",
        *laboratories,
        "crashes",
        f"peak in {family.windiest_laboratory} (cm)",
        "effort (m²/s⁴)",
        *_TRAIT_HEADINGS,
        *(["certified scale"] if certified else []),
    )
    fractions = _crash_probabilities(evaluation, family, traits)
    paragraphs = [f"### {name}", table(header, rows), *([f"Crash probabilities: {fractions}."] if fractions else [])]
    return "\n\n".join([*paragraphs, *(_reasons_without_certificate(traits) if certified else [])])


_TRAIT_HEADINGS = (
    "max \\|S\\|",
    "delay margin (ms)",
    "tolerated delay (ms)",
    "µs per tick, single vehicle",
    "in a fleet",
)


def _trait_texts(traits: Traits) -> tuple[str, ...]:
    return (
        _number(traits.sensitivity, ".2f"),
        _number(1e3 * traits.delay, ".0f"),
        delay_text(traits.delay_flown).removesuffix(" ms"),
        _number(1e6 * traits.lone, ".0f"),
        _number(1e6 * traits.fleet, ".2f"),
    )


def _certificate_text(traits: Traits) -> str:
    """Return, as text, the certified scale and the smallest scale at which an unstable loop was found, if any."""
    if not np.isfinite(traits.stable_scale):
        return "not certified"
    unstable = f" (unstable at {traits.unstable_scale:.2f})" if np.isfinite(traits.unstable_scale) else ""
    return f"{traits.stable_scale:.2f}{unstable}"


def _reasons_without_certificate(traits: Mapping[str, Traits]) -> list[str]:
    """Return, for each reason, a sentence that names the controllers that are not certified."""
    names: dict[str, list[str]] = {}
    for controller, each in traits.items():
        if each.not_certified:
            names.setdefault(each.not_certified, []).append(CONTROLLER_NAMES[controller])
    return [f"Not certified: {', '.join(each)}. Reason: {reason}." for reason, each in names.items()]


def _crash_probabilities(evaluation: Evaluation, family: LaboratoryFamily, traits: Mapping[str, Traits]) -> str:
    """Return, as text, the crash probability with its interval for all controllers and laboratories with a crash."""
    fractions = [
        f"{CONTROLLER_NAMES[name]} ({laboratory}): {crash_probability(evaluation.flights[laboratory][name]).percent()}"
        for laboratory in family.laboratories
        for name in traits
        if evaluation.flights[laboratory][name].crashed.any()
    ]
    return "; ".join(fractions)


def _sensitivity_variants_table(evaluation: Evaluation) -> str:
    rows = []
    for name, each in evaluation.traits.get(SENSITIVITY_VARIANTS, {}).items():
        controller, _, limit = name.partition("@")
        metrics = evaluation.flights["high wind"][name]
        mean = mean_interval(values_without_crashes(metrics, "rmse")).text(size=0.01)
        rows.append((CONTROLLER_NAMES[controller], limit, mean, str(int(metrics.crashed.sum())), *_trait_texts(each)))
    return table(("", "limit", "high wind (cm)", "crashes", *_TRAIT_HEADINGS), rows) if rows else "No design was flown."


def _entries_table() -> str:
    entries = controller_entries(on_board=False, position_networks=True).values()
    rows = [
        (
            each.label,
            each.plant_knowledge,
            f"search over {len(each.parameters)} numbers" if each.parameters else "Riccati equations",
        )
        for each in entries
    ]
    return table(("", "plant knowledge in addition to mass, inertia and reference", "tuned by"), rows)


def _missing_designs_text(evaluation: Evaluation) -> str:
    absent = {
        family: [CONTROLLER_NAMES[name] for name in each.entries if name not in evaluation.traits.get(family, {})]
        for family, each in FAMILIES.items()
    }
    lines = [f"- {family}: {', '.join(names)}" for family, names in absent.items() if names]
    return (
        "These controllers have no design and were not flown:\n\n" + "\n".join(lines)
        if lines
        else "Each controller has a design for each family of laboratories."
    )


def _max_samples(evaluation: Evaluation) -> int:
    return max(len(each.rmse) for results in evaluation.flights.values() for each in results.values())


def _claim_numbers(claims: Sequence[Claim], rule: str) -> str:
    return ", ".join(str(number) for number, each in enumerate(claims, start=1) if each.rule == rule)


def _number(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"
