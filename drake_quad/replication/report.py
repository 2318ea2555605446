"""Report of the replication: text, tables and files."""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from drake_quad.files import write_text
from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import peak_norm
from drake_quad.replication.baseline_comparison import COMPARED_CONTROLLERS, FairEntry, fair_entries, write_fair
from drake_quad.replication.calibration import HYPOTHESES, NETWORK_CELL, PD_CELL
from drake_quad.replication.claims import all_claims
from drake_quad.replication.effort import (
    EffortMatch,
    effort_matches,
    published_ratios,
    published_scatter,
    write_efforts,
)
from drake_quad.replication.figures import Flights, paper_figures
from drake_quad.replication.measures import EFFORTS, OUR_EFFORT
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell, published_table
from drake_quad.replication.results import Experiment
from drake_quad.replication.table_ii import (
    QUANTITIES,
    TableEntry,
    number_or_dash,
    percent_or_dash,
    table_entries,
    table_markdown,
    write_entries,
)
from drake_quad.reports.claims import Claim, verdict_counts, verdict_table, write_claims
from drake_quad.reports.page import filled_template, image, table, write_figures, write_page
from drake_quad.reports.results import read_groups
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.winds.fan import jets
from drake_quad.statistics.estimates import mean_interval
from drake_quad.statistics.interval import Interval
from drake_quad.visualization.style import Vector

CAPTIONS = {
    "table_ii": "RMSE of Table II: the printed runs with their mean, and the mean of our simulations. The intervals"
    " of our means are narrower than their markers. The bars contain 95 % of the simulations.",
    "figure_4": "The paper's Fig. 4: upper and lower elliptic memberships for four pairs of exponents.",
    "figure_7": "The paper's Fig. 7: paths in sample 0 without wind. The numbers are those of the segments.",
    "figure_8": "The paper's Fig. 8: paths in sample 0 without wind, seen from above.",
    "figure_9": "The paper's Fig. 9: Euclidean errors in sample 0 without wind, over the numbered segments. The"
    " triangles are the peaks in the paper's figure.",
    "figure_10": "The paper's Fig. 10: Euclidean errors of four controllers in sample 0 in low wind. The triangles are"
    " the mean RMSE of Table II.",
    "figure_11": "The paper's Fig. 11: Euclidean errors of four controllers in sample 0 in high wind. The triangles are"
    " the mean RMSE of Table II.",
    "figure_12": "The paper's Fig. 12: commands of PD and network on X, without wind.",
    "figure_13": "The paper's Fig. 13: commands of PD and network on Y, without wind.",
    "advantage": "Relative reduction of the error from type 1 to type 2, without wind, over the noise of the cameras"
    " and over the weight q of the lower memberships, with 95 % intervals. Type 1 is better where the reduction is"
    " negative.",
    "gains": "Mean RMSE over the gains of the PD, without wind. With the gains shown in grey, at least one sample"
    " crashed.",
    "fair": "Mean RMSE of the PD, of PD+T2FNN, and of controllers that the paper does not consider.",
}
# Headings of the columns of claims.csv, each with the field of `Claim` that the column contains.
_FILE_COLUMNS = {"claim": "statement", "printed": "printed", "ours": "evidence"} | {
    name: name for name in ("verdict", "rule", "details", "figure")
}
# Headings of the columns of the table in the report, each with the field of `Claim` that the column contains.
_REPORT_COLUMNS = {"claim": "statement", "the paper's evidence": "printed", "ours, with 95 % intervals": "evidence"}
_FITTED_CELLS = (PD_CELL, NETWORK_CELL)


class Findings(NamedTuple):
    """Tables and claims that follow from an experiment.

    Attributes:
        entries: entries of Table II.
        claims: claims of the paper, with verdicts.
        fair: comparison with controllers that the paper does not consider.
        efforts: agreement of each definition of control effort with the paper; the best agreement is first.
    """

    entries: Sequence[TableEntry]
    claims: Sequence[Claim]
    fair: Sequence[FairEntry]
    efforts: Sequence[EffortMatch]


def collect_findings(experiment: Experiment) -> Findings:
    """Return the findings of an experiment."""
    return Findings(
        table_entries(experiment.cells), all_claims(experiment), fair_entries(experiment), effort_matches(experiment)
    )


def write_report(
    folder: Path,
    experiment: Experiment,
    findings: Findings,
    flights: Flights,
    *,
    vector: Vector | None = None,
    progress: Callable[[], object] = lambda: None,
) -> list[Path]:
    """Write the tables, the figures and the pages of the report, and return the files.

    Args:
        folder: folder of the report.
        experiment: results of the experiment.
        findings: findings of the experiment.
        flights: flight of sample 0 of each cell of Table II, for the figures.
        vector: format of additional vector graphics; None for no vector graphics.
        progress: called after each figure.
    """
    write_text(folder / "calibration.csv", files(__package__).joinpath("calibration.csv").read_text(encoding="utf-8"))
    sections = (f"## {heading}\n\n{table_markdown(findings.entries, name)}\n" for name, heading in QUANTITIES.items())
    tables = [
        write_entries(folder / "table_ii.csv", findings.entries),
        write_text(folder / "table_ii.md", "# Table II\n\n" + "\n".join(sections)),
        write_claims(folder / "claims.csv", findings.claims, _FILE_COLUMNS),
        write_fair(folder / "fair.csv", findings.fair),
        write_efforts(folder / "effort.csv", findings.efforts),
    ]
    write_figures(paper_figures(experiment, flights), folder, vector=vector, progress=progress)
    return [*tables, *write_page(folder, report_markdown(experiment, findings))]


def report_markdown(experiment: Experiment, findings: Findings) -> str:
    """Return the report as Markdown, with links to its figures in the adjacent folder `figures`."""
    return filled_template(
        __package__,
        figures={name: image(name, caption) for name, caption in CAPTIONS.items()},
        **_experiment_fields(experiment),
        **_scenario_fields(experiment.cells[Cell("low_wind", "pd_t2fnn")].scenario),
        **_calibration_fields(),
        **_table_fields(findings.entries),
        **_claim_fields(findings.claims),
        **_fair_fields(experiment, findings.fair),
        **_effort_fields(findings.efforts),
    )


def _experiment_fields(experiment: Experiment) -> dict[str, Any]:
    sweeps = [experiment.noise, experiment.q, *experiment.slopes.values(), *experiment.maps.values()]
    varied = [*(sweep.metrics.crashed for sweep in sweeps), np.isnan(experiment.legs.metrics.straight)]
    path_errors = (experiment.recorded[Cell("no_wind", name)]["path_error"] for name in ("pd", "pd_t2fnn"))
    path_pd, path_network = (mean_interval(errors).metres() for errors in path_errors)
    return {
        "samples": len(experiment.cells[PD_CELL].samples),
        "recorded": len(experiment.recorded[PD_CELL]["path_error"]),
        "duration": experiment.cells[PD_CELL].duration,
        "path_pd": path_pd,
        "path_network": path_network,
        "varied": sum(crashed.size for crashed in varied),
        "varied_crashed": sum(int(crashed.sum()) for crashed in varied),
        "sweep": len(experiment.noise.samples),
    }


def _scenario_fields(scenario: Scenario) -> dict[str, Any]:
    """Return the template fields that state the assumptions of the scenario PD+T2FNN in low wind."""
    plan, laboratory = plan_route(scenario), scenario.laboratory
    link, network = laboratory.command_link, cast(Network, scenario.cascade.network)
    first, second = jets(laboratory.wind)
    outlets = (", ".join(f"{each:g}" for each in jet.outlet) for jet in (first, second))
    return {
        "scenario": scenario,
        "plan": plan,
        "num_legs": len(plan.legs),
        "speed": peak_norm(plan.path, 1),
        "acceleration": peak_norm(plan.path, 2),
        "position_noise": 1e3 * laboratory.motion_capture.position_noise,
        "attitude_noise": 1e3 * laboratory.motion_capture.attitude_noise,
        "link_delay": 1e3 * link.period * link.delay_ticks,
        "link_loss": 100.0 * link.loss_rate,
        "jet": first,
        "jets": " and ".join(f"({outlet}) m" for outlet in outlets),
        "turbulence": 100.0 * first.turbulence,
        "num_sets": len(network.inputs.specified["error"].centres),
        "centres": ", ".join(f"{centre:g}" for centre in network.inputs.specified["error"].centres),
    }


def _calibration_fields() -> dict[str, str]:
    with as_file(files(__package__) / "calibration.csv") as path:
        fitted = read_groups(path, ("hypothesis", "wind", "controller"))
    rows, numbers, spreads = [], [], {}
    deviations: dict[tuple[str, Cell], float] = {}
    for cell, line in published_table().items():
        errors = {name: float(fitted[name, *cell]["rmse_m"][0]) for name in HYPOTHESES}
        deviations |= {(name, cell): error / line.rmse.mean - 1.0 for name, error in errors.items()}
        ours = (f"{error:.3f}{_in_brackets(deviations[name, cell])}" for name, error in errors.items())
        wind = WINDS[cell.wind] + (" (fitted)" if cell in _FITTED_CELLS else "")
        rows.append((wind, CONTROLLERS[cell.controller], number_or_dash(line.rmse.mean), *ours))
    for name, (label, _, *free) in HYPOTHESES.items():
        values = (fitted[name, *PD_CELL][column][0] for column in ("pd_number", "network_number"))
        texts = (f"{number.label}: {value:.4g}" for number, value in zip(free, values, strict=True))
        numbers.append(f"- {label}: {'; '.join(texts)}.")
        predicted = [deviations[name, cell] for cell in published_table() if cell not in _FITTED_CELLS]
        spreads[f"spread_{name}"] = f"{100.0 * np.nanmin(predicted):+.1f} to {100.0 * np.nanmax(predicted):+.1f} %"
    header = ("", "", "printed", *(hypothesis.label for hypothesis in HYPOTHESES.values()))
    return {"fitted": "\n".join(numbers), "calibration": table(header, rows), **spreads}


def _table_fields(entries: Sequence[TableEntry]) -> dict[str, Any]:
    errors = {entry.cell: entry for entry in entries if entry.quantity == "rmse"}
    predicted = [entry for cell, entry in errors.items() if cell not in _FITTED_CELLS and np.isfinite(entry.deviation)]
    exceptions = [entry for entry in predicted if abs(entry.deviation) > 0.1]
    deviations = [entry.deviation for entry in predicted]
    crashed = sum(entry.crashed for entry in errors.values())
    return {
        **{f"table_{name}": table_markdown(entries, name) for name in QUANTITIES},
        "off_pd": percent_or_dash(errors[PD_CELL].deviation),
        "off_network": percent_or_dash(errors[NETWORK_CELL].deviation),
        "predicted": len(predicted),
        "within": len(predicted) - len(exceptions),
        "exceptions": "; the exceptions are " + ", ".join(map(_cell_text, exceptions)) if exceptions else "",
        "spread": f"{100.0 * min(deviations):+.1f} to {100.0 * max(deviations):+.1f} %",
        "crashes": f"{crashed:,} samples crashed; means are those of the others." if crashed else "No sample crashed.",
    }


def _claim_fields(claims: Sequence[Claim]) -> dict[str, str]:
    parts = []
    for number, claim in enumerate(claims, start=1):
        title = claim.statement[0].upper() + claim.statement[1:]
        parts.append(
            f"### {number}. {title}\n\nThe paper: {claim.printed}. Here: {claim.evidence}.\n\nVerdict:"
            f" **{claim.verdict}**. Rule: {claim.rule}."
        )
        if claim.details:
            parts.append(f"Details: {claim.details}.")
        if claim.figure:
            parts.append(image(claim.figure, CAPTIONS[claim.figure]))
    return {
        "verdicts": verdict_table(claims, _REPORT_COLUMNS),
        "claims": "\n\n".join(parts),
        "count": verdict_counts(claims),
    }


def _fair_fields(experiment: Experiment, entries: Sequence[FairEntry]) -> dict[str, str]:
    rows = [
        (
            WINDS[entry.cell.wind],
            COMPARED_CONTROLLERS[entry.cell.controller],
            *(mean.text() for mean in (entry.rmse, entry.peak_error, entry.effort_x, entry.effort_y)),
            "1" if entry.cell.controller == "pd" else entry.over_pd.ratio(),
            "1" if entry.cell.controller == "pd_t2fnn" else entry.over_network.ratio(),
        )
        for entry in entries
    ]
    efforts = (f"effort on {axis} (m²/s⁴)" for axis in "XY")
    header = ("", "", "RMSE (m)", "peak error (m)", *efforts, "RMSE / PD's RMSE", "RMSE / PD+T2FNN's RMSE")
    over_network = {entry.cell: entry.over_network for entry in entries}
    network_ratios = {
        wind: experiment.comparison(Cell(wind, "pd_feed_forward_t2fnn"), Cell(wind, "pd_feed_forward")).ratio
        for wind in WINDS
    }
    return {
        "fair": table(header, rows),
        **{
            f"{name}_over_network": _fractions_by_wind_text({wind: over_network[Cell(wind, name)] for wind in WINDS})
            for name in ("pd_retuned", "pd_feed_forward")
        },
        "network_over_feed_forward": _fractions_by_wind_text(network_ratios),
    }


def _effort_fields(matches: Sequence[EffortMatch]) -> dict[str, Any]:
    x, y = published_ratios()
    rows = [("*printed*", f"{x:.2f}", f"{y:.2f}", "")]
    for match in matches:
        definition = EFFORTS[match.name].definition + (" (ours)" if match.name == OUR_EFFORT else "")
        rows.append((definition, f"{match.ratio_x:.2f}", f"{match.ratio_y:.2f}", match.distance.ratio()))
    return {
        "effort": table(("definition", "ratio on X", "ratio on Y", "factor between ours and printed"), rows),
        "scatter": published_scatter(),
        "closest": f"the {EFFORTS[matches[0].name].definition}",
    }


def _cell_text(entry: TableEntry) -> str:
    return f"{CONTROLLERS[entry.cell.controller]} in {WINDS[entry.cell.wind]} ({percent_or_dash(entry.deviation)})"


def _fractions_by_wind_text(fractions: Mapping[str, Interval]) -> str:
    return ", ".join(f"{fraction.percent()} ({WINDS[wind]})" for wind, fraction in fractions.items())


def _in_brackets(deviation: float) -> str:
    return "" if np.isnan(deviation) else f" ({percent_or_dash(deviation)})"
